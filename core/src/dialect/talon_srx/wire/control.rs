//! Control frames, host to controller.

use super::{BrakeOverride, FeedbackDevice, LimitOverride, ModeSelect, id};
use crate::field::{bit, flag, i24, i24_bytes};
use crate::frame::Frame;
use crate::frc_id::with_number;

/// What Control_1 and Control_5 have in common: bytes 2 to 7.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct General {
    /// Signed 24 bits; by mode a throttle (±1023), a position, a velocity or a device number.
    pub demand: i32,
    /// `ProfileSlotSelect`: true selects slot 1.
    pub slot_1: bool,
    /// `FeedbackDeviceSelect`.
    pub feedback: FeedbackDevice,
    /// `OverrideLimitSwitchEn`.
    pub limits: LimitOverride,
    /// `RevFeedbackSensor`.
    pub reverse_sensor: bool,
    /// `RevMotDuringCloseLoopEn`: turns the output of closed loops and of following.
    pub reverse_output: bool,
    /// `OverrideBrakeType`.
    pub brake: BrakeOverride,
    /// `ModeSelect`.
    pub mode: ModeSelect,
    /// `RampThrottle`: throttle units per 10 ms, 0 = at once.
    pub ramp: u8,
}

impl General {
    // Not inlined: both frames that carry it would have a copy.
    #[inline(never)]
    const fn parse([high, middle, low, select, options, ramp]: [u8; 6]) -> Self {
        Self {
            demand: i24(high, middle, low),
            slot_1: bit(select, 0),
            feedback: FeedbackDevice::from_code(select >> 1),
            limits: LimitOverride::from_code(select >> 5),
            reverse_sensor: bit(options, 0),
            reverse_output: bit(options, 1),
            brake: BrakeOverride::from_code(options >> 2),
            mode: ModeSelect::from_code(options >> 4),
            ramp,
        }
    }

    const fn emit(&self) -> [u8; 6] {
        let [high, middle, low] = i24_bytes(self.demand);
        let select = flag(self.slot_1, 0) | self.feedback.code() << 1 | self.limits.code() << 5;
        let options = flag(self.reverse_sensor, 0)
            | flag(self.reverse_output, 1)
            | self.brake.code() << 2
            | self.mode.code() << 4;
        [high, middle, low, select, options, self.ramp]
    }
}

/// Control_1: enables, and in its long form tells what to do.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Control1 {
    /// `TokenH`, `TokenL`. Not checked: the algorithm is not public.
    pub token: u16,
    /// What to do (8 bytes); nothing in the short form of 2 bytes, which only enables.
    pub general: Option<General>,
}

impl Control1 {
    /// Reads the frame's data; `None` unless it has 8 or 2 bytes.
    #[must_use]
    pub fn parse(frame: &Frame) -> Option<Self> {
        if let Some([t0, t1, rest @ ..]) = frame.exact::<8>() {
            let general = Some(General::parse(*rest));
            return Some(Self {
                token: u16::from_be_bytes([*t0, *t1]),
                general,
            });
        }
        let token = u16::from_be_bytes(*frame.exact::<2>()?);
        Some(Self {
            token,
            general: None,
        })
    }

    /// The frame for device `number`. The demand saturates at 24 bits.
    #[must_use]
    pub const fn emit(&self, number: u8) -> Frame {
        let id = with_number(id::CONTROL_1, number);
        let [t0, t1] = self.token.to_be_bytes();
        match &self.general {
            Some(general) => {
                let [a, b, c, d, e, f] = general.emit();
                Frame::extended(id, [t0, t1, a, b, c, d, e, f])
            }
            None => Frame::extended(id, [t0, t1]),
        }
    }
}

/// Control_5: what to do, without enabling (8 bytes).
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Control5 {
    /// `ThrottleBump`, 11 bits; clients send 0, and nothing is done with it.
    pub bump: u16,
    /// What to do.
    pub general: General,
}

impl Control5 {
    /// Reads the frame's data; `None` unless it has exactly 8 bytes.
    #[must_use]
    pub fn parse(frame: &Frame) -> Option<Self> {
        let [high, low, rest @ ..] = frame.exact::<8>()?;
        let bump = u16::from(high & 7) << 8 | u16::from(*low);
        Some(Self {
            bump,
            general: General::parse(*rest),
        })
    }

    /// The frame for device `number`. The demand saturates at 24 bits, the bump at 11.
    #[must_use]
    pub const fn emit(&self, number: u8) -> Frame {
        let bump = if self.bump > 0x7FF { 0x7FF } else { self.bump };
        let [high, low] = bump.to_be_bytes();
        let [a, b, c, d, e, f] = self.general.emit();
        Frame::extended(
            with_number(id::CONTROL_5, number),
            [high, low, a, b, c, d, e, f],
        )
    }
}

/// Control_2: periods of Status_1 to Status_4 in ms (4 bytes). 0 leaves a period as it is.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Control2 {
    /// Periods of Status_1, 2, 3 and 4.
    pub periods: [u8; 4],
}

impl Control2 {
    /// Reads the frame's data; `None` unless it has exactly 4 bytes.
    #[must_use]
    pub fn parse(frame: &Frame) -> Option<Self> {
        Some(Self {
            periods: *frame.exact::<4>()?,
        })
    }

    /// The frame for device `number`.
    #[must_use]
    pub const fn emit(&self, number: u8) -> Frame {
        Frame::extended(with_number(id::CONTROL_2, number), self.periods)
    }
}

/// Control_3: clears flags, once per frame (1 to 8 bytes, of which the first counts; emitted with 4).
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Control3 {
    /// `ZeroFeedbackSensor`: the selected sensor's position becomes 0.
    pub zero_sensor: bool,
    /// `ClearStickyFaults`.
    pub clear_sticky: bool,
}

impl Control3 {
    /// Reads the frame's data; `None` if there is none.
    #[must_use]
    pub fn parse(frame: &Frame) -> Option<Self> {
        let flags = *frame.data().first()?;
        Some(Self {
            zero_sensor: bit(flags, 0),
            clear_sticky: bit(flags, 1),
        })
    }

    /// The frame for device `number`.
    #[must_use]
    pub const fn emit(&self, number: u8) -> Frame {
        let flags = flag(self.zero_sensor, 0) | flag(self.clear_sticky, 1);
        Frame::extended(with_number(id::CONTROL_3, number), [flags, 0, 0, 0])
    }
}

/// Global enable: speaks to every controller (1 to 8 bytes, of which the first counts; emitted with 8).
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct GlobalEnable {
    /// Controllers may drive for another 100 ms; false stops all of them at once.
    pub enabled: bool,
}

impl GlobalEnable {
    /// Reads the frame's data; `None` if there is none.
    #[must_use]
    pub fn parse(frame: &Frame) -> Option<Self> {
        Some(Self {
            enabled: bit(*frame.data().first()?, 0),
        })
    }

    /// The frame.
    #[must_use]
    pub const fn emit(&self) -> Frame {
        Frame::extended(
            id::GLOBAL_ENABLE,
            [flag(self.enabled, 0), 0, 0, 0, 0, 0, 0, 0],
        )
    }
}
