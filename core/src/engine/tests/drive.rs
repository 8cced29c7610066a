//! Modes, halting, faults, ramps.

use super::*;

const ALL_SETPOINTS: [Setpoint; 8] = [
    Setpoint::Off,
    Setpoint::Duty(Duty::new(10_000)),
    Setpoint::Velocity(100),
    Setpoint::Position(100),
    Setpoint::Current(Amps::ONE),
    Setpoint::Voltage(Volts::ONE),
    Setpoint::Follow(3),
    Setpoint::Pulse,
];

/// A rig in which every mode has an output: unit gains, a master and pulses.
fn live_rig() -> Rig {
    let mut rig = Rig::new();
    rig.set(ParameterId::Slot0P, 100 << 16);
    rig.command.master = MasterReport {
        duty: Duty::new(5_000),
        sequence: 1,
    };
    rig
}

fn feed(rig: &mut Rig) {
    rig.command.master.sequence += 1;
    rig.sample.pulse = Pulse {
        width_us: 1750,
        count: rig.sample.pulse.count.wrapping_add(1),
    };
}

#[test]
fn every_mode_drives_and_every_event_ends_as_the_table_says() {
    // Mode × event → output while the event lasts. "Drive" events keep the output, the others end it.
    for setpoint in ALL_SETPOINTS {
        let mut rig = live_rig();
        for _ in 0..3 {
            feed(&mut rig);
            rig.send(setpoint).tick();
        }
        if setpoint == Setpoint::Pulse {
            rig.tick();
        }
        let driven = rig.snapshot.duty() != Duty::ZERO;
        assert_eq!(driven, setpoint != Setpoint::Off, "{setpoint:?}");

        let mut halted = rig.clone();
        assert_eq!(
            halted.send(Setpoint::Off).tick(),
            0,
            "{setpoint:?} then off"
        );
        let mut faulted = rig.clone();
        faulted.sample.pins.set(Pin::GateDriverFault, true);
        assert_eq!(faulted.tick(), 0, "{setpoint:?} then fault");
        assert_eq!(faulted.snapshot.actuation, Actuation::Off);
        let mut silent = rig.clone();
        silent.ticks(208);
        assert_eq!(
            silent.snapshot.duty(),
            Duty::ZERO,
            "{setpoint:?} then silence"
        );
    }
}

#[test]
fn i2_silence_ends_the_drive_104_ms_after_the_last_control_frame() {
    let mut rig = Rig::new();
    assert_eq!(rig.duty(10_000).tick(), 10_000);
    assert_eq!(rig.ticks(207), 10_000);
    assert_eq!(rig.snapshot.mode, Mode::Duty);
    assert_eq!(rig.tick(), 0);
    assert_eq!(
        (rig.snapshot.mode, rig.snapshot.state),
        (Mode::Off, DriveState::Halted)
    );
    assert_eq!(rig.snapshot.faults, Faults::NONE, "a timeout is no fault");
}

#[test]
fn a_control_frame_restarts_the_heartbeat_and_no_drive_stops_it() {
    let mut rig = Rig::new();
    rig.duty(10_000).ticks(208);
    assert_eq!(rig.duty(10_000).ticks(208), 10_000);
    assert_eq!(rig.send(Setpoint::Off).ticks(500), 0);
    assert_eq!(rig.snapshot.mode, Mode::Off);
}

#[test]
fn halted_needs_a_nonzero_setpoint() {
    let mut rig = Rig::new();
    rig.set(ParameterId::Slot0P, 1 << 16);
    rig.encoder(500);
    assert_eq!(rig.send(Setpoint::Position(0)).tick(), 0);
    assert_eq!(rig.snapshot.state, DriveState::Halted);
    rig.send(Setpoint::Position(600)).tick();
    assert_eq!(rig.snapshot.state, DriveState::Running);
    // Once running, a zero setpoint is a setpoint like any other.
    assert_eq!(rig.send(Setpoint::Position(0)).tick(), -500);
}

#[test]
fn any_command_resumes_where_the_policy_says_so() {
    let mut rig = Rig::new();
    rig.policy.resume = settings::Resume::AnyCommand;
    rig.send(Setpoint::Position(0)).tick();
    assert_eq!(rig.snapshot.state, DriveState::Running);
}

#[test]
fn nothing_drives_before_the_zero_of_the_current_sensor_is_known() {
    let mut rig = Rig::cold();
    for _ in 0..63 {
        assert_eq!(rig.duty(10_000).tick(), 0);
        assert_eq!(rig.snapshot.actuation, Actuation::Off);
    }
    assert_eq!(rig.duty(10_000).tick(), 10_000);
}

#[test]
fn a_command_of_the_self_check_counts_if_it_is_still_alive() {
    let mut rig = Rig::cold();
    rig.ticks(10);
    rig.duty(10_000).ticks(53);
    assert_eq!(rig.snapshot.duty().units(), 0);
    assert_eq!(rig.tick(), 10_000);
    assert_eq!(rig.ticks(207 - 53), 10_000);
    assert_eq!(rig.tick(), 0, "104 ms after the command");
}

#[test]
fn a_failed_self_check_keeps_the_output_off() {
    let mut rig = Rig::cold();
    rig.sample.current = 3000;
    assert_eq!(rig.drive(Setpoint::Duty(Duty::MAX), 1000), 0);
    assert_eq!(rig.snapshot.state, DriveState::SelfCheck);
    rig.sample.current = 2050;
    rig.drive(Setpoint::Duty(Duty::MAX), 128);
    assert_eq!(rig.snapshot.state, DriveState::Running);
}

#[test]
fn ramp_of_the_guide_example_takes_two_ticks() {
    // Guide, "Output Control Protocol": from 5000 to 10000 with vltgRampSet 2500.
    let mut rig = Rig::new();
    rig.duty(5000).tick();
    rig.command.opts.ramp = 2500;
    assert_eq!(
        [rig.duty(10_000).tick(), rig.tick(), rig.tick()],
        [7500, 10_000, 10_000]
    );
}

#[test]
fn closed_loop_ramp_16_takes_1_02_seconds_to_full_throttle() {
    // Guide, paramClosedLoopRampRateSlot0.
    let mut rig = Rig::new();
    rig.set(ParameterId::Slot0P, i32::MAX)
        .set(ParameterId::Slot0Ramp, 16);
    rig.command.opts.ramp = 1;
    let mut ticks = 0;
    while rig.send(Setpoint::Velocity(1000)).tick() < 32767 {
        ticks += 1;
        assert!(ticks < 3000);
    }
    // 32767 / 16 = 2048 ticks of 500 µs = 1.024 s; the command's own ramp is not for closed loops.
    assert_eq!(ticks + 1, 2048);
}

#[test]
fn a_ramp_starts_at_zero_after_a_halt() {
    let mut rig = Rig::new();
    rig.command.opts.ramp = 100;
    rig.drive(Setpoint::Duty(Duty::MAX), 50);
    assert_eq!(rig.snapshot.duty().units(), 5000);
    rig.send(Setpoint::Off).tick();
    assert_eq!(rig.duty(32767).tick(), 100);
}

#[test]
fn voltage_compensation_divides_by_the_bus_voltage() {
    let mut rig = Rig::new();
    for (target, bus, expected) in [
        (6, 12.0, 16384),
        (-6, 12.0, -16384),
        (12, 9.0, 32767),
        (-12, 9.0, -32768),
    ] {
        rig.sample.bus_voltage = volts(bus);
        let duty = rig.drive(Setpoint::Voltage(Volts::from_num(target)), 2);
        assert!(
            (i32::from(duty) - expected).abs() <= 30,
            "{target} V of {bus} V: {duty}"
        );
    }
    rig.sample.bus_voltage = 0;
    assert_eq!(rig.drive(Setpoint::Voltage(Volts::ONE), 2), 32767);
    assert_eq!(rig.drive(Setpoint::Voltage(Volts::ZERO), 2), 0);
}

#[test]
fn a_follower_copies_its_master_and_stops_104_ms_after_the_last_report() {
    let mut rig = Rig::new();
    let follow = Setpoint::Follow(7);
    assert_eq!(rig.drive(follow, 5), 0, "no report yet");
    rig.command.master = MasterReport {
        duty: Duty::new(-1234),
        sequence: 1,
    };
    assert_eq!(rig.drive(follow, 208), -1234);
    assert_eq!(rig.drive(follow, 1), 0);
    assert_eq!(
        (rig.snapshot.mode, rig.snapshot.state),
        (Mode::Follow, DriveState::Running)
    );
    rig.command.master.sequence += 1;
    assert_eq!(rig.drive(follow, 1), -1234);
    // Another master: the old report is void.
    assert_eq!(rig.drive(Setpoint::Follow(8), 1), 0);
}

#[test]
fn motor_reversal_turns_the_output_of_every_mode() {
    let mut rig = Rig::new();
    rig.set(ParameterId::Slot0P, 1 << 16);
    rig.command.opts.reverse_motor = true;
    assert_eq!(rig.drive(Setpoint::Duty(Duty::new(100)), 1), -100);
    assert_eq!(rig.drive(Setpoint::Duty(Duty::MIN), 1), 32767);
    assert_eq!(rig.drive(Setpoint::Position(100), 1), -100);
    rig.command.master = MasterReport {
        duty: Duty::new(50),
        sequence: 9,
    };
    assert_eq!(rig.drive(Setpoint::Follow(1), 1), -50);
}

#[test]
fn reversed_current_loop_still_has_negative_feedback() {
    let mut rig = Rig::new();
    rig.set(ParameterId::Slot0P, 1000 << 16);
    rig.command.opts.reverse_motor = true;
    rig.amperes(-10.0);
    let at_target = rig.drive(Setpoint::Current(Amps::from_num(10)), 1);
    assert!(at_target.abs() < 40, "{at_target}");
    rig.amperes(0.0);
    assert!(rig.drive(Setpoint::Current(Amps::from_num(10)), 1) < -9_900);
}

#[test]
fn brake_override_wins_while_given_and_ends_with_the_command() {
    let mut rig = Rig::new();
    rig.duty(100).tick();
    rig.command.opts.neutral = Some(Neutral::Coast);
    rig.duty(0).tick();
    assert_eq!(rig.snapshot.actuation, Actuation::Off);
    assert_eq!(rig.snapshot.neutral, Neutral::Coast);
    rig.ticks(300);
    assert_eq!(
        rig.snapshot.actuation,
        Actuation::Brake,
        "the timeout clears the override"
    );
    rig.set(ParameterId::BrakeAtNeutral, 0).tick();
    assert_eq!(rig.snapshot.actuation, Actuation::Off);
    rig.command.opts.neutral = Some(Neutral::Brake);
    rig.send(Setpoint::Off).ticks(1000);
    assert_eq!(
        rig.snapshot.actuation,
        Actuation::Brake,
        "no-drive has no timeout"
    );
}

#[test]
fn i3_every_fault_switches_off_in_its_tick_and_holds_for_3_s() {
    type Cause = fn(&mut Rig, bool);
    let faults: [(Fault, Cause, usize); 5] = [
        (
            Fault::GateDriver,
            |rig, on| rig.sample.pins.set(Pin::GateDriverFault, on),
            1,
        ),
        (
            Fault::OverTemperature,
            |rig, on| rig.sample.temperature = celsius(if on { 106.0 } else { 25.0 }),
            4,
        ),
        (
            Fault::UnderVoltage,
            |rig, on| rig.sample.bus_voltage = volts(if on { 5.7 } else { 12.0 }),
            10_000,
        ),
        (
            Fault::OverCurrent,
            |rig, on| {
                rig.amperes(if on { -62.5 } else { 0.0 });
            },
            8_000,
        ),
        (
            Fault::OverCurrent,
            |rig, on| rig.sample.current = if on { 4095 } else { 2048 },
            2_000,
        ),
    ];
    for (fault, cause, ticks) in faults {
        let mut rig = Rig::new();
        let forward = Setpoint::Duty(Duty::new(3_000));
        assert_eq!(rig.drive(forward, 1), 3_000);
        cause(&mut rig, true);
        rig.drive(forward, ticks - 1);
        assert_eq!(
            rig.snapshot.faults,
            Faults::NONE,
            "{fault:?} one tick early"
        );
        assert_eq!(rig.drive(forward, 1), 0, "{fault:?}");
        assert!(rig.snapshot.faults.contains(fault));
        assert_eq!(rig.snapshot.actuation, Actuation::Off);
        assert_eq!(rig.snapshot.fault_events[fault as usize], 1);
        // Still present: the timer starts again with every tick.
        assert_eq!(rig.drive(forward, 7_000), 0);
        cause(&mut rig, false);
        assert_eq!(rig.drive(forward, 5_999), 0);
        assert!(rig.snapshot.faults.contains(fault));
        assert_eq!(rig.drive(forward, 1), 3_000, "{fault:?} resumes after 3 s");
        assert_eq!(
            rig.snapshot.fault_events[fault as usize], 1,
            "one event, not one per tick"
        );
    }
}

#[test]
fn a_second_fault_restarts_the_3_s() {
    let mut rig = Rig::new();
    let forward = Setpoint::Duty(Duty::new(3_000));
    rig.sample.pins.set(Pin::GateDriverFault, true);
    rig.drive(forward, 1);
    rig.sample.pins.set(Pin::GateDriverFault, false);
    rig.drive(forward, 5_000);
    rig.sample.pins.set(Pin::GateDriverFault, true);
    rig.drive(forward, 1);
    rig.sample.pins.set(Pin::GateDriverFault, false);
    assert_eq!(rig.drive(forward, 5_999), 0);
    assert_eq!(rig.drive(forward, 1), 3_000);
    assert_eq!(rig.snapshot.fault_events[Fault::GateDriver as usize], 1);
}

#[test]
fn after_a_fault_a_silent_host_finds_the_drive_halted() {
    let mut rig = Rig::new();
    rig.duty(3_000).tick();
    rig.sample.pins.set(Pin::GateDriverFault, true);
    rig.tick();
    rig.sample.pins.set(Pin::GateDriverFault, false);
    assert_eq!(rig.ticks(7_000), 0);
    assert_eq!(rig.snapshot.state, DriveState::Halted);
}

#[test]
fn a_brief_dip_below_5_75_volts_is_no_fault() {
    let mut rig = Rig::new();
    rig.sample.bus_voltage = volts(5.7);
    rig.ticks(9_999);
    rig.sample.bus_voltage = volts(5.8);
    rig.tick();
    rig.sample.bus_voltage = volts(5.7);
    rig.ticks(9_999);
    assert_eq!(rig.snapshot.faults, Faults::NONE);
}

#[test]
fn a_hot_bridge_is_derated() {
    let mut rig = Rig::new();
    rig.sample.temperature = celsius(95.0);
    let duty = i32::from(rig.drive(Setpoint::Duty(Duty::MAX), 2));
    assert!((duty - 16384).abs() < 100, "{duty}");
    let reverse = i32::from(rig.drive(Setpoint::Duty(Duty::MIN), 2));
    assert_eq!(reverse, -duty);
}

#[test]
fn without_a_bus_pulses_drive_and_their_end_halts() {
    let mut rig = Rig::new();
    rig.command.setpoint = Setpoint::Pulse;
    assert_eq!(rig.ticks(3), 0);
    rig.sample.pulse = Pulse {
        width_us: 2000,
        count: 1,
    };
    assert_eq!(rig.tick(), 32767);
    assert_eq!(rig.ticks(199), 32767);
    assert_eq!(rig.tick(), 0);
    assert_eq!(rig.snapshot.state, DriveState::Halted);
}
