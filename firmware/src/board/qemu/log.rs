//! Log frames to the emulator's console by semihosting, one whole frame with one call.
//!
//! Only thread mode logs, so nothing has to be masked meanwhile: the tick is not delayed by a line.

use core::cell::UnsafeCell;

use cortex_m_semihosting::hio;
use heapless::Vec;

/// Longest frame; what is longer is cut off, and the decoder passes over it.
const LONGEST: usize = 128;

#[defmt::global_logger]
struct Logger;

struct State {
    encoder: defmt::Encoder,
    frame: Vec<u8, LONGEST>,
}

struct Shared(UnsafeCell<State>);

// SAFETY: the state is used in thread mode only, as the whole log is; the processor has one core.
unsafe impl Sync for Shared {}

static STATE: Shared = Shared(UnsafeCell::new(State {
    encoder: defmt::Encoder::new(),
    frame: Vec::new(),
}));

impl State {
    fn put(frame: &mut Vec<u8, LONGEST>, bytes: &[u8]) {
        let room = frame.capacity() - frame.len();
        // It fits: it is cut to the room.
        let _ = frame.extend_from_slice(bytes.get(..room.min(bytes.len())).unwrap_or(&[]));
    }
}

fn with(action: impl FnOnce(&mut State)) {
    // SAFETY: see `Shared`; defmt does not call one of the functions below from another.
    action(unsafe { &mut *STATE.0.get() });
}

// SAFETY: there is one user at a time, see `Shared`.
unsafe impl defmt::Logger for Logger {
    fn acquire() {
        with(|state| {
            state.frame.clear();
            let frame = &mut state.frame;
            state.encoder.start_frame(|bytes| State::put(frame, bytes));
        });
    }

    unsafe fn flush() {}

    unsafe fn release() {
        with(|state| {
            let frame = &mut state.frame;
            state.encoder.end_frame(|bytes| State::put(frame, bytes));
            if let Ok(mut console) = hio::hstdout() {
                // Nobody may be listening.
                let _ = console.write_all(&state.frame);
            }
        });
    }

    unsafe fn write(bytes: &[u8]) {
        with(|state| {
            let frame = &mut state.frame;
            state.encoder.write(bytes, |bytes| State::put(frame, bytes));
        });
    }
}
