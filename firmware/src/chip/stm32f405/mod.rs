//! STM32F405 at 168 MHz. Section numbers are those of the reference manual RM0090, revision 20.

pub mod can;
pub mod converter;
pub mod flash;

use cortex_m::peripheral::NVIC;
use stm32_metapac::flash::vals::Latency;
#[cfg(not(feature = "bootloader"))]
use stm32_metapac::interrupt;
use stm32_metapac::rcc::vals::{Pllm, Plln, Pllp, Pllq, Pllsrc, Ppre, Sw};
use stm32_metapac::{FLASH, Interrupt, PWR, RCC};
use windlass_core::reset::ResetCause;

use super::stm32;
use crate::record::Record;

/// Timer clock of TIM1 in MHz (7.2: twice PCLK2, which is HCLK / 2).
pub const TIMER_1_MHZ: u32 = 168;
/// Timer clock of TIM2 to TIM7 in MHz (7.2: twice PCLK1, which is HCLK / 4).
pub const TIMER_7_MHZ: u32 = 84;
/// Threshold of the supply detector: 2.8 V (5.4.1, PLS; data sheet, table 18).
const SUPPLY_THRESHOLD: u8 = 0b110;

/// Why the chip started, from its reset flags, which are cleared for the next time (7.3.21).
///
/// More than one flag can be set: every reset inside the chip pulls the reset pin too, and switching on
/// sets the brown-out flag as well.
pub fn take_reset_cause(_: &Record) -> ResetCause {
    let flags = RCC.csr().read();
    RCC.csr().modify(|csr| csr.set_rmvf(true));
    if flags.porrstf() {
        ResetCause::PowerOn
    } else if flags.borrstf() {
        ResetCause::BrownOut
    } else if flags.wdgrstf() {
        ResetCause::Watchdog
    } else if flags.sftrstf() {
        ResetCause::Requested
    } else if flags.wwdgrstf() || flags.lpwrrstf() {
        ResetCause::Other
    } else if flags.padrstf() {
        ResetCause::ResetPin
    } else {
        ResetCause::Unknown
    }
}

/// Waits until the supply is above the detector's threshold.
pub fn await_supply() {
    RCC.apb1enr().modify(|enable| enable.set_pwren(true));
    PWR.cr1().modify(|control| {
        control.set_pls(SUPPLY_THRESHOLD);
        control.set_pvde(true);
    });
    while PWR.csr1().read().pvdo() {}
}

/// Starts the clocks: a crystal of `crystal_mhz`, 168 MHz for the core, 84 and 42 MHz for the peripherals (7.2,
/// 7.3.2). After the watchdog, so that a crystal that does not start ends in a reset.
pub fn start_clocks(crystal_mhz: u8) {
    RCC.cr().modify(|control| control.set_hseon(true));
    while !RCC.cr().read().hserdy() {}
    // Five wait states at 168 MHz and 3.3 V (3.5.1, table 10), with prefetch and both caches.
    FLASH.acr().write(|access| {
        access.set_latency(Latency::WS5);
        access.set_prften(true);
        access.set_icen(true);
        access.set_dcen(true);
    });
    RCC.pllcfgr().write(|pll| {
        pll.set_pllsrc(Pllsrc::HSE);
        pll.set_pllm(Pllm::from_bits(crystal_mhz));
        pll.set_plln(Plln::from_bits(336));
        pll.set_pllp(Pllp::DIV2);
        pll.set_pllq(Pllq::from_bits(7));
    });
    RCC.cr().modify(|control| control.set_pllon(true));
    while !RCC.cr().read().pllrdy() {}
    RCC.cfgr().modify(|clocks| {
        clocks.set_ppre1(Ppre::DIV4);
        clocks.set_ppre2(Ppre::DIV2);
        clocks.set_sw(Sw::PLL1_P);
    });
    while RCC.cfgr().read().sws() != Sw::PLL1_P {}

    RCC.ahb1enr().modify(|enable| {
        enable.set_gpioaen(true);
        enable.set_gpioben(true);
        enable.set_gpiocen(true);
    });
    RCC.apb1enr().modify(|enable| {
        enable.set_tim2en(true);
        enable.set_tim3en(true);
        enable.set_tim7en(true);
        enable.set_can1en(true);
    });
    RCC.apb2enr().modify(|enable| {
        enable.set_tim1en(true);
        enable.set_adc1en(true);
    });
}

/// Brown-out level that the option bytes should name: level 3, 2.7 V (3.6.2, BOR_LEV).
pub const BROWN_OUT_LEVEL: u8 = 0b00;

/// Brown-out level that they do name.
#[must_use]
pub fn brown_out_level() -> u8 {
    FLASH.optcr().read().bor_lev()
}

/// Ends the program when the supply falls below the detector's threshold.
pub fn watch_supply(nvic: &mut NVIC) {
    stm32::watch_supply(nvic, Interrupt::PVD);
}

#[cfg(not(feature = "bootloader"))]
#[interrupt]
fn PVD() {
    stm32::supply_is_low();
}
