//! STM32G431 and STM32G474 at 170 MHz. Section numbers are those of the reference manual RM0440, revision 8.

pub mod can;
pub mod converter;
pub mod flash;

use cortex_m::peripheral::NVIC;
use stm32_metapac::flash::vals::Latency;
#[cfg(not(feature = "bootloader"))]
use stm32_metapac::interrupt;
use stm32_metapac::rcc::vals::{Fdcansel, Hpre, Pllm, Plln, Pllq, Pllr, Pllsrc, Sw};
use stm32_metapac::{FLASH, Interrupt, PWR, RCC};
use windlass_core::reset::ResetCause;

use super::stm32;
use crate::record::Record;

/// Clock of the core and of every timer in MHz (7.2: no bus prescaler).
pub const CLOCK_MHZ: u32 = 170;
/// Input of the PLL in MHz (7.4.4: 2.66 to 16).
const PLL_INPUT_MHZ: u8 = 4;
/// 4 MHz × 85 = 340 MHz, of which the core takes half and CAN a quarter.
const PLL_FACTOR: u8 = 85;
/// Threshold of the supply detector: 2.8 V (6.4.2, PLS).
const SUPPLY_THRESHOLD: u8 = 0b101;

/// Why the chip started, from its reset flags, which are cleared for the next time (7.4.28).
///
/// One flag stands for power-on and brown-out; RAM that has survived tells them apart. Every reset inside the
/// chip pulls the reset pin too.
pub fn take_reset_cause(record: &Record) -> ResetCause {
    let flags = RCC.csr().read();
    RCC.csr().modify(|csr| csr.set_rmvf(true));
    if flags.borrstf() && record.survived() {
        ResetCause::BrownOut
    } else if flags.borrstf() {
        ResetCause::PowerOn
    } else if flags.iwdgrstf() {
        ResetCause::Watchdog
    } else if flags.sftrstf() {
        ResetCause::Requested
    } else if flags.wwdgrstf() || flags.lpwrrstf() || flags.oblrstf() {
        ResetCause::Other
    } else if flags.pinrstf() {
        ResetCause::ResetPin
    } else {
        ResetCause::Unknown
    }
}

/// Waits until the supply is above the detector's threshold.
pub fn await_supply() {
    RCC.apb1enr1().modify(|enable| enable.set_pwren(true));
    // Also ends the pull-downs that USB-C puts on PB4 and PB6 (6.4.3, UCPD1_DBDIS).
    PWR.cr3().modify(|control| control.set_ucpd1_dbdis(true));
    PWR.cr2().write(|detector| {
        detector.set_pls(SUPPLY_THRESHOLD);
        detector.set_pvde(true);
    });
    while PWR.sr2().read().pvdo() {}
}

/// Starts the clocks: a crystal of `crystal_mhz`, a multiple of 4, and 170 MHz for everything, 85 MHz for CAN (7.2).
/// After the watchdog, so that a crystal that does not start ends in a reset.
pub fn start_clocks(crystal_mhz: u8) {
    RCC.cr().modify(|control| control.set_hseon(true));
    while !RCC.cr().read().hserdy() {}
    // Boost mode of voltage range 1 and four wait states for more than 150 MHz (6.1.5, 3.3.3 table 9).
    PWR.cr5().modify(|control| control.set_r1mode(false));
    FLASH.acr().modify(|access| {
        access.set_latency(Latency::WS4);
        access.set_prften(true);
        access.set_icen(true);
        access.set_dcen(true);
    });
    while FLASH.acr().read().latency() != Latency::WS4 {}
    RCC.pllcfgr().write(|pll| {
        pll.set_pllsrc(Pllsrc::HSE);
        pll.set_pllm(Pllm::from_bits(crystal_mhz / PLL_INPUT_MHZ - 1));
        pll.set_plln(Plln::from_bits(PLL_FACTOR));
        pll.set_pllr(Pllr::DIV2);
        pll.set_pllren(true);
        pll.set_pllq(Pllq::DIV4);
        pll.set_pllqen(true);
    });
    RCC.cr().modify(|control| control.set_pllon(true));
    while !RCC.cr().read().pllrdy() {}
    // The core must pass through half the speed for a microsecond (6.1.5, 7.2.7).
    RCC.cfgr().modify(|clocks| {
        clocks.set_hpre(Hpre::DIV2);
        clocks.set_sw(Sw::PLL1_R);
    });
    while RCC.cfgr().read().sws() != Sw::PLL1_R {}
    cortex_m::asm::delay(CLOCK_MHZ);
    RCC.cfgr().modify(|clocks| clocks.set_hpre(Hpre::DIV1));
    RCC.ccipr()
        .modify(|sources| sources.set_fdcansel(Fdcansel::PLL1_Q));
    start_peripherals();
}

fn start_peripherals() {
    RCC.ahb2enr().modify(|enable| {
        enable.set_gpioaen(true);
        enable.set_gpioben(true);
        enable.set_gpiocen(true);
        enable.set_adc12en(true);
    });
    RCC.apb1enr1().modify(|enable| {
        enable.set_tim2en(true);
        enable.set_tim3en(true);
        enable.set_tim4en(true);
        enable.set_tim7en(true);
        enable.set_fdcanen(true);
    });
    RCC.apb2enr().modify(|enable| {
        enable.set_tim1en(true);
        enable.set_syscfgen(true);
    });
}

/// Brown-out level that the option bytes should name: level 4, 2.8 V (3.4.1, BOR_LEV).
pub const BROWN_OUT_LEVEL: u8 = 4;

/// Brown-out level that they do name.
#[must_use]
pub fn brown_out_level() -> u8 {
    FLASH.optr().read().bor_lev()
}

/// Ends the program when the supply falls below the detector's threshold.
pub fn watch_supply(nvic: &mut NVIC) {
    stm32::watch_supply(nvic, Interrupt::PVD_PVM);
}

#[cfg(not(feature = "bootloader"))]
#[interrupt]
fn PVD_PVM() {
    stm32::supply_is_low();
}
