//! Control frames, host to controller.

use super::{BrakeOverride, FeedbackDevice, LimitOverride, ModeSelect, id};
use crate::field::{bit, flag, i24_bytes};
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

/// Bytes 2 to 7 of Control_1 and Control_5 as they came: a controller keeps what it was told, and most of it is
/// asked for only when it is shown.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct RawGeneral {
    /// Bytes 0 to 3 of the frame, the first one lowest: two bytes of its own and the upper ones of the demand.
    start: u32,
    /// Low byte of the demand, select, options, ramp.
    end: u32,
}

impl RawGeneral {
    /// What stands in the frame's data; `None` unless it has exactly 8 bytes.
    #[must_use]
    #[inline]
    pub fn read(frame: &Frame) -> Option<Self> {
        let [start, end] = frame.words()?;
        Some(Self { start, end })
    }

    /// See [`General::demand`].
    #[must_use]
    pub const fn demand(self) -> i32 {
        // The high bytes stand the other way round.
        let high = self.start.swap_bytes() as i16 as i32;
        high << 8 | (self.end & 0xFF) as i32
    }

    const fn select(self) -> u8 {
        (self.end >> 8) as u8
    }

    const fn options(self) -> u8 {
        (self.end >> 16) as u8
    }

    /// See [`General::slot_1`].
    #[must_use]
    pub const fn slot_1(self) -> bool {
        bit(self.select(), 0)
    }

    /// See [`General::feedback`].
    #[must_use]
    pub const fn feedback(self) -> FeedbackDevice {
        FeedbackDevice::from_code(self.select() >> 1)
    }

    /// See [`General::limits`].
    #[must_use]
    pub const fn limits(self) -> LimitOverride {
        LimitOverride::from_code(self.select() >> 5)
    }

    /// See [`General::reverse_sensor`].
    #[must_use]
    pub const fn reverse_sensor(self) -> bool {
        bit(self.options(), 0)
    }

    /// See [`General::reverse_output`].
    #[must_use]
    pub const fn reverse_output(self) -> bool {
        bit(self.options(), 1)
    }

    /// See [`General::brake`].
    #[must_use]
    pub const fn brake(self) -> BrakeOverride {
        BrakeOverride::from_code(self.options() >> 2)
    }

    /// See [`General::mode`].
    #[must_use]
    pub const fn mode(self) -> ModeSelect {
        ModeSelect::from_code(self.options() >> 4)
    }

    /// See [`General::ramp`].
    #[must_use]
    pub const fn ramp(self) -> u8 {
        (self.end >> 24) as u8
    }
}

impl Default for RawGeneral {
    /// What [`General::default`] says.
    fn default() -> Self {
        General::default().raw()
    }
}

impl From<RawGeneral> for General {
    fn from(raw: RawGeneral) -> Self {
        Self {
            demand: raw.demand(),
            slot_1: raw.slot_1(),
            feedback: raw.feedback(),
            limits: raw.limits(),
            reverse_sensor: raw.reverse_sensor(),
            reverse_output: raw.reverse_output(),
            brake: raw.brake(),
            mode: raw.mode(),
            ramp: raw.ramp(),
        }
    }
}

impl General {
    /// As it stands in a frame. The demand saturates at 24 bits.
    #[must_use]
    pub const fn raw(&self) -> RawGeneral {
        let [high, middle, low, select, options, ramp] = self.emit();
        RawGeneral {
            start: u32::from_le_bytes([0, 0, high, middle]),
            end: u32::from_le_bytes([low, select, options, ramp]),
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
        let general = RawGeneral::read(frame);
        if general.is_none() {
            frame.exact::<2>()?;
        }
        let [t0, t1, ..] = *frame.bytes();
        Some(Self {
            token: u16::from_be_bytes([t0, t1]),
            general: general.map(General::from),
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
        let general = RawGeneral::read(frame)?.into();
        let [high, low, ..] = *frame.bytes();
        let bump = u16::from(high & 7) << 8 | u16::from(low);
        Some(Self { bump, general })
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
