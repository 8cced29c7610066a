//! The two slots of a controller and the decision what to start: a pure function of what is in flash and
//! of the kind of reset.
//!
//! - An image is valid once the bootloader has *committed* it, after checking all of it; the commit is the
//!   last thing that is written. Before anything of a committed image is changed, the intent is written to
//!   the other slot, so that no half-erased trailer can make the image look valid.
//! - A committed image is on *trial* until it has run and answered, and then *confirmed* by itself.
//!   [`TRIAL_RESETS`] resets by watchdog or fault in trial put the fallback image back.
//! - The first boot after a confirmation copies the image to the fallback slot.
//!
//! Every step can be interrupted at any moment and is taken up again by the next [`boot`].

mod flash;
mod log;
#[cfg(test)]
mod tests;

use embedded_storage::nor_flash::NorFlash;

use flash::CHUNK;
pub use flash::{Slot, SlotError, TRAILER_SIZE};
pub use log::{Log, RECORD_MARKER, RECORD_SIZE, Record, Refresh};

use super::image::{Header, ImageError, PAGE_SIZE, pages_of, read_header, verify};
use super::status::Reason;
use crate::node::Handover;
use crate::reset::{Crashes, ResetCause};

/// Resets by watchdog or fault that end a trial.
pub const TRIAL_RESETS: u8 = 3;
/// Failures in a row that end the attempts to start a confirmed image: those of a trial, and five more for the image
/// that has been put back.
pub const CRASH_LIMIT: u8 = 8;
/// The slots of one controller.
#[derive(Clone, Debug)]
pub struct Slots<A, F> {
    /// Where the application runs from.
    pub application: Slot<A>,
    /// Copy of the last confirmed image, if the controller has room for it.
    pub fallback: Option<Slot<F>>,
}

/// What is in flash, as far as it matters for the decision.
#[derive(Clone, Copy, Debug)]
pub struct View {
    /// Trailer of the application slot.
    pub application: Log,
    /// The image in the application slot is whole.
    pub whole: bool,
    /// Trailer of the fallback slot, if there is one.
    pub fallback: Option<Log>,
}

/// How the controller comes to start: what the decision knows beside flash.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Start {
    /// The kind of reset.
    pub cause: ResetCause,
    /// Left by the image before, if it restarted on purpose.
    pub handover: Option<Handover>,
    /// Failures in a row.
    pub crashes: Crashes,
}

impl Start {
    /// The supply was switched on.
    pub const POWER_ON: Self = Self {
        cause: ResetCause::PowerOn,
        handover: None,
        crashes: Crashes::NONE,
    };
}

/// What to do at boot.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Decision {
    /// Start the application.
    Start,
    /// Copy the fallback image to the application slot, then decide again.
    Restore,
    /// Stay in the bootloader.
    Stay(Reason),
}

impl View {
    /// Nothing has been looked at.
    pub(super) const NOTHING: Self = Self {
        application: Log::EMPTY,
        whole: false,
        fallback: None,
    };

    /// The application slot has a commit that nothing has revoked.
    #[must_use]
    pub fn is_committed(&self) -> bool {
        let begun = self.begun().map_or(0, |(generation, _)| generation);
        self.application
            .committed()
            .is_some_and(|(generation, _)| generation >= begun)
    }

    /// A restore has begun and not ended.
    #[must_use]
    pub fn is_restoring(&self) -> bool {
        self.begun().is_some_and(|(_, restore)| restore) && !self.is_committed()
    }

    fn begun(&self) -> Option<(u32, bool)> {
        self.fallback.and_then(|log| log.begun())
    }

    /// The fallback slot holds an image that can be put back. It is checked whole before it is.
    #[must_use]
    pub fn has_fallback(&self) -> bool {
        self.fallback.is_some_and(|log| log.committed().is_some())
            && self.application.refresh != Refresh::Begun
    }

    /// The fallback slot holds another image than the application slot.
    fn fallback_differs(&self) -> bool {
        let image = |log: Log| log.committed().map(|(_, image_crc)| image_crc);
        self.fallback.and_then(image) != image(self.application)
    }

    /// The next generation.
    #[must_use]
    pub fn next_generation(&self) -> u32 {
        let fallback = self.fallback.map_or(0, |log| log.generation());
        let largest = self.application.generation().max(fallback);
        largest.saturating_add(1)
    }

    /// The decision.
    #[must_use]
    pub fn decide(&self, start: &Start) -> Decision {
        let handover = start.handover;
        if handover.is_some_and(|handover| handover.stay_in_bootloader) {
            return Decision::Stay(Reason::Requested);
        }
        if self.is_restoring() {
            return Decision::Restore;
        }
        if !self.is_committed() {
            let begun = self.application.stored != 0 || self.begun().is_some();
            return Decision::Stay(if begun {
                Reason::UpdateIncomplete
            } else {
                Reason::Empty
            });
        }
        if !self.whole {
            return self.restore_or(Reason::ImageDamaged);
        }
        let failed =
            !self.application.confirmed() && self.application.trial_failures >= TRIAL_RESETS;
        // An explicit order to restart tries even an image that has failed.
        if handover.is_some() {
            return Decision::Start;
        }
        if failed {
            return if self.fallback_differs() {
                self.restore_or(Reason::TrialFailed)
            } else {
                Decision::Stay(Reason::TrialFailed)
            };
        }
        if start.crashes.0 >= CRASH_LIMIT {
            return Decision::Stay(Reason::CrashLoop);
        }
        Decision::Start
    }

    fn restore_or(&self, reason: Reason) -> Decision {
        if self.has_fallback() {
            Decision::Restore
        } else {
            Decision::Stay(reason)
        }
    }

    /// The application's image is to be copied to the fallback slot.
    fn needs_refresh(&self) -> bool {
        self.fallback.is_some()
            && self.application.confirmed()
            && match self.application.refresh {
                Refresh::Idle => self.fallback_differs(),
                Refresh::Begun => true,
                Refresh::Done | Refresh::Failed => false,
            }
    }
}

/// What [`boot`] has decided and done.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Booted {
    /// The image to start, or why the bootloader stays.
    pub start: Result<Header, Reason>,
    /// The committed image is confirmed.
    pub confirmed: bool,
}

/// Decides what to start, and carries out whatever has to be done before: continues what was interrupted,
/// counts a failed trial, puts the fallback image back, or refreshes the fallback.
pub fn boot<A: NorFlash, F: NorFlash>(slots: &mut Slots<A, F>, start: &Start) -> Booted {
    let mut view = slots.view();
    if view.is_committed() && !view.application.confirmed() && start.cause.is_failure() {
        // An uncounted failure only makes the trial one reset longer.
        let _ = slots
            .application
            .append(&mut view.application, Record::TrialFailed);
    }
    let started = match view.decide(start) {
        Decision::Stay(reason) => Err(reason),
        Decision::Restore => {
            let restored = slots.restore(&mut view);
            slots.look(&mut view);
            match (restored, view.decide(start)) {
                (Ok(()), Decision::Start) => Ok(()),
                _ => Err(Reason::RestoreFailed),
            }
        }
        Decision::Start => Ok(()),
    };
    if started.is_ok() {
        slots.application.settle(&mut view.application);
        if view.needs_refresh() {
            slots.refresh(&mut view);
        }
    }
    let header = slots.header();
    Booted {
        start: match (started, header) {
            (Ok(()), Some(header)) => Ok(header),
            (Ok(()), None) => Err(Reason::ImageDamaged),
            (Err(reason), _) => Err(reason),
        },
        confirmed: view.is_committed() && view.application.confirmed(),
    }
}

impl<A: NorFlash, F: NorFlash> Slots<A, F> {
    /// Reads both trailers and checks the image of a committed application.
    pub fn view(&mut self) -> View {
        let mut view = View::NOTHING;
        self.look(&mut view);
        view
    }

    /// [`Slots::view`] in place: the value is larger than most stack frames.
    #[inline(never)]
    pub(super) fn look(&mut self, view: &mut View) {
        view.application = self.application.log();
        view.fallback = None;
        if let Some(slot) = &mut self.fallback {
            let log = view.fallback.insert(slot.log());
            if view.application.refresh != Refresh::Begun {
                slot.settle(log);
            }
        }
        view.whole = view.is_committed() && self.application.is_whole(&view.application);
    }

    /// Header of the image in the application slot, valid or not.
    pub fn header(&mut self) -> Option<Header> {
        self.application.header()
    }

    /// Puts the fallback image back.
    ///
    /// # Errors
    /// There is no whole fallback image (nothing was changed), or the flash failed (the next boot tries
    /// again).
    pub(crate) fn restore(&mut self, view: &mut View) -> Result<(), SlotError> {
        let Some(fallback) = &mut self.fallback else {
            return Err(SlotError::NoRoom);
        };
        let Some(log) = view.fallback.as_mut().filter(|_| {
            // A refresh that was interrupted leaves no image.
            view.application.refresh != Refresh::Begun
        }) else {
            return Err(SlotError::NoRoom);
        };
        if !fallback.is_whole(log) {
            return Err(SlotError::Mismatch);
        }
        let largest = view.application.generation();
        let generation = match log.begun() {
            // Interrupted: nothing of that generation has been committed.
            Some((generation, true)) if generation > largest => generation,
            _ => {
                let next = largest.max(log.generation()).saturating_add(1);
                fallback.append_twice(log, Record::RestoreBegun { generation: next })?;
                next
            }
        };
        copy(fallback, &mut self.application, generation, true)
    }

    /// Copies the confirmed application to the fallback slot. A failure is remembered, so that a worn-out
    /// slot does not cost every boot its time.
    fn refresh(&mut self, view: &mut View) {
        let Some(fallback) = &mut self.fallback else {
            return;
        };
        let log = &mut view.application;
        if log.refresh != Refresh::Begun
            && self
                .application
                .append_twice(log, Record::RefreshBegun)
                .is_err()
        {
            return;
        }
        let generation = log.generation();
        let done = copy(&mut self.application, fallback, generation, false).is_ok();
        let _ = self.application.append(log, Record::RefreshEnded { done });
    }
}

/// Copies the image of one slot to another one and commits it there.
fn copy<S: NorFlash, T: NorFlash>(
    from: &mut Slot<S>,
    to: &mut Slot<T>,
    generation: u32,
    confirmed: bool,
) -> Result<(), SlotError> {
    let header = from.header().ok_or(SlotError::Mismatch)?;
    to.erase_trailer()?;
    copy_pages(from, to, header.pages)?;
    let image_crc = header.image_crc;
    if to.check() != Ok(header) {
        return Err(SlotError::Mismatch);
    }
    let mut log = Log::EMPTY;
    let committed = Record::Committed {
        generation,
        image_crc,
    };
    if confirmed {
        to.append_twice(&mut log, Record::Confirmed)?;
    }
    to.append_twice(&mut log, committed)
}

/// Copies the pages of a bitmap. Not inlined: what is copied is on the stack only meanwhile.
#[inline(never)]
fn copy_pages<S: NorFlash, T: NorFlash>(
    from: &mut Slot<S>,
    to: &mut Slot<T>,
    bitmap: u32,
) -> Result<(), SlotError> {
    let mut chunk = [0; CHUNK];
    for page in pages_of(bitmap) {
        to.erase_page(page)?;
        for offset in (0..PAGE_SIZE).step_by(CHUNK) {
            super::image::ReadPages::read(from, page, offset, &mut chunk)?;
            to.program(page, offset, &chunk)?;
        }
    }
    Ok(())
}

impl<F: NorFlash> Slot<F> {
    /// Header of the image in the slot, valid or not.
    pub fn header(&mut self) -> Option<Header> {
        read_header(self).ok()
    }

    /// True if the slot holds exactly the image that was committed.
    fn is_whole(&mut self, log: &Log) -> bool {
        let Some((_, image_crc)) = log.committed() else {
            return false;
        };
        match self.check() {
            Ok(header) => header.image_crc == image_crc,
            Err(_) => false,
        }
    }

    /// The signature in the slot's header.
    #[cfg(feature = "signed")]
    pub(crate) fn signature(&mut self) -> Option<[u8; super::image::SIGNATURE_LENGTH]> {
        let mut bytes = [0; super::image::HEADER_LENGTH];
        super::image::ReadPages::read(
            self,
            super::image::LAST_PAGE,
            super::image::HEADER_OFFSET,
            &mut bytes,
        )
        .ok()?;
        Some(Header::signature(&bytes))
    }

    /// Checks the whole image, see [`verify`]. Not inlined: there are three callers.
    #[inline(never)]
    pub(crate) fn check(&mut self) -> Result<Header, ImageError<SlotError>> {
        verify(self, |_| ())
    }

    /// The running image has answered a host: it is confirmed, unless it is already. True if anything was
    /// written.
    ///
    /// # Errors
    /// The flash failed; trying again is safe.
    pub fn confirm(&mut self) -> Result<bool, SlotError> {
        let mut log = self.log();
        if log.committed().is_none() || log.confirmed() {
            return Ok(false);
        }
        self.append_twice(&mut log, Record::Confirmed)?;
        Ok(true)
    }
}
