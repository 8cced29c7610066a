//! Whole updates over a bus that loses frames, both ways.

use windlass_core::frame::Frame;
use windlass_core::management::vendor::CommandCode;
use windlass_core::management::wire::VendorStatus;

use crate::boot_bench::{F405, Image, f405};
use crate::journal_cuts::Random;

/// Frames out of which one is lost: 0.01 %.
pub const LOSS: u64 = 10_000;

/// What was seen.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Report {
    /// Updates.
    pub updates: u64,
    /// Frames that were lost.
    pub lost: u64,
    /// Pages that were sent again.
    pub repeated: u64,
    /// Updates that did not end in exactly the image.
    pub wrong: u64,
}

/// Flashes a controller with images of 31 pages, one after the other; one frame in `loss` is lost.
///
/// # Panics
/// If the images of the test can not be packed.
#[must_use]
pub fn run(updates: u64, loss: u64, seed: u64) -> Report {
    let mut bench = f405(seed);
    let pages: Vec<u8> = (0..31).collect();
    let images = [0x0117, 0x0118].map(|version| Image::small(&bench.hardware, version, &pages));
    let mut random = Random::new(seed);
    let mut report = Report::default();
    for image in images.iter().cycle().take(updates as usize) {
        bench.enter();
        let mut sent_all = true;
        for page in image.order() {
            sent_all &= send(&mut bench, image, page, &mut random, loss, &mut report);
        }
        bench.soft_reset();
        let whole = bench.version() == Some(image.header.identity.version) && bench.holds(image);
        report.wrong += u64::from(!(sent_all && whole));
        bench.application_answers();
        bench.power_cycle();
        report.updates += 1;
    }
    report
}

/// Sends a page until it is acknowledged.
fn send(
    bench: &mut F405,
    image: &Image,
    page: u8,
    random: &mut Random,
    loss: u64,
    report: &mut Report,
) -> bool {
    for attempt in 0..10 {
        report.repeated += u64::from(attempt > 0);
        let frames = bench.page_frames(page, &image.pages[&page]);
        bench.take_sent();
        for frame in frames {
            if random.below(loss) == 0 {
                report.lost += 1;
            } else {
                bench.feed(&frame);
            }
        }
        let status = bench.take_sent().first().and_then(code);
        if random.below(loss) == 0 {
            report.lost += 1;
        } else if status == Some(CommandCode::NoError) {
            return true;
        }
    }
    false
}

fn code(frame: &Frame) -> Option<CommandCode> {
    CommandCode::from_code(VendorStatus::parse(frame)?.code as u8)
}
