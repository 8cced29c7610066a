//! The settings journal: complete sets, one after the other, in a ring of flash erase units.
//!
//! A set is a header, entries (see [`Content`]) and a seal. The newest whole set is the one in force; a
//! save that is cut anywhere leaves the set before in force, or the new one. Which of them was decided by
//! [`Journal::open`] stays decided, even if bits in flash read differently later. `docs/settings.md`
//! describes the format and gives the argument.
//!
//! The journal holds no flash: each call takes it, and it must be the same region each time. It works on
//! any [`NorFlash`] of at least two erase units whose program units are 1, 2, 4 or 8 bytes, and programs
//! each of them once between two erases.

mod crash;
mod entries;
mod layout;
mod stored;
#[cfg(test)]
mod tests;

use embedded_storage::nor_flash::NorFlash;

pub use crash::Crash;
pub use entries::{Change, Content, Entries, Entry, Key, Sink, VALUE_CAPACITY, Value};
use entries::{Pass, Use, Walk};
use layout::{CELL, Contents, SEAL, Set, UNIT_HEADER, generation_cell, newer, read_cell};

/// Format of the entries that this firmware writes. Header and CRC of a set are the same in all formats.
pub const FORMAT: u16 = 1;

/// How often [`Journal::open`] tries to settle what a cut has left.
const SETTLING_ATTEMPTS: u32 = 8;

/// How often a save is tried at another place if the memory refuses.
const WRITE_ATTEMPTS: u32 = 4;

/// Why a set was not written. The set before stays in force.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum SaveError {
    /// There is no room without erasing, which is not allowed at present.
    EraseDue,
    /// What is stored is of a newer format, which this firmware does not destroy.
    NewerFormat,
    /// The set is larger than the memory can hold safely.
    TooLarge,
    /// The memory failed.
    Memory,
}

/// A set that was written, or that was found to be written already.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Saved {
    /// Number of the save that the set in force comes from.
    pub sequence: u32,
    /// False if nothing had changed, so that nothing was written.
    pub written: bool,
}

/// Is a set written that is equal to the one before?
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Repeat {
    /// No: every set is a save of its own.
    Never,
    /// Yes, as a copy of that set under the same number.
    Always,
}

/// Where sets can be appended.
#[derive(Clone, Copy, Debug)]
struct Place {
    /// Address of the erase unit.
    unit: u32,
    /// Generation of the sets that go there.
    generation: u32,
    /// First free address; the end of the unit if nothing can be appended.
    end: u32,
    /// Something was begun here that may be a set.
    touched: bool,
}

/// The state of the journal in a flash region.
#[derive(Clone, Copy, Debug)]
pub struct Journal {
    newest: Option<Set>,
    /// The unit of the newest set.
    active: Place,
    /// The unit after it in the ring.
    next: Place,
}

impl Journal {
    /// Finds the set in force.
    ///
    /// If a save or an erase was cut, this writes a copy of that set before it returns: what was begun
    /// can then never come into force later. That may take an erase, so that this is for the time before
    /// the drive starts.
    #[must_use]
    #[inline(never)]
    pub fn open<F: NorFlash>(flash: &mut F) -> Self {
        for _ in 0..SETTLING_ATTEMPTS {
            let mut journal = Self::find(flash);
            if journal.is_settled(flash)
                || journal
                    .append(flash, &Change::NONE, Repeat::Always, true)
                    .is_ok()
            {
                return journal;
            }
        }
        Self::find(flash)
    }

    /// True if nothing that reads differently next time can change which set is in force.
    fn is_settled<F: NorFlash>(&self, flash: &mut F) -> bool {
        let newest_is_last = match &self.newest {
            Some(set) if set.format > FORMAT => return true,
            Some(set) => set.is_sealed(flash) && self.active.end <= set.end(),
            None => true,
        };
        newest_is_last && !self.next.touched
    }

    fn find<F: NorFlash>(flash: &mut F) -> Self {
        let size = F::ERASE_SIZE as u32;
        let capacity = flash.capacity() as u32 / size * size;
        let last = capacity.saturating_sub(size);
        // Without any set, the ring begins as if its last unit were full.
        let (mut newest, mut unit, mut end) = (None, last, capacity);
        for start in (0..capacity).step_by(F::ERASE_SIZE) {
            let contents = Contents::read(flash, start, start + size);
            if contents.newest.is_some() && newer(newest, contents.newest) != newest {
                (newest, unit, end) = (contents.newest, start, contents.end);
            }
        }
        let generation = newest.map_or(0, |set| set.generation);
        Self {
            newest,
            active: Place::look(flash, unit, generation, Some(end)),
            next: Place::after(flash, unit, generation),
        }
    }

    /// Saves of the settings so far (`vcmdGetFlashSeqnum`).
    #[must_use]
    pub fn sequence(&self) -> u32 {
        self.newest.map_or(0, |set| set.sequence)
    }

    /// True if what is stored is of a newer format: it is not read, and nothing is written.
    #[must_use]
    pub fn is_newer_format(&self) -> bool {
        self.newest.is_some_and(|set| set.format > FORMAT)
    }

    /// The entries of the set in force; none if nothing was stored or if its format is newer.
    pub fn entries<'f, F: NorFlash>(&self, flash: &'f mut F) -> Entries<'f, F> {
        Entries::new(flash, self.readable())
    }

    fn readable(&self) -> Option<&Set> {
        self.newest.as_ref().filter(|set| set.format <= FORMAT)
    }

    /// The value of one entry.
    pub fn get<F: NorFlash>(&self, flash: &mut F, key: Key) -> Option<Value> {
        self.entries(flash)
            .find(|entry| entry.key == key)
            .map(|entry| entry.value)
    }

    /// Reads the value of one entry as far as `value` has room for it, and gives the length that is stored, at most
    /// [`VALUE_CAPACITY`]. What lies beyond the length is left alone.
    // For a bootloader, which reads the few entries that it knows: `get` takes more stack and code, but shares them with
    // `entries`. Not inlined, because there are several callers.
    #[inline(never)]
    pub fn read<F: NorFlash>(&self, flash: &mut F, key: Key, value: &mut [u8]) -> Option<usize> {
        let mut walk = Walk::new(self.readable()?);
        loop {
            let place = walk.next(flash)?;
            if place.key == key && place.is_readable() {
                return place.read(flash, value);
            }
        }
    }

    /// Writes a set with the writer's entries and, from the set before, those that are not the writer's.
    /// Nothing is written if it would be equal to the set before.
    ///
    /// # Errors
    /// See [`SaveError`]. [`SaveError::EraseDue`] only if `may_erase` is false; the same call may then
    /// succeed later.
    pub fn save<F: NorFlash>(
        &mut self,
        flash: &mut F,
        content: &dyn Content,
        may_erase: bool,
    ) -> Result<Saved, SaveError> {
        if self.is_newer_format() {
            return Err(SaveError::NewerFormat);
        }
        let mut result = Err(SaveError::Memory);
        for _ in 0..WRITE_ATTEMPTS {
            result = self.append(flash, content, Repeat::Never, may_erase);
            if result != Err(SaveError::Memory) {
                break;
            }
        }
        result
    }

    /// Writes one set. If the memory fails, what was touched is not used again.
    fn append<F: NorFlash>(
        &mut self,
        flash: &mut F,
        content: &dyn Content,
        repeat: Repeat,
        may_erase: bool,
    ) -> Result<Saved, SaveError> {
        const { assert!((CELL as usize).is_multiple_of(F::WRITE_SIZE) && F::READ_SIZE == 1) };
        let before = self.newest;
        let compared = before.map_or(0, |set| set.entries());
        let measured = Pass::run(flash, content, before.as_ref(), Use::Measure(compared));
        let (crc, length, equal) = (measured.crc, measured.length, measured.good);
        let equal = equal && before.is_some_and(|set| u32::from(set.length) == length);
        if equal && repeat == Repeat::Never {
            return Ok(Saved {
                sequence: self.sequence(),
                written: false,
            });
        }
        // An unsealed set may read differently each time: what was read now must be what was meant.
        let reads_as_meant = before.is_none_or(|set| set.finish_crc(crc) == set.crc);
        if repeat == Repeat::Always && !reads_as_meant {
            return Err(SaveError::Memory);
        }
        let length = u16::try_from(length).map_err(|_| SaveError::TooLarge)?;
        let moves = self.make_room(flash, Set::extent_of(length), may_erase)?;
        let place = if moves {
            &mut self.next
        } else {
            &mut self.active
        };
        let mut set = Set {
            address: place.end,
            format: FORMAT,
            length,
            generation: place.generation,
            sequence: before.map_or(0, |set| set.sequence),
            crc: 0,
        };
        if repeat == Repeat::Never {
            set.sequence = set.sequence.wrapping_add(1);
        }
        set.crc = set.finish_crc(crc);
        // If the memory refuses the first cell, which an interrupted save may have touched, the one after
        // it will do. Later failures leave the whole place unused.
        place.end += CELL;
        set.write_magic(flash).map_err(|_| SaveError::Memory)?;
        place.end = set.end();
        set.write_header(flash).map_err(|_| SaveError::Memory)?;
        let work = Use::Program(set.entries());
        let programmed = Pass::run(flash, content, before.as_ref(), work).good;
        if !programmed || !set.reads_back(flash) {
            return Err(SaveError::Memory);
        }
        set.write_seal(flash).map_err(|_| SaveError::Memory)?;
        self.newest = Some(set);
        if moves {
            self.active = self.next;
            self.next = Place::after(flash, self.active.unit, self.active.generation);
        }
        Ok(Saved {
            sequence: set.sequence,
            written: true,
        })
    }

    /// Makes sure that there is room for `extent` bytes; true if it is in the next unit.
    fn make_room<F: NorFlash>(
        &mut self,
        flash: &mut F,
        extent: u32,
        may_erase: bool,
    ) -> Result<bool, SaveError> {
        if self.active.room::<F>() >= extent {
            return Ok(false);
        }
        // With two units, the unit of the newest set also holds the one before: the other unit can
        // then be erased at any time.
        let usable = F::ERASE_SIZE as u32 - UNIT_HEADER;
        let two = flash.capacity() / F::ERASE_SIZE <= 2;
        if extent > if two { usable / 2 } else { usable } || self.is_too_small() {
            return Err(SaveError::TooLarge);
        }
        if self.next.room::<F>() < extent {
            if !may_erase {
                return Err(SaveError::EraseDue);
            }
            self.next.erase(flash).map_err(|_| SaveError::Memory)?;
            // A memory that fails without a word has left it as it was.
            if self.next.room::<F>() < extent {
                return Err(SaveError::Memory);
            }
        }
        Ok(true)
    }

    /// True if a unit can be erased in advance, so that a later save need not wait for it.
    #[must_use]
    pub fn wants_erase<F: NorFlash>(&self) -> bool {
        !self.is_newer_format() && !self.is_too_small() && self.next.room::<F>() == 0
    }

    /// Erases the next unit in advance.
    ///
    /// # Errors
    /// [`SaveError::Memory`], or another one if nothing can be written at all.
    pub fn erase_next<F: NorFlash>(&mut self, flash: &mut F) -> Result<(), SaveError> {
        if self.is_newer_format() {
            return Err(SaveError::NewerFormat);
        }
        if self.is_too_small() {
            return Err(SaveError::TooLarge);
        }
        self.next.erase(flash).map_err(|_| SaveError::Memory)
    }

    /// True if there is one erase unit only, which a journal can not use.
    const fn is_too_small(&self) -> bool {
        self.next.unit == self.active.unit
    }

    /// True if a set somewhat larger than the one in force can be saved without erasing.
    #[must_use]
    pub fn has_room<F: NorFlash>(&self) -> bool {
        let extent = Set::extent_of(self.newest.map_or(0, |set| set.length)) + USUAL_GROWTH;
        self.active.room::<F>() >= extent || self.next.room::<F>() >= extent
    }
}

/// What [`Journal::has_room`] allows a set to grow by: more than the longest string.
const USUAL_GROWTH: u32 = 128;

impl Place {
    const fn limit<F: NorFlash>(&self) -> u32 {
        self.unit + F::ERASE_SIZE as u32
    }

    const fn room<F: NorFlash>(&self) -> u32 {
        self.limit::<F>().saturating_sub(self.end)
    }

    /// What can be appended to a unit as part of `generation`; its sets end at `end`, if that is known already.
    ///
    /// Only a unit whose header is whole is known to be erased where it reads so. The header's first cell
    /// alone tells that sets of this generation may have been begun.
    #[inline(never)]
    fn look<F: NorFlash>(flash: &mut F, unit: u32, generation: u32, end: Option<u32>) -> Self {
        let limit = unit + F::ERASE_SIZE as u32;
        let mut place = Self {
            unit,
            generation,
            end: limit,
            touched: false,
        };
        if read_cell(flash, unit) == Some(generation_cell(generation)) {
            let end = end.unwrap_or_else(|| Contents::read(flash, unit, limit).end);
            place.touched = end > unit + UNIT_HEADER;
            if read_cell(flash, unit + CELL) == Some(SEAL) {
                place.end = end;
            }
        }
        place
    }

    /// The place after a unit in the ring.
    fn after<F: NorFlash>(flash: &mut F, unit: u32, generation: u32) -> Self {
        let following = unit + F::ERASE_SIZE as u32;
        let fits = following + F::ERASE_SIZE as u32 <= flash.capacity() as u32;
        let generation = generation.wrapping_add(1);
        Self::look(flash, if fits { following } else { 0 }, generation, None)
    }

    /// Erases the unit and writes its header, the seal last: it is only there if the erase is complete.
    fn erase<F: NorFlash>(&mut self, flash: &mut F) -> Result<(), F::Error> {
        let limit = self.limit::<F>();
        self.end = limit;
        flash.erase(self.unit, limit)?;
        flash.write(self.unit, &generation_cell(self.generation))?;
        flash.write(self.unit + CELL, &SEAL)?;
        // A unit that did not become erased is left alone until it is erased again.
        *self = Self::look(flash, self.unit, self.generation, None);
        if self.touched {
            self.end = limit;
        }
        Ok(())
    }
}
