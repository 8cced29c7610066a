//! The settings memory of a simulated board: the journal in the board's flash, in its own time.
//!
//! A save takes as long as the data sheet says. What it does to the flash is worked out when it begins;
//! if the power goes before it ends, the flash goes back to how it was and the save is begun again with a
//! cut at that moment. A real processor waits for its flash; the simulated one goes on, and only what the
//! node is told comes when the save is over.

use windlass_core::params::Stored;
use windlass_core::params::journal::{Journal, SaveError, Saved};
use windlass_core::time::{Duration, Instant};

use crate::nor::{NorChip, NorState, Partition, Region, STM32F405};
use crate::random::Random;

/// The journal of the STM32F405.
type JournalFlash = Partition<4, 0x4000>;

/// Something that takes time.
#[derive(Debug)]
enum Job {
    Save {
        stored: Box<Stored>,
        may_erase: bool,
    },
    EraseAhead,
}

/// What a job has led to.
#[derive(Clone, Copy, Debug)]
enum Outcome {
    Saved(Result<Saved, SaveError>),
    Erased,
}

/// A job that has begun.
#[derive(Debug)]
struct Running {
    job: Job,
    since: Instant,
    until: Instant,
    flash_before: NorState,
    journal_before: Journal,
    outcome: Outcome,
}

/// Flash and journal of one board.
#[derive(Debug)]
pub(super) struct Memory {
    chip: NorChip,
    flash: JournalFlash,
    journal: Journal,
    running: Option<Box<Running>>,
    /// A save that waits for an erase in advance to end.
    waiting: Option<Job>,
    random: Random,
    writes: u32,
    erases_at_start: u32,
}

impl Memory {
    /// The memory of a board that left its maker with these settings.
    pub(super) fn new(seed: u64, stored: &Stored) -> Self {
        let chip = NorChip::new(&STM32F405, seed);
        let Some(mut flash) = chip.partition(Region::Journal) else {
            unreachable!("the geometry of the STM32F405 has a journal of these units");
        };
        let mut journal = Journal::open(&mut flash);
        for result in [
            journal.save(&mut flash, stored, true).map(|_| ()),
            journal.erase_next(&mut flash),
        ] {
            debug_assert_eq!(result, Ok(()));
        }
        let mut memory = Self {
            chip,
            flash,
            journal,
            running: None,
            waiting: None,
            random: Random::new(seed, 0x7EA2),
            writes: 0,
            erases_at_start: 0,
        };
        memory.erases_at_start = memory.all_erases();
        memory
    }

    /// The board starts: the settings in force, and whether they are of a newer format.
    pub(super) fn open(&mut self) -> (Stored, bool) {
        // Without a loss of power, what the image before had begun is complete.
        self.waiting = None;
        if let Some(running) = self.running.take() {
            self.count(running.outcome);
        }
        self.journal = Journal::open(&mut self.flash);
        (self.load(), self.journal.is_newer_format())
    }

    /// The settings in force.
    fn load(&mut self) -> Stored {
        Stored::load(&self.journal, &mut self.flash)
    }

    /// What would be loaded at the next start. Looks at a copy, also of a memory without power.
    pub(super) fn kept(&self) -> Stored {
        let before = self.running.as_ref().map(|running| &running.flash_before);
        let copy = NorChip::new(&STM32F405, 0);
        copy.restore(before.unwrap_or(&self.chip.save()));
        copy.power_on();
        copy.partition::<4, 0x4000>(Region::Journal)
            .map(|mut flash| Stored::load(&Journal::open(&mut flash), &mut flash))
            .unwrap_or_default()
    }

    /// Begins a save.
    pub(super) fn save(&mut self, now: Instant, stored: Stored, may_erase: bool) {
        let stored = Box::new(stored);
        self.begin(now, Job::Save { stored, may_erase });
    }

    /// Erases in advance if that is of use and nothing else is being done.
    pub(super) fn erase_ahead(&mut self, now: Instant) {
        if self.running.is_none() && self.journal.wants_erase::<JournalFlash>() {
            self.begin(now, Job::EraseAhead);
        }
    }

    fn begin(&mut self, now: Instant, job: Job) {
        if self.running.is_some() {
            self.waiting = Some(job);
            return;
        }
        let (flash_before, journal_before) = (self.chip.save(), self.journal);
        let busy = self.chip.busy_us();
        let outcome = self.perform(&job);
        let busy = Duration::from_micros(self.chip.busy_us() - busy);
        self.running = Some(Box::new(Running {
            job,
            since: now,
            until: now + busy,
            flash_before,
            journal_before,
            outcome,
        }));
    }

    fn perform(&mut self, job: &Job) -> Outcome {
        match job {
            Job::Save { stored, may_erase } => {
                Outcome::Saved(self.journal.save(&mut self.flash, &**stored, *may_erase))
            }
            Job::EraseAhead => {
                // If it fails, a later save finds out.
                let _ = self.journal.erase_next(&mut self.flash);
                Outcome::Erased
            }
        }
    }

    /// The result of a save that has ended by now.
    pub(super) fn poll(&mut self, now: Instant) -> Option<Result<Saved, SaveError>> {
        let running = self.running.take_if(|running| running.until <= now)?;
        if let Some(job) = self.waiting.take() {
            self.begin(running.until, job);
        }
        self.count(running.outcome)
    }

    fn count(&mut self, outcome: Outcome) -> Option<Result<Saved, SaveError>> {
        let Outcome::Saved(result) = outcome else {
            return None;
        };
        self.writes += u32::from(result.is_ok_and(|saved| saved.written));
        Some(result)
    }

    /// The power goes.
    pub(super) fn power_off(&mut self, now: Instant) {
        self.waiting = None;
        if let Some(running) = self.running.take() {
            self.chip.restore(&running.flash_before);
            self.journal = running.journal_before;
            let elapsed = now.since(running.since).as_micros();
            self.chip.cut_after(elapsed, self.random.next());
            self.perform(&running.job);
        }
        self.chip.power_off();
    }

    /// The power comes back.
    pub(super) fn power_on(&mut self) {
        self.chip.power_on();
    }

    /// Sets written since the world began.
    pub(super) const fn writes(&self) -> u32 {
        self.writes
    }

    /// Units erased since the world began.
    pub(super) fn erases(&self) -> u32 {
        self.all_erases() - self.erases_at_start
    }

    fn all_erases(&self) -> u32 {
        self.chip.erases(Region::Journal).iter().sum()
    }
}
