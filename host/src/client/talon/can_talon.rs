//! One Talon: what the robot's program sets.

use std::cell::RefCell;
use std::rc::Rc;
use std::time::Duration;

use windlass_core::dialect::talon_srx::wire::{
    BrakeOverride, Control2, Control3, FeedbackDevice, General, LimitOverride, MAX_DEVICE_NUMBER,
    ModeSelect, Parameter,
};

use super::robot::{Motor, Shared};
use super::{TalonError, units};
use crate::transport::Bus;

/// What a set point means (manual 10, 17).
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum ControlMode {
    /// Share of full throttle, −1 to 1.
    PercentVbus,
    /// Position of the selected sensor in its units.
    Position,
    /// Velocity of the selected sensor in its units per 100 ms.
    Speed,
    /// Volts. Firmware 1.1 does not support it (manual 21.1): neutral.
    Voltage,
    /// Number of the Talon that is followed.
    Follower,
}

impl ControlMode {
    const fn select(self) -> ModeSelect {
        match self {
            Self::PercentVbus => ModeSelect::Duty,
            Self::Position => ModeSelect::Position,
            Self::Speed => ModeSelect::Velocity,
            Self::Voltage => ModeSelect::VoltageCompensation,
            Self::Follower => ModeSelect::Follower,
        }
    }

    fn demand(self, value: f64) -> Result<i32, TalonError> {
        match self {
            Self::PercentVbus => Ok(units::duty(value)),
            Self::Position | Self::Speed => units::sensor_demand(value),
            Self::Voltage => units::voltage_demand(value),
            Self::Follower => {
                if (0.0..=f64::from(MAX_DEVICE_NUMBER)).contains(&value) {
                    return Ok(value as i32);
                }
                Err(TalonError::invalid(format!(
                    "master {value} is out of range; allowed: 0 to {MAX_DEVICE_NUMBER}"
                )))
            }
        }
    }
}

/// What neutral does (manual 4.3.2).
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum NeutralMode {
    /// As stored in the device.
    Jumper,
    /// Brake.
    Brake,
    /// Coast.
    Coast,
}

/// Which limits are used (manual 8.2).
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum LimitMode {
    /// Limit switches, no soft limits.
    SwitchInputsOnly,
    /// Limit switches and soft limits.
    SoftPositionLimits,
    /// Neither.
    DisableSwitchInputs,
}

/// A periodic status frame (manual 20.5).
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum StatusFrame {
    /// Throttle, faults, mode, error; 10 ms.
    General,
    /// Selected sensor, current, sticky faults; 20 ms.
    Feedback,
    /// Quadrature encoder; 100 ms.
    QuadEncoder,
    /// Analog input, temperature, battery; 100 ms.
    AnalogTempVbat,
}

/// One Talon on the bus of a [`Robot`](super::Robot).
///
/// What is set is sent at once if the robot is enabled, and again with every control frame; while it is
/// disabled it waits for the first control frame after enabling (manual 16.2).
#[derive(Debug)]
pub struct CanTalon<B> {
    pub(super) shared: Rc<RefCell<Shared<B>>>,
    pub(super) number: u8,
}

impl<B> Clone for CanTalon<B> {
    fn clone(&self) -> Self {
        Self {
            shared: Rc::clone(&self.shared),
            number: self.number,
        }
    }
}

impl<B: Bus> CanTalon<B> {
    pub(super) const fn new(shared: Rc<RefCell<Shared<B>>>, number: u8) -> Self {
        Self { shared, number }
    }

    /// Device number, 0 to 62.
    #[must_use]
    pub const fn device_id(&self) -> u8 {
        self.number
    }

    /// Works on this Talon's motor; it exists since the handle was made and stays for good.
    fn motor<T>(&self, work: impl FnOnce(&mut Motor, Duration) -> T) -> Option<T> {
        let mut shared = self.shared.borrow_mut();
        let now = shared.now();
        shared
            .motors
            .get_mut(&self.number)
            .map(|motor| work(motor, now))
    }

    /// Changes the control frame and sends it.
    fn change(&self, change: impl FnOnce(&mut General)) -> Result<(), TalonError> {
        self.motor(|motor, _| change(&mut motor.control));
        Ok(self.shared.borrow_mut().flush(self.number)?)
    }

    /// Gives a new set point in the unit of the control mode, and feeds motor safety. After motor safety or
    /// [`CanTalon::disable`] it drives nothing until [`CanTalon::enable_control`].
    ///
    /// As the published clients do, the demand goes out first and the mode after it.
    ///
    /// # Errors
    /// The value does not fit the mode, or the bus failed.
    pub fn set(&self, value: f64) -> Result<(), TalonError> {
        let mode = self.motor(|motor, now| {
            motor.safety.feed(now);
            motor.control_enabled.then_some(motor.mode)
        });
        let Some(Some(mode)) = mode else {
            return Ok(());
        };
        let demand = mode.demand(value)?;
        self.motor(|motor, _| motor.set_point = value);
        // A new mode is "No Drive" until here, so the demand is never taken in the unit of the one before.
        self.change(|control| control.demand = demand)?;
        let driving = self.motor(|motor, _| motor.control.mode == mode.select());
        if driving != Some(true) {
            self.change(|control| control.mode = mode.select())?;
        }
        Ok(())
    }

    /// The last set point.
    #[must_use]
    pub fn get(&self) -> f64 {
        self.motor(|motor, _| motor.set_point).unwrap_or_default()
    }

    /// Chooses what set points mean. A change of the mode drives nothing until the next
    /// [`CanTalon::set`] (manual 16.12); the present mode again changes nothing.
    ///
    /// # Errors
    /// The bus failed.
    pub fn set_control_mode(&self, mode: ControlMode) -> Result<(), TalonError> {
        let changed = self.motor(|motor, _| {
            let changed = motor.mode != mode;
            motor.mode = mode;
            changed
        });
        if changed == Some(true) {
            self.change(|control| control.mode = ModeSelect::NoDrive)?;
        }
        Ok(())
    }

    /// The control mode of the next set point.
    #[must_use]
    pub fn control_mode(&self) -> ControlMode {
        self.motor(|motor, _| motor.mode)
            .unwrap_or(ControlMode::PercentVbus)
    }

    /// Allows to drive again after motor safety or [`CanTalon::disable`]; the drive begins with the next
    /// [`CanTalon::set`] (manual 19.1).
    pub fn enable_control(&self) {
        self.motor(|motor, now| {
            motor.control_enabled = true;
            motor.safety.feed(now);
        });
    }

    /// Ends the drive (mode "No Drive") until [`CanTalon::enable_control`].
    ///
    /// # Errors
    /// The bus failed.
    pub fn disable(&self) -> Result<(), TalonError> {
        self.motor(|motor, _| motor.stop());
        Ok(self.shared.borrow_mut().flush(self.number)?)
    }

    /// False after motor safety or [`CanTalon::disable`].
    #[must_use]
    pub fn is_control_enabled(&self) -> bool {
        self.motor(|motor, _| motor.control_enabled) == Some(true)
    }

    /// Switches motor safety on or off; it is off at first (manual 19).
    pub fn set_safety_enabled(&self, enabled: bool) {
        self.motor(|motor, now| motor.safety.set_enabled(enabled, now));
    }

    /// Whether motor safety is on.
    #[must_use]
    pub fn is_safety_enabled(&self) -> bool {
        self.motor(|motor, _| motor.safety.is_enabled()) == Some(true)
    }

    /// Time without a set point after which motor safety ends the drive; 100 ms at first.
    pub fn set_expiration(&self, expiration: Duration) {
        self.motor(|motor, _| motor.safety.set_expiration(expiration));
    }

    /// The expiration time of motor safety.
    #[must_use]
    pub fn expiration(&self) -> Duration {
        self.motor(|motor, _| motor.safety.expiration())
            .unwrap_or_default()
    }

    /// How often motor safety has ended the drive (the driver station's "Output not updated often enough").
    #[must_use]
    pub fn expirations(&self) -> u32 {
        self.motor(|motor, _| motor.expirations).unwrap_or_default()
    }

    /// Selects the sensor of closed loops and soft limits (manual 7).
    ///
    /// # Errors
    /// The bus failed.
    pub fn set_feedback_device(&self, device: FeedbackDevice) -> Result<(), TalonError> {
        self.change(|control| control.feedback = device)
    }

    /// True turns the selected sensor's position and velocity round (manual 7.2, `reverseSensor` in Java).
    ///
    /// # Errors
    /// The bus failed.
    pub fn set_sensor_direction(&self, reversed: bool) -> Result<(), TalonError> {
        self.change(|control| control.reverse_sensor = reversed)
    }

    /// True turns the output of closed loops and of following round (manual 7.3, 9.4).
    ///
    /// # Errors
    /// The bus failed.
    pub fn reverse_output(&self, reversed: bool) -> Result<(), TalonError> {
        self.change(|control| control.reverse_output = reversed)
    }

    /// Largest change of the output in volts per second of a 12 V battery, in every mode; 0 for none
    /// (manual 6).
    ///
    /// # Errors
    /// The rate cannot be sent (see [`units::voltage_ramp`]), or the bus failed.
    pub fn set_voltage_ramp_rate(&self, volts_per_second: f64) -> Result<(), TalonError> {
        let ramp = units::voltage_ramp(volts_per_second)?;
        self.change(|control| control.ramp = ramp)
    }

    /// The voltage ramp in the device's own unit: throttle per 10 ms, 0 for none (manual 17.6).
    ///
    /// # Errors
    /// The bus failed.
    pub fn set_ramp_steps(&self, steps: u8) -> Result<(), TalonError> {
        self.change(|control| control.ramp = steps)
    }

    /// Selects the motor control profile, 0 or 1 (manual 11).
    ///
    /// # Errors
    /// There is no such profile, or the bus failed.
    pub fn select_profile_slot(&self, slot: u8) -> Result<(), TalonError> {
        if slot > 1 {
            return Err(TalonError::invalid(format!(
                "profile slot {slot} is out of range; allowed: 0 and 1"
            )));
        }
        self.change(|control| control.slot_1 = slot == 1)
    }

    /// What neutral does (manual 4.3).
    ///
    /// # Errors
    /// The bus failed.
    pub fn config_neutral_mode(&self, mode: NeutralMode) -> Result<(), TalonError> {
        self.change(|control| {
            control.brake = match mode {
                NeutralMode::Jumper => BrakeOverride::Stored,
                NeutralMode::Brake => BrakeOverride::Brake,
                NeutralMode::Coast => BrakeOverride::Coast,
            };
        })
    }

    /// Forces each limit switch on or off, whatever is stored (manual 4.3.3).
    ///
    /// # Errors
    /// The bus failed.
    pub fn enable_limit_switch(&self, forward: bool, reverse: bool) -> Result<(), TalonError> {
        self.change(|control| control.limits = LimitOverride::Forced { forward, reverse })
    }

    /// Gives the limit switches back to what is stored (manual 4.3.1, "No Override").
    ///
    /// # Errors
    /// The bus failed.
    pub fn use_stored_limit_switches(&self) -> Result<(), TalonError> {
        self.change(|control| control.limits = LimitOverride::STORED)
    }

    /// Chooses limit switches and soft limits together (manual 8.2).
    ///
    /// # Errors
    /// A soft limit's setting was not acknowledged, or the bus failed.
    pub fn config_limit_mode(&self, mode: LimitMode) -> Result<(), TalonError> {
        let (soft, switches) = match mode {
            LimitMode::SwitchInputsOnly => (false, true),
            LimitMode::SoftPositionLimits => (true, true),
            LimitMode::DisableSwitchInputs => (false, false),
        };
        self.enable_limit_switch(switches, switches)?;
        self.set_parameter(Parameter::ForwardSoftEnable, u32::from(soft))?;
        self.set_parameter(Parameter::ReverseSoftEnable, u32::from(soft))
    }

    /// Period of a status frame, 1 to 255 ms (manual 20.5). The device forgets it with its power.
    ///
    /// # Errors
    /// The period is 0, or the bus failed.
    pub fn set_status_frame_rate_ms(
        &self,
        frame: StatusFrame,
        period_ms: u8,
    ) -> Result<(), TalonError> {
        if period_ms == 0 {
            return Err(TalonError::invalid(
                "status frame period 0 ms is out of range; allowed: 1 to 255 ms",
            ));
        }
        let periods = self.motor(|motor, _| {
            let [general, feedback, encoder, analog] = &mut motor.status_periods;
            *match frame {
                StatusFrame::General => general,
                StatusFrame::Feedback => feedback,
                StatusFrame::QuadEncoder => encoder,
                StatusFrame::AnalogTempVbat => analog,
            } = period_ms;
            motor.status_periods
        });
        let control = Control2 {
            periods: periods.unwrap_or_default(),
        };
        self.send(&control.emit(self.number))
    }

    /// Clears the sticky faults (manual 14).
    ///
    /// # Errors
    /// The bus failed.
    pub fn clear_sticky_faults(&self) -> Result<(), TalonError> {
        let control = Control3 {
            clear_sticky: true,
            ..Control3::default()
        };
        self.send(&control.emit(self.number))
    }

    fn send(&self, frame: &windlass_core::frame::Frame) -> Result<(), TalonError> {
        Ok(self.shared.borrow_mut().client.send(frame)?)
    }
}
