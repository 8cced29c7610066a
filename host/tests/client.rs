//! The client library against simulated devices, in virtual time.

use std::time::Duration;

use windlass::client::{
    Address, Client, Descriptors, Drive, Error, PinTestResult, Selector, Target, Value,
    find_parameter,
};
use windlass::transport::SimBus;
use windlass_core::dialect::dmc60c::wire::ModeSelect;
use windlass_core::management::Identity;
use windlass_core::management::vendor::{Descriptor, PinTest, TestPin};
use windlass_core::management::wire::ImageType;
use windlass_core::params::table::{Parameter, ParameterId, TABLE};
use windlass_core::reset::ResetCause;
use windlass_sim::Poke;

type Bench = Client<SimBus>;

fn bench(nodes: &[&str]) -> Bench {
    let nodes: Vec<_> = nodes.iter().map(|node| node.parse().unwrap()).collect();
    Client::new(SimBus::with_nodes(&nodes))
}

fn only(client: &mut Bench) -> Address {
    let devices = client.scan().unwrap();
    let [device] = devices.as_slice() else {
        panic!("one device expected: {devices:?}");
    };
    device.address
}

fn poke(client: &mut Bench, node: usize, poke: Poke) {
    client.bus().world().node_mut(node).unwrap().poke(poke);
}

fn millis(span: u64) -> Duration {
    Duration::from_millis(span)
}

fn set(client: &mut Bench, address: Address, name: &str, text: &str) {
    let value = Value::parse(find_parameter(name).unwrap(), text).unwrap();
    assert_eq!(client.set_parameter(address, value).unwrap(), value);
}

/// Drives device 1 and gives its status afterwards.
fn drive(client: &mut Bench, target: Target, span: Duration) -> windlass::client::Status {
    let control = Drive::new(target).unwrap().frame();
    client.drive_for(1, &control, span).unwrap();
    *client.status(1).unwrap()
}

/// Gains for the simulated CIM motor with its 4096 counts: feed-forward to about the speed of full
/// throttle, proportional for the rest.
fn set_velocity_gains(client: &mut Bench, address: Address) {
    set(client, address, "ClosedLoopFGainSlot0", "0.9");
    set(client, address, "ClosedLoopPGainSlot0", "1");
}

#[test]
fn devices_with_the_same_number_are_told_apart_and_one_is_renumbered() {
    let mut client = bench(&["dmc60c:5", "dmc60c:5", "dmc60c:0"]);
    let devices = client.scan().unwrap();
    let numbers: Vec<u8> = devices.iter().map(|device| device.address.number).collect();
    assert_eq!(numbers, [0, 5, 5]);
    let selector: Selector = "dmc60c:5".parse().unwrap();
    let error = client.find(&selector).unwrap_err();
    let Error::Ambiguous { candidates, .. } = &error else {
        panic!("two candidates expected: {error}");
    };
    let [first, second] = candidates[..] else {
        panic!("two candidates expected: {error}");
    };
    assert_ne!(first.session, second.session);
    assert!(error.next_step().contains(&second.to_string()));

    for text in [format!("@{}", second.session), second.to_string()] {
        let selector: Selector = text.parse().unwrap();
        assert_eq!(client.find(&selector).unwrap().address, second);
    }
    let moved = client.set_device_number(second, 6).unwrap();
    assert_eq!(moved.session, second.session);
    let devices = client.scan().unwrap();
    let addresses: Vec<Address> = devices.iter().map(|device| device.address).collect();
    assert_eq!(addresses[1..], [first, moved]);
}

#[test]
fn devices_with_the_same_number_are_found_whenever_they_are_asked() {
    let mut client = bench(&["dmc60c:5", "dmc60c:5", "dmc60c:0", "dmc60c:0"]);
    for shift in 0..50 {
        client.listen(Duration::from_micros(shift * 1373)).unwrap();
        let devices = client.scan().unwrap();
        let numbers: Vec<u8> = devices.iter().map(|device| device.address.number).collect();
        assert_eq!(numbers, [0, 0, 5, 5], "shift {shift}");
        for device in devices {
            client.firmware_versions(device.address).unwrap();
        }
    }
}

#[test]
fn a_device_number_out_of_range_is_refused_before_it_is_sent() {
    let mut client = bench(&["dmc60c:5"]);
    let address = only(&mut client);
    for number in [0, 64, 255] {
        let error = client.set_device_number(address, number).unwrap_err();
        assert!(matches!(error, Error::Value(_)), "{error}");
    }
    assert_eq!(only(&mut client), address);
}

#[test]
fn strings_are_read_back_as_written() {
    let mut client = bench(&["dmc60c:5"]);
    let address = only(&mut client);
    let fresh = client.descriptors(address).unwrap();
    for descriptor in Descriptor::ALL {
        assert_eq!(
            fresh.text(descriptor),
            Identity::DMC60C.default_text(descriptor)
        );
    }
    for descriptor in Descriptor::ALL {
        for text in ["", "A", "abcdefg", "abcdefgh"] {
            client.set_descriptor(address, descriptor, text).unwrap();
            assert_eq!(client.descriptors(address).unwrap().text(descriptor), text);
        }
        let longest = "x".repeat(descriptor.capacity());
        client
            .set_descriptor(address, descriptor, &longest)
            .unwrap();
        let error = client.set_descriptor(address, descriptor, &format!("{longest}y"));
        assert!(matches!(error, Err(Error::Value(_))));
        assert_eq!(
            client.descriptors(address).unwrap().text(descriptor),
            longest
        );
    }
    let error = client.set_descriptor(address, Descriptor::DeviceName, "a\0b");
    assert!(matches!(error, Err(Error::Value(_))));
    assert_ne!(client.descriptors(address).unwrap(), Descriptors::default());
}

#[test]
fn versions_and_flash_writes_are_read() {
    let mut client = bench(&["dmc60c:5"]);
    let device = client.find(&"5".parse().unwrap()).unwrap();
    let versions = client.firmware_versions(device.address).unwrap();
    assert_eq!(versions.image, ImageType::Application);
    assert_eq!(device.versions, Some(versions));
    let before = client.flash_sequence(device.address).unwrap();
    client
        .set_descriptor(device.address, Descriptor::DeviceName, "written")
        .unwrap();
    client.listen(millis(500)).unwrap();
    assert!(client.flash_sequence(device.address).unwrap() > before);
}

#[test]
fn a_factory_reset_puts_everything_back_but_number_and_serial_number() {
    let mut client = bench(&["dmc60c:5"]);
    let address = only(&mut client);
    for (descriptor, text) in [
        (Descriptor::DeviceName, "winch"),
        (Descriptor::SerialNumber, "0042"),
    ] {
        client.set_descriptor(address, descriptor, text).unwrap();
    }
    let gain = Value::parse(find_parameter("10").unwrap(), "1.5").unwrap();
    client.set_parameter(address, gain).unwrap();
    assert_eq!(client.factory_reset(address, false).unwrap(), address);
    let strings = client.descriptors(address).unwrap();
    assert_eq!(strings.text(Descriptor::DeviceName), "Motor Controller");
    assert_eq!(strings.text(Descriptor::SerialNumber), "0042");
    let read = client.parameter(address, ParameterId::Slot0P).unwrap();
    assert_eq!(read.raw, 0);
    let anonymous = client.factory_reset(address, true).unwrap();
    assert_eq!((anonymous.number, anonymous.session), (0, address.session));
    assert_eq!(only(&mut client), anonymous);
    let strings = client.descriptors(anonymous).unwrap();
    assert_eq!(strings.text(Descriptor::SerialNumber), "UNKNOWN");
}

/// What a parameter of a device that was just switched on reads; nothing for what shows the moment.
fn fresh(row: &Parameter) -> Option<u32> {
    match row.id {
        ParameterId::ResetCause => Some(ResetCause::PowerOn as u32),
        ParameterId::Leds => None,
        _ => Some(row.default),
    }
}

#[test]
fn every_parameter_reads_its_default() {
    let mut client = bench(&["dmc60c:5"]);
    let address = only(&mut client);
    for row in &TABLE {
        let value = client.parameter(address, row.id).unwrap();
        let expected = fresh(row).unwrap_or(value.raw);
        assert_eq!(value.raw, expected, "{}", row.name);
    }
}

#[test]
fn parameters_are_written_and_bad_values_are_not_sent() {
    let mut client = bench(&["dmc60c:5"]);
    let address = only(&mut client);
    set(&mut client, address, "ClosedLoopPGainSlot1", "-0.25");
    set(&mut client, address, "ContinuousCurrentLimit", "20A");
    set(&mut client, address, "LimitSoftFwdThreshold", "-100000");
    let gain = client.parameter(address, ParameterId::Slot1P).unwrap();
    assert_eq!(gain.raw, 0xFFFF_C000);
    let traffic = client.traffic();
    let bad = Value {
        parameter: ParameterId::GeneralPeriod,
        raw: 51,
    };
    assert!(matches!(
        client.set_parameter(address, bad),
        Err(Error::Value(_))
    ));
    assert_eq!(client.traffic(), traffic);
}

#[test]
fn duty_cycle_drives_both_ways_and_silence_stops_it() {
    let mut client = bench(&["dmc60c:1"]);
    only(&mut client);
    let forward = drive(&mut client, Target::Duty(50.0), millis(500));
    assert!((forward.duty_percent().unwrap() - 50.0).abs() < 0.1);
    assert!(forward.velocity().unwrap() > 10_000, "{forward:?}");
    let reverse = drive(&mut client, Target::Duty(-50.0), millis(1000));
    assert!((reverse.duty_percent().unwrap() + 50.0).abs() < 0.1);
    assert!(reverse.velocity().unwrap() < -10_000, "{reverse:?}");
    client.listen(millis(120)).unwrap();
    assert_eq!(client.status(1).unwrap().duty_percent(), Some(0.0));
}

#[test]
fn switching_off_needs_no_timeout() {
    let mut client = bench(&["dmc60c:1"]);
    only(&mut client);
    drive(&mut client, Target::Duty(30.0), millis(200));
    client.switch_off(1).unwrap();
    client.listen(millis(25)).unwrap();
    let general = client.status(1).unwrap().general.unwrap().value;
    assert_eq!((general.duty, general.mode), (0, ModeSelect::NoDrive));
}

#[test]
fn closed_loop_velocity_reaches_its_target() {
    let mut client = bench(&["dmc60c:1"]);
    let address = only(&mut client);
    set_velocity_gains(&mut client, address);
    let target = Target::rpm(600.0, 4096).unwrap();
    assert_eq!(target, Target::Velocity(4096));
    let status = drive(&mut client, target, millis(1500));
    let velocity = status.velocity().unwrap();
    assert!((velocity - 4096).abs() < 200, "{velocity}");
    assert_eq!(status.general.unwrap().value.mode, ModeSelect::Velocity);
}

#[test]
fn closed_loop_position_reaches_its_target() {
    let mut client = bench(&["dmc60c:1"]);
    let address = only(&mut client);
    set(&mut client, address, "ClosedLoopPGainSlot0", "4");
    set(&mut client, address, "ClosedLoopDGainSlot0", "120");
    let status = drive(&mut client, Target::Position(8192), millis(3000));
    let position = status.position().unwrap();
    assert!((position - 8192).abs() < 400, "{position}");
}

#[test]
fn closed_loop_current_reaches_its_target() {
    let mut client = bench(&["dmc60c:1"]);
    let address = only(&mut client);
    poke(&mut client, 0, Poke::Stall(true));
    set(&mut client, address, "ClosedLoopFGainSlot0", "240");
    set(&mut client, address, "ClosedLoopIGainSlot0", "1");
    let status = drive(&mut client, Target::Current(10.0), millis(1000));
    let current = status.current().unwrap();
    assert!((current - 10.0).abs() < 1.0, "{current}");
}

#[test]
fn voltage_compensation_holds_the_output_voltage() {
    let mut client = bench(&["dmc60c:1"]);
    only(&mut client);
    let status = drive(&mut client, Target::Voltage(6.0), millis(1000));
    let volts = status.bus_voltage().unwrap() * status.duty_percent().unwrap() / 100.0;
    assert!((volts - 6.0).abs() < 0.15, "{volts}");
}

#[test]
fn a_follower_does_what_its_master_does() {
    let mut client = bench(&["dmc60c:1", "dmc60c:2"]);
    client.scan().unwrap();
    let follower = Drive::new(Target::Follow(1)).unwrap().frame();
    let master = Drive::new(Target::Duty(40.0)).unwrap().frame();
    for _ in 0..10 {
        client.control(1, &master).unwrap();
        client.control(2, &follower).unwrap();
        client.listen(millis(50)).unwrap();
    }
    let duty = client.status(2).unwrap().duty_percent().unwrap();
    assert!((duty - 40.0).abs() < 0.1, "{duty}");
}

#[test]
fn a_restart_keeps_the_session_and_a_power_cycle_does_not() {
    let mut client = bench(&["dmc60c:5"]);
    let address = only(&mut client);
    client.soft_reset(address).unwrap();
    assert_eq!(only(&mut client), address);
    client.enter_bootloader(address).unwrap();
    let device = client.find(&Selector::from(address)).unwrap();
    assert_eq!(device.image_name(), "bootloader");
    client.soft_reset(address).unwrap();

    client.bus().world().power_cycle(0);
    client.listen(millis(1000)).unwrap();
    let error = client.parameter(address, ParameterId::Slot0P).unwrap_err();
    let Error::WrongSession { session, .. } = error else {
        panic!("another session expected: {error}");
    };
    assert_ne!(session, address.session);
}

#[test]
fn a_device_without_power_is_stale_and_does_not_answer() {
    let mut client = bench(&["dmc60c:5"]);
    let address = only(&mut client);
    client.listen(millis(300)).unwrap();
    assert!(!client.status(5).unwrap().is_stale(client.now()));
    poke(&mut client, 0, Poke::Powered(false));
    client.listen(millis(600)).unwrap();
    assert!(client.status(5).unwrap().is_stale(client.now()));
    let error = client.descriptors(address).unwrap_err();
    assert!(matches!(error, Error::NoAnswer { .. }), "{error}");
}

#[test]
fn the_header_tests_name_the_last_pin_that_failed() {
    let mut client = bench(&["dmc60c:5"]);
    let address = only(&mut client);
    let short = client.pin_test(address, PinTest::Short).unwrap();
    assert_eq!(short, PinTestResult::Passed);
    let open = client.pin_test(address, PinTest::Open).unwrap();
    assert!(
        matches!(open, PinTestResult::Failed(Some(pin)) if TestPin::TABLE.iter().any(|row| row.0 == pin))
    );
    poke(&mut client, 0, Poke::J1Loopback(true));
    let open = client.pin_test(address, PinTest::Open).unwrap();
    assert_eq!(open, PinTestResult::Passed);
}

#[test]
fn a_lossy_bus_is_survived_by_asking_again() {
    use windlass_sim::{World, WorldConfig};
    let mut world = World::new(WorldConfig {
        loss: 0.05,
        ..WorldConfig::default()
    });
    world.add_node("dmc60c:5".parse().unwrap());
    let mut client = Client::new(SimBus::new(world));
    let address = client.find(&"5".parse().unwrap()).unwrap().address;
    for row in &TABLE {
        let value = client.parameter(address, row.id).unwrap();
        if row.id != ParameterId::TransmissionsFailed {
            let expected = fresh(row).unwrap_or(value.raw);
            assert_eq!(value.raw, expected, "{}", row.name);
        }
    }
}
