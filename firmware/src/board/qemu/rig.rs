//! The plant, run by the lowest interrupt between two ticks.

use cortex_m_rt::exception;
use heapless::Deque;
use windlass_core::engine::snapshot::{Actuation, Sample};
use windlass_core::management::vendor::{PinTest, TestPin};
use windlass_sim::{PlantConfig, Poke, Rig};

use core::cell::RefCell;
use critical_section::Mutex;

use crate::latest::{Latest, Maybe};

/// Seed of the sensors' noise.
const SEED: u64 = 1;

/// What the next tick measures.
pub(super) static SAMPLE: Latest<Maybe<Sample>> = Latest::empty();
/// What the latest tick decided.
pub(super) static ACTUATION: Latest<Actuation> = Latest::new(Actuation::Off);

/// Pokes on their way to the plant.
static POKES: Mutex<RefCell<Deque<Poke, 16>>> = Mutex::new(RefCell::new(Deque::new()));
/// A pin test on its way to the plant, and its result.
static PIN_TEST: Latest<Maybe<PinTest>> = Latest::empty();
static PIN_RESULT: Latest<Maybe<Option<TestPin>>> = Latest::empty();

/// Queues a poke; false if too many wait.
pub(super) fn poke(poke: Poke) -> bool {
    critical_section::with(|token| POKES.borrow_ref_mut(token).push_back(poke).is_ok())
}

/// Lets the plant test the header's pins: it runs in between, at the latest after the next tick.
pub(super) fn test_pins(test: PinTest) -> Option<TestPin> {
    PIN_TEST.offer(test);
    loop {
        if let Some(result) = PIN_RESULT.take() {
            return result;
        }
        cortex_m::asm::wfi();
    }
}

#[exception]
fn PendSV() {
    static mut RIG: Option<Rig> = None;
    let rig = RIG.get_or_insert_with(|| Rig::new(&PlantConfig::default(), SEED));
    while let Some(poke) = critical_section::with(|token| POKES.borrow_ref_mut(token).pop_front()) {
        rig.poke(poke);
    }
    if let Some(test) = PIN_TEST.take() {
        PIN_RESULT.offer(rig.test_pins(test));
    }
    rig.advance(ACTUATION.get());
    SAMPLE.offer(rig.sample());
}
