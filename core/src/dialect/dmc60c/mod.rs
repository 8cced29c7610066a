//! The DMC60C dialect: control frame in, three periodic status frames out.
//!
//! Source: DMC60C CAN Protocol Guide, "Output Control Protocol" and "Periodic Status Frames", with the
//! decisions of `docs/dmc60c.md`. Parameters and everything else belong to the management channel.

pub mod wire;

#[cfg(test)]
mod tests;

use wire::{
    Control0, ModeSelect, StatusAnalog, StatusEncoder, StatusGeneral, id,
};

use super::schedule::{Periodic, earlier};
use super::{Bad, Decoded, Dialect, Intent, Outcome, Outgoing, View};
use crate::engine::command::{DriveOpts, Neutral, Setpoint, Slot};
use crate::engine::settings::{Policy, Resume};
use crate::engine::snapshot::{Mode, Pin};
use crate::field::{I24_MAX, I24_MIN, divide_on_overflow, saturate_i16};
use crate::frame::{ExtendedMatch, Frame};
use crate::frc_id::{NUMBER_MASK, with_number};
use crate::params::Params;
use crate::params::table::ParameterId;
use crate::time::{Duration, Instant, TICKS_PER_MS};
use crate::units::{Amps, Duty, Volts};

/// Bits of an identifier that tell the status frame that is listened to from the control frame.
const ONLY_STATUS: u32 = id::STATUS_GENERAL & !id::CONTROL_0;

/// What the dialect remembers.
#[derive(Clone, Debug)]
pub struct Dmc60c {
    /// The followed controller's general status.
    master: ExtendedMatch,
    general: Periodic,
    encoder: Periodic,
    analog: Periodic,
}

impl Default for Dmc60c {
    fn default() -> Self {
        Self {
            master: ExtendedMatch::NONE,
            general: Periodic::default(),
            encoder: Periodic::default(),
            analog: Periodic::default(),
        }
    }
}

impl Dialect for Dmc60c {
    const NAME: &'static str = "dmc60c";

    /// Heartbeat and follower timeout 104 ms, fault state 3 s (guide, "Output Control Protocol" and
    /// `paramActiveFaults`).
    const POLICY: Policy = Policy {
        command_timeout_ticks: (104 * TICKS_PER_MS) as u16,
        master_timeout_ticks: (104 * TICKS_PER_MS) as u16,
        fault_hold_ticks: (3000 * TICKS_PER_MS) as u16,
        resume: Resume::NonZeroSetpoint,
        ..Policy::BASE
    };

    #[inline]
    fn decode(&mut self, own: u8, frame: &Frame) -> Decoded {
        let control = ExtendedMatch::new(with_number(id::CONTROL_0, own));
        if !frame.is(control) && !frame.is(self.master) {
            return Decoded::Ignored;
        }
        self.read(frame)
    }

    /// Parameters are the management channel's; this dialect asks nothing.
    fn answer(&mut self, _: Outcome) {}

    fn start(&mut self, now: Instant, params: &Params) {
        self.general.start(now, period(params, ParameterId::GeneralPeriod));
        self.encoder.start(now, period(params, ParameterId::EncoderPeriod));
        self.analog.start(now, period(params, ParameterId::AnalogPeriod));
    }

    fn stop(&mut self) {
        *self = Self::default();
    }

    fn encode(&mut self, now: Instant, view: &View<'_>) -> Option<Outgoing> {
        let params = view.params;
        let frame = if self.general.take(now, period(params, ParameterId::GeneralPeriod)) {
            status_general(view).emit(view.number)
        } else if self.encoder.take(now, period(params, ParameterId::EncoderPeriod)) {
            status_encoder(view).emit(view.number)
        } else if self.analog.take(now, period(params, ParameterId::AnalogPeriod)) {
            status_analog(view).emit(view.number)
        } else {
            return None;
        };
        Some(Outgoing::Status(frame))
    }

    fn next_deadline(&self) -> Option<Instant> {
        earlier(self.general.due(), earlier(self.encoder.due(), self.analog.due()))
    }
}

impl Dmc60c {
    /// A control frame for this device or a general status frame of the followed controller.
    fn read(&mut self, frame: &Frame) -> Decoded {
        if frame.raw_id() & ONLY_STATUS != 0 {
            return master_report(frame);
        }
        let Some(control) = Control0::parse(frame) else { return refused(frame) };
        let setpoint = setpoint(&control);
        self.master = match setpoint {
            Setpoint::Follow(master) => {
                ExtendedMatch::new(with_number(id::STATUS_GENERAL, master))
            }
            _ => ExtendedMatch::NONE,
        };
        Decoded::Intent(Intent::Drive(setpoint, drive_opts(&control)))
    }
}

/// A general status frame of the followed controller.
#[inline(never)]
fn master_report(frame: &Frame) -> Decoded {
    let Some(status) = StatusGeneral::parse(frame) else { return refused(frame) };
    Decoded::Intent(Intent::MasterReport(Duty::new(status.duty)))
}

/// Why a frame could not be read.
const fn refused(frame: &Frame) -> Decoded {
    Decoded::Bad(if frame.is_remote() { Bad::Remote } else { Bad::Length })
}

fn period(params: &Params, id: ParameterId) -> Duration {
    Duration::from_millis(params.get(id))
}

/// The setpoint of a control frame. Reserved modes are taken as `modeNoDrive` (docs/dmc60c.md).
fn setpoint(control: &Control0) -> Setpoint {
    match control.mode {
        // The duty cycle stands in trgtM and trgtL alone; trgtH is whatever the client's sign
        // extension made of it.
        ModeSelect::Voltage => Setpoint::Duty(Duty::new(control.target as i16)),
        ModeSelect::Velocity => Setpoint::Velocity(control.target),
        ModeSelect::Position => Setpoint::Position(control.target),
        ModeSelect::Current => Setpoint::Current(Amps::from_bits(control.target)),
        ModeSelect::VoltageCompensation => Setpoint::Voltage(Volts::from_bits(control.target)),
        ModeSelect::Follower => Setpoint::Follow((control.target as u32 & NUMBER_MASK) as u8),
        ModeSelect::NoDrive | ModeSelect::Reserved(_) => Setpoint::Off,
    }
}

fn drive_opts(control: &Control0) -> DriveOpts {
    let neutral = if control.brake { Neutral::Brake } else { Neutral::Coast };
    DriveOpts {
        slot: if control.slot_1 { Slot::One } else { Slot::Zero },
        neutral: control.override_neutral.then_some(neutral),
        limits: control.limits,
        reverse_sensor: control.reverse_sensor,
        reverse_motor: control.reverse_motor,
        ramp: control.ramp,
        ..DriveOpts::default()
    }
}

/// `STSGENERAL` of the present state.
#[must_use]
pub fn status_general(view: &View<'_>) -> StatusGeneral {
    let (snapshot, limits) = (view.snapshot, &view.settings.limits);
    let (error, error_divided) = error_field(snapshot.mode, snapshot.error);
    StatusGeneral {
        duty: snapshot.duty().units(),
        limit_pins: snapshot.pins.limits(),
        limit_hit: snapshot.limits.switch_hit,
        limit_disabled: limits.switch_disabled,
        limit_normally_closed: limits.normally_closed,
        limit_override: snapshot.opts.limits,
        soft_hit: snapshot.limits.soft_hit,
        soft_enabled: limits.soft_enabled,
        current_limited: snapshot.current_limited,
        faults: snapshot.faults,
        mode: mode_select(snapshot.mode),
        error_divided,
        error,
    }
}

const fn mode_select(mode: Mode) -> ModeSelect {
    match mode {
        Mode::Duty => ModeSelect::Voltage,
        Mode::Velocity => ModeSelect::Velocity,
        Mode::Position => ModeSelect::Position,
        Mode::Current => ModeSelect::Current,
        Mode::Voltage => ModeSelect::VoltageCompensation,
        Mode::Follow => ModeSelect::Follower,
        Mode::Pulse | Mode::Off => ModeSelect::NoDrive,
    }
}

/// The error field and `fDivErrBy256`: 24 bits wide, but clients read only 16 of them in voltage mode,
/// and nothing while following or off.
fn error_field(mode: Mode, error: i32) -> (i32, bool) {
    match mode {
        Mode::Duty => divide_on_overflow(error, i32::from(i16::MIN), i32::from(i16::MAX), 8),
        Mode::Velocity | Mode::Position | Mode::Current | Mode::Voltage => {
            divide_on_overflow(error, I24_MIN, I24_MAX, 8)
        }
        Mode::Follow | Mode::Pulse | Mode::Off => (0, false),
    }
}

/// `STSENCODER` of the present state.
#[must_use]
pub fn status_encoder(view: &View<'_>) -> StatusEncoder {
    let snapshot = view.snapshot;
    let (position, position_divided) = divide_on_overflow(snapshot.position, I24_MIN, I24_MAX, 3);
    let (velocity, velocity_divided) =
        divide_on_overflow(snapshot.velocity, i32::from(i16::MIN), i32::from(i16::MAX), 2);
    StatusEncoder {
        position,
        position_divided,
        velocity: saturate_i16(velocity),
        velocity_divided,
        pin_a: snapshot.pins.is_high(Pin::EncoderA),
        pin_b: snapshot.pins.is_high(Pin::EncoderB),
        pin_index: snapshot.pins.is_high(Pin::EncoderIndex),
    }
}

/// `STSANALOG` of the present state.
#[must_use]
pub fn status_analog(view: &View<'_>) -> StatusAnalog {
    let snapshot = view.snapshot;
    StatusAnalog {
        analog_in: to_8_8(snapshot.analog_in),
        current: to_8_8(snapshot.current),
        temperature: to_8_8(snapshot.temperature),
        bus_voltage: to_8_8(snapshot.bus_voltage),
    }
}

/// 16.16 to 8.8, rounded down, saturated.
fn to_8_8(value: fixed::types::I16F16) -> i16 {
    saturate_i16(value.to_bits() >> 8)
}
