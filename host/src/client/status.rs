//! Status frames in engineering units.

use std::time::Duration;

use windlass_core::dialect::dmc60c::wire::{
    ModeSelect, StatusAnalog, StatusEncoder, StatusGeneral, id,
};
use windlass_core::frame::Frame;
use windlass_core::frc_id;

/// A value is stale when this many of its periods have passed without a new one.
const STALE_PERIODS: u32 = 5;
/// Throttle units at and below which the vendor's client shows −100 %.
const FULL_REVERSE: i16 = -32510;

/// The latest value of a periodic frame.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Live<T> {
    /// The value.
    pub value: T,
    /// When it arrived, on the bus's clock.
    pub at: Duration,
    /// Time from the value before, or the frame's default period for the first one.
    pub period: Duration,
}

impl<T> Live<T> {
    /// Time since the value arrived.
    #[must_use]
    pub const fn age(&self, now: Duration) -> Duration {
        now.saturating_sub(self.at)
    }

    /// True if several periods have passed since.
    #[must_use]
    pub fn is_stale(&self, now: Duration) -> bool {
        self.age(now) > self.period * STALE_PERIODS
    }
}

fn note<T>(live: &mut Option<Live<T>>, value: Option<T>, at: Duration, default_period: Duration) {
    let Some(value) = value else {
        return;
    };
    let period = match live {
        Some(before) => at.saturating_sub(before.at).max(Duration::from_millis(1)),
        None => default_period,
    };
    *live = Some(Live { value, at, period });
}

/// The closed-loop error of the general status frame; its meaning depends on the mode.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum ClosedLoopError {
    /// Throttle units, voltage mode.
    Throttle(i32),
    /// Counts per 100 ms, or counts.
    Counts(i64),
    /// Amperes.
    Amps(f64),
    /// Volts.
    Volts(f64),
    /// The mode has none.
    None,
}

impl ClosedLoopError {
    /// Reads the field as the vendor's client does.
    #[must_use]
    pub fn of(general: &StatusGeneral) -> Self {
        let scale = if general.error_divided { 256 } else { 1 };
        let counts = i64::from(general.error) * scale;
        let fixed = counts as f64 / 65536.0;
        match general.mode {
            ModeSelect::Voltage => {
                let [low, middle, _, _] = general.error.to_le_bytes();
                Self::Throttle(i32::from(i16::from_le_bytes([low, middle])) * scale as i32)
            }
            ModeSelect::Velocity | ModeSelect::Position => Self::Counts(counts),
            ModeSelect::Current => Self::Amps(fixed),
            ModeSelect::VoltageCompensation => Self::Volts(fixed),
            ModeSelect::Follower | ModeSelect::NoDrive | ModeSelect::Reserved(_) => Self::None,
        }
    }

    /// The error as a plain number in the unit of the mode; 0 where there is none.
    #[must_use]
    pub fn number(self) -> f64 {
        match self {
            Self::Throttle(units) => f64::from(units),
            Self::Counts(counts) => counts as f64,
            Self::Amps(value) | Self::Volts(value) => value,
            Self::None => 0.0,
        }
    }
}

/// The latest status of the devices with one number. Status frames carry no session, so devices that
/// share a number cannot be told apart here.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Status {
    /// Duty cycle, limits, faults, mode and error.
    pub general: Option<Live<StatusGeneral>>,
    /// Position and velocity.
    pub encoder: Option<Live<StatusEncoder>>,
    /// Voltages, current and temperature.
    pub analog: Option<Live<StatusAnalog>>,
}

impl Status {
    /// Takes a status frame.
    pub(super) fn note(&mut self, frame: &Frame, at: Duration) {
        let Some(identifier) = frame.extended_id() else {
            return;
        };
        let slow = Duration::from_millis(100);
        match frc_id::base(identifier) {
            id::STATUS_GENERAL => {
                let default_period = Duration::from_millis(10);
                note(
                    &mut self.general,
                    StatusGeneral::parse(frame),
                    at,
                    default_period,
                );
            }
            id::STATUS_ENCODER => {
                note(&mut self.encoder, StatusEncoder::parse(frame), at, slow);
            }
            id::STATUS_ANALOG => note(&mut self.analog, StatusAnalog::parse(frame), at, slow),
            _ => {}
        }
    }

    /// Duty cycle in percent.
    #[must_use]
    pub fn duty_percent(&self) -> Option<f64> {
        self.general.map(|live| duty_percent(live.value.duty))
    }

    /// Position in counts.
    #[must_use]
    pub fn position(&self) -> Option<i32> {
        self.encoder.map(|live| live.value.position_counts())
    }

    /// Velocity in counts per 100 ms.
    #[must_use]
    pub fn velocity(&self) -> Option<i32> {
        self.encoder
            .map(|live| live.value.velocity_counts_per_100ms())
    }

    /// Motor current in amperes.
    #[must_use]
    pub fn current(&self) -> Option<f64> {
        self.analog.map(|live| fixed_8_8(live.value.current))
    }

    /// Bus voltage in volts.
    #[must_use]
    pub fn bus_voltage(&self) -> Option<f64> {
        self.analog.map(|live| fixed_8_8(live.value.bus_voltage))
    }

    /// Case temperature in degrees Celsius.
    #[must_use]
    pub fn temperature(&self) -> Option<f64> {
        self.analog.map(|live| fixed_8_8(live.value.temperature))
    }

    /// Voltage at AIN1 in volts.
    #[must_use]
    pub fn analog_in(&self) -> Option<f64> {
        self.analog.map(|live| fixed_8_8(live.value.analog_in))
    }

    /// True if any frame that was once seen has stopped coming, or none was ever seen.
    #[must_use]
    pub fn is_stale(&self, now: Duration) -> bool {
        let stale = [
            self.general.map(|live| live.is_stale(now)),
            self.encoder.map(|live| live.is_stale(now)),
            self.analog.map(|live| live.is_stale(now)),
        ];
        stale.iter().all(Option::is_none) || stale.contains(&Some(true))
    }
}

/// The device that sent a status frame; `None` for other frames.
pub(super) fn sender(frame: &Frame) -> Option<u8> {
    let identifier = frame.extended_id()?;
    let status = [id::STATUS_GENERAL, id::STATUS_ENCODER, id::STATUS_ANALOG];
    let known =
        status.contains(&frc_id::base(identifier)) && frame.dlc() == 8 && !frame.is_remote();
    known.then(|| frc_id::number(identifier))
}

fn duty_percent(units: i16) -> f64 {
    if units <= FULL_REVERSE {
        -100.0
    } else {
        f64::from(units) * 100.0 / 32767.0
    }
}

fn fixed_8_8(value: i16) -> f64 {
    f64::from(value) / 256.0
}

/// A control mode as a word.
pub(crate) const fn mode_name(mode: ModeSelect) -> &'static str {
    match mode {
        ModeSelect::Voltage => "voltage",
        ModeSelect::Velocity => "velocity",
        ModeSelect::Position => "position",
        ModeSelect::Current => "current",
        ModeSelect::VoltageCompensation => "voltage compensation",
        ModeSelect::Follower => "follower",
        ModeSelect::NoDrive => "no drive",
        ModeSelect::Reserved(_) => "reserved",
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn general(mode: ModeSelect, error: i32, error_divided: bool) -> StatusGeneral {
        let frame = Frame::extended(id::STATUS_GENERAL, [0; 8]);
        StatusGeneral {
            mode,
            error,
            error_divided,
            ..StatusGeneral::parse(&frame).unwrap()
        }
    }

    #[test]
    fn the_error_follows_the_mode() {
        let error = |mode, raw, divided| ClosedLoopError::of(&general(mode, raw, divided));
        let counts = ClosedLoopError::Counts;
        assert_eq!(error(ModeSelect::Velocity, -5, false), counts(-5));
        assert_eq!(error(ModeSelect::Position, -5, true), counts(-1280));
        assert_eq!(
            error(ModeSelect::Current, 98304, false),
            ClosedLoopError::Amps(1.5)
        );
        assert_eq!(
            error(ModeSelect::VoltageCompensation, 256, true),
            ClosedLoopError::Volts(1.0)
        );
        // High byte ignored in voltage mode.
        assert_eq!(
            error(ModeSelect::Voltage, 0x12_8000, false),
            ClosedLoopError::Throttle(-32768)
        );
        assert_eq!(
            error(ModeSelect::Follower, 99, false),
            ClosedLoopError::None
        );
        assert_eq!(error(ModeSelect::NoDrive, 99, true).number(), 0.0);
    }

    #[test]
    fn duty_is_shown_as_the_vendor_s_client_does() {
        assert_eq!(duty_percent(32767), 100.0);
        assert_eq!(duty_percent(-32510), -100.0);
        assert!(duty_percent(-32509) > -100.0);
        assert_eq!(duty_percent(0), 0.0);
    }

    #[test]
    fn a_value_is_stale_after_five_of_its_own_periods() {
        let mut status = Status::default();
        assert!(status.is_stale(Duration::ZERO));
        let frame = StatusEncoder::default().emit(5);
        assert_eq!(sender(&frame), Some(5));
        status.note(&frame, Duration::from_millis(1000));
        assert!(!status.is_stale(Duration::from_millis(1500)));
        assert!(status.is_stale(Duration::from_millis(1501)));
        status.note(&frame, Duration::from_millis(1020));
        assert!(!status.is_stale(Duration::from_millis(1120)));
        assert!(status.is_stale(Duration::from_millis(1121)));
    }

    #[test]
    fn frames_of_another_length_are_no_status() {
        let short = StatusEncoder::default().emit(5).shortened(7);
        assert_eq!(sender(&short), None);
        assert_eq!(sender(&Frame::standard(0x7FF, [0; 8])), None);
    }
}
