//! The kit of parts that `docs/hardware.md` describes, around a board that brings only the chip: CAN transceiver,
//! H-bridge, current-sense amplifier, encoder, switches and lights, at the same pins of every chip where they can be.

use stm32_metapac::{GPIOA, GPIOB, GPIOC, Interrupt, TIM3, interrupt};
use windlass_core::engine;

use super::stm32::{self, Analog, Description, Inputs, Panel};
use crate::chip::stm32::bridge::{Leg, Wiring};
use crate::chip::stm32::encoder::Encoder;
use crate::chip::stm32::pulse::PulseInput;
use crate::chip::stm32::{Pin, TIM2_AS_16_BITS};

/// Current, bus voltage, temperature and AIN1.
pub(super) const ANALOG: [Pin; 4] = [Pin(GPIOC, 0), Pin(GPIOC, 1), Pin(GPIOC, 2), Pin(GPIOC, 3)];

/// What differs from chip to chip and from board to board.
pub(super) struct Chip {
    /// Crystal in MHz.
    pub(super) crystal_mhz: u8,
    /// Clock of TIM1 in MHz.
    pub(super) bridge_mhz: u32,
    /// Clock of TIM2 to TIM7 in MHz.
    pub(super) timers_mhz: u32,
    /// Alternate function of the pins of TIM1.
    pub(super) bridge_function: u8,
    /// 1 µs, as the timer of the bridge counts it.
    pub(super) dead_time: u8,
    /// Receive and transmit pin of the CAN transceiver.
    pub(super) can: [Pin; 2],
    /// Index of the encoder.
    pub(super) index: Pin,
    /// Interrupt of the tick timer, TIM7.
    pub(super) tick: Interrupt,
}

impl Chip {
    /// The kit at this chip.
    pub(super) const fn with_kit(&self) -> Description {
        Description {
            crystal_mhz: self.crystal_mhz,
            engine: engine::Board::REFERENCE,
            can: self.can,
            bridge: Wiring {
                clock_mhz: self.bridge_mhz,
                plus: Leg {
                    channel: 0,
                    high: (Pin(GPIOA, 8), self.bridge_function),
                    low: (Pin(GPIOB, 13), self.bridge_function),
                },
                minus: Leg {
                    channel: 1,
                    high: (Pin(GPIOA, 9), self.bridge_function),
                    low: (Pin(GPIOB, 14), self.bridge_function),
                },
                enable: Some(Pin(GPIOB, 15)),
                fault: Some((Pin(GPIOB, 12), self.bridge_function)),
                dead_time: self.dead_time,
            },
            inputs: Inputs {
                limits: [Pin(GPIOC, 4), Pin(GPIOC, 5)],
                encoder: ([Pin(GPIOA, 0), Pin(GPIOA, 1), self.index], 1),
                index: Interrupt::TIM2,
                pulse: PulseInput {
                    timer: TIM3,
                    pin: (Pin(GPIOB, 4), 2),
                    clock_mhz: self.timers_mhz,
                },
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
            tick: self.tick,
            tick_mhz: self.timers_mhz,
        }
    }
}

static ENCODER: Encoder = Encoder::new(TIM2_AS_16_BITS);

#[cfg(not(feature = "bootloader"))]
#[interrupt]
fn TIM2() {
    ENCODER.captured();
}

/// The control tick with the converter's results in the order of [`ANALOG`].
///
/// # Safety
/// Nothing but the tick's interrupt may call this.
#[inline]
pub(super) unsafe fn run_tick(board: &Description, conversions: [u16; 4]) {
    let [current, bus_voltage, temperature, analog_in] = conversions;
    let analog = Analog {
        current,
        bus_voltage,
        temperature,
        analog_in,
    };
    // SAFETY: this is the tick's interrupt, and it is called once each time.
    if let Some(tick) = unsafe { stm32::tick() } {
        tick.run(board, &ENCODER, &analog);
    }
}

/// Starts the board and runs it.
#[cfg(not(feature = "bootloader"))]
pub(super) fn run(board: &Description, start_converter: impl FnOnce()) -> ! {
    stm32::run(board, &ENCODER, || {
        for pin in ANALOG {
            pin.analog();
        }
        start_converter();
    })
}
