//! Any contents of the settings memory: opening the journal never panics, what is loaded is allowed by the
//! table of parameters, and a save afterwards is in force.
//!
//! Input: first byte, what to do; then records of four bytes that edit a memory which holds a few sets
//! (address, value), or the contents themselves.
#![no_main]

use embedded_storage::nor_flash::{ErrorType, NorFlash, NorFlashErrorKind, ReadNorFlash};
use libfuzzer_sys::fuzz_target;
use windlass_core::crc::iso_hdlc;
use windlass_core::params::Stored;
use windlass_core::params::journal::{Change, Journal, Key};
use windlass_core::params::table::{ParameterId, TABLE};

const UNIT: usize = 1024;
const SIZE: usize = 3 * UNIT;

/// Flash whose cells can be programmed at any time: what it holds may look erased by chance only.
struct Memory {
    bytes: Vec<u8>,
}

impl ErrorType for Memory {
    type Error = NorFlashErrorKind;
}

impl ReadNorFlash for Memory {
    const READ_SIZE: usize = 1;

    fn read(&mut self, offset: u32, bytes: &mut [u8]) -> Result<(), NorFlashErrorKind> {
        let from = offset as usize;
        let part = self.bytes.get(from..from + bytes.len()).ok_or(NorFlashErrorKind::OutOfBounds)?;
        bytes.copy_from_slice(part);
        Ok(())
    }

    fn capacity(&self) -> usize {
        self.bytes.len()
    }
}

impl NorFlash for Memory {
    const WRITE_SIZE: usize = 4;
    const ERASE_SIZE: usize = UNIT;

    fn erase(&mut self, from: u32, to: u32) -> Result<(), NorFlashErrorKind> {
        assert!(from as usize % UNIT == 0 && to as usize % UNIT == 0);
        self.bytes[from as usize..to as usize].fill(0xFF);
        Ok(())
    }

    fn write(&mut self, offset: u32, bytes: &[u8]) -> Result<(), NorFlashErrorKind> {
        assert!(offset as usize % 4 == 0 && bytes.len() % 4 == 0);
        let part = &mut self.bytes[offset as usize..offset as usize + bytes.len()];
        assert!(part.iter().all(|byte| *byte == 0xFF), "programmed twice");
        part.copy_from_slice(bytes);
        Ok(())
    }
}

/// Corrects the CRC of the set at `at`, so that what is in it is looked at.
fn mend(bytes: &mut [u8], at: usize) -> Option<()> {
    let length = usize::from(u16::from_le_bytes(bytes.get(at + 8..at + 10)?.try_into().ok()?));
    let mut covered = bytes.get(at + 24..at + 24 + length)?.to_vec();
    covered.extend((at as u32).to_le_bytes());
    covered.extend(bytes.get(at + 8..at + 20)?);
    bytes.get_mut(at + 20..at + 24)?.copy_from_slice(&iso_hdlc(&covered).to_le_bytes());
    Some(())
}

fuzz_target!(|input: &[u8]| {
    let Some((what, rest)) = input.split_first() else { return };
    // With corrected CRCs a set may claim to be newer than all that can ever be written.
    let mends = what & 2 != 0;
    let mut memory = Memory { bytes: vec![0xFF; SIZE] };
    if what & 1 == 0 {
        let mut journal = Journal::open(&mut memory);
        for number in 1..=what >> 4 {
            let value = [number; 40];
            let key = if number % 2 == 0 { Key::NUMBER } else { Key::Other(0x40) };
            journal.save(&mut memory, &Change { key, value: Some(&value[..usize::from(number)]) }, true).unwrap();
        }
        for edit in rest.chunks_exact(4) {
            let at = usize::from(u16::from_le_bytes([edit[0], edit[1]])) % SIZE;
            if !mends || edit[3] & 1 == 0 {
                memory.bytes[at] = edit[2];
            } else {
                mend(&mut memory.bytes, at & !7);
            }
        }
    } else {
        for (byte, value) in memory.bytes.iter_mut().zip(rest) {
            *byte = *value;
        }
        if mends {
            mend(&mut memory.bytes, 16);
        }
    }
    let mut journal = Journal::open(&mut memory);
    let mut stored = Stored::load(&journal, &mut memory);
    assert!(stored.number <= 63);
    for row in &TABLE {
        assert!(row.kind.allows(stored.params.get(row.id)), "{}", row.name);
    }
    assert!(journal.entries(&mut memory).count() <= SIZE / 2);
    let gain = stored.params.get(ParameterId::Slot0P) ^ 1;
    stored.params.set(ParameterId::Slot0P, gain).unwrap();
    if journal.save(&mut memory, &stored, true).is_ok() && !mends {
        let again = Journal::open(&mut memory);
        assert_eq!(Stored::load(&again, &mut memory).params.get(ParameterId::Slot0P), gain);
    }
});
