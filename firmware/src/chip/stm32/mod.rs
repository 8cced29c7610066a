//! What the STM32 families of this project have in common, register by register: pins, watchdog, tick timer,
//! H-bridge timer and encoder timer, and what is alike in CAN and flash. What differs (clocks, CAN, converter) stands
//! beside, one folder each.
//!
//! Section numbers are those of RM0090 (STM32F405, revision 20) and RM0440 (STM32G4, revision 8), in this
//! order. A bootloader needs nothing of [`bridge`], [`encoder`] and [`pulse`].

pub mod bridge;
pub mod can;
pub mod encoder;
pub mod flash;
pub mod pulse;

use core::convert::Infallible;
use core::ptr;

use cortex_m::peripheral::NVIC;
use embedded_hal::digital::{ErrorType, InputPin};
use stm32_metapac::gpio::Gpio;
use stm32_metapac::gpio::regs::Bsrr;
use stm32_metapac::gpio::vals::{Moder, Ospeedr, Pupdr};
use stm32_metapac::iwdg::vals::{Key, Pr};
use stm32_metapac::timer::TimGp16;
use stm32_metapac::{EXTI, IWDG, Interrupt, TIM2, TIM7, UID};
use windlass_core::time::TICK;

#[cfg(not(feature = "bootloader"))]
use crate::fault;
#[cfg(not(feature = "bootloader"))]
use crate::record::Cause;

/// Priorities; the chips implement the upper four bits (PM0214, 4.4.4). Lower numbers preempt.
const PRIORITY_SUPPLY: u8 = 0x00;
const PRIORITY_TICK: u8 = 0x10;
const PRIORITY_INDEX: u8 = 0x40;
/// Bootloaders serve their CAN controller without interrupts.
#[cfg(not(feature = "bootloader"))]
pub(super) const PRIORITY_CAN: u8 = 0x80;

/// A watchdog period: a prescaler of the LSI of 32 kHz (17 to 47 kHz over all parts), and what is counted down
/// from (21.4.2, 21.4.3; 42.4.2, 42.4.3).
type Period = (Pr, u16);

/// While the control tick runs: 20 ms, 14 to 38 over all parts.
const SHORT: Period = (Pr::DIVIDE_BY4, 160);
/// While flash is erased, which takes up to 2 s, and in the bootloader: 8.2 s, 5.6 to 15.4 over all parts.
const LONG: Period = (Pr::DIVIDE_BY64, 4095);
/// Of the image that this is.
const PERIOD: Period = if cfg!(feature = "bootloader") {
    LONG
} else {
    SHORT
};

/// Line of the supply detector among the external interrupts (12.2.5; 15.3, table 103).
const SUPPLY_LINE: usize = 16;

/// TIM2 by the registers that all general-purpose timers have.
// SAFETY: it has the registers of the timers with 16 bits at the same places; its counters are wider.
pub const TIM2_AS_16_BITS: TimGp16 = unsafe { TimGp16::from_ptr(TIM2.as_ptr()) };

/// A pin of a port, 0 to 15; the functions below keep that range, because the register's own check would be a panic
/// path.
#[derive(Clone, Copy)]
pub struct Pin(pub Gpio, pub usize);

impl Pin {
    /// Gives the pin to a peripheral (8.3.2; 9.3.2). As slow as a reset leaves it, an output may take 100 ns for an
    /// edge, a tenth of a bit on the bus and of the bridge's dead time (data sheet, I/O AC characteristics).
    pub fn alternate(self, function: u8) {
        let Self(port, pin) = self;
        port.ospeedr()
            .modify(|speed| speed.set_ospeedr(pin % 16, Ospeedr::MEDIUM_SPEED));
        port.afr(pin / 8 % 2)
            .modify(|select| select.set_afr(pin % 8, function));
        self.mode(Moder::ALTERNATE);
    }

    /// Makes it an analog input.
    #[inline]
    pub fn analog(self) {
        self.mode(Moder::ANALOG);
    }

    /// Makes it an input with its pull-up.
    #[inline]
    pub fn input(self) {
        self.pulled_up();
        self.mode(Moder::INPUT);
    }

    /// Switches the pull-up on, whatever the pin is used for.
    #[inline]
    pub fn pulled_up(self) {
        self.pull(Pupdr::PULL_UP);
    }

    /// Switches the pull-down on, whatever the pin is used for.
    #[inline]
    pub fn pulled_down(self) {
        self.pull(Pupdr::PULL_DOWN);
    }

    fn pull(self, to: Pupdr) {
        let Self(port, pin) = self;
        port.pupdr().modify(|pull| pull.set_pupdr(pin % 16, to));
    }

    /// Makes it an output, low.
    #[inline]
    pub fn output(self) {
        self.set(false);
        self.mode(Moder::OUTPUT);
    }

    #[inline]
    fn mode(self, mode: Moder) {
        let Self(port, pin) = self;
        port.moder().modify(|modes| modes.set_moder(pin % 16, mode));
    }

    /// Sets an output.
    #[inline]
    pub fn set(self, high: bool) {
        let Self(port, pin) = self;
        // The lower half sets, the upper half resets (8.4.7; 9.4.7).
        let bit = if high { pin } else { pin + 16 };
        port.bsrr()
            .write_value(Bsrr(1_u32.wrapping_shl(bit as u32)));
    }

    /// Level of an input.
    #[inline]
    #[must_use]
    pub fn is_high(self) -> bool {
        let Self(port, pin) = self;
        port.idr().read().0.wrapping_shr(pin as u32) & 1 != 0
    }
}

/// An input of the controller, which a board may not have: it then reads high, as if nothing were connected.
#[derive(Clone, Copy)]
pub struct Input(pub Option<Pin>);

impl ErrorType for Input {
    type Error = Infallible;
}

impl InputPin for Input {
    #[inline]
    fn is_high(&mut self) -> Result<bool, Infallible> {
        Ok(self.0.is_none_or(Pin::is_high))
    }

    #[inline]
    fn is_low(&mut self) -> Result<bool, Infallible> {
        Ok(!self.0.is_none_or(Pin::is_high))
    }
}

/// Starts the watchdog (21.3; 42.3). Before the clocks, so that a crystal that does not start ends in a reset.
pub fn start_watchdog() {
    IWDG.kr().write(|key| key.set_key(Key::START));
    set_watchdog(PERIOD);
}

/// Changes the watchdog's period, whatever it was before: once started it runs until the next reset, also from the
/// bootloader into the application.
fn set_watchdog((prescaler, reload): Period) {
    // The registers take their values over in the clock of the watchdog, one after the other (21.4.4; 42.4.4).
    let settled = || while IWDG.sr().read().0 != 0 {};
    IWDG.kr().write(|key| key.set_key(Key::ENABLE));
    settled();
    IWDG.pr().write(|scale| scale.set_pr(prescaler));
    IWDG.rlr().write(|value| value.set_rl(reload));
    settled();
    feed_watchdog();
}

/// A time in which the watchdog waits for flash to be erased.
#[must_use]
pub(super) struct Patience(());

impl Patience {
    /// Gives the watchdog its long period.
    pub(super) fn begin() -> Self {
        set_watchdog(LONG);
        Self(())
    }

    /// Goes back to the image's own.
    pub(super) fn end(self) {
        set_watchdog(PERIOD);
    }
}

/// Reads flash, past what the compiler thinks it knows of it.
pub(super) fn read_memory(address: u32, bytes: &mut [u8]) {
    for (at, byte) in (address..).zip(bytes) {
        // SAFETY: a partition has checked that the address lies in its region of the flash, which can always be
        // read.
        *byte = unsafe { ptr::with_exposed_provenance::<u8>(at as usize).read_volatile() };
    }
}

/// Writes a word to flash that is being programmed.
pub(super) fn write_memory(address: u32, word: u32) {
    // SAFETY: a partition has checked that the address is aligned and lies in its region of the flash, where
    // neither code nor data of this program stands.
    unsafe { ptr::with_exposed_provenance_mut::<u32>(address as usize).write_volatile(word) };
}

/// Restarts the watchdog's period.
pub fn feed_watchdog() {
    IWDG.kr().write(|key| key.set_key(Key::RESET));
}

/// Lets the supply detector interrupt when the supply falls below its threshold; its output rises then.
pub(super) fn watch_supply(nvic: &mut NVIC, interrupt: Interrupt) {
    EXTI.rtsr(0)
        .modify(|lines| lines.set_line(SUPPLY_LINE, true));
    EXTI.imr(0)
        .modify(|lines| lines.set_line(SUPPLY_LINE, true));
    enable(nvic, interrupt, PRIORITY_SUPPLY);
}

/// The supply of the chip is too low to go on: bridge off and reset. The next start waits until it is back.
#[cfg(not(feature = "bootloader"))]
pub(super) fn supply_is_low() -> ! {
    fault::end(Cause::SupplyLow)
}

/// Starts the control tick: TIM7 counts microseconds and overflows every 500 (20.3; 31.3). `clock_mhz` is its
/// clock.
pub fn start_tick(nvic: &mut NVIC, interrupt: Interrupt, clock_mhz: u32) {
    TIM7.psc().write_value((clock_mhz - 1) as u16);
    TIM7.arr()
        .write(|top| top.set_arr(TICK.as_micros() as u16 - 1));
    TIM7.egr().write(|event| event.set_ug(true));
    acknowledge_tick();
    TIM7.dier().write(|enable| enable.set_uie(true));
    TIM7.cr1().write(|control| control.set_cen(true));
    enable(nvic, interrupt, PRIORITY_TICK);
}

/// Lets TIM7 count microseconds, wrapping after 65,536. `clock_mhz` is its clock.
pub fn start_clock(clock_mhz: u32) {
    TIM7.psc().write_value((clock_mhz - 1) as u16);
    TIM7.egr().write(|event| event.set_ug(true));
    TIM7.cr1().write(|control| control.set_cen(true));
}

/// The tick interrupt has been seen.
#[inline]
pub fn acknowledge_tick() {
    TIM7.sr().write(|status| status.set_uif(false));
}

/// Microseconds since the latest tick.
#[must_use]
pub fn micros_of_tick() -> u32 {
    u32::from(TIM7.cnt().read().cnt())
}

pub(super) fn enable(nvic: &mut NVIC, interrupt: Interrupt, priority: u8) {
    // SAFETY: the handler exists, the interrupt was not enabled before, and no critical section of this
    // program relies on priorities.
    unsafe {
        nvic.set_priority(interrupt, priority);
        NVIC::unmask(interrupt);
    }
}

/// A number that differs from chip to chip: the unique device identifier (39.1; 48.1), folded.
#[must_use]
pub fn unique_number() -> u32 {
    let [one, two, three] = [UID.uid(0).read(), UID.uid(1).read(), UID.uid(2).read()];
    one ^ two.rotate_left(11) ^ three.rotate_left(22)
}
