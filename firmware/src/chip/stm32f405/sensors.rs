//! Analog inputs on ADC1, synchronous to the PWM (13), and the encoder on TIM2 (18).

use core::sync::atomic::{AtomicU32, Ordering};

use cortex_m::peripheral::NVIC;
use stm32_metapac::adc::vals::{Exten, SampleTime};
use stm32_metapac::adccommon::vals::Adcpre;
use stm32_metapac::timer::vals::{CcmrInputCcs, FilterValue, Sms};
use stm32_metapac::{ADC1, ADC123_COMMON, GPIOA, GPIOC, Interrupt, TIM2, interrupt};
use windlass_core::engine::snapshot::IndexCapture;

use super::{PRIORITY_INDEX, alternate, analog, enable, pulled_up};

/// Channels in the order of conversion: current PC0, bus voltage PC1, temperature PC2, AIN1 PC3. The
/// current comes first, nearest to the trigger.
const CHANNELS: [u8; 4] = [10, 11, 12, 13];
/// External trigger of the injected group: TIM1_TRGO (13.13.3, JEXTSEL).
const TRIGGER: u8 = 0b0001;

/// Index edges, rising and falling, with the counter at the latest of each.
static RISING: Edges = Edges::new();
static FALLING: Edges = Edges::new();

struct Edges {
    count: AtomicU32,
    at: AtomicU32,
}

impl Edges {
    const fn new() -> Self {
        Self {
            count: AtomicU32::new(0),
            at: AtomicU32::new(0),
        }
    }

    fn add(&self, at: u32) {
        self.at.store(at, Ordering::Relaxed);
        let count = self.count.load(Ordering::Relaxed);
        self.count.store(count.wrapping_add(1), Ordering::Release);
    }

    fn capture(&self) -> IndexCapture {
        IndexCapture {
            edges: self.count.load(Ordering::Acquire) as u16,
            count: self.at.load(Ordering::Relaxed),
        }
    }
}

/// Starts converter and counter.
pub fn start(nvic: &mut NVIC) {
    start_converter();
    for pin in [0, 1, 2] {
        pulled_up(GPIOA, pin);
        alternate(GPIOA, pin, 1);
    }
    // Both edges of both channels count; the filter passes what lasts 8 clocks of 84 MHz.
    TIM2.smcr().write(|mode| mode.set_sms(Sms::ENCODER_MODE_3));
    TIM2.arr().write_value(u32::MAX);
    TIM2.ccmr_input(0).write(|input| {
        for channel in 0..2 {
            input.set_ccs(channel, CcmrInputCcs::TI4);
            input.set_icf(channel, FilterValue::FCK_INT_N8);
        }
    });
    // The index pin is captured twice: by channel 3 when it rises and by channel 4 when it falls.
    TIM2.ccmr_input(1).write(|input| {
        input.set_ccs(0, CcmrInputCcs::TI4);
        input.set_ccs(1, CcmrInputCcs::TI3);
        input.set_icf(0, FilterValue::FCK_INT_N8);
        input.set_icf(1, FilterValue::FCK_INT_N8);
    });
    TIM2.ccer().write(|capture| {
        capture.set_cce(2, true);
        capture.set_cce(3, true);
        capture.set_ccp(3, true);
    });
    TIM2.dier().write(|enable| {
        enable.set_ccie(2, true);
        enable.set_ccie(3, true);
    });
    TIM2.cr1().write(|control| control.set_cen(true));
    enable(nvic, Interrupt::TIM2, PRIORITY_INDEX);
}

fn start_converter() {
    for pin in 0..4 {
        analog(GPIOC, pin);
    }
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
        sequence.set_jl(CHANNELS.len() as u8 - 1);
        for (place, channel) in CHANNELS.into_iter().enumerate() {
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

/// Latest conversions: current, bus voltage, temperature, AIN1.
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

/// The quadrature counter.
#[must_use]
pub fn counter() -> u32 {
    TIM2.cnt().read()
}

/// Level of QEA at the last tick in bit 0, its rising edges above.
static ENCODER_A: AtomicU32 = AtomicU32::new(1);

/// Rising edges of QEA, wrapping; to be called once a tick with the pin's level. The timer counts quadrature
/// and no single channel, so a pulse that is shorter than a tick is missed: good for 1000 edges a second.
#[must_use]
pub fn a_rises(level: bool) -> u16 {
    let before = ENCODER_A.load(Ordering::Relaxed);
    let rises = (before >> 1).wrapping_add(u32::from(level && before & 1 == 0));
    ENCODER_A.store(rises << 1 | u32::from(level), Ordering::Relaxed);
    rises as u16
}

/// Rising and falling edges of the index.
#[must_use]
pub fn index() -> (IndexCapture, IndexCapture) {
    (RISING.capture(), FALLING.capture())
}

#[interrupt]
fn TIM2() {
    let status = TIM2.sr().read();
    // Reading the captured value clears the flag.
    if status.ccif(2) {
        RISING.add(TIM2.ccr(2).read());
    }
    if status.ccif(3) {
        FALLING.add(TIM2.ccr(3).read());
    }
}
