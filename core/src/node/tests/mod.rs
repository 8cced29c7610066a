//! One node with its engine, frame by frame: what goes over the wire is all that these tests see.

extern crate std;

mod keeping;
mod reset;
mod stored;

use std::vec::Vec;

use super::*;
use crate::dialect::dmc60c::wire::{Control0, ModeSelect, StatusGeneral};
use crate::engine::Engine;
use crate::engine::snapshot::{Pin, Sample, Snapshot};
use crate::frc_id::base;
use crate::management::vendor::{CommandCode, Descriptor};
use crate::management::wire::{
    ParameterRequest, ParameterResponse, ParameterSet, VendorCommand, VendorStatus, id,
};
use crate::params::journal::{SaveError, Saved};
use crate::time::{Duration, TICK};
use proptest::prelude::*;

/// A powered controller whose frames are all sent at once.
struct Bench {
    node: Node,
    engine: Engine,
    sample: Sample,
    snapshot: Snapshot,
    now: Instant,
    sent: Vec<(Instant, Frame)>,
    /// What the node has asked for, but for confirmations and being called healthy.
    actions: Vec<Action>,
    confirmations: u32,
    healthy: u32,
    /// How the settings memory fails.
    memory: Option<SaveError>,
}

impl Bench {
    fn new() -> Self {
        Self::with(
            &NodeConfig::dmc60c(1),
            Some(Stored {
                number: 5,
                ..Stored::default()
            }),
        )
    }

    fn with(config: &NodeConfig, stored: Option<Stored>) -> Self {
        Self {
            node: Node::new(Instant::ZERO, config, stored.as_ref()),
            engine: Engine::new(),
            sample: Sample {
                current: 2048,
                bus_voltage: 1354,
                temperature: 931,
                ..Sample::default()
            },
            snapshot: Snapshot::default(),
            now: Instant::ZERO,
            sent: Vec::new(),
            actions: Vec::new(),
            confirmations: 0,
            healthy: 0,
            memory: None,
        }
    }

    /// A controller that has finished its self-check and seen a bus.
    fn connected() -> Self {
        let mut bench = Self::new();
        bench.run(100);
        bench.receive(&Frame::extended(0x1FFF_FFFF, []));
        bench
    }

    fn flush(&mut self) {
        while let Some(action) = self.node.take_action() {
            if action == Action::Confirm {
                self.confirmations += 1;
                continue;
            }
            if action == Action::Healthy {
                self.healthy += 1;
                continue;
            }
            self.actions.push(action);
            if action == Action::Save {
                let sequence = self.node.stored().sequence;
                let result = self.memory.map_or(
                    Ok(Saved {
                        sequence,
                        written: true,
                    }),
                    Err,
                );
                self.node.save_ended(self.now, result);
            }
        }
        while let Some(transmission) = self.node.poll_tx(self.now, &self.snapshot) {
            self.sent.push((self.now, transmission.frame));
            self.node
                .on_transmitted(self.now, transmission.tag, TxOutcome::Sent);
        }
    }

    fn receive(&mut self, frame: &Frame) {
        self.node.on_frame(self.now, frame, &self.snapshot);
        self.flush();
    }

    fn run(&mut self, ticks: u32) {
        for _ in 0..ticks {
            self.now = self.now + TICK;
            let (settings, command) = (*self.node.settings(), *self.node.command());
            self.snapshot = *self.engine.tick(&settings, &self.sample, &command);
            self.node.poll(self.now, &self.snapshot);
            self.flush();
        }
    }

    fn session(&self) -> u16 {
        self.node.session().expect("a bus")
    }

    fn vendor(&mut self, command: u16, param1: u16) -> Option<VendorStatus> {
        self.sent.clear();
        let session = self.session();
        self.receive(
            &VendorCommand {
                session,
                command,
                param1,
                param2: 0,
            }
            .emit(self.node.number()),
        );
        self.sent
            .iter()
            .find_map(|(_, frame)| VendorStatus::parse(frame))
    }

    fn get(&mut self, parameter: u8) -> ParameterResponse {
        let session = self.session();
        self.sent.clear();
        self.receive(&ParameterRequest { session, parameter }.emit(self.node.number()));
        ParameterResponse::parse(&self.sent.last().expect("an answer").1).unwrap()
    }

    fn set(&mut self, parameter: u8, value: u32) -> ParameterResponse {
        let session = self.session();
        self.sent.clear();
        self.receive(
            &ParameterSet {
                session,
                parameter,
                value,
            }
            .emit(self.node.number()),
        );
        ParameterResponse::parse(&self.sent.last().expect("an answer").1).unwrap()
    }

    fn duty(&mut self, duty: i16) {
        let control = Control0 {
            mode: ModeSelect::Voltage,
            target: i32::from(duty),
            ..Control0::default()
        };
        self.receive(&control.emit(self.node.number()));
    }
}

#[test]
fn nothing_is_sent_before_a_bus_is_seen_and_any_frame_shows_one() {
    for frame in [
        Frame::standard(0x7FF, [1]),
        Frame::extended(0, []),
        Frame::remote(Frame::standard(1, []).id(), 0).unwrap(),
    ] {
        let mut bench = Bench::new();
        bench.run(1000);
        assert!(bench.sent.is_empty());
        assert_eq!(bench.node.session(), None);
        bench.receive(&frame);
        assert_ne!(bench.session(), 0);
        bench.run(20);
        assert_eq!(base(bench.sent[0].1.raw_id()), 0x0206_1400);
    }
}

#[test]
fn status_frames_come_every_10_and_100_ms() {
    let mut bench = Bench::connected();
    bench.run(2000);
    let count = |wanted| {
        bench
            .sent
            .iter()
            .filter(|(_, frame)| base(frame.raw_id()) == wanted)
            .count()
    };
    assert_eq!(
        [count(0x0206_1400), count(0x0206_1480), count(0x0206_14C0)],
        [100, 10, 10]
    );
}

#[test]
fn i2_silence_shows_on_the_wire_as_no_drive() {
    let mut bench = Bench::connected();
    bench.duty(8000);
    bench.run(1);
    assert_eq!(bench.snapshot.duty().units(), 8000);
    bench.run(208);
    assert_eq!(bench.snapshot.duty().units(), 0);
    bench.run(20);
    let status = bench.sent.iter().rev().find_map(|(_, frame)| {
        (base(frame.raw_id()) == 0x0206_1400).then(|| StatusGeneral::parse(frame))?
    });
    assert_eq!(status.unwrap().mode, ModeSelect::NoDrive);
}

#[test]
fn losing_the_bus_switches_off_counts_a_fault_and_draws_a_new_session() {
    let mut bench = Bench::connected();
    bench.duty(8000);
    bench.run(1);
    let before = bench.session();
    bench.node.on_bus_lost(bench.now);
    bench.node.on_bus_lost(bench.now);
    bench.run(1);
    assert_eq!(bench.snapshot.duty().units(), 0, "off in the same tick");
    assert_eq!(bench.node.session(), None);
    bench.sent.clear();
    bench.run(1000);
    assert!(
        bench.sent.is_empty(),
        "nobody is told anything without a bus"
    );
    // A command of the old session brings the bus back and is dropped.
    let old = VendorCommand {
        session: before,
        command: 0x61,
        param1: 0,
        param2: 0,
    };
    bench.receive(&old.emit(5));
    assert!(bench.sent.is_empty());
    assert_ne!(bench.session(), before);
    assert_eq!(
        (
            bench.get(52).value,
            bench.get(57).value,
            bench.get(51).value
        ),
        (16, 1, 0)
    );
}

#[test]
fn restarts_keep_the_session_and_are_acknowledged_without_a_bus() {
    for (command, image, code) in [
        (0xF1, ImageType::Application, CommandCode::AcknowledgeReset),
        (0xF0, ImageType::Bootloader, CommandCode::InBootloader),
    ] {
        let mut bench = Bench::connected();
        bench.set(10, 77);
        bench.run(1);
        bench.set(10, 78);
        bench.actions.clear();
        assert_eq!(
            bench.vendor(command, 0),
            None,
            "no answer before the restart"
        );
        let session = bench.session();
        let handover = Handover {
            session,
            stay_in_bootloader: command == 0xF0,
        };
        assert_eq!(
            bench.actions,
            [Action::Save, Action::Reset(handover)],
            "settings first"
        );
        let config = NodeConfig {
            image,
            handover: Some(handover),
            ..NodeConfig::dmc60c(1)
        };
        let mut after = Bench::with(&config, Some(bench.node.stored()));
        after.run(1);
        let (_, frame) = after.sent[0];
        assert_eq!(frame.extended_id(), Some(id::VENDOR_STATUS | 5));
        assert_eq!(VendorStatus::parse(&frame).unwrap().code, code as u16);
        assert_eq!(after.session(), session);
    }
}

#[test]
fn the_bootloader_tells_its_image_and_ignores_control_frames() {
    let config = NodeConfig {
        image: ImageType::Bootloader,
        ..NodeConfig::dmc60c(1)
    };
    let mut bench = Bench::with(
        &config,
        Some(Stored {
            number: 5,
            ..Stored::default()
        }),
    );
    bench.duty(8000);
    assert_eq!(bench.node.command().setpoint, Setpoint::Off);
    bench.run(1000);
    assert!(
        bench.sent.is_empty(),
        "no status frames from the bootloader"
    );
    assert_eq!(bench.vendor(0x61, 0).unwrap().byte_count, 6);
    assert_eq!(bench.sent[1].1.data(), [1, 0, 0x17, 0x01, 0x09, 0x01]);
}

#[test]
fn a_destroyed_enumeration_answer_draws_a_new_session() {
    let mut bench = Bench::connected();
    let before = bench.session();
    bench.node.on_frame(
        bench.now,
        &Frame::extended(id::ENUMERATE, []),
        &bench.snapshot,
    );
    bench.now = bench.now + Duration::from_millis(10);
    let answer = bench.node.poll_tx(bench.now, &bench.snapshot).unwrap();
    assert_eq!(answer.attempts, Attempts::AtMost(1));
    bench
        .node
        .on_transmitted(bench.now, answer.tag, TxOutcome::Failed);
    assert_ne!(bench.session(), before);
    assert_eq!(base(answer.frame.raw_id()), id::ENUMERATE_RESPONSE);
}

#[test]
fn identify_lasts_5_s() {
    let mut bench = Bench::connected();
    assert_eq!(bench.vendor(0x50, 0).unwrap().code, 0);
    let identifies = |bench: &Bench| {
        matches!(
            bench.node.indication(bench.now, &bench.snapshot),
            Indication::Identify(_)
        )
    };
    bench.run(9_999);
    assert!(identifies(&bench));
    bench.run(1);
    assert!(!identifies(&bench));
}

#[test]
fn pin_tests_are_refused_while_the_motor_is_driven() {
    let mut bench = Bench::connected();
    assert_eq!(bench.vendor(0xF3, 0), None);
    assert_eq!(bench.actions, [Action::PinTest(PinTest::Short)]);
    bench.node.pin_test_done(None);
    bench.flush();
    bench.duty(100);
    bench.run(1);
    assert_eq!(
        bench.vendor(0xF4, 0).unwrap().code,
        CommandCode::NotSupported as u16
    );
}

#[test]
fn i5_frames_for_another_device_change_nothing() {
    let mut bench = Bench::connected();
    let session = bench.session();
    let (command, settings) = (*bench.node.command(), *bench.node.settings());
    bench.sent.clear();
    let control = Control0 {
        mode: ModeSelect::Voltage,
        target: 1,
        ..Control0::default()
    };
    for number in (0..64).filter(|number| *number != 5) {
        bench.receive(&control.emit(number));
        bench.receive(
            &ParameterSet {
                session,
                parameter: 10,
                value: 1,
            }
            .emit(number),
        );
        bench.receive(
            &VendorCommand {
                session,
                command: 1,
                param1: 9,
                param2: 0,
            }
            .emit(number),
        );
    }
    bench.receive(&Frame::standard(5, [0; 8]));
    assert_eq!(
        (*bench.node.command(), *bench.node.settings()),
        (command, settings)
    );
    assert!(bench.sent.is_empty() && bench.actions.is_empty());
    assert_eq!(bench.node.number(), 5);
    assert_eq!(
        bench.node.counters().ignored,
        63 * 3 + 2,
        "all counted, with the one that connected"
    );
}

proptest! {
    /// I1 for the whole node: frames near its own identifiers in any order, with the engine running.
    #[test]
    fn i1_no_frame_panics_the_node(
        steps in proptest::collection::vec((0..12_usize, any::<[u8; 8]>(), 0..=8_usize, 0..4_u32, any::<bool>()), 1..80)
    ) {
        let mut bench = Bench::connected();
        for (kind, mut data, len, ticks, own_session) in steps {
            if own_session {
                let session = bench.node.session().unwrap_or(1);
                data[..2].copy_from_slice(&session.to_le_bytes());
            }
            let base = [
                id::ENUMERATE, id::VENDOR_COMMAND, id::VENDOR_DATA_OUT, id::PARAMETER_REQUEST,
                id::PARAMETER_SET, 0x0206_0000, 0x0206_1400, 0x1000_0000,
            ].get(kind).copied();
            match base {
                Some(base) => {
                    let number = u32::from(bench.node.number());
                    bench.receive(&Frame::extended(base | number, data).shortened(len));
                }
                None if kind == 8 => bench.node.on_bus_lost(bench.now),
                None => bench.sample.pins.set(Pin::GateDriverFault, own_session),
            }
            bench.run(ticks);
            if let Some(Action::Reset(_)) = bench.actions.last() {
                bench = Bench::connected();
            }
        }
    }
}
