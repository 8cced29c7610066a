//! One Talon: what the robot's program reads (manual 5, 14).

use windlass_core::dialect::talon_srx::wire::{
    self, FeedbackDevice, LiveFaults, ModeSelect, Status1, Status2, Status3, Status4, Status5,
    Sticky,
};

use super::status::{Stamped, reading};
use super::{CanTalon, Reading, TalonStatus, units};
use crate::transport::Bus;

/// Bits of the fault words, as in `CANSpeedController` of the published clients.
pub mod fault {
    /// `kTemperatureFault`.
    pub const TEMPERATURE: u16 = 0x02;
    /// `kBusVoltageFault`.
    pub const BUS_VOLTAGE: u16 = 0x04;
    /// `kFwdLimitSwitch`.
    pub const FORWARD_LIMIT_SWITCH: u16 = 0x10;
    /// `kRevLimitSwitch`.
    pub const REVERSE_LIMIT_SWITCH: u16 = 0x20;
    /// `kFwdSoftLimit`.
    pub const FORWARD_SOFT_LIMIT: u16 = 0x40;
    /// `kRevSoftLimit`.
    pub const REVERSE_SOFT_LIMIT: u16 = 0x80;
}

/// A fault word, see [`fault`].
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct FaultBits(pub u16);

impl FaultBits {
    /// Names as the manual's self-test and examples use them, with their bits.
    const NAMES: [(u16, &'static str); 6] = [
        (fault::TEMPERATURE, "Over Temp"),
        (fault::BUS_VOLTAGE, "Under Vbat"),
        (fault::FORWARD_LIMIT_SWITCH, "Fwd. Limit Switch"),
        (fault::REVERSE_LIMIT_SWITCH, "Rev. Limit Switch"),
        (fault::FORWARD_SOFT_LIMIT, "Fwd. Soft Limit"),
        (fault::REVERSE_SOFT_LIMIT, "Rev. Soft Limit"),
    ];

    /// True if no fault is set.
    #[must_use]
    pub const fn is_empty(self) -> bool {
        self.0 == 0
    }

    /// The faults that are set, as words.
    pub fn names(self) -> impl Iterator<Item = &'static str> {
        Self::NAMES
            .into_iter()
            .filter(move |(bit, _)| self.0 & bit != 0)
            .map(|(_, name)| name)
    }

    const fn of(faults: [bool; 6]) -> Self {
        let [
            temperature,
            voltage,
            forward,
            reverse,
            forward_soft,
            reverse_soft,
        ] = faults;
        Self(
            (temperature as u16) << 1
                | (voltage as u16) << 2
                | (forward as u16) << 4
                | (reverse as u16) << 5
                | (forward_soft as u16) << 6
                | (reverse_soft as u16) << 7,
        )
    }
}

impl From<LiveFaults> for FaultBits {
    fn from(live: LiveFaults) -> Self {
        Self::of([
            live.over_temperature,
            live.under_voltage,
            live.forward_limit,
            live.reverse_limit,
            live.forward_soft,
            live.reverse_soft,
        ])
    }
}

impl From<Sticky> for FaultBits {
    fn from(sticky: Sticky) -> Self {
        Self::of([
            sticky.over_temperature,
            sticky.under_voltage,
            sticky.forward_limit,
            sticky.reverse_limit,
            sticky.forward_soft,
            sticky.reverse_soft,
        ])
    }
}

impl TalonStatus {
    /// Position of the selected sensor with the later firmware's divider undone.
    pub(super) const fn position(status: Status2) -> i32 {
        status.position * if status.position_divided { 8 } else { 1 }
    }

    /// Velocity of the selected sensor with the later firmware's divider undone.
    pub(super) const fn velocity(status: Status2) -> i32 {
        status.velocity as i32 * if status.velocity_divided { 4 } else { 1 }
    }
}

impl<B: Bus> CanTalon<B> {
    fn read<T: Copy, U: Default>(
        &self,
        what: &'static str,
        frame: impl FnOnce(&TalonStatus) -> Option<Stamped<T>>,
        value: impl FnOnce(T) -> U,
    ) -> Reading<U> {
        let shared = self.shared.borrow();
        let frame = frame(shared.status(self.number));
        reading(self.number, shared.now(), what, frame, value)
    }

    fn general<U: Default>(&self, value: impl FnOnce(Status1) -> U) -> Reading<U> {
        self.read("its general status", |status| status.general, value)
    }

    fn feedback<U: Default>(&self, value: impl FnOnce(Status2) -> U) -> Reading<U> {
        self.read("its feedback status", |status| status.feedback, value)
    }

    fn encoder<U: Default>(&self, value: impl FnOnce(Status3) -> U) -> Reading<U> {
        self.read("its encoder status", |status| status.encoder, value)
    }

    fn analog<U: Default>(&self, value: impl FnOnce(Status4) -> U) -> Reading<U> {
        self.read("its analog status", |status| status.analog, value)
    }

    /// Everything last reported.
    #[must_use]
    pub fn status(&self) -> TalonStatus {
        self.shared.borrow().status(self.number).clone()
    }

    /// Applied throttle, −1023 to 1023, whatever the mode.
    #[must_use]
    pub fn applied_throttle(&self) -> Reading<i16> {
        self.general(|general| general.throttle)
    }

    /// Target minus measured value of the closed loop, in sensor units.
    #[must_use]
    pub fn closed_loop_error(&self) -> Reading<i32> {
        self.general(|general| general.error)
    }

    /// The mode in force.
    #[must_use]
    pub fn mode(&self) -> Reading<ModeSelect> {
        self.general(|general| general.mode)
    }

    /// The sensor in force.
    #[must_use]
    pub fn feedback_device(&self) -> Reading<FeedbackDevice> {
        self.general(|general| general.feedback)
    }

    /// True while the device accepts to be driven.
    #[must_use]
    pub fn is_enabled(&self) -> Reading<bool> {
        self.general(|general| general.token_locked)
    }

    /// True if the forward limit switch connects its pin to ground, even if the switch is not used.
    #[must_use]
    pub fn is_fwd_limit_switch_closed(&self) -> Reading<bool> {
        self.general(|general| general.forward_closed)
    }

    /// True if the reverse limit switch connects its pin to ground, even if the switch is not used.
    #[must_use]
    pub fn is_rev_limit_switch_closed(&self) -> Reading<bool> {
        self.general(|general| general.reverse_closed)
    }

    /// True if neither a limit switch nor a soft limit refuses to drive forward.
    #[must_use]
    pub fn forward_limit_ok(&self) -> Reading<bool> {
        let blocked = fault::FORWARD_LIMIT_SWITCH | fault::FORWARD_SOFT_LIMIT;
        self.faults().map(|faults| faults.0 & blocked == 0)
    }

    /// True if neither a limit switch nor a soft limit refuses to drive in reverse.
    #[must_use]
    pub fn reverse_limit_ok(&self) -> Reading<bool> {
        let blocked = fault::REVERSE_LIMIT_SWITCH | fault::REVERSE_SOFT_LIMIT;
        self.faults().map(|faults| faults.0 & blocked == 0)
    }

    /// Faults that are present.
    #[must_use]
    pub fn faults(&self) -> Reading<FaultBits> {
        self.general(|general| general.faults.into())
    }

    /// True if the device reports a hardware failure, which has no place in the fault words.
    #[must_use]
    pub fn hardware_failure(&self) -> Reading<bool> {
        self.general(|general| general.faults.hardware)
    }

    /// Faults that have been present since they were last cleared; they survive power cycles.
    #[must_use]
    pub fn sticky_faults(&self) -> Reading<FaultBits> {
        self.feedback(|feedback| feedback.sticky.into())
    }

    /// Position of the selected sensor in its units.
    #[must_use]
    pub fn position(&self) -> Reading<i32> {
        self.feedback(TalonStatus::position)
    }

    /// Velocity of the selected sensor in its units per 100 ms.
    #[must_use]
    pub fn speed(&self) -> Reading<i32> {
        self.feedback(TalonStatus::velocity)
    }

    /// Motor current in amperes.
    #[must_use]
    pub fn output_current(&self) -> Reading<f64> {
        self.feedback(|feedback| wire::current(feedback.current).to_num())
    }

    /// The motor control profile in force, 0 or 1.
    #[must_use]
    pub fn profile_slot(&self) -> Reading<u8> {
        self.feedback(|feedback| u8::from(feedback.slot_1))
    }

    /// True if neutral brakes, false if it coasts.
    #[must_use]
    pub fn brake_enable_during_neutral(&self) -> Reading<bool> {
        self.feedback(|feedback| feedback.brake)
    }

    /// Position of the quadrature encoder, whatever sensor is selected and never turned round.
    #[must_use]
    pub fn enc_position(&self) -> Reading<i32> {
        self.encoder(|encoder| encoder.position)
    }

    /// Velocity of the quadrature encoder in counts per 100 ms.
    #[must_use]
    pub fn enc_vel(&self) -> Reading<i32> {
        self.encoder(|encoder| i32::from(encoder.velocity))
    }

    /// Rising edges of the index pin, modulo 65536.
    #[must_use]
    pub fn number_of_quad_idx_rises(&self) -> Reading<u16> {
        self.encoder(|encoder| encoder.index_rises)
    }

    /// Levels of the pins quadrature A, B and index.
    #[must_use]
    pub fn quadrature_pins(&self) -> Reading<(bool, bool, bool)> {
        self.encoder(|encoder| (encoder.pin_a, encoder.pin_b, encoder.pin_index))
    }

    /// Analog position with its overflows: the analog encoder's.
    #[must_use]
    pub fn analog_in(&self) -> Reading<i32> {
        self.analog(|analog| analog.position)
    }

    /// The analog input's conversion, 0 to 1023 for 0 to 3.3 V (manual 16.18).
    #[must_use]
    pub fn analog_in_raw(&self) -> Reading<u16> {
        self.analog(|analog| (analog.position & 0x3FF) as u16)
    }

    /// Velocity of the analog input in units per 100 ms.
    #[must_use]
    pub fn analog_in_vel(&self) -> Reading<i32> {
        self.analog(|analog| i32::from(analog.velocity))
    }

    /// Battery voltage in volts.
    #[must_use]
    pub fn bus_voltage(&self) -> Reading<f64> {
        self.analog(|analog| wire::battery(analog.battery).to_num())
    }

    /// Temperature in degrees Celsius.
    #[must_use]
    pub fn temperature(&self) -> Reading<f64> {
        self.analog(|analog| wire::temperature(analog.temperature).to_num())
    }

    /// Voltage at the motor: battery voltage times applied throttle. It is as old as the older of both.
    #[must_use]
    pub fn output_voltage(&self) -> Reading<f64> {
        let (throttle, bus) = (self.applied_throttle(), self.bus_voltage());
        let volts = bus.value * units::share(throttle.value);
        let older = if throttle.age.is_none() || throttle.age > bus.age && bus.age.is_some() {
            throttle.map(|_| 0.0)
        } else {
            bus
        };
        older.map(|_| volts)
    }

    /// Resets since the first power-on, and the firmware's version, as told after the latest reset.
    #[must_use]
    pub fn start_up(&self) -> Option<Status5> {
        let shared = self.shared.borrow();
        shared
            .status(self.number)
            .start_up
            .map(|stamped| stamped.value)
    }
}
