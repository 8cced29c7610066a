//! The drive under the Talon SRX's policy: enable, ramp, loops, faults, follower. `inputs`: sensors and limits.

use super::*;
use crate::engine::Engine;
use proptest::prelude::*;

mod inputs;

const TIMEOUT: usize = 200;

/// The rules of `docs/talon-srx.md`: enable, command and follower 100 ms, only the power stage stops, for
/// 3 s; under-voltage and over-temperature are shown.
const POLICY: Policy = Policy {
    command_timeout_ticks: 200,
    master_timeout_ticks: 200,
    fault_hold_ticks: 6000,
    resume: settings::Resume::AnyCommand,
    enabling: settings::Enabling::Separate,
    law: Law::Throttle,
    sensors: settings::SensorSet::All,
    soft_threshold: settings::SoftThreshold::Exclusive,
    stopping: Faults::NONE.with(Fault::GateDriver),
    indicated: Some(settings::Indicated {
        under_voltage: 65 * 65536 / 10,
        over_temperature: 100 << 16,
        ticks: 4,
    }),
    sticky: settings::Sticky::Presence,
    pause_ticks: 200,
};

/// An engine past its self-check under the policy, not enabled.
fn rig() -> Rig {
    let mut rig = Rig::cold();
    rig.policy = POLICY;
    rig.ticks(64);
    assert_eq!(rig.snapshot.state, DriveState::Halted);
    rig
}

impl Rig {
    fn enable(&mut self) -> &mut Self {
        self.command.enable.sequence += 1;
        self.command.enable.withdrawn = false;
        self
    }

    /// Control frames that enable, one before each tick; gives the throttle of the last.
    fn throttle(&mut self, setpoint: Setpoint, ticks: usize) -> i32 {
        for _ in 0..ticks {
            self.enable().send(setpoint).tick();
        }
        self.applied()
    }

    fn applied(&self) -> i32 {
        self.snapshot.duty().throttle()
    }

    fn analog(&mut self, conversion: u16) -> &mut Self {
        self.sample.analog_in = conversion << 2;
        self
    }
}

fn duty(throttle: i32) -> Setpoint {
    Setpoint::Duty(Duty::from_throttle(throttle))
}

#[test]
fn i2_a_command_without_permission_and_a_permission_without_command_drive_nothing() {
    let mut rig = rig();
    for _ in 0..500 {
        rig.send(duty(500)).tick();
        assert_eq!(rig.applied(), 0);
    }
    assert_eq!(rig.snapshot.state, DriveState::Halted);
    rig.enable().tick();
    assert_eq!(rig.applied(), 500, "the command is fresh enough");
    // The permission goes on, the command does not.
    for tick in 2..500 {
        rig.enable().tick();
        assert_eq!(rig.applied() != 0, tick < TIMEOUT, "tick {tick}");
    }
    // The command goes on, the permission does not.
    let mut rig = super::throttle::rig();
    rig.throttle(duty(500), 1);
    for tick in 1..500 {
        rig.send(duty(500)).tick();
        assert_eq!(rig.applied() != 0, tick < TIMEOUT, "tick {tick}");
    }
}

#[test]
fn i2_a_withdrawn_permission_stops_in_the_same_tick_and_without_a_ramp() {
    let mut rig = rig();
    rig.command.opts.ramp = 1;
    rig.throttle(duty(1000), 400);
    assert_eq!(rig.applied(), 20);
    rig.command.enable.withdrawn = true;
    rig.send(duty(1000)).tick();
    assert_eq!(rig.applied(), 0);
    assert_eq!(rig.snapshot.actuation, Actuation::Brake, "neutral brakes");
    for _ in 0..300 {
        rig.send(duty(1000)).tick();
        assert_eq!(rig.applied(), 0);
    }
    rig.throttle(duty(1000), 1);
    assert_eq!(rig.applied(), 1, "the ramp begins at zero");
}

#[test]
fn options_outlive_the_permission() {
    let mut rig = rig();
    rig.command.opts.neutral = Some(Neutral::Coast);
    rig.throttle(duty(0), 1);
    rig.ticks(1000);
    assert_eq!(rig.snapshot.state, DriveState::Halted);
    assert_eq!(rig.snapshot.neutral, Neutral::Coast);
}

#[test]
fn the_ramp_moves_once_in_10_ms_in_every_mode_and_both_ways() {
    for reach in [duty(1023), Setpoint::Follow(7), Setpoint::Position(5000)] {
        let mut rig = rig();
        rig.set(ParameterId::ThrottleSlot0P, 1 << 22);
        rig.command.master = MasterReport {
            duty: Duty::MAX,
            sequence: 1,
        };
        rig.command.opts.ramp = 10;
        let mut seen = std::vec![0];
        for tick in 0..2100 {
            rig.command.master.sequence += 1;
            let target = if tick < 1050 { reach } else { duty(-1023) };
            seen.push(rig.throttle(target, 1));
        }
        for window in seen.windows(21) {
            assert!((window[20] - window[0]).abs() <= 10, "{window:?}");
        }
        assert_eq!(seen[1050], 530, "53 steps in 52.5 periods of 10 ms");
        assert_eq!(
            seen[2100],
            530 - 520,
            "the first step back is 10 ms after the last one up"
        );
    }
}

extern crate std;

#[test]
fn full_throttle_takes_a_second_with_a_ramp_of_10() {
    let mut rig = rig();
    rig.command.opts.ramp = 10;
    // 103 steps, the first at once: 1.02 s.
    assert_eq!(rig.throttle(duty(1023), 102 * 20), 1020);
    assert_eq!(rig.throttle(duty(1023), 1), 1023);
}

#[test]
fn the_loop_works_once_in_a_millisecond_beginning_at_once() {
    let mut rig = rig();
    rig.set(ParameterId::ThrottleSlot0I, 1 << 22);
    // The first pass accumulates nothing (manual 18), each further one 7.
    let got: std::vec::Vec<_> = (0..8)
        .map(|_| rig.throttle(Setpoint::Position(7), 1))
        .collect();
    assert_eq!(got, [0, 0, 7, 7, 14, 14, 21, 21]);
    assert_eq!(rig.snapshot.accumulator, 21);
    assert_eq!(rig.snapshot.error, 7);
    rig.command.set_accumulator = SetAccumulator {
        value: 0,
        generation: 1,
    };
    assert_eq!(
        rig.throttle(Setpoint::Position(7), 1),
        7,
        "cleared before the pass"
    );
    assert_eq!(rig.snapshot.accumulator, 7);
}

#[test]
fn the_loop_begins_anew_after_a_change_of_mode_and_a_disable() {
    let mut rig = rig();
    rig.set(ParameterId::ThrottleSlot0I, 1 << 22);
    rig.throttle(Setpoint::Position(7), 8);
    rig.throttle(Setpoint::Velocity(7), 1);
    assert_eq!(rig.snapshot.accumulator, 0);
    rig.throttle(Setpoint::Velocity(7), 3);
    assert_eq!(rig.snapshot.accumulator, 7);
    rig.command.enable.withdrawn = true;
    rig.tick();
    assert_eq!(rig.snapshot.accumulator, 0);
}

#[test]
fn a_changed_gain_and_a_changed_slot_act_at_the_next_pass_without_a_restart() {
    let mut rig = rig();
    rig.set(ParameterId::ThrottleSlot0P, 1 << 22)
        .set(ParameterId::ThrottleSlot1P, 3 << 22);
    assert_eq!(rig.throttle(Setpoint::Position(100), 2), 100);
    rig.set(ParameterId::ThrottleSlot0P, 2 << 22);
    assert_eq!(rig.throttle(Setpoint::Position(100), 1), 200);
    rig.throttle(Setpoint::Position(100), 1);
    let before = rig.snapshot.accumulator;
    rig.command.opts.slot = Slot::One;
    assert_eq!(rig.throttle(Setpoint::Position(100), 1), 300);
    assert_eq!(rig.snapshot.accumulator, before + 100);
}

#[test]
fn the_closed_loop_ramp_starts_from_the_applied_throttle() {
    let mut rig = rig();
    rig.set(ParameterId::ThrottleSlot0P, 1 << 22)
        .set(ParameterId::ThrottleSlot0Ramp, 5);
    rig.throttle(duty(300), 1);
    assert_eq!(rig.throttle(Setpoint::Position(0), 1), 295);
    assert_eq!(rig.throttle(Setpoint::Position(0), 2), 290);
}

#[test]
fn reversal_turns_loop_and_follower_and_the_sensor_only_its_own_reading() {
    let mut rig = rig();
    rig.set(ParameterId::ThrottleSlot0P, 1 << 22);
    rig.encoder(100);
    rig.command.opts.reverse_motor = true;
    assert_eq!(rig.throttle(Setpoint::Position(150), 1), -50);
    rig.command.master = MasterReport {
        duty: Duty::from_throttle(400),
        sequence: 1,
    };
    assert_eq!(rig.throttle(Setpoint::Follow(7), 1), -400);
    rig.command.opts.reverse_sensor = true;
    rig.throttle(Setpoint::Follow(7), 1);
    assert_eq!(rig.snapshot.position, -100, "also while following");
    assert_eq!(rig.snapshot.raw.encoder.position, 100);
}

#[test]
fn a_pause_switches_off_for_100_ms_and_the_drive_resumes() {
    let mut rig = rig();
    rig.throttle(duty(500), 10);
    rig.command.pause += 1;
    for tick in 1..=TIMEOUT {
        assert_eq!(rig.throttle(duty(500), 1), 0, "tick {tick}");
        assert_eq!(rig.snapshot.state, DriveState::Halted);
    }
    assert_eq!(rig.throttle(duty(500), 1), 500);
}

#[test]
fn voltage_temperature_and_current_never_stop_the_drive_and_are_shown_while_present() {
    let mut rig = rig();
    assert_eq!(rig.throttle(duty(500), 1), 500);
    rig.sample.bus_voltage = volts(6.4);
    rig.sample.temperature = celsius(101.0);
    rig.amperes(63.0);
    assert_eq!(rig.throttle(duty(1023), 20_000), 1023, "not derated either");
    let faults = rig.snapshot.faults;
    for fault in [
        Fault::UnderVoltage,
        Fault::OverTemperature,
        Fault::OverCurrent,
    ] {
        assert!(faults.contains(fault), "{fault:?}");
    }
    rig.sample.bus_voltage = volts(6.6);
    rig.throttle(duty(500), 1);
    assert!(!rig.snapshot.faults.contains(Fault::UnderVoltage));
    assert!(rig.snapshot.faults.contains(Fault::OverTemperature));
    assert_eq!(rig.snapshot.fault_events[2], 1);
}

#[test]
fn i3_a_failure_of_the_power_stage_is_off_in_the_same_tick_and_for_3_s() {
    let mut rig = rig();
    rig.throttle(duty(500), 10);
    rig.sample.pins.set(Pin::GateDriverFault, true);
    rig.throttle(duty(500), 1);
    assert_eq!(rig.snapshot.actuation, Actuation::Off);
    rig.sample.pins.set(Pin::GateDriverFault, false);
    for tick in 1..6000 {
        rig.throttle(duty(500), 1);
        assert_eq!(rig.snapshot.actuation, Actuation::Off, "tick {tick}");
    }
    assert_eq!(rig.throttle(duty(500), 1), 500);
}

#[test]
fn a_follower_copies_for_100_ms_and_then_is_neutral_at_once() {
    let mut rig = rig();
    rig.command.opts.ramp = 200;
    rig.command.master = MasterReport {
        duty: Duty::from_throttle(-700),
        sequence: 1,
    };
    rig.throttle(Setpoint::Follow(9), 100);
    assert_eq!(rig.applied(), -700);
    for tick in 101..400 {
        let throttle = rig.throttle(Setpoint::Follow(9), 1);
        assert_eq!(throttle != 0, tick <= TIMEOUT, "tick {tick}");
    }
    assert_eq!(rig.snapshot.state, DriveState::Running, "enabled, neutral");
}

#[test]
fn neutral_is_enabled_and_drives_nothing() {
    let mut rig = rig();
    rig.throttle(duty(500), 1);
    assert_eq!(rig.throttle(Setpoint::Neutral, 1), 0);
    assert_eq!(rig.snapshot.state, DriveState::Running);
    assert_eq!(rig.snapshot.actuation, Actuation::Brake);
    assert_eq!(rig.snapshot.mode, Mode::Off);
}

#[test]
fn the_rc_input_drives_without_a_bus() {
    let mut rig = rig();
    rig.send(Setpoint::Pulse);
    rig.sample.pulse = Pulse {
        width_us: 2000,
        count: 1,
    };
    rig.ticks(3);
    assert_eq!(rig.applied(), 1023);
}

proptest! {
    /// I4: the throttle stays within ±1023 and |change| within the ramp per 10 ms, whatever gains, targets
    /// and positions are.
    #[test]
    fn i4_the_throttle_never_exceeds_full_and_the_ramp(
        gains: [u32; 4], ramp in 1..256_u16,
        steps in proptest::collection::vec((any::<i32>(), any::<u32>(), 0..4_u8), 1..200),
    ) {
        let mut rig = rig();
        for (id, value) in [
            (ParameterId::ThrottleSlot0P, gains[0]),
            (ParameterId::ThrottleSlot0I, gains[1]),
            (ParameterId::ThrottleSlot0D, gains[2]),
            (ParameterId::ThrottleSlot0F, gains[3]),
        ] {
            rig.set(id, value as i32);
        }
        rig.command.opts.ramp = ramp;
        let mut seen = std::vec![0];
        for (target, encoder, mode) in steps {
            rig.sample.encoder = encoder;
            let setpoint = match mode {
                0 => Setpoint::Position(target),
                1 => Setpoint::Velocity(target),
                2 => duty(target),
                _ => Setpoint::Follow(1),
            };
            rig.command.master = MasterReport {
                duty: Duty::new(target as i16),
                sequence: rig.command.master.sequence + 1,
            };
            seen.push(rig.throttle(setpoint, 1));
        }
        for window in seen.windows(21) {
            prop_assert!((window[20] - window[0]).unsigned_abs() <= u32::from(ramp), "{:?}", window);
        }
        prop_assert!(seen.iter().all(|throttle| throttle.abs() <= 1023));
    }

    /// I1 and I3: nothing that comes in panics, and what is stopped does not drive.
    #[test]
    fn i1_i3_no_input_breaks_the_throttle_drive(
        steps in proptest::collection::vec(
            (any::<[u16; 4]>(), any::<[u32; 4]>(), any::<[bool; 6]>(), 0..8_u8, 0..5_u8), 1..60,
        ),
    ) {
        let mut rig = rig();
        for (analog, words, flags, mode, sensor) in steps {
            let [a, b, c, d] = words;
            rig.sample = Sample {
                encoder: a,
                encoder_a_rises: analog[0],
                analog_in: analog[1],
                bus_voltage: analog[2],
                temperature: analog[3],
                pins: Pins::default()
                    .with(Pin::ForwardLimit, flags[0])
                    .with(Pin::ReverseLimit, flags[1])
                    .with(Pin::GateDriverFault, flags[2] && flags[3]),
                ..rig.sample
            };
            rig.command.setpoint = match mode {
                0 => Setpoint::Off,
                1 => Setpoint::Neutral,
                2 => Setpoint::Duty(Duty::new(b as i16)),
                3 => Setpoint::Velocity(b as i32),
                4 => Setpoint::Position(b as i32),
                5 => Setpoint::Current(Amps::from_bits(b as i32)),
                6 => Setpoint::Follow(b as u8),
                _ => Setpoint::Pulse,
            };
            rig.command.opts.sensor = [
                SensorSelect::Quadrature,
                SensorSelect::AnalogPotentiometer,
                SensorSelect::AnalogEncoder,
                SensorSelect::RisingEdges,
                SensorSelect::None,
            ][usize::from(sensor)];
            rig.command.opts.reverse_motor = flags[4];
            rig.command.opts.reverse_sensor = flags[5];
            rig.command.opts.ramp = c as u16;
            rig.command.sequence = c;
            rig.command.enable = Enable { sequence: d, withdrawn: d % 16 == 0 };
            rig.command.set_position =
                SetPosition { of: PositionOf::Selected, counts: b as i32, generation: d };
            rig.command.set_accumulator = SetAccumulator { value: b as i32, generation: d };
            rig.tick();
            let snapshot = &rig.snapshot;
            let throttle = rig.applied();
            if snapshot.state != DriveState::Running || snapshot.faults.contains(Fault::GateDriver) {
                prop_assert_eq!(throttle, 0);
            }
            prop_assert!(throttle <= 0 || !snapshot.limits.blocked.forward());
            prop_assert!(throttle >= 0 || !snapshot.limits.blocked.reverse());
        }
    }
}

#[test]
fn i10_the_same_ticks_give_the_same_snapshots() {
    let run = || {
        let mut rig = rig();
        let mut engine = Engine::new();
        core::mem::swap(&mut engine, &mut rig.engine);
        rig.engine = engine;
        rig.set(ParameterId::ThrottleSlot0P, 3 << 20)
            .set(ParameterId::ThrottleSlot0I, 1 << 12);
        (0..5000_u32)
            .map(|tick| {
                rig.encoder((tick * 7919 % 4001) as i32);
                rig.throttle(Setpoint::Position((tick * 31 % 5000) as i32), 1);
                rig.snapshot
            })
            .collect::<std::vec::Vec<_>>()
    };
    assert_eq!(run(), run());
}
