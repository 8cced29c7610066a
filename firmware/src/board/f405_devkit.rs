//! A board with an STM32F405RG, a CAN transceiver, an H-bridge and an encoder; `docs/hardware.md` has the
//! pin table.

use cortex_m::Peripherals;
use static_cell::StaticCell;
use stm32_metapac::{GPIOA, GPIOC, interrupt};
use windlass_core::engine::snapshot::{Pins, Pulse, Sample};
use windlass_core::led::{Colour, Leds};
use windlass_core::management::vendor::{PinTest, TestPin};
use windlass_core::time::Instant;

use crate::chip::stm32f405::can::Can;
use crate::chip::stm32f405::{self as chip, bridge, sensors};
use crate::clock::Clock;
use crate::control::{Control, Crossing};
use crate::fault::RECORD;
use crate::kept::Kept;
use crate::port::Board;
use crate::thread::Thread;

pub use bridge::off as bridge_off;

/// Crystal in MHz: Olimex H405 and ST's Discovery have 8, the Feather STM32F405 has 12.
const CRYSTAL_MHZ: u8 = 8;

/// Inputs and outputs on port C.
const FORWARD_LIMIT: usize = 4;
const REVERSE_LIMIT: usize = 5;
const STATUS_RED: usize = 6;
const STATUS_GREEN: usize = 7;
const STATUS_BLUE: usize = 8;
const BRAKE_LED: usize = 9;
const BUTTON: usize = 10;

static CROSSING: Crossing = Crossing::new();
/// Static, because they would take up most of the stack.
static BOARD: StaticCell<Devkit> = StaticCell::new();
static THREAD: StaticCell<Thread> = StaticCell::new();

/// The control tick: sample, engine, bridge.
#[interrupt]
fn TIM7() {
    static mut CONTROL: Control = Control::new();
    chip::acknowledge_tick();
    let actuation = CONTROL.tick(&CROSSING, &sample());
    bridge::apply(actuation);
}

/// Everything the board measures. There is no RC-PWM input.
fn sample() -> Sample {
    let [current, bus_voltage, temperature, analog_in] = sensors::conversions();
    let (index_rising, index_falling) = sensors::index();
    let encoder_a = chip::is_high(GPIOA, 0);
    Sample {
        encoder: sensors::counter(),
        pins: Pins {
            forward_limit: chip::is_high(GPIOC, FORWARD_LIMIT),
            reverse_limit: chip::is_high(GPIOC, REVERSE_LIMIT),
            encoder_a,
            encoder_b: chip::is_high(GPIOA, 1),
            encoder_index: chip::is_high(GPIOA, 2),
            gate_driver_fault: bridge::fault(),
        },
        index_rising,
        index_falling,
        encoder_a_rises: sensors::a_rises(encoder_a),
        current,
        bus_voltage,
        temperature,
        analog_in,
        pulse: Pulse::default(),
    }
}

/// The board's part of thread mode.
struct Devkit {
    can: Can,
    clock: Clock,
    kept: Kept,
    button: Button,
}

/// The brake/coast button: counts once when its level has been low for 20 ms.
#[derive(Default)]
struct Button {
    low_ticks: u8,
}

impl Button {
    const LOW_TICKS: u8 = 40;

    fn pressed(&mut self, high: bool) -> bool {
        self.low_ticks = if high {
            0
        } else {
            self.low_ticks.saturating_add(1)
        };
        self.low_ticks == Self::LOW_TICKS
    }
}

impl Board for Devkit {
    type Bus = Can;

    fn now(&mut self) -> Instant {
        self.clock.now(&CROSSING, chip::micros_of_tick)
    }

    fn bus(&mut self) -> &mut Can {
        &mut self.can
    }

    fn kept(&mut self) -> &mut Kept {
        &mut self.kept
    }

    /// One RGB LED shows the first of the ring, another one the brake.
    fn show(&mut self, leds: Leds) {
        let [first, ..] = leds.ring;
        let (red, green, blue) = mixed(first);
        chip::set(GPIOC, STATUS_RED, red);
        chip::set(GPIOC, STATUS_GREEN, green);
        chip::set(GPIOC, STATUS_BLUE, blue);
        chip::set(GPIOC, BRAKE_LED, leds.brake != Colour::Off);
    }

    fn button_pressed(&mut self) -> bool {
        self.button.pressed(chip::is_high(GPIOC, BUTTON))
    }

    /// The header's pins belong to timers and cannot be driven: reported as a failure of the last pin.
    fn test_pins(&mut self, _: PinTest) -> Option<TestPin> {
        Some(TestPin::EncoderIndex)
    }

    fn feed_watchdog(&mut self) {
        chip::feed_watchdog();
    }

    fn idle(&mut self) {
        cortex_m::asm::wfi();
    }
}

/// A colour as red, green and blue.
fn mixed(colour: Colour) -> (bool, bool, bool) {
    match colour {
        Colour::Off => (false, false, false),
        Colour::Red | Colour::Orange => (true, false, false),
        Colour::Yellow => (true, true, false),
        Colour::Green => (false, true, false),
        Colour::Blue => (false, false, true),
        Colour::Fuchsia => (true, false, true),
        Colour::Cyan => (false, true, true),
        Colour::White => (true, true, true),
    }
}

/// Starts the hardware, the bridge before anything that can drive it, and runs thread mode.
pub fn run() -> ! {
    let (board, thread) = build();
    thread.run(board, &CROSSING)
}

/// Starts the hardware and makes the node. A function of its own, so that thread mode does not keep the
/// large stack frame that this takes.
#[inline(never)]
fn build() -> (&'static mut Devkit, &'static mut Thread) {
    let cause = chip::take_reset_cause();
    chip::start_clocks(CRYSTAL_MHZ);
    bridge::start();
    for pin in [FORWARD_LIMIT, REVERSE_LIMIT, BUTTON] {
        chip::pulled_up(GPIOC, pin);
    }
    for pin in [STATUS_RED, STATUS_GREEN, STATUS_BLUE, BRAKE_LED] {
        chip::output(GPIOC, pin);
    }
    let board = BOARD.init_with(|| Devkit {
        can: Can::default(),
        clock: Clock::default(),
        kept: Kept::new(&RECORD, cause, chip::unique_number()),
        button: Button::default(),
    });
    let config = board.kept.node_config();
    let thread = THREAD.init_with(|| Thread::new(Instant::ZERO, &config, None));
    if let Some(mut core) = Peripherals::take() {
        sensors::start(&mut core.NVIC);
        board.can = Can::start(&mut core.NVIC);
        chip::start_tick(&mut core.NVIC);
    }
    (board, thread)
}
