//! Flash that does not do what it is told: it reports an error, or leaves a unit as it was and says nothing.

extern crate std;

use std::boxed::Box;
use std::collections::BTreeMap;
use std::vec::Vec;

use embedded_storage::nor_flash::{ErrorType, NorFlash, NorFlashErrorKind, ReadNorFlash};

use super::image::{
    HEADER_OFFSET, Hardware, INFO_LENGTH, INFO_OFFSET, Identity, InfoBlock, LAST_PAGE, NO_VERSION,
    PAGE_SIZE, Page, pack,
};
use super::slots::{Log, RECORD_SIZE, Record, Slot, SlotError, Slots, Start, TRAILER_SIZE, boot};
use super::status::Reason;
use super::trust::Trust;
use super::updater::Updater;
use crate::crc::page_transfer;
use crate::management::vendor::CommandCode;
use crate::node::PRODUCT_DMC60C;

const UNIT: usize = 8;
const VERSION: u16 = 0x0118;

/// How programming a unit goes wrong.
#[derive(Clone, Copy, Debug)]
enum Fault {
    /// The controller reports it.
    Error,
    /// Nothing is reported, and nothing programmed.
    Stuck,
}

/// Memory that is erased in units of `E` bytes, with one unit of programming that fails so many times.
struct Memory<const E: usize> {
    bytes: Vec<u8>,
    fault: Option<(u32, Fault, u32)>,
    writes: u32,
}

impl<const E: usize> Memory<E> {
    fn new(hardware: &Hardware) -> Self {
        let pages = hardware.pages.count_ones() as usize;
        Self {
            bytes: std::vec![0xFF; pages * PAGE_SIZE + TRAILER_SIZE],
            fault: None,
            writes: 0,
        }
    }
}

impl<const E: usize> ErrorType for &mut Memory<E> {
    type Error = NorFlashErrorKind;
}

impl<const E: usize> ReadNorFlash for &mut Memory<E> {
    const READ_SIZE: usize = 1;

    fn read(&mut self, offset: u32, bytes: &mut [u8]) -> Result<(), NorFlashErrorKind> {
        bytes.copy_from_slice(&self.bytes[offset as usize..][..bytes.len()]);
        Ok(())
    }

    fn capacity(&self) -> usize {
        self.bytes.len()
    }
}

impl<const E: usize> NorFlash for &mut Memory<E> {
    const WRITE_SIZE: usize = UNIT;
    const ERASE_SIZE: usize = E;

    fn erase(&mut self, from: u32, to: u32) -> Result<(), NorFlashErrorKind> {
        self.bytes[from as usize..to as usize].fill(0xFF);
        Ok(())
    }

    fn write(&mut self, offset: u32, bytes: &[u8]) -> Result<(), NorFlashErrorKind> {
        self.writes += 1;
        if let Some((at, fault, times)) = &mut self.fault
            && *at == offset
            && *times > 0
        {
            *times -= 1;
            return match fault {
                Fault::Error => Err(NorFlashErrorKind::Other),
                Fault::Stuck => Ok(()),
            };
        }
        let place = &mut self.bytes[offset as usize..][..bytes.len()];
        assert!(place.iter().all(|byte| *byte == 0xFF), "programmed twice");
        place.copy_from_slice(bytes);
        Ok(())
    }
}

type Small = Memory<2048>;

const TRAILER: u32 = 24 * PAGE_SIZE as u32;

fn log_of(memory: &mut Small) -> Log {
    Slot::new(memory, &Hardware::G431).log()
}

/// Joins the second copy to records that have only one; tells whether there were any.
fn settles(memory: &mut Small) -> bool {
    let before = memory.writes;
    let mut slot = Slot::new(&mut *memory, &Hardware::G431);
    let mut log = slot.log();
    slot.settle(&mut log);
    memory.writes != before
}

#[test]
fn a_record_goes_to_the_next_place_if_one_refuses_or_does_not_read_back() {
    for fault in [Fault::Error, Fault::Stuck] {
        for at in (0..2 * RECORD_SIZE).step_by(UNIT) {
            let mut memory = Small::new(&Hardware::G431);
            memory.fault = Some((TRAILER + at as u32, fault, u32::MAX));
            let mut slot = Slot::new(&mut memory, &Hardware::G431);
            let mut log = slot.log();
            assert_eq!(slot.append_twice(&mut log, Record::Confirmed), Ok(()));
            assert!(log.confirmed() && log_of(&mut memory).confirmed());
            assert!(!settles(&mut memory), "{fault:?} at {at}: one copy only");
        }
    }
}

#[test]
fn a_trailer_that_takes_no_record_is_an_error_and_says_nothing() {
    let mut memory = Small::new(&Hardware::G431);
    let mut slot = Slot::new(&mut memory, &Hardware::G431);
    let mut log = slot.log();
    for _ in 0..TRAILER_SIZE / RECORD_SIZE {
        assert_eq!(slot.append(&mut log, Record::TrialFailed), Ok(()));
    }
    let full = slot.append_twice(&mut log, Record::Confirmed);
    assert_eq!(full, Err(SlotError::Full));
    assert!(!log.confirmed() && !log_of(&mut memory).confirmed());
}

#[test]
fn a_single_copy_is_joined_by_a_second_one_and_two_are_left_alone() {
    let committed = Record::Committed {
        generation: 3,
        image_crc: 7,
    };
    for record in [
        committed,
        Record::Confirmed,
        Record::UpdateBegun { generation: 4 },
    ] {
        let mut memory = Small::new(&Hardware::G431);
        let mut slot = Slot::new(&mut memory, &Hardware::G431);
        let mut log = slot.log();
        assert_eq!(slot.append(&mut log, record), Ok(()));
        assert!(settles(&mut memory), "{record:?}");
        assert!(!settles(&mut memory), "{record:?}");
        // The same record with other values is another one.
        let mut slot = Slot::new(&mut memory, &Hardware::G431);
        let mut log = slot.log();
        let other = Record::Committed {
            generation: 9,
            image_crc: 7,
        };
        assert_eq!(slot.append(&mut log, other), Ok(()));
        assert!(settles(&mut memory) && !settles(&mut memory));
        assert_eq!(log_of(&mut memory).committed(), Some((9, 7)));
    }
}

fn image(hardware: &Hardware) -> BTreeMap<u8, Box<Page>> {
    let identity = Identity {
        product: PRODUCT_DMC60C,
        hardware: hardware.id,
        version: VERSION,
        rollback: 0,
    };
    let mut first = Box::new([0x11; PAGE_SIZE]);
    first[INFO_OFFSET..][..INFO_LENGTH].copy_from_slice(&InfoBlock { identity }.to_bytes());
    let mut last = Box::new([0x22; PAGE_SIZE]);
    last[HEADER_OFFSET..].fill(0xFF);
    let mut pages = BTreeMap::from([(0, first), (1, Box::new([0x33; PAGE_SIZE]))]);
    pack(|page| pages.get(&page).map(|page| &**page), &mut last).unwrap();
    pages.insert(LAST_PAGE, last);
    pages
}

type OneSlot<'a, const E: usize> = Slots<&'a mut Memory<E>, &'a mut Memory<E>>;

fn slots<'a, const E: usize>(memory: &'a mut Memory<E>, hardware: &Hardware) -> OneSlot<'a, E> {
    Slots {
        application: Slot::new(memory, hardware),
        fallback: None,
    }
}

/// Sends pages from the last to the first until one is refused; gives its number and the result.
fn send<const E: usize>(
    updater: &mut Updater,
    slots: &mut OneSlot<'_, E>,
    hardware: &Hardware,
) -> Result<(), (u8, CommandCode)> {
    let trust = Trust {
        product: PRODUCT_DMC60C,
        hardware: hardware.id,
        rollback: 0,
        key: None,
    };
    for (number, page) in image(hardware).iter().rev() {
        updater.take(0, &page[..]);
        updater.take(PAGE_SIZE, &page_transfer(&page[..]).to_le_bytes());
        let code = updater.write(slots, &trust, *number);
        if code != CommandCode::NoError {
            return Err((*number, code));
        }
    }
    Ok(())
}

/// A unit in the middle of a page fails: always, then for a while. `offset` is that of the page in the slot.
fn update<const E: usize>(hardware: &Hardware, (page, offset): (u8, usize), retries: bool) {
    for fault in [Fault::Error, Fault::Stuck] {
        let mut memory = Memory::<E>::new(hardware);
        memory.fault = Some(((offset + 800) as u32, fault, u32::MAX));
        let mut slots_of_memory = slots(&mut memory, hardware);
        let mut updater = Updater::new([0; PAGE_SIZE]);
        updater.look(&mut slots_of_memory);
        let result = send(&mut updater, &mut slots_of_memory, hardware);
        assert_eq!(result, Err((page, CommandCode::FlashWriteFailed)));
        assert_eq!(updater.version(), NO_VERSION);
        let booted = boot(&mut slots_of_memory, &Start::POWER_ON);
        assert!(booted.start.is_err(), "a page is missing: {booted:?}");
        assert_ne!(booted.start, Err(Reason::ImageDamaged));
        // The flash works again: from page 30 on.
        memory.fault = None;
        let mut slots_of_memory = slots(&mut memory, hardware);
        let mut updater = Updater::new([0; PAGE_SIZE]);
        updater.look(&mut slots_of_memory);
        let result = send(&mut updater, &mut slots_of_memory, hardware);
        assert_eq!(result, Ok(()));
        assert_eq!(updater.version(), VERSION);
        assert!(boot(&mut slots_of_memory, &Start::POWER_ON).start.is_ok());

        let mut memory = Memory::<E>::new(hardware);
        memory.fault = Some(((offset + 800) as u32, fault, 5));
        let mut slots_of_memory = slots(&mut memory, hardware);
        let mut updater = Updater::new([0; PAGE_SIZE]);
        updater.look(&mut slots_of_memory);
        let result = send(&mut updater, &mut slots_of_memory, hardware);
        assert_eq!(result.is_ok(), retries, "five failures, six attempts");
    }
}

#[test]
fn a_page_that_cannot_be_programmed_is_refused_and_never_started() {
    let last = 23 * PAGE_SIZE;
    update::<2048>(&Hardware::G431, (1, PAGE_SIZE), true);
    update::<2048>(&Hardware::G431, (LAST_PAGE, last), true);
    // One erase unit: only page 30 can be tried again, because only it erases.
    update::<0x2_0000>(&Hardware::F405, (1, PAGE_SIZE), false);
    update::<0x2_0000>(&Hardware::F405, (LAST_PAGE, 30 * PAGE_SIZE), true);
}
