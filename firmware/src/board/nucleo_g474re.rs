//! NUCLEO-G474RE with a CAN transceiver, an H-bridge and an encoder connected to its headers; `docs/hardware.md`
//! has the pin table. Alternate functions are those of the STM32G474 data sheet, table 13; what the board itself
//! occupies (PA2, PA3, PA5, PA13, PA14, PB3, PC13 to PC15, PF0, PF1) is told by UM2505.

use stm32_metapac::timer::TimGp16;
use stm32_metapac::{GPIOA, GPIOB, GPIOC, Interrupt, TIM2, interrupt};
use windlass_core::bridge::Inputs;
use windlass_core::engine;
use windlass_core::engine::snapshot::{Pulse, Sample};

use super::stm32::{self as board, Description, Panel, Tick};
use crate::chip::stm32::bridge::{Leg, Wiring};
use crate::chip::stm32::encoder::Encoder;
use crate::chip::stm32::{self as chip, Input, Pin};
use crate::chip::stm32g4::{CLOCK_MHZ, converter};

/// Crystal X3 in MHz (UM2505, HSE clock).
const CRYSTAL_MHZ: u8 = 24;

const FORWARD_LIMIT: Pin = Pin(GPIOC, 4);
const REVERSE_LIMIT: Pin = Pin(GPIOC, 5);
/// A, B and index, at the first three channels of TIM2 (function 1). PA2 belongs to the debug probe's serial line.
const ENCODER_PINS: [Pin; 3] = [Pin(GPIOA, 0), Pin(GPIOA, 1), Pin(GPIOB, 10)];
/// Reports a fault of the gate drivers with a low level.
const DRIVER_FAULT: Pin = Pin(GPIOB, 12);
/// Current PC0, bus voltage PC1, temperature PC2, AIN1 PC3.
const ANALOG: [(Pin, u8); 4] = [
    (Pin(GPIOC, 0), 6),
    (Pin(GPIOC, 1), 7),
    (Pin(GPIOC, 2), 8),
    (Pin(GPIOC, 3), 9),
];

/// The current-sense amplifier is strong enough for a short sampling time.
const QUICK: [u8; 1] = [ANALOG[0].1];

const BOARD: Description = Description {
    crystal_mhz: CRYSTAL_MHZ,
    engine: engine::Board::REFERENCE,
    can: [Pin(GPIOA, 11), Pin(GPIOA, 12)],
    bridge: Wiring {
        clock_mhz: CLOCK_MHZ,
        plus: Leg {
            channel: 0,
            high: (Pin(GPIOA, 8), 6),
            low: (Pin(GPIOB, 13), 6),
        },
        minus: Leg {
            channel: 1,
            high: (Pin(GPIOA, 9), 6),
            low: (Pin(GPIOB, 14), 6),
        },
        enable: Some(Pin(GPIOB, 15)),
        fault: Some((DRIVER_FAULT, 6)),
        // 1 µs: 170 periods of 5.88 ns, as (64 + 21) × 2.
        dead_time: 0x80 | 21,
    },
    panel: Panel {
        status: [
            Some(Pin(GPIOC, 6)),
            Some(Pin(GPIOC, 7)),
            Some(Pin(GPIOC, 8)),
        ],
        brake: Some(Pin(GPIOC, 9)),
        button: Some(Pin(GPIOC, 10)),
    },
    tick: Interrupt::TIM7_DAC,
    tick_mhz: CLOCK_MHZ,
};

// SAFETY: TIM2 has the registers of the timers with 16 bits, with wider counters.
static ENCODER: Encoder = Encoder::new(unsafe { TimGp16::from_ptr(TIM2.as_ptr()) });

/// The control tick: sample, engine, bridge.
#[cfg(not(feature = "bootloader"))]
#[interrupt]
fn TIM7_DAC() {
    static mut TICK: Tick = Tick::new();
    chip::acknowledge_tick();
    let sample = sample(TICK);
    TICK.run(&BOARD.bridge, &sample);
}

#[cfg(not(feature = "bootloader"))]
#[interrupt]
fn TIM2() {
    ENCODER.captured();
}

/// Everything the board measures. There is no RC-PWM input.
#[cfg(not(feature = "bootloader"))]
fn sample(tick: &mut Tick) -> Sample {
    let [current, bus_voltage, temperature, analog_in] = converter::conversions();
    let encoder = tick.position.follow(ENCODER.count());
    let [rising, falling] = ENCODER.index();
    let [encoder_a, encoder_b, encoder_index] = ENCODER_PINS.map(|pin| Input(Some(pin)));
    let mut inputs = Inputs {
        forward_limit: Input(Some(FORWARD_LIMIT)),
        reverse_limit: Input(Some(REVERSE_LIMIT)),
        encoder_a,
        encoder_b,
        encoder_index,
        gate_driver_fault_n: Input(Some(DRIVER_FAULT)),
    };
    let pins = inputs.read();
    Sample {
        encoder,
        pins,
        index_rising: tick.position.index(rising),
        index_falling: tick.position.index(falling),
        encoder_a_rises: tick.rises.follow(pins.encoder_a),
        current,
        bus_voltage,
        temperature,
        analog_in,
        pulse: Pulse::default(),
    }
}

/// Every switch of the bridge open, from anywhere.
#[cfg(not(feature = "bootloader"))]
pub fn bridge_off() {
    BOARD.bridge.off();
}

/// Starts the board and runs it.
#[cfg(not(feature = "bootloader"))]
pub fn run() -> ! {
    board::run(&BOARD, |nvic| {
        for pin in [FORWARD_LIMIT, REVERSE_LIMIT] {
            pin.input();
        }
        for (pin, _) in ANALOG {
            pin.analog();
        }
        converter::start(ANALOG.map(|(_, channel)| channel), &QUICK, None);
        ENCODER.start(nvic, ENCODER_PINS, 1, Interrupt::TIM2);
    })
}

/// Starts the application, or stays in the bootloader.
#[cfg(feature = "bootloader")]
pub fn boot() -> ! {
    super::stm32_boot::boot(&BOARD, || {})
}
