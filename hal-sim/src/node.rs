//! One simulated controller: the real core on a virtual board.

use windlass_core::boot::slots::Start as BootStart;
use windlass_core::dialect::DialectKind;
use windlass_core::engine::Engine;
use windlass_core::engine::snapshot::{Actuation, DriveState, Snapshot};
use windlass_core::frame::Frame;
use windlass_core::management::wire::ImageType;
use windlass_core::node::{Action, Handover, Node, NodeConfig, Tag, Transmission, TxOutcome};
use windlass_core::params::Stored;
use windlass_core::params::table::ParameterId;
use windlass_core::reset::{Crashes, Reset, ResetCause};
use windlass_core::time::Instant;

use crate::bus::Station;
use crate::controller::{Controller, ErrorState};
use crate::plant::PlantConfig;
use crate::random::Random;
use crate::replay::{ActuationHash, TickRecord};
use crate::rig::Rig;
use crate::spec::NodeSpec;
use loading::Loading;
pub use memory::Chip;
use memory::{BoardMemory, Outcome, Start, Started};

mod loading;
mod memory;
mod observe;
mod poke;

/// Longest self-check before the world begins; a board whose self-check fails is left in it.
const WARM_UP_TICKS: u32 = 200;
/// Ticks from power-on or restart to the first tick of the image: 5 ms.
const BOOT_TICKS: u32 = 10;
/// Ticks that the watchdog waits for an application that hangs: 20 ms, as on the boards.
const WATCHDOG_TICKS: u32 = 40;

/// What the board is doing.
#[derive(Debug)]
enum Power {
    Off,
    Booting {
        ticks: u32,
        handover: Option<Handover>,
    },
    /// The bootloader decides, and does what has to be done before.
    Starting,
    /// The application runs.
    On(Box<Node>),
    /// The bootloader stays.
    Loading(Loading),
}

/// The part of the CAN controller's state that [`SimNode::truth`] shows.
#[derive(Clone, Copy, Debug, Default)]
struct ControllerView {
    tec: u16,
    rec: u16,
    error_state: ErrorState,
    bus_off_count: u32,
}

/// What the node wants of its CAN controller.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub(crate) struct Wiring {
    /// The controller is to be reset before anything else.
    pub(crate) reset: bool,
    /// Powered and initialised.
    pub(crate) running: bool,
    /// Wires plugged in.
    pub(crate) connected: bool,
}

/// One controller of a [`World`](crate::World) with everything that is connected to it.
#[derive(Debug)]
pub struct SimNode {
    spec: NodeSpec,
    pub(crate) station: Station,
    power: Power,
    engine: Engine,
    fresh: bool,
    snapshot: Snapshot,
    actuation: Actuation,
    rig: Rig,
    image: ImageType,
    /// Why the board runs.
    reset: Reset,
    /// Failures in a row, in RAM that a reset leaves alone.
    crashes: Crashes,
    memory: Box<dyn BoardMemory>,
    /// The application hangs, as long as it has since the watchdog was fed last.
    hangs: bool,
    hung_ticks: u32,
    /// Dialect and number that were in force last.
    identity: (DialectKind, u8),
    random: Random,
    /// What the image that starts is given.
    handover: Option<Handover>,
    seed: u32,
    /// Tag of the frame in the transmit mailbox.
    in_mailbox: Option<Tag>,
    wiring: Wiring,
    wiring_changed: bool,
    view: ControllerView,
    now: Instant,
    hash: ActuationHash,
    records: Option<Vec<TickRecord>>,
    /// The ticks of the self-check before the world saw the node, until its first tick in the world.
    warm_up: Vec<TickRecord>,
}

impl SimNode {
    /// A node that has been running for a while when the world first sees it.
    pub(crate) fn new(
        spec: NodeSpec,
        (plant, chip): (&PlantConfig, Chip),
        station: Station,
        (seed, index): (u64, usize),
        now: Instant,
    ) -> Self {
        let stream = 0x1000 + 2 * index as u64;
        let mut stored = Stored {
            number: spec.number,
            ..Stored::default()
        };
        // The default is the same dialect if the table should refuse the value.
        let _ = stored.params.set(ParameterId::Dialect, spec.dialect.code());
        let mut node = Self {
            spec,
            station,
            power: Power::Off,
            engine: Engine::new(),
            fresh: true,
            snapshot: Snapshot::default(),
            actuation: Actuation::Off,
            rig: Rig::with_noise(plant, Random::new(seed, stream)),
            image: ImageType::Application,
            reset: Reset::POWER_ON,
            crashes: Crashes::NONE,
            memory: memory::new(chip, Random::new(seed, stream + 1).next(), &stored),
            hangs: false,
            hung_ticks: 0,
            identity: (spec.dialect, spec.number),
            random: Random::new(seed, stream + 1),
            handover: None,
            seed: 0,
            in_mailbox: None,
            wiring: Wiring {
                reset: false,
                running: true,
                connected: true,
            },
            wiring_changed: false,
            view: ControllerView::default(),
            now,
            hash: ActuationHash::new(),
            records: None,
            warm_up: Vec::new(),
        };
        node.boot(now, None);
        node.warm_up(now);
        node
    }

    /// The board was switched on before the world begins: its self-check is over.
    fn warm_up(&mut self, now: Instant) {
        self.records = Some(Vec::new());
        for _ in 0..WARM_UP_TICKS {
            if self.snapshot.state == DriveState::SelfCheck {
                self.run(now);
            }
        }
        self.warm_up = self.records.take().unwrap_or_default();
    }

    /// Offset of the board's tick from that of the first board in µs: boards have clocks of their own.
    pub(crate) fn draw_phase(&mut self) -> u64 {
        1 + self.random.below(499)
    }

    /// The processor starts.
    fn boot(&mut self, now: Instant, handover: Option<Handover>) {
        self.handover = handover;
        self.power = Power::Starting;
        self.crashes = self.crashes.after(self.reset.cause);
        let start = Start {
            boot: BootStart {
                cause: self.reset.cause,
                handover,
                crashes: self.crashes,
            },
            seed: self.random.next() as u32,
        };
        self.seed = start.seed;
        self.memory.start(now, start);
        self.poll_memory(now);
    }

    /// The bootloader has decided.
    fn enter(&mut self, now: Instant, started: Started) {
        self.engine = Engine::new();
        self.fresh = true;
        self.snapshot = Snapshot::default();
        self.in_mailbox = None;
        self.hung_ticks = 0;
        match started {
            Started::Application {
                header,
                crash,
                stored,
                newer_settings,
            } => {
                self.image = ImageType::Application;
                let config = NodeConfig {
                    application_version: header.identity.version,
                    handover: self.handover,
                    newer_settings,
                    reset: self.reset,
                    crash,
                    ..NodeConfig::dmc60c(self.seed)
                };
                self.power = Power::On(Box::new(Node::new(now, &config, Some(&stored))));
            }
            Started::Loader(loader) => {
                self.image = ImageType::Bootloader;
                self.power = Power::Loading(Loading::new(loader));
            }
        }
        self.rewire();
    }

    /// Takes over what the flash has finished.
    fn poll_memory(&mut self, now: Instant) {
        match (self.memory.poll(now), &mut self.power) {
            (Some(Outcome::Started(started)), _) => self.enter(now, started),
            (Some(Outcome::Saved(result)), Power::On(node)) => node.save_ended(now, result),
            (Some(Outcome::Worked), Power::Loading(loading)) => {
                loading.go_on(now, &mut *self.memory);
                self.act();
            }
            _ => {}
        }
    }

    /// Stops the image; whatever was in the transmit mailbox is gone.
    fn halt(&mut self, power: Power) {
        self.identity = (self.dialect(), self.number());
        self.power = power;
        self.actuation = Actuation::Off;
        self.snapshot = Snapshot::default();
        self.in_mailbox = None;
        self.wiring.reset = true;
        self.rewire();
    }

    fn rewire(&mut self) {
        self.wiring.running = matches!(self.power, Power::On(_) | Power::Loading(_));
        self.wiring_changed = true;
    }

    /// What is to be changed at the CAN controller, once for each change.
    pub(crate) fn take_wiring(&mut self) -> Option<Wiring> {
        if !self.wiring_changed {
            return None;
        }
        let wiring = self.wiring;
        self.wiring.reset = false;
        self.wiring_changed = false;
        Some(wiring)
    }

    /// Takes over what [`SimNode::truth`] shows of the CAN controller.
    pub(crate) fn look_at(&mut self, controller: &Controller) {
        self.view = ControllerView {
            tec: controller.tec,
            rec: controller.rec,
            error_state: controller.state,
            bus_off_count: controller.bus_off_count,
        };
    }

    /// One control tick: the plant moves on to `now` with the last actuation, then the board acts. `errors`
    /// is the CAN controller's count of error frames.
    pub(crate) fn tick(&mut self, now: Instant, errors: u32) {
        self.now = now;
        if let Power::On(node) = &mut self.power
            && !self.hangs
        {
            node.set_bus_errors(now, errors);
        }
        self.warm_up = Vec::new();
        self.rig.advance(self.actuation);
        match &mut self.power {
            Power::Off => {}
            Power::Booting { ticks, handover } => {
                *ticks -= 1;
                if *ticks == 0 {
                    let handover = *handover;
                    self.boot(now, handover);
                }
            }
            Power::On(_) if self.hangs => self.hang(),
            Power::On(_) => self.run(now),
            // The bootloader has no control loop: its bridge stays off.
            Power::Starting | Power::Loading(_) => self.poll_memory(now),
        }
    }

    /// A tick in which the application does nothing; the bridge stays as it is until the watchdog resets.
    fn hang(&mut self) {
        self.hung_ticks += 1;
        if self.hung_ticks >= WATCHDOG_TICKS {
            self.reset = self.reset.again(ResetCause::Watchdog);
            self.halt(Power::Booting {
                ticks: BOOT_TICKS,
                handover: None,
            });
        }
    }

    fn run(&mut self, now: Instant) {
        let sample = self.rig.sample();
        let Power::On(node) = &mut self.power else {
            return;
        };
        {
            let (settings, command) = (node.settings(), node.command());
            if let Some(records) = &mut self.records {
                records.push(TickRecord {
                    fresh: self.fresh,
                    settings: *settings,
                    sample,
                    command: *command,
                });
            }
            self.fresh = false;
            self.snapshot = *self.engine.tick(settings, &sample, command);
            self.actuation = self.snapshot.actuation;
            self.hash.update(&self.snapshot);
        }
        node.poll(now, &self.snapshot);
        self.poll_memory(now);
        self.act();
        if let Power::On(node) = &self.power
            && node.may_erase(now)
        {
            self.memory.erase_ahead(now);
        }
    }

    /// Does what the node asks of its board.
    fn act(&mut self) {
        if let Power::Loading(loading) = &mut self.power
            && let Some(handover) = loading.take_reset()
        {
            self.restart(handover);
            return;
        }
        while let Power::On(node) = &mut self.power
            && let Some(action) = node.take_action()
        {
            self.perform(action);
        }
    }

    /// One action. Apart from [`SimNode::act`] because it is rare and needs a large stack frame.
    #[inline(never)]
    fn perform(&mut self, action: Action) {
        let Power::On(node) = &mut self.power else {
            return;
        };
        match action {
            Action::Save => {
                let may_erase = node.may_erase(self.now);
                self.memory.save(self.now, node.stored(), may_erase);
            }
            Action::PinTest(test) => node.pin_test_done(self.rig.test_pins(test)),
            Action::Confirm => {
                self.crashes = Crashes::NONE;
                self.memory.confirm(self.now);
            }
            Action::Healthy => self.crashes = Crashes::NONE,
            Action::Reset(handover) => self.restart(handover),
        }
    }

    /// A restart that was asked for.
    fn restart(&mut self, handover: Handover) {
        self.reset = self.reset.again(ResetCause::Requested);
        self.halt(Power::Booting {
            ticks: BOOT_TICKS,
            handover: Some(handover),
        });
    }

    /// A frame was received. True if the node may have something to send or do because of it.
    pub(crate) fn on_frame(&mut self, now: Instant, frame: &Frame) -> bool {
        if let Power::Loading(loading) = &mut self.power {
            let matters = loading.on_frame(now, frame, &mut *self.memory);
            self.act();
            return matters;
        }
        let Power::On(node) = &mut self.power else {
            return false;
        };
        if self.hangs {
            return false;
        }
        let ignored = node.counters().ignored;
        node.on_frame(now, frame, &self.snapshot);
        // What is due by time is sent at the next tick anyway, so a frame for somebody else costs no
        // more than this: on a busy bus most frames are.
        if node.counters().ignored != ignored {
            return false;
        }
        self.act();
        true
    }

    /// The frame in the mailbox was sent or given up.
    pub(crate) fn on_transmitted(&mut self, now: Instant, sent: bool) {
        let Some(tag) = self.in_mailbox.take() else {
            return;
        };
        let outcome = if sent {
            TxOutcome::Sent
        } else {
            TxOutcome::Failed
        };
        match &mut self.power {
            Power::On(node) if !self.hangs => {
                node.on_transmitted(now, tag, outcome);
                self.act();
            }
            Power::Loading(loading) => loading.loader.on_transmitted(now, tag, outcome),
            _ => {}
        }
    }

    /// The controller became error passive or bus-off.
    pub(crate) fn on_bus_lost(&mut self, now: Instant) {
        match &mut self.power {
            Power::On(node) => node.on_bus_lost(now),
            Power::Loading(loading) => loading.loader.on_bus_lost(),
            _ => {}
        }
    }

    /// The next frame for the mailbox, which must be empty.
    pub(crate) fn poll_tx(&mut self, now: Instant) -> Option<Transmission> {
        if self.in_mailbox.is_some() {
            return None;
        }
        let transmission = match &mut self.power {
            Power::On(node) if !self.hangs => node.poll_tx(now, &self.snapshot),
            Power::Loading(loading) => loading.poll_tx(now),
            _ => None,
        }?;
        self.in_mailbox = Some(transmission.tag);
        Some(transmission)
    }

    pub(crate) fn actuation_hash(&self) -> u64 {
        self.hash.value()
    }

    /// Starts to keep what goes into every tick, see [`replay`](crate::replay).
    pub fn record_ticks(&mut self) {
        let warm_up = std::mem::take(&mut self.warm_up);
        self.records.get_or_insert(warm_up);
    }

    /// The ticks since recording began or since the last call; none if nothing is recorded.
    pub fn take_ticks(&mut self) -> Vec<TickRecord> {
        self.records
            .as_mut()
            .map(std::mem::take)
            .unwrap_or_default()
    }
}
