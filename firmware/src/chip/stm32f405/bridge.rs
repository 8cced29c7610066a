//! The H-bridge on TIM1: two half-bridges with complementary outputs, dead time and break input (17).

use stm32_metapac::timer::vals::{Bkp, Cms, Mms, Ocm, Ossi, Ossr};
use stm32_metapac::{GPIOA, GPIOB, TIM1};
use windlass_core::engine::snapshot::Actuation;

use super::{TIMER_1_MHZ, alternate, output, pulled_up, set};

/// PWM frequency in kHz, above what people hear.
const FREQUENCY_KHZ: u32 = 20;
/// The counter goes up to this and down again (centre-aligned).
const TOP: u32 = TIMER_1_MHZ * 1000 / 2 / FREQUENCY_KHZ;
/// Counter value, on its way down, at which the converter starts.
const SAMPLE_AT: u16 = 2;
/// Dead time of 1 µs: 168 periods of 5.95 ns, as (64 + 20) × 2 (17.4.18, DTG).
const DEAD_TIME: u8 = 0x80 | 20;

/// Pin of port B that enables the gate drivers; pulled down outside, so that they are off at reset.
const ENABLE: usize = 15;
/// Pin of port B at which the gate driver reports a fault with a low level.
const FAULT: usize = 12;

/// Sets the timer up with every switch off.
pub fn start() {
    output(GPIOB, ENABLE);
    pulled_up(GPIOB, FAULT);
    alternate(GPIOB, FAULT, 1);
    TIM1.cr1()
        .write(|control| control.set_cms(Cms::CENTER_ALIGNED1));
    TIM1.arr().write(|top| top.set_arr(TOP as u16));
    // Channel 4 has no pin; its reference rises when the counter nears its lower end, in the middle of
    // the on-time, and triggers the converter once a period (17.3.9, 17.4.2).
    TIM1.ccr(3).write(|compare| compare.set_ccr(SAMPLE_AT));
    TIM1.ccmr_output(1)
        .write(|mode| mode.set_ocm(1, Ocm::PWM_MODE1));
    TIM1.cr2()
        .write(|control| control.set_mms(Mms::COMPARE_OC4));
    TIM1.ccmr_output(0).write(|mode| {
        for channel in 0..2 {
            mode.set_ocm(channel, Ocm::PWM_MODE1);
            mode.set_ocpe(channel, true);
        }
    });
    TIM1.ccer().write(|enable| {
        for channel in 0..2 {
            enable.set_cce(channel, true);
            enable.set_ccne(channel, true);
        }
    });
    // Off state: all outputs at their idle level, which is low (OIS = 0), in run and in idle mode.
    TIM1.bdtr().write(|safety| {
        safety.set_dtg(DEAD_TIME);
        safety.set_ossi(Ossi::IDLE_LEVEL);
        safety.set_ossr(Ossr::IDLE_LEVEL);
        safety.set_bkp(0, Bkp::ACTIVE_LOW);
        safety.set_bke(0, true);
    });
    TIM1.egr().write(|event| event.set_ug(true));
    TIM1.cr1().modify(|control| control.set_cen(true));
    // The timer's outputs reach the pins only now that their idle level is defined.
    for (port, pin) in [(GPIOA, 8), (GPIOA, 9), (GPIOB, 13), (GPIOB, 14)] {
        alternate(port, pin, 1);
    }
}

/// Every switch open, from anywhere: the outputs go to their idle level at once, the gate drivers off.
pub fn off() {
    TIM1.bdtr().modify(|safety| safety.set_moe(false));
    set(GPIOB, ENABLE, false);
}

/// Does what the tick decided. The compare values act from the next PWM period on.
///
/// Driving one way switches one half-bridge and holds the low side of the other on; braking holds both
/// low sides on.
pub fn apply(actuation: Actuation) {
    let (one, other) = match actuation {
        Actuation::Off => return off(),
        Actuation::Brake => (0, 0),
        Actuation::Drive(duty) => {
            // One more than the top keeps the high side on for the whole period.
            let on = (u32::from(duty.magnitude()) * (TOP + 1)) >> 15;
            if duty.units() > 0 { (on, 0) } else { (0, on) }
        }
    };
    TIM1.ccr(0).write(|compare| compare.set_ccr(one as u16));
    TIM1.ccr(1).write(|compare| compare.set_ccr(other as u16));
    // A break clears the main output enable; the hardware refuses to set it while the break lasts.
    TIM1.sr().write(|status| {
        status.0 = u32::MAX;
        status.set_bif(0, false);
    });
    TIM1.bdtr().modify(|safety| safety.set_moe(true));
    set(GPIOB, ENABLE, true);
}

/// The gate driver reports a fault.
#[must_use]
pub fn fault() -> bool {
    !super::is_high(GPIOB, FAULT)
}
