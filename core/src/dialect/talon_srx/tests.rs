//! The rules of enable, control and status frames and of parameters, without an engine. Layouts have their
//! own tests in `wire`.

use super::*;
use super::wire::{Control1, Control5, General};
use crate::dialect::{Device, Request};
use crate::engine::command::PositionOf;
use crate::engine::{Board, Settings};
use crate::params::compile;
use crate::engine::snapshot::{Actuation, Pins, Snapshot};
use proptest::prelude::*;
use wire::{ParameterRequest, ParameterValue, TABLE};

extern crate std;
use std::sync::LazyLock;
use std::vec::Vec;

const OWN: u8 = 3;

fn at(millis: u32) -> Instant {
    Instant::ZERO + Duration::from_millis(millis)
}

fn general(mode: ModeSelect, demand: i32) -> General {
    General { mode, demand, ..General::default() }
}

fn control_1(mode: ModeSelect, demand: i32) -> Frame {
    Control1 { token: 0, general: Some(general(mode, demand)) }.emit(OWN)
}

fn short() -> Frame {
    Control1 { token: 0, general: None }.emit(OWN)
}

fn disable_all() -> Frame {
    Frame::extended(id::DISABLE_ALL, [])
}

fn intent(decoded: Decoded) -> Intent {
    match decoded {
        Decoded::Intent(intent) => intent,
        other => panic!("{other:?}"),
    }
}

/// No frame of this dialect shows settings other than by their effects.
static SETTINGS: LazyLock<Settings> =
    LazyLock::new(|| compile::settings(&Params::new(), &Board::REFERENCE, &TalonSrx::POLICY));

fn view<'a>(params: &'a Params, snapshot: &'a Snapshot) -> View<'a> {
    View { number: OWN, params, settings: &SETTINGS, snapshot, device: Device::default() }
}

/// A dialect whose bus has just appeared and that has sent its start-up frame.
fn started() -> TalonSrx {
    let (params, snapshot) = (Params::new(), Snapshot::default());
    let mut talon = TalonSrx::default();
    talon.start(at(0), &params);
    let first = talon.encode(at(0), &view(&params, &snapshot));
    assert!(matches!(first, Some(Outgoing::Status(frame)) if base(frame.raw_id()) == id::STATUS_5));
    talon
}

/// Whether a frame means anything to the device, be it refused for its length.
fn takes(talon: &mut TalonSrx, frame: &Frame) -> bool {
    talon.decode(OWN, frame) != Decoded::Ignored
}

#[test]
fn i5_only_frames_for_this_device_are_taken() {
    let accepts = |raw| takes(&mut TalonSrx::default(), &Frame::extended(raw, []));
    for base in [
        id::CONTROL_1,
        id::CONTROL_2,
        id::CONTROL_3,
        id::CONTROL_5,
        id::PARAMETER_REQUEST,
        id::PARAMETER_SET,
    ] {
        for number in 0..64 {
            assert_eq!(accepts(base | number), number == 3 || number == 63, "{base:x} {number}");
        }
    }
    assert!(accepts(id::GLOBAL_ENABLE) && accepts(id::DISABLE_ALL));
    for foreign in [1, 0x0004_0183, id::STATUS_1 | 3, id::PARAMETER_RESPONSE | 3, 0x0206_0003] {
        assert!(!accepts(foreign), "{foreign:x}");
    }
    let standard = Frame::standard(0, []);
    assert!(!takes(&mut TalonSrx::default(), &standard), "only 29-bit frames");
}

#[test]
fn a_number_of_zero_works() {
    let mut talon = TalonSrx::default();
    let frame = Control1 { token: 0, general: Some(general(ModeSelect::Duty, 7)) }.emit(0);
    let opts = drive_opts(general(ModeSelect::Duty, 7).raw());
    let setpoint = Setpoint::Duty(Duty::from_throttle(7));
    assert_eq!(intent(talon.decode(0, &frame)), Intent::Drive(setpoint, opts));
}

#[test]
fn modes_of_firmware_1_1_drive_and_all_others_are_neutral() {
    for code in 0..16 {
        let mode = ModeSelect::from_code(code);
        let expected = match code {
            0 => Setpoint::Duty(Duty::from_throttle(500)),
            1 => Setpoint::Position(500),
            2 => Setpoint::Velocity(500),
            5 => Setpoint::Follow((500 & 63) as u8),
            _ => Setpoint::Neutral,
        };
        assert_eq!(setpoint(general(mode, 500).raw()), expected, "mode {code}");
        let blind = General { feedback: FeedbackDevice::Unsupported(5), ..general(mode, 500) };
        if code == 1 || code == 2 {
            assert_eq!(setpoint(blind.raw()), Setpoint::Neutral);
        } else {
            assert_eq!(setpoint(blind.raw()), expected);
        }
    }
    assert_eq!(setpoint(general(ModeSelect::Duty, 5000).raw()), Setpoint::Duty(Duty::MAX));
    assert_eq!(setpoint(general(ModeSelect::Duty, -5000).raw()), Setpoint::Duty(Duty::MIN));
}

#[test]
fn the_output_is_turned_in_closed_loops_and_while_following_only() {
    for (mode, turned) in [
        (ModeSelect::Duty, false),
        (ModeSelect::Position, true),
        (ModeSelect::Velocity, true),
        (ModeSelect::Follower, true),
    ] {
        let told = General { reverse_output: true, ..general(mode, 0) };
        assert_eq!(drive_opts(told.raw()).reverse_motor, turned);
    }
}

#[test]
fn a_global_disable_holds_until_the_global_enable() {
    let mut talon = TalonSrx::default();
    let mut decode = |frame: Frame| talon.decode(OWN, &frame);
    let enable = |enabled| GlobalEnable { enabled }.emit();
    let drive = control_1(ModeSelect::Duty, 100);
    assert!(matches!(intent(decode(drive)), Intent::Drive(..)));
    assert_eq!(intent(decode(enable(false))), Intent::Enable(false));
    assert!(matches!(intent(decode(drive)), Intent::Prepare(..)), "taken, but no permission");
    assert_eq!(decode(short()), Decoded::Ignored);
    assert_eq!(intent(decode(enable(true))), Intent::Enable(true));
    assert!(matches!(intent(decode(drive)), Intent::Drive(..)));
    assert_eq!(intent(decode(short())), Intent::Enable(true));
}

#[test]
fn the_broadcast_disable_holds_until_a_control_1_whatever_its_data() {
    let mut talon = TalonSrx::default();
    let remote = Frame::remote(embedded_can::ExtendedId::ZERO, 8).unwrap();
    for disable in [disable_all(), Frame::extended(0, [9; 8]), remote] {
        assert_eq!(intent(talon.decode(OWN, &disable)), Intent::Enable(false));
        let enable = GlobalEnable { enabled: true }.emit();
        assert_eq!(talon.decode(OWN, &enable), Decoded::Ignored);
        let content = Control5 { bump: 0, general: general(ModeSelect::Duty, 1) }.emit(OWN);
        assert!(matches!(intent(talon.decode(OWN, &content)), Intent::Prepare(..)));
        assert_eq!(intent(talon.decode(OWN, &short())), Intent::Enable(true));
        assert_eq!(intent(talon.decode(OWN, &enable)), Intent::Enable(true));
    }
}

#[test]
fn a_held_disable_survives_the_loss_of_the_bus() {
    let mut talon = TalonSrx::default();
    talon.decode(OWN, &GlobalEnable { enabled: false }.emit());
    talon.stop();
    talon.start(at(0), &Params::new());
    let decoded = talon.decode(OWN, &control_1(ModeSelect::Duty, 100));
    assert!(matches!(intent(decoded), Intent::Prepare(..)));
}

#[test]
fn only_the_followed_controller_is_heard_and_its_throttle_copied() {
    let mut talon = TalonSrx::default();
    let report = Status1 { throttle: -1023, ..Status1::default() };
    assert!(!takes(&mut talon, &report.emit(9)));
    talon.decode(OWN, &control_1(ModeSelect::Follower, 9));
    assert!(takes(&mut talon, &report.emit(9)));
    assert!(!takes(&mut talon, &report.emit(8)));
    let decoded = talon.decode(OWN, &report.emit(9));
    assert_eq!(intent(decoded), Intent::MasterReport(Duty::MIN));
    talon.decode(OWN, &control_1(ModeSelect::Duty, 9));
    assert!(!takes(&mut talon, &report.emit(9)));
}

#[test]
fn bad_lengths_and_remote_frames_are_counted_and_change_nothing() {
    let mut talon = started();
    let before = std::format!("{talon:?}");
    for base in [id::CONTROL_1, id::CONTROL_2, id::CONTROL_5, id::PARAMETER_SET] {
        let raw = base | u32::from(OWN);
        let short = Frame::extended(raw, [1, 2, 3]);
        assert_eq!(talon.decode(OWN, &short), Decoded::Bad(Bad::Length), "{base:x}");
        let remote = Frame::remote(embedded_can::ExtendedId::new(raw).unwrap(), 8).unwrap();
        assert_eq!(talon.decode(OWN, &remote), Decoded::Bad(Bad::Remote), "{base:x}");
    }
    for empty in [id::CONTROL_3 | 3, id::GLOBAL_ENABLE] {
        let frame = Frame::extended(empty, []);
        assert_eq!(talon.decode(OWN, &frame), Decoded::Bad(Bad::Length));
    }
    assert_eq!(std::format!("{talon:?}"), before);
}

/// Frames of `span` milliseconds, polled twice a millisecond, as base identifiers with their time in ms.
fn frames(talon: &mut TalonSrx, from: u32, span: u32) -> Vec<(u32, u32)> {
    let (params, snapshot) = (Params::new(), Snapshot::default());
    let mut sent = Vec::new();
    for tick in 2 * from..2 * (from + span) {
        let now = Instant::ZERO + Duration::from_ticks(tick);
        while let Some(outgoing) = talon.encode(now, &view(&params, &snapshot)) {
            let (Outgoing::Status(frame) | Outgoing::Answer(frame)) = outgoing;
            sent.push((base(frame.raw_id()), tick / 2));
        }
    }
    sent
}

fn times(sent: &[(u32, u32)], id: u32) -> Vec<u32> {
    sent.iter().filter(|frame| frame.0 == id).map(|frame| frame.1).collect()
}

#[test]
fn default_periods_are_those_of_the_manual_and_each_is_changed_alone() {
    let mut talon = started();
    let sent = frames(&mut talon, 0, 401);
    for (id, count) in [
        (id::STATUS_1, 40),
        (id::STATUS_2, 20),
        (id::STATUS_3, 4),
        (id::STATUS_4, 4),
        (id::STATUS_5, 0),
        (id::STATUS_6, 0),
        (id::STATUS_7, 0),
    ] {
        assert_eq!(times(&sent, id).len(), count, "{id:x}");
    }
    assert_eq!(times(&sent, id::STATUS_1)[..3], [10, 20, 30]);
    let control = Control2 { periods: [0, 1, 255, 0] };
    assert_eq!(talon.decode(OWN, &control.emit(OWN)), Decoded::Done);
    let sent = frames(&mut talon, 401, 1020);
    assert_eq!(times(&sent, id::STATUS_1).len(), 102);
    assert!((1018..=1020).contains(&times(&sent, id::STATUS_2).len()));
    assert!((3..=4).contains(&times(&sent, id::STATUS_3).len()));
    assert!((10..=11).contains(&times(&sent, id::STATUS_4).len()));
}

#[test]
fn the_start_up_frame_is_sent_once() {
    let mut talon = started();
    talon.stop();
    talon.start(at(50), &Params::new());
    assert!(times(&frames(&mut talon, 50, 100), id::STATUS_5).is_empty());
}

#[test]
fn status_6_and_7_begin_and_end_by_parameter() {
    let mut talon = started();
    for (parameter, id) in
        [(Parameter::Status6Period, id::STATUS_6), (Parameter::Status7Period, id::STATUS_7)]
    {
        let set = |value| ParameterValue { parameter: parameter.code(), value }.emit_set(OWN);
        talon.decode(OWN, &set(5));
        assert!(times(&frames(&mut talon, 0, 101), id).len() >= 19);
        talon.decode(OWN, &set(0));
        assert!(times(&frames(&mut talon, 101, 100), id).is_empty());
    }
}

#[test]
fn every_documented_parameter_answers_a_request_and_a_set_and_no_other_does() {
    let (params, snapshot) = (Params::new(), Snapshot::default());
    for code in 0..=255 {
        let mut talon = started();
        let known = Parameter::from_code(code);
        let ask = |talon: &mut TalonSrx, frame: Frame| {
            let decoded = talon.decode(OWN, &frame);
            if let Decoded::Request(Request::Write(row, value)) = decoded {
                talon.answer(Outcome { parameter: row, result: Ok(value) });
            }
            match talon.encode(at(0), &view(&params, &snapshot)) {
                Some(Outgoing::Answer(frame)) => ParameterValue::parse_response(&frame),
                _ => None,
            }
        };
        let request = ParameterRequest { parameter: code }.emit(OWN);
        let set = ParameterValue { parameter: code, value: 1 }.emit_set(OWN);
        for frame in [request, set] {
            let answer = ask(&mut talon, frame).map(|answer| answer.parameter);
            assert_eq!(answer, known.map(Parameter::code), "{code}");
        }
    }
}

#[test]
fn a_burst_of_requests_is_answered_whole() {
    let (params, snapshot) = (Params::new(), Snapshot::default());
    let mut talon = started();
    for row in TABLE {
        talon.decode(OWN, &ParameterRequest { parameter: row.id.code() }.emit(OWN));
    }
    let mut answered = 0;
    while let Some(Outgoing::Answer(_)) = talon.encode(at(0), &view(&params, &snapshot)) {
        answered += 1;
    }
    assert_eq!(answered, TABLE.len());
}

#[test]
fn live_values_are_set_by_intents_and_answered_with_what_they_will_be() {
    let (params, snapshot) = (Params::new(), Snapshot::default());
    let mut talon = started();
    let position = |value: i32| Intent::SetPosition(PositionOf::Selected, value);
    let set = |talon: &mut TalonSrx, parameter: Parameter, value: i32| {
        let frame =
            ParameterValue { parameter: parameter.code(), value: value as u32 }.emit_set(OWN);
        let decoded = talon.decode(OWN, &frame);
        let Some(Outgoing::Answer(frame)) = talon.encode(at(0), &view(&params, &snapshot)) else {
            panic!("no answer");
        };
        (decoded, ParameterValue::parse_response(&frame).unwrap().value as i32)
    };
    let got = set(&mut talon, Parameter::SensorPosition, -77);
    assert_eq!(got, (Decoded::Intent(position(-77)), -77));
    let got = set(&mut talon, Parameter::EncoderPosition, 5);
    assert_eq!(got, (Decoded::Intent(Intent::SetPosition(PositionOf::Encoder, 5)), 5));
    let got = set(&mut talon, Parameter::IntegralAccumulator, 9);
    assert_eq!(got, (Decoded::Intent(Intent::SetAccumulator(9)), 9));
    assert_eq!(set(&mut talon, Parameter::IndexRiseEvents, 4), (Decoded::Done, 4));
    assert_eq!(talon.status_3(&view(&params, &snapshot)).index_rises, 4);
    assert_eq!(set(&mut talon, Parameter::AppliedThrottle, 4), (Decoded::Done, 0), "read only");
    let told = General { feedback: FeedbackDevice::AnalogPotentiometer, ..General::default() };
    talon.decode(OWN, &Control1 { token: 0, general: Some(told) }.emit(OWN));
    assert_eq!(set(&mut talon, Parameter::SensorPosition, 3).1, 0, "the potentiometer stays");
}

#[test]
fn both_flags_of_control_3_are_seen() {
    let mut talon = TalonSrx::default();
    let frame = Control3 { zero_sensor: true, clear_sticky: true }.emit(OWN);
    let expected = Intent::Clear { position: true, sticky: true };
    assert_eq!(intent(talon.decode(OWN, &frame)), expected);
}

#[test]
fn the_general_status_mirrors_what_was_told_and_shows_what_is() {
    let params = Params::new();
    let mut talon = TalonSrx::default();
    let told = General {
        feedback: FeedbackDevice::AnalogEncoder,
        limits: LimitOverride::Forced { forward: false, reverse: true },
        slot_1: true,
        ..general(ModeSelect::VoltageCompensation, 9)
    };
    talon.decode(OWN, &Control1 { token: 0, general: Some(told) }.emit(OWN));
    let mut snapshot = Snapshot {
        state: DriveState::Running,
        actuation: Actuation::Drive(Duty::from_throttle(-700)),
        error: i32::MIN,
        pins: Pins::default().with(Pin::ForwardLimit, false),
        ..Snapshot::default()
    };
    snapshot.limits.switch_hit = Directions::FORWARD;
    snapshot.limits.soft_hit = Directions::REVERSE;
    let status = talon.status_1(&view(&params, &snapshot));
    assert_eq!(status.mode, ModeSelect::VoltageCompensation);
    assert_eq!((status.feedback, status.limits), (told.feedback, told.limits));
    assert_eq!((status.throttle, status.error), (-700, i32::MIN));
    assert!(status.token_locked && status.forward_closed && !status.reverse_closed);
    assert!(status.faults.forward_limit && status.faults.reverse_soft);
    snapshot.limits.switch_disabled = Directions::FORWARD;
    let status = talon.status_1(&view(&params, &snapshot));
    assert!(status.forward_closed && !status.faults.forward_limit, "manual 16.22");
    let feedback = talon.status_2(&view(&params, &snapshot));
    assert!(feedback.slot_1 && feedback.brake && !feedback.control_5_allowed);
}

proptest! {
    #[test]
    fn i1_no_frame_panics(
        frames in proptest::collection::vec((0..20_u8, any::<[u8; 8]>(), 0..=8_usize, any::<bool>()), 1..40),
    ) {
        let (params, snapshot) = (Params::new(), Snapshot::default());
        let bases = [
            id::CONTROL_1, id::CONTROL_2, id::CONTROL_3, id::CONTROL_5, id::STATUS_1,
            id::PARAMETER_REQUEST, id::PARAMETER_SET,
        ];
        let mut talon = TalonSrx::default();
        talon.start(at(0), &params);
        for (millis, (which, data, len, remote)) in (0..).zip(frames) {
            let raw = match bases.get(usize::from(which)) {
                Some(base) => base | u32::from(OWN),
                None => [id::GLOBAL_ENABLE, id::DISABLE_ALL][usize::from(which % 2)],
            };
            let raw_id = embedded_can::ExtendedId::new(raw).unwrap();
            let frame = if remote {
                Frame::remote(raw_id, len).unwrap()
            } else {
                Frame::new(raw_id, &data[..len]).unwrap()
            };
            talon.decode(OWN, &frame);
            let _ = talon.encode(at(millis), &view(&params, &snapshot));
        }
    }
}
