//! Properties that hold for any input whatever.

use super::*;
use proptest::prelude::*;

fn any_setpoint() -> impl Strategy<Value = Setpoint> {
    prop_oneof![
        Just(Setpoint::Off),
        any::<i16>().prop_map(|duty| Setpoint::Duty(Duty::new(duty))),
        any::<i32>().prop_map(Setpoint::Velocity),
        any::<i32>().prop_map(Setpoint::Position),
        any::<i32>().prop_map(|bits| Setpoint::Current(Amps::from_bits(bits))),
        any::<i32>().prop_map(|bits| Setpoint::Voltage(Volts::from_bits(bits))),
        (0..4_u8).prop_map(Setpoint::Follow),
        Just(Setpoint::Pulse),
    ]
}

fn any_opts() -> impl Strategy<Value = DriveOpts> {
    (any::<[bool; 6]>(), 0..3_u8, any::<u16>()).prop_map(|(flags, neutral, ramp)| {
        let [
            slot,
            enabled,
            forward,
            reverse,
            reverse_sensor,
            reverse_motor,
        ] = flags;
        DriveOpts {
            slot: if slot { Slot::One } else { Slot::Zero },
            neutral: [None, Some(Neutral::Brake), Some(Neutral::Coast)][usize::from(neutral)],
            limits: LimitOverride {
                enabled,
                disabled: Directions::new(forward, reverse),
            },
            reverse_sensor,
            reverse_motor,
            ramp,
            ..DriveOpts::default()
        }
    })
}

prop_compose! {
    fn any_command()(
        sequence in 0..3_u32, setpoint in any_setpoint(), opts in any_opts(),
        duty: i16, report in 0..3_u32, counts: i32, generation in 0..3_u32,
    ) -> Command {
        Command {
            sequence, setpoint, opts,
            master: MasterReport { duty: Duty::new(duty), sequence: report },
            set_position: SetPosition { counts, generation, ..SetPosition::default() },
            ..Command::default()
        }
    }
}

prop_compose! {
    fn any_sample()(
        encoder: u32, pins: [bool; 5], gate in 0..20_u8, edges in 0..3_u16, count: u32,
        analog: [u16; 4], width_us: u16, pulses in 0..3_u16,
    ) -> Sample {
        let [forward_limit, reverse_limit, encoder_a, encoder_b, encoder_index] = pins;
        Sample {
            encoder,
            pins: Pins::LOW
                .with(Pin::ForwardLimit, forward_limit)
                .with(Pin::ReverseLimit, reverse_limit)
                .with(Pin::EncoderA, encoder_a)
                .with(Pin::EncoderB, encoder_b)
                .with(Pin::EncoderIndex, encoder_index)
                .with(Pin::GateDriverFault, gate == 0),
            index_rising: IndexCapture { edges, count },
            index_falling: IndexCapture { edges, count: count / 2 },
            current: analog[0], bus_voltage: analog[1], temperature: analog[2], analog_in: analog[3],
            pulse: Pulse { width_us, count: pulses },
            ..Sample::default()
        }
    }
}

fn any_params() -> impl Strategy<Value = Params> {
    proptest::collection::vec((any::<u8>(), any::<u32>(), 0..4_u8), 0..30).prop_map(|writes| {
        let mut params = Params::new();
        for (code, value, small) in writes {
            if let Some(id) = ParameterId::from_code(code) {
                let value = if small == 0 { value } else { value & 1 };
                let _ = params.set(id, value);
            }
        }
        params
    })
}

proptest! {
    /// I1 for the engine, I3 and the limits: whatever goes in, nothing panics, a fault means off, the
    /// duty cycle stays within what is allowed, and no blocked direction is driven.
    #[test]
    fn i1_i3_no_input_breaks_the_limits(
        params in any_params(),
        steps in proptest::collection::vec((any_sample(), any_command()), 1..40),
        calm in 0..100_usize,
    ) {
        let mut rig = Rig::cold();
        if calm > 30 {
            rig = Rig::new();
        }
        rig.params = params;
        for (sample, command) in steps {
            rig.sample = Sample { current: if calm > 60 { 2048 } else { sample.current }, ..sample };
            rig.command = command;
            let duty = i32::from(rig.tick());
            let snapshot = &rig.snapshot;
            if !snapshot.faults.is_empty() || snapshot.state != DriveState::Running {
                prop_assert_eq!(duty, 0);
            }
            if snapshot.mode.is_closed_loop() && duty != 0 {
                let settings = compile::settings(&rig.params, &Board::REFERENCE, &rig.policy);
                let slot = settings.slot(command.opts.slot);
                prop_assert!(duty <= slot.forward_max && duty >= slot.reverse_max);
            }
            prop_assert!(duty <= 0 || !snapshot.limits.blocked.forward());
            prop_assert!(duty >= 0 || !snapshot.limits.blocked.reverse());
            prop_assert_eq!(
                snapshot.actuation == Actuation::Drive(Duty::ZERO), false, "zero is never driven"
            );
        }
    }

    /// I4: whatever the gains, nominal duty cycle, ramp and targets are, the slot's maximum is kept in
    /// every tick, and so is the derated cap of a hot bridge.
    #[test]
    fn i4_the_duty_never_exceeds_the_slot_maximum_or_the_derated_cap(
        gains: [i32; 4], ramp in 0..100_i32, nominal in 0..32767_i32, maximum in 0..32767_i32,
        hot in 86..104_i32, steps in proptest::collection::vec((any::<i32>(), any::<u32>()), 1..30),
    ) {
        let mut rig = Rig::new();
        for (id, value) in [
            (ParameterId::Slot0P, gains[0]),
            (ParameterId::Slot0I, gains[1]),
            (ParameterId::Slot0D, gains[2]),
            (ParameterId::Slot0F, gains[3]),
            (ParameterId::Slot0Ramp, ramp),
            (ParameterId::Slot0ForwardNominal, nominal),
            (ParameterId::Slot0ReverseNominal, -nominal),
            (ParameterId::Slot0ForwardMax, maximum),
            (ParameterId::Slot0ReverseMax, -maximum / 2),
        ] {
            rig.set(id, value);
        }
        for (target, encoder) in &steps {
            rig.sample.encoder = *encoder;
            let duty = i32::from(rig.drive(Setpoint::Position(*target), 1));
            prop_assert!(duty <= maximum && duty >= -maximum / 2, "{} of {}", duty, maximum);
        }
        rig.sample.temperature = celsius(f64::from(hot));
        // One conversion step is 0.08 °C, which is 132 throttle units of the derating.
        let cap = (105 - hot) * 32768 / 20 + 132;
        for (target, _) in steps {
            let duty = i32::from(rig.drive(Setpoint::Duty(Duty::new(target as i16)), 1));
            prop_assert!(duty.abs() <= cap, "{} of {} at {}", duty, cap, hot);
        }
    }

    /// A revision only tells the engine where it need not look: one that comes with every tick changes nothing.
    #[test]
    fn a_revision_without_a_change_changes_nothing(
        params in any_params(),
        steps in proptest::collection::vec((any_sample(), any_command(), 0..300_usize), 1..20),
    ) {
        let mut rig = Rig::new();
        rig.params = params;
        let mut revised = rig.clone();
        let settings = compile::settings(&rig.params, &Board::REFERENCE, &rig.policy);
        for (sample, command, ticks) in steps {
            rig.sample = Sample { current: 2048, ..sample };
            rig.command = command;
            for _ in 0..=ticks {
                rig.tick();
                revised.command = Command { revision: revised.command.revision + 1, ..rig.command };
                let snapshot = revised.engine.tick(&settings, &rig.sample, &revised.command);
                prop_assert_eq!(snapshot, &rig.snapshot);
            }
        }
    }

    /// Idempotence: a command that is seen again changes nothing that a lost repetition would not.
    #[test]
    fn a_repeated_command_value_is_harmless(command in any_command(), sample in any_sample()) {
        let mut once = Rig::new();
        once.sample = Sample { current: 2048, ..sample };
        once.command = command;
        once.tick();
        let mut again = once.clone();
        again.command = command;
        prop_assert_eq!(once.tick(), again.tick());
        prop_assert_eq!(once.snapshot, again.snapshot);
    }
}
