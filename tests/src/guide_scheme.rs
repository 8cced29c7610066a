//! The update scheme of the DMC60C guide ("Firmware Updates"), for comparison only: pages are erased and
//! written in place, page 0 with the reset vector among them, and the last two words of page 30 are held in
//! RAM until page 0 is in. A version word other than 0xFFFF makes the application valid.

use std::collections::BTreeMap;
use std::fmt;

use embedded_storage::nor_flash::{NorFlash, ReadNorFlash};
use windlass_core::boot::image::{Hardware, LAST_PAGE, PAGE_SIZE, Page};
use windlass_sim::nor::{Cut, CutPoint, NorChip, Partition, Region, STM32G474};

use crate::boot_bench::Image;
use crate::boot_cuts::{Extent, Scenario, Step};
use crate::journal_cuts::Random;

/// What the processor starts from. On the DMC60C it stands in page 0; without it nothing runs any more.
const RESET_VECTOR: [u8; 8] = *b"go boot!";
/// Bytes that are held back.
const HELD: usize = 8;
/// Erase and program units of the STM32G474.
const WRITE: usize = 8;
const ERASE: usize = 2_048;

/// What the sweep has seen.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Report {
    /// Flash operations of the scenario.
    pub operations: u64,
    /// Cuts.
    pub cuts: u64,
    /// Boots of anything but the old or the new image whole.
    pub wrong: u64,
    /// Controllers without a reset vector: nothing can be flashed over CAN any more.
    pub bricks: u64,
}

impl Report {
    /// Both together.
    #[must_use]
    pub const fn with(self, other: Self) -> Self {
        Self {
            operations: self.operations + other.operations,
            cuts: self.cuts + other.cuts,
            wrong: self.wrong + other.wrong,
            bricks: self.bricks + other.bricks,
        }
    }
}

impl fmt::Display for Report {
    fn fmt(&self, formatter: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(
            formatter,
            "{} operations, {} cuts, {} wrong boots, {} bricks",
            self.operations, self.cuts, self.wrong, self.bricks
        )
    }
}

struct Device {
    chip: NorChip,
    flash: Partition<WRITE, ERASE>,
    held: Option<[u8; HELD]>,
}

impl Device {
    fn new(seed: u64) -> Self {
        let chip = NorChip::new(&STM32G474, seed);
        let flash = chip
            .partition(Region::Application)
            .expect("the chip has an application slot");
        let mut device = Self {
            chip,
            flash,
            held: None,
        };
        device.program(0, &RESET_VECTOR);
        device
    }

    fn program(&mut self, at: usize, bytes: &[u8]) {
        for (unit, offset) in bytes.chunks(WRITE).zip((at..).step_by(WRITE)) {
            if unit.iter().any(|byte| *byte != 0xFF) {
                // Without power nothing happens, and that is what is tested.
                let _ = self.flash.write(offset as u32, unit);
            }
        }
    }

    fn read(&mut self, at: usize) -> [u8; 8] {
        let mut bytes = [0; 8];
        let read = self.flash.read(at as u32, &mut bytes);
        read.map_or([0; 8], |()| bytes)
    }

    fn write_page(&mut self, page: u8, content: &Page) {
        let at = usize::from(page) * PAGE_SIZE;
        let mut content = *content;
        let last = usize::from(LAST_PAGE) * PAGE_SIZE + PAGE_SIZE - HELD;
        match page {
            0 => content[..8].copy_from_slice(&self.read(0)),
            LAST_PAGE => {
                self.held = content.last_chunk().copied();
                content[PAGE_SIZE - HELD..].fill(0xFF);
            }
            _ => {}
        }
        let _ = self.flash.erase(at as u32, (at + PAGE_SIZE) as u32);
        self.program(at, &content);
        if page == 0
            && let Some(held) = self.held.take()
        {
            self.program(last, &held);
        }
    }

    fn version_word(&mut self) -> u16 {
        let [.., low, high, _, _] =
            self.read(usize::from(LAST_PAGE) * PAGE_SIZE + PAGE_SIZE - HELD);
        u16::from_le_bytes([low, high])
    }

    /// True if the pages are this image's, apart from the reset vector.
    fn holds(&mut self, image: &Image) -> bool {
        let mut bytes = [0; PAGE_SIZE];
        image.pages.iter().all(|(page, content)| {
            let at = usize::from(*page) * PAGE_SIZE;
            let skip = if *page == 0 { 8 } else { 0 };
            self.flash.read(at as u32, &mut bytes).is_ok() && bytes[skip..] == content[skip..]
        })
    }

    fn live(&mut self, steps: &[Step], image: &Image) {
        for step in steps {
            match step {
                Step::Page(page, _) => self.write_page(*page, &image.pages[page]),
                // It has no way to resume.
                Step::Resume => {
                    for page in image.order() {
                        self.write_page(page, &image.pages[&page]);
                    }
                }
                Step::SoftReset | Step::PowerCycle | Step::Watchdog => self.held = None,
                // A wrong CRC changes nothing, and the rest touches the settings only.
                _ => {}
            }
            if !self.chip.is_powered() {
                return;
            }
        }
    }
}

/// Sweeps a scenario.
///
/// # Panics
/// If a scenario names a version that the sweep has no image of.
#[must_use]
pub fn sweep(scenario: &Scenario, extent: Extent, seed: u64) -> Report {
    let images: BTreeMap<u16, Image> = [scenario.from, scenario.to]
        .into_iter()
        .filter(|version| *version != 0)
        .map(|version| (version, Image::small(&Hardware::G474, version, &[0, 1])))
        .collect();
    let mut device = Device::new(seed);
    if let Some(old) = images.get(&scenario.from) {
        for page in old.order() {
            device.write_page(page, &old.pages[&page]);
        }
    }
    let new = &images[&scenario.to];
    let begin = device.chip.save();
    let first = device.chip.operations();
    device.live(&scenario.steps, new);
    let mut report = Report {
        operations: device.chip.operations() - first,
        ..Report::default()
    };
    let mut random = Random::new(seed);
    for operation in (0..report.operations).step_by(extent.stride as usize) {
        let inside = (0..extent.ways).map(|_| CutPoint::Inside(random.next()));
        let points: Vec<_> = [CutPoint::Before, CutPoint::After]
            .into_iter()
            .chain(inside)
            .collect();
        for point in points {
            device.chip.restore(&begin);
            device.chip.cut_at(Some(Cut {
                operation: first + operation,
                point,
            }));
            device.held = None;
            device.live(&scenario.steps, new);
            device.chip.cut_at(None);
            device.held = None;
            device.chip.power_off();
            device.chip.power_on();
            report.cuts += 1;
            if device.read(0) != RESET_VECTOR {
                report.bricks += 1;
            } else if device.version_word() != 0xFFFF {
                let whole = images.values().any(|image| device.holds(image));
                report.wrong += u64::from(!whole);
            }
        }
    }
    report
}
