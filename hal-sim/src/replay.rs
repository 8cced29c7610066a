//! Bit-exactness: a fingerprint of everything the engine decided, and the record to repeat it.

use windlass_core::engine::command::{Command, Neutral};
use windlass_core::engine::snapshot::{Actuation, Sample, Snapshot};
use windlass_core::engine::{Engine, Settings};

/// Everything that went into one tick.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct TickRecord {
    /// The engine was new at this tick (power-on or restart).
    pub fresh: bool,
    /// Settings in force.
    pub settings: Settings,
    /// What was measured.
    pub sample: Sample,
    /// What was commanded.
    pub command: Command,
}

/// Fingerprint of an actuation stream: FNV-1a over 64-bit words, three for each tick.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) struct ActuationHash(u64);

impl ActuationHash {
    /// Offset basis and prime of 64-bit FNV (Fowler, Noll, Vo).
    pub(crate) const fn new() -> Self {
        Self(0xCBF2_9CE4_8422_2325)
    }

    fn word(&mut self, word: u64) {
        self.0 = (self.0 ^ word).wrapping_mul(0x0000_0100_0000_01B3);
        // A multiplication moves differences upwards only; whole words need them back at the bottom.
        self.0 ^= self.0 >> 32;
    }

    /// Takes the result of one tick: actuation, neutral, mode, state, faults, error, position, velocity.
    pub(crate) fn update(&mut self, snapshot: &Snapshot) {
        let (kind, duty) = match snapshot.actuation {
            Actuation::Off => (0, 0),
            Actuation::Brake => (1, 0),
            Actuation::Drive(duty) => (2, duty.units()),
        };
        let pair = |high: u32, low: u32| u64::from(high) << 32 | u64::from(low);
        let flags = u32::from(snapshot.faults.bits())
            | (snapshot.mode as u32) << 8
            | (snapshot.state as u32) << 12
            | u32::from(snapshot.neutral == Neutral::Coast) << 16
            | u32::from(snapshot.current_limited) << 17
            | kind << 18;
        self.word(pair(flags, duty as u16 as u32));
        self.word(pair(snapshot.error as u32, snapshot.position as u32));
        self.word(pair(
            snapshot.velocity as u32,
            snapshot.current.to_bits() as u32,
        ));
    }

    pub(crate) const fn value(self) -> u64 {
        self.0
    }
}

/// Runs a record through a new engine and gives the hash of what it decides: the value of
/// [`World::actuation_hash`](crate::World::actuation_hash) if the record holds every tick since the node
/// was added.
#[must_use]
pub fn replay(records: &[TickRecord]) -> u64 {
    let mut engine = Engine::new();
    let mut hash = ActuationHash::new();
    for record in records {
        if record.fresh {
            engine = Engine::new();
        }
        let snapshot = engine.tick(&record.settings, &record.sample, &record.command);
        hash.update(snapshot);
    }
    hash.value()
}

#[cfg(test)]
mod tests {
    use super::*;
    use windlass_core::units::Duty;

    fn hash(actuations: &[Actuation]) -> u64 {
        let mut hash = ActuationHash::new();
        for actuation in actuations {
            hash.update(&Snapshot {
                actuation: *actuation,
                ..Snapshot::default()
            });
        }
        hash.value()
    }

    #[test]
    fn every_difference_and_every_order_shows() {
        let drive = |units| Actuation::Drive(Duty::new(units));
        let streams = [
            vec![Actuation::Off, Actuation::Brake],
            vec![Actuation::Brake, Actuation::Off],
            vec![Actuation::Off],
            vec![drive(1)],
            vec![drive(-1)],
            vec![drive(1), drive(1)],
        ];
        let mut seen: Vec<u64> = streams.iter().map(|stream| hash(stream)).collect();
        seen.sort_unstable();
        seen.dedup();
        assert_eq!(seen.len(), streams.len());
    }
}
