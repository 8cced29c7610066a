use super::*;
use crate::frame::Frame;
use proptest::prelude::*;

extern crate std;
use std::vec::Vec;

/// Frames that clients are known to send (docs/talon-srx.md, "Key samples" and start-up sequence).
#[test]
fn golden_control_frames() {
    let control = |general| {
        Control1 {
            token: 0,
            general: Some(general),
        }
        .emit(3)
    };
    let base = General {
        limits: LimitOverride::STORED,
        ..General::default()
    };
    let duty = |demand| General {
        demand,
        mode: ModeSelect::Duty,
        limits: LimitOverride::STORED,
        ..General::default()
    };
    assert_eq!(
        control(General {
            mode: ModeSelect::Duty,
            limits: LimitOverride::Stored(0),
            ..base
        }),
        Frame::extended(0x0204_0003, [0; 8])
    );
    assert_eq!(
        control(duty(0)),
        Frame::extended(0x0204_0003, [0, 0, 0, 0, 0, 0x20, 0, 0])
    );
    assert_eq!(
        control(base),
        Frame::extended(0x0204_0003, [0, 0, 0, 0, 0, 0x20, 0xF0, 0])
    );
    assert_eq!(
        control(duty(511)),
        Frame::extended(0x0204_0003, [0, 0, 0, 1, 0xFF, 0x20, 0, 0])
    );
    assert_eq!(
        control(duty(-1023)),
        Frame::extended(0x0204_0003, [0, 0, 0xFF, 0xFC, 1, 0x20, 0, 0])
    );
    assert_eq!(
        control(General {
            demand: 17,
            mode: ModeSelect::Follower,
            ..base
        }),
        Frame::extended(0x0204_0003, [0, 0, 0, 0, 0x11, 0x20, 0x50, 0])
    );
    let gain = ParameterValue {
        parameter: 1,
        value: 838_860,
    };
    assert_eq!(
        gain.emit_set(3),
        Frame::extended(0x0204_1883, [1, 0xCC, 0xCC, 0x0C, 0])
    );
    let position = ParameterValue {
        parameter: Parameter::SensorPosition.code(),
        value: 0,
    };
    assert_eq!(
        position.emit_set(3),
        Frame::extended(0x0204_1883, [0x49, 0, 0, 0, 0])
    );
    let clear = Control3 {
        clear_sticky: true,
        ..Control3::default()
    };
    assert_eq!(clear.emit(3), Frame::extended(0x0204_0083, [2, 0, 0, 0]));
    assert_eq!(
        Control3::parse(&Frame::extended(0x0204_0083, [2])),
        Some(clear)
    );
    let periods = Control2 {
        periods: [5, 20, 100, 100],
    };
    assert_eq!(
        periods.emit(3),
        Frame::extended(0x0204_0043, [5, 20, 100, 100])
    );
    let enable = GlobalEnable { enabled: true }.emit();
    assert_eq!(
        enable,
        Frame::extended(0x0004_01BF, [1, 0, 0, 0, 0, 0, 0, 0])
    );
}

#[test]
fn golden_status_frames() {
    let status = Status1 {
        error: -2,
        throttle: -1023,
        mode: ModeSelect::NoDrive,
        faults: LiveFaults {
            forward_limit: true,
            under_voltage: true,
            ..LiveFaults::default()
        },
        forward_closed: true,
        token_locked: true,
        token_seed: 0xA5,
        ..Status1::default()
    };
    // 3: throttle 100b, TokLocked, reverse open 1, forward closed 0; 5: mode bit 3, stored limits.
    assert_eq!(
        status.emit(3),
        Frame::extended(
            0x0204_1403,
            [
                0xFF,
                0xFF,
                0xFE,
                0b0110_0100,
                0x01,
                0b0010_0001,
                0b1110_1100,
                0xA5
            ]
        )
    );
    let feedback = Status2 {
        position: 0x12_3456,
        velocity: -2,
        current: 0x2AB,
        sticky: Sticky {
            over_temperature: true,
            reverse_soft: true,
            ..Sticky::default()
        },
        slot_1: true,
        brake: true,
        ..Status2::default()
    };
    assert_eq!(
        feedback.emit(3),
        Frame::extended(
            0x0204_1443,
            [0x12, 0x34, 0x56, 0xFF, 0xFE, 0xAA, 0b1110_0001, 0xC0]
        )
    );
    let start_up = Status5 {
        reset_count: 0x0102,
        reset_flags: 0x0304,
        version: [1, 1],
    };
    assert_eq!(
        start_up.emit(0),
        Frame::extended(0x0204_1500, [1, 2, 3, 4, 1, 1])
    );
}

#[test]
fn electrical_values_round_to_the_nearest_step_and_saturate() {
    let amps = |value: f64| Amps::from_num(value);
    assert_eq!(
        [0.0, 0.0624, 0.0626, -5.0, 127.9, 500.0].map(|a| current_raw(amps(a))),
        [0, 0, 1, 40, 1023, 1023]
    );
    assert_eq!(current(40), amps(5.0));
    let celsius = |value: f64| Celsius::from_num(value);
    assert_eq!(
        [-60.0, -50.0, 0.0, 25.0, 114.5, 300.0].map(|t| temperature_raw(celsius(t))),
        [0, 0, 78, 116, 255, 255]
    );
    let volts = |value: f64| Volts::from_num(value);
    assert_eq!(
        [0.0, 4.0, 4.03, 12.0, 16.75, 30.0].map(|v| battery_raw(volts(v))),
        [0, 0, 1, 160, 255, 255]
    );
    for raw in 0..=255 {
        assert_eq!(temperature_raw(temperature(raw)), raw);
        assert_eq!(battery_raw(battery(raw)), raw);
    }
    for raw in 0..=1023 {
        assert_eq!(current_raw(current(raw)), raw);
    }
    assert_eq!(to_10_22(12 << 16), 12 << 22);
    assert_eq!(to_10_22(i32::MAX), i32::MAX);
    assert_eq!(to_10_22(i32::MIN), i32::MIN);
}

#[test]
fn every_code_has_its_meaning_and_back() {
    for code in 0..16 {
        assert_eq!(ModeSelect::from_code(code).code(), code);
        assert_eq!(FeedbackDevice::from_code(code).code(), code);
        assert_eq!(LimitOverride::from_code(code).code(), code & 7);
        assert_eq!(BrakeOverride::from_code(code).code(), code & 3);
    }
    let forced = |forward, reverse| LimitOverride::Forced { forward, reverse };
    let expected = [
        forced(false, false),
        forced(false, true),
        forced(true, false),
        forced(true, true),
    ];
    assert_eq!([4, 5, 6, 7].map(LimitOverride::from_code), expected);
}

#[test]
fn parameters_are_in_ascending_order_and_found_by_number() {
    assert!(TABLE.windows(2).all(|pair| pair[0].id < pair[1].id));
    for row in TABLE {
        assert_eq!(Parameter::from_code(row.id.code()), Some(row.id));
        assert_eq!(
            (row.id.encoding(), row.id.access()),
            (row.encoding, row.access)
        );
    }
    let known: Vec<u8> = (0..=255)
        .filter(|code| Parameter::from_code(*code).is_some())
        .collect();
    assert_eq!(known.len(), TABLE.len());
    for unknown in [0, 7, 10, 17, 20, 25, 30, 36, 40, 54, 60, 72, 92, 100, 255] {
        assert!(!known.contains(&unknown), "{unknown}");
    }
}

#[test]
fn wrong_lengths_and_remote_frames_are_nothing() {
    for len in 0..=8 {
        let data = [0xFF; 8];
        let frame = Frame::extended(0x0204_0003, data).shortened(len);
        assert_eq!(Control1::parse(&frame).is_some(), len == 8 || len == 2);
        assert_eq!(Control2::parse(&frame).is_some(), len == 4);
        assert_eq!(Control3::parse(&frame).is_some(), len >= 1);
        assert_eq!(GlobalEnable::parse(&frame).is_some(), len >= 1);
        assert_eq!(Control5::parse(&frame).is_some(), len == 8);
        for eight in [
            Status1::parse(&frame).is_some(),
            Status2::parse(&frame).is_some(),
            Status3::parse(&frame).is_some(),
            Status4::parse(&frame).is_some(),
            Status6::parse(&frame).is_some(),
        ] {
            assert_eq!(eight, len == 8);
        }
        assert_eq!(Status5::parse(&frame).is_some(), len == 6);
        assert_eq!(Status7::parse(&frame).is_some(), len == 6);
        assert_eq!(ParameterRequest::parse(&frame).is_some(), len == 1);
        assert_eq!(ParameterValue::parse_set(&frame).is_some(), len == 5);
        assert_eq!(ParameterValue::parse_response(&frame).is_some(), len == 5);
        let id = embedded_can::ExtendedId::new(0x0204_0003).unwrap();
        let remote = Frame::remote(id, len).unwrap();
        assert!(Control1::parse(&remote).is_none() && Control3::parse(&remote).is_none());
    }
}

fn general() -> impl Strategy<Value = General> {
    (
        (-0x80_0000..=0x7F_FFFF_i32, any::<[bool; 3]>()),
        (0..16_u8, 0..8_u8, 0..4_u8, 0..16_u8, any::<u8>()),
    )
        .prop_map(
            |((demand, flags), (feedback, limits, brake, mode, ramp))| General {
                demand,
                slot_1: flags[0],
                feedback: FeedbackDevice::from_code(feedback),
                limits: LimitOverride::from_code(limits),
                reverse_sensor: flags[1],
                reverse_output: flags[2],
                brake: BrakeOverride::from_code(brake),
                mode: ModeSelect::from_code(mode),
                ramp,
            },
        )
}

proptest! {
    #[test]
    fn i7_every_control_frame_reads_back(
        general in general(), token: u16, bump in 0..0x800_u16, short: bool, number in 0..63_u8,
        periods: [u8; 4], flags: [bool; 3],
    ) {
        let control = Control1 { token, general: (!short).then_some(general) };
        prop_assert_eq!(Control1::parse(&control.emit(number)), Some(control));
        let control = Control5 { bump, general };
        prop_assert_eq!(Control5::parse(&control.emit(number)), Some(control));
        let control = Control2 { periods };
        prop_assert_eq!(Control2::parse(&control.emit(number)), Some(control));
        let control = Control3 { zero_sensor: flags[0], clear_sticky: flags[1] };
        prop_assert_eq!(Control3::parse(&control.emit(number)), Some(control));
        let enable = GlobalEnable { enabled: flags[2] };
        prop_assert_eq!(GlobalEnable::parse(&enable.emit()), Some(enable));
    }

    /// Every bit of the eight-byte frames has a place, apart from the reserved ones.
    #[test]
    fn i7_every_frame_is_emitted_as_it_was_parsed(data: [u8; 8], number in 0..63_u8) {
        let frame = |base: u32, mask: [u8; 8]| {
            let mut data = data;
            for (byte, mask) in data.iter_mut().zip(mask) {
                *byte &= mask;
            }
            Frame::extended(base | u32::from(number), data)
        };
        let all = [0xFF; 8];
        let control_1 = frame(id::CONTROL_1, all);
        prop_assert_eq!(Control1::parse(&control_1).unwrap().emit(number), control_1);
        let control_5 = frame(id::CONTROL_5, [7, 255, 255, 255, 255, 255, 255, 255]);
        prop_assert_eq!(Control5::parse(&control_5).unwrap().emit(number), control_5);
        let status_1 = frame(id::STATUS_1, all);
        let parsed = Status1::parse(&status_1).unwrap();
        if parsed.throttle != -1024 {
            prop_assert_eq!(parsed.emit(number), status_1);
        }
        let status_2 = frame(id::STATUS_2, [255, 255, 255, 255, 255, 255, 255, 0xF8]);
        prop_assert_eq!(Status2::parse(&status_2).unwrap().emit(number), status_2);
        let status_3 = frame(id::STATUS_3, [255, 255, 255, 255, 255, 255, 255, 0xE0]);
        prop_assert_eq!(Status3::parse(&status_3).unwrap().emit(number), status_3);
        let status_4 = frame(id::STATUS_4, [255, 255, 255, 255, 255, 255, 255, 0]);
        prop_assert_eq!(Status4::parse(&status_4).unwrap().emit(number), status_4);
        let status_5 = frame(id::STATUS_5, all).shortened(6);
        prop_assert_eq!(Status5::parse(&status_5).unwrap().emit(number), status_5);
        let status_6 = frame(id::STATUS_6, [0x83, 255, 3, 255, 3, 255, 3, 255]);
        prop_assert_eq!(Status6::parse(&status_6).unwrap().emit(number), status_6);
        let status_7 = frame(id::STATUS_7, all).shortened(6);
        prop_assert_eq!(Status7::parse(&status_7).unwrap().emit(number), status_7);
        let request = frame(id::PARAMETER_REQUEST, all).shortened(1);
        prop_assert_eq!(ParameterRequest::parse(&request).unwrap().emit(number), request);
        let set = frame(id::PARAMETER_SET, all).shortened(5);
        prop_assert_eq!(ParameterValue::parse_set(&set).unwrap().emit_set(number), set);
        let response = frame(id::PARAMETER_RESPONSE, all).shortened(5);
        prop_assert_eq!(
            ParameterValue::parse_response(&response).unwrap().emit_response(number),
            response
        );
    }

    #[test]
    fn what_does_not_fit_saturates(value: i32, wide: u16, throttle: i16) {
        let limited = value.clamp(-0x80_0000, 0x7F_FFFF);
        let general = General { demand: value, ..General::default() };
        let control = Control1 { token: 0, general: Some(general) }.emit(1);
        prop_assert_eq!(Control1::parse(&control).unwrap().general.unwrap().demand, limited);
        let status = Status1 { error: value, throttle, ..Status1::default() }.emit(1);
        let parsed = Status1::parse(&status).unwrap();
        prop_assert_eq!((parsed.error, parsed.throttle), (limited, throttle.clamp(-1023, 1023)));
        let status = Status2 { position: value, current: wide, ..Status2::default() }.emit(1);
        let parsed = Status2::parse(&status).unwrap();
        prop_assert_eq!((parsed.position, parsed.current), (limited, wide.min(1023)));
        let status = Status6 { analog: wide, ..Status6::default() }.emit(1);
        prop_assert_eq!(Status6::parse(&status).unwrap().analog, wide.min(1023));
    }
}
