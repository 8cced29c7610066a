//! The settings journal under power cuts: every cut of every save, pairs of cuts, and cuts at random.
//!
//! After each cut the journal is opened as a controller does when its power comes back. What is loaded
//! must be exactly the set before the save or exactly the new one, and it must be the same again and again
//! from then on.

use windlass_core::management::vendor::Descriptor;
use windlass_core::params::journal::{Change, Journal, Key, SaveError};
use windlass_core::params::store::QUIET_TIME;
use windlass_core::params::table::{ParameterId, TABLE};
use windlass_core::params::{SaveRule, SaveTimer, Stored};
use windlass_core::time::{Duration, Instant};
use windlass_sim::nor::{
    Cut, CutPoint, Geometry, NorChip, NorState, Partition, Region, RegionGeometry, STM32F405,
    STM32G431, STM32G474,
};

/// An entry that the settings do not own, as a bootloader keeps them.
const FOREIGN: Key = Key::Other(0x40);

/// What was seen.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Report {
    /// Saves that were swept.
    pub saves: u64,
    /// Rounds of the ring: the least number of erases of any unit.
    pub wraps: u32,
    /// Cuts.
    pub cuts: u64,
    /// Cuts that left the set before in force.
    pub old: u64,
    /// Cuts that left the new set in force.
    pub new: u64,
    /// Cuts that left anything else.
    pub wrong: u64,
    /// Openings after which another set was in force than after the one before.
    pub undecided: u64,
    /// Accesses that break the rules of flash.
    pub misuses: u64,
    /// Saves after a cut that did not succeed.
    pub stuck: u64,
}

impl Report {
    /// True if every cut left the old or the new set, once and for all.
    #[must_use]
    pub fn is_clean(&self) -> bool {
        self.wrong == 0
            && self.undecided == 0
            && self.misuses == 0
            && self.stuck == 0
            && self.old + self.new == self.cuts
    }

    /// Both reports together.
    #[must_use]
    pub fn with(self, other: Self) -> Self {
        Self {
            saves: self.saves + other.saves,
            wraps: self.wraps.max(other.wraps),
            cuts: self.cuts + other.cuts,
            old: self.old + other.old,
            new: self.new + other.new,
            wrong: self.wrong + other.wrong,
            undecided: self.undecided + other.undecided,
            misuses: self.misuses + other.misuses,
            stuck: self.stuck + other.stuck,
        }
    }
}

/// How much is swept.
#[derive(Clone, Copy, Debug)]
pub struct Extent {
    /// Saves of the sweep of single cuts.
    pub saves: u32,
    /// Different ways to interrupt each operation.
    pub ways: u64,
    /// Saves whose pairs of cuts are swept.
    pub pairs: u32,
    /// Of these, every how many-th first cut is taken.
    pub stride: usize,
    /// Power cuts at random.
    pub random: u32,
}

/// Small random numbers (SplitMix64, as in the bench).
#[derive(Clone, Debug)]
pub(crate) struct Random(u64);

impl Random {
    pub(crate) const fn new(seed: u64) -> Self {
        Self(seed)
    }

    pub(crate) fn next(&mut self) -> u64 {
        self.0 = self.0.wrapping_add(0x9E37_79B9_7F4A_7C15);
        let mut mixed = self.0;
        mixed = (mixed ^ (mixed >> 30)).wrapping_mul(0xBF58_476D_1CE4_E5B9);
        mixed = (mixed ^ (mixed >> 27)).wrapping_mul(0x94D0_49BB_1331_11EB);
        mixed ^ (mixed >> 31)
    }

    pub(crate) fn below(&mut self, bound: u64) -> u64 {
        self.next() % bound
    }
}

/// One thing that a controller does with its journal.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Step {
    Save,
    EraseAhead,
}

/// A journal in a chip, with the settings that should be in force.
struct Subject<const WRITE: usize, const ERASE: usize> {
    chip: NorChip,
    flash: Partition<WRITE, ERASE>,
    journal: Journal,
    stored: Stored,
    random: Random,
}

impl<const WRITE: usize, const ERASE: usize> Subject<WRITE, ERASE> {
    fn new(geometry: &'static Geometry, seed: u64) -> Self {
        let chip = NorChip::new(geometry, seed);
        let mut flash = chip
            .partition(Region::Journal)
            .expect("the geometry has a journal");
        let mut journal = Journal::open(&mut flash);
        let foreign = Change {
            key: FOREIGN,
            value: Some(b"kept by everybody"),
        };
        journal
            .save(&mut flash, &foreign, true)
            .expect("room in an empty journal");
        let stored = Stored::load(&journal, &mut flash);
        Self {
            chip,
            flash,
            journal,
            stored,
            random: Random(seed),
        }
    }

    /// Changes a few settings, as hosts do.
    fn change(&mut self) {
        let random = &mut self.random;
        for _ in 0..=random.below(3) {
            let row = &TABLE[random.below(TABLE.len() as u64) as usize];
            // A value that is not allowed changes nothing.
            let _ = self.stored.params.set(row.id, random.below(2) as u32);
            let _ = self.stored.params.set(row.id, random.next() as u32);
        }
        if random.below(4) == 0 {
            let which = Descriptor::ALL[random.below(6) as usize];
            let text = vec![b'a' + random.below(26) as u8; random.below(65) as usize];
            self.stored.descriptors.set(which, &text);
        }
        self.stored.number = 1 + (self.stored.number + random.below(61) as u8) % 62;
        self.stored.params = self.stored.params.persistent();
    }

    fn perform(&mut self, step: Step, stored: &Stored) -> Result<(), SaveError> {
        match step {
            Step::Save => self.journal.save(&mut self.flash, stored, true).map(|_| ()),
            Step::EraseAhead => self.journal.erase_next(&mut self.flash),
        }
    }

    fn load(&mut self) -> Stored {
        Stored::load(&self.journal, &mut self.flash)
    }

    /// The power comes back: which of the two sets is in force?
    fn restart(&mut self) -> Stored {
        self.chip.cut_at(None);
        self.chip.power_on();
        self.journal = Journal::open(&mut self.flash);
        self.load()
    }

    /// Restarts after a cut and judges what is in force.
    fn judge(&mut self, old: &Stored, new: &Stored, report: &mut Report) {
        report.cuts += 1;
        let misuses = violations(&self.chip);
        let loaded = self.restart();
        let foreign = self.journal.get(&mut self.flash, FOREIGN);
        if foreign.is_none_or(|value| value != b"kept by everybody"[..]) {
            report.wrong += 1;
        } else if loaded == *old {
            report.old += 1;
        } else if loaded == *new {
            report.new += 1;
        } else {
            report.wrong += 1;
        }
        for _ in 0..2 {
            self.chip.power_off();
            report.undecided += u64::from(self.restart() != loaded);
        }
        let next = Stored {
            number: 63,
            ..loaded.clone()
        };
        let saved = self.perform(Step::Save, &next);
        report.stuck += u64::from(saved.is_err() || self.load().number != 63);
        report.misuses += violations(&self.chip) - misuses;
    }

    /// Saves until the unit that comes next is in use: it must not be taken for erased if it is not.
    fn go_round(&mut self, report: &mut Report) {
        let misuses = violations(&self.chip);
        let erases = |chip: &NorChip| chip.erases(Region::Journal).iter().sum::<u32>();
        let before = erases(&self.chip);
        let mut stored = self.load();
        for number in (1..=62).cycle().take(400) {
            stored.number = number;
            let saved = self.perform(Step::Save, &stored);
            report.stuck += u64::from(saved.is_err());
            self.chip.power_off();
            report.wrong += u64::from(self.restart().number != number);
            if erases(&self.chip) > before {
                break;
            }
        }
        report.misuses += violations(&self.chip) - misuses;
    }

    /// What is to be in force after the next save.
    fn after(&self) -> Stored {
        Stored {
            sequence: self.journal.sequence() + 1,
            ..self.stored.clone()
        }
    }
}

/// Before, inside in several ways, and after.
fn points(ways: u64, seed: u64) -> impl Iterator<Item = CutPoint> {
    let inside =
        (0..ways).map(move |way| CutPoint::Inside(seed.wrapping_mul(31).wrapping_add(way)));
    [CutPoint::Before, CutPoint::After]
        .into_iter()
        .chain(inside)
}

/// Operations at the end of a save that are interrupted in more ways than the others.
const LAST_CELLS: u64 = 6;

/// Sweeps one geometry.
fn sweep<const WRITE: usize, const ERASE: usize>(
    geometry: &'static Geometry,
    extent: Extent,
) -> Report {
    let mut report = Report::default();
    let mut subject = Subject::<WRITE, ERASE>::new(geometry, 1);
    let every = (extent.saves / extent.pairs.max(1)).max(1);
    for at in 0..extent.saves {
        let ahead = subject.journal.wants_erase::<Partition<WRITE, ERASE>>()
            && subject.random.below(3) == 0;
        if ahead {
            step(&mut subject, Step::EraseAhead, extent, false, &mut report);
        }
        subject.change();
        let pairs = at % every == every - 1 && at / every < extent.pairs;
        step(&mut subject, Step::Save, extent, pairs, &mut report);
        report.saves += 1;
    }
    report.wraps = subject
        .chip
        .erases(Region::Journal)
        .into_iter()
        .min()
        .unwrap_or(0);
    report.with(at_random::<WRITE, ERASE>(geometry, extent.random))
}

/// Every cut of one step; at the end the step is carried out.
fn step<const WRITE: usize, const ERASE: usize>(
    subject: &mut Subject<WRITE, ERASE>,
    step: Step,
    extent: Extent,
    pairs: bool,
    report: &mut Report,
) {
    let (before, journal) = (subject.chip.save(), subject.journal);
    let old = subject.load();
    let stored = subject.stored.clone();
    let new = match step {
        Step::Save => subject.after(),
        Step::EraseAhead => old.clone(),
    };
    let first = subject.chip.operations();
    subject
        .perform(step, &stored)
        .expect("nothing stands in the way of a save");
    let end = subject.chip.operations();
    let (after, whole) = (subject.chip.save(), subject.journal);
    for operation in (first..end).step_by(if pairs { extent.stride } else { 1 }) {
        // An erase is one operation of many outcomes, and of a set the last cells decide.
        let ways = match step {
            Step::EraseAhead => 32 * extent.ways,
            Step::Save if operation + LAST_CELLS >= end => 8 * extent.ways,
            Step::Save => extent.ways,
        };
        for point in points(ways, operation) {
            subject.chip.restore(&before);
            subject.journal = journal;
            subject.chip.cut_at(Some(Cut { operation, point }));
            // The caller never learns what became of it.
            let _ = subject.perform(step, &stored);
            if pairs {
                second_cuts(subject, &old, &new, extent, report);
            } else {
                subject.judge(&old, &new, report);
            }
            if step == Step::EraseAhead {
                subject.go_round(report);
            }
        }
    }
    subject.chip.restore(&after);
    subject.journal = whole;
    subject.stored.sequence = subject.journal.sequence();
}

/// Every cut of the recovery from a cut.
fn second_cuts<const WRITE: usize, const ERASE: usize>(
    subject: &mut Subject<WRITE, ERASE>,
    old: &Stored,
    new: &Stored,
    extent: Extent,
    report: &mut Report,
) {
    let torn: NorState = subject.chip.save();
    subject.judge(old, new, report);
    subject.chip.restore(&torn);
    let first = subject.chip.operations();
    let _ = subject.restart();
    let end = subject.chip.operations();
    for operation in first..end {
        for point in points(extent.ways, operation) {
            subject.chip.restore(&torn);
            subject.chip.power_on();
            subject.chip.cut_at(Some(Cut { operation, point }));
            let _ = Journal::open(&mut subject.flash);
            subject.judge(old, new, report);
        }
    }
}

/// Saves with cuts at random, also several in a row: a controller on a loose wire.
fn at_random<const WRITE: usize, const ERASE: usize>(
    geometry: &'static Geometry,
    cuts: u32,
) -> Report {
    let mut report = Report::default();
    let mut subject = Subject::<WRITE, ERASE>::new(geometry, 2);
    while report.cuts < u64::from(cuts) {
        let old = subject.load();
        subject.change();
        let (stored, new) = (subject.stored.clone(), subject.after());
        arm(&mut subject);
        let saved = subject.perform(Step::Save, &stored);
        if saved.is_ok() && subject.chip.is_powered() {
            // In force already, and nothing may take it back.
            subject.chip.cut_at(None);
            report.wrong += u64::from(subject.load() != new);
            continue;
        }
        report.cuts += 1;
        while subject.random.below(3) == 0 {
            subject.chip.power_on();
            arm(&mut subject);
            let _ = Journal::open(&mut subject.flash);
        }
        let loaded = subject.restart();
        report.old += u64::from(loaded == old);
        report.new += u64::from(loaded == new);
        report.wrong += u64::from(loaded != old && loaded != new);
        subject.chip.power_off();
        report.undecided += u64::from(subject.restart() != loaded);
        subject.stored = loaded;
    }
    report.misuses += violations(&subject.chip);
    report
}

/// Accesses that a journal must not need: those that break the rules of flash, and other values over what a
/// cut has left invisible.
fn violations(chip: &NorChip) -> u64 {
    chip.misuses() + chip.overprogrammed().len() as u64
}

fn arm<const WRITE: usize, const ERASE: usize>(subject: &mut Subject<WRITE, ERASE>) {
    let random = &mut subject.random;
    let point = match random.below(4) {
        0 => CutPoint::Before,
        1 => CutPoint::After,
        _ => CutPoint::Inside(random.next()),
    };
    subject.chip.cut_at(Some(Cut {
        operation: subject.chip.operations() + random.below(120),
        point,
    }));
}

/// A chip's journal alone: the other regions only cost time.
macro_rules! journal_alone {
    ($name:ident, $regions:ident, $whole:expr) => {
        static $regions: [RegionGeometry; 1] = [$whole.regions[0]];
        static $name: Geometry = Geometry {
            regions: &$regions,
            ..$whole
        };
    };
}

journal_alone!(F405, F405_REGIONS, STM32F405);
journal_alone!(G474, G474_REGIONS, STM32G474);
journal_alone!(G431, G431_REGIONS, STM32G431);

/// Sweeps the journals of the STM32F405, the G474 and the G431, each in a thread of its own.
#[must_use]
pub fn sweep_all(extent: Extent) -> [(&'static str, Report); 3] {
    std::thread::scope(|scope| {
        let threads = [
            (
                F405.name,
                scope.spawn(move || sweep::<4, 0x4000>(&F405, extent)),
            ),
            (
                G474.name,
                scope.spawn(move || sweep::<8, 0x800>(&G474, extent)),
            ),
            (
                G431.name,
                scope.spawn(move || sweep::<8, 0x800>(&G431, extent)),
            ),
        ];
        threads.map(|(name, thread)| (name, thread.join().expect("a sweep has panicked")))
    })
}

/// What a day of changes has cost.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Day {
    /// The chip.
    pub chip: &'static str,
    /// The rule.
    pub rule: SaveRule,
    /// Sets written.
    pub saves: u32,
    /// Erases of each unit.
    pub erases: Vec<u32>,
}

/// 24 hours of changes under a rule, in virtual time, one change every `period`.
fn day<const WRITE: usize, const ERASE: usize>(
    geometry: &'static Geometry,
    rule: SaveRule,
    period: Duration,
) -> Day {
    let mut subject = Subject::<WRITE, ERASE>::new(geometry, 3);
    let mut timer = SaveTimer::new(rule);
    let end = Instant::ZERO + Duration::from_millis(24 * 3600 * 1000);
    let (mut now, mut value, first) = (Instant::ZERO, 0, subject.journal.sequence());
    while now <= end {
        value += 1;
        // Any value is allowed for a gain.
        let _ = subject.stored.params.set(ParameterId::Slot0P, value);
        timer.changed(now);
        let next = now + period;
        // A save takes no time here, which only makes the next one come sooner.
        while let Some(due) = timer.due().filter(|due| *due < next && *due <= end) {
            let stored = subject.stored.clone();
            timer.begin();
            subject
                .perform(Step::Save, &stored)
                .expect("nothing stands in the way of a save");
            timer.saved(due);
        }
        now = next;
    }
    Day {
        chip: geometry.name,
        rule,
        saves: subject.journal.sequence() - first,
        erases: subject.chip.erases(Region::Journal),
    }
}

/// Days of constant change: each rule on each chip, at the period of change that makes it write most.
#[must_use]
pub fn days(period: Duration) -> Vec<Day> {
    let quiet = (SaveRule::AfterQuiet, QUIET_TIME);
    let constant = (SaveRule::SinceLastSave, period);
    let mut days = Vec::new();
    for (rule, period) in [quiet, constant] {
        days.push(day::<4, 0x4000>(&F405, rule, period));
        days.push(day::<8, 0x800>(&G474, rule, period));
        days.push(day::<8, 0x800>(&G431, rule, period));
    }
    days
}
