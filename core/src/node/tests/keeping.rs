//! When settings are written, what is answered, and what happens if they can not be.

use super::*;
use crate::params::SettingsState;

const STATE: u8 = 131;
const FACTORY_RESET: u16 = 0xE3;

impl Bench {
    fn state(&mut self) -> SettingsState {
        let value = self.get(STATE).value;
        let state = self.node.settings_state();
        assert_eq!(state as u32, value);
        state
    }

    fn spin(&mut self, ticks: u32) {
        for _ in 0..ticks {
            if self.now.as_micros().is_multiple_of(50_000) {
                let frame = Control0 {
                    mode: ModeSelect::Voltage,
                    target: 10_000,
                    ..Control0::default()
                };
                self.receive(&frame.emit(self.node.number()));
            }
            self.run(1);
        }
    }

    fn saves(&self) -> usize {
        let is_save = |action: &&Action| **action == Action::Save;
        self.actions.iter().filter(is_save).count()
    }
}

#[test]
fn the_state_of_the_settings_can_be_read() {
    let mut bench = Bench::connected();
    assert_eq!(bench.state(), SettingsState::Saved);
    bench.set(10, 1);
    assert_eq!(bench.state(), SettingsState::Pending);
    bench.run(1);
    assert_eq!(bench.state(), SettingsState::Saved);
    bench.set(10, 2);
    bench.run(29_000);
    assert_eq!(bench.state(), SettingsState::Pending);
    bench.run(1_001);
    assert_eq!(bench.state(), SettingsState::Saved);
    assert_eq!(bench.set(STATE, 3).value, 0, "writing has no effect");
}

#[test]
fn an_erase_waits_until_the_drive_has_been_off_for_a_second() {
    let mut bench = Bench::connected();
    bench.spin(1000);
    assert!(!bench.node.may_erase(bench.now));
    bench.memory = Some(SaveError::EraseDue);
    let status = bench.vendor(0x01, 6).unwrap();
    assert_eq!(status.code, CommandCode::SaveWaits as u16);
    assert_eq!(bench.node.number(), 6, "it is in force all the same");
    assert_eq!(bench.state(), SettingsState::EraseDue);
    bench.spin(40_000);
    assert_eq!(
        bench.saves(),
        1,
        "nothing is tried while the motor is driven"
    );
    // The heartbeat ends after 104 ms.
    bench.run(208);
    assert!(!matches!(bench.snapshot.actuation, Actuation::Drive(_)));
    bench.memory = None;
    let (mut off, before) = (0, bench.now);
    while bench.saves() == 1 {
        assert!(!bench.node.may_erase(bench.now));
        bench.run(1);
        off += 1;
        assert!(off < 2100);
    }
    let waited = bench.now.since(before).as_micros() / 1000;
    assert!((890..=1000).contains(&waited), "{waited} ms");
    assert_eq!(bench.state(), SettingsState::Saved);
}

#[test]
fn a_restart_waits_for_the_save_and_may_erase_as_soon_as_the_output_is_off() {
    let mut bench = Bench::connected();
    bench.spin(1000);
    bench.set(10, 1);
    bench.run(1);
    bench.set(10, 2);
    bench.actions.clear();
    bench.memory = Some(SaveError::EraseDue);
    bench.vendor(0xF1, 0);
    assert_eq!(bench.actions, [Action::Save], "no restart yet");
    bench.memory = None;
    bench.run(2);
    assert!(matches!(
        bench.actions[..],
        [Action::Save, Action::Save, Action::Reset(_)]
    ));
}

#[test]
fn a_save_that_fails_is_told_and_tried_again_after_15_s() {
    let mut bench = Bench::connected();
    bench.memory = Some(SaveError::Memory);
    let status = bench.vendor(0x01, 6).unwrap();
    assert_eq!(status.code, CommandCode::FlashWriteFailed as u16);
    assert_eq!(bench.state(), SettingsState::Pending);
    bench.memory = None;
    bench.run(29_990);
    assert_eq!(bench.saves(), 1);
    bench.run(20);
    assert_eq!(bench.saves(), 2);
    assert_eq!(bench.state(), SettingsState::Saved);
}

#[test]
fn a_newer_format_is_left_alone() {
    let config = NodeConfig {
        newer_settings: true,
        ..NodeConfig::dmc60c(1)
    };
    let mut bench = Bench::with(&config, None);
    bench.run(100);
    bench.receive(&Frame::extended(0x1FFF_FFFF, []));
    assert_eq!(bench.state(), SettingsState::NewerFormat);
    let refused = CommandCode::FlashWriteFailed as u16;
    for (command, parameter) in [(0x01, 6), (FACTORY_RESET, 0)] {
        assert_eq!(bench.vendor(command, parameter).unwrap().code, refused);
    }
    assert_eq!(bench.node.number(), 0);
    // Parameters act, but only until the next start.
    assert_eq!(bench.set(10, 7).value, 7);
    bench.run(40_000);
    assert_eq!(bench.saves(), 0);
    assert_eq!(bench.state(), SettingsState::NewerFormat);
}

#[test]
fn a_command_that_waits_for_its_save_is_ended_by_the_next_one() {
    let mut bench = Bench::connected();
    let session = bench.session();
    let command = |command, param1| VendorCommand {
        session,
        command,
        param1,
        param2: 0,
    };
    // Both come before the platform has had time to write.
    let frames = [command(0x01, 6).emit(5), command(0x61, 0).emit(6)];
    for frame in frames {
        bench.node.on_frame(bench.now, &frame, &bench.snapshot);
    }
    bench.sent.clear();
    bench.flush();
    let codes: Vec<_> = bench
        .sent
        .iter()
        .filter_map(|(_, frame)| VendorStatus::parse(frame))
        .map(|status| status.byte_count)
        .collect();
    assert_eq!(codes, [6], "only the versions are answered");
    assert_eq!(bench.saves(), 1);
}

/// A controller with everything away from its default.
fn configured() -> Bench {
    let mut bench = Bench::connected();
    bench.set(10, 77);
    bench.set(93, 20);
    for (command, text) in [(0x02, *b"winch\0"), (0x07, *b"00042\0")] {
        bench.vendor(command, 6);
        bench.receive(&Frame::extended(id::VENDOR_DATA_OUT | 5, text));
    }
    bench.sample.pins.set(Pin::GateDriverFault, true);
    bench.run(1);
    bench.sample.pins.set(Pin::GateDriverFault, false);
    bench.run(6001);
    assert_eq!((bench.get(52).value, bench.get(56).value), (8, 1));
    bench
}

#[test]
fn a_factory_reset_keeps_the_number_and_what_the_maker_has_set() {
    let mut bench = configured();
    assert_eq!(bench.vendor(FACTORY_RESET, 0).unwrap().code, 0);
    for (parameter, value) in [(10, 0), (93, 10), (52, 0), (56, 0)] {
        assert_eq!(bench.get(parameter).value, value, "{parameter}");
    }
    let stored = bench.node.stored();
    assert_eq!(stored.number, 5);
    assert_eq!(stored.params, crate::params::Params::new());
    let text = |which| stored.descriptors.stored(which);
    assert_eq!(text(Descriptor::DeviceName), None);
    assert_eq!(text(Descriptor::SerialNumber), Some(&b"00042"[..]));
    // The same fault events are not counted anew.
    bench.run(10);
    assert_eq!(bench.get(56).value, 0);
}

#[test]
fn a_factory_reset_of_everything_also_forgets_number_and_strings() {
    let mut bench = configured();
    assert_eq!(bench.vendor(FACTORY_RESET, 1).unwrap().code, 0);
    assert_eq!(
        bench.sent[0].1.extended_id(),
        Some(id::VENDOR_STATUS),
        "answered under the new number"
    );
    let stored = bench.node.stored();
    assert_eq!(
        stored,
        Stored {
            sequence: stored.sequence,
            ..Stored::default()
        }
    );
}

#[test]
fn a_factory_reset_is_refused_while_the_motor_is_driven() {
    let mut bench = configured();
    bench.spin(1000);
    let status = bench.vendor(FACTORY_RESET, 0).unwrap();
    assert_eq!(status.code, CommandCode::DriveRunning as u16);
    assert_eq!(bench.get(10).value, 77);
    bench.run(208);
    let status = bench.vendor(FACTORY_RESET, 2).unwrap();
    assert_eq!(status.code, CommandCode::BadParameter as u16);
    assert_eq!(bench.get(10).value, 77);
}
