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

impl Record {
    fn to_content(self) -> [u8; CONTENT] {
        let (kind, argument, first, second) = match self {
            Self::Stored { page, crc } => (1, page, crc, 0),
            Self::Committed {
                generation,
                image_crc,
            } => (2, 0, generation, image_crc),
            Self::Confirmed => (3, 0, 0, 0),
            Self::TrialFailed => (4, 0, 0, 0),
            Self::UpdateBegun { generation } => (5, 0, generation, 0),
            Self::RestoreBegun { generation } => (6, 0, generation, 0),
            Self::RefreshBegun => (7, 0, 0, 0),
            Self::RefreshEnded { done } => (8, u8::from(done), 0, 0),
        };
        let [f0, f1, f2, f3] = u32::to_le_bytes(first);
        let [s0, s1, s2, s3] = u32::to_le_bytes(second);
        let mut content = [0; CONTENT];
        let fields = [kind, argument, 0, 0, f0, f1, f2, f3, s0, s1, s2, s3];
        for (to, from) in content.iter_mut().zip(fields) {
            *to = from;
        }
        let crc = record_crc(&content);
        if let Some(place) = content.last_chunk_mut::<4>() {
            *place = crc.to_le_bytes();
        }
        content
    }

    pub(super) fn from_content(content: &[u8; CONTENT]) -> Option<Self> {
        let stored = content.last_chunk::<4>().copied().map(u32::from_le_bytes);
        if stored != Some(record_crc(content)) {
            return None;
        }
        let [kind, argument, _, _, f0, f1, f2, f3, s0, s1, s2, s3, ..] = *content;
        let first = u32::from_le_bytes([f0, f1, f2, f3]);
        let second = u32::from_le_bytes([s0, s1, s2, s3]);
        Some(match kind {
            1 => Self::Stored {
                page: argument,
                crc: first,
            },
            2 => Self::Committed {
                generation: first,
                image_crc: second,
            },
            3 => Self::Confirmed,
            4 => Self::TrialFailed,
            5 => Self::UpdateBegun { generation: first },
            6 => Self::RestoreBegun { generation: first },
            7 => Self::RefreshBegun,
            8 => Self::RefreshEnded {
                done: argument != 0,
            },
            _ => return None,
        })
    }

    /// The 32 bytes of a place, for a tool that writes a whole flash.
    #[must_use]
    pub fn to_bytes(self) -> [u8; RECORD_SIZE] {
        let mut bytes = [0; RECORD_SIZE];
        let content = self.to_content();
        for (to, from) in bytes.iter_mut().zip(RECORD_MARKER.iter().chain(&content)) {
            *to = *from;
        }
        bytes
    }
}

fn record_crc(content: &[u8; CONTENT]) -> u32 {
    iso_hdlc(content.get(..CONTENT - 4).unwrap_or(&[]))
}

/// A record that is written twice.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
struct Copies {
    record: Record,
    count: u8,
}

impl Copies {
    fn count(present: Option<Self>, record: Record) -> Self {
        let before = present
            .filter(|copies| copies.record == record)
            .map_or(0, |copies| copies.count);
        Self {
            record,
            count: before.saturating_add(1),
        }
    }
}

/// What the records of a trailer say.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Log {
    /// Pages with a [`Record::Stored`].
    pub stored: u32,
    /// Failures in trial.
    pub trial_failures: u8,
    /// The slot's image is in the fallback slot, or could not be copied there.
    pub refresh: Refresh,
    committed: Option<Copies>,
    confirmed: Option<Copies>,
    begun: Option<Copies>,
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
    pub(super) fn take(&mut self, record: Record) {
        match record {
            Record::Stored { page, .. } => {
                self.stored |= 1_u32.checked_shl(u32::from(page)).unwrap_or(0);
            }
            Record::Committed { .. } => {
                self.committed = Some(Copies::count(self.committed, record));
            }
            Record::Confirmed => self.confirmed = Some(Copies::count(self.confirmed, record)),
            Record::TrialFailed => self.trial_failures = self.trial_failures.saturating_add(1),
            Record::UpdateBegun { .. } | Record::RestoreBegun { .. } => {
                self.begun = Some(Copies::count(self.begun, record));
            }
            Record::RefreshBegun => self.refresh = Refresh::Begun,
            Record::RefreshEnded { done: true } => self.refresh = Refresh::Done,
            Record::RefreshEnded { done: false } => self.refresh = Refresh::Failed,
        }
    }

    /// Generation and CRC of the committed image.
    #[must_use]
    pub const fn committed(&self) -> Option<(u32, u32)> {
        match self.committed {
            Some(Copies {
                record:
                    Record::Committed {
                        generation,
                        image_crc,
                    },
                ..
            }) => Some((generation, image_crc)),
            _ => None,
        }
    }

    /// The image has been confirmed.
    #[must_use]
    pub const fn confirmed(&self) -> bool {
        self.confirmed.is_some()
    }

    /// In the fallback slot: the generation that has been begun last, and whether by a restore.
    #[must_use]
    pub const fn begun(&self) -> Option<(u32, bool)> {
        match self.begun {
            Some(Copies {
                record: Record::UpdateBegun { generation },
                ..
            }) => Some((generation, false)),
            Some(Copies {
                record: Record::RestoreBegun { generation },
                ..
            }) => Some((generation, true)),
            _ => None,
        }
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
        let mut log = Log::default();
        for index in 0..PLACES {
            let mut marker = RECORD_MARKER;
            let readable = self.read_trailer(place(index), &mut marker).is_ok();
            if readable && is_blank(&marker) {
                continue;
            }
            log.next = index + 1;
            if let Some(record) = self.record(index) {
                log.take(record);
            }
        }
        log
    }

    fn record(&mut self, index: usize) -> Option<Record> {
        let mut content = [0; CONTENT];
        self.read_trailer(place(index) + LARGEST_UNIT, &mut content)
            .ok()?;
        Record::from_content(&content)
    }

    /// CRC of each stored page as on the wire, 0 for the others.
    pub fn stored_crcs(&mut self) -> [u32; 31] {
        let mut crcs = [0; 31];
        for index in 0..PLACES {
            if let Some(Record::Stored { page, crc }) = self.record(index)
                && let Some(place) = crcs.get_mut(usize::from(page))
            {
                *place = crc;
            }
        }
        crcs
    }

    /// Appends a record and takes it over into `log`, which must be this trailer's present one.
    pub(crate) fn append(&mut self, log: &mut Log, record: Record) -> Result<(), SlotError> {
        for _ in 0..ATTEMPTS {
            let index = log.next;
            if index >= PLACES {
                return Err(SlotError::Full);
            }
            log.next += 1;
            // A place that refuses is left behind: what stands there is no valid record.
            let at = place(index);
            let content = record.to_content();
            let written = self.write_trailer(at, &RECORD_MARKER).is_ok()
                && self.write_trailer(at + LARGEST_UNIT, &content).is_ok();
            if written && self.record(index) == Some(record) {
                log.take(record);
                return Ok(());
            }
        }
        Err(SlotError::Flash)
    }

    /// Appends a record that a decision depends on, twice.
    pub(crate) fn append_twice(&mut self, log: &mut Log, record: Record) -> Result<(), SlotError> {
        self.append(log, record)?;
        self.append(log, record)
    }

    /// Joins another copy to every record of which only one valid copy is read.
    pub(crate) fn settle(&mut self, log: &mut Log) {
        for copies in [log.committed, log.confirmed, log.begun]
            .into_iter()
            .flatten()
        {
            if copies.count < COPIES {
                // If that fails the single copy goes on counting; the next boot tries again.
                let _ = self.append(log, copies.record);
            }
        }
    }
}
