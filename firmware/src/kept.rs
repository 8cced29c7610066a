//! What outlives a run of the application: settings in the journal, the image in its slot, and what the bootloader has
//! passed on.

use embedded_storage::nor_flash::NorFlash;
use windlass_core::boot::slots::Slot;
use windlass_core::engine;
use windlass_core::node::NodeConfig;
use windlass_core::params::Stored;
use windlass_core::params::journal::{Crash, Journal, SaveError, Saved};
use windlass_core::reset::Reset;

use crate::record::{PassedOn, Record};

/// What the application knows of itself and of its start.
#[derive(Clone, Copy, Debug)]
pub struct Origin {
    /// What bootloader and application tell each other.
    pub record: &'static Record,
    /// Passed on by the bootloader.
    pub passed_on: PassedOn,
    /// The application's own version.
    pub version: u16,
    /// Converts what is measured.
    pub board: engine::Board,
    /// Differs from specimen to specimen.
    pub seed: u32,
}

/// Settings and image of the application: `S` is the journal's memory, `A` that of the application's slot.
#[derive(Debug)]
pub struct Kept<S, A> {
    origin: Origin,
    journal: Journal,
    crash: Option<Crash>,
    settings: S,
    slot: Slot<A>,
}

impl<S: NorFlash, A: NorFlash> Kept<S, A> {
    /// Opens the journal and keeps the crash that the program may have started with: at its start, because that may take
    /// an erase.
    #[must_use]
    pub fn new(origin: Origin, mut settings: S, slot: Slot<A>) -> Self {
        let mut journal = Journal::open(&mut settings);
        let reset = &origin.passed_on.start.reset;
        Self {
            crash: Crash::keep(&mut journal, &mut settings, reset),
            origin,
            journal,
            settings,
            slot,
        }
    }

    /// Why the application has started.
    #[must_use]
    pub const fn reset(&self) -> Reset {
        self.origin.passed_on.start.reset
    }

    /// What the node is made from.
    #[must_use]
    pub fn node_config(&self) -> NodeConfig {
        let Origin {
            passed_on,
            version,
            board,
            seed,
            ..
        } = self.origin;
        NodeConfig {
            board,
            application_version: version,
            bootloader_version: passed_on.bootloader_version,
            handover: passed_on.start.handover,
            newer_settings: self.journal.is_newer_format(),
            reset: passed_on.start.reset,
            crash: self.crash,
            ..NodeConfig::dmc60c(seed)
        }
    }

    /// The settings in force.
    pub fn load(&mut self) -> Stored {
        Stored::load(&self.journal, &mut self.settings)
    }

    /// Writes the settings. Where one bank of flash holds program and settings, the processor waits for each unit,
    /// and if it may erase, for up to half a second.
    ///
    /// # Errors
    /// See [`SaveError`].
    pub fn save(&mut self, stored: &Stored, may_erase: bool) -> Result<Saved, SaveError> {
        self.journal.save(&mut self.settings, stored, may_erase)
    }

    /// Erases in advance if that is of use, so that a later save need not wait for it.
    pub fn erase_ahead(&mut self) {
        if self.journal.wants_erase::<S>() {
            // If it fails, a later save finds out.
            let _ = self.journal.erase_next(&mut self.settings);
        }
    }

    /// The image has run and answered.
    pub fn confirm(&mut self) {
        self.healthy();
        // If it fails, the next start tries again.
        let _ = self.slot.confirm();
    }

    /// The image works: failures before this count no more.
    pub fn healthy(&self) {
        self.origin.record.healthy();
    }

    /// The slot that the application runs from.
    pub const fn slot(&mut self) -> &mut Slot<A> {
        &mut self.slot
    }
}
