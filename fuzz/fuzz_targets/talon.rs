//! Any sequence of frames at a running Talon SRX: nothing panics, and it drives only while it is enabled; and
//! any bytes through the parsers of its frames: what is emitted again reads back as the same.
//!
//! Input: records of 11 bytes (kind, length, ticks, eight data bytes).
#![no_main]

mod driven;

use libfuzzer_sys::fuzz_target;
use windlass_core::dialect::DialectKind;
use windlass_core::dialect::talon_srx::wire::{
    Control1, Control2, Control3, Control5, GlobalEnable, ParameterRequest, ParameterValue, Status1,
    Status2, Status3, Status4, Status5, Status6, Status7, id,
};
use windlass_core::frame::Frame;
use windlass_core::management::identity::Manufacturer;
use windlass_core::management::wire::id as management;

const BASES: [u32; 8] = [
    id::CONTROL_1,
    id::CONTROL_2,
    id::CONTROL_3,
    id::CONTROL_5,
    id::PARAMETER_SET,
    id::STATUS_1,
    Manufacturer::CrossTheRoad.identifier(management::VENDOR_COMMAND),
    0,
];

/// Whatever a parser takes, its emitter gives back.
macro_rules! reads_back {
    ($frame:expr, $($parse:path, $emit:expr;)*) => { $(
        if let Some(value) = $parse($frame) {
            assert_eq!($parse(&$emit(&value)), Some(value));
        }
    )* };
}

fn through_the_parsers(frame: &Frame) {
    reads_back! { frame,
        Control1::parse, |value: &Control1| value.emit(5);
        Control2::parse, |value: &Control2| value.emit(5);
        Control3::parse, |value: &Control3| value.emit(5);
        Control5::parse, |value: &Control5| value.emit(5);
        GlobalEnable::parse, |value: &GlobalEnable| value.emit();
        ParameterRequest::parse, |value: &ParameterRequest| value.emit(5);
        ParameterValue::parse_set, |value: &ParameterValue| value.emit_set(5);
        ParameterValue::parse_response, |value: &ParameterValue| value.emit_response(5);
        Status2::parse, |value: &Status2| value.emit(5);
        Status3::parse, |value: &Status3| value.emit(5);
        Status4::parse, |value: &Status4| value.emit(5);
        Status5::parse, |value: &Status5| value.emit(5);
        Status6::parse, |value: &Status6| value.emit(5);
        Status7::parse, |value: &Status7| value.emit(5);
    }
    // The field has eleven bits: -1024 saturates when it is emitted.
    if let Some(status) = Status1::parse(frame).filter(|status| status.throttle >= -1023) {
        assert_eq!(Status1::parse(&status.emit(5)), Some(status));
    }
}

fuzz_target!(|input: &[u8]| {
    for record in input.chunks_exact(11) {
        let mut data = [0; 8];
        data.copy_from_slice(&record[3..]);
        let length = usize::from(record[1] % 9);
        through_the_parsers(&Frame::extended(id::CONTROL_1, data).shortened(length));
    }
    driven::run(input, DialectKind::TalonSrx, &BASES, true);
});
