//! The emulated board: QEMU's `netduinoplus2` with SLCAN on USART1 instead of a CAN controller, the
//! bench's plant in the image instead of bridge and sensors, and RAM instead of flash.
//!
//! Interrupts, from the top: SysTick runs the engine, USART1 and USART2 move bytes, PendSV moves the
//! plant on by one tick. Thread mode does everything else. USART2 takes the pokes of the plant.

#[cfg(feature = "bootloader")]
mod boot;
mod bus;
#[cfg(not(feature = "bootloader"))]
mod console;
#[cfg(feature = "log")]
mod log;
#[cfg(not(feature = "bootloader"))]
mod poke;
#[cfg(not(feature = "bootloader"))]
mod rig;
mod serial;

#[cfg(feature = "bootloader")]
pub use boot::boot;

use core::sync::atomic::{AtomicU32, Ordering};

use cortex_m::Peripherals;
use cortex_m::peripheral::SCB;
use cortex_m_rt::exception;
use static_cell::StaticCell;
use stm32_metapac as pac;
use windlass_core::engine;
use windlass_core::engine::snapshot::Actuation;
use windlass_core::led::Leds;
use windlass_core::management::vendor::{PinTest, TestPin};
use windlass_core::node::Handover;
use windlass_core::reset::ResetCause;
use windlass_core::time::Instant;

use crate::chip::stm32f405_emulated as chip;
use crate::clock::Clock;
use crate::control::{Control, Crossing};
use crate::fault;
#[cfg(not(feature = "bootloader"))]
use crate::info;
use crate::kept::Kept;
use crate::memory;
use crate::port::{Board, Event};
use crate::record::Cause;
use crate::thread::Thread;

use bus::SlcanBus;

/// Difference of boards that were made on one day: here there is only one.
const SEED: u32 = 0x5EED_0001;

static CROSSING: Crossing = Crossing::new();

/// How late the tick starts.
static JITTER: Jitter = Jitter::new();

/// Least and most cycles from the timer's event to the start of its handler.
struct Jitter {
    least: AtomicU32,
    most: AtomicU32,
}

impl Jitter {
    const fn new() -> Self {
        Self {
            least: AtomicU32::new(u32::MAX),
            most: AtomicU32::new(0),
        }
    }

    fn note(&self, cycles: u32) {
        self.least.store(
            cycles.min(self.least.load(Ordering::Relaxed)),
            Ordering::Relaxed,
        );
        self.most.store(
            cycles.max(self.most.load(Ordering::Relaxed)),
            Ordering::Relaxed,
        );
    }

    /// The difference.
    fn spread(&self) -> u32 {
        let least = self.least.load(Ordering::Relaxed);
        self.most.load(Ordering::Relaxed).saturating_sub(least)
    }
}

/// The control tick: nothing but the engine, and a note to the plant that it is its turn.
#[cfg(not(feature = "bootloader"))]
#[exception]
fn SysTick() {
    static mut CONTROL: Control = Control::new();
    JITTER.note(chip::cycles_of_tick());
    if let Some(sample) = rig::SAMPLE.get().get() {
        let actuation = CONTROL.tick(&CROSSING, &sample);
        rig::ACTUATION.put(actuation);
    } else {
        CROSSING.skip();
    }
    SCB::set_pendsv();
}

/// The bridge is off: there is none but the plant's.
#[cfg(not(feature = "bootloader"))]
pub fn bridge_off() {
    rig::ACTUATION.put(Actuation::Off);
}

/// Static, because they would take up most of the stack.
static BOARD: StaticCell<Qemu> = StaticCell::new();
static THREAD: StaticCell<Thread> = StaticCell::new();

type BoardKept = Kept<memory::Settings, memory::Application>;

/// The board's part of thread mode.
struct Qemu {
    bus: SlcanBus,
    clock: Clock,
    kept: BoardKept,
}

#[cfg(not(feature = "bootloader"))]
impl Board for Qemu {
    type Bus = SlcanBus;
    type Settings = memory::Settings;
    type Application = memory::Application;

    fn now(&mut self) -> Instant {
        self.clock.now(&CROSSING, chip::micros_of_tick)
    }

    fn bus(&mut self) -> &mut SlcanBus {
        &mut self.bus
    }

    fn kept(&mut self) -> &mut BoardKept {
        &mut self.kept
    }

    fn restart(&mut self, handover: Handover) -> ! {
        fault::end(Cause::Requested(handover))
    }

    fn show(&mut self, _: Leds) {}

    fn button_pressed(&mut self) -> bool {
        false
    }

    fn test_pins(&mut self, test: PinTest) -> Option<TestPin> {
        rig::test_pins(test)
    }

    fn feed_watchdog(&mut self) {}

    fn log(&mut self, event: Event) {
        crate::log::event(event);
    }

    fn idle(&mut self) {
        console::take_pokes();
        if !bus::FLOOD.load(Ordering::Relaxed) {
            cortex_m::asm::wfi();
        }
    }
}

/// Time since power-on in µs.
pub fn micros() -> u64 {
    CROSSING.micros()
}

/// Starts the hardware and runs thread mode.
#[cfg(not(feature = "bootloader"))]
pub fn run() -> ! {
    if let Some(mut core) = Peripherals::take() {
        chip::start_serial(&mut core.NVIC, serial::CAN, pac::Interrupt::USART1);
        chip::start_serial(&mut core.NVIC, console::POKES, pac::Interrupt::USART2);
        SCB::set_pendsv();
        chip::start_tick(&mut core.SCB, &mut core.SYST);
    }
    let (board, thread) = build();
    crate::log::event(Event::Started(board.kept.reset()));
    thread.run(board, &CROSSING)
}

/// Makes board and node. A function of its own, so that thread mode does not keep the large stack frame
/// that this takes.
#[cfg(not(feature = "bootloader"))]
#[inline(never)]
fn build() -> (&'static mut Qemu, &'static mut Thread) {
    // The emulated chip has no reset flags: the record alone decides.
    let origin = info::origin(engine::Board::REFERENCE, SEED, || ResetCause::Unknown);
    let board = BOARD.init_with(|| Qemu {
        bus: SlcanBus::default(),
        clock: Clock::default(),
        kept: Kept::new(origin, memory::settings(), memory::application()),
    });
    let config = board.kept.node_config();
    let stored = board.kept.load();
    let thread = THREAD.init_with(|| Thread::new(Instant::ZERO, &config, Some(&stored)));
    (board, thread)
}
