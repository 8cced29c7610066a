//! The wires between a controller and its plant: virtual pins behind the traits of `embedded-hal`.

use core::convert::Infallible;

use embedded_hal::digital::{self, InputPin, OutputPin};
use embedded_hal::pwm::{self, SetDutyCycle};
use windlass_core::bridge::{Bridge, Inputs};
use windlass_core::engine::snapshot::Actuation;
use windlass_core::units::Duty;

/// Resolution of a PWM channel: that of the duty cycle itself, so that nothing is rounded.
const FULL: u16 = 32768;

/// A PWM channel.
#[derive(Clone, Copy, Debug, Default)]
pub(crate) struct Channel(u16);

impl pwm::ErrorType for Channel {
    type Error = Infallible;
}

impl SetDutyCycle for Channel {
    fn max_duty_cycle(&self) -> u16 {
        FULL
    }

    fn set_duty_cycle(&mut self, duty: u16) -> Result<(), Infallible> {
        self.0 = duty;
        Ok(())
    }
}

/// A digital wire; `true` is high.
#[derive(Clone, Copy, Debug, Default)]
pub(crate) struct Level(pub(crate) bool);

impl digital::ErrorType for Level {
    type Error = Infallible;
}

impl OutputPin for Level {
    fn set_low(&mut self) -> Result<(), Infallible> {
        self.0 = false;
        Ok(())
    }

    fn set_high(&mut self) -> Result<(), Infallible> {
        self.0 = true;
        Ok(())
    }
}

impl InputPin for Level {
    fn is_high(&mut self) -> Result<bool, Infallible> {
        Ok(self.0)
    }

    fn is_low(&mut self) -> Result<bool, Infallible> {
        Ok(!self.0)
    }
}

/// The controller's end of the power stage.
pub(crate) type Driver = Bridge<Channel, Channel, Level>;

/// The controller's digital inputs.
pub(crate) type InputPins = Inputs<Level>;

/// A bridge that is switched off.
pub(crate) fn driver() -> Driver {
    match Bridge::new(Channel::default(), Channel::default(), Level::default()) {
        Ok(driver) => driver,
        Err(_) => unreachable!("virtual pins have no errors"),
    }
}

/// Open inputs: every pull-up reads high.
pub(crate) fn inputs() -> InputPins {
    let high = Level(true);
    Inputs {
        forward_limit: high,
        reverse_limit: high,
        encoder_a: high,
        encoder_b: high,
        encoder_index: high,
        gate_driver_fault_n: high,
    }
}

/// What the power stage makes of its pins: both inputs low short the terminals, and so would both high.
pub(crate) fn power_stage(driver: &Driver) -> Actuation {
    let (forward, reverse, enable) = driver.pins();
    match (enable.0, forward.0, reverse.0) {
        (false, _, _) => Actuation::Off,
        (true, forward, 0) if forward > 0 => Actuation::Drive(Duty::saturating(i32::from(forward))),
        (true, 0, reverse) if reverse > 0 => {
            Actuation::Drive(Duty::saturating(-i32::from(reverse)))
        }
        _ => Actuation::Brake,
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn every_duty_cycle_arrives_at_the_terminals_as_it_is() {
        let mut driver = driver();
        assert_eq!(power_stage(&driver), Actuation::Off);
        for duty in (i16::MIN..=i16::MAX).filter(|duty| *duty != 0) {
            let drive = Actuation::Drive(Duty::new(duty));
            driver.apply(drive).unwrap();
            assert_eq!(power_stage(&driver), drive);
        }
        for actuation in [Actuation::Brake, Actuation::Off] {
            driver.apply(actuation).unwrap();
            assert_eq!(power_stage(&driver), actuation);
        }
    }
}
