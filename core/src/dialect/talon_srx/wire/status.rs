//! Status frames, controller to host.

use super::{FeedbackDevice, LimitOverride, ModeSelect, id, saturated_throttle, u10, u10_bytes};
use crate::field::{bit, flag, i24, i24_bytes};
use crate::frame::Frame;
use crate::frc_id::with_number;

/// Faults that are present now.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct LiveFaults {
    /// Over-temperature.
    pub over_temperature: bool,
    /// Under-voltage.
    pub under_voltage: bool,
    /// Forward limit switch, enabled and tripped.
    pub forward_limit: bool,
    /// Reverse limit switch.
    pub reverse_limit: bool,
    /// Forward soft limit, enabled and exceeded.
    pub forward_soft: bool,
    /// Reverse soft limit.
    pub reverse_soft: bool,
    /// Hardware failure; it has no sticky form.
    pub hardware: bool,
}

/// Faults that have been present since they were last cleared.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Sticky {
    /// Over-temperature.
    pub over_temperature: bool,
    /// Under-voltage.
    pub under_voltage: bool,
    /// Forward limit switch.
    pub forward_limit: bool,
    /// Reverse limit switch.
    pub reverse_limit: bool,
    /// Forward soft limit.
    pub forward_soft: bool,
    /// Reverse soft limit.
    pub reverse_soft: bool,
}

/// Status_1, general (8 bytes).
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Status1 {
    /// `CloseLoopErr`, signed 24 bits.
    pub error: i32,
    /// `AppliedThrottle`, −1023 to 1023.
    pub throttle: i16,
    /// Faults.
    pub faults: LiveFaults,
    /// `TokLocked`.
    pub token_locked: bool,
    /// The forward pin is connected to ground. On the wire the bit is 0 then.
    pub forward_closed: bool,
    /// The reverse pin is connected to ground. On the wire the bit is 0 then.
    pub reverse_closed: bool,
    /// `FeedbackDeviceSelect`.
    pub feedback: FeedbackDevice,
    /// `LimitSwitchEn`, the code of the override.
    pub limits: LimitOverride,
    /// `ModeSelect`.
    pub mode: ModeSelect,
    /// `TokenSeed`.
    pub token_seed: u8,
}

impl Status1 {
    /// Reads the frame's data; `None` unless it has exactly 8 bytes.
    #[must_use]
    pub fn parse(frame: &Frame) -> Option<Self> {
        let [e0, e1, e2, flags, throttle, select, faults, token_seed] = *frame.exact::<8>()?;
        let throttle = throttle_of(flags, throttle);
        Some(Self {
            error: i24(e0, e1, e2),
            throttle,
            faults: LiveFaults {
                over_temperature: bit(faults, 4),
                under_voltage: bit(faults, 3),
                forward_limit: bit(faults, 2),
                reverse_limit: bit(faults, 1),
                forward_soft: bit(flags, 4),
                reverse_soft: bit(flags, 3),
                hardware: bit(faults, 0),
            },
            token_locked: bit(flags, 5),
            forward_closed: !bit(flags, 7),
            reverse_closed: !bit(flags, 6),
            feedback: FeedbackDevice::from_code(select >> 1),
            limits: LimitOverride::from_code(select >> 5),
            mode: ModeSelect::from_code((select & 1) << 3 | faults >> 5),
            token_seed,
        })
    }

    /// The throttle alone, all that a follower wants; `None` as for [`Status1::parse`].
    #[must_use]
    pub fn parse_throttle(frame: &Frame) -> Option<i16> {
        let [_, _, _, flags, throttle, ..] = *frame.exact::<8>()?;
        Some(throttle_of(flags, throttle))
    }

    /// The frame of device `number`. The error saturates at 24 bits, the throttle at ±1023.
    #[must_use]
    pub const fn emit(&self, number: u8) -> Frame {
        let [e0, e1, e2] = i24_bytes(self.error);
        let [high, low] = saturated_throttle(self.throttle).to_be_bytes();
        let faults = &self.faults;
        let flags = high & 7
            | flag(faults.reverse_soft, 3)
            | flag(faults.forward_soft, 4)
            | flag(self.token_locked, 5)
            | flag(!self.reverse_closed, 6)
            | flag(!self.forward_closed, 7);
        let mode = self.mode.code();
        let select = mode >> 3 | self.feedback.code() << 1 | self.limits.code() << 5;
        let faults = flag(faults.hardware, 0)
            | flag(faults.reverse_limit, 1)
            | flag(faults.forward_limit, 2)
            | flag(faults.under_voltage, 3)
            | flag(faults.over_temperature, 4)
            | mode << 5;
        Frame::extended(
            with_number(id::STATUS_1, number),
            [e0, e1, e2, flags, low, select, faults, self.token_seed],
        )
    }
}

/// Eleven bits, moved up to the sign of sixteen and back.
const fn throttle_of(flags: u8, low: u8) -> i16 {
    i16::from_be_bytes([flags << 5 | low >> 3, low << 5]) >> 5
}

/// Status_2, feedback (8 bytes).
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Status2 {
    /// `SensorPosition` of the selected sensor, signed 24 bits.
    pub position: i32,
    /// `SensorVelocity`, units per 100 ms.
    pub velocity: i16,
    /// `Current`, 10 bits in steps of 0.125 A, see [`super::current`].
    pub current: u16,
    /// Sticky faults.
    pub sticky: Sticky,
    /// `ProfileSlotSelect`.
    pub slot_1: bool,
    /// `BrakeIsEnabled`.
    pub brake: bool,
    /// `Cmd5Allowed` (later firmware): the host may enable with the short Control_1.
    pub control_5_allowed: bool,
    /// `VelDiv4` (later firmware): the velocity is to be multiplied by 4.
    pub velocity_divided: bool,
    /// `PosDiv8` (later firmware): the position is to be multiplied by 8.
    pub position_divided: bool,
}

impl Status2 {
    /// Reads the frame's data; `None` unless it has exactly 8 bytes.
    #[must_use]
    pub fn parse(frame: &Frame) -> Option<Self> {
        let [p0, p1, p2, v0, v1, current, sticky, flags] = *frame.exact::<8>()?;
        Some(Self {
            position: i24(p0, p1, p2),
            velocity: i16::from_be_bytes([v0, v1]),
            current: u16::from(current) << 2 | u16::from(sticky >> 6),
            sticky: Sticky {
                over_temperature: bit(sticky, 5),
                under_voltage: bit(sticky, 4),
                forward_limit: bit(sticky, 3),
                reverse_limit: bit(sticky, 2),
                forward_soft: bit(sticky, 1),
                reverse_soft: bit(sticky, 0),
            },
            slot_1: bit(flags, 6),
            brake: bit(flags, 7),
            control_5_allowed: bit(flags, 3),
            velocity_divided: bit(flags, 4),
            position_divided: bit(flags, 5),
        })
    }

    /// The frame of device `number`. The position saturates at 24 bits, the current at 10.
    #[must_use]
    pub const fn emit(&self, number: u8) -> Frame {
        let [p0, p1, p2] = i24_bytes(self.position);
        let [v0, v1] = self.velocity.to_be_bytes();
        let current = if self.current > 0x3FF {
            0x3FF
        } else {
            self.current
        };
        let faults = &self.sticky;
        let sticky = flag(faults.reverse_soft, 0)
            | flag(faults.forward_soft, 1)
            | flag(faults.reverse_limit, 2)
            | flag(faults.forward_limit, 3)
            | flag(faults.under_voltage, 4)
            | flag(faults.over_temperature, 5)
            | ((current & 3) as u8) << 6;
        let flags = flag(self.control_5_allowed, 3)
            | flag(self.velocity_divided, 4)
            | flag(self.position_divided, 5)
            | flag(self.slot_1, 6)
            | flag(self.brake, 7);
        Frame::extended(
            with_number(id::STATUS_2, number),
            [p0, p1, p2, v0, v1, (current >> 2) as u8, sticky, flags],
        )
    }
}

/// Status_3, quadrature encoder (8 bytes). Raw: neither selection nor reversal touch it.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Status3 {
    /// `EncPosition`, signed 24 bits, four counts per cycle.
    pub position: i32,
    /// `EncVel`, counts per 100 ms.
    pub velocity: i16,
    /// `IndexRiseEvents`, wrapping.
    pub index_rises: u16,
    /// Quadrature A reads high.
    pub pin_a: bool,
    /// Quadrature B reads high.
    pub pin_b: bool,
    /// The index pin reads high.
    pub pin_index: bool,
}

impl Status3 {
    /// Reads the frame's data; `None` unless it has exactly 8 bytes.
    #[must_use]
    pub fn parse(frame: &Frame) -> Option<Self> {
        let [p0, p1, p2, v0, v1, r0, r1, flags] = *frame.exact::<8>()?;
        Some(Self {
            position: i24(p0, p1, p2),
            velocity: i16::from_be_bytes([v0, v1]),
            index_rises: u16::from_be_bytes([r0, r1]),
            pin_a: bit(flags, 7),
            pin_b: bit(flags, 6),
            pin_index: bit(flags, 5),
        })
    }

    /// The frame of device `number`. The position saturates at 24 bits.
    #[must_use]
    pub const fn emit(&self, number: u8) -> Frame {
        let [p0, p1, p2] = i24_bytes(self.position);
        let [v0, v1] = self.velocity.to_be_bytes();
        let [r0, r1] = self.index_rises.to_be_bytes();
        let flags = flag(self.pin_a, 7) | flag(self.pin_b, 6) | flag(self.pin_index, 5);
        Frame::extended(
            with_number(id::STATUS_3, number),
            [p0, p1, p2, v0, v1, r0, r1, flags],
        )
    }
}

/// Status_4, analog input, temperature and battery voltage (8 bytes).
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Status4 {
    /// `AnalogInWithOv`, signed 24 bits: the low 10 bits are the conversion, the others count overflows.
    pub position: i32,
    /// `AnalogInVel`, units per 100 ms.
    pub velocity: i16,
    /// `Temp`, see [`super::temperature`].
    pub temperature: u8,
    /// `BatteryV`, see [`super::battery`].
    pub battery: u8,
}

impl Status4 {
    /// Reads the frame's data; `None` unless it has exactly 8 bytes. The eighth is reserved.
    #[must_use]
    pub fn parse(frame: &Frame) -> Option<Self> {
        let [p0, p1, p2, v0, v1, temperature, battery, _] = *frame.exact::<8>()?;
        Some(Self {
            position: i24(p0, p1, p2),
            velocity: i16::from_be_bytes([v0, v1]),
            temperature,
            battery,
        })
    }

    /// The frame of device `number`. The position saturates at 24 bits.
    #[must_use]
    pub const fn emit(&self, number: u8) -> Frame {
        let [p0, p1, p2] = i24_bytes(self.position);
        let [v0, v1] = self.velocity.to_be_bytes();
        Frame::extended(
            with_number(id::STATUS_4, number),
            [p0, p1, p2, v0, v1, self.temperature, self.battery, 0],
        )
    }
}

/// Status_5, start-up (6 bytes): sent once after a reset.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Status5 {
    /// `ResetCount`.
    pub reset_count: u16,
    /// `ResetFlags`.
    pub reset_flags: u16,
    /// Firmware version, major and minor; 255 and 255 while there is no application (manual 2.3.2).
    pub version: [u8; 2],
}

impl Status5 {
    /// Reads the frame's data; `None` unless it has exactly 6 bytes.
    #[must_use]
    pub fn parse(frame: &Frame) -> Option<Self> {
        let [c0, c1, f0, f1, major, minor] = *frame.exact::<6>()?;
        Some(Self {
            reset_count: u16::from_be_bytes([c0, c1]),
            reset_flags: u16::from_be_bytes([f0, f1]),
            version: [major, minor],
        })
    }

    /// The frame of device `number`.
    #[must_use]
    pub const fn emit(&self, number: u8) -> Frame {
        let [c0, c1] = self.reset_count.to_be_bytes();
        let [f0, f1] = self.reset_flags.to_be_bytes();
        let [major, minor] = self.version;
        Frame::extended(
            with_number(id::STATUS_5, number),
            [c0, c1, f0, f1, major, minor],
        )
    }
}

/// Status_6, raw conversions (8 bytes), 10 bits each. Off by default.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Status6 {
    /// Current.
    pub current: u16,
    /// Level of the chip select pin.
    pub chip_select: bool,
    /// Temperature.
    pub temperature: u16,
    /// Battery voltage.
    pub battery: u16,
    /// Analog input.
    pub analog: u16,
}

impl Status6 {
    /// Reads the frame's data; `None` unless it has exactly 8 bytes.
    #[must_use]
    pub fn parse(frame: &Frame) -> Option<Self> {
        let [c0, c1, t0, t1, b0, b1, a0, a1] = *frame.exact::<8>()?;
        Some(Self {
            current: u10(c0, c1),
            chip_select: bit(c0, 7),
            temperature: u10(t0, t1),
            battery: u10(b0, b1),
            analog: u10(a0, a1),
        })
    }

    /// The frame of device `number`. Conversions saturate at 10 bits.
    #[must_use]
    pub const fn emit(&self, number: u8) -> Frame {
        let [c0, c1] = u10_bytes(self.current);
        let [t0, t1] = u10_bytes(self.temperature);
        let [b0, b1] = u10_bytes(self.battery);
        let [a0, a1] = u10_bytes(self.analog);
        Frame::extended(
            with_number(id::STATUS_6, number),
            [c0 | flag(self.chip_select, 7), c1, t0, t1, b0, b1, a0, a1],
        )
    }
}

/// Status_7, counters of tokens (6 bytes). Off by default.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Status7 {
    /// Tokens that failed.
    pub failures: u16,
    /// The last token that failed.
    pub last_failed: u16,
    /// Tokens that were accepted.
    pub successes: u16,
}

impl Status7 {
    /// Reads the frame's data; `None` unless it has exactly 6 bytes.
    #[must_use]
    pub fn parse(frame: &Frame) -> Option<Self> {
        let [f0, f1, l0, l1, s0, s1] = *frame.exact::<6>()?;
        Some(Self {
            failures: u16::from_be_bytes([f0, f1]),
            last_failed: u16::from_be_bytes([l0, l1]),
            successes: u16::from_be_bytes([s0, s1]),
        })
    }

    /// The frame of device `number`.
    #[must_use]
    pub const fn emit(&self, number: u8) -> Frame {
        let [f0, f1] = self.failures.to_be_bytes();
        let [l0, l1] = self.last_failed.to_be_bytes();
        let [s0, s1] = self.successes.to_be_bytes();
        Frame::extended(with_number(id::STATUS_7, number), [f0, f1, l0, l1, s0, s1])
    }
}
