//! The memory cells of one region: what complete and interrupted operations leave in them.

use std::collections::BTreeMap;

use super::NorError;
use crate::random::Random;

/// Largest program unit in bytes.
const LARGEST_UNIT: usize = 8;

/// What has happened to a program unit since it was erased.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Unit {
    Erased,
    Programmed,
    /// An operation on it was interrupted.
    Torn,
}

/// A unit that an interrupted operation has left.
#[derive(Clone, Copy, Debug)]
struct Torn {
    /// Bits that are neither 0 nor 1.
    unstable: u64,
    /// What they read as at present.
    reads: u64,
    /// They change with every read, else with every power-on.
    restless: bool,
    /// The error-correcting code can not mend the unit.
    unreadable: bool,
    /// What was to be programmed; `None` after an interrupted erase.
    intended: Option<u64>,
}

/// May a unit be programmed?
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum May {
    Yes,
    /// Over another value whose programming was interrupted and of which nothing is to be seen.
    Over,
    /// It is not erased, but has been seen so.
    No,
    Misuse,
}

/// The cells of one region.
#[derive(Clone, Debug)]
pub(super) struct Cells {
    bytes: Vec<u8>,
    units: Vec<Unit>,
    torn: BTreeMap<usize, Torn>,
    erases: Vec<u32>,
    unit_size: usize,
    erase_size: usize,
}

fn word(bytes: &[u8]) -> u64 {
    let mut whole = [0xFF; LARGEST_UNIT];
    whole[..bytes.len()].copy_from_slice(bytes);
    u64::from_le_bytes(whole)
}

/// Each bit set with a probability of `eighths` / 8.
fn sprinkle(random: &mut Random, eighths: u64) -> u64 {
    (0..64).fold(0, |bits, at| {
        bits | u64::from(random.below(8) < eighths) << at
    })
}

impl Cells {
    /// Erased cells.
    pub(super) fn new(capacity: usize, unit_size: usize, erase_size: usize) -> Self {
        Self {
            bytes: vec![0xFF; capacity],
            units: vec![Unit::Erased; capacity / unit_size],
            torn: BTreeMap::new(),
            erases: vec![0; capacity / erase_size],
            unit_size,
            erase_size,
        }
    }

    pub(super) fn erases(&self) -> &[u32] {
        &self.erases
    }

    /// Unstable bits fall one way or the other.
    pub(super) fn power_on(&mut self, random: &mut Random) {
        for torn in self.torn.values_mut() {
            torn.reads = random.next();
        }
    }

    pub(super) fn read(
        &mut self,
        from: usize,
        bytes: &mut [u8],
        random: &mut Random,
    ) -> Result<(), NorError> {
        let end = from + bytes.len();
        bytes.copy_from_slice(&self.bytes[from..end]);
        if self.torn.is_empty() {
            return Ok(());
        }
        let units = from / self.unit_size..end.div_ceil(self.unit_size);
        for (unit, torn) in self.torn.range_mut(units) {
            if torn.unreadable {
                return Err(NorError::Uncorrectable);
            }
            if torn.restless {
                torn.reads = random.next();
            }
            let (unstable, reads) = (torn.unstable.to_le_bytes(), torn.reads.to_le_bytes());
            for at in 0..self.unit_size {
                let address = unit * self.unit_size + at;
                if (from..end).contains(&address) {
                    let byte = &mut bytes[address - from];
                    *byte = *byte & !unstable[at] | reads[at] & unstable[at];
                }
            }
        }
        Ok(())
    }

    pub(super) fn may_program(&mut self, at: usize, data: &[u8], random: &mut Random) -> May {
        let unit = at / self.unit_size;
        let Some(&torn) = self.torn.get(&unit) else {
            return match self.units[unit] {
                Unit::Erased => May::Yes,
                Unit::Programmed | Unit::Torn => May::Misuse,
            };
        };
        let Some(intended) = torn.intended else {
            return May::Misuse;
        };
        let mut present = [0xFF; LARGEST_UNIT];
        let reads_erased = self
            .read(at, &mut present[..self.unit_size], random)
            .is_ok_and(|()| present == [0xFF; LARGEST_UNIT]);
        let may_read_erased = torn.restless
            && !torn.unreadable
            && word(&self.bytes[at..at + self.unit_size]) | torn.unstable == u64::MAX;
        match (reads_erased, intended == word(data)) {
            (true, true) => May::Yes,
            (true, false) => May::Over,
            (false, _) if may_read_erased => May::No,
            (false, _) => May::Misuse,
        }
    }

    pub(super) fn program(&mut self, at: usize, data: &[u8]) {
        self.bytes[at..at + self.unit_size].copy_from_slice(data);
        self.units[at / self.unit_size] = Unit::Programmed;
        self.torn.remove(&(at / self.unit_size));
    }

    /// Programs over an interrupted unit: a bit that is to stay 1 stays as unstable as it was.
    pub(super) fn program_over(&mut self, at: usize, data: &[u8]) {
        let unit = at / self.unit_size;
        self.bytes[at..at + self.unit_size].copy_from_slice(data);
        if let Some(torn) = self.torn.get_mut(&unit) {
            torn.unstable &= word(data);
            torn.intended = Some(word(data));
        }
    }

    /// Programming was interrupted: each bit that was to become 0 has, or has not, or is unstable. A cut
    /// at the very beginning leaves all of them 1 or unstable, one at the very end all 0 or unstable.
    pub(super) fn tear_program(
        &mut self,
        at: usize,
        data: &[u8],
        unreadable: bool,
        random: &mut Random,
    ) {
        let intended = word(data);
        let changing = !intended;
        let done = match random.below(4) {
            0 => 0,
            1 => u64::MAX,
            _ => sprinkle(random, 4),
        };
        let unstable = changing
            & match random.below(4) {
                0 => 0,
                // One bit or two of a byte.
                1 => sprinkle(random, 1) & (0x1F << random.below(64)),
                eighths => sprinkle(random, eighths),
            };
        // What an earlier interruption has left in bits that are not to change.
        let left = self.torn.get(&(at / self.unit_size));
        let unstable = unstable | left.map_or(0, |torn| torn.unstable & intended);
        let present = !(changing & done);
        self.bytes[at..at + self.unit_size]
            .copy_from_slice(&present.to_le_bytes()[..self.unit_size]);
        self.tear(at / self.unit_size, unstable, unreadable, random);
        if let Some(torn) = self.torn.get_mut(&(at / self.unit_size)) {
            torn.intended = Some(intended);
        }
    }

    fn tear(&mut self, unit: usize, unstable: u64, unreadable: bool, random: &mut Random) {
        self.units[unit] = Unit::Torn;
        self.torn.insert(
            unit,
            Torn {
                unstable,
                reads: random.next(),
                restless: random.below(2) == 0,
                unreadable: unreadable && random.below(8) == 0,
                intended: None,
            },
        );
    }

    fn erase_unit(&mut self, at: usize) -> (std::ops::Range<usize>, std::ops::Range<usize>) {
        self.erases[at / self.erase_size] += 1;
        let bytes = at..at + self.erase_size;
        let units = at / self.unit_size..(at + self.erase_size) / self.unit_size;
        (bytes, units)
    }

    pub(super) fn erase(&mut self, at: usize) {
        let (bytes, units) = self.erase_unit(at);
        self.bytes[bytes].fill(0xFF);
        self.torn.retain(|unit, _| !units.contains(unit));
        self.units[units].fill(Unit::Erased);
    }

    /// Erasing was interrupted. It goes through the cells' phases: first all are driven towards 0, then
    /// towards 1; at the end all read 1 while some would not keep it.
    pub(super) fn tear_erase(&mut self, at: usize, unreadable: bool, random: &mut Random) {
        let (_, units) = self.erase_unit(at);
        let phase = random.below(4);
        let progress = 1 + random.below(7);
        let unstable_eighths = random.below(4);
        for unit in units {
            let from = unit * self.unit_size;
            let bytes = &mut self.bytes[from..from + self.unit_size];
            let present = word(bytes);
            let left = match phase {
                0 => present & !sprinkle(random, progress),
                1 => sprinkle(random, progress),
                2 => present | sprinkle(random, progress),
                _ => u64::MAX,
            };
            bytes.copy_from_slice(&left.to_le_bytes()[..bytes.len()]);
            let unstable = sprinkle(random, unstable_eighths);
            self.tear(unit, unstable, unreadable, random);
        }
    }
}
