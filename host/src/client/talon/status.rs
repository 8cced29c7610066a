//! What a Talon last reported, and how old that is.

use std::collections::BTreeMap;
use std::time::Duration;

use windlass_core::dialect::talon_srx::wire::{
    ModeSelect, ParameterValue, Status1, Status2, Status3, Status4, Status5, id,
};
use windlass_core::frame::Frame;
use windlass_core::frc_id;

use super::TalonError;

/// A value is stale when its frame is older than this: the published clients then give it with the error
/// `RxTimeout`.
pub const STALE_AFTER: Duration = Duration::from_millis(200);

/// Something received, with its time on the bus's clock.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Stamped<T> {
    /// What.
    pub value: T,
    /// When.
    pub at: Duration,
}

/// A value as a getter gives it: the last one known, zero if there was never one, with its age.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Reading<T> {
    /// The value.
    pub value: T,
    /// Its age; none if no frame with it was ever received.
    pub age: Option<Duration>,
    number: u8,
    what: &'static str,
}

impl<T> Reading<T> {
    /// True if the value is not older than 200 ms.
    #[must_use]
    pub fn is_fresh(&self) -> bool {
        self.age.is_some_and(|age| age <= STALE_AFTER)
    }

    /// The value if it is fresh.
    ///
    /// # Errors
    /// [`TalonError::RxTimeout`] if it is not.
    pub fn fresh(self) -> Result<T, TalonError> {
        if self.is_fresh() {
            return Ok(self.value);
        }
        Err(TalonError::RxTimeout {
            number: self.number,
            what: self.what,
            age_ms: self.age.map(|age| age.as_millis() as u64),
        })
    }

    /// The published clients' number for what is wrong with the value: 0 nothing, 1 `RxTimeout`.
    #[must_use]
    pub fn code(&self) -> i32 {
        i32::from(!self.is_fresh())
    }

    /// The same reading in another unit.
    pub(super) fn map<U>(self, convert: impl FnOnce(T) -> U) -> Reading<U> {
        Reading {
            value: convert(self.value),
            age: self.age,
            number: self.number,
            what: self.what,
        }
    }
}

/// The latest frames of the Talons with one number. Status frames carry no session, so devices that share a
/// number cannot be told apart here.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct TalonStatus {
    /// General.
    pub general: Option<Stamped<Status1>>,
    /// Selected sensor, current, sticky faults.
    pub feedback: Option<Stamped<Status2>>,
    /// Quadrature encoder.
    pub encoder: Option<Stamped<Status3>>,
    /// Analog input, temperature, battery.
    pub analog: Option<Stamped<Status4>>,
    /// Start-up.
    pub start_up: Option<Stamped<Status5>>,
    /// Parameters that were answered, by their numbers.
    pub(super) parameters: BTreeMap<u8, Stamped<u32>>,
}

impl TalonStatus {
    /// Takes a frame of this device.
    pub(in crate::client) fn note(&mut self, frame: &Frame, at: Duration) {
        fn set<T>(place: &mut Option<Stamped<T>>, value: Option<T>, at: Duration) {
            if let Some(value) = value {
                *place = Some(Stamped { value, at });
            }
        }
        let Some(identifier) = frame.extended_id() else {
            return;
        };
        match frc_id::base(identifier) {
            id::STATUS_1 => set(&mut self.general, Status1::parse(frame), at),
            id::STATUS_2 => set(&mut self.feedback, Status2::parse(frame), at),
            id::STATUS_3 => set(&mut self.encoder, Status3::parse(frame), at),
            id::STATUS_4 => set(&mut self.analog, Status4::parse(frame), at),
            id::STATUS_5 => set(&mut self.start_up, Status5::parse(frame), at),
            id::PARAMETER_RESPONSE => {
                if let Some(ParameterValue { parameter, value }) =
                    ParameterValue::parse_response(frame)
                {
                    self.parameters.insert(parameter, Stamped { value, at });
                }
            }
            _ => {}
        }
    }

    /// True if no periodic frame has come for 200 ms, or there was never one.
    #[must_use]
    pub fn is_stale(&self, now: Duration) -> bool {
        let latest = [
            self.general.map(|stamped| stamped.at),
            self.feedback.map(|stamped| stamped.at),
            self.encoder.map(|stamped| stamped.at),
            self.analog.map(|stamped| stamped.at),
        ];
        let latest = latest.into_iter().flatten().max();
        latest.is_none_or(|at| now.saturating_sub(at) > STALE_AFTER)
    }
}

/// The Talon that sent a frame; none for frames of other kinds.
pub(in crate::client) fn sender(frame: &Frame) -> Option<u8> {
    let identifier = frame.extended_id()?;
    let known = [
        id::STATUS_1,
        id::STATUS_2,
        id::STATUS_3,
        id::STATUS_4,
        id::STATUS_5,
        id::PARAMETER_RESPONSE,
    ];
    known
        .contains(&frc_id::base(identifier))
        .then(|| frc_id::number(identifier))
}

/// The value of a frame as a reading.
pub(super) fn reading<T: Copy, U: Default>(
    number: u8,
    now: Duration,
    what: &'static str,
    frame: Option<Stamped<T>>,
    value: impl FnOnce(T) -> U,
) -> Reading<U> {
    Reading {
        value: frame.map_or_else(U::default, |stamped| value(stamped.value)),
        age: frame.map(|stamped| now.saturating_sub(stamped.at)),
        number,
        what,
    }
}

/// A mode in the words that the DMC60C's modes have too.
pub(crate) fn mode_word(mode: ModeSelect) -> &'static str {
    match mode {
        ModeSelect::Duty => "duty",
        ModeSelect::Position => "position",
        ModeSelect::Velocity => "velocity",
        ModeSelect::Current => "current",
        ModeSelect::VoltageCompensation => "voltage compensation",
        ModeSelect::Follower => "follower",
        ModeSelect::NoDrive => "no drive",
        ModeSelect::Reserved(_) => "reserved",
    }
}
