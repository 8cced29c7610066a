//! What all STM32 boards do in the same way: start, thread mode's part and the tick's. A board's own file says
//! what is connected where.

use core::ptr;
use core::sync::atomic::{AtomicPtr, Ordering};

use cortex_m::Peripherals;
use cortex_m::peripheral::NVIC;
use static_cell::StaticCell;
use stm32_metapac::Interrupt;
use windlass_core::bridge;
use windlass_core::engine;
use windlass_core::engine::snapshot::{self, Actuation, Sample};
use windlass_core::led::{Colour, Leds};
use windlass_core::management::vendor::{PinTest, TestPin};
use windlass_core::node::Handover;
use windlass_core::time::Instant;

use crate::button::Button;
use crate::chip::family;
use crate::chip::family::can::Can;
use crate::chip::stm32::bridge::{Stage, Wiring};
use crate::chip::stm32::encoder::Encoder;
use crate::chip::stm32::pulse::PulseInput;
use crate::chip::stm32::{self as chip, Input, Pin};
use crate::clock::Clock;
use crate::control::{Control, Crossing};
use crate::count::{Position, Pulses, Rises};
use crate::fault::{self, RECORD};
#[cfg(not(feature = "bootloader"))]
use crate::info;
use crate::kept::Kept;
use crate::latest::Maybe;
use crate::log;
use crate::memory;
use crate::port::{Board, Event};
use crate::record::Cause;
use crate::thread::Thread;

pub(super) static CROSSING: Crossing = Crossing::new();
/// Static, because they would take up most of the stack.
static BOARD: StaticCell<Controller> = StaticCell::new();
static THREAD: StaticCell<Thread> = StaticCell::new();

/// Lights and button. Pins that a board does not have are left out.
#[derive(Clone, Copy)]
pub(super) struct Panel {
    /// Red, green and blue of the first LED of the ring; a single one lights for every colour.
    pub(super) status: [Option<Pin>; 3],
    /// Brake LED.
    pub(super) brake: Option<Pin>,
    /// Brake/coast button to ground.
    pub(super) button: Option<Pin>,
}

impl Panel {
    /// Makes outputs and the input.
    pub(super) fn start(self) {
        let [one, two, three] = self.status;
        for pin in &[one, two, three, self.brake] {
            if let Some(pin) = pin {
                pin.output();
            }
        }
        if let Some(button) = self.button {
            button.input();
        }
    }

    /// Shows the LEDs.
    pub(super) fn show(self, leds: Leds) {
        let [first, ..] = leds.ring;
        let (red, green, blue) = mixed(first);
        match self.status {
            [Some(only), None, None] => only.set(red || green || blue),
            pins => {
                for (pin, on) in pins.iter().zip(&[red, green, blue]) {
                    if let Some(pin) = pin {
                        pin.set(*on);
                    }
                }
            }
        }
        if let Some(brake) = self.brake {
            brake.set(leds.brake != Colour::Off);
        }
    }
}

/// Encoder, limit switches and RC-PWM input.
pub(super) struct Inputs {
    /// Forward and reverse limit switch to ground.
    pub(super) limits: [Pin; 2],
    /// A, B and index of the encoder, at the first three channels of its timer, with their alternate function.
    pub(super) encoder: ([Pin; 3], u8),
    /// Interrupt of the encoder's timer.
    pub(super) index: Interrupt,
    /// RC-PWM input.
    pub(super) pulse: PulseInput,
}

impl Inputs {
    fn start(&self, nvic: &mut NVIC, encoder: &'static Encoder) {
        for pin in self.limits {
            pin.input();
        }
        let (pins, function) = self.encoder;
        encoder.start(nvic, pins, function, self.index);
        self.pulse.start();
    }
}

/// What a board's converter gives for one tick, see [`Sample`].
pub(super) struct Analog {
    /// Current of the motor.
    pub(super) current: u16,
    /// Supply of the bridge.
    pub(super) bus_voltage: u16,
    /// Temperature of the bridge.
    pub(super) temperature: u16,
    /// AIN1.
    pub(super) analog_in: u16,
}

/// What a board is made of.
pub(super) struct Description {
    /// Crystal in MHz.
    pub(super) crystal_mhz: u8,
    /// Conversion factors and limits.
    pub(super) engine: engine::Board,
    /// Receive and transmit pin of the CAN transceiver.
    pub(super) can: [Pin; 2],
    /// The bridge.
    pub(super) bridge: Wiring,
    /// What the sample is made of, besides the converter's part.
    pub(super) inputs: Inputs,
    /// Lights and button.
    pub(super) panel: Panel,
    /// Interrupt of the tick timer.
    pub(super) tick: Interrupt,
    /// Clock of the tick timer in MHz.
    pub(super) tick_mhz: u32,
}

/// What the tick's interrupt owns.
pub(super) struct Tick {
    control: Control,
    stage: Maybe<Stage>,
    position: Position,
    rises: Rises,
    pulses: Pulses,
}

impl Tick {
    /// Nothing has been measured yet.
    pub(super) const fn new() -> Self {
        Self {
            control: Control::new(),
            stage: Maybe::Nothing,
            position: Position::new(),
            rises: Rises::new(),
            pulses: Pulses::new(),
        }
    }

    /// One tick: everything that the board measures, engine, bridge.
    #[inline]
    pub(super) fn run(
        &mut self,
        board: &Description,
        encoder: &Encoder,
        analog: &Analog,
    ) -> Actuation {
        let sample = self.sample(board, encoder, analog);
        let actuation = self.control.tick(&CROSSING, &sample);
        if self.stage.as_ref().is_none() {
            self.stage = board.bridge.stage().into();
        }
        if let Some(stage) = self.stage.as_mut() {
            // Pins of this chip do not fail, and a bridge that fails has switched itself off.
            let _ = stage.apply(actuation);
        }
        actuation
    }

    #[inline]
    fn sample(&mut self, board: &Description, encoder: &Encoder, analog: &Analog) -> Sample {
        let inputs = &board.inputs;
        let count = self.position.follow(encoder.count());
        let [rising, falling] = encoder.index();
        let [forward_limit, reverse_limit] = inputs.limits.map(|pin| Input(Some(pin)));
        let [encoder_a, encoder_b, encoder_index] = inputs.encoder.0.map(|pin| Input(Some(pin)));
        let mut pins = bridge::Inputs {
            forward_limit,
            reverse_limit,
            encoder_a,
            encoder_b,
            encoder_index,
            gate_driver_fault_n: Input(board.bridge.fault.map(|(pin, _)| pin)),
        };
        let pins = pins.read();
        Sample {
            encoder: count,
            pins,
            index_rising: self.position.index(rising),
            index_falling: self.position.index(falling),
            encoder_a_rises: self.rises.follow(pins.is_high(snapshot::Pin::EncoderA)),
            current: analog.current,
            bus_voltage: analog.bus_voltage,
            temperature: analog.temperature,
            analog_in: analog.analog_in,
            pulse: inputs.pulse.follow(&mut self.pulses),
        }
    }
}

/// The tick once it is made. Not a static with a value: its few bytes that are not zero would have all two kilobytes
/// copied from flash.
static TICK: AtomicPtr<Tick> = AtomicPtr::new(ptr::null_mut());

/// What the tick's interrupt owns.
///
/// # Safety
/// Nothing but that interrupt may call this, and it once each time.
#[inline]
pub(super) unsafe fn tick() -> Option<&'static mut Tick> {
    // SAFETY: it points nowhere or to a static that nobody else has (see `start_tick`), and the caller lets go of the
    // reference before it asks for the next one.
    unsafe { TICK.load(Ordering::Relaxed).as_mut() }
}

/// Makes what the tick's interrupt owns and starts it. Not inlined, because it may take up much of the stack.
#[cfg(not(feature = "bootloader"))]
#[inline(never)]
fn start_tick(nvic: &mut NVIC, description: &Description) {
    static PLACE: StaticCell<Tick> = StaticCell::new();
    TICK.store(PLACE.init_with(Tick::new), Ordering::Relaxed);
    chip::start_tick(nvic, description.tick, description.tick_mhz);
}

type BoardKept = Kept<memory::Settings, memory::Application>;

/// The board's part of thread mode.
struct Controller {
    can: Can,
    clock: Clock,
    kept: BoardKept,
    button: Button,
    panel: Panel,
}

impl Board for Controller {
    type Bus = Can;
    type Settings = memory::Settings;
    type Application = memory::Application;

    fn now(&mut self) -> Instant {
        self.clock.now(&CROSSING, chip::micros_of_tick)
    }

    fn bus(&mut self) -> &mut Can {
        &mut self.can
    }

    fn kept(&mut self) -> &mut BoardKept {
        &mut self.kept
    }

    fn restart(&mut self, handover: Handover) -> ! {
        fault::end(Cause::Requested(handover))
    }

    fn show(&mut self, leds: Leds) {
        self.panel.show(leds);
    }

    fn button_pressed(&mut self) -> bool {
        self.button
            .pressed(self.panel.button.is_none_or(Pin::is_high))
    }

    /// The header's pins belong to timers and cannot be driven: reported as a failure of the last pin.
    fn test_pins(&mut self, _: PinTest) -> Option<TestPin> {
        Some(TestPin::EncoderIndex)
    }

    fn feed_watchdog(&mut self) {
        chip::feed_watchdog();
    }

    fn log(&mut self, event: Event) {
        log::event(event);
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

/// Time since power-on in µs.
pub fn micros() -> u64 {
    CROSSING.micros()
}

/// Starts the hardware, the bridge before anything that can drive it, and runs thread mode. `prepare` starts the
/// converter and what the board needs besides.
#[cfg(not(feature = "bootloader"))]
pub(super) fn run(
    description: &Description,
    encoder: &'static Encoder,
    prepare: impl FnOnce(),
) -> ! {
    let (board, thread) = build(description, encoder, prepare);
    log::event(Event::Started(board.kept.reset()));
    log::brown_out_level(family::brown_out_level(), family::BROWN_OUT_LEVEL);
    thread.run(board, &CROSSING)
}

/// Starts the hardware and makes the node. A function of its own, so that thread mode does not keep the
/// large stack frame that this takes.
#[cfg(not(feature = "bootloader"))]
#[inline(never)]
fn build(
    description: &Description,
    encoder: &'static Encoder,
    prepare: impl FnOnce(),
) -> (&'static mut Controller, &'static mut Thread) {
    let origin = info::origin(description.engine, chip::unique_number(), || {
        family::take_reset_cause(&RECORD)
    });
    family::await_supply();
    chip::start_watchdog();
    family::start_clocks(description.crystal_mhz);
    description.bridge.start();
    let panel = description.panel;
    panel.start();
    let board = BOARD.init_with(|| Controller {
        can: Can::default(),
        clock: Clock::default(),
        kept: Kept::new(origin, memory::settings(), memory::application()),
        button: Button::default(),
        panel,
    });
    let thread = thread(&mut board.kept);
    if let Some(mut core) = Peripherals::take() {
        let nvic = &mut core.NVIC;
        family::watch_supply(nvic);
        prepare();
        description.inputs.start(nvic, encoder);
        let [receive, transmit] = description.can;
        board.can = Can::start(nvic, receive, transmit);
        start_tick(nvic, description);
    }
    (board, thread)
}

/// Makes the node with what is stored. Not inlined, so that its settings and the journal's passes do not add up on
/// the stack.
#[cfg(not(feature = "bootloader"))]
#[inline(never)]
fn thread(kept: &mut BoardKept) -> &'static mut Thread {
    let config = kept.node_config();
    let stored = kept.load();
    THREAD.init_with(|| Thread::new(Instant::ZERO, &config, Some(&stored)))
}
