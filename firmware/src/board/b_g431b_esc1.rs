//! B-G431B-ESC1, ST's three-phase motor board with an STM32G431CB; `docs/hardware.md` has the pin table.
//!
//! Two of the three half-bridges make the H-bridge: U is M+, W is M−, because the amplifiers of these two reach the
//! same converter. V stays off. Pins are those of UM2516 and its schematic (MB1419), alternate functions those of
//! the STM32G431 data sheet, table 13.

use stm32_metapac::opamp::Opamp;
use stm32_metapac::opamp::vals::{PgaGain, VmSel, VpSel};
use stm32_metapac::{GPIOA, GPIOB, GPIOC, Interrupt, OPAMP1, OPAMP3, TIM4, interrupt};
use windlass_core::engine;
use windlass_core::engine::settings::{Linear, Thresholds};

use super::stm32::{self as board, Analog, Description, Inputs, Panel};
use crate::chip::stm32::bridge::{Leg, Wiring};
use crate::chip::stm32::encoder::Encoder;
use crate::chip::stm32::pulse::PulseInput;
use crate::chip::stm32::{self as chip, Pin, TIM2_AS_16_BITS};
use crate::chip::stm32g4::{CLOCK_MHZ, converter};
use crate::shunt::Shunts;

/// Crystal in MHz.
const CRYSTAL_MHZ: u8 = 8;

/// The transceiver is on while this is low.
const CAN_SHUTDOWN: Pin = Pin(GPIOC, 11);
/// 120 Ω between the bus lines while this is high.
const CAN_TERMINATION: Pin = Pin(GPIOC, 14);
/// True if this board stands at an end of the bus.
const TERMINATED: bool = false;

/// Shunts of U and W behind their amplifiers (PA2, PB1), bus voltage (PA0), temperature (PB14).
const ANALOG: [(Pin, u8); 4] = [
    (Pin(GPIOA, 2), 3),
    (Pin(GPIOB, 1), 12),
    (Pin(GPIOA, 0), 1),
    (Pin(GPIOB, 14), 5),
];
const QUICK: [u8; 2] = [ANALOG[0].1, ANALOG[1].1];
/// Potentiometer of the daughterboard, AIN1.
const POTENTIOMETER: (Pin, u8) = (Pin(GPIOB, 12), 11);
/// Inputs of the amplifiers: shunt and bias of U, then of W.
const AMPLIFIER_INPUTS: [Pin; 4] = [Pin(GPIOA, 1), Pin(GPIOA, 3), Pin(GPIOB, 0), Pin(GPIOB, 2)];

/// µA for each step of the converter: 3.3 V in 4096 steps over 3 mΩ and a gain of 64 / 7, which is the 16 of the
/// amplifier less its bias network.
const SHUNT_MICROAMPERES: i32 = 29_373;

const ENGINE: engine::Board = engine::Board {
    // 169 kΩ over 18 kΩ: 8.3698 mV a step.
    bus_voltage: Linear {
        offset: 0,
        gain: 8776,
    },
    // NTC as ST's motor control software reads it: 1.055 V at 25 °C and 22.7 mV/K. A straight line for a curve;
    // far from 25 °C it is some degrees off.
    temperature: Linear {
        offset: -1_407_484,
        gain: 37_216,
    },
    thresholds: Thresholds {
        // The board's peak current (UM2516, features).
        over_current: 40 << 16,
        ..engine::Board::REFERENCE.thresholds
    },
    ..engine::Board::REFERENCE
};

const BOARD: Description = Description {
    crystal_mhz: CRYSTAL_MHZ,
    engine: ENGINE,
    can: [Pin(GPIOA, 11), Pin(GPIOB, 9)],
    bridge: Wiring {
        clock_mhz: CLOCK_MHZ,
        plus: Leg {
            channel: 0,
            high: (Pin(GPIOA, 8), 6),
            low: (Pin(GPIOC, 13), 4),
        },
        minus: Leg {
            channel: 2,
            high: (Pin(GPIOA, 10), 6),
            low: (Pin(GPIOB, 15), 4),
        },
        // The gate drivers (L6387) have neither an enable nor a fault pin.
        enable: None,
        fault: None,
        // 1 µs: 170 periods of 5.88 ns, as (64 + 21) × 2.
        dead_time: 0x80 | 21,
    },
    inputs: Inputs {
        // Pads of the serial line, J3, which the daughterboard with the debug probe drives while it is attached.
        limits: [Pin(GPIOB, 3), Pin(GPIOB, 4)],
        // A+, B+ and Z+ of J8, at the first three channels of TIM4.
        encoder: ([Pin(GPIOB, 6), Pin(GPIOB, 7), Pin(GPIOB, 8)], 2),
        index: Interrupt::TIM4,
        // Pad PWM, at the first channel of TIM2.
        pulse: PulseInput {
            timer: TIM2_AS_16_BITS,
            pin: (Pin(GPIOA, 15), 1),
            clock_mhz: CLOCK_MHZ,
        },
    },
    panel: Panel {
        status: [Some(Pin(GPIOC, 6)), None, None],
        brake: None,
        button: Some(Pin(GPIOC, 10)),
    },
    tick: Interrupt::TIM7,
    tick_mhz: CLOCK_MHZ,
};

static ENCODER: Encoder = Encoder::new(TIM4);

/// The control tick.
#[cfg(not(feature = "bootloader"))]
#[interrupt]
fn TIM7() {
    static mut SHUNTS: Shunts = Shunts::new(SHUNT_MICROAMPERES);
    chip::acknowledge_tick();
    let [plus, minus, bus_voltage, temperature] = converter::conversions();
    let analog = Analog {
        current: SHUNTS.current(plus, minus),
        bus_voltage,
        temperature,
        analog_in: converter::between(),
    };
    // SAFETY: this is the tick's interrupt, and it is called once each time.
    if let Some(tick) = unsafe { board::tick() } {
        SHUNTS.applied(tick.run(&BOARD, &ENCODER, &analog));
    }
}

#[cfg(not(feature = "bootloader"))]
#[interrupt]
fn TIM4() {
    ENCODER.captured();
}

/// Every switch of the bridge open, from anywhere.
#[cfg(not(feature = "bootloader"))]
pub fn bridge_off() {
    BOARD.bridge.off();
}

/// Starts an amplifier with a gain of 16 and the bias of its external network (RM0440, 25.3.5).
fn start_amplifier(amplifier: Opamp) {
    amplifier.csr().write(|control| {
        control.set_vp_sel(VpSel::VINP0);
        control.set_vm_sel(VmSel::PGA);
        control.set_pga_gain(PgaGain::GAIN16_INPUT_VINM0);
        control.set_opahsm(true);
    });
    amplifier.csr().modify(|control| control.set_opampen(true));
}

/// Switches the transceiver on.
fn start_transceiver() {
    CAN_SHUTDOWN.output();
    CAN_TERMINATION.output();
    CAN_TERMINATION.set(TERMINATED);
}

/// Starts the board and runs it.
#[cfg(not(feature = "bootloader"))]
pub fn run() -> ! {
    board::run(&BOARD, &ENCODER, || {
        start_transceiver();
        let outputs = ANALOG.map(|(pin, _)| pin);
        for pin in outputs
            .into_iter()
            .chain(AMPLIFIER_INPUTS)
            .chain([POTENTIOMETER.0])
        {
            pin.analog();
        }
        start_amplifier(OPAMP1);
        start_amplifier(OPAMP3);
        converter::start(
            ANALOG.map(|(_, channel)| channel),
            &QUICK,
            Some(POTENTIOMETER.1),
        );
    })
}

/// Starts the application, or stays in the bootloader.
#[cfg(feature = "bootloader")]
pub fn boot() -> ! {
    super::stm32_boot::boot(&BOARD, start_transceiver)
}
