//! The quadrature encoder and its index on TIM2 or TIM4 (18; 29).
//!
//! TIM2 has 32 bits; it is used with 16 like TIM4, so that there is one way to read them. `crate::count` makes a
//! position of 32 bits out of it.

use core::sync::atomic::{AtomicU32, Ordering};

use cortex_m::peripheral::NVIC;
use stm32_metapac::Interrupt;
use stm32_metapac::timer::TimGp16;
use stm32_metapac::timer::vals::{CcmrInputCcs, FilterValue, Sms};

use super::{PRIORITY_INDEX, Pin, enable};

/// Latest edges of one direction: their number in the upper half, the counter at the latest in the lower, in one
/// word so that they belong together.
struct Edges(AtomicU32);

impl Edges {
    const fn new() -> Self {
        Self(AtomicU32::new(0))
    }

    fn add(&self, at: u16) {
        let number = (self.0.load(Ordering::Relaxed) >> 16) + 1;
        self.0
            .store(number << 16 | u32::from(at), Ordering::Relaxed);
    }

    fn get(&self) -> (u16, u16) {
        let both = self.0.load(Ordering::Relaxed);
        ((both >> 16) as u16, both as u16)
    }
}

/// An encoder input of a board; it has one.
pub struct Encoder {
    timer: TimGp16,
    rising: Edges,
    falling: Edges,
}

impl Encoder {
    /// The encoder at a timer.
    #[must_use]
    pub const fn new(timer: TimGp16) -> Self {
        Self {
            timer,
            rising: Edges::new(),
            falling: Edges::new(),
        }
    }

    /// Starts counting A and B at the first two channels' pins, and capturing the index at the third's.
    pub fn start(&self, nvic: &mut NVIC, pins: [Pin; 3], function: u8, interrupt: Interrupt) {
        for pin in pins {
            pin.pulled_up();
            pin.alternate(function);
        }
        let timer = self.timer;
        // Both edges of both channels count; the filter passes what lasts 8 clocks of the timer.
        timer.smcr().write(|mode| mode.set_sms(Sms::ENCODER_MODE_3));
        timer.arr().write(|top| top.set_arr(u16::MAX));
        timer.ccmr_input(0).write(|input| {
            for channel in 0..2 {
                input.set_ccs(channel, CcmrInputCcs::TI4);
                input.set_icf(channel, FilterValue::FCK_INT_N8);
            }
        });
        // The index pin is captured twice: by channel 3 when it rises and by channel 4 when it falls.
        timer.ccmr_input(1).write(|input| {
            input.set_ccs(0, CcmrInputCcs::TI4);
            input.set_ccs(1, CcmrInputCcs::TI3);
            input.set_icf(0, FilterValue::FCK_INT_N8);
            input.set_icf(1, FilterValue::FCK_INT_N8);
        });
        timer.ccer().write(|capture| {
            capture.set_cce(2, true);
            capture.set_cce(3, true);
            capture.set_ccp(3, true);
        });
        timer.dier().write(|enable| {
            enable.set_ccie(2, true);
            enable.set_ccie(3, true);
        });
        timer.cr1().write(|control| control.set_cen(true));
        enable(nvic, interrupt, PRIORITY_INDEX);
    }

    /// The counter.
    #[inline]
    #[must_use]
    pub fn count(&self) -> u16 {
        self.timer.cnt().read().cnt()
    }

    /// Rising and falling edges of the index, each with the counter at the latest one.
    #[inline]
    #[must_use]
    pub fn index(&self) -> [(u16, u16); 2] {
        [self.rising.get(), self.falling.get()]
    }

    /// The timer's interrupt: the index has moved. Reading a captured value clears its flag.
    pub fn captured(&self) {
        let status = self.timer.sr().read();
        if status.ccif(2) {
            self.rising.add(self.timer.ccr(2).read().ccr());
        }
        if status.ccif(3) {
            self.falling.add(self.timer.ccr(3).read().ccr());
        }
    }
}
