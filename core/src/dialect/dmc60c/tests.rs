//! Golden frames, round trips and the rules of the status fields. Vectors are computed from the guide's
//! layouts by hand; none has been recorded from a vendor device.

use super::wire::*;
use super::*;
use crate::frc_id::base;
use crate::engine::command::LimitOverride;
use crate::engine::limit::Directions;
use crate::engine::snapshot::{Actuation, Fault, LimitStatus, Pins, Snapshot};
use crate::engine::{Board, Settings};
use crate::params::compile;
use proptest::prelude::*;

fn view<'a>(params: &'a Params, settings: &'a Settings, snapshot: &'a Snapshot) -> View<'a> {
    View { number: 5, params, settings, snapshot, device: crate::dialect::Device::default() }
}

fn settings(params: &Params) -> Settings {
    compile::settings(params, &Board::REFERENCE, &Dmc60c::POLICY)
}

#[test]
fn control_frame_bytes_are_those_of_the_guide() {
    // Target bytes stand in the order H (3), L (4), M (5): docs/dmc60c.md.
    let control = Control0 {
        mode: ModeSelect::Position,
        override_neutral: true,
        brake: true,
        slot_1: true,
        reverse_sensor: true,
        reverse_motor: true,
        limits: LimitOverride { enabled: true, disabled: Directions::FORWARD },
        target: 0x12_34_56,
        ramp: 0xABCD,
    };
    let frame = control.emit(5);
    assert_eq!(frame.extended_id(), Some(0x0206_0005));
    assert_eq!(frame.data(), [0xF2, 0x0B, 0, 0x12, 0x56, 0x34, 0xCD, 0xAB]);
    assert_eq!(Control0::parse(&frame), Some(control));
}

#[test]
fn voltage_target_ignores_the_high_byte() {
    for high in [0x00, 0xFF, 0x7F] {
        let frame = Frame::extended(0x0206_0005, [0, 0, 0, high, 0x00, 0x80, 0, 0]);
        let decoded = Dmc60c::default().decode(5, &frame);
        let expected = Setpoint::Duty(Duty::MIN);
        assert_eq!(decoded, Decoded::Intent(Intent::Drive(expected, DriveOpts::default())));
    }
}

#[test]
fn setpoints_of_every_mode() {
    let table = [
        (0, Setpoint::Duty(Duty::new(0x1234))),
        (1, Setpoint::Velocity(0x1234)),
        (2, Setpoint::Position(0x1234)),
        (3, Setpoint::Current(Amps::from_bits(0x1234))),
        (4, Setpoint::Voltage(Volts::from_bits(0x1234))),
        (5, Setpoint::Follow(0x34)),
        (15, Setpoint::Off),
    ];
    for (code, setpoint) in table {
        let control = Control0 { mode: ModeSelect::from_code(code), target: 0x1234, ..Control0::default() };
        let decoded = Dmc60c::default().decode(5, &control.emit(5));
        assert_eq!(decoded, Decoded::Intent(Intent::Drive(setpoint, DriveOpts { neutral: None, ..drive_opts(&control) })));
    }
}

#[test]
fn reserved_modes_switch_off() {
    for code in 6..15 {
        let control = Control0 { mode: ModeSelect::Reserved(code), target: 1000, ..Control0::default() };
        match Dmc60c::default().decode(5, &control.emit(5)) {
            Decoded::Intent(Intent::Drive(Setpoint::Off, _)) => {}
            other => panic!("mode {code}: {other:?}"),
        }
    }
}

#[test]
fn wrong_lengths_and_remote_frames_are_refused() {
    let good = Control0 { mode: ModeSelect::Voltage, target: 1000, ..Control0::default() }.emit(5);
    for len in 0..8 {
        assert_eq!(Dmc60c::default().decode(5, &good.shortened(len)), Decoded::Bad(Bad::Length));
    }
    let remote = Frame::remote(good.id(), 8).unwrap();
    assert_eq!(Dmc60c::default().decode(5, &remote), Decoded::Bad(Bad::Remote));
}

#[test]
fn i5_frames_for_other_devices_are_not_accepted() {
    let mut dialect = Dmc60c::default();
    for number in (0..64).filter(|number| *number != 5) {
        assert_eq!(dialect.decode(5, &Control0::default().emit(number)), Decoded::Ignored);
    }
    let eleven_bit = Frame::standard(0x005, [0; 8]);
    assert_eq!(dialect.decode(5, &eleven_bit), Decoded::Ignored);
    assert_eq!(dialect.decode(5, &Frame::extended(0x0205_0005, [0; 8])), Decoded::Ignored);
}

#[test]
fn only_the_master_s_general_status_is_followed() {
    let mut dialect = Dmc60c::default();
    let follow = Control0 { mode: ModeSelect::Follower, target: 9, ..Control0::default() };
    dialect.decode(5, &follow.emit(5));
    let params = Params::new();
    let snapshot = Snapshot { actuation: Actuation::Drive(Duty::new(-77)), ..Snapshot::default() };
    let report = status_general(&view(&params, &settings(&params), &snapshot));
    assert_eq!(dialect.decode(5, &report.emit(8)), Decoded::Ignored);
    let decoded = dialect.decode(5, &report.emit(9));
    assert_eq!(decoded, Decoded::Intent(Intent::MasterReport(Duty::new(-77))));
    assert_eq!(dialect.decode(5, &report.emit(9).shortened(7)), Decoded::Bad(Bad::Length));
    dialect.decode(5, &Control0::default().emit(5));
    assert_eq!(dialect.decode(5, &report.emit(9)), Decoded::Ignored, "no longer following");
}

#[test]
fn general_status_bits_stand_where_the_guide_puts_them() {
    let mut params = Params::new();
    params.set(ParameterId::ForwardLimitNormallyClosed, 1).unwrap();
    params.set(ParameterId::ReverseLimitDisabled, 1).unwrap();
    params.set(ParameterId::SoftForwardEnable, 1).unwrap();
    let snapshot = Snapshot {
        mode: Mode::Position,
        actuation: Actuation::Drive(Duty::new(0x0102)),
        error: -2,
        opts: DriveOpts {
            limits: LimitOverride { enabled: true, disabled: Directions::REVERSE },
            ..DriveOpts::default()
        },
        limits: LimitStatus {
            switch_hit: Directions::FORWARD,
            soft_hit: Directions::REVERSE,
            ..LimitStatus::NONE
        },
        current_limited: true,
        faults: crate::engine::snapshot::Faults::NONE.with(Fault::UnderVoltage),
        pins: Pins::default().with(Pin::ReverseLimit, false),
        ..Snapshot::default()
    };
    let frame = status_general(&view(&params, &settings(&params), &snapshot)).emit(5);
    assert_eq!(frame.extended_id(), Some(0x0206_1405));
    let fs0 = 0b0100_1011; // reverse: disabled; forward: pin high, hit, normally closed
    let fs1 = 0b1011_0101; // limited, soft reverse hit, soft forward enabled, reverse override, override
    let fs2 = 0b0001_0010; // position mode, under-voltage
    assert_eq!(frame.data(), [0x02, 0x01, fs0, fs1, fs2, 0xFE, 0xFF, 0xFF]);
}

#[test]
fn error_field_divides_by_256_only_on_overflow() {
    let table = [
        (Mode::Velocity, I24_MAX, (I24_MAX, false)),
        (Mode::Position, I24_MAX + 1, (0x8000, true)),
        (Mode::Position, I24_MIN, (I24_MIN, false)),
        (Mode::Position, I24_MIN - 1, (-0x8001, true)),
        (Mode::Current, 127 << 16, (127 << 16, false)),
        (Mode::Voltage, 200 << 16, (200 << 8, true)),
        (Mode::Duty, 32767, (32767, false)),
        (Mode::Duty, -65535, (-256, true)),
        (Mode::Follow, 1234, (0, false)),
        (Mode::Off, 1234, (0, false)),
    ];
    for (mode, error, expected) in table {
        assert_eq!(error_field(mode, error), expected, "{mode:?} {error}");
    }
}

#[test]
fn encoder_status_divides_at_its_limits() {
    // Guide, "Quadrature Encoder Status Frames": ×8 makes 27 bits, ×4 makes 18 bits.
    let params = Params::new();
    let at = |position, velocity| {
        let snapshot = Snapshot { position, velocity, ..Snapshot::default() };
        status_encoder(&view(&params, &settings(&params), &snapshot))
    };
    let below = at(I24_MAX, 32767);
    assert_eq!((below.position_divided, below.velocity_divided), (false, false));
    let above = at(I24_MAX + 1, 32768);
    assert_eq!((above.position, above.position_divided), (0x10_0000, true));
    assert_eq!((above.velocity, above.velocity_divided), (8192, true));
    assert_eq!(above.position_counts(), I24_MAX + 1);
    assert_eq!(above.velocity_counts_per_100ms(), 32768);
    let negative = at(I24_MIN - 1, -32769);
    assert_eq!((negative.position, negative.velocity), (-0x10_0001, -8193));
    let far = at(i32::MAX, i32::MAX);
    assert_eq!((far.position, far.velocity), (I24_MAX, 32767));
    assert_eq!(far.position_counts(), 67_108_856);
    assert_eq!(at(i32::MIN, i32::MIN).position_counts(), -67_108_864);
}

#[test]
fn encoder_status_bytes_are_big_endian() {
    let status = StatusEncoder {
        position: 0x12_34_56,
        position_divided: true,
        velocity: 0x789A,
        velocity_divided: false,
        pin_a: true,
        pin_b: false,
        pin_index: true,
    };
    let frame = status.emit(63);
    assert_eq!(frame.extended_id(), Some(0x0206_14BF));
    assert_eq!(frame.data(), [0x12, 0x34, 0x56, 0x78, 0x9A, 0, 0, 0b1_0101]);
}

#[test]
fn analog_status_is_8_8_little_endian_and_saturates() {
    let params = Params::new();
    let snapshot = Snapshot {
        analog_in: Volts::from_num(1.5),
        current: Amps::from_num(-2.25),
        temperature: Volts::from_num(300),
        bus_voltage: Volts::from_num(12),
        ..Snapshot::default()
    };
    let frame = status_analog(&view(&params, &settings(&params), &snapshot)).emit(5);
    assert_eq!(frame.extended_id(), Some(0x0206_14C5));
    assert_eq!(frame.data(), [0x80, 0x01, 0xC0, 0xFD, 0xFF, 0x7F, 0x00, 0x0C]);
}

#[test]
fn status_frames_start_one_period_after_the_bus_and_keep_their_rhythm() {
    let params = Params::new();
    let snapshot = Snapshot::default();
    let mut dialect = Dmc60c::default();
    let mut seen = [0; 3];
    dialect.start(Instant::ZERO, &params);
    for millis in 0..=1000 {
        let now = Instant::ZERO + Duration::from_millis(millis);
        while let Some(Outgoing::Status(frame)) = dialect.encode(now, &view(&params, &settings(&params), &snapshot)) {
            assert!(millis >= 10);
            let kind = match base(frame.raw_id()) {
                id::STATUS_GENERAL => 0,
                id::STATUS_ENCODER => 1,
                _ => 2,
            };
            seen[kind] += 1;
        }
    }
    assert_eq!(seen, [100, 10, 10]);
    dialect.stop();
    assert_eq!(dialect.next_deadline(), None);
}

prop_compose! {
    fn any_frame()(id in 0..0x2000_0000_u32, extended: bool, data: [u8; 8], len in 0..=8_usize, remote in 0..10_u8) -> Frame {
        let frame = if extended { Frame::extended(id, data) } else { Frame::standard(id as u16, data) };
        if remote == 0 { Frame::remote(frame.id(), len).unwrap() } else { frame.shortened(len) }
    }
}

proptest! {
    /// I7: what a parser understands it emits again, but for reserved bits.
    #[test]
    fn i7_encode_of_decode_is_the_frame(data: [u8; 8]) {
        let reserved = [0, 0xF0, 0xFF, 0, 0, 0, 0, 0];
        let mut clean = data;
        for (byte, mask) in clean.iter_mut().zip(reserved) { *byte &= !mask; }
        let frame = Frame::extended(0x0206_0005, clean);
        prop_assert_eq!(Control0::parse(&frame).unwrap().emit(5), frame);
        let frame = Frame::extended(0x0206_1405, data);
        prop_assert_eq!(StatusGeneral::parse(&frame).unwrap().emit(5), frame);
        let frame = Frame::extended(0x0206_14C5, data);
        prop_assert_eq!(StatusAnalog::parse(&frame).unwrap().emit(5), frame);
        let mut encoder = data;
        (encoder[5], encoder[6]) = (0, 0);
        encoder[7] &= 0x1F;
        let frame = Frame::extended(0x0206_1485, encoder);
        prop_assert_eq!(StatusEncoder::parse(&frame).unwrap().emit(5), frame);
    }

    /// I1 for the decoder.
    #[test]
    fn i1_no_frame_panics_the_decoder(frames in proptest::collection::vec(any_frame(), 1..20), own in 0..64_u8) {
        let mut dialect = Dmc60c::default();
        for frame in frames {
            let _ = dialect.decode(own, &frame);
        }
    }
}
