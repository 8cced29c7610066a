//! The RC-PWM input on a general-purpose timer: its PWM input mode measures without the processor (18.3.6; 29, PWM input mode).

use stm32_metapac::timer::TimGp16;
use stm32_metapac::timer::vals::{CcmrInputCcs, FilterValue, Sms, Ts};
use windlass_core::engine::snapshot::Pulse;

use super::Pin;
use crate::count::Pulses;

/// Where a board has its RC-PWM input: the first channel of a timer.
#[derive(Clone, Copy)]
pub struct PulseInput {
    /// The timer.
    pub timer: TimGp16,
    /// The pin with its alternate function.
    pub pin: (Pin, u8),
    /// Clock of the timer in MHz.
    pub clock_mhz: u32,
}

impl PulseInput {
    /// Starts measuring: a rising edge sets the counter of microseconds to 0, a falling one captures it. An open input
    /// is held low and shows no pulses.
    pub fn start(&self) {
        let (pin, function) = self.pin;
        pin.pulled_down();
        pin.alternate(function);
        let timer = self.timer;
        timer.psc().write_value((self.clock_mhz - 1) as u16);
        timer.arr().write(|top| top.set_arr(u16::MAX));
        timer.egr().write(|event| event.set_ug(true));
        // Both channels see the first one's pin. The filter passes what lasts 8 clocks of the timer.
        timer.ccmr_input(0).write(|input| {
            input.set_ccs(0, CcmrInputCcs::TI4);
            input.set_ccs(1, CcmrInputCcs::TI3);
            input.set_icf(0, FilterValue::FCK_INT_N8);
            input.set_icf(1, FilterValue::FCK_INT_N8);
        });
        timer.ccer().write(|capture| {
            capture.set_cce(0, true);
            capture.set_cce(1, true);
            capture.set_ccp(1, true);
        });
        timer.smcr().write(|mode| {
            mode.set_ts(Ts::TI1FP1);
            mode.set_sms(Sms::RESET_MODE);
        });
        timer.cr1().write(|control| control.set_cen(true));
    }

    /// What came since the tick before. Reading a captured value clears its flag.
    #[inline]
    pub(crate) fn follow(&self, pulses: &mut Pulses) -> Pulse {
        let status = self.timer.sr().read();
        let width = status.ccif(1).then(|| self.timer.ccr(1).read().ccr());
        pulses.follow(status.ccif(0), width)
    }
}
