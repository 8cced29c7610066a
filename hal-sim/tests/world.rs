//! The whole bench: real nodes on the virtual bus, in virtual time.

mod bench;

use bench::Bench;
use windlass_core::dialect::dmc60c::wire::{self, ModeSelect, StatusGeneral};
use windlass_core::engine::command::Neutral;
use windlass_core::engine::snapshot::{DriveState, Fault};
use windlass_core::frame::Frame;
use windlass_core::frc_id;
use windlass_core::management::vendor::{Command, CommandCode, PinTest, TestPin};
use windlass_core::management::wire::{EnumerateResponse0, EnumerateResponse1, ImageType, id};
use windlass_core::params::table::ParameterId;
use windlass_core::time::{Duration, Instant, TICK};
use windlass_sim::{Poke, Source, WorldConfig, replay};

#[test]
fn a_node_enumerates() {
    let mut bench = Bench::new(&["dmc60c:5"]);
    bench
        .world
        .send(bench.tool, Frame::extended(id::ENUMERATE, []));
    bench.run(100);
    let answers = bench.of_kind(id::ENUMERATE_RESPONSE);
    assert_eq!(answers.len(), 2);
    let first = EnumerateResponse0::parse(&answers[0].frame).unwrap();
    let second = EnumerateResponse1::parse(&answers[1].frame).unwrap();
    assert_eq!(first.session, second.session);
    assert_eq!(Some(first.session), bench.truth(0).session);
    assert_eq!(first.product_id, 0x6020_0103);
    // Device number 5 waits 5 ms: request, delay, at most one tick, the answer's own bits.
    let at = answers[0].at.as_micros();
    assert!((5_000..5_900).contains(&at), "{at}");
}

#[test]
fn voltage_mode_turns_the_motor_and_stops_104_ms_after_silence() {
    let mut bench = Bench::new(&["dmc60c:5"]);
    bench.enumerate();
    bench.drive_for(5, ModeSelect::Voltage, 16_384, 500);
    let truth = bench.truth(0);
    assert_eq!(truth.duty, 16_384);
    // Half of 12.7 V, 2.4 A of friction: a little under half of 36 386 · 12.7 / 12.
    assert!(
        (17_500.0..19_500.0).contains(&truth.velocity_counts_per_100ms),
        "{truth:?}"
    );
    let status = bench.of_kind(wire::id::STATUS_GENERAL);
    let last = StatusGeneral::parse(&status.last().unwrap().frame).unwrap();
    assert_eq!((last.duty, last.mode), (16_384, ModeSelect::Voltage));

    bench.drive(5, ModeSelect::Voltage, 16_384);
    let sent_at = bench.world.now();
    let mut stopped_after = None;
    for tick in 1..250 {
        bench.world.advance(TICK);
        if bench.truth(0).duty == 0 {
            stopped_after = Some(tick);
            break;
        }
    }
    // 208 ticks and at most one for the frame's way to the next tick.
    assert!(
        matches!(stopped_after, Some(208..=209)),
        "{stopped_after:?} from {sent_at:?}"
    );
    assert_eq!(bench.truth(0).drive_state, DriveState::Halted);
}

#[test]
fn status_frames_keep_their_periods_on_a_busy_bus() {
    let nodes = ["dmc60c:1", "dmc60c:2", "dmc60c:3", "dmc60c:4"];
    let mut bench = Bench::new(&nodes);
    bench.enumerate();
    for _ in 0..100 {
        for number in 1..=4 {
            bench.drive(number, ModeSelect::Voltage, 3000);
        }
        bench.run(10);
    }
    let frames = bench.drain();
    for (base, period) in [
        (wire::id::STATUS_GENERAL, 10_000),
        (wire::id::STATUS_ENCODER, 100_000),
        (wire::id::STATUS_ANALOG, 100_000),
    ] {
        for number in 1..=4 {
            let times: Vec<u64> = frames
                .iter()
                .filter(|received| received.frame.raw_id() == frc_id::with_number(base, number))
                .map(|received| received.at.as_micros())
                .collect();
            assert!(times.len() as u64 >= 1_000_000 / period - 1);
            for pair in times.windows(2) {
                let gap = pair[1] - pair[0];
                assert!(gap.abs_diff(period) <= 1000, "{base:x} {number}: {gap}");
            }
        }
    }
    assert_eq!(bench.world.bus().error_frames, 0);
}

#[test]
fn two_nodes_of_one_number_are_told_apart_and_renumbered() {
    let mut bench = Bench::new(&["dmc60c:0", "dmc60c:0"]);
    let mut found = bench.enumerate();
    found.extend(bench.enumerate());
    found.sort_unstable();
    found.dedup();
    assert!(found.len() >= 2, "{found:?}");
    let sessions = [0, 1].map(|index| bench.truth(index).session.unwrap());
    assert_ne!(sessions[0], sessions[1]);
    let code = bench.command((0, sessions[1]), Command::SetDeviceNumber, 9);
    assert_eq!(
        CommandCode::from_code(code as u8),
        Some(CommandCode::NoError)
    );
    assert_eq!((bench.truth(0).number, bench.truth(1).number), (0, 9));
    assert_eq!(bench.truth(1).flash_writes, 1);
}

#[test]
fn nodes_of_one_number_stay_on_the_bus() {
    // Their status frames share identifiers, and the noise on the current makes their data differ.
    for seed in 1..=5 {
        let config = WorldConfig {
            seed,
            ..WorldConfig::default()
        };
        let mut bench = Bench::with(config, &["dmc60c:0"; 4]);
        bench.enumerate();
        let sessions = [0, 1, 2, 3].map(|index| bench.truth(index).session);
        bench.run(20_000);
        for (index, session) in sessions.into_iter().enumerate() {
            assert_eq!(
                bench.truth(index).session,
                session,
                "node {index}, seed {seed}"
            );
        }
    }
}

#[test]
fn settings_survive_a_power_cycle_and_the_encoder_count_does_not() {
    let mut bench = Bench::new(&["dmc60c:5"]);
    let node = bench.enumerate()[0];
    bench.set(node, ParameterId::Slot0P, 0x1_2345);
    bench.drive_for(5, ModeSelect::Voltage, 10_000, 300);
    let before = bench.truth(0);
    assert!(bench.world.node(0).unwrap().snapshot().position > 1000);
    bench.world.power_cycle(0);
    assert!(bench.world.node(0).unwrap().node().is_none(), "booting");
    bench.run(20);
    let after = bench.truth(0);
    assert!(
        after.position_counts > before.position_counts,
        "the shaft turns on"
    );
    assert!(after.session.is_none());
    assert!(bench.world.node(0).unwrap().snapshot().position.abs() < before.position_counts as i32);
    let again = bench.enumerate()[0];
    assert_ne!(again.1, node.1);
    let kept = bench.world.node(0).unwrap().node().unwrap().stored();
    assert_eq!(kept.params.get(ParameterId::Slot0P), 0x1_2345);
}

#[test]
fn a_node_without_power_is_not_there() {
    let mut bench = Bench::new(&["dmc60c:5", "dmc60c:6"]);
    bench.poke(0, Poke::Powered(false));
    let found = bench.enumerate();
    assert_eq!(found.iter().map(|node| node.0).collect::<Vec<_>>(), [6]);
    let truth = bench.truth(0);
    assert_eq!((truth.powered, truth.duty, truth.number), (false, 0, 5));
    bench.poke(0, Poke::Powered(true));
    bench.run(10);
    assert_eq!(bench.enumerate().len(), 2);
}

#[test]
fn a_soft_reset_keeps_the_session_and_acknowledges() {
    let mut bench = Bench::new(&["dmc60c:5"]);
    let node = bench.enumerate()[0];
    let code = bench.command(node, Command::SoftReset, 0);
    assert_eq!(
        CommandCode::from_code(code as u8),
        Some(CommandCode::AcknowledgeReset)
    );
    assert_eq!(bench.truth(0).session, Some(node.1));
    let code = bench.command(node, Command::EnterBootloader, 0);
    assert_eq!(
        CommandCode::from_code(code as u8),
        Some(CommandCode::InBootloader)
    );
    assert_eq!(bench.truth(0).mode, ImageType::Bootloader);
    // The bootloader answers enumeration and drives nothing.
    assert_eq!(bench.enumerate(), [node]);
    bench.drive_for(5, ModeSelect::Voltage, 10_000, 100);
    assert_eq!(bench.truth(0).duty, 0);
}

#[test]
fn a_pulled_bus_plug_stops_the_motor_and_is_a_communication_fault() {
    let mut bench = Bench::new(&["dmc60c:5"]);
    let session = bench.enumerate()[0].1;
    bench.drive_for(5, ModeSelect::Voltage, 10_000, 200);
    bench.poke(0, Poke::BusConnected(false));
    bench.run(20);
    let truth = bench.truth(0);
    // The first status frame is tried 16 times: that takes about 3 ms after at most 10 ms.
    assert_eq!((truth.duty, truth.session, truth.tec), (0, None, 128));
    let faults = bench
        .world
        .node(0)
        .unwrap()
        .node()
        .unwrap()
        .faults()
        .sticky();
    assert!(faults.contains(Fault::Communication));
    bench.poke(0, Poke::BusConnected(true));
    let again = bench.enumerate();
    assert_eq!(again.len(), 1);
    assert_ne!(again[0].1, session);
}

#[test]
fn limit_switches_reach_the_pins() {
    let mut bench = Bench::new(&["dmc60c:5"]);
    bench.enumerate();
    bench.drive_for(5, ModeSelect::Voltage, 10_000, 100);
    bench.poke(0, Poke::ForwardLimitClosed(true));
    bench.drive_for(5, ModeSelect::Voltage, 10_000, 40);
    assert_eq!(bench.truth(0).duty, 0);
    bench.drive_for(5, ModeSelect::Voltage, -10_000, 40);
    assert_eq!(bench.truth(0).duty, -10_000);
}

#[test]
fn a_short_circuit_is_a_gate_driver_fault() {
    let mut bench = Bench::new(&["dmc60c:5"]);
    bench.enumerate();
    bench.poke(0, Poke::ShortCircuit(true));
    bench.drive_for(5, ModeSelect::Voltage, 10_000, 100);
    let truth = bench.truth(0);
    assert_eq!((truth.faults, truth.duty), (Fault::GateDriver.bit(), 0));
    assert!(truth.current_a.abs() < 1.0);
    bench.poke(0, Poke::ShortCircuit(false));
    bench.drive_for(5, ModeSelect::Voltage, 10_000, 3200);
    assert_eq!((bench.truth(0).faults, bench.truth(0).duty), (0, 10_000));
}

#[test]
fn heat_and_low_voltage_are_seen_by_the_node() {
    let mut bench = Bench::new(&["dmc60c:5"]);
    bench.enumerate();
    bench.poke(0, Poke::TemperatureCelsius(Some(110.0)));
    bench.run(10);
    assert_eq!(bench.truth(0).faults, Fault::OverTemperature.bit());
    bench.poke(0, Poke::TemperatureCelsius(Some(30.0)));
    bench.poke(0, Poke::BatteryVolts(Some(5.5)));
    bench.run(4_900);
    assert_eq!(bench.truth(0).faults, 0);
    bench.run(200);
    assert_eq!(bench.truth(0).faults, Fault::UnderVoltage.bit());
}

#[test]
fn impossible_numbers_change_nothing() {
    let mut bench = Bench::new(&["dmc60c:5"]);
    for value in [f64::NAN, f64::INFINITY, f64::NEG_INFINITY] {
        bench.poke(0, Poke::BatteryVolts(Some(value)));
        bench.poke(0, Poke::TemperatureCelsius(Some(value)));
        bench.poke(0, Poke::AnalogVolts(Some(value)));
        bench.poke(0, Poke::LoadNewtonMetres(value));
    }
    bench.run(10);
    let truth = bench.truth(0);
    assert!((truth.bus_v - 12.7).abs() < 0.01);
    assert!((truth.temp_c - 25.0).abs() < 0.01);
    assert!((truth.analog_v - 1.65).abs() < 0.01);
    assert_eq!(truth.position_counts, 0);
}

#[test]
fn rc_pulses_drive_while_there_is_no_bus() {
    let mut bench = Bench::new(&["dmc60c:5"]);
    bench.poke(0, Poke::PulseWidthUs(Some(1750)));
    bench.run(200);
    let truth = bench.truth(0);
    assert!((14_000..20_000).contains(&truth.duty), "{truth:?}");
    bench.poke(0, Poke::PulseWidthUs(None));
    bench.run(150);
    assert_eq!(bench.truth(0).duty, 0);
}

#[test]
fn the_button_toggles_brake_and_coast() {
    let mut bench = Bench::new(&["dmc60c:5"]);
    bench.enumerate();
    assert_eq!(bench.truth(0).neutral, Neutral::Brake);
    bench.poke(0, Poke::Button);
    bench.run(10);
    assert_eq!(bench.truth(0).neutral, Neutral::Coast);
}

#[test]
fn header_tests_look_at_the_header() {
    let mut bench = Bench::new(&["dmc60c:5"]);
    let node = bench.enumerate()[0];
    let passed = CommandCode::TestPassed as u16;
    let failed = |pin: TestPin| CommandCode::TestFailed as u16 | (pin as u16) << 8;
    let (short, open) = (
        Command::PinTest(PinTest::Short),
        Command::PinTest(PinTest::Open),
    );
    assert_eq!(bench.command(node, short, 0), passed);
    assert_eq!(bench.command(node, open, 0), failed(TestPin::EncoderIndex));
    bench.poke(0, Poke::ReverseLimitClosed(true));
    assert_eq!(bench.command(node, short, 0), failed(TestPin::ReverseLimit));
    bench.poke(0, Poke::ReverseLimitClosed(false));
    bench.poke(0, Poke::J1Loopback(true));
    assert_eq!(bench.command(node, open, 0), passed);
}

#[test]
fn one_seed_gives_one_actuation_stream() {
    let run = |seed| {
        let config = WorldConfig {
            seed,
            loss: 0.02,
            corruption: 0.01,
            delay: Duration::from_micros(300),
            ..WorldConfig::default()
        };
        let mut bench = Bench::with(config, &["dmc60c:5", "dmc60c:6"]);
        for node in bench.enumerate() {
            bench.set(node, ParameterId::Slot0P, 1 << 16);
        }
        bench.drive_for(5, ModeSelect::Velocity, 8000, 500);
        bench.drive_for(6, ModeSelect::Position, -3000, 500);
        let hashes = [0, 1].map(|index| bench.world.actuation_hash(index));
        (hashes, bench.world.bus(), bench.truth(0), bench.truth(1))
    };
    assert_eq!(run(1), run(1));
    assert_ne!(run(1).0, run(2).0);
}

#[test]
fn a_recorded_run_replays_to_the_same_hash() {
    let mut bench = Bench::new(&["dmc60c:5"]);
    bench.world.node_mut(0).unwrap().record_ticks();
    let node = bench.enumerate()[0];
    bench.set(node, ParameterId::Slot0P, 2 << 16);
    bench.drive_for(5, ModeSelect::Velocity, 8000, 300);
    bench.world.power_cycle(0);
    bench.run(50);
    bench.drive_for(5, ModeSelect::Voltage, -9000, 300);
    let records = bench.world.node_mut(0).unwrap().take_ticks();
    assert!(records.len() > 1000);
    assert_eq!(replay(&records), bench.world.actuation_hash(0));
    assert_ne!(replay(&records[1..]), bench.world.actuation_hash(0));
}

#[test]
fn the_trace_tells_who_sent_what() {
    let mut bench = Bench::new(&["dmc60c:5"]);
    bench.enumerate();
    let trace = bench.world.trace_since(0, 3);
    assert_eq!(trace[0].frame, Frame::extended(id::ENUMERATE, []));
    assert_eq!(trace[0].from, Source::Participant("test".to_owned()));
    assert_eq!((trace[1].from.clone(), trace[1].seq), (Source::Node(0), 1));
    assert!(bench.world.trace_since(1_000_000, 3).is_empty());
}

#[test]
fn waiting_ends_with_the_frame_or_at_the_deadline() {
    let mut bench = Bench::new(&[]);
    let other = bench.world.join("other");
    let deadline = Instant::from_micros(2_000);
    assert_eq!(
        bench.world.advance_until_received(bench.tool, deadline),
        None
    );
    assert_eq!(bench.world.now(), deadline);
    bench.world.send(other, Frame::standard(0, []));
    assert_eq!(bench.world.pending(other), 1);
    let late = Instant::from_micros(1_000_000);
    let received = bench
        .world
        .advance_until_received(bench.tool, late)
        .unwrap();
    assert_eq!(received.at, Instant::from_micros(2_050));
    assert_eq!(
        (bench.world.now(), bench.world.pending(other)),
        (received.at, 0)
    );
    // A tool that has left neither sends nor acknowledges.
    bench.world.leave(bench.tool);
    bench.world.send(other, Frame::standard(0, []));
    bench.run(10);
    assert_eq!(bench.world.pending(other), 1);
    assert!(bench.world.bus().error_frames > 10);
}
