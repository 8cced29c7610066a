//! The flash of a simulated board, in its own time: settings journal and image slots.
//!
//! A job takes as long as the data sheet says. What it does to the flash is worked out when it begins; if
//! the power goes before it ends, the flash goes back to how it was and the job is begun again with a cut
//! at that moment. A real processor waits for its flash. The bootloader does so here too; an application
//! goes on, and only what the node is told comes when the job is over.

use std::collections::VecDeque;
use std::fmt::Debug;

use windlass_core::boot::image::{
    FIRST_PAGE, Hardware, Header, INFO_LENGTH, INFO_OFFSET, Identity, InfoBlock, LAST_PAGE,
    PAGE_SIZE, Page, pack,
};
use windlass_core::boot::loader::{Loader, LoaderConfig, Memory as Regions, start};
use windlass_core::boot::slots::{Slot, Slots, Start as BootStart};
use windlass_core::boot::trust::Trust;
use windlass_core::boot::updater::Updater;
use windlass_core::crc::page_transfer;
use windlass_core::management::vendor::CommandCode;
use windlass_core::node::PRODUCT_DMC60C;
use windlass_core::params::Stored;
use windlass_core::params::journal::{Crash, Journal, SaveError, Saved};
use windlass_core::reset::Reset;
use windlass_core::time::{Duration, Instant};

use crate::nor::{Geometry, NorChip, NorState, Partition, Region, STM32F405, STM32G431, STM32G474};
use crate::random::Random;

/// The microcontroller of a simulated board, as far as its flash goes.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum Chip {
    /// STM32F405: one erase unit per slot.
    #[default]
    Stm32F405,
    /// STM32G474: small erase units.
    Stm32G474,
    /// STM32G431: small erase units, a slot of 24 pages, no fallback.
    Stm32G431,
}

impl Chip {
    /// What images for it have to be made for.
    #[must_use]
    pub const fn hardware(self) -> Hardware {
        match self {
            Self::Stm32F405 => Hardware::F405,
            Self::Stm32G474 => Hardware::G474,
            Self::Stm32G431 => Hardware::G431,
        }
    }
}

/// Version of the application and the bootloader on a new board (guide, cover page: 1.23 and 1.9).
const FACTORY_VERSION: u16 = 0x0117;
const BOOTLOADER_VERSION: u16 = 0x0109;

/// What runs after a start.
#[derive(Debug)]
pub(super) enum Started {
    /// The application of this header.
    Application {
        header: Header,
        crash: Option<Crash>,
        stored: Box<Stored>,
        newer_settings: bool,
    },
    /// The bootloader.
    Loader(Box<Loader>),
}

/// How a start comes about.
#[derive(Clone, Copy, Debug)]
pub(super) struct Start {
    pub(super) boot: BootStart,
    pub(super) seed: u32,
}

/// Something that takes time.
#[derive(Debug)]
enum Job {
    Start(Start),
    Save {
        stored: Box<Stored>,
        may_erase: bool,
    },
    EraseAhead,
    Confirm,
    /// What the last frame has asked the bootloader for; holds it as it was before.
    Work(Box<Loader>),
}

/// What a job has led to.
#[derive(Debug)]
pub(super) enum Outcome {
    Started(Started),
    Saved(Result<Saved, SaveError>),
    Worked,
    /// Nothing that anybody waits for.
    Done,
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

/// The memory of a board, whatever its chip.
pub(super) trait BoardMemory: Debug + Send {
    /// The processor starts: [`Outcome::Started`] comes once the bootloader has decided.
    fn start(&mut self, now: Instant, start: Start);
    /// Begins a save.
    fn save(&mut self, now: Instant, stored: Stored, may_erase: bool);
    /// Erases in advance if that is of use and nothing else is being done.
    fn erase_ahead(&mut self, now: Instant);
    /// The running image has answered.
    fn confirm(&mut self, now: Instant);
    /// Lets the bootloader do what it has been asked for; true if that takes until
    /// [`Outcome::Worked`].
    fn work(&mut self, now: Instant, loader: &mut Loader) -> bool;
    /// What has ended by now.
    fn poll(&mut self, now: Instant) -> Option<Outcome>;
    /// What would be loaded at the next start. Looks at a copy, also of a memory without power.
    fn kept(&self) -> Stored;
    /// The power goes.
    fn power_off(&mut self, now: Instant);
    /// The power comes back.
    fn power_on(&mut self);
    /// Sets written since the world began.
    fn writes(&self) -> u32;
    /// Units of the journal erased since the world began.
    fn erases(&self) -> u32;
}

/// The memory of a board that left its maker with these settings.
pub(super) fn new(chip: Chip, seed: u64, stored: &Stored) -> Box<dyn BoardMemory> {
    let hardware = chip.hardware();
    match chip {
        Chip::Stm32F405 => Box::new(Memory::<4, 0x2_0000, 0x4000>::new(
            &STM32F405, hardware, seed, stored,
        )),
        Chip::Stm32G474 => Box::new(Memory::<8, 0x800, 0x800>::new(
            &STM32G474, hardware, seed, stored,
        )),
        Chip::Stm32G431 => Box::new(Memory::<8, 0x800, 0x800>::new(
            &STM32G431, hardware, seed, stored,
        )),
    }
}

/// Flash, slots and journal of one board. `W`, `S` and `J` are the sizes of the program unit and of the
/// erase units of slots and journal.
#[derive(Debug)]
struct Memory<const W: usize, const S: usize, const J: usize> {
    geometry: &'static Geometry,
    hardware: Hardware,
    chip: NorChip,
    flash: Partition<W, J>,
    journal: Journal,
    slots: Slots<Partition<W, S>, Partition<W, S>>,
    running: Option<Box<Running>>,
    /// What waits for the running job to end.
    waiting: VecDeque<Job>,
    random: Random,
    writes: u32,
    erases_at_start: u32,
}

impl<const W: usize, const S: usize, const J: usize> Memory<W, S, J> {
    fn new(geometry: &'static Geometry, hardware: Hardware, seed: u64, stored: &Stored) -> Self {
        let chip = NorChip::new(geometry, seed);
        let (Some(mut flash), Some(application)) = (
            chip.partition(Region::Journal),
            chip.partition(Region::Application),
        ) else {
            unreachable!("the geometry has a journal and a slot of these units");
        };
        let slots = Slots {
            application: Slot::new(application, &hardware),
            fallback: chip
                .partition(Region::Fallback)
                .map(|fallback| Slot::new(fallback, &hardware)),
        };
        let mut journal = Journal::open(&mut flash);
        for result in [
            journal.save(&mut flash, stored, true).map(|_| ()),
            journal.erase_next(&mut flash),
        ] {
            debug_assert_eq!(result, Ok(()));
        }
        let mut memory = Self {
            geometry,
            hardware,
            chip,
            flash,
            journal,
            slots,
            running: None,
            waiting: VecDeque::new(),
            random: Random::new(seed, 0x7EA2),
            writes: 0,
            erases_at_start: 0,
        };
        memory.install_factory_image();
        memory.erases_at_start = memory.all_erases();
        memory
    }

    /// What the maker does: an image that was tried and confirmed.
    fn install_factory_image(&mut self) {
        let trust = Trust {
            product: PRODUCT_DMC60C,
            hardware: self.hardware.id,
            rollback: 0,
            key: None,
        };
        let mut updater = Updater::new([0; PAGE_SIZE]);
        updater.look(&mut self.slots);
        for (number, page) in factory_image(self.hardware.id) {
            updater.take(0, &page[..]);
            updater.take(PAGE_SIZE, &page_transfer(&page[..]).to_le_bytes());
            let code = updater.write(&mut self.slots, &trust, number);
            debug_assert_eq!(code, CommandCode::NoError);
        }
        let confirmed = self.slots.application.confirm();
        debug_assert_eq!(confirmed, Ok(true));
        // The boot after a confirmation fills the fallback slot.
        let booted = self.regions(|regions| start(regions, &BootStart::POWER_ON));
        debug_assert!(booted.start.is_ok());
    }

    fn regions<T>(
        &mut self,
        with: impl FnOnce(&mut Regions<'_, Partition<W, S>, Partition<W, S>, Partition<W, J>>) -> T,
    ) -> T {
        with(&mut Regions {
            slots: &mut self.slots,
            journal: &mut self.journal,
            settings: &mut self.flash,
        })
    }

    fn begin(&mut self, now: Instant, job: Job) {
        if self.running.is_some() {
            self.waiting.push_back(job);
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
            Job::Start(start) => Outcome::Started(self.decide(*start)),
            Job::Save { stored, may_erase } => {
                Outcome::Saved(self.journal.save(&mut self.flash, &**stored, *may_erase))
            }
            Job::EraseAhead => {
                // If it fails, a later save finds out.
                let _ = self.journal.erase_next(&mut self.flash);
                Outcome::Done
            }
            Job::Confirm => {
                // If it fails, the image stays on trial.
                let _ = self.slots.application.confirm();
                Outcome::Done
            }
            Job::Work(loader) => {
                let mut loader = loader.clone();
                self.regions(|regions| loader.work(regions));
                Outcome::Worked
            }
        }
    }

    fn decide(&mut self, Start { boot, seed }: Start) -> Started {
        self.journal = Journal::open(&mut self.flash);
        let booted = self.regions(|regions| start(regions, &boot));
        match booted.start {
            Ok(header) => Started::Application {
                header,
                crash: Crash::keep(
                    &mut self.journal,
                    &mut self.flash,
                    &Reset::first(boot.cause),
                ),
                stored: Box::new(Stored::load(&self.journal, &mut self.flash)),
                newer_settings: self.journal.is_newer_format(),
            },
            Err(reason) => {
                let config = LoaderConfig {
                    product_id: PRODUCT_DMC60C,
                    hardware: self.hardware.id,
                    bootloader_version: BOOTLOADER_VERSION,
                    seed,
                    handover: boot.handover,
                    reason,
                };
                let loader = self.regions(|regions| Loader::new(&config, regions));
                Started::Loader(Box::new(loader))
            }
        }
    }

    fn count(&mut self, outcome: &Outcome) {
        if let Outcome::Saved(Ok(Saved { written: true, .. })) = outcome {
            self.writes += 1;
        }
    }

    fn all_erases(&self) -> u32 {
        self.chip.erases(Region::Journal).iter().sum()
    }
}

impl<const W: usize, const S: usize, const J: usize> BoardMemory for Memory<W, S, J> {
    fn start(&mut self, now: Instant, start: Start) {
        // Without a loss of power, what the image before had begun is complete.
        self.waiting.clear();
        if let Some(running) = self.running.take() {
            self.count(&running.outcome);
        }
        self.begin(now, Job::Start(start));
    }

    fn save(&mut self, now: Instant, stored: Stored, may_erase: bool) {
        let stored = Box::new(stored);
        self.begin(now, Job::Save { stored, may_erase });
    }

    fn erase_ahead(&mut self, now: Instant) {
        if self.running.is_none() && self.journal.wants_erase::<Partition<W, J>>() {
            self.begin(now, Job::EraseAhead);
        }
    }

    fn confirm(&mut self, now: Instant) {
        self.begin(now, Job::Confirm);
    }

    fn work(&mut self, now: Instant, loader: &mut Loader) -> bool {
        if !loader.has_work() {
            return false;
        }
        let before = Box::new(loader.clone());
        let (flash_before, journal_before) = (self.chip.save(), self.journal);
        let busy = self.chip.busy_us();
        self.regions(|regions| loader.work(regions));
        let busy = Duration::from_micros(self.chip.busy_us() - busy);
        self.running = Some(Box::new(Running {
            job: Job::Work(before),
            since: now,
            until: now + busy,
            flash_before,
            journal_before,
            outcome: Outcome::Worked,
        }));
        true
    }

    fn poll(&mut self, now: Instant) -> Option<Outcome> {
        let running = self.running.take_if(|running| running.until <= now)?;
        self.count(&running.outcome);
        if let Some(job) = self.waiting.pop_front() {
            self.begin(running.until, job);
        }
        Some(running.outcome)
    }

    fn kept(&self) -> Stored {
        let before = self.running.as_ref().map(|running| &running.flash_before);
        let copy = NorChip::new(self.geometry, 0);
        copy.restore(before.unwrap_or(&self.chip.save()));
        copy.power_on();
        copy.partition::<W, J>(Region::Journal)
            .map(|mut flash| Stored::load(&Journal::open(&mut flash), &mut flash))
            .unwrap_or_default()
    }

    fn power_off(&mut self, now: Instant) {
        self.waiting.clear();
        if let Some(running) = self.running.take() {
            self.chip.restore(&running.flash_before);
            self.journal = running.journal_before;
            let elapsed = now.since(running.since).as_micros();
            self.chip.cut_after(elapsed, self.random.next());
            self.perform(&running.job);
        }
        self.chip.power_off();
    }

    fn power_on(&mut self) {
        self.chip.power_on();
    }

    fn writes(&self) -> u32 {
        self.writes
    }

    fn erases(&self) -> u32 {
        self.all_erases() - self.erases_at_start
    }
}

/// The application of a new board: only what tells which one it is, for the code that runs is that of the
/// bench itself. In the order in which an update sends it.
fn factory_image(hardware: u32) -> [(u8, Box<Page>); 2] {
    let identity = Identity {
        product: PRODUCT_DMC60C,
        hardware,
        version: FACTORY_VERSION,
        rollback: 0,
    };
    let mut first = Box::new([0xFF; PAGE_SIZE]);
    first[INFO_OFFSET..][..INFO_LENGTH].copy_from_slice(&InfoBlock { identity }.to_bytes());
    let mut last = Box::new([0xFF; PAGE_SIZE]);
    let packed = pack(|page| (page == FIRST_PAGE).then_some(&*first), &mut last);
    debug_assert!(packed.is_ok());
    [(LAST_PAGE, last), (FIRST_PAGE, first)]
}
