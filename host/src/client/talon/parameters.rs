//! One Talon: parameters that are set and read by request.

use windlass_core::dialect::talon_srx::wire::{
    Access, Encoding, Parameter, ParameterRequest, ParameterValue,
};
use windlass_core::frame::Frame;

use super::{CanTalon, TalonError, units};
use crate::transport::Bus;

/// A motor control profile (manual 11).
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Profile {
    /// Proportional gain, throttle per unit of error, 0 to 1023.
    pub p: f64,
    /// Integral gain, throttle per accumulated unit and ms, 0 to 1023.
    pub i: f64,
    /// Derivative gain, throttle per unit and ms, 0 to 1023.
    pub d: f64,
    /// Feed-forward gain, throttle per unit of the target, −512 to 512.
    pub f: f64,
    /// The integral is cleared while the error is not below this; 0 for never. In sensor units.
    pub i_zone: u32,
    /// Largest change of the output in volts per second of a 12 V battery; 0 for none.
    pub close_loop_ramp_rate: f64,
}

/// The parameters of a profile.
struct Places {
    p: Parameter,
    i: Parameter,
    d: Parameter,
    f: Parameter,
    i_zone: Parameter,
    ramp: Parameter,
}

const PROFILES: [Places; 2] = [
    Places {
        p: Parameter::Slot0P,
        i: Parameter::Slot0I,
        d: Parameter::Slot0D,
        f: Parameter::Slot0F,
        i_zone: Parameter::Slot0IZone,
        ramp: Parameter::Slot0Ramp,
    },
    Places {
        p: Parameter::Slot1P,
        i: Parameter::Slot1I,
        d: Parameter::Slot1D,
        f: Parameter::Slot1F,
        i_zone: Parameter::Slot1IZone,
        ramp: Parameter::Slot1Ramp,
    },
];

impl<B: Bus> CanTalon<B> {
    /// Sends a parameter's frame and waits for the answer; control frames go on meanwhile.
    fn ask(&self, parameter: Parameter, frame: &Frame) -> Result<u32, TalonError> {
        let mut shared = self.shared.borrow_mut();
        let (number, code) = (self.number, parameter.code());
        let asked_at = shared.now();
        let until = asked_at + shared.answer_time;
        let before = shared.status(number).parameters.get(&code).copied();
        shared.client.send(frame)?;
        let answered = shared.run_until(until, |shared| {
            let now = shared.status(number).parameters.get(&code).copied();
            now.is_some_and(|now| now.at >= asked_at) && now != before
        })?;
        let answer = shared.status(number).parameters.get(&code);
        match answer {
            Some(answer) if answered => Ok(answer.value),
            _ => Err(TalonError::NotUpdated {
                number,
                parameter: code,
            }),
        }
    }

    /// Sets a parameter by its raw bits; the device answers with the value in force.
    ///
    /// # Errors
    /// Read only, no answer within 4 ms, another value in force, or the bus failed.
    pub fn set_parameter(&self, parameter: Parameter, raw: u32) -> Result<(), TalonError> {
        if parameter.access() == Access::ReadOnly {
            return Err(TalonError::invalid(format!(
                "parameter {parameter:?} can only be read"
            )));
        }
        let set = ParameterValue {
            parameter: parameter.code(),
            value: raw,
        };
        let stored = self.ask(parameter, &set.emit_set(self.number))?;
        // Positions move on, and the integral adds up, between the set and its answer.
        if parameter.access() == Access::Stored && stored != raw {
            return Err(TalonError::invalid(format!(
                "the device did not take {raw:#x} for {parameter:?}; {stored:#x} is in force"
            )));
        }
        Ok(())
    }

    /// Reads a parameter's raw bits.
    ///
    /// # Errors
    /// No answer within 4 ms, or the bus failed.
    pub fn parameter(&self, parameter: Parameter) -> Result<u32, TalonError> {
        let request = ParameterRequest {
            parameter: parameter.code(),
        };
        self.ask(parameter, &request.emit(self.number))
    }

    /// Reads a parameter as a number in its unit.
    ///
    /// # Errors
    /// As [`CanTalon::parameter`].
    pub fn parameter_value(&self, parameter: Parameter) -> Result<f64, TalonError> {
        let raw = self.parameter(parameter)? as i32;
        Ok(match parameter.encoding() {
            Encoding::Integer | Encoding::Flag => f64::from(raw),
            Encoding::Unsigned10Q22 => units::gain_from(raw),
            Encoding::Signed10Q22 => units::feed_forward_from(raw),
        })
    }

    fn places(slot: u8) -> Result<&'static Places, TalonError> {
        PROFILES.get(usize::from(slot)).ok_or_else(|| {
            TalonError::invalid(format!(
                "profile slot {slot} is out of range; allowed: 0 and 1"
            ))
        })
    }

    /// Sets a motor control profile, and selects it as Java's `setPID` does (manual 12.1.3).
    ///
    /// # Errors
    /// A value is out of range (nothing is sent then), a parameter was not answered, or the bus failed.
    pub fn set_profile(&self, slot: u8, profile: &Profile) -> Result<(), TalonError> {
        let places = Self::places(slot)?;
        let i_zone = i32::try_from(profile.i_zone)
            .map_err(|_| TalonError::invalid("I zone is out of range; allowed: 0 to 2147483647"))?;
        let values = [
            (places.p, units::gain(profile.p)?),
            (places.i, units::gain(profile.i)?),
            (places.d, units::gain(profile.d)?),
            (places.f, units::feed_forward(profile.f)?),
            (places.i_zone, i_zone),
            (
                places.ramp,
                units::closed_loop_ramp(profile.close_loop_ramp_rate)?,
            ),
        ];
        for (parameter, value) in values {
            self.set_parameter(parameter, value as u32)?;
        }
        self.select_profile_slot(slot)
    }

    /// Reads a motor control profile.
    ///
    /// # Errors
    /// No such slot, a parameter was not answered, or the bus failed.
    pub fn profile(&self, slot: u8) -> Result<Profile, TalonError> {
        let places = Self::places(slot)?;
        let ramp_steps = self.parameter_value(places.ramp)?;
        Ok(Profile {
            p: self.parameter_value(places.p)?,
            i: self.parameter_value(places.i)?,
            d: self.parameter_value(places.d)?,
            f: self.parameter_value(places.f)?,
            i_zone: self.parameter(places.i_zone)?,
            close_loop_ramp_rate: units::closed_loop_rate(ramp_steps),
        })
    }

    /// The slot that is selected in the control frame.
    fn own_slot(&self) -> &'static Places {
        let shared = self.shared.borrow();
        let slot_1 = shared
            .motors
            .get(&self.number)
            .is_some_and(|motor| motor.control.slot_1);
        let [zero, one] = &PROFILES;
        if slot_1 { one } else { zero }
    }

    /// Sets the proportional gain of the selected profile.
    ///
    /// # Errors
    /// Out of range, no answer, or the bus failed.
    pub fn set_p(&self, p: f64) -> Result<(), TalonError> {
        self.set_parameter(self.own_slot().p, units::gain(p)? as u32)
    }

    /// Sets the integral gain of the selected profile.
    ///
    /// # Errors
    /// Out of range, no answer, or the bus failed.
    pub fn set_i(&self, i: f64) -> Result<(), TalonError> {
        self.set_parameter(self.own_slot().i, units::gain(i)? as u32)
    }

    /// Sets the derivative gain of the selected profile.
    ///
    /// # Errors
    /// Out of range, no answer, or the bus failed.
    pub fn set_d(&self, d: f64) -> Result<(), TalonError> {
        self.set_parameter(self.own_slot().d, units::gain(d)? as u32)
    }

    /// Sets the feed-forward gain of the selected profile.
    ///
    /// # Errors
    /// Out of range, no answer, or the bus failed.
    pub fn set_f(&self, f: f64) -> Result<(), TalonError> {
        self.set_parameter(self.own_slot().f, units::feed_forward(f)? as u32)
    }

    /// Sets the I zone of the selected profile in sensor units, 0 for none.
    ///
    /// # Errors
    /// No answer, or the bus failed.
    pub fn set_izone(&self, i_zone: u32) -> Result<(), TalonError> {
        self.set_parameter(self.own_slot().i_zone, i_zone)
    }

    /// Sets the closed-loop ramp of the selected profile in volts per second.
    ///
    /// # Errors
    /// The rate cannot be sent (see [`units::closed_loop_ramp`]), no answer, or the bus failed.
    pub fn set_close_loop_ramp_rate(&self, volts_per_second: f64) -> Result<(), TalonError> {
        let ramp = units::closed_loop_ramp(volts_per_second)?;
        self.set_parameter(self.own_slot().ramp, ramp as u32)
    }

    /// Clears the accumulated error of the closed loop (manual 12.2).
    ///
    /// # Errors
    /// No answer, or the bus failed.
    pub fn clear_iaccum(&self) -> Result<(), TalonError> {
        self.set_parameter(Parameter::IntegralAccumulator, 0)
    }

    /// The accumulated error of the closed loop.
    ///
    /// # Errors
    /// No answer, or the bus failed.
    pub fn iaccum(&self) -> Result<i32, TalonError> {
        Ok(self.parameter(Parameter::IntegralAccumulator)? as i32)
    }

    /// Sets the position of the selected sensor by that sensor's rule: an analog encoder keeps its low ten
    /// bits, a potentiometer cannot be set (manual 13).
    ///
    /// # Errors
    /// No answer, or the bus failed.
    pub fn set_position(&self, position: i32) -> Result<(), TalonError> {
        self.set_parameter(Parameter::SensorPosition, position as u32)
    }

    /// Uses the forward soft limit at this sensor position (manual 8).
    ///
    /// # Errors
    /// No answer, or the bus failed.
    pub fn set_forward_soft_limit(&self, limit: i32) -> Result<(), TalonError> {
        self.set_parameter(Parameter::ForwardSoftThreshold, limit as u32)
    }

    /// Switches the forward soft limit on or off.
    ///
    /// # Errors
    /// No answer, or the bus failed.
    pub fn enable_forward_soft_limit(&self, enabled: bool) -> Result<(), TalonError> {
        self.set_parameter(Parameter::ForwardSoftEnable, u32::from(enabled))
    }

    /// Uses the reverse soft limit at this sensor position (manual 8).
    ///
    /// # Errors
    /// No answer, or the bus failed.
    pub fn set_reverse_soft_limit(&self, limit: i32) -> Result<(), TalonError> {
        self.set_parameter(Parameter::ReverseSoftThreshold, limit as u32)
    }

    /// Switches the reverse soft limit on or off.
    ///
    /// # Errors
    /// No answer, or the bus failed.
    pub fn enable_reverse_soft_limit(&self, enabled: bool) -> Result<(), TalonError> {
        self.set_parameter(Parameter::ReverseSoftEnable, u32::from(enabled))
    }

    /// Whether the forward limit switch is normally open. A change disables the drive for a moment and is
    /// kept by the device (manual 4.4).
    ///
    /// # Errors
    /// No answer, or the bus failed.
    pub fn config_fwd_limit_switch_normally_open(&self, open: bool) -> Result<(), TalonError> {
        self.set_parameter(Parameter::OnBootForwardNormallyClosed, u32::from(!open))
    }

    /// Whether the reverse limit switch is normally open, see
    /// [`CanTalon::config_fwd_limit_switch_normally_open`].
    ///
    /// # Errors
    /// No answer, or the bus failed.
    pub fn config_rev_limit_switch_normally_open(&self, open: bool) -> Result<(), TalonError> {
        self.set_parameter(Parameter::OnBootReverseNormallyClosed, u32::from(!open))
    }

    /// The firmware's version, major and minor.
    ///
    /// # Errors
    /// No answer, or the bus failed.
    pub fn firmware_version(&self) -> Result<(u8, u8), TalonError> {
        let [_, _, major, minor] = self.parameter(Parameter::FirmwareVersion)?.to_be_bytes();
        Ok((major, minor))
    }
}
