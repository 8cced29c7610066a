//! The H-bridge on TIM1: two half-bridges with complementary outputs, dead time and break input (17; 28).
//!
//! The channels are those that [`Bridge`] of the core drives, so that simulated and real boards share the
//! decision which switch is on. Driving one way switches one half-bridge and holds the low side of the other on;
//! braking holds both low sides on.

use core::convert::Infallible;

use embedded_hal::digital::{self, OutputPin};
use embedded_hal::pwm::{self, SetDutyCycle};
use stm32_metapac::TIM1;
use stm32_metapac::timer::vals::{Bkp, Cms, Mms, Ocm, Ossi, Ossr};
use windlass_core::bridge::Bridge;

use super::Pin;

/// PWM frequency in kHz, above what people hear.
const FREQUENCY_KHZ: u32 = 20;
/// Counter value, on its way down, at which the converter starts.
const SAMPLE_AT: u16 = 2;

/// One half-bridge: its channel of TIM1, 0 to 2, and pins with their alternate functions.
#[derive(Clone, Copy)]
pub struct Leg {
    /// Channel, 0 for channel 1.
    pub channel: usize,
    /// High side, or the PWM input of a driver that has only one.
    pub high: (Pin, u8),
    /// Low side.
    pub low: (Pin, u8),
}

/// How a board's bridge is connected.
#[derive(Clone, Copy)]
pub struct Wiring {
    /// Clock of TIM1 in MHz.
    pub clock_mhz: u32,
    /// Half-bridge at M+.
    pub plus: Leg,
    /// Half-bridge at M−.
    pub minus: Leg,
    /// Enables the gate drivers with a high level; pulled down outside, so that they are off at reset.
    pub enable: Option<Pin>,
    /// Break input with its alternate function: the gate drivers report a fault with a low level.
    pub fault: Option<(Pin, u8)>,
    /// Dead time as the timer counts it (17.4.18; 28.6.20, DTG).
    pub dead_time: u8,
}

/// A compare value.
#[derive(Clone, Copy)]
pub struct Channel {
    channel: usize,
    top: u16,
}

/// Main output enable of the timer and the enable line of the gate drivers.
#[derive(Clone, Copy)]
pub struct Gates {
    enable: Option<Pin>,
}

/// The bridge as the tick drives it.
pub type Stage = Bridge<Channel, Channel, Gates>;

impl Wiring {
    /// Counts up to this and down again (centre-aligned).
    const fn top(&self) -> u16 {
        (self.clock_mhz * 1000 / 2 / FREQUENCY_KHZ) as u16
    }

    /// The bridge for the tick, off; after [`Wiring::start`].
    #[must_use]
    pub fn stage(&self) -> Option<Stage> {
        let [plus, minus] = [self.plus, self.minus].map(|leg| Channel {
            channel: leg.channel,
            top: self.top(),
        });
        let gates = Gates {
            enable: self.enable,
        };
        // Pins of this chip do not fail: there always is one.
        Bridge::new(plus, minus, gates).ok()
    }

    /// Sets the timer up with every switch off.
    pub fn start(&self) {
        if let Some(enable) = self.enable {
            enable.output();
        }
        if let Some((pin, function)) = self.fault {
            pin.pulled_up();
            pin.alternate(function);
        }
        TIM1.cr1()
            .write(|control| control.set_cms(Cms::CENTER_ALIGNED1));
        TIM1.arr().write(|top| top.set_arr(self.top()));
        // Channel 4 has no pin; its reference rises when the counter nears its lower end, in the middle of
        // the on-time, and triggers the converter once a period (17.3.9, 17.4.2; 28.3.12, 28.6.2).
        TIM1.ccr(3).write(|compare| compare.set_ccr(SAMPLE_AT));
        TIM1.ccmr_output(1)
            .modify(|mode| mode.set_ocm(1, Ocm::PWM_MODE1));
        TIM1.cr2()
            .write(|control| control.set_mms(Mms::COMPARE_OC4));
        for leg in [&self.plus, &self.minus] {
            TIM1.ccmr_output(leg.channel / 2).modify(|mode| {
                mode.set_ocm(leg.channel % 2, Ocm::PWM_MODE1);
                mode.set_ocpe(leg.channel % 2, true);
            });
            TIM1.ccer().modify(|enable| {
                enable.set_cce(leg.channel, true);
                enable.set_ccne(leg.channel, true);
            });
        }
        // Off state: all outputs at their idle level, which is low (OIS = 0), in run and in idle mode.
        TIM1.bdtr().write(|safety| {
            safety.set_dtg(self.dead_time);
            safety.set_ossi(Ossi::IDLE_LEVEL);
            safety.set_ossr(Ossr::IDLE_LEVEL);
            safety.set_bkp(0, Bkp::ACTIVE_LOW);
            safety.set_bke(0, self.fault.is_some());
        });
        TIM1.egr().write(|event| event.set_ug(true));
        TIM1.cr1().modify(|control| control.set_cen(true));
        // The timer's outputs reach the pins only now that their idle level is defined.
        for leg in [&self.plus, &self.minus] {
            for (pin, function) in [leg.high, leg.low] {
                pin.alternate(function);
            }
        }
    }

    /// Every switch open, from anywhere: the outputs go to their idle level at once, the gate drivers off.
    pub fn off(&self) {
        Gates {
            enable: self.enable,
        }
        .set(false);
    }
}

impl Gates {
    #[inline]
    fn set(self, on: bool) {
        if on {
            // A break clears the main output enable; the hardware refuses to set it while the break lasts.
            TIM1.sr().write(|status| {
                status.0 = u32::MAX;
                status.set_bif(0, false);
            });
        }
        TIM1.bdtr().modify(|safety| safety.set_moe(on));
        if let Some(enable) = self.enable {
            enable.set(on);
        }
    }
}

impl pwm::ErrorType for Channel {
    type Error = Infallible;
}

impl SetDutyCycle for Channel {
    /// One more than the top keeps the high side on for the whole period.
    #[inline]
    fn max_duty_cycle(&self) -> u16 {
        self.top + 1
    }

    /// Acts from the next PWM period on.
    #[inline]
    fn set_duty_cycle(&mut self, duty: u16) -> Result<(), Infallible> {
        // Channels 1 to 3 by name: a computed index would bring a panic into the tick.
        let register = match self.channel {
            0 => TIM1.ccr(0),
            1 => TIM1.ccr(1),
            _ => TIM1.ccr(2),
        };
        register.write(|compare| compare.set_ccr(duty));
        Ok(())
    }
}

impl digital::ErrorType for Gates {
    type Error = Infallible;
}

impl OutputPin for Gates {
    #[inline]
    fn set_low(&mut self) -> Result<(), Infallible> {
        self.set(false);
        Ok(())
    }

    #[inline]
    fn set_high(&mut self) -> Result<(), Infallible> {
        self.set(true);
        Ok(())
    }
}
