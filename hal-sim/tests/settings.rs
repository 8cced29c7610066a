//! Settings of a whole board: kept through power cuts, written in their time, erased while off.

mod bench;

use bench::Bench;
use windlass_core::dialect::dmc60c::wire::ModeSelect;
use windlass_core::management::vendor::{Command, CommandCode};
use windlass_core::management::wire::{
    ParameterRequest, ParameterResponse, ParameterSet, VendorCommand,
};
use windlass_core::params::SettingsState;
use windlass_core::params::table::ParameterId;
use windlass_core::reset::ResetCause;
use windlass_core::time::Duration;
use windlass_sim::{Poke, SimNode};

fn node(bench: &Bench) -> &SimNode {
    bench.world.node(0).unwrap()
}

fn cut(bench: &mut Bench) {
    bench.poke(0, Poke::Powered(false));
    bench.run(10);
    bench.poke(0, Poke::Powered(true));
    bench.run(20);
}

#[test]
fn i6_power_cut_at_any_moment_of_a_save_leaves_the_old_or_the_new_settings() {
    let (mut old, mut new, mut acknowledged) = (0, 0, 0);
    for micros in (0..4000).step_by(23) {
        let mut bench = Bench::new(&["dmc60c:5"]);
        let (number, session) = bench.enumerate()[0];
        bench.set((number, session), ParameterId::Slot0P, 1);
        bench.run(20);
        let before = node(&bench).stored();
        assert_eq!(before.params.get(ParameterId::Slot0P), 1);
        // Both are written by one save: the number at once, the gain with it.
        let gain = ParameterSet {
            session,
            parameter: ParameterId::Slot0P as u8,
            value: 2,
        };
        let renumber = VendorCommand {
            session,
            command: Command::SetDeviceNumber.code(),
            param1: 9,
            param2: 0,
        };
        bench.drain();
        bench.world.send(bench.tool, gain.emit(number));
        bench.world.send(bench.tool, renumber.emit(number));
        bench.world.advance(Duration::from_micros(micros));
        let status = windlass_core::management::wire::id::VENDOR_STATUS;
        let answered = !bench.of_kind(status).is_empty();
        cut(&mut bench);
        let after = node(&bench).stored();
        let running = node(&bench).node().unwrap();
        let loaded = (running.number(), after.params.get(ParameterId::Slot0P));
        match loaded {
            (5, 1) => old += 1,
            (9, 2) => new += 1,
            other => panic!("cut {micros} µs after the commands: {other:?}"),
        }
        if answered {
            acknowledged += 1;
            assert_eq!(loaded, (9, 2), "acknowledged, then lost: {micros} µs");
        }
    }
    assert!(
        old > 20 && new > 20 && acknowledged > 20,
        "{old} {new} {acknowledged}"
    );
}

/// A parameter as it is read over the bus.
fn get(bench: &mut Bench, (number, session): (u8, u16), parameter: ParameterId) -> u32 {
    bench.drain();
    let request = ParameterRequest {
        session,
        parameter: parameter as u8,
    };
    bench.world.send(bench.tool, request.emit(number));
    bench.run(20);
    let answers = bench.of_kind(windlass_core::management::wire::id::PARAMETER_RESPONSE);
    let answer = ParameterResponse::parse(&answers[0].frame).unwrap();
    assert_eq!(answer.code, 0);
    answer.value
}

#[test]
fn a_crash_is_known_after_a_power_cut() {
    let mut bench = Bench::new(&["dmc60c:5"]);
    let device = bench.enumerate()[0];
    assert_eq!(get(&mut bench, device, ParameterId::CrashCause), 0);
    bench.set(device, ParameterId::Slot0P, 7);
    bench.run(20);
    bench.poke(0, Poke::Hang(true));
    bench.run(25);
    bench.poke(0, Poke::Hang(false));
    bench.run(500);
    let watchdog = ResetCause::Watchdog as u32;
    let device = bench.enumerate()[0];
    assert_eq!(get(&mut bench, device, ParameterId::ResetCause), watchdog);
    assert_eq!(get(&mut bench, device, ParameterId::CrashCause), watchdog);
    cut(&mut bench);
    bench.run(500);
    let device = bench.enumerate()[0];
    let power_on = ResetCause::PowerOn as u32;
    assert_eq!(get(&mut bench, device, ParameterId::ResetCause), power_on);
    assert_eq!(get(&mut bench, device, ParameterId::CrashCause), watchdog);
    assert_eq!(get(&mut bench, device, ParameterId::Slot0P), 7);
}

#[test]
fn nothing_is_erased_while_the_motor_is_driven() {
    let mut bench = Bench::new(&["dmc60c:5"]);
    let (mut number, session) = bench.enumerate()[0];
    let mut waits = 0;
    for _ in 0..1500 {
        bench.drive_for(number, ModeSelect::Voltage, 8000, 20);
        let next = 11 - number;
        let code = bench.command((number, session), Command::SetDeviceNumber, u16::from(next));
        number = next;
        if code == CommandCode::SaveWaits as u16 {
            waits += 1;
            break;
        }
        assert_eq!(code, CommandCode::NoError as u16);
    }
    assert_eq!(waits, 1, "the memory is full at some time");
    let truth = bench.truth(0);
    assert_eq!(truth.flash_erases, 0);
    assert!(truth.flash_writes > 100, "{}", truth.flash_writes);
    assert_eq!(truth.settings, Some(SettingsState::EraseDue));
    bench.drive_for(number, ModeSelect::Voltage, 8000, 3000);
    assert_eq!(bench.truth(0).flash_erases, 0);
    // Off: a second later the erase begins, and a quarter of a second later it is over.
    bench.run(1000);
    assert_eq!(bench.truth(0).settings, Some(SettingsState::EraseDue));
    bench.run(600);
    let truth = bench.truth(0);
    assert_eq!(truth.settings, Some(SettingsState::Saved));
    assert_eq!(node(&bench).stored().number, number);
    // The one for the set, and the other unit in advance.
    bench.run(600);
    assert_eq!(bench.truth(0).flash_erases, 2);
}

#[test]
fn a_power_cut_during_an_erase_in_advance_loses_nothing() {
    let mut bench = Bench::new(&["dmc60c:5"]);
    let (mut number, session) = bench.enumerate()[0];
    // Into the second unit: the first one is then to be erased.
    while bench.truth(0).flash_erases == 0 {
        let next = 11 - number;
        bench.command((number, session), Command::SetDeviceNumber, u16::from(next));
        number = next;
    }
    bench.run(100);
    cut(&mut bench);
    assert_eq!(node(&bench).node().unwrap().number(), number);
    assert_eq!(node(&bench).stored().number, number);
    bench.run(2000);
    assert_eq!(bench.truth(0).flash_erases, 2, "erased again, whole");
}
