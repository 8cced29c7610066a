//! The STM32F405 that QEMU's machine `netduinoplus2` emulates: processor, SysTick, NVIC and USARTs.
//!
//! QEMU 7.2 has neither RCC nor GPIO, CAN, ADC, watchdog or flash controller; clocks therefore stand as
//! QEMU starts them (168 MHz) and nothing waits for a ready flag. Section numbers are those of the
//! reference manual RM0090 and of the ARMv7-M Architecture Reference Manual (DDI 0403E).

pub mod flash;

use cortex_m::peripheral::scb::SystemHandler;
use cortex_m::peripheral::syst::SystClkSource;
use cortex_m::peripheral::{NVIC, SCB, SYST};
use stm32_metapac::interrupt;
use stm32_metapac::usart::Usart;
use windlass_core::time::TICK;

/// Processor clock in MHz as `netduinoplus2` sets it.
const CLOCK_MHZ: u32 = 168;
/// SysTick counts from this to 0 in one control tick (B3.3.1: the period is one more than the reload).
const RELOAD: u32 = CLOCK_MHZ * TICK.as_micros() as u32 - 1;

/// Priorities; the chip implements the upper four bits (PM0214, 4.4.4). Lower numbers preempt.
const PRIORITY_TICK: u8 = 0x00;
const PRIORITY_SERIAL: u8 = 0x80;
const PRIORITY_PLANT: u8 = 0xF0;

/// Starts the control tick. SysTick makes it, because QEMU's model of the general-purpose timers does
/// not repeat its update event.
pub fn start_tick(scb: &mut SCB, timer: &mut SYST) {
    // SAFETY: the priorities of the handlers are set before any of them is enabled, and no critical
    // section of this program relies on priorities.
    unsafe {
        scb.set_priority(SystemHandler::SysTick, PRIORITY_TICK);
        scb.set_priority(SystemHandler::PendSV, PRIORITY_PLANT);
    }
    timer.set_clock_source(SystClkSource::Core);
    timer.set_reload(RELOAD);
    timer.clear_current();
    timer.enable_interrupt();
    timer.enable_counter();
}

/// Lets SysTick count without interrupting: it has to be asked by [`tick_has_passed`] more often than it ends.
pub fn start_clock(timer: &mut SYST) {
    timer.set_clock_source(SystClkSource::Core);
    timer.set_reload(RELOAD);
    timer.clear_current();
    timer.enable_counter();
}

/// True if SysTick has come to its end since it was asked last (B3.3.3, COUNTFLAG).
pub fn tick_has_passed(timer: &mut SYST) -> bool {
    timer.has_wrapped()
}

/// Processor cycles since the latest tick.
#[must_use]
pub fn cycles_of_tick() -> u32 {
    RELOAD.saturating_sub(SYST::get_current())
}

/// Microseconds since the latest tick.
#[must_use]
pub fn micros_of_tick() -> u32 {
    cycles_of_tick() / CLOCK_MHZ
}

/// Enables a USART for reception by interrupt and for transmission (30.6.4). Its line rate means nothing
/// to QEMU.
pub fn start_serial(nvic: &mut NVIC, serial: Usart, interrupt: interrupt) {
    serial.cr1().write(|control| {
        control.set_ue(true);
        control.set_te(true);
        control.set_re(true);
        control.set_rxneie(true);
    });
    // SAFETY: the handler exists and the interrupt was not enabled before.
    unsafe {
        nvic.set_priority(interrupt, PRIORITY_SERIAL);
        NVIC::unmask(interrupt);
    }
}

/// The byte that has been received, if one has (30.6.1 RXNE).
#[must_use]
pub fn received(serial: Usart) -> Option<u8> {
    serial
        .sr()
        .read()
        .rxne()
        .then(|| serial.dr().read().dr() as u8)
}

/// Lets the USART interrupt for received bytes, or holds it back while the queue is full.
pub fn listen(serial: Usart, on: bool) {
    serial.cr1().modify(|control| control.set_rxneie(on));
}

/// Writes bytes, waiting for the transmitter before each (30.6.1 TXE), which QEMU has always ready.
pub fn write(serial: Usart, bytes: &[u8]) {
    for byte in bytes {
        while !serial.sr().read().txe() {}
        serial.dr().write(|data| data.set_dr(u16::from(*byte)));
    }
}

/// Makes an interrupt that nothing handles.
pub fn interrupt_without_handler() {
    // SAFETY: this is what the trap of unexpected interrupts is for; nothing waits for this interrupt.
    unsafe { NVIC::unmask(interrupt::TIM5) };
    NVIC::pend(interrupt::TIM5);
}

/// Pushes a word onto a stack that is full.
pub fn overflow_stack(end: u32) -> ! {
    // SAFETY: the program ends here on purpose: the push below the stack's end is a bus fault.
    unsafe {
        core::arch::asm!(
            "msr msp, {end}",
            "push {{{end}}}",
            "b .",
            end = in(reg) end,
            options(noreturn)
        )
    }
}
