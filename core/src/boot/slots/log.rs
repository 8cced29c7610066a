//! The trailer of a slot: a log of records, appended and never changed.
//!
//! A record has a place of 32 bytes: an 8-byte marker, then 24 bytes of content with a CRC. The marker is
//! programmed first and has the same value everywhere. So if the power fails while a marker is programmed
//! and it still reads as erased afterwards, the next record goes to the same place, programs the very same
//! value and completes it; and where a marker is seen the place is taken, whatever became of the content.
//!
//! A record whose writing was interrupted can read as valid today and as invalid tomorrow. What a decision
//! depends on is therefore written twice, and a single valid copy is joined by another one before anything
//! is done because of it ([`Slot::settle`]).

use embedded_storage::nor_flash::NorFlash;

use super::flash::{LARGEST_UNIT, Slot, SlotError, TRAILER_SIZE};
use crate::boot::image::is_blank;
use crate::crc::iso_hdlc;

/// Bytes of a record's place.
pub const RECORD_SIZE: usize = 32;
/// Places of a trailer.
const PLACES: usize = TRAILER_SIZE / RECORD_SIZE;
/// What a taken place begins with.
pub const RECORD_MARKER: [u8; LARGEST_UNIT] = *b"WLRECORD";
/// Bytes of a record's content.
const CONTENT: usize = RECORD_SIZE - LARGEST_UNIT;
/// Places that are tried before an append is given up.
const ATTEMPTS: u8 = 4;
/// Copies of a record that a decision depends on.
const COPIES: u8 = 2;

/// What happened to a slot.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Record {
    /// A page of an update is stored and verified; with its page transfer CRC.
    Stored {
        /// The page.
        page: u8,
        /// CRC of its 4096 bytes as on the wire.
        crc: u32,
    },
    /// All pages are stored, and CRC and signature are right: the image is valid.
    Committed {
        /// Grows with every image and every order to replace one.
        generation: u32,
        /// The header's image CRC.
        image_crc: u32,
    },
    /// The image has run and answered.
    Confirmed,
    /// The image was reset by watchdog or fault before it was confirmed.
    TrialFailed,
    /// In the fallback slot: an update of the application slot begins; no image of a smaller generation is
    /// valid there any more.
    UpdateBegun {
        /// See [`Record::Committed`].
        generation: u32,
    },
    /// In the fallback slot: its image is being copied to the application slot.
    RestoreBegun {
        /// Generation that the restored image will have.
        generation: u32,
    },
    /// In the application slot: its image is being copied to the fallback slot, whose content is void.
    RefreshBegun,
    /// In the application slot: the copy is complete, or has failed for good.
    RefreshEnded {
        /// The fallback slot holds this image.
        done: bool,
    },
}

/// A record as it stands in flash: kind (low byte) and argument, then two values. What is only carried on or compared
/// stays in this form.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) struct Words([u32; 3]);

/// The kinds.
mod kind {
    pub(super) const STORED: u8 = 1;
    pub(super) const COMMITTED: u8 = 2;
    pub(super) const CONFIRMED: u8 = 3;
    pub(super) const TRIAL_FAILED: u8 = 4;
    pub(super) const UPDATE_BEGUN: u8 = 5;
    pub(super) const RESTORE_BEGUN: u8 = 6;
    pub(super) const REFRESH_BEGUN: u8 = 7;
    pub(super) const REFRESH_ENDED: u8 = 8;
}

impl Record {
    // Inlined: where the kind is known, which is everywhere, it comes down to three words.
    #[inline(always)]
    pub(super) const fn words(self) -> Words {
        let (kind, argument, first, second) = match self {
            Self::Stored { page, crc } => (kind::STORED, page, crc, 0),
            Self::Committed {
                generation,
                image_crc,
            } => (kind::COMMITTED, 0, generation, image_crc),
            Self::Confirmed => (kind::CONFIRMED, 0, 0, 0),
            Self::TrialFailed => (kind::TRIAL_FAILED, 0, 0, 0),
            Self::UpdateBegun { generation } => (kind::UPDATE_BEGUN, 0, generation, 0),
            Self::RestoreBegun { generation } => (kind::RESTORE_BEGUN, 0, generation, 0),
            Self::RefreshBegun => (kind::REFRESH_BEGUN, 0, 0, 0),
            Self::RefreshEnded { done } => (kind::REFRESH_ENDED, done as u8, 0, 0),
        };
        Words([u16::from_le_bytes([kind, argument]) as u32, first, second])
    }

    /// The 32 bytes of a place, for a tool that writes a whole flash.
    #[must_use]
    pub fn to_bytes(self) -> [u8; RECORD_SIZE] {
        let mut bytes = [0; RECORD_SIZE];
        let content = self.words().to_content();
        for (to, from) in bytes.iter_mut().zip(RECORD_MARKER.iter().chain(&content)) {
            *to = *from;
        }
        bytes
    }
}

impl Words {
    const fn kind(self) -> u8 {
        let Self([first, ..]) = self;
        first as u8
    }

    const fn argument(self) -> u8 {
        let Self([first, ..]) = self;
        (first >> 8) as u8
    }

    const fn values(self) -> (u32, u32) {
        let Self([_, first, second]) = self;
        (first, second)
    }

    /// The generation and whether a restore has begun, of a record that begins something.
    const fn begun(self) -> Option<(u32, bool)> {
        match self.kind() {
            kind @ (kind::UPDATE_BEGUN | kind::RESTORE_BEGUN) => {
                Some((self.values().0, kind == kind::RESTORE_BEGUN))
            }
            _ => None,
        }
    }

    // Byte by byte in the open: the compiler makes words of it, while iterators cost a hundred bytes each.
    const fn to_content(self) -> [u8; CONTENT] {
        let Self([first, second, third]) = self;
        let [a0, a1, a2, a3] = first.to_le_bytes();
        let [b0, b1, b2, b3] = second.to_le_bytes();
        let [c0, c1, c2, c3] = third.to_le_bytes();
        let bytes = [
            a0, a1, a2, a3, b0, b1, b2, b3, c0, c1, c2, c3, 0, 0, 0, 0, 0, 0, 0, 0,
        ];
        let [d0, d1, d2, d3] = record_crc(&bytes).to_le_bytes();
        [
            a0, a1, a2, a3, b0, b1, b2, b3, c0, c1, c2, c3, 0, 0, 0, 0, 0, 0, 0, 0, d0, d1, d2, d3,
        ]
    }

    pub(super) fn from_content(content: &[u8; CONTENT]) -> Option<Self> {
        let (bytes, crc) = content.split_first_chunk()?;
        if crc != record_crc(bytes).to_le_bytes() {
            return None;
        }
        let [a0, a1, a2, a3, b0, b1, b2, b3, c0, c1, c2, c3, ..] = *bytes;
        Some(Self([
            u32::from_le_bytes([a0, a1, a2, a3]),
            u32::from_le_bytes([b0, b1, b2, b3]),
            u32::from_le_bytes([c0, c1, c2, c3]),
        ]))
    }
}

/// CRC of all that comes before it.
const fn record_crc(bytes: &[u8; CONTENT - 4]) -> u32 {
    iso_hdlc(bytes)
}

/// A record that is written twice; none of it while the count is 0.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
struct Copies {
    words: Words,
    count: u8,
}

impl Copies {
    const NONE: Self = Self {
        words: Words([0; 3]),
        count: 0,
    };

    fn add(&mut self, words: Words) {
        if self.words != words {
            *self = Self { words, count: 0 };
        }
        self.count = self.count.saturating_add(1);
    }

    fn words(&self) -> Option<Words> {
        (self.count > 0).then_some(self.words)
    }
}

/// What the records of a trailer say.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Log {
    /// Pages with a [`Record::Stored`].
    pub stored: u32,
    /// Failures in trial.
    pub trial_failures: u8,
    /// The slot's image is in the fallback slot, or could not be copied there.
    pub refresh: Refresh,
    committed: Copies,
    confirmed: Copies,
    begun: Copies,
    /// First free place.
    next: usize,
}

/// Progress of copying an image to the fallback slot.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum Refresh {
    /// Not begun.
    #[default]
    Idle,
    /// Begun and not ended: what the fallback slot holds is void.
    Begun,
    /// Done.
    Done,
    /// Given up.
    Failed,
}

impl Log {
    /// That of an erased trailer.
    pub const EMPTY: Self = Self {
        stored: 0,
        trial_failures: 0,
        refresh: Refresh::Idle,
        committed: Copies::NONE,
        confirmed: Copies::NONE,
        begun: Copies::NONE,
        next: 0,
    };

    pub(super) fn take(&mut self, words: Words) {
        match words.kind() {
            kind::STORED => {
                let page = u32::from(words.argument());
                self.stored |= 1_u32.checked_shl(page).unwrap_or(0);
            }
            kind::COMMITTED => self.committed.add(words),
            kind::CONFIRMED => self.confirmed.add(words),
            kind::TRIAL_FAILED => self.trial_failures = self.trial_failures.saturating_add(1),
            kind::UPDATE_BEGUN | kind::RESTORE_BEGUN => self.begun.add(words),
            kind::REFRESH_BEGUN => self.refresh = Refresh::Begun,
            kind::REFRESH_ENDED if words.argument() != 0 => self.refresh = Refresh::Done,
            kind::REFRESH_ENDED => self.refresh = Refresh::Failed,
            // Of a later version.
            _ => {}
        }
    }

    /// Generation and CRC of the committed image.
    #[must_use]
    pub fn committed(&self) -> Option<(u32, u32)> {
        self.committed.words().map(Words::values)
    }

    /// The image has been confirmed.
    #[must_use]
    pub const fn confirmed(&self) -> bool {
        self.confirmed.count > 0
    }

    /// In the fallback slot: the generation that has been begun last, and whether by a restore.
    #[must_use]
    pub fn begun(&self) -> Option<(u32, bool)> {
        self.begun.words().and_then(Words::begun)
    }

    /// The largest generation that this trailer names.
    #[must_use]
    pub fn generation(&self) -> u32 {
        let committed = self.committed().map_or(0, |(generation, _)| generation);
        let begun = self.begun().map_or(0, |(generation, _)| generation);
        committed.max(begun)
    }
}

fn place(index: usize) -> usize {
    index * RECORD_SIZE
}

impl<F: NorFlash> Slot<F> {
    /// Reads the trailer. What cannot be read counts as a taken place without a record.
    pub fn log(&mut self) -> Log {
        let mut log = Log::EMPTY;
        for index in 0..PLACES {
            let mut marker = RECORD_MARKER;
            let readable = self.read_trailer(place(index), &mut marker).is_ok();
            if readable && is_blank(&marker) {
                continue;
            }
            log.next = index + 1;
            if let Some(words) = self.words(index) {
                log.take(words);
            }
        }
        log
    }

    /// A place without its marker is free, whatever stands behind it.
    fn is_taken(&mut self, index: usize) -> bool {
        let mut marker = [0; LARGEST_UNIT];
        self.read_trailer(place(index), &mut marker).is_ok() && marker == RECORD_MARKER
    }

    #[inline(never)]
    fn words(&mut self, index: usize) -> Option<Words> {
        let mut content = [0; CONTENT];
        self.read_trailer(place(index) + LARGEST_UNIT, &mut content)
            .ok()?;
        Words::from_content(&content)
    }

    /// CRC of each stored page as on the wire, 0 for the others.
    pub fn stored_crcs(&mut self) -> [u32; 31] {
        let mut crcs = [0; 31];
        for index in 0..PLACES {
            if let Some(words) = self.words(index)
                && words.kind() == kind::STORED
                && let Some(place) = crcs.get_mut(usize::from(words.argument()))
            {
                (*place, _) = words.values();
            }
        }
        crcs
    }

    /// Appends a record and takes it over into `log`, which must be this trailer's present one.
    #[inline(always)]
    pub(crate) fn append(&mut self, log: &mut Log, record: Record) -> Result<(), SlotError> {
        self.append_words(log, record.words())
    }

    #[inline(never)]
    fn append_words(&mut self, log: &mut Log, words: Words) -> Result<(), SlotError> {
        for _ in 0..ATTEMPTS {
            let index = log.next;
            if index >= PLACES {
                return Err(SlotError::Full);
            }
            log.next += 1;
            // A place that refuses is left behind: what stands there is no valid record.
            let at = place(index);
            let content = words.to_content();
            let written = self.write_trailer(at, &RECORD_MARKER).is_ok()
                && self.write_trailer(at + LARGEST_UNIT, &content).is_ok();
            if written && self.is_taken(index) && self.words(index) == Some(words) {
                log.take(words);
                return Ok(());
            }
        }
        Err(SlotError::Flash)
    }

    /// Appends a record that a decision depends on, twice.
    #[inline(always)]
    pub(crate) fn append_twice(&mut self, log: &mut Log, record: Record) -> Result<(), SlotError> {
        self.append_words_twice(log, record.words())
    }

    #[inline(never)]
    fn append_words_twice(&mut self, log: &mut Log, words: Words) -> Result<(), SlotError> {
        self.append_words(log, words)?;
        self.append_words(log, words)
    }

    /// Joins another copy to every record of which only one valid copy is read.
    pub(crate) fn settle(&mut self, log: &mut Log) {
        for copies in &[log.committed, log.confirmed, log.begun] {
            if copies.count > 0 && copies.count < COPIES {
                // If that fails the single copy goes on counting; the next boot tries again.
                let _ = self.append_words(log, copies.words);
            }
        }
    }
}
