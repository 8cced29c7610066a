//! Whatever is done to a world: no panic, exact time, frames neither invented nor lost.

use embedded_can::{ExtendedId, StandardId};
use proptest::prelude::*;
use windlass_core::frame::Frame;
use windlass_core::time::Duration;
use windlass_sim::{Poke, World, WorldConfig};

#[derive(Clone, Debug)]
enum Step {
    Send(bool, Frame),
    Advance(u64),
    Wait(u64),
    Poke(usize, Poke),
    PowerCycle(usize),
    Rejoin,
}

fn frame() -> impl Strategy<Value = Frame> {
    let data = proptest::collection::vec(any::<u8>(), 0..=8);
    // Half of the identifiers lie where the nodes listen.
    let raw = prop_oneof![
        0_u32..0x2000_0000,
        (0_u32..0x400, 0_u32..3).prop_map(|(api, number)| 0x0206_0000 | api << 6 | number),
    ];
    (any::<bool>(), any::<bool>(), raw, data).prop_map(|(remote, standard, raw, data)| {
        let id: embedded_can::Id = match (standard, StandardId::new((raw & 0x7FF) as u16)) {
            (true, Some(id)) => id.into(),
            _ => ExtendedId::new(raw).unwrap().into(),
        };
        if remote {
            Frame::remote(id, data.len()).unwrap()
        } else {
            Frame::new(id, &data).unwrap()
        }
    })
}

fn poke() -> impl Strategy<Value = Poke> {
    let level = proptest::option::of(any::<bool>());
    let value = proptest::option::of(-10.0..150.0);
    (0..16, any::<bool>(), level, value).prop_map(|(which, flag, level, value)| match which {
        0 => Poke::ForwardLimitClosed(flag),
        1 => Poke::ReverseLimitClosed(flag),
        2 => Poke::IndexPin(level),
        3 => Poke::AnalogVolts(value),
        4 => Poke::BatteryVolts(value),
        5 => Poke::TemperatureCelsius(value),
        6 => Poke::LoadNewtonMetres(value.unwrap_or(0.0) / 50.0),
        7 => Poke::Stall(flag),
        8 => Poke::EncoderUnplugged(flag),
        9 => Poke::ShortCircuit(flag),
        10 => Poke::GateDriverFault(flag),
        11 => Poke::BusConnected(flag),
        12 => Poke::Powered(flag),
        13 => Poke::J1Loopback(flag),
        14 => Poke::PulseWidthUs(value.map(|width| width.abs() as u16 * 20)),
        _ => Poke::Button,
    })
}

fn step() -> impl Strategy<Value = Step> {
    prop_oneof![
        4 => (any::<bool>(), frame()).prop_map(|(first, frame)| Step::Send(first, frame)),
        3 => (0_u64..20_000).prop_map(Step::Advance),
        2 => (0_u64..20_000).prop_map(Step::Wait),
        2 => (0_usize..3, poke()).prop_map(|(node, poke)| Step::Poke(node, poke)),
        1 => (0_usize..3).prop_map(Step::PowerCycle),
        1 => Just(Step::Rejoin),
    ]
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(200))]

    #[test]
    fn a_world_survives_anything(
        seed: u64,
        loss in 0.0..0.3,
        corruption in 0.0..0.3,
        delay in 0_u64..500,
        steps in proptest::collection::vec(step(), 1..80),
    ) {
        let config = WorldConfig {
            seed,
            loss,
            corruption,
            delay: Duration::from_micros(delay),
            ..WorldConfig::default()
        };
        let mut world = World::new(config);
        for number in 0..3 {
            world.add_node(format!("dmc60c:{number}").parse().unwrap());
        }
        let first = world.join("first");
        let mut second = world.join("second");
        for step in steps {
            let before = world.now();
            match step {
                Step::Send(true, frame) => world.send(first, frame),
                Step::Send(false, frame) => world.send(second, frame),
                Step::Advance(micros) => {
                    world.advance(Duration::from_micros(micros));
                    prop_assert_eq!(world.now().since(before).as_micros(), micros);
                }
                Step::Wait(micros) => {
                    let deadline = before + Duration::from_micros(micros);
                    let received = world.advance_until_received(first, deadline);
                    prop_assert!(world.now() <= deadline);
                    match received {
                        Some(received) => prop_assert!(received.at <= world.now()),
                        None => prop_assert_eq!(world.now(), deadline),
                    }
                }
                Step::Poke(node, poke) => world.node_mut(node).unwrap().poke(poke),
                Step::PowerCycle(node) => world.power_cycle(node),
                Step::Rejoin => {
                    world.leave(second);
                    second = world.join("second");
                }
            }
        }
        world.advance(Duration::from_millis(100));
        let bus = world.bus();
        prop_assert!((0.0..=100.0).contains(&bus.load_percent));
        let trace = world.trace_since(0, usize::MAX);
        prop_assert_eq!(trace.len() as u64, bus.frames);
        prop_assert!(trace.windows(2).all(|pair| pair[0].at < pair[1].at));
        for index in 0..world.nodes() {
            let truth = world.node(index).unwrap().truth();
            prop_assert!(truth.current_a.is_finite() && truth.velocity_counts_per_100ms.is_finite());
            prop_assert!(truth.powered || truth.duty == 0);
        }
    }
}
