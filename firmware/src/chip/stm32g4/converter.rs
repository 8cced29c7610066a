//! Analog inputs on ADC1, four conversions in the middle of every PWM on-time and one in between (RM0440, 21).

use stm32_metapac::adc::vals::{Adcaldif, Exten, SampleTime};
use stm32_metapac::adccommon::vals::Ckmode;
use stm32_metapac::{ADC1, ADC12_COMMON};

use super::CLOCK_MHZ;

/// External trigger of the injected group: TIM1_TRGO (21.4.18, table 166, JEXTSEL).
const TRIGGER: u8 = 0;
/// Start of the converter's voltage regulator in µs (STM32G431 data sheet, `t_ADCVREG_STUP`): 20.
const REGULATOR_US: u32 = 20;

/// Starts the conversions of these channels, in this order. `quick` are those whose amplifier is strong enough
/// for a short sampling time, the others are sampled for longer. `between` is converted once a tick at any time.
pub fn start(channels: [u8; 4], quick: &[u8], between: Option<u8>) {
    // 170 MHz / 4 = 42.5 MHz, below the limit of 60.
    ADC12_COMMON
        .ccr()
        .modify(|common| common.set_ckmode(Ckmode::SYNC_DIV4));
    // Out of deep power-down, regulator on, calibrated, on (21.4.6, 21.4.8, 21.4.9).
    ADC1.cr().modify(|control| control.set_deeppwd(false));
    ADC1.cr().modify(|control| control.set_advregen(true));
    cortex_m::asm::delay(REGULATOR_US * CLOCK_MHZ);
    ADC1.cr().modify(|control| {
        control.set_adcaldif(Adcaldif::SINGLE_ENDED);
        control.set_adcal(true);
    });
    while ADC1.cr().read().adcal() {}
    // Four clocks of the converter have to pass before it may be switched on (21.4.9).
    cortex_m::asm::delay(32);
    ADC1.cr().modify(|control| control.set_aden(true));
    while !ADC1.isr().read().adrdy() {}
    // 24.5 or 92.5 clocks of sampling and 12.5 of conversion: at most 9.9 µs for all four.
    for channel in channels.into_iter().chain(between) {
        let time = if quick.contains(&channel) {
            SampleTime::CYCLES24_5
        } else {
            SampleTime::CYCLES92_5
        };
        let (register, place) = (channel / 10, usize::from(channel % 10));
        if register == 0 {
            ADC1.smpr().modify(|times| times.set_smp(place, time));
        } else {
            ADC1.smpr2().modify(|times| times.set_smp(place, time));
        }
    }
    ADC1.jsqr().write(|sequence| {
        sequence.set_jl(channels.len() as u8 - 1);
        sequence.set_jextsel(TRIGGER);
        sequence.set_jexten(Exten::RISING_EDGE);
        for (place, channel) in channels.into_iter().enumerate() {
            sequence.set_jsq(place, channel);
        }
    });
    if let Some(channel) = between {
        ADC1.sqr1().write(|sequence| sequence.set_sq(0, channel));
    }
    ADC1.cr().modify(|control| control.set_jadstart(true));
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

/// The conversion in between that was started by the call before; starts the next one.
#[inline]
#[must_use]
pub fn between() -> u16 {
    let latest = ADC1.dr().read().rdata();
    ADC1.cr().modify(|control| control.set_adstart(true));
    latest
}
