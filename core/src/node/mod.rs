//! The ring that joins the layers of one controller: frames in, commands and settings out, frames out.
//!
//! A node runs in thread mode. It holds the management channel, the driving dialect, the parameters and
//! the command that the control tick reads; the engine itself runs elsewhere and is known only by its
//! [`Snapshot`].

mod keeping;
mod parameters;
#[cfg(test)]
mod tests;
mod types;

pub use types::{
    Action, Attempts, Counters, Handover, NodeConfig, PRODUCT_DMC60C, Tag, Transmission, TxOutcome,
};

use keeping::Keeping;

use crate::dialect::schedule::earlier;
use crate::dialect::{AnyDialect, Decoded, Device, DialectKind, Intent, Outgoing, View};
use crate::engine::command::{Command, DriveOpts, PositionOf, SetAccumulator, Setpoint};
use crate::engine::settings::{Settings, Sticky};
use crate::engine::snapshot::{Actuation, Fault, Snapshot};
use crate::frame::Frame;
use crate::led::{self, BUS_ERROR_TIME, IDENTIFY_TIME, Indication, Leds, Style};
use crate::management::vendor::{CommandCode, PinTest, TestPin};
use crate::management::wire::{FirmwareVersions, ImageType};
use crate::management::{self, Answer, ENUMERATION_ATTEMPTS, Management, SessionIds};
use crate::params::table::ParameterId;
use crate::params::{FaultLog, SettingsState, Stored, compile};
use crate::reset::HEALTHY_AFTER;
use crate::time::Instant;

/// Attempts for a periodic frame: a destroyed one is not repeated, see [`Node::poll_tx`].
const STATUS_ATTEMPTS: u8 = 1;

/// Whether the image has answered a host, which ends its trial (docs/updates.md).
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Confirmation {
    Silent,
    Answered,
    Told,
}

impl Confirmation {
    /// An answer has been sent and acknowledged.
    const fn answered(&mut self) {
        if matches!(self, Self::Silent) {
            *self = Self::Answered;
        }
    }

    /// True once, after the first answer.
    fn take(&mut self) -> bool {
        let due = *self == Self::Answered;
        if due {
            *self = Self::Told;
        }
        due
    }
}

/// One controller, apart from its engine and its hardware.
#[derive(Clone, Debug)]
pub struct Node {
    config: NodeConfig,
    management: Management,
    dialect: AnyDialect,
    stored: Stored,
    settings: Settings,
    command: Command,
    faults: FaultLog,
    counters: Counters,
    keeping: Keeping,
    reset: Option<Handover>,
    pin_test: Option<PinTest>,
    identify_since: Option<Instant>,
    /// When the error frame came that the LEDs show.
    bus_error_since: Option<Instant>,
    sessions: SessionIds,
    confirm: Confirmation,
    /// When the image has run long enough to be called healthy, unless it answers before.
    healthy_at: Option<Instant>,
    healthy: bool,
}

impl Node {
    /// A node that starts at `now`. `stored` is what was kept last, or nothing on a blank board.
    #[must_use]
    pub fn new(now: Instant, config: &NodeConfig, stored: Option<&Stored>) -> Self {
        let mut stored = match stored {
            Some(stored) => Stored {
                params: stored.params.persistent(),
                ..stored.clone()
            },
            None => Stored::default(),
        };
        let kind = DialectKind::from_code(stored.params.get(ParameterId::Dialect))
            .unwrap_or(DialectKind::Dmc60c);
        let settings = compile::settings(&stored.params, &config.board, &kind.policy());
        let identity = kind.identity();
        stored.number = identity.number(stored.number);
        let mut node = Self {
            config: *config,
            management: Management::new(config.image, identity),
            dialect: AnyDialect::new(kind),
            faults: FaultLog::new(&stored),
            stored,
            settings,
            command: Command {
                setpoint: Setpoint::Pulse,
                ..Command::default()
            },
            counters: Counters::default(),
            keeping: Keeping::new(kind.save_rule(), config.newer_settings),
            reset: None,
            pin_test: None,
            identify_since: None,
            bus_error_since: None,
            sessions: SessionIds::new(config.seed),
            confirm: Confirmation::Silent,
            healthy_at: Some(now + HEALTHY_AFTER),
            healthy: false,
        };
        if let Some(handover) = config.handover {
            node.resume(now, handover);
        }
        node
    }

    /// Goes on in the session that asked for the restart, and acknowledges it without waiting for the bus.
    fn resume(&mut self, now: Instant, handover: Handover) {
        self.connect(now, handover.session);
        match self.config.image {
            ImageType::Application => self.management.finish(CommandCode::AcknowledgeReset),
            _ if handover.stay_in_bootloader => self.management.finish(CommandCode::InBootloader),
            // A reset that ends in the bootloader because there is no application is not answered.
            _ => {}
        }
    }

    /// Every frame that the controller receives, whomever it is for: the first one shows that there is a
    /// bus.
    pub fn on_frame(&mut self, now: Instant, frame: &Frame, snapshot: &Snapshot) {
        self.counters.received = self.counters.received.wrapping_add(1);
        if self.management.session().is_none() {
            let session = self.sessions.draw(now);
            self.connect(now, session);
        }
        match self.management.decode(self.stored.number, frame) {
            management::Decoded::NotMine => self.drive_frame(now, frame, snapshot),
            management::Decoded::Done => {}
            management::Decoded::Request(request) => self.execute(now, request, snapshot),
            management::Decoded::Bad(bad) => self.counters.count_bad(bad),
        }
    }

    /// A frame that is not the management channel's.
    fn drive_frame(&mut self, now: Instant, frame: &Frame, snapshot: &Snapshot) {
        let number = self.stored.number;
        let decoded = match self.config.image {
            ImageType::Application => self.dialect.decode(number, frame),
            _ => Decoded::Ignored,
        };
        match decoded {
            Decoded::Ignored => self.counters.ignored = self.counters.ignored.wrapping_add(1),
            Decoded::Done => {}
            Decoded::Intent(intent) => self.obey(now, intent),
            Decoded::Request(query) => {
                let outcome = self.parameter(now, query, snapshot);
                self.dialect.answer(outcome);
            }
            Decoded::Bad(bad) => self.counters.count_bad(bad),
        }
    }

    fn obey(&mut self, now: Instant, intent: Intent) {
        match intent {
            Intent::Drive(setpoint, opts) => {
                self.drive(setpoint, opts);
                self.permit(true);
            }
            Intent::Prepare(setpoint, opts) => self.drive(setpoint, opts),
            Intent::Enable(permitted) => self.permit(permitted),
            Intent::MasterReport(duty) => {
                let master = &mut self.revise().master;
                master.duty = duty;
                master.sequence = master.sequence.wrapping_add(1);
            }
            Intent::SetPosition(of, counts) => self.set_position(of, counts),
            Intent::SetAccumulator(value) => {
                let order = &mut self.revise().set_accumulator;
                let generation = order.generation.wrapping_add(1);
                *order = SetAccumulator { value, generation };
            }
            Intent::Clear { position, sticky } => {
                if position {
                    self.set_position(PositionOf::Selected, 0);
                }
                if sticky {
                    self.clear_sticky(now);
                }
            }
        }
    }

    fn permit(&mut self, permitted: bool) {
        let enable = &mut self.revise().enable;
        enable.sequence = enable.sequence.wrapping_add(1);
        enable.withdrawn = !permitted;
    }

    fn drive(&mut self, setpoint: Setpoint, opts: DriveOpts) {
        let command = self.revise();
        command.setpoint = setpoint;
        command.opts = opts;
        command.sequence = command.sequence.wrapping_add(1);
    }

    /// The command, which is about to change: the only way to it.
    fn revise(&mut self) -> &mut Command {
        self.command.revision = self.command.revision.wrapping_add(1);
        &mut self.command
    }

    /// The controller has become error passive or bus-off and has flushed its transmit queue.
    ///
    /// Output off, session and transfers void, RC-PWM input in force until the next frame is received.
    pub fn on_bus_lost(&mut self, now: Instant) {
        if self.management.session().is_none() {
            return;
        }
        self.management.stop();
        self.dialect.stop();
        self.drive(Setpoint::Pulse, DriveOpts::default());
        self.counters.bus_losses = self.counters.bus_losses.wrapping_add(1);
        self.faults.record(Fault::Communication);
        self.faults_changed(now);
    }

    fn connect(&mut self, now: Instant, session: u16) {
        self.management.start(session);
        self.dialect.start(now, &self.stored.params);
        self.drive(Setpoint::Off, DriveOpts::default());
    }

    fn execute(&mut self, now: Instant, request: management::Request, snapshot: &Snapshot) {
        use management::Request as R;
        match request {
            R::Enumerate => self.management.enumerate(now, self.stored.number),
            R::Parameter(query) => {
                let outcome = self.parameter(now, query, snapshot);
                if !self.management.answer_parameter(outcome) {
                    self.counters.answers_lost = self.counters.answers_lost.wrapping_add(1);
                }
            }
            R::SetNumber(number) => {
                if !self.refuses_changes() {
                    self.stored.number = number;
                    self.identity_changed();
                }
            }
            R::SetDescriptor(which) => {
                if !self.refuses_changes() {
                    let text = self.management.text();
                    self.stored.descriptors.set(which, text);
                    self.identity_changed();
                }
            }
            R::FactoryReset { all } => self.factory_reset(all, snapshot),
            R::Identify => {
                self.identify_since = Some(now);
                self.management.finish(CommandCode::NoError);
            }
            R::GetDescriptors => self.management.send_descriptors(&self.stored.descriptors),
            R::GetVersions => self.management.send_versions(self.versions()),
            R::GetSequence => self.management.send_sequence(self.stored.sequence),
            R::EnterBootloader => self.restart(true),
            R::SoftReset => self.restart(false),
            // The slots are the bootloader's, and a page is written there.
            R::WritePage { .. }
            | R::Data(_)
            | R::GetPageCrcs
            | R::RestoreFallback
            | R::GetBootStatus
            | R::InstallKey(_) => self.management.finish(CommandCode::NotSupported),
            R::PinTest(test) => {
                // The test drives the limit and encoder inputs, which a turning motor needs.
                if matches!(snapshot.actuation, Actuation::Drive(_)) {
                    self.management.finish(CommandCode::NotSupported);
                } else {
                    self.pin_test = Some(test);
                }
            }
        }
    }

    fn restart(&mut self, stay_in_bootloader: bool) {
        if let Some(session) = self.management.session() {
            self.drive(Setpoint::Off, DriveOpts::default());
            // A restart that was asked for loses no settings.
            self.keeping.flush();
            self.reset = Some(Handover {
                session,
                stay_in_bootloader,
            });
        }
    }

    fn faults_changed(&mut self, now: Instant) {
        let (sticky, counts) = (self.faults.sticky(), self.faults.stored_counts());
        if (sticky, counts) != (self.stored.sticky, self.stored.fault_counts) {
            self.stored.sticky = sticky;
            self.stored.fault_counts = counts;
            self.keeping.changed(now);
        }
    }

    /// Once per control tick, after the engine: takes over its faults.
    pub fn poll(&mut self, now: Instant, snapshot: &Snapshot) {
        if self.faults.observe(snapshot) {
            self.faults_changed(now);
        }
        if self.settings.policy.sticky == Sticky::Presence {
            self.observe_presence(now, snapshot);
        }
        if self
            .identify_since
            .is_some_and(|since| now.since(since) >= IDENTIFY_TIME)
        {
            self.identify_since = None;
        }
        if self.healthy_at.is_some_and(|at| now >= at) {
            self.healthy_at = None;
            self.healthy = true;
        }
        self.poll_keeping(now, snapshot);
    }

    /// The next frame to send. To be called whenever the transmit mailbox is free: after
    /// [`Node::poll`], after [`Node::on_frame`] and when a transmission has ended.
    pub fn poll_tx(&mut self, now: Instant, snapshot: &Snapshot) -> Option<Transmission> {
        let number = self.stored.number;
        let versions = self.versions();
        if let Some((frame, answer)) = self.management.encode(now, number, versions) {
            let attempts = match answer {
                Answer::Enumerate0 => Attempts::AtMost(ENUMERATION_ATTEMPTS),
                Answer::Other | Answer::Dialect => Attempts::UntilSent,
            };
            return Some(Transmission {
                frame,
                tag: Tag(answer),
                attempts,
            });
        }
        if self.config.image != ImageType::Application {
            return None;
        }
        let view = View {
            number,
            params: &self.stored.params,
            settings: &self.settings,
            snapshot,
            device: self.device(),
        };
        let (frame, attempts) = match self.dialect.encode(now, &view)? {
            Outgoing::Answer(frame) => (frame, Attempts::UntilSent),
            // Two devices of one number send their status under one identifier. Once they start at the
            // same moment with different data they destroy each other, and would do so again at every
            // repetition until both are error passive. The next period brings a new frame anyway.
            Outgoing::Status(frame) => (frame, Attempts::AtMost(STATUS_ATTEMPTS)),
        };
        Some(Transmission {
            frame,
            tag: Tag(Answer::Dialect),
            attempts,
        })
    }

    /// A transmission has ended.
    pub fn on_transmitted(&mut self, now: Instant, tag: Tag, outcome: TxOutcome) {
        if outcome == TxOutcome::Failed {
            self.counters.given_up = self.counters.given_up.wrapping_add(1);
        }
        match (tag.0, outcome) {
            (Answer::Enumerate0, TxOutcome::Sent) => self.management.enumerate_0_sent(),
            (Answer::Enumerate0, TxOutcome::Failed) => {
                let session = self.sessions.draw(now);
                self.management.enumerate_0_destroyed(now, session);
            }
            (Answer::Other, TxOutcome::Sent) => self.confirm.answered(),
            (Answer::Other | Answer::Dialect, _) => {}
        }
    }

    /// How many frames the platform has lost since power-on before the node could see them.
    pub const fn set_dropped(&mut self, frames: u32) {
        self.counters.dropped = frames;
    }

    /// How many error frames the CAN controller has seen since it was initialised; wraps. A new one makes the
    /// LEDs flash, if the dialect's style has that; during a flash none begins anew.
    pub fn set_bus_errors(&mut self, now: Instant, errors: u32) {
        let is_new = errors != self.counters.bus_errors;
        self.counters.bus_errors = errors;
        let is_over = |since: &Instant| now.since(*since) >= BUS_ERROR_TIME;
        if self.bus_error_since.as_ref().is_some_and(is_over) {
            self.bus_error_since = None;
        }
        if is_new && self.bus_error_since.is_none() {
            self.bus_error_since = Some(now);
        }
    }

    /// When [`Node::poll_tx`] or [`Node::poll`] have something to do next, apart from new frames and
    /// faults.
    #[must_use]
    pub fn next_deadline(&self) -> Option<Instant> {
        let save = self.keeping.due();
        earlier(
            self.management.next_deadline(),
            earlier(self.dialect.next_deadline(), save),
        )
    }

    /// What the platform has to do, one at a time, the settings before a restart.
    pub fn take_action(&mut self) -> Option<Action> {
        if self.keeping.begin() {
            Some(Action::Save)
        } else if let Some(test) = self.pin_test.take() {
            Some(Action::PinTest(test))
        } else if self.confirm.take() {
            self.healthy_at = None;
            Some(Action::Confirm)
        } else if core::mem::take(&mut self.healthy) {
            Some(Action::Healthy)
        } else if self.keeping.is_idle() {
            self.reset.take().map(Action::Reset)
        } else {
            None
        }
    }

    /// A pin test has ended; `failed` names the last pin that failed it.
    pub fn pin_test_done(&mut self, failed: Option<TestPin>) {
        self.management.finish_pin_test(failed);
    }

    /// The brake/coast button has been pressed: the stored setting is toggled.
    pub fn press_button(&mut self, now: Instant) {
        let brakes = self.stored.params.flag(ParameterId::BrakeAtNeutral);
        if self
            .stored
            .params
            .set(ParameterId::BrakeAtNeutral, u32::from(!brakes))
            == Ok(true)
        {
            self.parameter_changed(now, ParameterId::BrakeAtNeutral);
        }
    }

    /// What the LEDs show.
    #[must_use]
    pub fn leds(&self, now: Instant, snapshot: &Snapshot) -> Leds {
        let style = self.dialect.kind().led_style();
        led::leds(now, style, self.indication(now, snapshot), snapshot.neutral)
    }

    /// What the LEDs tell.
    #[must_use]
    pub fn indication(&self, now: Instant, snapshot: &Snapshot) -> Indication {
        match self.identify_since {
            Some(since) if now.since(since) < IDENTIFY_TIME => {
                Indication::Identify(now.since(since))
            }
            _ if self.config.image != ImageType::Application => Indication::Bootloader,
            _ => {
                let stopping = self.settings.policy.stopping;
                let shown = led::indication(self.session().is_some(), snapshot, stopping);
                let flashes = self.dialect.kind().led_style() == Style::Blinking
                    && self.bus_error_since.is_some();
                match shown {
                    Indication::Fault(_) | Indication::NoLink => shown,
                    _ if flashes => Indication::BusError,
                    _ => shown,
                }
            }
        }
    }

    fn device(&self) -> Device {
        Device {
            sticky: self.faults.sticky(),
            version: self.config.application_version,
            reset_count: self.config.reset.count.min(u32::from(u16::MAX)) as u16,
            reset_flags: self.config.reset.cause as u16,
            unsaved: self.settings_state() != SettingsState::Saved,
        }
    }

    fn versions(&self) -> FirmwareVersions {
        FirmwareVersions {
            image: self.config.image,
            application: self.config.application_version,
            bootloader: self.config.bootloader_version,
        }
    }

    /// What the next control tick is to do.
    #[must_use]
    pub const fn command(&self) -> &Command {
        &self.command
    }

    /// What the next control tick is to obey.
    #[must_use]
    pub const fn settings(&self) -> &Settings {
        &self.settings
    }

    /// Frames by what became of them.
    #[must_use]
    pub const fn counters(&self) -> &Counters {
        &self.counters
    }

    /// Device number, 0 = none assigned.
    #[must_use]
    pub const fn number(&self) -> u8 {
        self.stored.number
    }

    /// Session id; none while no bus is seen.
    #[must_use]
    pub const fn session(&self) -> Option<u16> {
        self.management.session()
    }

    /// The dialect that drives.
    #[must_use]
    pub const fn dialect(&self) -> DialectKind {
        self.dialect.kind()
    }

    /// The image that runs.
    #[must_use]
    pub const fn image(&self) -> ImageType {
        self.config.image
    }

    /// Sticky faults and counts.
    #[must_use]
    pub const fn faults(&self) -> &FaultLog {
        &self.faults
    }
}
