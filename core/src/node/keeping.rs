//! What a node keeps: when it asks its platform to write, and what becomes of it.

use super::Node;
use crate::engine::snapshot::{Actuation, Snapshot};
use crate::management::vendor::{CommandCode, Descriptor};
use crate::params::journal::{SaveError, Saved};
use crate::params::{Params, SaveRule, SaveTimer, SettingsState, Stored, compile};
use crate::time::{Duration, Instant};

/// How long the output must have been off before flash may be erased. Erasing stops many chips for up to
/// a quarter of a second, which a short pause between two movements is too short for.
const IDLE_TIME: Duration = Duration::from_millis(1000);

/// State of the settings on their way into non-volatile memory.
#[derive(Clone, Debug)]
pub(super) struct Keeping {
    timer: SaveTimer,
    /// To be written without waiting for the timer.
    at_once: bool,
    /// Being written.
    busy: bool,
    /// An erase is due that is not allowed yet.
    waits: bool,
    /// What is stored is of a newer format.
    refused: bool,
    /// A vendor command is answered by the next save, or by the one that is being written.
    owed: bool,
    answering: bool,
    /// When the output was driven last; `None` if it was not.
    last_driven: Option<Instant>,
    driving: bool,
}

impl Keeping {
    pub(super) const fn new(rule: SaveRule, refused: bool) -> Self {
        Self {
            timer: SaveTimer::new(rule),
            at_once: false,
            busy: false,
            waits: false,
            refused,
            owed: false,
            answering: false,
            last_driven: None,
            driving: false,
        }
    }

    /// Something that is stored has changed.
    pub(super) fn changed(&mut self, now: Instant) {
        if !self.refused {
            self.timer.changed(now);
        }
    }

    /// Everything that has changed is to be written before a restart.
    pub(super) const fn flush(&mut self) {
        self.at_once |= self.timer.due().is_some() || self.waits;
        self.waits = false;
    }

    /// True once if a set is to be written now.
    pub(super) const fn begin(&mut self) -> bool {
        let begins = self.at_once && !self.busy;
        if begins {
            self.at_once = false;
            self.busy = true;
            self.answering = self.owed;
            self.owed = false;
            self.timer.begin();
        }
        begins
    }

    /// True if nothing is on its way.
    pub(super) const fn is_idle(&self) -> bool {
        !self.at_once && !self.busy && !self.waits
    }

    /// When the next set is due, if that is decided by time.
    pub(super) const fn due(&self) -> Option<Instant> {
        self.timer.due()
    }

    fn ended(&mut self, now: Instant, result: Result<Saved, SaveError>) -> CommandCode {
        self.busy = false;
        match result {
            Ok(_) => {
                self.timer.saved(now);
                CommandCode::NoError
            }
            Err(SaveError::EraseDue) => {
                self.waits = true;
                CommandCode::SaveWaits
            }
            Err(SaveError::NewerFormat) => {
                self.refused = true;
                CommandCode::FlashWriteFailed
            }
            Err(SaveError::TooLarge | SaveError::Memory) => {
                self.timer.failed(now);
                CommandCode::FlashWriteFailed
            }
        }
    }

    const fn state(&self) -> SettingsState {
        if self.refused {
            SettingsState::NewerFormat
        } else if self.waits {
            SettingsState::EraseDue
        } else if self.is_idle() && self.timer.due().is_none() {
            SettingsState::Saved
        } else {
            SettingsState::Pending
        }
    }
}

impl Node {
    /// Identity is written at once; the answer means that it has been.
    pub(super) fn identity_changed(&mut self) {
        self.keeping.at_once = true;
        self.keeping.owed = true;
        self.management.defer();
    }

    /// True if identity and settings can not be changed for good, which has then been answered.
    pub(super) fn refuses_changes(&mut self) -> bool {
        if self.keeping.refused {
            self.management.finish(CommandCode::FlashWriteFailed);
        }
        self.keeping.refused
    }

    /// Puts parameters, faults and the device's name back to their defaults; with `all` also device number
    /// and the strings that the maker has set.
    pub(super) fn factory_reset(&mut self, all: bool, snapshot: &Snapshot) {
        if matches!(snapshot.actuation, Actuation::Drive(_)) {
            self.management.finish(CommandCode::DriveRunning);
            return;
        }
        if self.refuses_changes() {
            return;
        }
        self.stored.params = Params::new();
        let policy = self.dialect.kind().policy();
        self.settings = compile::settings(&self.stored.params, &self.config.board, &policy);
        self.faults.clear();
        self.stored.sticky = self.faults.sticky();
        self.stored.fault_counts = self.faults.stored_counts();
        self.stored.descriptors.clear(Descriptor::DeviceName);
        if all {
            self.stored.number = 0;
            for which in Descriptor::ALL {
                self.stored.descriptors.clear(which);
            }
        }
        self.identity_changed();
    }

    /// Once per tick: is something due, and may it be written?
    pub(super) fn poll_keeping(&mut self, now: Instant, snapshot: &Snapshot) {
        let keeping = &mut self.keeping;
        keeping.driving = matches!(snapshot.actuation, Actuation::Drive(_));
        if keeping.driving {
            keeping.last_driven = Some(now);
        }
        if keeping.due().is_some_and(|due| due <= now) {
            keeping.at_once = true;
        }
        if self.keeping.waits && self.may_erase(now) {
            self.keeping.waits = false;
            self.keeping.at_once = true;
        }
    }

    /// True if the platform may erase flash although that stops the processor: the output has been off for
    /// a second, or the node is about to restart.
    #[must_use]
    pub fn may_erase(&self, now: Instant) -> bool {
        let idle = self
            .keeping
            .last_driven
            .is_none_or(|last| now.since(last) >= IDLE_TIME);
        idle || self.reset.is_some() && !self.keeping.driving
    }

    /// What is to be kept over a power cycle.
    #[must_use]
    pub fn stored(&self) -> Stored {
        Stored {
            params: self.stored.params.persistent(),
            sequence: self.stored.sequence.wrapping_add(1),
            ..self.stored.clone()
        }
    }

    /// The platform has written what [`Node::stored`] was at the time of the
    /// [`Action::Save`](super::Action::Save), or could not.
    pub fn save_ended(&mut self, now: Instant, result: Result<Saved, SaveError>) {
        if let Ok(saved) = result {
            self.stored.sequence = saved.sequence;
        }
        let code = self.keeping.ended(now, result);
        if core::mem::take(&mut self.keeping.answering) {
            self.management.finish_deferred(code);
        }
    }

    /// What is known of the settings in force and of those in non-volatile memory.
    #[must_use]
    pub const fn settings_state(&self) -> SettingsState {
        self.keeping.state()
    }
}
