//! From an [`Actuation`] to the pins of an H-bridge, and from pins to a [`Sample`]'s levels, over the traits of
//! `embedded-hal`: simulated boards and real ones use the same code.
//!
//! [`Sample`]: crate::engine::snapshot::Sample

use embedded_hal::digital::{InputPin, OutputPin};
use embedded_hal::pwm::SetDutyCycle;

use crate::engine::snapshot::{Actuation, Pin, Pins};

/// Why a bridge could not be set. Its outputs are off then, as far as the pins allow.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum BridgeError {
    /// A PWM channel refused its duty cycle.
    Pwm,
    /// The enable pin could not be driven.
    Enable,
}

/// An H-bridge of two half bridges with one PWM input each and a common enable (BTS7960 class).
///
/// | enable | forward input | reverse input | terminals |
/// |---|---|---|---|
/// | low | any | any | floating |
/// | high | low | low | both at ground: brake |
/// | high | PWM | low | M+ above M− |
/// | high | low | PWM | M− above M+ |
///
/// Invariant: never both inputs with a duty cycle at once.
#[derive(Clone, Debug)]
pub struct Bridge<F, R, E> {
    forward: F,
    reverse: R,
    enable: E,
}

impl<F: SetDutyCycle, R: SetDutyCycle, E: OutputPin> Bridge<F, R, E> {
    /// Takes the pins and switches the bridge off.
    ///
    /// # Errors
    /// A pin that cannot be driven.
    pub fn new(forward: F, reverse: R, enable: E) -> Result<Self, BridgeError> {
        let mut bridge = Self {
            forward,
            reverse,
            enable,
        };
        bridge.off()?;
        Ok(bridge)
    }

    /// Opens every switch: the terminals float.
    ///
    /// # Errors
    /// A pin that cannot be driven; the others are switched off all the same.
    pub fn off(&mut self) -> Result<(), BridgeError> {
        let enable = self.enable.set_low().map_err(|_| BridgeError::Enable);
        let forward = self.forward.set_duty_cycle(0).map_err(|_| BridgeError::Pwm);
        let reverse = self.reverse.set_duty_cycle(0).map_err(|_| BridgeError::Pwm);
        enable.and(forward).and(reverse)
    }

    /// Does what the engine has decided. The duty cycle is scaled to the resolution of the PWM channels,
    /// rounded down.
    ///
    /// # Errors
    /// A pin that cannot be driven; the bridge is switched off.
    pub fn apply(&mut self, actuation: Actuation) -> Result<(), BridgeError> {
        let result = match actuation {
            Actuation::Off => self.off(),
            Actuation::Brake => self.set(0, 0),
            Actuation::Drive(duty) => {
                let size = u32::from(duty.magnitude());
                if duty.units() > 0 {
                    self.set(compare(size, self.forward.max_duty_cycle()), 0)
                } else {
                    self.set(0, compare(size, self.reverse.max_duty_cycle()))
                }
            }
        };
        if result.is_err() {
            // The first error is what the caller has to know; this is the last resort.
            let _ = self.off();
        }
        result
    }

    /// Sets both inputs, the one that goes to zero first, so that they never overlap.
    fn set(&mut self, forward: u16, reverse: u16) -> Result<(), BridgeError> {
        if forward == 0 {
            self.forward
                .set_duty_cycle(0)
                .map_err(|_| BridgeError::Pwm)?;
            self.reverse
                .set_duty_cycle(reverse)
                .map_err(|_| BridgeError::Pwm)?;
        } else {
            self.reverse
                .set_duty_cycle(0)
                .map_err(|_| BridgeError::Pwm)?;
            self.forward
                .set_duty_cycle(forward)
                .map_err(|_| BridgeError::Pwm)?;
        }
        self.enable.set_high().map_err(|_| BridgeError::Enable)
    }

    /// The pins: forward, reverse, enable.
    pub const fn pins(&self) -> (&F, &R, &E) {
        (&self.forward, &self.reverse, &self.enable)
    }
}

/// A duty cycle of `size` / 32768 as a compare value.
fn compare(size: u32, full: u16) -> u16 {
    ((size * u32::from(full)) >> 15) as u16
}

/// The digital inputs of a controller. The gate driver's fault output is active low, as on every common driver.
#[derive(Clone, Debug)]
pub struct Inputs<P> {
    /// FWDLIM.
    pub forward_limit: P,
    /// REVLIM.
    pub reverse_limit: P,
    /// QEA.
    pub encoder_a: P,
    /// QEB.
    pub encoder_b: P,
    /// QEIDX.
    pub encoder_index: P,
    /// Fault output of the gate driver, low while a fault is present.
    pub gate_driver_fault_n: P,
}

impl<P: InputPin> Inputs<P> {
    /// Reads all pins. A pin that cannot be read counts as what an open wire with a pull-up would show; only
    /// an unreadable gate driver counts as its fault.
    pub fn read(&mut self) -> Pins {
        let open = |pin: &mut P| pin.is_high().unwrap_or(true);
        Pins::LOW
            .with(Pin::ForwardLimit, open(&mut self.forward_limit))
            .with(Pin::ReverseLimit, open(&mut self.reverse_limit))
            .with(Pin::EncoderA, open(&mut self.encoder_a))
            .with(Pin::EncoderB, open(&mut self.encoder_b))
            .with(Pin::EncoderIndex, open(&mut self.encoder_index))
            .with(
                Pin::GateDriverFault,
                self.gate_driver_fault_n.is_low().unwrap_or(true),
            )
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::units::Duty;
    use embedded_hal::{digital, pwm};

    /// A pin or channel that can be broken.
    #[derive(Clone, Copy, Debug, Default)]
    struct Wire {
        value: u16,
        broken: bool,
    }

    #[derive(Debug)]
    struct Broken;

    impl digital::Error for Broken {
        fn kind(&self) -> digital::ErrorKind {
            digital::ErrorKind::Other
        }
    }

    impl pwm::Error for Broken {
        fn kind(&self) -> pwm::ErrorKind {
            pwm::ErrorKind::Other
        }
    }

    impl digital::ErrorType for Wire {
        type Error = Broken;
    }

    impl pwm::ErrorType for Wire {
        type Error = Broken;
    }

    impl OutputPin for Wire {
        fn set_low(&mut self) -> Result<(), Broken> {
            self.set_duty_cycle(0)
        }

        fn set_high(&mut self) -> Result<(), Broken> {
            self.set_duty_cycle(1)
        }
    }

    impl SetDutyCycle for Wire {
        fn max_duty_cycle(&self) -> u16 {
            1000
        }

        fn set_duty_cycle(&mut self, duty: u16) -> Result<(), Broken> {
            if self.broken {
                return Err(Broken);
            }
            self.value = duty;
            Ok(())
        }
    }

    fn values(bridge: &Bridge<Wire, Wire, Wire>) -> (u16, u16, u16) {
        let (forward, reverse, enable) = bridge.pins();
        (forward.value, reverse.value, enable.value)
    }

    #[test]
    fn every_actuation_sets_its_pins() {
        let wire = Wire {
            value: 77,
            broken: false,
        };
        let mut bridge = Bridge::new(wire, wire, wire).unwrap();
        assert_eq!(values(&bridge), (0, 0, 0), "off from the start");
        for (actuation, expected) in [
            (Actuation::Drive(Duty::new(16384)), (500, 0, 1)),
            (Actuation::Drive(Duty::MAX), (999, 0, 1)),
            (Actuation::Drive(Duty::MIN), (0, 1000, 1)),
            (Actuation::Brake, (0, 0, 1)),
            (Actuation::Drive(Duty::new(-8192)), (0, 250, 1)),
            (Actuation::Off, (0, 0, 0)),
        ] {
            bridge.apply(actuation).unwrap();
            assert_eq!(values(&bridge), expected, "{actuation:?}");
        }
    }

    #[test]
    fn a_broken_channel_switches_everything_else_off() {
        let good = Wire::default();
        let broken = Wire {
            value: 0,
            broken: true,
        };
        let mut bridge = Bridge {
            forward: good,
            reverse: broken,
            enable: good,
        };
        let drive = Actuation::Drive(Duty::new(1000));
        assert_eq!(bridge.apply(drive), Err(BridgeError::Pwm));
        assert_eq!(values(&bridge), (0, 0, 0));
        let mut bridge = Bridge {
            forward: good,
            reverse: good,
            enable: broken,
        };
        assert_eq!(bridge.apply(drive), Err(BridgeError::Enable));
        assert_eq!(
            values(&bridge),
            (0, 0, 0),
            "no duty cycle behind a dead enable"
        );
        assert_eq!(
            Bridge::new(good, good, broken).err(),
            Some(BridgeError::Enable)
        );
    }
}
