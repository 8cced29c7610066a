//! Talon SRX: numbers, several devices, both dialects on one bus, load and errors of the bus. The numbers are
//! the rows of docs/talon-srx-rows.md.

use std::collections::{BTreeMap, BTreeSet};
use std::time::Duration;

use windlass::client::talon::ControlMode;
use windlass::client::{Drive, Selector, Target, Value};
use windlass::transport::Bus;
use windlass_core::dialect::DialectKind;
use windlass_core::dialect::dmc60c::wire::id as dmc60c_id;
use windlass_core::dialect::talon_srx::PRODUCT_TALON_SRX;
use windlass_core::dialect::talon_srx::wire::id;
use windlass_core::frame::Frame;
use windlass_core::frc_id::base;
use windlass_core::led::Colour;
use windlass_core::management::wire::{EnumerateResponse0, VendorCommand};
use windlass_core::node::PRODUCT_DMC60C;
use windlass_core::params::table::ParameterId;
use windlass_sim::{Poke, Source};
use windlass_tests::talon::{Talon, TalonBench};

/// Drives the Talon through the client and the DMC60C with frames of its own for `millis`.
fn drive_both(bench: &TalonBench, dmc60c: Target, millis: u64) {
    let control = Drive::new(dmc60c).unwrap().frame();
    for _ in 0..millis / 50 {
        bench
            .robot
            .lend(|client| client.control(5, &control))
            .unwrap();
        bench.run(50);
    }
}

#[test]
fn a_mixed_bus_drives_the_same_number_of_both_dialects_without_cross_talk() {
    let bench = TalonBench::new(&["talon:5", "dmc60c:5"]);
    let talon = bench.talon(5);
    bench.robot.enable().unwrap();
    talon.set(0.5).unwrap();
    drive_both(&bench, Target::Duty(-25.0), 1000);
    let (talon_truth, dmc60c_truth) = (bench.truth(0), bench.truth(1));
    assert_eq!(bench.throttle(0), 511);
    assert_eq!(dmc60c_truth.duty, -8192);
    assert!(talon_truth.velocity_counts_per_100ms > 1000.0);
    assert!(dmc60c_truth.velocity_counts_per_100ms < -1000.0);
    // Each host's view shows its own device only.
    assert_eq!(talon.applied_throttle().fresh().unwrap(), 511);
    let shown = bench.robot.lend(|client| *client.status(5).unwrap());
    assert!((shown.duty_percent().unwrap() + 25.0).abs() < 0.1);
    let (talon_speed, dmc60c_speed) = (talon.speed().fresh().unwrap(), shown.velocity().unwrap());
    assert!(
        talon_speed > 1000 && dmc60c_speed < -1000,
        "{talon_speed} {dmc60c_speed}"
    );
    // One stops, the other goes on.
    bench.robot.disable().unwrap();
    drive_both(&bench, Target::Duty(-25.0), 300);
    assert_eq!((bench.throttle(0), bench.truth(1).duty), (0, -8192));
    bench.robot.enable().unwrap();
    bench.run(300);
    assert_eq!((bench.throttle(0), bench.truth(1).duty), (511, 0));
    // Nobody has refused a frame: the other dialect's are simply not its own.
    for index in [0, 1] {
        let counters = bench.truth(index).counters;
        assert_eq!(
            (counters.bad_length, counters.remote, counters.unexpected),
            (0, 0, 0)
        );
    }
}

#[test]
fn a_mixed_bus_names_devices_of_the_same_number_by_their_dialect() {
    let bench = TalonBench::new(&["talon:5", "dmc60c:5", "talon:6"]);
    let find = |text: &str| {
        let selector: Selector = text.parse().unwrap();
        bench.robot.lend(|client| {
            let device = client.find(&selector)?;
            client
                .dialect(device.address)
                .map(|dialect| dialect.unwrap().name())
        })
    };
    assert_eq!(find("talon:5").unwrap(), "talon");
    assert_eq!(find("dmc60c:5").unwrap(), "dmc60c");
    assert_eq!(find("6").unwrap(), "talon");
    assert!(find("5").is_err(), "ambiguous");
    assert!(find("dmc60c:6").is_err(), "driven by another dialect");
}

/// Every frame since `from` whose API field belongs to the management channel, by identifier, apart from the
/// hosts' own.
fn management_frames(bench: &TalonBench, from: u64) -> BTreeSet<u32> {
    let entries = bench.world(|world| world.trace_since(from, usize::MAX));
    entries
        .into_iter()
        .filter(|entry| matches!(entry.from, Source::Node(_)))
        .map(|entry| entry.frame.raw_id())
        .filter(|raw| raw & 0xFFC0 >= 0xF000)
        .collect()
}

#[test]
fn a_mixed_bus_shows_each_host_its_own_devices_only() {
    let bench = TalonBench::new(&["talon:5", "dmc60c:5", "dmc60c:0", "talon:0"]);
    let from = bench.next_frame();
    bench.inject(Frame::extended(0x0000_0240, []));
    bench.run(150);
    assert_eq!(
        management_frames(&bench, from),
        BTreeSet::from([0x0204_F000, 0x0204_F005, 0x0206_F000, 0x0206_F005])
    );
    // One device for each identifier, and its kind by the product id.
    let first_answers = |identifier: u32| {
        let entries = bench.world(|world| world.trace_since(from, usize::MAX));
        let of_it = entries
            .into_iter()
            .filter(move |entry| entry.frame.raw_id() == identifier);
        of_it
            .filter_map(|entry| EnumerateResponse0::parse(&entry.frame))
            .collect::<Vec<_>>()
    };
    for (identifier, product) in [
        (0x0204_F000, PRODUCT_TALON_SRX),
        (0x0204_F005, PRODUCT_TALON_SRX),
        (0x0206_F000, PRODUCT_DMC60C),
        (0x0206_F005, PRODUCT_DMC60C),
    ] {
        let products: Vec<u32> = first_answers(identifier)
            .iter()
            .map(|answer| answer.product_id)
            .collect();
        assert_eq!(products, [product], "{identifier:#x}");
    }
    // A DMC60C host that knows a Talon's session even so gets no answer, and the other way round.
    let session = |identifier| first_answers(identifier)[0].session;
    for (session, base, own) in [
        (session(0x0204_F005), 0x0206_FC05, 0x0204_FC05),
        (session(0x0206_F005), 0x0204_FC05, 0x0206_FC05),
    ] {
        let question = VendorCommand {
            session,
            command: 0x61,
            param1: 0,
            param2: 0,
        };
        let ask = |identifier| {
            let from = bench.next_frame();
            bench.inject(question.emit(5).with_extended_id(identifier));
            bench.run(20);
            management_frames(&bench, from)
        };
        assert_eq!(ask(base), BTreeSet::new());
        assert_eq!(ask(own), BTreeSet::from([own + 0x80, own + 0xC0]));
    }
}

#[test]
fn devices_of_one_number_and_different_dialects_never_send_one_identifier() {
    let bench = TalonBench::new(&["talon:5", "dmc60c:5"]);
    let from = bench.next_frame();
    for round in 0..50 {
        bench.inject(Frame::extended(0x0000_0240, []));
        bench.run_us(20_000 + round * 37);
    }
    let mut senders: BTreeMap<u32, BTreeSet<usize>> = BTreeMap::new();
    for entry in bench.world(|world| world.trace_since(from, usize::MAX)) {
        if let Source::Node(index) = entry.from {
            let raw = entry.frame.raw_id();
            senders.entry(raw).or_default().insert(index);
        }
    }
    assert!(senders.len() > 8, "{senders:?}");
    assert!(
        senders.values().all(|nodes| nodes.len() == 1),
        "{senders:?}"
    );
    assert_eq!(bench.world(|world| world.bus().error_frames), 0);
}

#[test]
fn a_talon_becomes_a_dmc60c_and_back_by_its_parameter_and_a_restart() {
    let bench = TalonBench::new(&["talon:0"]);
    let become_ = |dialect: DialectKind| {
        bench.robot.lend(|client| {
            let device = client.scan().unwrap()[0];
            let value = Value {
                parameter: ParameterId::Dialect,
                raw: dialect.code(),
            };
            client.set_parameter(device.address, value).unwrap();
            // The acknowledgement comes under the new manufacturer.
            let address = client.soft_reset(device.address).unwrap();
            assert_eq!(address.manufacturer, dialect.identity().manufacturer);
            assert_eq!(client.dialect(address).unwrap(), Some(dialect));
            client.firmware_versions(address).unwrap();
            address
        })
    };
    let address = become_(DialectKind::Dmc60c);
    let renumbered = bench
        .robot
        .lend(|client| client.set_device_number(address, 63).unwrap());
    assert_eq!(renumbered.number, 63);
    // A Talon cannot have the number 63, which addresses all of them: it has its factory number then.
    bench.robot.lend(|client| {
        let value = Value {
            parameter: ParameterId::Dialect,
            raw: DialectKind::TalonSrx.code(),
        };
        client.set_parameter(renumbered, value).unwrap();
        assert!(client.soft_reset(renumbered).is_err(), "answers under 0");
    });
    let devices = bench.robot.lend(|client| client.scan()).unwrap();
    let found: Vec<_> = devices
        .iter()
        .map(|device| (device.address.number, device.product_id))
        .collect();
    assert_eq!(found, [(0, Some(PRODUCT_TALON_SRX))]);
}

#[test]
fn every_node_is_listed_once_whatever_its_dialect() {
    let bench = TalonBench::new(&["talon:3", "dmc60c:3", "talon:4", "dmc60c:7"]);
    let devices = bench.robot.lend(|client| client.scan()).unwrap();
    let numbers: Vec<u8> = devices.iter().map(|device| device.address.number).collect();
    // Numbers in ascending order, and of one number by the session.
    assert_eq!(numbers, [3, 3, 4, 7]);
}

#[test]
fn row_03_the_factory_number_is_0() {
    let bench = TalonBench::new(&["talon"]);
    let devices = bench.robot.lend(|client| client.scan()).unwrap();
    assert_eq!(devices[0].address.number, 0);
    let talon = bench.talon(0);
    bench.robot.enable().unwrap();
    talon.set(0.25).unwrap();
    bench.run(50);
    assert_eq!(bench.throttle(0), 255);
}

#[test]
fn row_01_a_new_number_acts_at_once_and_is_kept_over_a_power_cycle() {
    let bench = TalonBench::new(&["talon:3"]);
    let renumbered = bench.robot.lend(|client| {
        let device = client.find(&"talon:3".parse().unwrap()).unwrap();
        client.set_device_number(device.address, 62).unwrap()
    });
    assert_eq!(renumbered.number, 62);
    bench.run(16_000);
    bench.world(|world| world.power_cycle(0));
    bench.run(300);
    let (old, new) = (bench.talon(3), bench.talon(62));
    bench.robot.enable().unwrap();
    old.set(1.0).unwrap();
    new.set(0.5).unwrap();
    bench.run(300);
    assert_eq!(bench.throttle(0), 511);
    assert!(!old.applied_throttle().is_fresh());
    assert_eq!(new.applied_throttle().fresh().unwrap(), 511);
}

#[test]
fn row_01_the_numbers_0_to_62_can_be_given_and_63_is_refused_by_host_and_device() {
    let bench = TalonBench::new(&["talon:3"]);
    for number in [62, 0] {
        bench.robot.lend(|client| {
            let device = client.scan().unwrap()[0];
            let address = client.set_device_number(device.address, number).unwrap();
            assert_eq!(address.number, number);
        });
        bench.world(|world| world.power_cycle(0));
        bench.run(300);
        assert_eq!(bench.truth(0).number, number, "kept");
        let talon = bench.talon(number);
        bench.robot.enable().unwrap();
        talon.set(0.5).unwrap();
        bench.run(100);
        assert_eq!(bench.throttle(0), 511);
        bench.robot.disable().unwrap();
        talon.disable().unwrap();
        bench.run(50);
    }
    let address = bench.robot.lend(|client| client.scan()).unwrap()[0].address;
    let from = bench.next_frame();
    let refused = bench
        .robot
        .lend(|client| client.set_device_number(address, 63));
    assert!(refused.unwrap_err().to_string().contains("0 to 62"));
    assert_eq!(
        bench.frames(from, 0x0204_FC00, 0).len(),
        0,
        "nothing is sent"
    );
    let command = VendorCommand {
        session: address.session,
        command: 0x01,
        param1: 63,
        param2: 0,
    };
    bench.inject(command.emit(0).with_extended_id(0x0204_FC00));
    bench.run(20);
    let answer = bench.frames(from, 0x0204_FCC0, 0)[0].frame;
    assert_eq!(answer.data(), [2, 0, 0, 0], "cercBadParameter");
    assert_eq!(bench.truth(0).number, 0);
}

#[test]
fn row_04_up_to_five_devices_of_one_number_are_told_apart_and_one_is_renumbered() {
    let bench = TalonBench::new(&["talon:0"; 5]);
    let devices = bench.robot.lend(|client| client.scan()).unwrap();
    assert_eq!(devices.len(), 5);
    let chosen = devices[2].address;
    bench
        .robot
        .lend(|client| client.flash_leds(chosen))
        .unwrap();
    bench.run(50);
    let sessions = [0, 1, 2, 3, 4].map(|index| bench.truth(index).session);
    let node = sessions
        .iter()
        .position(|session| *session == Some(chosen.session))
        .unwrap();
    bench
        .robot
        .lend(|client| client.set_device_number(chosen, 9))
        .unwrap();
    for index in 0..5 {
        let expected = if index == node { 9 } else { 0 };
        assert_eq!(bench.truth(index).number, expected);
    }
}

#[test]
fn i5_frames_for_another_number_change_nothing() {
    let bench = TalonBench::new(&["talon:3", "talon:4"]);
    let talon = bench.talon(3);
    bench.robot.enable().unwrap();
    talon.set_p(2.0).unwrap();
    talon
        .set_status_frame_rate_ms(windlass::client::talon::StatusFrame::General, 3)
        .unwrap();
    talon.set_position(777).unwrap();
    talon.set(1.0).unwrap();
    bench.run(100);
    let other = bench.talon(4);
    let from = bench.next_frame();
    bench.run(1000);
    assert_eq!(bench.throttle(1), 0);
    assert!(bench.frames(from, id::STATUS_1, 4).len().abs_diff(100) <= 1);
    use windlass_core::dialect::talon_srx::wire::Parameter;
    assert_eq!(other.parameter(Parameter::Slot0P).unwrap(), 0);
    assert!(other.position().value.abs() < 2);
}

#[test]
fn row_69_pulling_a_device_off_the_bus_has_no_effect_on_the_others() {
    let bench = TalonBench::new(&["talon:3", "talon:4", "talon:5"]);
    let talons: Vec<Talon> = [3, 4, 5].map(|number| bench.talon(number)).into();
    // One that was never there, too.
    let absent = bench.talon(20);
    bench.robot.enable().unwrap();
    for talon in talons.iter().chain([&absent]) {
        talon.set(0.5).unwrap();
    }
    bench.run(200);
    bench.poke(1, Poke::BusConnected(false));
    for _ in 0..100 {
        bench.run(10);
        assert_eq!((bench.throttle(0), bench.throttle(2)), (511, 511));
    }
    assert_eq!(bench.throttle(1), 0, "it hears nothing any more");
    assert!(!talons[1].applied_throttle().is_fresh());
    bench.poke(1, Poke::BusConnected(true));
    bench.run(500);
    assert_eq!(bench.throttle(1), 511);
    assert_eq!(absent.applied_throttle().code(), 1);
}

/// Utilisation of the bus over a second in percent, as `windlass monitor --bus` measures it.
fn utilisation(bench: &TalonBench) -> f64 {
    let before = bench.robot.lend(|client| client.traffic());
    bench.run(1000);
    let after = bench.robot.lend(|client| client.traffic());
    (after.bits - before.bits) as f64 / 10_000.0
}

#[test]
fn row_65_sixteen_talons_at_10_ms_use_57_to_69_percent_of_the_bus() {
    let nodes: Vec<String> = (1..=16).map(|number| format!("talon:{number}")).collect();
    let nodes: Vec<&str> = nodes.iter().map(String::as_str).collect();
    let bench = TalonBench::new(&nodes);
    let talons: Vec<Talon> = (1..=16).map(|number| bench.talon(number)).collect();
    bench.robot.enable().unwrap();
    for (at, talon) in talons.iter().enumerate() {
        talon.set(0.06 * at as f64).unwrap();
    }
    bench.run(500);
    let load = utilisation(&bench);
    println!("16 Talons, default rates, control every 10 ms: {load:.1} %");
    assert!((57.0..=69.0).contains(&load), "{load:.1} %");
    // Every one is controlled all the time, and nothing is lost.
    for at in 0..16 {
        assert_eq!(bench.throttle(at), (1023.0 * 0.06 * at as f64) as i32);
    }
    let health = bench.robot.lend(|client| client.bus().health()).unwrap();
    assert_eq!((health.bus_off, health.tx_full), (Some(0), Some(0)));
    assert_eq!(
        (health.receive_errors, health.transmit_errors),
        (Some(0), Some(0))
    );
    let statistics = bench.world(|world| world.bus());
    assert_eq!((statistics.error_frames, statistics.lost), (0, 0));
}

#[test]
fn row_68_one_error_frame_blinks_every_unit_red_once_and_leaves_the_drive_alone() {
    let bench = TalonBench::new(&["talon:3", "talon:4"]);
    let talons = [bench.talon(3), bench.talon(4)];
    bench.robot.enable().unwrap();
    for talon in &talons {
        talon.set(0.5).unwrap();
    }
    bench.run(1000);
    let errors = bench.world(|world| world.bus().error_frames);
    // Shorted just long enough to destroy a frame.
    bench.world(|world| world.short_bus(true));
    while bench.world(|world| world.bus().error_frames) == errors {
        bench.run_us(50);
    }
    bench.world(|world| world.short_bus(false));
    let mut red_ms = [0, 0];
    for _ in 0..1000 {
        bench.run(1);
        for (index, count) in red_ms.iter_mut().enumerate() {
            let ring = bench.truth(index).leds.ring;
            *count += u32::from(ring == [Colour::Red; 4]);
            assert_eq!(bench.throttle(index), 511);
        }
    }
    for count in red_ms {
        assert!((90..=110).contains(&count), "red for {red_ms:?} ms");
    }
}

#[test]
fn row_05_the_chosen_unit_alone_blinks_orange_fast() {
    let bench = TalonBench::new(&["talon:3", "talon:4"]);
    let address = bench
        .robot
        .lend(|client| client.find(&"talon:3".parse().unwrap()))
        .unwrap()
        .address;
    let orange_changes = |index| {
        let mut changes = 0;
        let mut before = bench.truth(index).leds.ring;
        for _ in 0..2000 {
            bench.run(1);
            let ring = bench.truth(index).leds.ring;
            let colours = ring
                .iter()
                .all(|colour| [Colour::Orange, Colour::Off].contains(colour));
            assert!(colours, "{ring:?}");
            changes += u32::from(ring != before);
            before = ring;
        }
        changes
    };
    // Disabled: 1 Hz.
    let slow = orange_changes(0);
    assert!((3..=5).contains(&slow), "{slow}");
    bench
        .robot
        .lend(|client| client.flash_leds(address))
        .unwrap();
    let fast = orange_changes(0);
    assert!((30..=34).contains(&fast), "8 Hz: {fast} changes in 2 s");
    bench.run(10_000);
    bench
        .robot
        .lend(|client| client.flash_leds(address))
        .unwrap();
    let other = orange_changes(1);
    assert!((3..=5).contains(&other), "{other}");
}

#[test]
fn row_10_row_70_a_device_in_its_bootloader_does_not_drive_and_keeps_its_number() {
    let bench = TalonBench::new(&["talon:3"]);
    let talon = bench.talon(3);
    let address = bench
        .robot
        .lend(|client| client.find(&"3".parse().unwrap()))
        .unwrap()
        .address;
    bench
        .robot
        .lend(|client| client.enter_bootloader(address))
        .unwrap();
    bench.robot.enable().unwrap();
    talon.set(1.0).unwrap();
    bench.run(500);
    assert_eq!(bench.throttle(0), 0);
    let device = bench
        .robot
        .lend(|client| client.find(&"3".parse().unwrap()))
        .unwrap();
    assert_eq!(
        (device.address.number, device.image_name()),
        (3, "bootloader")
    );
    let report = talon.self_test().unwrap();
    assert!(!report.responding);
}

#[test]
fn nobody_but_the_robot_and_the_devices_talks() {
    let bench = TalonBench::new(&["talon:3", "dmc60c:4"]);
    let talon = bench.talon(3);
    bench.robot.enable().unwrap();
    talon.set_control_mode(ControlMode::PercentVbus).unwrap();
    talon.set(0.1).unwrap();
    let from = bench.next_frame();
    bench.run(500);
    for entry in bench.world(|world| world.trace_since(from, usize::MAX)) {
        let kind = base(entry.frame.extended_id().unwrap());
        let talon_frame = kind & 0xFFFF_0000 == id::CONTROL_1;
        match entry.from {
            Source::Node(0) => assert!(talon_frame && kind >= id::STATUS_1, "{kind:#x}"),
            Source::Node(_) => assert!(kind >= dmc60c_id::STATUS_GENERAL, "{kind:#x}"),
            Source::Participant(_) => assert_eq!(kind, id::CONTROL_1),
        }
    }
    assert!(bench.robot.now() > Duration::ZERO);
}
