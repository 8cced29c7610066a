//! When the drive runs: one state machine with one transition function, and the timeouts that feed it.
//!
//! Faults are not part of it. They keep the output off whatever the state is, and the state goes on
//! following the commands meanwhile, so that the drive resumes as the policy says.

use super::command::{Command, MasterReport, Setpoint};
use super::settings::{Enabling, Policy, Resume};
use super::snapshot::{DriveState, Mode, Pulse, Snapshot};
use crate::time::TICKS_PER_MS;
use crate::units::Duty;

/// What happened to the drive in one tick.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Event {
    /// The self-check ended well.
    Ready,
    /// A command with a non-zero setpoint, or any command where the policy resumes on any.
    Drive,
    /// A driving command with setpoint zero.
    Zero,
    /// A command to switch off.
    Halt,
    /// No command within the policy's time.
    Timeout,
}

/// The state after `event`.
#[must_use]
pub const fn transition(state: DriveState, event: Event) -> DriveState {
    match (state, event) {
        (DriveState::SelfCheck, Event::Ready) => DriveState::Halted,
        (DriveState::SelfCheck, _) => DriveState::SelfCheck,
        (DriveState::Halted | DriveState::Running, Event::Drive) => DriveState::Running,
        (DriveState::Halted | DriveState::Running, Event::Halt | Event::Timeout) => {
            DriveState::Halted
        }
        (DriveState::Halted | DriveState::Running, Event::Zero | Event::Ready) => state,
    }
}

/// Follows the commands: restarts and expires the heartbeat.
#[derive(Clone, Copy, Debug, Default)]
pub struct Liveness {
    sequence: u32,
    /// Ticks until the heartbeat ends, or the first of the times of `separate`; 0 if none runs.
    wait: u16,
    expired: bool,
    /// The command is alive, and so is its permission.
    in_force: bool,
    watched: Watched,
    /// The policy's times.
    timeout_ticks: u16,
    pause_ticks: u16,
    separate: Separate,
}

/// What keeps the command in force.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
enum Watched {
    /// Control frames.
    #[default]
    Heartbeat,
    /// The RC-PWM input.
    Pulse,
    /// Control frames and a permission of its own.
    Permission,
}

/// Follows commands, the permission to drive and pauses, where the permission is separate. The times are those of
/// the latest look at them, which is one at every changed command and whenever one of them ends.
#[derive(Clone, Copy, Debug, Default)]
struct Separate {
    /// Ticks from that look to the next if nothing else happens.
    planned: u16,
    heartbeat: u16,
    enable_sequence: u32,
    permission: u16,
    pause: u32,
    pause_left: u16,
}

impl Separate {
    const fn new() -> Self {
        Self {
            planned: 0,
            heartbeat: 0,
            enable_sequence: 0,
            permission: 0,
            pause: 0,
            pause_left: 0,
        }
    }

    /// Lets ticks pass.
    fn pass(&mut self, ticks: u16) {
        for left in [
            &mut self.heartbeat,
            &mut self.permission,
            &mut self.pause_left,
        ] {
            *left = left.saturating_sub(ticks);
        }
    }

    /// Ticks until the first of the times ends; 0 if none runs.
    fn plan(&mut self) -> u16 {
        // One less each, so that a time that does not run is the longest, and none at all becomes 0 again.
        let [heartbeat, permission, pause] =
            [self.heartbeat, self.permission, self.pause_left].map(|left| left.wrapping_sub(1));
        self.planned = heartbeat.min(permission).min(pause).wrapping_add(1);
        self.planned
    }

    /// True while command and permission are alive, and no pause.
    const fn permits(&self) -> bool {
        self.heartbeat > 0 && self.permission > 0 && self.pause_left == 0
    }
}

impl Liveness {
    /// No command yet.
    #[must_use]
    pub const fn new() -> Self {
        Self {
            sequence: 0,
            wait: 0,
            expired: false,
            in_force: false,
            watched: Watched::Heartbeat,
            timeout_ticks: 0,
            pause_ticks: 0,
            separate: Separate::new(),
        }
    }

    /// A command that has changed, instead of [`Liveness::update`] in this tick; gives what happens to the state, if
    /// anything.
    pub fn obey(&mut self, policy: &Policy, command: &Command, pulse_valid: bool) -> Option<Event> {
        self.timeout_ticks = policy.command_timeout_ticks;
        self.pause_ticks = policy.pause_ticks;
        let before = self.watched;
        self.watched = match (command.setpoint, policy.enabling) {
            (Setpoint::Pulse, _) => Watched::Pulse,
            (_, Enabling::WithCommand) => Watched::Heartbeat,
            (_, Enabling::Separate) => Watched::Permission,
        };
        let passed = self.separate.planned - self.wait.min(self.separate.planned);
        if self.watched == Watched::Permission {
            return Some(self.look(command, passed.saturating_add(1)));
        }
        if before == Watched::Permission {
            // Its times stand still meanwhile.
            self.separate.pass(passed);
            self.separate.planned = 0;
            self.wait = 0;
        }
        if command.sequence == self.sequence {
            return self.update(command, pulse_valid);
        }
        self.sequence = command.sequence;
        self.expired = false;
        let off = matches!(command.setpoint, Setpoint::Off | Setpoint::Pulse);
        self.wait = if off { 0 } else { policy.command_timeout_ticks };
        self.separate.heartbeat = 0;
        self.in_force = !off;
        Some(self.standing(policy, command).unwrap_or(Event::Halt))
    }

    /// One tick without a changed command; gives what happens to the state, if anything. The setpoint in force changes
    /// only with [`Liveness::is_in_force`] or a changed command.
    #[inline]
    pub fn update(&mut self, command: &Command, pulse_valid: bool) -> Option<Event> {
        if self.watched == Watched::Pulse {
            return Some(if pulse_valid {
                Event::Drive
            } else {
                Event::Halt
            });
        }
        if self.wait == 0 {
            return None;
        }
        self.wait -= 1;
        if self.wait > 0 {
            return None;
        }
        Some(self.end(command))
    }

    /// The time that was waited for is over.
    #[inline(never)]
    fn end(&mut self, command: &Command) -> Event {
        if self.watched == Watched::Permission {
            return self.look(command, self.separate.planned);
        }
        self.expired = true;
        self.in_force = false;
        Event::Timeout
    }

    /// What the command and its separate permission mean after `ticks`, this one included: the drive runs exactly
    /// while both are alive.
    fn look(&mut self, command: &Command, ticks: u16) -> Event {
        let separate = &mut self.separate;
        separate.pass(ticks);
        if command.sequence != self.sequence {
            self.sequence = command.sequence;
            separate.heartbeat = self.timeout_ticks;
        }
        if command.enable.sequence != separate.enable_sequence {
            separate.enable_sequence = command.enable.sequence;
            separate.permission = self.timeout_ticks;
        }
        if command.enable.withdrawn {
            separate.permission = 0;
        }
        if command.pause != separate.pause {
            separate.pause = command.pause;
            separate.pause_left = self.pause_ticks;
        }
        self.wait = separate.plan();
        self.expired = false;
        let off = matches!(command.setpoint, Setpoint::Off);
        self.in_force = separate.permits() && !off;
        if self.in_force {
            Event::Drive
        } else {
            Event::Timeout
        }
    }

    /// What the command that is alive means for the state; nothing if none is.
    pub fn standing(&self, policy: &Policy, command: &Command) -> Option<Event> {
        match self.setpoint(command) {
            Setpoint::Off | Setpoint::Pulse => None,
            setpoint if setpoint.is_nonzero() || self.watched == Watched::Permission => {
                Some(Event::Drive)
            }
            _ => Some(match policy.resume {
                Resume::NonZeroSetpoint => Event::Zero,
                Resume::AnyCommand => Event::Drive,
            }),
        }
    }

    /// True from a timeout until the next command: the command's options are void.
    #[must_use]
    pub const fn has_expired(&self) -> bool {
        self.expired
    }

    /// True while a driving command, and its permission, are alive. Never for the RC-PWM input, which needs
    /// neither.
    #[must_use]
    pub const fn is_in_force(&self) -> bool {
        self.in_force
    }

    /// The setpoint in force: off unless a driving command is alive.
    #[must_use]
    pub const fn setpoint(&self, command: &Command) -> Setpoint {
        match command.setpoint {
            Setpoint::Pulse => Setpoint::Pulse,
            setpoint if self.in_force => setpoint,
            _ => Setpoint::Off,
        }
    }
}

/// The mode that drives a setpoint.
#[must_use]
pub const fn mode_of(setpoint: Setpoint) -> Mode {
    match setpoint {
        Setpoint::Off | Setpoint::Neutral => Mode::Off,
        Setpoint::Duty(_) => Mode::Duty,
        Setpoint::Velocity(_) => Mode::Velocity,
        Setpoint::Position(_) => Mode::Position,
        Setpoint::Current(_) => Mode::Current,
        Setpoint::Voltage(_) => Mode::Voltage,
        Setpoint::Follow(_) => Mode::Follow,
        Setpoint::Pulse => Mode::Pulse,
    }
}

/// Follows the reports of the controller that is followed.
#[derive(Clone, Copy, Debug, Default)]
pub struct Follower {
    master: Option<u8>,
    sequence: u32,
    ticks_left: u16,
    duty: Duty,
}

impl Follower {
    /// Nobody followed.
    #[must_use]
    pub const fn new() -> Self {
        Self {
            master: None,
            sequence: 0,
            ticks_left: 0,
            duty: Duty::ZERO,
        }
    }

    /// The setpoint in force or the report may have changed. To be called before [`Follower::wait`].
    pub fn obey(&mut self, policy: &Policy, setpoint: Setpoint, report: MasterReport) {
        let master = match setpoint {
            Setpoint::Follow(master) => Some(master),
            _ => None,
        };
        if master != self.master {
            self.master = master;
            self.ticks_left = 0;
        }
        if report.sequence != self.sequence {
            self.sequence = report.sequence;
            self.ticks_left = policy.master_timeout_ticks.saturating_add(1);
        }
        self.duty = report.duty;
    }

    /// One tick; to be called in every tick in which a controller is followed.
    // Not inlined: it would become instructions that every other tick executes without effect.
    #[inline(never)]
    pub fn wait(&mut self) {
        self.ticks_left = self.ticks_left.saturating_sub(1);
    }

    /// The duty cycle to copy, nothing once the reports have stopped.
    #[must_use]
    pub fn report(&self) -> Option<Duty> {
        (self.ticks_left > 0).then_some(self.duty)
    }

    /// The duty cycle to copy, zero once the reports have stopped.
    #[must_use]
    pub fn duty(&self) -> Duty {
        self.report().unwrap_or(Duty::ZERO)
    }
}

/// A pulse must come at least this often (longest period of the DMC60C's hardware reference manual).
const PULSE_TIMEOUT_TICKS: u16 = (100 * TICKS_PER_MS) as u16;
/// Accepted pulse widths in µs (hardware reference manual).
const PULSE_ACCEPTED: core::ops::RangeInclusive<u16> = 600..=2400;
/// Width of neutral, and distance to full forward and full reverse, in µs.
const PULSE_CENTRE: i32 = 1500;
const PULSE_SPAN: i32 = 500;
/// Dead band: 4 % of the span to either side of the centre, in µs.
const PULSE_DEAD_BAND: i32 = PULSE_SPAN * 4 / 100;

/// Follows the RC-PWM input.
#[derive(Clone, Copy, Debug, Default)]
pub struct PulseInput {
    count: u16,
    ticks_left: u16,
    duty: Duty,
}

impl PulseInput {
    /// No pulse yet.
    #[must_use]
    pub const fn new() -> Self {
        Self {
            count: 0,
            ticks_left: 0,
            duty: Duty::ZERO,
        }
    }

    /// One tick; shows whether pulses arrive. Those outside the accepted widths are ignored and do not keep the
    /// input alive.
    #[inline]
    pub fn update(&mut self, pulse: Pulse, shown: &mut Snapshot) {
        if pulse.count != self.count {
            self.take(pulse);
            shown.pulse_valid = self.ticks_left > 0;
        } else if self.ticks_left > 0 {
            self.ticks_left -= 1;
            if self.ticks_left == 0 {
                shown.pulse_valid = false;
            }
        }
    }

    #[inline(never)]
    fn take(&mut self, pulse: Pulse) {
        self.count = pulse.count;
        if PULSE_ACCEPTED.contains(&pulse.width_us) {
            self.ticks_left = PULSE_TIMEOUT_TICKS;
            self.duty = duty_of_pulse(pulse.width_us);
        } else {
            self.ticks_left = self.ticks_left.saturating_sub(1);
        }
    }

    /// The duty cycle asked for.
    #[must_use]
    pub const fn duty(&self) -> Duty {
        self.duty
    }
}

/// 1.0 ms is full reverse, 1.5 ms neutral, 2.0 ms full forward.
fn duty_of_pulse(width_us: u16) -> Duty {
    let offset = (i32::from(width_us) - PULSE_CENTRE).clamp(-PULSE_SPAN, PULSE_SPAN);
    if offset.abs() < PULSE_DEAD_BAND {
        Duty::ZERO
    } else {
        Duty::saturating(offset * i32::from(i16::MAX) / PULSE_SPAN)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use DriveState::{Halted, Running, SelfCheck};

    #[test]
    fn transition_table() {
        use Event::{Drive, Halt, Ready, Timeout, Zero};
        let table = [
            (
                SelfCheck,
                [SelfCheck, SelfCheck, SelfCheck, SelfCheck, Halted],
            ),
            (Halted, [Running, Halted, Halted, Halted, Halted]),
            (Running, [Running, Running, Halted, Halted, Running]),
        ];
        for (state, expected) in table {
            let got = [Drive, Zero, Halt, Timeout, Ready].map(|event| transition(state, event));
            assert_eq!(got, expected, "{state:?}");
        }
    }

    #[test]
    fn pulse_widths_map_to_duty() {
        let table = [
            (1000, -32767),
            (1250, -16383),
            (1481, 0),
            (1500, 0),
            (1519, 0),
            (1520, 1310),
            (1750, 16383),
            (2000, 32767),
            (2400, 32767),
            (600, -32767),
        ];
        for (width, duty) in table {
            assert_eq!(duty_of_pulse(width), Duty::new(duty), "{width} us");
        }
    }

    #[test]
    fn pulse_input_ends_100_ms_after_the_last_valid_pulse() {
        let mut input = PulseInput::default();
        let mut shown = Snapshot::new();
        let mut pulse = |width_us, count| {
            input.update(Pulse { width_us, count }, &mut shown);
            shown.pulse_valid
        };
        assert!(pulse(1750, 1));
        // Pulses of nonsense width must not keep the input alive.
        for tick in 1..200 {
            assert!(pulse(2500, 1 + tick), "tick {tick}");
        }
        assert!(!pulse(2500, 201));
    }
}
