//! Control frames from engineering units.

use windlass_core::dialect::dmc60c::wire::{Control0, ModeSelect};
use windlass_core::engine::command::LimitOverride;
use windlass_core::engine::limit::Directions;
use windlass_core::field::{I24_MAX, I24_MIN};
use windlass_core::management::wire::MAX_DEVICE_NUMBER;

use super::ValueError;

/// 100 % in throttle units.
const FULL_THROTTLE: f64 = 32767.0;
/// One ampere or volt in the 8.16 format of the target field.
const ONE: f64 = 65536.0;

/// What to drive, in engineering units.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Target {
    /// Open loop, −100 to 100 percent.
    Duty(f64),
    /// Encoder velocity in counts per 100 ms.
    Velocity(i32),
    /// Encoder position in counts.
    Position(i32),
    /// Motor current in amperes, −128 to 127.99998.
    Current(f64),
    /// Output voltage in volts, −128 to 127.99998.
    Voltage(f64),
    /// The duty cycle of another device, by its number.
    Follow(u8),
}

impl Target {
    /// A velocity from revolutions per minute and encoder counts per revolution (four times the
    /// encoder's cycles); rounded to the nearest count per 100 ms.
    ///
    /// # Errors
    /// The velocity is not finite or beyond 24 bits.
    pub fn rpm(rpm: f64, counts_per_revolution: u32) -> Result<Self, ValueError> {
        let counts = (rpm * f64::from(counts_per_revolution) / 600.0).round();
        let whole = in_range(counts, f64::from(I24_MIN), f64::from(I24_MAX));
        let counts =
            whole.ok_or_else(|| out_of_range("--rpm", rpm, "a velocity within 24 bits"))?;
        Ok(Self::Velocity(counts as i32))
    }

    /// The mode and the 24-bit target field.
    fn field(self) -> Result<(ModeSelect, i32), ValueError> {
        match self {
            Self::Duty(percent) => {
                let percent = in_range(percent, -100.0, 100.0)
                    .ok_or_else(|| out_of_range("duty cycle", percent, "-100 to 100 %"))?;
                let units = (percent / 100.0 * FULL_THROTTLE).round();
                Ok((ModeSelect::Voltage, units as i32))
            }
            Self::Velocity(counts) => Ok((ModeSelect::Velocity, whole("velocity", counts)?)),
            Self::Position(counts) => Ok((ModeSelect::Position, whole("position", counts)?)),
            Self::Current(amps) => Ok((ModeSelect::Current, fixed("current", amps, "A")?)),
            Self::Voltage(volts) => Ok((
                ModeSelect::VoltageCompensation,
                fixed("voltage", volts, "V")?,
            )),
            Self::Follow(number) => {
                let master = in_range(f64::from(number), 0.0, f64::from(MAX_DEVICE_NUMBER))
                    .ok_or_else(|| out_of_range("master", f64::from(number), "0 to 63"))?;
                Ok((ModeSelect::Follower, master as i32))
            }
        }
    }
}

/// A number within bounds, both included; NaN never is.
fn in_range(number: f64, min: f64, max: f64) -> Option<f64> {
    (number >= min && number <= max).then_some(number)
}

fn whole(what: &str, counts: i32) -> Result<i32, ValueError> {
    let allowed = format!("{I24_MIN} to {I24_MAX} counts");
    in_range(f64::from(counts), f64::from(I24_MIN), f64::from(I24_MAX))
        .map(|_| counts)
        .ok_or_else(|| out_of_range(what, f64::from(counts), &allowed))
}

fn fixed(what: &str, number: f64, unit: &str) -> Result<i32, ValueError> {
    let allowed = format!("-128 to 127.99998 {unit}");
    in_range(
        (number * ONE).round(),
        f64::from(I24_MIN),
        f64::from(I24_MAX),
    )
    .map(|raw| raw as i32)
    .ok_or_else(|| out_of_range(what, number, &allowed))
}

fn out_of_range(what: &str, number: f64, allowed: &str) -> ValueError {
    ValueError::new(format!(
        "{what} {number} is out of range; allowed: {allowed}"
    ))
}

/// A control frame under construction.
///
/// ```
/// use windlass::client::{Drive, Target};
/// let control = Drive::new(Target::Duty(50.0))?.ramp(16).brake().frame();
/// assert_eq!((control.target, control.ramp), (16384, 16));
/// # Ok::<(), windlass::client::ValueError>(())
/// ```
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Drive {
    control: Control0,
}

impl Drive {
    /// A drive to `target` with slot 0, no ramp, stored neutral behaviour and stored limits.
    ///
    /// # Errors
    /// The target is not finite or does not fit the frame.
    pub fn new(target: Target) -> Result<Self, ValueError> {
        let (mode, target) = target.field()?;
        Ok(Self {
            control: Control0 {
                mode,
                target,
                ..Control0::default()
            },
        })
    }

    /// Uses the gains of slot 1.
    #[must_use]
    pub const fn slot_1(mut self) -> Self {
        self.control.slot_1 = true;
        self
    }

    /// Changes the duty cycle by at most `rate` throttle units per 500 µs in the open-loop modes.
    #[must_use]
    pub const fn ramp(mut self, rate: u16) -> Self {
        self.control.ramp = rate;
        self
    }

    /// Brakes at neutral, whatever is stored.
    #[must_use]
    pub const fn brake(mut self) -> Self {
        self.control.override_neutral = true;
        self.control.brake = true;
        self
    }

    /// Coasts at neutral, whatever is stored.
    #[must_use]
    pub const fn coast(mut self) -> Self {
        self.control.override_neutral = true;
        self.control.brake = false;
        self
    }

    /// Drives the motor the other way round.
    #[must_use]
    pub const fn reverse_motor(mut self) -> Self {
        self.control.reverse_motor = true;
        self
    }

    /// Counts the encoder the other way round.
    #[must_use]
    pub const fn reverse_sensor(mut self) -> Self {
        self.control.reverse_sensor = true;
        self
    }

    /// Replaces the stored enable states of the limit switches; true disables a switch.
    #[must_use]
    pub const fn override_limits(mut self, disable_forward: bool, disable_reverse: bool) -> Self {
        self.control.limits = LimitOverride {
            enabled: true,
            disabled: Directions::new(disable_forward, disable_reverse),
        };
        self
    }

    /// The frame's content.
    #[must_use]
    pub const fn frame(self) -> Control0 {
        self.control
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn target(target: Target) -> (ModeSelect, i32) {
        let control = Drive::new(target).unwrap().frame();
        (control.mode, control.target)
    }

    #[test]
    fn targets_are_scaled() {
        assert_eq!(target(Target::Duty(100.0)), (ModeSelect::Voltage, 32767));
        assert_eq!(target(Target::Duty(-100.0)), (ModeSelect::Voltage, -32767));
        assert_eq!(target(Target::Velocity(-7)), (ModeSelect::Velocity, -7));
        assert_eq!(target(Target::Current(-1.5)), (ModeSelect::Current, -98304));
        let compensated = (ModeSelect::VoltageCompensation, 6 << 16);
        assert_eq!(target(Target::Voltage(6.0)), compensated);
        assert_eq!(target(Target::Follow(63)), (ModeSelect::Follower, 63));
    }

    #[test]
    fn the_guide_s_speed_formula_holds() {
        // Guide, "Quadrature Encoder Status Frames": velcnt = RPM * CPR / 600.
        assert_eq!(Target::rpm(600.0, 80), Ok(Target::Velocity(80)));
        assert_eq!(Target::rpm(-19200.0, 4096), Ok(Target::Velocity(-131_072)));
        assert!(Target::rpm(f64::NAN, 80).is_err());
        assert!(Target::rpm(f64::INFINITY, 80).is_err());
        assert!(Target::rpm(1e12, 4096).is_err());
    }

    #[test]
    fn targets_out_of_range_are_refused() {
        for bad in [
            Target::Duty(100.1),
            Target::Duty(f64::NAN),
            Target::Velocity(I24_MAX + 1),
            Target::Position(I24_MIN - 1),
            Target::Current(128.0),
            Target::Current(f64::NEG_INFINITY),
            Target::Voltage(f64::NAN),
            Target::Follow(64),
        ] {
            let error = Drive::new(bad).unwrap_err().to_string();
            assert!(error.contains("out of range"), "{error}");
        }
    }

    #[test]
    fn options_set_their_bits() {
        let drive = Drive::new(Target::Duty(0.0)).unwrap();
        let control = drive
            .slot_1()
            .coast()
            .reverse_sensor()
            .override_limits(true, false);
        let parsed = Control0::parse(&control.frame().emit(5)).unwrap();
        assert_eq!(parsed, control.frame());
        assert!(parsed.slot_1 && parsed.override_neutral && !parsed.brake);
        assert!(parsed.reverse_sensor && !parsed.reverse_motor);
        assert!(parsed.limits.enabled && parsed.limits.disabled == Directions::FORWARD);
    }
}
