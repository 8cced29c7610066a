//! The one table of parameters: identifiers, names, types, defaults and storage.
//!
//! Range checks, the host tool's listing and the documentation are all made from it. Parameters 1 to 93
//! are the DMC60C's (guide, "Configuration Parameter Summary" and the section of each); 128 to 254 are
//! this project's own.

/// How the 32 bits of a value are read, and which values are allowed.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Kind {
    /// 0 or 1.
    Flag,
    /// Signed 16.16 number.
    Fixed,
    /// Signed 16.16 number that may not be negative.
    NonNegativeFixed,
    /// Unsigned 10.22 number.
    Unsigned10Q22,
    /// Signed 10.22 number.
    Signed10Q22,
    /// Unsigned number up to 0x7FFFFFFF.
    Unsigned31,
    /// Signed 32-bit number.
    Signed,
    /// Signed number within bounds, both included.
    Range(i32, i32),
    /// A value that is computed when it is read; what writing does is told by the parameter.
    Computed,
}

impl Kind {
    /// True if `value` may be written to a parameter of this kind.
    #[must_use]
    pub const fn allows(self, value: u32) -> bool {
        let signed = value as i32;
        match self {
            Self::Flag => value <= 1,
            Self::Fixed
            | Self::Signed
            | Self::Unsigned10Q22
            | Self::Signed10Q22
            | Self::Computed => true,
            Self::NonNegativeFixed | Self::Unsigned31 => signed >= 0,
            Self::Range(min, max) => signed >= min && signed <= max,
        }
    }
}

/// Where a parameter lives.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Storage {
    /// In RAM and, by the 15 s rule, in non-volatile memory.
    Persistent,
    /// In RAM only; the default returns at power-on.
    Volatile,
    /// Part of the running drive, read from its state.
    Live,
}

/// One row of the table.
#[derive(Clone, Copy, Debug)]
pub struct Parameter {
    /// Which parameter.
    pub id: ParameterId,
    /// Name in the guide, or this project's for 128 and above.
    pub name: &'static str,
    /// Type and range.
    pub kind: Kind,
    /// Raw default value.
    pub default: u32,
    /// Where it lives.
    pub storage: Storage,
    /// Unit of the value, empty for plain numbers and flags.
    pub unit: &'static str,
}

/// What a controller has to know of a parameter: its row without the texts for people, which would take as
/// much room in a microcontroller again.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Rule {
    pub(crate) id: ParameterId,
    pub(crate) kind: Kind,
    pub(crate) default: u32,
    pub(crate) storage: Storage,
}

macro_rules! parameters {
    ($( $(#[$doc:meta])* $variant:ident = $code:literal, $name:literal, $kind:expr, $default:expr, $storage:ident, $unit:literal; )*) => {
        /// Identifier of a parameter; the discriminant is the number on the wire.
        #[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Hash)]
        #[repr(u8)]
        pub enum ParameterId { $( $(#[$doc])* $variant = $code, )* }

        /// Every parameter, in ascending order of identifiers.
        pub static TABLE: [Parameter; COUNT] = [ $( Parameter {
            id: ParameterId::$variant, name: $name, kind: $kind, default: $default,
            storage: Storage::$storage, unit: $unit,
        }, )* ];

        /// The rules of [`TABLE`], in its order.
        pub(crate) static RULES: [Rule; COUNT] = [ $( Rule {
            id: ParameterId::$variant, kind: $kind, default: $default, storage: Storage::$storage,
        }, )* ];

        /// Number of parameters.
        pub const COUNT: usize = [ $( $code as u8, )* ].len();

        const CODES: [u8; COUNT] = [ $( $code, )* ];
    };
}

use Kind::{
    Computed, Fixed, Flag, NonNegativeFixed, Range, Signed, Signed10Q22, Unsigned10Q22, Unsigned31,
};

/// Throttle units of the forward limits (guide, `paramClosedLoopFwdMaxSlot0`).
const FORWARD: Kind = Range(0, 32767);
/// Throttle units of the reverse limits (guide, `paramClosedLoopRevMaxSlot0`).
const REVERSE: Kind = Range(-32768, 0);
/// Frame period of encoder and analog status (guide, `paramStatusAnalogFrameRate`).
const PERIOD: Kind = Range(1, 30_000);

parameters! {
    /// Forward limit switch is normally closed.
    ForwardLimitNormallyClosed = 1, "paramLimitSwtFwdNormClosed", Flag, 0, Persistent, "";
    /// Forward limit switch is disabled.
    ForwardLimitDisabled = 2, "paramLimitSwtFwdDisabled", Flag, 0, Persistent, "";
    /// Reverse limit switch is normally closed.
    ReverseLimitNormallyClosed = 3, "paramLimitSwtRevNormClosed", Flag, 0, Persistent, "";
    /// Reverse limit switch is disabled.
    ReverseLimitDisabled = 4, "paramLimitSwtRevDisabled", Flag, 0, Persistent, "";
    /// Forward soft limit.
    SoftForwardThreshold = 5, "paramLimitSoftFwdThreshold", Signed, 0, Persistent, "counts";
    /// Forward soft limit is enabled.
    SoftForwardEnable = 6, "paramLimitSoftFwdEnable", Flag, 0, Persistent, "";
    /// Reverse soft limit.
    SoftReverseThreshold = 7, "paramLimitSoftRevThreshold", Signed, 0, Persistent, "counts";
    /// Reverse soft limit is enabled.
    SoftReverseEnable = 8, "paramLimitSoftRevEnable", Flag, 0, Persistent, "";
    /// Amperes for each step of the current conversion.
    CurrentMultiplier = 9, "paramAdcCurrentMultiplier", Fixed, 0x816, Persistent, "A/LSB";
    /// Slot 0 proportional gain.
    Slot0P = 10, "paramClosedLoopPGainSlot0", Fixed, 0, Persistent, "";
    /// Slot 0 integral gain.
    Slot0I = 11, "paramClosedLoopIGainSlot0", Fixed, 0, Persistent, "";
    /// Slot 0 derivative gain.
    Slot0D = 12, "paramClosedLoopDGainSlot0", Fixed, 0, Persistent, "";
    /// Slot 0 accumulator limit.
    Slot0IZone = 13, "paramClosedLoopIZoneSlot0", Unsigned31, 0, Persistent, "";
    /// Slot 0 feed-forward gain.
    Slot0F = 14, "paramClosedLoopFGainSlot0", Fixed, 0, Persistent, "";
    /// Slot 0 allowable error.
    Slot0AllowableError = 15, "paramClosedLoopAllowableErrorSlot0", Unsigned31, 0, Persistent, "";
    /// Slot 0 ramp rate.
    Slot0Ramp = 16, "paramClosedLoopRampRateSlot0", Unsigned31, 0, Persistent, "throttle/tick";
    /// Slot 0 maximum forward duty cycle.
    Slot0ForwardMax = 17, "paramClosedLoopFwdMaxSlot0", FORWARD, 32767, Persistent, "throttle";
    /// Slot 0 maximum reverse duty cycle.
    Slot0ReverseMax = 18, "paramClosedLoopRevMaxSlot0", REVERSE, -32768_i32 as u32, Persistent, "throttle";
    /// Slot 0 nominal forward duty cycle.
    Slot0ForwardNominal = 19, "paramClosedLoopFwdNominalSlot0", FORWARD, 0, Persistent, "throttle";
    /// Slot 0 nominal reverse duty cycle.
    Slot0ReverseNominal = 20, "paramClosedLoopRevNominalSlot0", REVERSE, 0, Persistent, "throttle";
    /// Slot 1 proportional gain.
    Slot1P = 21, "paramClosedLoopPGainSlot1", Fixed, 0, Persistent, "";
    /// Slot 1 integral gain.
    Slot1I = 22, "paramClosedLoopIGainSlot1", Fixed, 0, Persistent, "";
    /// Slot 1 derivative gain.
    Slot1D = 23, "paramClosedLoopDGainSlot1", Fixed, 0, Persistent, "";
    /// Slot 1 accumulator limit.
    Slot1IZone = 24, "paramClosedLoopIZoneSlot1", Unsigned31, 0, Persistent, "";
    /// Slot 1 feed-forward gain.
    Slot1F = 25, "paramClosedLoopFGainSlot1", Fixed, 0, Persistent, "";
    /// Slot 1 allowable error.
    Slot1AllowableError = 26, "paramClosedLoopAllowableErrorSlot1", Unsigned31, 0, Persistent, "";
    /// Slot 1 ramp rate.
    Slot1Ramp = 27, "paramClosedLoopRampRateSlot1", Unsigned31, 0, Persistent, "throttle/tick";
    /// Slot 1 maximum forward duty cycle.
    Slot1ForwardMax = 28, "paramClosedLoopFwdMaxSlot1", FORWARD, 32767, Persistent, "throttle";
    /// Slot 1 maximum reverse duty cycle.
    Slot1ReverseMax = 29, "paramClosedLoopRevMaxSlot1", REVERSE, -32768_i32 as u32, Persistent, "throttle";
    /// Slot 1 nominal forward duty cycle.
    Slot1ForwardNominal = 30, "paramClosedLoopFwdNominalSlot1", FORWARD, 0, Persistent, "throttle";
    /// Slot 1 nominal reverse duty cycle.
    Slot1ReverseNominal = 31, "paramClosedLoopRevNominalSlot1", REVERSE, 0, Persistent, "throttle";
    /// Current limiter proportional gain.
    CurrentLimitP = 32, "paramCurrentLimitPGain", Fixed, 0x0064_0000, Persistent, "";
    /// Current limiter integral gain.
    CurrentLimitI = 33, "paramCurrentLimitIGain", Fixed, 0x003C_0000, Persistent, "";
    /// Current limiter derivative gain.
    CurrentLimitD = 34, "paramCurrentLimitDGain", Fixed, 0, Persistent, "";
    /// Current limiter accumulator limit.
    CurrentLimitIZone = 35, "paramCurrentLimitIZone", Unsigned31, 0x014C_C888, Persistent, "A";
    /// Current limiter feed-forward gain.
    CurrentLimitF = 36, "paramCurrentLimitFGain", Fixed, 0, Persistent, "";
    /// Encoder position.
    EncoderPosition = 41, "paramEncoderPosition", Computed, 0, Live, "counts";
    /// The index pin clears the encoder position.
    ClearPositionOnIndex = 42, "paramClearPositionOnIndex", Flag, 0, Volatile, "";
    /// The forward limit switch clears the encoder position.
    ClearPositionOnForwardLimit = 43, "paramClearPositionOnFwdLimit", Flag, 0, Volatile, "";
    /// The reverse limit switch clears the encoder position.
    ClearPositionOnReverseLimit = 44, "paramClearPositionOnRevLimit", Flag, 0, Volatile, "";
    /// Rising edges of the index pin count (else falling ones).
    IndexActiveEdge = 45, "paramIndexActiveEdge", Flag, 0, Volatile, "";
    /// Active faults; writing has no effect.
    ActiveFaults = 51, "paramActiveFaults", Computed, 0, Live, "";
    /// Sticky faults; writing a non-zero value clears them after the answer.
    StickyFaults = 52, "paramStickyFaults", Computed, 0, Live, "";
    /// Times of over-current; writing a non-zero value clears the count after the answer.
    OverCurrentCount = 53, "paramOverCurrentStkyFltCnt", Computed, 0, Live, "";
    /// Times of over-temperature; writing as for over-current.
    OverTemperatureCount = 54, "paramOverTempStkyFltCnt", Computed, 0, Live, "";
    /// Times of under-voltage; writing as for over-current.
    UnderVoltageCount = 55, "paramUnderVoltageStkyFltCnt", Computed, 0, Live, "";
    /// Times of a gate driver fault; writing as for over-current.
    GateDriverCount = 56, "paramGateDriverStkyFltCnt", Computed, 0, Live, "";
    /// Times that the bus was lost since power-on; writing as for over-current.
    CommunicationCount = 57, "paramCommStkyFltCnt", Computed, 0, Live, "";
    /// Continuous current limit, 40 A.
    ContinuousCurrent = 61, "paramContinuousCurrentLimit", NonNegativeFixed, 40 << 16, Persistent, "A";
    /// Peak current limit, 60 A.
    PeakCurrent = 62, "paramPeakCurrentLimit", NonNegativeFixed, 60 << 16, Persistent, "A";
    /// Time above the peak limit before limiting begins.
    PeakDuration = 63, "paramPeakCurrentDuration", Range(0, 65535), 500, Persistent, "ms";
    /// Current limiting is enabled.
    CurrentLimitEnable = 64, "paramCurrentLimitEnable", Flag, 0, Persistent, "";
    /// Period of the analog status frame.
    AnalogPeriod = 91, "paramStatusAnalogFrameRate", PERIOD, 100, Volatile, "ms";
    /// Period of the encoder status frame.
    EncoderPeriod = 92, "paramStatusEncoderFrameRate", PERIOD, 100, Volatile, "ms";
    /// Period of the general status frame; at most 50 ms so that followers get it within 104 ms.
    GeneralPeriod = 93, "paramStatusGeneralFrameRate", Range(1, 50), 10, Volatile, "ms";
    /// Dialect that drives the motor; takes effect at the next start.
    Dialect = 128, "paramDialect", Range(0, crate::dialect::COUNT as i32 - 1), 0, Persistent, "";
    /// Neutral brakes (else it coasts); the brake/coast button toggles it.
    BrakeAtNeutral = 129, "paramBrakeAtNeutral", Flag, 1, Persistent, "";
    /// Why the controller started, a code of [`ResetCause`](crate::reset::ResetCause); writing has no effect,
    /// as for the next seven.
    ResetCause = 130, "paramResetCause", Computed, 0, Live, "";
    /// What is known of the stored settings, see [`SettingsState`](crate::params::SettingsState); writing
    /// has no effect.
    SettingsState = 131, "paramSettingsState", Computed, 0, Live, "";
    /// Detail of the cause: line of a panic, fault status, exception number.
    ResetDetail = 132, "paramResetDetail", Computed, 0, Live, "";
    /// Frames that were received and lost, because nobody took them in time, since power-on.
    FramesDropped = 133, "paramFramesDropped", Computed, 0, Live, "";
    /// Restarts since power-on.
    ResetCount = 134, "paramResetCount", Computed, 0, Live, "";
    /// Place of the cause: hash of the file with the panic, address of the faulting instruction.
    ResetPlace = 135, "paramResetPlace", Computed, 0, Live, "";
    /// Transmissions that were given up since the start.
    TransmissionsFailed = 136, "paramTransmissionsFailed", Computed, 0, Live, "";
    /// What the LEDs show at this moment, see [`Leds::to_bits`](crate::led::Leds::to_bits).
    Leds = 137, "paramLeds", Computed, 0, Live, "";
    /// Slot 0 of the law in throttle units: proportional gain.
    ThrottleSlot0P = 140, "paramThrottlePGainSlot0", Unsigned10Q22, 0, Persistent, "throttle/count";
    /// Slot 0 of the law in throttle units: integral gain.
    ThrottleSlot0I = 141, "paramThrottleIGainSlot0", Unsigned10Q22, 0, Persistent, "throttle/count";
    /// Slot 0 of the law in throttle units: derivative gain.
    ThrottleSlot0D = 142, "paramThrottleDGainSlot0", Unsigned10Q22, 0, Persistent, "throttle/count";
    /// Slot 0 of the law in throttle units: feed-forward gain.
    ThrottleSlot0F = 143, "paramThrottleFGainSlot0", Signed10Q22, 0, Persistent, "throttle/count";
    /// Slot 0 of the law in throttle units: errors of this size and above clear the accumulator, 0 = off.
    ThrottleSlot0IZone = 144, "paramThrottleIZoneSlot0", Unsigned31, 0, Persistent, "counts";
    /// Slot 0 of the law in throttle units: largest change of the output per 1 ms, 0 = at once.
    ThrottleSlot0Ramp = 145, "paramThrottleRampRateSlot0", Unsigned31, 0, Persistent, "throttle/ms";
    /// Slot 1 of the law in throttle units: proportional gain.
    ThrottleSlot1P = 146, "paramThrottlePGainSlot1", Unsigned10Q22, 0, Persistent, "throttle/count";
    /// Slot 1 of the law in throttle units: integral gain.
    ThrottleSlot1I = 147, "paramThrottleIGainSlot1", Unsigned10Q22, 0, Persistent, "throttle/count";
    /// Slot 1 of the law in throttle units: derivative gain.
    ThrottleSlot1D = 148, "paramThrottleDGainSlot1", Unsigned10Q22, 0, Persistent, "throttle/count";
    /// Slot 1 of the law in throttle units: feed-forward gain.
    ThrottleSlot1F = 149, "paramThrottleFGainSlot1", Signed10Q22, 0, Persistent, "throttle/count";
    /// Slot 1 of the law in throttle units: errors of this size and above clear the accumulator, 0 = off.
    ThrottleSlot1IZone = 150, "paramThrottleIZoneSlot1", Unsigned31, 0, Persistent, "counts";
    /// Slot 1 of the law in throttle units: largest change of the output per 1 ms, 0 = at once.
    ThrottleSlot1Ramp = 151, "paramThrottleRampRateSlot1", Unsigned31, 0, Persistent, "throttle/ms";
    /// Limits that have blocked since the sticky faults were cleared, where the dialect keeps them: bit 0
    /// forward switch, 1 reverse switch, 2 forward soft limit, 3 reverse soft limit.
    StickyLimits = 152, "paramStickyLimits", Range(0, 15), 0, Persistent, "";
    /// The latest crash, kept over a loss of power: a code of [`ResetCause`](crate::reset::ResetCause), 0 if none is
    /// known; writing has no effect, as for the next two.
    CrashCause = 153, "paramCrashCause", Computed, 0, Live, "";
    /// Detail of the latest crash, as in `paramResetDetail`.
    CrashDetail = 154, "paramCrashDetail", Computed, 0, Live, "";
    /// Place of the latest crash, as in `paramResetPlace`.
    CrashPlace = 155, "paramCrashPlace", Computed, 0, Live, "";
}

impl ParameterId {
    /// The parameter with the number `code` on the wire.
    #[must_use]
    pub fn from_code(code: u8) -> Option<Self> {
        let index = POSITIONS.get(usize::from(code))?;
        RULES.get(usize::from(*index)).map(|rule| rule.id)
    }

    /// The number on the wire.
    #[must_use]
    pub const fn code(self) -> u8 {
        self as u8
    }

    /// The parameter's place in [`TABLE`].
    #[must_use]
    pub(crate) fn position(self) -> usize {
        POSITIONS
            .get(usize::from(self.code()))
            .map_or(COUNT, |index| usize::from(*index))
    }

    /// The parameter's rule.
    #[must_use]
    pub(crate) fn rule(self) -> &'static Rule {
        RULES.get(self.position()).unwrap_or(&RULES[0])
    }

    /// The parameter's row in the table.
    #[must_use]
    pub fn row(self) -> &'static Parameter {
        // `position` is below COUNT for every variant, which a test shows; the first row only stands
        // in for a panic.
        TABLE.get(self.position()).unwrap_or(&TABLE[0])
    }
}

/// Position in [`TABLE`] of every wire number, `u8::MAX` for unused ones.
// Evaluated by the compiler: an index out of bounds would be a compile error.
#[allow(clippy::indexing_slicing)]
static POSITIONS: [u8; 256] = {
    let mut positions = [u8::MAX; 256];
    let mut at = 0;
    while at < COUNT {
        positions[CODES[at] as usize] = at as u8;
        at += 1;
    }
    positions
};

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn every_row_is_found_by_its_number_and_defaults_are_allowed() {
        for (at, row) in TABLE.iter().enumerate() {
            assert_eq!(ParameterId::from_code(row.id.code()), Some(row.id));
            assert_eq!(row.id.position(), at, "{}", row.name);
            assert!(row.kind.allows(row.default), "{}", row.name);
        }
        assert!(TABLE.windows(2).all(|pair| pair[0].id < pair[1].id));
    }

    #[test]
    fn the_guide_s_summary_has_as_many_parameters_up_to_93() {
        // Counted in the guide's "Configuration Parameter Summary".
        assert_eq!(TABLE.iter().filter(|row| row.id.code() <= 93).count(), 55);
        for unused in [0, 37, 40, 46, 50, 58, 60, 65, 90, 94, 127, 255] {
            assert_eq!(ParameterId::from_code(unused), None);
        }
    }
}
