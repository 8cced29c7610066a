//! Any sequence of frames at a running controller, whatever dialect drives it.

use windlass_core::dialect::DialectKind;
use windlass_core::engine::Engine;
use windlass_core::engine::snapshot::{DriveState, Pin, Sample, Snapshot};
use windlass_core::frame::Frame;
use windlass_core::node::{Action, Node, NodeConfig, TxOutcome};
use windlass_core::params::Stored;
use windlass_core::params::journal::{SaveError, Saved};
use windlass_core::params::table::ParameterId;
use windlass_core::time::{Instant, TICK};

/// Runs the records of `input` (11 bytes each: kind, length, ticks, eight data bytes). `bases` are the base
/// identifiers that the kinds choose from; 0 takes any identifier from the data. `unsolicited`: the dialect
/// reports before it has seen a bus.
pub fn run(input: &[u8], dialect: DialectKind, bases: &[u32; 8], unsolicited: bool) {
    let config = NodeConfig::dmc60c(1);
    let mut stored = Stored::default();
    stored.params.set(ParameterId::Dialect, dialect.code()).unwrap();
    let mut node = Node::new(Instant::ZERO, &config, Some(&stored));
    let mut engine = Engine::new();
    let mut sample = Sample { current: 2048, bus_voltage: 1354, temperature: 931, ..Sample::default() };
    let mut snapshot = Snapshot::default();
    let mut now = Instant::ZERO;
    for record in input.chunks_exact(11) {
        let (kind, length, ticks) = (record[0], usize::from(record[1] % 9), record[2] % 8);
        let mut data = [0; 8];
        data.copy_from_slice(&record[3..]);
        if kind & 0x40 != 0 {
            let session = node.session().unwrap_or(1);
            data[..2].copy_from_slice(&session.to_le_bytes());
        }
        let base = bases[usize::from(kind) & 7];
        let number = u32::from(if kind & 0x20 != 0 { data[7] & 0x3F } else { node.number() });
        let raw = if base == 0 { u32::from_le_bytes([data[0], data[1], data[2], data[3]]) } else { base | number };
        let frame = match kind & 0x18 {
            0x18 => Frame::standard(raw as u16, data).shortened(length),
            _ if base == 0 && kind & 0x10 != 0 => {
                node.on_bus_lost(now);
                continue;
            }
            _ => Frame::extended(raw, data).shortened(length),
        };
        sample.pins.set(Pin::GateDriverFault, kind & 0x80 != 0 && data[7] == 0xA5);
        sample.encoder = sample.encoder.wrapping_add(u32::from(data[6]));
        node.on_frame(now, &frame, &snapshot);
        for _ in 0..ticks {
            now = now + TICK;
            let (settings, command) = (*node.settings(), *node.command());
            snapshot = *engine.tick(&settings, &sample, &command);
            node.poll(now, &snapshot);
            if !snapshot.faults.intersection(settings.policy.stopping).is_empty() || snapshot.state != DriveState::Running {
                assert_eq!(snapshot.duty().units(), 0);
            }
            while let Some(transmission) = node.poll_tx(now, &snapshot) {
                assert!(unsolicited || node.session().is_some());
                let outcome = if data[5] == 0x5A { TxOutcome::Failed } else { TxOutcome::Sent };
                node.on_transmitted(now, transmission.tag, outcome);
            }
            match node.take_action() {
                Some(Action::Save) => {
                    let result = match data[4] & 7 {
                        0 => Err(SaveError::EraseDue),
                        1 => Err(SaveError::Memory),
                        2 => Err(SaveError::NewerFormat),
                        _ => Ok(Saved { sequence: node.stored().sequence, written: true }),
                    };
                    node.save_ended(now, result);
                }
                Some(Action::Reset(_)) => {
                    let mut stored = node.stored();
                    stored.params.set(ParameterId::Dialect, dialect.code()).unwrap();
                    node = Node::new(now, &config, Some(&stored));
                    engine = Engine::new();
                }
                Some(Action::Confirm | Action::Healthy) => {}
                Some(Action::PinTest(_)) => node.pin_test_done(None),
                None => {}
            }
        }
    }
}
