//! Entries of a set: a key, and a value of up to 127 bytes.
//!
//! Two bytes (class and length, identifier) and the value. Whoever writes a set replaces the entries that
//! it owns and keeps all others as they are, so that a bootloader that knows nothing but names, or another
//! version of the firmware, loses nothing.

use embedded_storage::nor_flash::NorFlash;
use heapless::Vec;

use super::layout::{CELL, ERASED, Set, read_cell};
use crate::crc::Crc32;

/// Longest value that is read; longer ones are only kept.
pub const VALUE_CAPACITY: usize = 64;

/// Value of an entry.
pub type Value = Vec<u8, VALUE_CAPACITY>;

/// Bit of an entry's first byte: not a parameter.
const OTHER: u8 = 0x80;

/// What an entry is about.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Key {
    /// The parameter with this number.
    Parameter(u8),
    /// Something else, see the constants.
    Other(u8),
}

impl Key {
    /// Device number, one byte.
    pub const NUMBER: Self = Self::Other(1);
    /// Sticky faults, one byte as in `paramStickyFaults`.
    pub const STICKY_FAULTS: Self = Self::Other(2);
    /// Counts of the faults with bits 0 to 3, four bytes.
    pub const FAULT_COUNTS: Self = Self::Other(3);
    /// The latest crash, nine bytes: code of its cause, detail, place, low bytes first.
    pub const CRASH: Self = Self::Other(4);

    /// Smallest anti-rollback counter that the bootloader accepts, four bytes, low byte first.
    pub const ROLLBACK: Self = Self::Other(0x20);
    /// Ed25519 public key that images must be signed by, 32 bytes.
    pub const SIGNING_KEY: Self = Self::Other(0x21);

    /// One of the six strings.
    #[must_use]
    pub const fn text(which: crate::management::vendor::Descriptor) -> Self {
        Self::Other(0x10 + which as u8)
    }

    const fn bytes(self, length: u8) -> [u8; 2] {
        match self {
            Self::Parameter(id) => [length, id],
            Self::Other(id) => [length | OTHER, id],
        }
    }

    const fn read(bytes: [u8; 2]) -> (Self, u8) {
        let [first, id] = bytes;
        let length = first & !OTHER;
        match first & OTHER {
            0 => (Self::Parameter(id), length),
            _ => (Self::Other(id), length),
        }
    }
}

/// One entry.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Entry {
    /// What it is about.
    pub key: Key,
    /// Its value.
    pub value: Value,
}

/// What a writer puts into a set. Behind `dyn` wherever it is used, so that the code which writes a set exists once.
pub trait Content {
    /// True if entries with this key are the writer's: those of the set before are left out.
    fn owns(&self, key: Key) -> bool;

    /// Puts the writer's entries, the same ones in the same order each time.
    fn put(&self, sink: &mut dyn Sink);
}

/// Takes entries.
pub trait Sink {
    /// Takes one entry; a value beyond 127 bytes is cut off.
    fn entry(&mut self, key: Key, value: &[u8]);
}

/// A change of one entry; everything else stays as it is.
#[derive(Clone, Copy, Debug)]
pub struct Change<'a> {
    /// Which entry.
    pub key: Key,
    /// Its new value, or `None` to remove it.
    pub value: Option<&'a [u8]>,
}

impl Change<'_> {
    /// No change at all: a copy of the set before. It removes an entry that no set has, because a writer of its own
    /// would be another kilobyte of machine code.
    pub(super) const NONE: Self = Self {
        key: Key::Other(0),
        value: None,
    };
}

impl Content for Change<'_> {
    fn owns(&self, key: Key) -> bool {
        key == self.key
    }

    fn put(&self, sink: &mut dyn Sink) {
        if let Some(value) = self.value {
            sink.entry(self.key, value);
        }
    }
}

/// Where an entry stands in flash.
pub(super) struct Place {
    pub(super) key: Key,
    header: u32,
    length: u8,
}

impl Place {
    /// True if the value is one that is read at all.
    pub(super) fn is_readable(&self) -> bool {
        usize::from(self.length) <= VALUE_CAPACITY
    }

    /// Reads the value as far as there is room, and gives its length; `None` if the memory fails.
    pub(super) fn read<F: NorFlash>(&self, flash: &mut F, value: &mut [u8]) -> Option<usize> {
        let length = usize::from(self.length);
        let room = value.len().min(length);
        flash
            .read(self.header + 2, value.get_mut(..room)?)
            .is_ok()
            .then_some(length)
    }
}

/// Goes through the entries of a set.
pub(super) struct Walk {
    at: u32,
    end: u32,
}

impl Walk {
    pub(super) const fn new(set: &Set) -> Self {
        Self {
            at: set.entries(),
            end: set.entries() + set.length as u32,
        }
    }

    pub(super) fn next<F: NorFlash>(&mut self, flash: &mut F) -> Option<Place> {
        let mut header = [0; 2];
        if self.at + 2 > self.end || flash.read(self.at, &mut header).is_err() {
            return None;
        }
        let (key, length) = Key::read(header);
        let place = Place {
            key,
            header: self.at,
            length,
        };
        self.at += 2 + u32::from(length);
        (self.at <= self.end).then_some(place)
    }
}

/// The entries of a set, in the order in which they were put.
pub struct Entries<'f, F> {
    pub(super) flash: &'f mut F,
    walk: Option<Walk>,
}

impl<'f, F: NorFlash> Entries<'f, F> {
    pub(super) fn new(flash: &'f mut F, set: Option<&Set>) -> Self {
        Self {
            flash,
            walk: set.map(Walk::new),
        }
    }
}

impl<F: NorFlash> Iterator for Entries<'_, F> {
    type Item = Entry;

    fn next(&mut self) -> Option<Entry> {
        let walk = self.walk.as_mut()?;
        loop {
            let place = walk.next(self.flash)?;
            let mut value = Value::new();
            if value.resize(usize::from(place.length), 0).is_ok() {
                place.read(self.flash, &mut value)?;
                return Some(Entry {
                    key: place.key,
                    value,
                });
            }
        }
    }
}

/// What to do with the bytes of a set's entries.
#[derive(Clone, Copy)]
pub(super) enum Use {
    /// Only measure them, and compare them with what stands at this address.
    Measure(u32),
    /// Program them from this address on.
    Program(u32),
}

/// Takes the bytes of a set's entries one after the other.
pub(super) struct Pass<'f, F> {
    flash: &'f mut F,
    work: Use,
    cell: [u8; 8],
    /// Bytes taken so far.
    pub(super) length: u32,
    /// CRC over them.
    pub(super) crc: Crc32,
    /// Programming has succeeded, or everything compared was equal.
    pub(super) good: bool,
}

impl<'f, F: NorFlash> Pass<'f, F> {
    /// Takes the writer's entries, then those of `before` that are not the writer's.
    pub(super) fn run(
        flash: &'f mut F,
        content: &dyn Content,
        before: Option<&Set>,
        work: Use,
    ) -> Self {
        let mut pass = Self {
            flash,
            work,
            cell: ERASED,
            length: 0,
            crc: Crc32::new(),
            good: true,
        };
        content.put(&mut pass);
        if let Some(set) = before {
            let mut walk = Walk::new(set);
            while let Some(place) = walk.next(pass.flash) {
                if !content.owns(place.key) {
                    pass.keep(&place);
                }
            }
        }
        if !pass.length.is_multiple_of(CELL) {
            pass.flush();
        }
        pass
    }

    fn keep(&mut self, place: &Place) {
        for at in place.header..place.header + 2 + u32::from(place.length) {
            let mut byte = [0];
            self.good &= self.flash.read(at, &mut byte).is_ok();
            let [byte] = byte;
            self.byte(byte);
        }
    }

    fn byte(&mut self, byte: u8) {
        self.crc.push(byte);
        if let Some(place) = self.cell.get_mut((self.length % CELL) as usize) {
            *place = byte;
        }
        self.length += 1;
        if self.length.is_multiple_of(CELL) {
            self.flush();
        }
    }

    /// The cell is full, or the last one.
    fn flush(&mut self) {
        let offset = self.length.saturating_sub(1) / CELL * CELL;
        self.good = self.good
            && match self.work {
                Use::Measure(from) => read_cell(self.flash, from + offset) == Some(self.cell),
                Use::Program(from) => self.flash.write(from + offset, &self.cell).is_ok(),
            };
        self.cell = ERASED;
    }
}

impl<F: NorFlash> Sink for Pass<'_, F> {
    fn entry(&mut self, key: Key, value: &[u8]) {
        let length = value.len().min(usize::from(!OTHER));
        for byte in key.bytes(length as u8) {
            self.byte(byte);
        }
        for byte in value.iter().take(length) {
            self.byte(*byte);
        }
    }
}
