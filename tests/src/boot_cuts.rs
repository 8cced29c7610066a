//! Updates under power cuts (I6): whole lives of an image, cut before, inside and after every flash
//! operation.
//!
//! After each cut the power comes back and the bootloader decides. Whatever it starts must be exactly the
//! old or exactly the new image; whatever state it is in, an update by the bus must lead to a running
//! image again; and the settings must be exactly those before or after the save that was cut.

use std::collections::BTreeMap;

use windlass_core::boot::image::{Hardware, PAGE_SIZE};
use windlass_core::management::vendor::{Command, CommandCode, Descriptor};
use windlass_core::params::Stored;
use windlass_core::params::table::ParameterId;
use windlass_core::reset::ResetCause;
use windlass_sim::nor::{Cut, CutPoint, NorState, Region};

use crate::boot_bench::{Bench, Image, f405, g431, g474};
use crate::journal_cuts::Random;

/// Versions of the images: the old one, the new one, and the one that is flashed after a cut.
const OLD: u16 = 0x0117;
const NEW: u16 = 0x0118;
const RESCUE: u16 = 0x0201;

/// One step of a controller's life.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Step {
    /// Into the bootloader, if it does not run already.
    Enter,
    /// A page of the new image, with the answer that is due if nothing was cut.
    Page(u8, CommandCode),
    /// A page whose CRC is wrong.
    BadPage(u8),
    /// The pages of the new image that the bootloader does not report as stored.
    Resume,
    /// `vcmdSoftReset`.
    SoftReset,
    /// The application answers a host.
    Answer,
    /// The application keeps changed settings.
    Save,
    /// Power off and on.
    PowerCycle,
    /// A reset by the watchdog.
    Watchdog,
    /// `vcmdRestoreFallback`.
    Restore,
}

use Step::{Answer, BadPage, Enter, PowerCycle, Resume, Save, SoftReset, Watchdog};

const DONE: CommandCode = CommandCode::NoError;
/// Every page, and the application runs.
const UPDATE: [Step; 5] = [
    Enter,
    Step::Page(30, DONE),
    Step::Page(1, DONE),
    Step::Page(0, DONE),
    SoftReset,
];
/// The application answers, and the next boot copies it to the fallback slot.
const SETTLE: [Step; 2] = [Answer, PowerCycle];

/// A life that is swept.
#[derive(Clone, Debug)]
pub struct Scenario {
    /// Its name.
    pub name: &'static str,
    /// Versions before and after; 0 = an erased chip.
    pub(crate) from: u16,
    pub(crate) to: u16,
    pub(crate) steps: Vec<Step>,
}

/// Every scenario of the sweep.
#[must_use]
pub fn scenarios() -> Vec<Scenario> {
    let scenario = |name, from, to, parts: &[&[Step]]| Scenario {
        name,
        from,
        to,
        steps: parts.concat(),
    };
    let incomplete = Step::Page(0, CommandCode::ImageIncomplete);
    vec![
        scenario("fresh", 0, NEW, &[&UPDATE, &SETTLE]),
        scenario("upgrade", OLD, NEW, &[&UPDATE, &SETTLE]),
        scenario("same version", OLD, OLD, &[&UPDATE, &SETTLE]),
        scenario("downgrade", NEW, OLD, &[&UPDATE, &SETTLE]),
        scenario(
            "missing page",
            OLD,
            NEW,
            &[
                &[Enter, Step::Page(30, DONE), incomplete, SoftReset],
                &[Step::Page(1, DONE), SoftReset],
                &SETTLE,
            ],
        ),
        scenario(
            "page with a bad CRC",
            OLD,
            NEW,
            &[
                &[Enter, BadPage(30), Step::Page(30, DONE), BadPage(1)],
                &[Step::Page(1, DONE), BadPage(0), Step::Page(0, DONE)],
                &[SoftReset],
                &SETTLE,
            ],
        ),
        scenario(
            "interrupted, then repeated",
            OLD,
            NEW,
            &[
                &[Enter, Step::Page(30, DONE), Step::Page(1, DONE), PowerCycle],
                &UPDATE,
                &SETTLE,
            ],
        ),
        scenario(
            "interrupted, then resumed",
            OLD,
            NEW,
            &[
                &[Enter, Step::Page(30, DONE), Step::Page(1, DONE), PowerCycle],
                &[Enter, Resume, SoftReset],
                &SETTLE,
            ],
        ),
        scenario(
            "settings saved in trial",
            OLD,
            NEW,
            &[&UPDATE, &[Save, Watchdog], &SETTLE],
        ),
        scenario(
            "trial failed three times",
            OLD,
            NEW,
            &[&UPDATE, &[Watchdog, Watchdog, Watchdog, PowerCycle]],
        ),
        scenario(
            "restore by command",
            OLD,
            NEW,
            &[&UPDATE, &[Enter, Step::Restore, SoftReset], &SETTLE],
        ),
    ]
}

/// What a sweep has seen.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Report {
    /// Flash operations of the scenario when nothing is cut.
    pub operations: u64,
    /// Cuts: single ones, and firsts of pairs.
    pub cuts: u64,
    /// Second cuts, during the recovery from the first.
    pub pairs: u64,
    /// First boots after a cut that started the old image.
    pub old: u64,
    /// That started the new one.
    pub new: u64,
    /// That stayed in the bootloader.
    pub stayed: u64,
    /// Boots of anything that is neither the old nor the new image whole.
    pub wrong: u64,
    /// Controllers that could not be flashed any more.
    pub bricks: u64,
    /// Settings that were neither those before nor those after a save.
    pub settings: u64,
    /// Accesses that break the rules of flash.
    pub misuses: u64,
    /// Units of a page that were programmed over another value which a cut has left invisible. Nobody can
    /// avoid them on a chip that erases a slot as a whole; what comes of them must be harmless.
    pub overprogrammed: u64,
}

impl Report {
    /// Nothing went wrong.
    #[must_use]
    pub const fn is_clean(&self) -> bool {
        self.wrong == 0 && self.bricks == 0 && self.settings == 0 && self.misuses == 0
    }

    /// Both together.
    #[must_use]
    pub const fn with(self, other: Self) -> Self {
        Self {
            operations: self.operations + other.operations,
            cuts: self.cuts + other.cuts,
            pairs: self.pairs + other.pairs,
            old: self.old + other.old,
            new: self.new + other.new,
            stayed: self.stayed + other.stayed,
            wrong: self.wrong + other.wrong,
            bricks: self.bricks + other.bricks,
            settings: self.settings + other.settings,
            misuses: self.misuses + other.misuses,
            overprogrammed: self.overprogrammed + other.overprogrammed,
        }
    }
}

/// How much is swept.
#[derive(Clone, Copy, Debug)]
pub struct Extent {
    /// Every n-th operation only.
    pub stride: u64,
    /// Different ways to interrupt each operation.
    pub ways: u64,
    /// Second cuts for each scenario and chip.
    pub pairs: u64,
}

/// The settings before and after the save of a scenario.
fn settings(after: bool) -> Stored {
    let mut stored = Stored {
        number: if after { 9 } else { 5 },
        ..Stored::default()
    };
    let name = if after { "after the save" } else { "before" };
    stored
        .descriptors
        .set(Descriptor::DeviceName, name.as_bytes());
    // A value that the table refuses would leave the default, the same in both.
    let _ = stored
        .params
        .set(ParameterId::BrakeAtNeutral, u32::from(after));
    stored
}

/// A scenario on a chip.
struct Subject<const W: usize, const S: usize, const J: usize> {
    bench: Bench<W, S, J>,
    images: BTreeMap<u16, Image>,
    scenario: Scenario,
    /// The chip before the first step.
    begin: NorState,
}

impl<const W: usize, const S: usize, const J: usize> Subject<W, S, J> {
    fn new(mut bench: Bench<W, S, J>, scenario: &Scenario) -> Self {
        let image = |version| {
            let image = Image::small(&bench.hardware, version, &[0, 1]);
            (version, image)
        };
        let images: BTreeMap<_, _> = [OLD, NEW, RESCUE].map(image).into();
        if let Some(image) = images.get(&scenario.from) {
            assert!(bench.enter(), "an erased chip stays in the bootloader");
            assert_eq!(bench.send_image(image), Some(DONE));
            bench.soft_reset();
            bench.application_answers();
            bench.application_saves(&settings(false));
            bench.power_cycle();
        }
        let begin = bench.chip.save();
        Self {
            bench,
            images,
            scenario: scenario.clone(),
            begin,
        }
    }

    /// Goes through the steps until they end or the power is cut. True if every answer was the expected
    /// one.
    fn live(&mut self) -> bool {
        let image = self.images[&self.scenario.to].clone();
        let bench = &mut self.bench;
        let mut expected = true;
        for at in 0..self.scenario.steps.len() {
            match self.scenario.steps[at] {
                Enter => {
                    bench.enter();
                }
                Step::Page(page, code) => {
                    expected &= bench.send_page(page, &image.pages[&page], 0) == Some(code);
                }
                BadPage(page) => {
                    let code = bench.send_page(page, &image.pages[&page], 1);
                    expected &= code == Some(CommandCode::CrcMismatch);
                }
                Resume => {
                    let stored = bench.status().map_or(0, |status| status.stored);
                    for page in image.order() {
                        if stored >> page & 1 == 0 {
                            expected &= bench.send_page(page, &image.pages[&page], 0) == Some(DONE);
                        }
                    }
                }
                SoftReset => bench.soft_reset(),
                Answer => bench.application_answers(),
                Save => bench.application_saves(&settings(true)),
                PowerCycle => bench.power_cycle(),
                Watchdog => bench.reset(ResetCause::Watchdog),
                Step::Restore => {
                    bench.transact(Command::RestoreFallback, (0, 0), &[]);
                }
            }
            if !bench.chip.is_powered() {
                break;
            }
        }
        expected
    }

    fn rewind(&mut self) {
        self.bench.chip.restore(&self.begin);
        self.bench.power_cycle();
    }

    /// Cuts the power once, and looks at what comes after.
    fn cut(&mut self, cut: Cut, second: Option<Cut>, report: &mut Report) {
        self.rewind();
        let begin = self.bench.chip.operations();
        let from = |cut: Cut| Cut {
            operation: cut.operation + begin,
            ..cut
        };
        let misuses = self.bench.chip.misuses();
        self.bench.chip.cut_at(Some(from(cut)));
        self.live();
        self.bench.chip.cut_at(None);
        let allowed = [self.scenario.from, self.scenario.to];
        if let Some(second) = second {
            let operation = self.bench.chip.operations() + second.operation;
            self.bench.chip.cut_at(Some(Cut {
                operation,
                ..second
            }));
            report.pairs += 1;
            self.bench.power_cycle();
            self.rescue();
            self.bench.chip.cut_at(None);
            self.bench.power_cycle();
            self.judge(&[allowed[0], allowed[1], RESCUE], report);
        } else {
            report.cuts += 1;
            self.bench.power_cycle();
            self.judge(&allowed, report);
            match self.bench.version() {
                Some(version) if version == self.scenario.to => report.new += 1,
                Some(_) => report.old += 1,
                None => report.stayed += 1,
            }
        }
        // What reads differently from one time to the next must not lead to anything else either.
        self.bench.power_cycle();
        self.judge(&[allowed[0], allowed[1], RESCUE], report);
        // One half of the hosts goes on where it was, the other one begins anew.
        if cut.operation.is_multiple_of(2) {
            self.resume();
            self.judge(&[allowed[0], allowed[1], RESCUE], report);
        }
        let rescued = (0..2).any(|_| self.rescue());
        report.bricks += u64::from(!rescued);
        self.judge(&[RESCUE], report);
        report.misuses += self.bench.chip.misuses() - misuses;
        for (region, offset) in self.bench.chip.overprogrammed() {
            // Records decide what runs: none may depend on a unit like that.
            let page = match region {
                Region::Journal => false,
                Region::Application | Region::Fallback => {
                    offset < self.bench.hardware.pages.count_ones() as usize * PAGE_SIZE
                }
            };
            report.overprogrammed += u64::from(page);
            report.misuses += u64::from(!page);
        }
    }

    /// Sends the pages that are missing of an update that has begun, whatever is answered, and restarts.
    fn resume(&mut self) {
        let image = self.images[&self.scenario.to].clone();
        let bench = &mut self.bench;
        bench.enter();
        let status = bench.status().unwrap_or_default();
        for page in image.order() {
            if status.wanted != 0 && (status.wanted & !status.stored) >> page & 1 != 0 {
                bench.send_page(page, &image.pages[&page], 0);
            }
        }
        bench.soft_reset();
    }

    /// Flashes another image by the bus; true if it runs afterwards, also from power-on.
    fn rescue(&mut self) -> bool {
        let image = self.images[&RESCUE].clone();
        let bench = &mut self.bench;
        bench.enter();
        bench.send_image(&image);
        bench.soft_reset();
        bench.application_answers();
        let runs = bench.version() == Some(RESCUE);
        bench.power_cycle();
        runs && bench.version() == Some(RESCUE)
    }

    /// What runs must be whole, and one of these; the settings must be whole.
    fn judge(&mut self, allowed: &[u16], report: &mut Report) {
        if let Some(version) = self.bench.version() {
            let exact = allowed.contains(&version)
                && (0..2).all(|_| self.bench.holds(&self.images[&version]));
            report.wrong += u64::from(!exact);
        }
        if self.scenario.from == 0 {
            return;
        }
        let mut loaded = self.bench.settings();
        loaded.sequence = 0;
        let saved = self.scenario.steps.contains(&Save);
        let whole = loaded == settings(false) || saved && loaded == settings(true);
        report.settings += u64::from(!whole);
    }
}

/// Sweeps one scenario on one chip.
fn sweep<const W: usize, const S: usize, const J: usize>(
    bench: Bench<W, S, J>,
    scenario: &Scenario,
    extent: Extent,
    seed: u64,
) -> Report {
    let mut subject = Subject::new(bench, scenario);
    subject.rewind();
    let begin = subject.bench.chip.operations();
    let expected = subject.live();
    let operations = subject.bench.chip.operations() - begin;
    let mut report = Report {
        operations,
        // A scenario that does not go as it should is no scenario.
        wrong: u64::from(!expected),
        ..Report::default()
    };
    subject.judge(&[scenario.from, scenario.to], &mut report);
    let mut random = Random::new(seed);
    let offset = random.below(extent.stride);
    for operation in (offset..operations).step_by(extent.stride as usize) {
        let inside = (0..extent.ways).map(|_| CutPoint::Inside(random.next()));
        let points: Vec<_> = [CutPoint::Before, CutPoint::After]
            .into_iter()
            .chain(inside)
            .collect();
        for point in points {
            subject.cut(Cut { operation, point }, None, &mut report);
        }
    }
    let point = |random: &mut Random| match random.below(4) {
        0 => CutPoint::Before,
        1 => CutPoint::After,
        _ => CutPoint::Inside(random.next()),
    };
    for _ in 0..extent.pairs {
        let first = Cut {
            operation: random.below(operations),
            point: point(&mut random),
        };
        // A recovery has about as many operations as an update.
        let second = Cut {
            operation: random.below(operations),
            point: point(&mut random),
        };
        subject.cut(first, Some(second), &mut report);
    }
    report
}

/// A chip of the sweep.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Chip {
    /// One erase unit per slot.
    F405,
    /// Small erase units, fallback.
    G474,
    /// Small erase units, no fallback.
    G431,
}

impl Chip {
    /// Every chip.
    pub const ALL: [Self; 3] = [Self::F405, Self::G474, Self::G431];

    /// Its name.
    #[must_use]
    pub const fn name(self) -> &'static str {
        match self {
            Self::F405 => Hardware::F405.name,
            Self::G474 => Hardware::G474.name,
            Self::G431 => Hardware::G431.name,
        }
    }

    /// Sweeps a scenario.
    #[must_use]
    pub fn sweep(self, scenario: &Scenario, extent: Extent, seed: u64) -> Report {
        match self {
            Self::F405 => sweep(f405(seed), scenario, extent, seed),
            Self::G474 => sweep(g474(seed), scenario, extent, seed),
            Self::G431 => sweep(g431(seed), scenario, extent, seed),
        }
    }
}
