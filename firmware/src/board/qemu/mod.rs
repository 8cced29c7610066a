//! The emulated board: QEMU's `netduinoplus2` with SLCAN on USART1 instead of a CAN controller, the
//! bench's plant in the image instead of bridge and sensors, and RAM instead of flash.
//!
//! Interrupts, from the top: SysTick runs the engine, USART1 and USART2 move bytes, PendSV moves the
//! plant on by one tick. Thread mode does everything else. USART2 takes the pokes of the plant.

mod bus;
mod poke;
mod rig;
mod serial;

use cortex_m::Peripherals;
use cortex_m::peripheral::SCB;
use cortex_m_rt::exception;
use cortex_m_semihosting::hprintln;
use static_cell::StaticCell;
use stm32_metapac as pac;
use windlass_core::engine::snapshot::Actuation;
use windlass_core::led::Leds;
use windlass_core::management::vendor::{PinTest, TestPin};
use windlass_core::management::wire::ImageType;
use windlass_core::node::{Handover, NodeConfig};
use windlass_core::params::Stored;
use windlass_core::time::{Duration, Instant};

use crate::chip::stm32f405_emulated as chip;
use crate::control::{Control, Crossing};
use crate::fault::RECORD;
use crate::port::Board;
use crate::thread::Thread;

use bus::SlcanBus;

/// Difference of boards that were made on one day: here there is only one.
const SEED: u32 = 0x5EED_0001;

static CROSSING: Crossing = Crossing::new();

/// The control tick: nothing but the engine, and a note to the plant that it is its turn.
#[exception]
fn SysTick() {
    static mut CONTROL: Control = Control::new();
    if let Some(sample) = rig::SAMPLE.get() {
        let actuation = CONTROL.tick(&CROSSING, &sample);
        rig::ACTUATION.put(actuation);
    } else {
        CROSSING.skip();
    }
    SCB::set_pendsv();
}

/// The bridge is off: there is none but the plant's.
pub fn bridge_off() {
    rig::ACTUATION.put(Actuation::Off);
}

/// Static, because they would take up most of the stack.
static BOARD: StaticCell<Qemu> = StaticCell::new();
static THREAD: StaticCell<Thread> = StaticCell::new();

/// The board's part of thread mode.
#[derive(Default)]
struct Qemu {
    bus: SlcanBus,
    clock: Clock,
    handover: Option<Handover>,
    stored: Option<Stored>,
}

/// Extends the 32-bit tick counter.
#[derive(Default)]
struct Clock {
    latest: u32,
    wraps: u32,
}

impl Clock {
    fn now(&mut self) -> Instant {
        // The tick interrupt may come between the two readings; the second then belongs to another tick.
        let (ticks, micros) = loop {
            let ticks = CROSSING.ticks();
            let micros = chip::micros_of_tick();
            if ticks == CROSSING.ticks() {
                break (ticks, micros);
            }
        };
        if ticks < self.latest {
            self.wraps = self.wraps.wrapping_add(1);
        }
        self.latest = ticks;
        let all = u64::from(self.wraps) << 32 | u64::from(ticks);
        let tick = windlass_core::time::TICK.as_micros();
        Instant::from_micros(all * tick) + Duration::from_micros(u64::from(micros))
    }
}

impl Board for Qemu {
    type Bus = SlcanBus;

    fn node_config(&self) -> NodeConfig {
        NodeConfig {
            image: match self.handover {
                Some(handover) if handover.stay_in_bootloader => ImageType::Bootloader,
                _ => ImageType::Application,
            },
            handover: self.handover,
            ..NodeConfig::dmc60c(SEED)
        }
    }

    fn now(&mut self) -> Instant {
        self.clock.now()
    }

    fn bus(&mut self) -> &mut SlcanBus {
        &mut self.bus
    }

    fn load(&mut self) -> Option<Stored> {
        self.stored.clone()
    }

    fn save(&mut self, stored: &Stored) -> bool {
        self.stored = Some(stored.clone());
        true
    }

    fn show(&mut self, _: Leds) {}

    fn button_pressed(&mut self) -> bool {
        false
    }

    fn test_pins(&mut self, test: PinTest) -> Option<TestPin> {
        rig::test_pins(test)
    }

    fn feed_watchdog(&mut self) {}
}

/// Starts the hardware and runs thread mode.
pub fn run() -> ! {
    match RECORD.take() {
        Some(cause) => hprintln!("windlass: restarted after {:?}", cause),
        None => hprintln!("windlass: started"),
    }
    if let Some(mut core) = Peripherals::take() {
        chip::start_serial(&mut core.NVIC, serial::CAN, pac::Interrupt::USART1);
        chip::start_serial(&mut core.NVIC, serial::POKES, pac::Interrupt::USART2);
        SCB::set_pendsv();
        chip::start_tick(&mut core.SCB, &mut core.SYST);
    }
    let (board, thread) = build();
    loop {
        if let Some(handover) = thread.pass(board, &CROSSING) {
            board.handover = Some(handover);
            restart(thread, board);
        }
        serial::take_pokes();
        cortex_m::asm::wfi();
    }
}

/// Makes board and node. A function of its own, like [`restart`], so that thread mode does not keep the
/// large stack frame that this takes.
#[inline(never)]
fn build() -> (&'static mut Qemu, &'static mut Thread) {
    let board = BOARD.init_with(Qemu::default);
    let config = board.node_config();
    let thread = THREAD.init_with(|| Thread::new(Instant::ZERO, &config, None));
    (board, thread)
}

/// Starts the node anew.
#[inline(never)]
fn restart(thread: &mut Thread, board: &mut Qemu) {
    CROSSING.restart();
    let now = board.now();
    let config = board.node_config();
    let stored = board.load();
    *thread = Thread::new(now, &config, stored.as_ref());
}
