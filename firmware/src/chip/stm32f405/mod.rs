//! STM32F405 at 168 MHz. Section numbers are those of the reference manual RM0090, revision 20.

pub mod bridge;
pub mod can;
pub mod sensors;

use cortex_m::peripheral::NVIC;
use stm32_metapac::gpio::Gpio;
use stm32_metapac::gpio::vals::{Moder, Pupdr};
use stm32_metapac::iwdg::vals::Key;
use stm32_metapac::rcc::vals::{Pllm, Plln, Pllp, Pllq, Pllsrc, Ppre, Sw};
use stm32_metapac::{FLASH, IWDG, Interrupt, RCC, TIM7};
use windlass_core::reset::ResetCause;
use windlass_core::time::TICK;

/// Timer clock of TIM1 in MHz (7.2: twice PCLK2, which is HCLK / 2).
const TIMER_1_MHZ: u32 = 168;
/// Timer clock of TIM2 to TIM7 in MHz (7.2: twice PCLK1, which is HCLK / 4).
const TIMER_7_MHZ: u32 = 84;

/// Priorities; the chip implements the upper four bits (PM0214, 4.4.4). Lower numbers preempt.
const PRIORITY_TICK: u8 = 0x00;
const PRIORITY_INDEX: u8 = 0x40;
const PRIORITY_CAN: u8 = 0x80;

/// Watchdog period: LSI / 4 counts 8000 per second (21.4.2), 17 to 47 kHz instead of 32 over all parts
/// make 14 to 38 ms of these 20.
const WATCHDOG_RELOAD: u16 = 160;

/// Why the chip started, from its reset flags, which are cleared for the next time (7.3.21).
///
/// More than one flag can be set: every reset inside the chip pulls the reset pin too, and switching on
/// sets the brown-out flag as well.
pub fn take_reset_cause() -> ResetCause {
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

/// Starts the watchdog first, so that a crystal that does not start ends in a reset, then the clocks: a
/// crystal of `crystal_mhz`, 168 MHz for the core, 84 and 42 MHz for the peripherals (7.2, 7.3.2).
pub fn start_clocks(crystal_mhz: u8) {
    IWDG.kr().write(|key| key.set_key(Key::START));
    IWDG.kr().write(|key| key.set_key(Key::ENABLE));
    IWDG.rlr().write(|reload| reload.set_rl(WATCHDOG_RELOAD));
    feed_watchdog();

    RCC.cr().modify(|control| control.set_hseon(true));
    while !RCC.cr().read().hserdy() {}
    // Five wait states at 168 MHz and 3.3 V (3.5.1, table 10), with prefetch and both caches.
    FLASH.acr().write(|access| {
        access.set_latency(stm32_metapac::flash::vals::Latency::WS5);
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
        enable.set_tim7en(true);
        enable.set_can1en(true);
    });
    RCC.apb2enr().modify(|enable| {
        enable.set_tim1en(true);
        enable.set_adc1en(true);
    });
}

/// Restarts the watchdog's period (21.3).
pub fn feed_watchdog() {
    IWDG.kr().write(|key| key.set_key(Key::RESET));
}

/// Gives a pin to a peripheral (8.3.2).
#[inline]
pub fn alternate(port: Gpio, pin: usize, function: u8) {
    port.afr(pin / 8)
        .modify(|select| select.set_afr(pin % 8, function));
    port.moder()
        .modify(|mode| mode.set_moder(pin, Moder::ALTERNATE));
}

/// Makes a pin an analog input.
#[inline]
pub fn analog(port: Gpio, pin: usize) {
    port.moder()
        .modify(|mode| mode.set_moder(pin, Moder::ANALOG));
}

/// Makes a pin an input with its pull-up.
#[inline]
pub fn pulled_up(port: Gpio, pin: usize) {
    port.pupdr()
        .modify(|pull| pull.set_pupdr(pin, Pupdr::PULL_UP));
}

/// Makes a pin an output, low.
#[inline]
pub fn output(port: Gpio, pin: usize) {
    set(port, pin, false);
    port.moder()
        .modify(|mode| mode.set_moder(pin, Moder::OUTPUT));
}

/// Sets an output.
#[inline]
pub fn set(port: Gpio, pin: usize, high: bool) {
    port.bsrr().write(|bits| {
        if high {
            bits.set_bs(pin, true);
        } else {
            bits.set_br(pin, true);
        }
    });
}

/// Level of an input.
#[inline]
#[must_use]
pub fn is_high(port: Gpio, pin: usize) -> bool {
    port.idr().read().idr(pin) == stm32_metapac::gpio::vals::Idr::HIGH
}

/// Starts the control tick: TIM7 counts microseconds and overflows every 500 (20.3).
pub fn start_tick(nvic: &mut NVIC) {
    TIM7.psc().write_value((TIMER_7_MHZ - 1) as u16);
    TIM7.arr()
        .write(|top| top.set_arr(TICK.as_micros() as u16 - 1));
    TIM7.egr().write(|event| event.set_ug(true));
    acknowledge_tick();
    TIM7.dier().write(|enable| enable.set_uie(true));
    TIM7.cr1().write(|control| control.set_cen(true));
    enable(nvic, Interrupt::TIM7, PRIORITY_TICK);
}

/// The tick interrupt has been seen.
pub fn acknowledge_tick() {
    TIM7.sr().write(|status| status.set_uif(false));
}

/// Microseconds since the latest tick.
#[must_use]
pub fn micros_of_tick() -> u32 {
    u32::from(TIM7.cnt().read().cnt())
}

fn enable(nvic: &mut NVIC, interrupt: Interrupt, priority: u8) {
    // SAFETY: the handler exists, the interrupt was not enabled before, and no critical section of this
    // program relies on priorities.
    unsafe {
        nvic.set_priority(interrupt, priority);
        NVIC::unmask(interrupt);
    }
}

/// A number that differs from chip to chip: the unique device identifier (39.1), folded.
#[must_use]
pub fn unique_number() -> u32 {
    const IDENTIFIER: *const [u32; 3] = 0x1FFF_7A10 as *const [u32; 3];
    // SAFETY: three words of read-only memory that every STM32F405 has at this address.
    let [one, two, three] = unsafe { IDENTIFIER.read_volatile() };
    one ^ two.rotate_left(11) ^ three.rotate_left(22)
}
