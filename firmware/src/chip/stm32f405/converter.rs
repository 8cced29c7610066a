//! Analog inputs on ADC1, four conversions in the middle of every PWM on-time (RM0090, 13).

use stm32_metapac::adc::vals::{Exten, SampleTime};
use stm32_metapac::adccommon::vals::Adcpre;
use stm32_metapac::{ADC1, ADC123_COMMON};

/// External trigger of the injected group: TIM1_TRGO (13.13.3, JEXTSEL).
const TRIGGER: u8 = 0b0001;

/// Starts the conversions of these channels, in this order; the current comes first, nearest to the trigger.
pub fn start(channels: [u8; 4]) {
    // 84 MHz / 4 = 21 MHz, below the limit of 30.
    ADC123_COMMON
        .ccr()
        .write(|common| common.set_adcpre(Adcpre::DIV4));
    // 15 clocks of sampling: four conversions take 5.1 µs.
    ADC1.smpr1().write(|times| {
        for channel in 0..4 {
            times.set_smp(channel, SampleTime::CYCLES15);
        }
    });
    ADC1.jsqr().write(|sequence| {
        sequence.set_jl(channels.len() as u8 - 1);
        for (place, channel) in channels.into_iter().enumerate() {
            sequence.set_jsq(place, channel);
        }
    });
    ADC1.cr1().write(|control| control.set_scan(true));
    ADC1.cr2().write(|control| {
        control.set_adon(true);
        control.set_jextsel(TRIGGER);
        control.set_jexten(Exten::RISING_EDGE);
    });
}

/// Latest conversions, in the order of the channels.
#[inline]
#[must_use]
pub fn conversions() -> [u16; 4] {
    // One by one: the bounds checks of constant places vanish, those of a loop do not.
    [
        ADC1.jdr(0).read().jdata(),
        ADC1.jdr(1).read().jdata(),
        ADC1.jdr(2).read().jdata(),
        ADC1.jdr(3).read().jdata(),
    ]
}
