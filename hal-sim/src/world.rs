//! The virtual world: one clock that owns the bus, the nodes and the CAN tools.

use std::collections::VecDeque;

use windlass_core::frame::Frame;
use windlass_core::node::Attempts;
use windlass_core::time::{Duration, Instant, TICK};

use crate::bus::{Bus, Disturbance, Outcome, Station};
use crate::controller::ErrorState;
use crate::node::{Chip, SimNode};
use crate::plant::PlantConfig;
use crate::poke::Poke;
use crate::random::Random;
use crate::spec::{NodeSpec, WorldConfig};
use crate::ticker::Ticker;
use crate::trace::{Source, Trace, TraceEntry, Traced};

/// Frames that a CAN tool may leave unread before the oldest are dropped.
const INBOX_CAPACITY: usize = 65_536;

/// A CAN tool on the bus.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub struct ParticipantId(usize);

/// A frame that a CAN tool received.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Received {
    /// The frame.
    pub frame: Frame,
    /// End of the frame, in virtual time.
    pub at: Instant,
}

/// How the bus has been doing.
#[derive(Clone, Debug, PartialEq)]
pub struct BusStatistics {
    /// Share of the last 100 ms in which the bus was busy, in percent.
    pub load_percent: f64,
    /// Good frames since the world began.
    pub frames: u64,
    /// Error frames since the world began.
    pub error_frames: u64,
    /// Receptions that were lost (good frames times receivers that missed them).
    pub lost: u64,
    /// Frames dropped because a CAN tool did not read them.
    pub overruns: u64,
    /// Everybody who is on the bus now.
    pub participants: Vec<ParticipantStatistics>,
}

/// Counters of one participant's CAN controller.
#[derive(Clone, Debug, PartialEq)]
pub struct ParticipantStatistics {
    /// Who it is.
    pub source: Source,
    /// Error state.
    pub state: ErrorState,
    /// Transmit error counter.
    pub tec: u16,
    /// Receive error counter.
    pub rec: u16,
    /// Times that it went bus-off.
    pub bus_off_count: u32,
    /// Frames sent.
    pub sent: u64,
    /// Frames received.
    pub received: u64,
    /// Frames that it missed.
    pub lost: u64,
}

/// Whom a controller on the bus belongs to.
#[derive(Clone, Copy, Debug)]
enum Owner {
    Node(usize),
    Tool(usize),
}

#[derive(Debug)]
struct Tool {
    name: String,
    station: Station,
    inbox: VecDeque<Received>,
    overruns: u64,
}

/// A bus with simulated controllers and CAN tools in virtual time.
///
/// Nothing happens unless one of the `advance` functions is called; then everything happens in the order
/// of virtual time. The same seed and the same calls give the same bits.
#[derive(Debug)]
pub struct World {
    seed: u64,
    /// Now, in ns.
    now: u64,
    bus: Bus,
    owners: Vec<Owner>,
    nodes: Vec<SimNode>,
    tools: Vec<Tool>,
    ticker: Ticker,
    trace: Trace,
    outcome: Outcome,
}

fn instant(nanos: u64) -> Instant {
    Instant::from_micros(nanos / 1000)
}

fn nanos(instant: Instant) -> u64 {
    instant.as_micros().saturating_mul(1000)
}

impl World {
    /// An empty bus at time zero.
    #[must_use]
    pub fn new(config: WorldConfig) -> Self {
        let disturbance = Disturbance {
            loss: config.loss,
            corruption: config.corruption,
            delay: config.delay.as_micros() * 1000,
        };
        Self {
            seed: config.seed,
            now: 0,
            bus: Bus::new(config.bit_rate, disturbance, Random::new(config.seed, 1)),
            owners: Vec::new(),
            nodes: Vec::new(),
            tools: Vec::new(),
            ticker: Ticker::new(TICK.as_micros() * 1000),
            trace: Trace::default(),
            outcome: Outcome::default(),
        }
    }

    /// Adds a powered controller with the default plant; its index counts from 0.
    pub fn add_node(&mut self, spec: NodeSpec) -> usize {
        self.add_node_with_plant(spec, &PlantConfig::default())
    }

    /// Adds a powered controller on a plant of one's own.
    pub fn add_node_with_plant(&mut self, spec: NodeSpec, plant: &PlantConfig) -> usize {
        self.add_board(spec, plant, Chip::default())
    }

    /// Adds a powered controller with another chip's flash and a plant of one's own.
    pub fn add_board(&mut self, spec: NodeSpec, plant: &PlantConfig, chip: Chip) -> usize {
        let index = self.nodes.len();
        let station = self.bus.attach(false);
        self.owners.push(Owner::Node(index));
        let identity = (self.seed, index);
        let mut node = SimNode::new(spec, (plant, chip), station, identity, instant(self.now));
        let phase = if index == 0 { 0 } else { node.draw_phase() };
        self.ticker.add(index, phase * 1000, self.now);
        self.nodes.push(node);
        index
    }

    /// Plugs in a CAN tool: it acknowledges, receives and sends.
    pub fn join(&mut self, name: &str) -> ParticipantId {
        let id = self.tools.len();
        let station = self.bus.attach(true);
        self.owners.push(Owner::Tool(id));
        self.tools.push(Tool {
            name: name.to_owned(),
            station,
            inbox: VecDeque::new(),
            overruns: 0,
        });
        ParticipantId(id)
    }

    /// Unplugs a CAN tool for good, with everything that it has not sent or read.
    pub fn leave(&mut self, id: ParticipantId) {
        if let Some(tool) = self.tools.get_mut(id.0) {
            tool.inbox = VecDeque::new();
            let station = tool.station;
            self.bus.detach(station, self.now);
        }
    }

    /// Queues a frame of a CAN tool. It contends for the bus from now on; a tool that has left sends
    /// nothing.
    pub fn send(&mut self, id: ParticipantId, frame: Frame) {
        if let Some(tool) = self.tools.get(id.0)
            && self.bus.controller(tool.station).running
        {
            self.bus.enqueue(tool.station, frame, self.now);
        }
    }

    /// The oldest frame that a CAN tool has received and not yet read. Its own frames are not among them.
    pub fn receive(&mut self, id: ParticipantId) -> Option<Received> {
        self.tools.get_mut(id.0)?.inbox.pop_front()
    }

    /// Frames of a CAN tool that have not been sent.
    #[must_use]
    pub fn pending(&self, id: ParticipantId) -> usize {
        self.tools
            .get(id.0)
            .map_or(0, |tool| self.bus.pending(tool.station))
    }

    /// Counters of a CAN tool's controller; `None` if there is no such tool.
    #[must_use]
    pub fn participant(&self, id: ParticipantId) -> Option<ParticipantStatistics> {
        let tool = self.tools.get(id.0)?;
        Some(self.participant_statistics(tool.station))
    }

    /// Connects the two wires of the bus with each other, or parts them again. While they touch, every
    /// frame is destroyed in every attempt.
    pub fn short_bus(&mut self, shorted: bool) {
        self.bus.shorted = shorted;
    }

    /// Virtual time since the world began.
    #[must_use]
    pub fn now(&self) -> Instant {
        instant(self.now)
    }

    /// Lets exactly this much virtual time pass.
    pub fn advance(&mut self, span: Duration) {
        let target = self
            .now
            .saturating_add(span.as_micros().saturating_mul(1000));
        self.run(target, None);
    }

    /// Lets time pass until a frame is there for a CAN tool, and takes it; at the latest until
    /// `deadline`. A frame that is there already is given at once.
    pub fn advance_until_received(
        &mut self,
        id: ParticipantId,
        deadline: Instant,
    ) -> Option<Received> {
        if self.tools.get(id.0)?.inbox.is_empty() {
            self.run(nanos(deadline), Some(id.0));
        }
        self.receive(id)
    }

    /// Handles events up to and with `target`; stops early when the inbox of `tool` is not empty.
    ///
    /// Order at one moment: end of frame, control ticks, start of frame. A frame that could start at
    /// `target` itself waits for the next call, so that what is sent between two calls takes part in the
    /// arbitration.
    fn run(&mut self, target: u64, tool: Option<usize>) {
        self.rewire_all();
        loop {
            let now = self.ticker.next().min(self.bus.next_event());
            if now > target {
                break;
            }
            self.now = self.now.max(now);
            self.bus_event();
            while self.ticker.next() <= self.now {
                let index = self.ticker.take();
                self.tick(index);
            }
            let stop = tool.is_some_and(|tool| !self.tools[tool].inbox.is_empty());
            if stop || self.now == target {
                break;
            }
            if self.bus.starts_at(self.now) {
                self.bus.start(self.now);
            }
        }
        if tool.is_none_or(|tool| self.tools[tool].inbox.is_empty()) {
            self.now = self.now.max(target);
        }
        for node in &mut self.nodes {
            node.look_at(self.bus.controller(node.station));
        }
    }

    fn tick(&mut self, index: usize) {
        let node = &mut self.nodes[index];
        let errors = self.bus.controller(node.station).errors;
        node.tick(instant(self.now), errors);
        self.rewire(index);
        self.fill_mailbox(index);
    }

    /// Carries out what pokes and restarts changed at the CAN controllers.
    fn rewire_all(&mut self) {
        for index in 0..self.nodes.len() {
            self.rewire(index);
        }
    }

    fn rewire(&mut self, index: usize) {
        let node = &mut self.nodes[index];
        let Some(wiring) = node.take_wiring() else {
            return;
        };
        if wiring.reset {
            self.bus.set_running(node.station, false, self.now);
        }
        self.bus
            .set_connected(node.station, wiring.connected, self.now);
        self.bus.set_running(node.station, wiring.running, self.now);
    }

    fn fill_mailbox(&mut self, index: usize) {
        let node = &mut self.nodes[index];
        if !self.bus.mailbox_free(node.station) {
            return;
        }
        if let Some(transmission) = node.poll_tx(instant(self.now)) {
            let attempts = match transmission.attempts {
                Attempts::UntilSent => None,
                Attempts::AtMost(count) => Some(count),
            };
            self.bus
                .load_mailbox(node.station, transmission.frame, attempts, self.now);
        }
    }

    /// Whatever ends on the bus now is told to everybody concerned.
    fn bus_event(&mut self) {
        if self.bus.next_event() > self.now {
            return;
        }
        let mut outcome = std::mem::take(&mut self.outcome);
        self.bus.advance_to(self.now, &mut outcome);
        self.tell(&outcome);
        self.outcome = outcome;
    }

    fn tell(&mut self, outcome: &Outcome) {
        let now = instant(self.now);
        for &(station, sent) in &outcome.ended {
            if let Owner::Node(index) = self.owners[station] {
                self.nodes[index].on_transmitted(now, sent);
            }
        }
        for &station in &outcome.lost {
            if let Owner::Node(index) = self.owners[station] {
                self.nodes[index].on_bus_lost(now);
            }
        }
        for &(station, _) in &outcome.ended {
            if let Owner::Node(index) = self.owners[station] {
                self.fill_mailbox(index);
            }
        }
        if let Some((frame, from)) = outcome.delivered {
            let at = now;
            self.trace.push(Traced { at, frame, from });
            for &station in &outcome.receivers {
                match self.owners[station] {
                    Owner::Node(index) => {
                        if self.nodes[index].on_frame(now, &frame) {
                            self.rewire(index);
                            self.fill_mailbox(index);
                        }
                    }
                    Owner::Tool(tool) => self.tools[tool].take_in(Received { frame, at }),
                }
            }
        }
    }

    /// Number of nodes.
    #[must_use]
    pub fn nodes(&self) -> usize {
        self.nodes.len()
    }

    /// A node.
    #[must_use]
    pub fn node(&self, index: usize) -> Option<&SimNode> {
        self.nodes.get(index)
    }

    /// A node, to interfere with.
    pub fn node_mut(&mut self, index: usize) -> Option<&mut SimNode> {
        self.nodes.get_mut(index)
    }

    /// Switches a node off and on again; it is back on the bus 5 ms later. A node without power is
    /// switched on.
    pub fn power_cycle(&mut self, index: usize) {
        if let Some(node) = self.nodes.get_mut(index) {
            node.poke(Poke::Powered(false));
            node.poke(Poke::Powered(true));
        }
        self.rewire_all();
    }

    /// Fingerprint of everything that a node's engine has decided in all its ticks; 0 for no such node.
    #[must_use]
    pub fn actuation_hash(&self, index: usize) -> u64 {
        self.nodes.get(index).map_or(0, SimNode::actuation_hash)
    }

    /// How the bus is doing.
    #[must_use]
    pub fn bus(&self) -> BusStatistics {
        let stations = self.bus.members();
        let participants: Vec<_> = stations
            .iter()
            .map(|station| self.participant_statistics(*station))
            .collect();
        BusStatistics {
            load_percent: self.bus.load_percent(self.now),
            frames: self.bus.frames,
            error_frames: self.bus.error_frames,
            lost: self.bus.lost,
            overruns: self.tools.iter().map(|tool| tool.overruns).sum(),
            participants,
        }
    }

    fn participant_statistics(&self, station: Station) -> ParticipantStatistics {
        let controller = self.bus.controller(station);
        ParticipantStatistics {
            source: self.source(station),
            state: controller.state,
            tec: controller.tec,
            rec: controller.rec,
            bus_off_count: controller.bus_off_count,
            sent: controller.sent,
            received: controller.received,
            lost: controller.lost,
        }
    }

    fn source(&self, station: Station) -> Source {
        match self.owners[station] {
            Owner::Node(index) => Source::Node(index),
            Owner::Tool(tool) => Source::Participant(self.tools[tool].name.clone()),
        }
    }

    /// Up to `limit` frames that were on the bus, from number `seq` on, oldest first. The ring holds the
    /// last [`TRACE_CAPACITY`](crate::TRACE_CAPACITY) frames.
    #[must_use]
    pub fn trace_since(&self, seq: u64, limit: usize) -> Vec<TraceEntry> {
        self.trace
            .since(seq, limit)
            .map(|(seq, entry)| TraceEntry {
                seq,
                at: entry.at,
                frame: entry.frame,
                from: self.source(entry.from),
            })
            .collect()
    }
}

impl Tool {
    fn take_in(&mut self, received: Received) {
        if self.inbox.len() == INBOX_CAPACITY {
            self.inbox.pop_front();
            self.overruns += 1;
        }
        self.inbox.push_back(received);
    }
}
