//! One CAN bus: arbitration, frame timing, acknowledge, error frames, bus-off recovery.
//!
//! The bus is a state machine over virtual time in nanoseconds. Its owner asks [`Bus::next_event`] when
//! something happens next, calls [`Bus::advance_to`] at that time and hands the [`Outcome`] to the
//! participants. A frame's fate is drawn at its start of frame and told at its end of frame.
//!
//! Simplifications, none of which a participant can observe: controllers synchronise without delay;
//! an error frame always takes the longest superposition of flags (12 bits) unless the transmitter is
//! alone; what a loser of the arbitration saw of the winner's frame is not modelled bit by bit.

use windlass_core::frame::Frame;

use crate::bits::{self, Bits, INTERMISSION, Shape, UP_TO_ACK};
use crate::controller::{Controller, ErrorState, Mail, NEVER};
use crate::load::LoadMeter;
use crate::random::Random;

mod confinement;
#[cfg(test)]
mod tests;

/// Index of a controller on the bus.
pub(crate) type Station = usize;

/// Superposed error flags of several controllers.
const ERROR_FLAGS: u64 = 12;
/// Error flag of a lonely transmitter.
const ERROR_FLAG_ALONE: u64 = 6;
const ERROR_DELIMITER: u64 = 8;
/// Extra wait of an error-passive transmitter after its own frame.
const SUSPEND_TRANSMISSION: u64 = 8;
/// Length of a recessive sequence that bus-off recovery counts.
const RECESSIVE_SEQUENCE: u64 = 11;

/// Disturbances of a bus.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Disturbance {
    /// Probability that one receiver misses a good frame.
    pub(crate) loss: f64,
    /// Probability that a frame is destroyed by an error frame.
    pub(crate) corruption: f64,
    /// Largest delay between handing a frame to the controller and its first attempt, in ns.
    pub(crate) delay: u64,
}

/// What happened at one moment on the bus. One value is reused, so that nothing is allocated per frame.
#[derive(Debug, Default)]
pub(crate) struct Outcome {
    /// A frame that was good, with its transmitter.
    pub(crate) delivered: Option<(Frame, Station)>,
    /// Who received it.
    pub(crate) receivers: Vec<Station>,
    /// Transmissions from a mailbox that ended: true = sent, false = given up.
    pub(crate) ended: Vec<(Station, bool)>,
    /// Controllers that became error passive or bus-off.
    pub(crate) lost: Vec<Station>,
}

impl Outcome {
    fn clear(&mut self) {
        self.delivered = None;
        self.receivers.clear();
        self.ended.clear();
        self.lost.clear();
    }
}

/// What becomes of the frame on the wire.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Fate {
    Delivered,
    NotAcknowledged,
    Destroyed,
}

/// The frame on the wire.
#[derive(Clone, Copy, Debug)]
struct OnWire {
    frame: Frame,
    fate: Fate,
    start: u64,
    end: u64,
}

/// One CAN bus and its controllers.
#[derive(Debug)]
pub(crate) struct Bus {
    bit: u64,
    controllers: Vec<Controller>,
    /// Controllers that have not left for good.
    members: Vec<Station>,
    /// Earliest start of each controller's next frame, [`NEVER`] if it has none: what the controllers
    /// say, kept in one place because every start of frame asks everybody.
    ready: Vec<u64>,
    /// CAN tools: they keep their queue when error passive and refill the mailbox by themselves.
    is_tool: Vec<bool>,
    on_wire: Option<OnWire>,
    /// Who sends the frame on the wire; several if they sent the same bits in the arbitration field.
    transmitters: Vec<Station>,
    /// From here on a frame may start.
    free_at: u64,
    /// Next start of frame while the bus is free.
    next_start: u64,
    /// Next end of an attempt of an unplugged controller or of a bus-off recovery.
    next_special: u64,
    disturbance: Disturbance,
    /// CANH and CANL touch: nothing gets through.
    pub(crate) shorted: bool,
    random: Random,
    load: LoadMeter,
    pub(crate) frames: u64,
    pub(crate) error_frames: u64,
    /// Receptions lost behind good frames, of everybody.
    pub(crate) lost: u64,
}

impl Bus {
    pub(crate) fn new(bit_rate: u32, disturbance: Disturbance, random: Random) -> Self {
        Self {
            bit: 1_000_000_000 / u64::from(bit_rate.clamp(1, 1_000_000_000)),
            controllers: Vec::new(),
            members: Vec::new(),
            ready: Vec::new(),
            is_tool: Vec::new(),
            on_wire: None,
            transmitters: Vec::new(),
            free_at: 0,
            next_start: NEVER,
            next_special: NEVER,
            disturbance,
            shorted: false,
            random,
            load: LoadMeter::default(),
            frames: 0,
            error_frames: 0,
            lost: 0,
        }
    }

    /// Plugs in one more controller.
    pub(crate) fn attach(&mut self, is_tool: bool) -> Station {
        let station = self.controllers.len();
        self.controllers.push(Controller::new());
        self.ready.push(NEVER);
        self.is_tool.push(is_tool);
        self.members.push(station);
        station
    }

    /// Takes a controller away for good.
    pub(crate) fn detach(&mut self, station: Station, now: u64) {
        self.set_running(station, false, now);
        self.members.retain(|member| *member != station);
    }

    pub(crate) fn controller(&self, station: Station) -> &Controller {
        &self.controllers[station]
    }

    /// Controllers that have not left.
    pub(crate) fn members(&self) -> &[Station] {
        &self.members
    }

    /// Bus load in percent during the last 100 ms.
    pub(crate) fn load_percent(&self, now: u64) -> f64 {
        self.load.clone().percent(now)
    }

    /// Powers a controller on or off. Off: whatever it sends is cut, its counters are lost.
    pub(crate) fn set_running(&mut self, station: Station, running: bool, now: u64) {
        if self.controllers[station].running == running {
            return;
        }
        self.cut(station);
        self.controllers[station].running = running;
        self.controllers[station].reset();
        self.plan(now);
    }

    /// Plugs the wires of a controller in or out. What it wants to send stays in its mailbox.
    pub(crate) fn set_connected(&mut self, station: Station, connected: bool, now: u64) {
        if self.controllers[station].connected == connected {
            return;
        }
        self.cut(station);
        let controller = &mut self.controllers[station];
        controller.connected = connected;
        controller.alone_until = NEVER;
        self.plan(now);
    }

    /// A station that leaves in the middle of its own frame leaves a broken frame behind.
    fn cut(&mut self, station: Station) {
        if let Some(on_wire) = &mut self.on_wire
            && self.transmitters.contains(&station)
        {
            self.transmitters.retain(|other| *other != station);
            if self.transmitters.is_empty() {
                on_wire.fate = Fate::Destroyed;
            }
        }
    }

    /// True if the mailbox of a running controller is empty.
    pub(crate) fn mailbox_free(&self, station: Station) -> bool {
        let controller = &self.controllers[station];
        controller.running && controller.mail.is_none()
    }

    /// Puts a frame into the empty mailbox. `attempts`: how often it may be destroyed by an error frame
    /// (a missing acknowledge does not count), `None` = tried until it is sent.
    pub(crate) fn load_mailbox(
        &mut self,
        station: Station,
        frame: Frame,
        attempts: Option<u8>,
        now: u64,
    ) {
        let delay = match self.disturbance.delay {
            0 => 0,
            longest => self.random.below(longest + 1),
        };
        let controller = &mut self.controllers[station];
        controller.mail = Some(Mail {
            frame,
            shape: Shape::of(&frame),
            attempts: attempts.map(|count| count.max(1)),
            ready_at: now + delay,
        });
        if controller.listens() {
            let ready = controller.ready_at();
            self.ready[station] = ready;
            if self.on_wire.is_none() {
                self.next_start = self.next_start.min(ready.max(self.free_at));
            }
        } else {
            self.plan(now);
        }
    }

    /// Queues a frame of a CAN tool.
    pub(crate) fn enqueue(&mut self, station: Station, frame: Frame, now: u64) {
        self.controllers[station].queue.push_back(frame);
        self.refill(station, now);
    }

    /// Frames of a CAN tool that have not been sent.
    pub(crate) fn pending(&self, station: Station) -> usize {
        let controller = &self.controllers[station];
        controller.queue.len() + usize::from(controller.mail.is_some())
    }

    fn refill(&mut self, station: Station, now: u64) {
        if self.mailbox_free(station)
            && let Some(frame) = self.controllers[station].queue.pop_front()
        {
            self.load_mailbox(station, frame, None, now);
        }
    }

    /// Time of the next event in ns, never before the last one; [`NEVER`] if the bus is at rest.
    pub(crate) fn next_event(&self) -> u64 {
        let main = match &self.on_wire {
            Some(on_wire) => on_wire.end,
            None => self.next_start,
        };
        main.min(self.next_special)
    }

    /// Handles everything that is due at `now`, which must not lie beyond [`Bus::next_event`], except
    /// the start of a frame: see [`Bus::start`].
    pub(crate) fn advance_to(&mut self, now: u64, outcome: &mut Outcome) {
        outcome.clear();
        if self.on_wire.is_some_and(|on_wire| on_wire.end <= now) {
            self.finish(now, outcome);
        }
        if self.next_special <= now {
            self.handle_special(now, outcome);
        }
    }

    /// True if a frame starts at `now`.
    pub(crate) fn starts_at(&self, now: u64) -> bool {
        self.on_wire.is_none() && self.next_start <= now
    }

    /// Arbitration: among everybody who is ready at `now`, the lowest arbitration field wins. The others
    /// wait for the next chance; losing is no failed attempt.
    pub(crate) fn start(&mut self, now: u64) {
        self.count_idle(now);
        let mut best = u32::MAX;
        self.transmitters.clear();
        for &station in &self.members {
            if self.ready[station] > now {
                continue;
            }
            let Some(mail) = &self.controllers[station].mail else {
                continue;
            };
            if mail.shape.key < best {
                best = mail.shape.key;
                self.transmitters.clear();
            }
            if mail.shape.key == best {
                self.transmitters.push(station);
            }
        }
        self.put_on_wire(now);
        if self.next_special != NEVER {
            self.plan(now);
        }
    }

    /// Draws the fate of the frame that won.
    fn put_on_wire(&mut self, now: u64) {
        let Some(mail) = self
            .transmitters
            .first()
            .and_then(|station| self.controllers[*station].mail)
        else {
            return;
        };
        let stuffed = mail.shape.stuffed;
        let (fate, length) = if let Some(position) = self.collision() {
            (Fate::Destroyed, position + ERROR_FLAGS + ERROR_DELIMITER)
        } else if self.shorted || self.random.chance(self.disturbance.corruption) {
            let position = 1 + self.random.below(stuffed);
            (Fate::Destroyed, position + ERROR_FLAGS + ERROR_DELIMITER)
        } else if !self.is_acknowledged() {
            let head = stuffed + UP_TO_ACK;
            (
                Fate::NotAcknowledged,
                head + ERROR_FLAG_ALONE + ERROR_DELIMITER,
            )
        } else {
            (Fate::Delivered, bits::frame_bits(mail.shape))
        };
        self.on_wire = Some(OnWire {
            frame: mail.frame,
            fate,
            start: now,
            end: now + length * self.bit,
        });
        self.next_start = NEVER;
    }

    /// If several controllers won with frames that differ: bits until the first that differs.
    fn collision(&self) -> Option<u64> {
        let mut frames = self
            .transmitters
            .iter()
            .filter_map(|station| self.controllers[*station].mail)
            .map(|mail| mail.frame);
        let first = frames.next()?;
        frames
            .filter_map(|other| Bits::of(&first).stuffed_until_difference(Bits::of(&other)))
            .min()
    }

    fn is_acknowledged(&self) -> bool {
        self.members.iter().any(|station| {
            self.controllers[*station].listens() && !self.transmitters.contains(station)
        })
    }

    /// End of the frame or error frame on the wire.
    fn finish(&mut self, now: u64, outcome: &mut Outcome) {
        let Some(on_wire) = self.on_wire.take() else {
            return;
        };
        self.free_at = now + INTERMISSION * self.bit;
        self.load.add(on_wire.start, self.free_at);
        let transmitters = std::mem::take(&mut self.transmitters);
        match on_wire.fate {
            Fate::Delivered => self.deliver(&on_wire, &transmitters, outcome),
            Fate::NotAcknowledged => {
                self.error_frames += 1;
                for &station in &transmitters {
                    self.miss_acknowledge(station, outcome);
                }
            }
            Fate::Destroyed => self.destroy(&transmitters, outcome),
        }
        for &station in &transmitters {
            if self.controllers[station].state == ErrorState::Passive {
                self.controllers[station].suspended_until =
                    self.free_at + SUSPEND_TRANSMISSION * self.bit;
            }
        }
        for &station in &transmitters {
            if self.is_tool[station] {
                self.refill(station, now);
            }
        }
        self.transmitters = transmitters;
        if on_wire.fate == Fate::Delivered && self.next_special == NEVER {
            for &station in &self.transmitters {
                self.ready[station] = self.controllers[station].ready_at();
            }
            self.plan_start(now);
        } else {
            // ACK or error delimiter, end of frame and intermission are 11 recessive bits.
            self.count_recessive(1);
            self.plan(now);
        }
    }

    fn deliver(&mut self, on_wire: &OnWire, transmitters: &[Station], outcome: &mut Outcome) {
        self.frames += 1;
        for &station in transmitters {
            let controller = &mut self.controllers[station];
            controller.mail = None;
            controller.count_sent();
            outcome.ended.push((station, true));
        }
        for &station in &self.members {
            let controller = &mut self.controllers[station];
            if !controller.listens() || transmitters.contains(&station) {
                continue;
            }
            // The bus saw a good frame; the loss happens behind the controller (an overrun).
            if self.random.chance(self.disturbance.loss) {
                controller.lost += 1;
                self.lost += 1;
                continue;
            }
            controller.count_received();
            outcome.receivers.push(station);
        }
        if let Some(first) = transmitters.first() {
            outcome.delivered = Some((on_wire.frame, *first));
        }
    }

    /// Finds the next start of frame.
    fn plan_start(&mut self, now: u64) {
        self.next_start = NEVER;
        if self.on_wire.is_some() {
            return;
        }
        let ready = self.members.iter().map(|station| self.ready[*station]);
        if let Some(first) = ready.min()
            && first != NEVER
        {
            self.next_start = first.max(self.free_at).max(now);
        }
    }

    /// Asks every controller anew and finds the next start of frame and the next special event. While
    /// somebody is bus-off or unplugged with a frame to send, the latter is never [`NEVER`].
    fn plan(&mut self, now: u64) {
        let bit = self.bit;
        self.next_special = NEVER;
        for &station in &self.members {
            let controller = &mut self.controllers[station];
            self.ready[station] = controller.ready_at();
            if controller.state == ErrorState::BusOff && controller.running {
                let wait = u64::from(controller.recovery_left) * RECESSIVE_SEQUENCE * bit;
                let idle_from = match &self.on_wire {
                    Some(on_wire) => on_wire.end,
                    None => self.free_at,
                };
                self.next_special = self.next_special.min((idle_from + wait).max(now));
            }
            if controller.running && !controller.connected {
                if controller.alone_until == NEVER
                    && let Some(mail) = &controller.mail
                {
                    controller.alone_until = mail.ready_at.max(now) + alone_bits(mail.shape) * bit;
                }
                self.next_special = self.next_special.min(controller.alone_until);
            }
        }
        self.plan_start(now);
    }
}

/// Bits from one attempt of a lonely controller to its next one.
fn alone_bits(shape: Shape) -> u64 {
    shape.stuffed + UP_TO_ACK + ERROR_FLAG_ALONE + ERROR_DELIMITER + INTERMISSION
}
