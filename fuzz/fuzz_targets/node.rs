//! Any sequence of frames at a running DMC60C: nothing panics, a fault or a silent host means off, and the
//! node never talks before it has seen a bus.
//!
//! Input: records of 11 bytes (kind, length, ticks, eight data bytes).
#![no_main]

mod driven;

use libfuzzer_sys::fuzz_target;
use windlass_core::dialect::DialectKind;
use windlass_core::dialect::dmc60c::wire::id as control;
use windlass_core::management::wire::id;

const BASES: [u32; 8] = [
    id::ENUMERATE,
    id::VENDOR_COMMAND,
    id::VENDOR_DATA_OUT,
    id::PARAMETER_REQUEST,
    id::PARAMETER_SET,
    control::CONTROL_0,
    control::STATUS_GENERAL,
    0,
];

fuzz_target!(|input: &[u8]| driven::run(input, DialectKind::Dmc60c, &BASES, false));
