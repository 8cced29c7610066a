//! Faults in the transfer of a page: nothing wrong is ever programmed, the result is clear, and sending the
//! page again works.

use windlass_core::frame::Frame;
use windlass_core::management::vendor::{Command, CommandCode};
use windlass_tests::boot_bench::{F405, Image, f405};
use windlass_tests::lossy_updates;

/// Page that the faults hit.
const PAGE: u8 = 1;

/// A controller that waits for page 1, the image, and the frames of the page.
fn begun() -> (F405, Image, Vec<Frame>) {
    let mut bench = f405(1);
    let image = Image::with(&bench.hardware, 0x0118, &[0, PAGE], |page, at| {
        (at as u32 * 167 + u32::from(page) * 13 + (at as u32 >> 8)) as u8
    });
    assert_eq!(
        bench.send_page(30, &image.pages[&30], 0),
        Some(CommandCode::NoError)
    );
    // The session that the restarts of these tests go on with.
    bench.restart(true);
    let frames = bench.page_frames(PAGE, &image.pages[&PAGE]);
    assert_eq!(frames.len(), 1 + 513);
    (bench, image, frames)
}

/// Feeds frames, expects this result and an untouched flash, and then sends the page as it should be.
fn refused(bench: &mut F405, image: &Image, frames: &[Frame], expected: Option<CommandCode>) {
    let before = bench.chip.save();
    let operations = bench.chip.operations();
    bench.take_sent();
    for frame in frames {
        bench.feed(frame);
    }
    assert_eq!(bench.answer().map(|(code, _)| code), expected);
    assert_eq!(bench.chip.operations(), operations);
    let again = bench.send_page(PAGE, &image.pages[&PAGE], 0);
    assert_eq!(again, Some(CommandCode::NoError));
    bench.chip.restore(&before);
    // The loader's knowledge of what is stored goes back with the flash.
    bench.restart(true);
}

#[test]
fn each_frame_of_a_page_lost_doubled_or_shortened() {
    let (mut bench, image, frames) = begun();
    for at in 0..frames.len() {
        let mut lost = frames.clone();
        lost.remove(at);
        // Without the command the data mean nothing; without some data the device waits.
        refused(&mut bench, &image, &lost, None);
        let mut shortened = frames.clone();
        shortened[at] = shortened[at].shortened(shortened[at].dlc() - 1);
        refused(&mut bench, &image, &shortened, None);
        if at > 0 && at + 1 < frames.len() {
            let mut doubled = frames.clone();
            doubled.insert(at, frames[at]);
            let result = Some(CommandCode::DataReceivedMore);
            refused(&mut bench, &image, &doubled, result);
        }
    }
    // Doubled at the very end, the page is whole before the second copy comes, which means nothing.
    bench.take_sent();
    for frame in frames.iter().chain(frames.last()) {
        bench.feed(frame);
    }
    assert_eq!(bench.answer(), Some((CommandCode::NoError, vec![])));
    assert_eq!(
        bench.send_page(0, &image.pages[&0], 0),
        Some(CommandCode::NoError)
    );
    assert!(bench.holds(&image));
}

#[test]
fn each_frame_of_a_page_swapped_with_its_neighbour() {
    let (mut bench, image, frames) = begun();
    for at in 1..frames.len() - 1 {
        let mut swapped = frames.clone();
        assert_ne!(swapped[at].data(), swapped[at + 1].data());
        swapped.swap(at, at + 1);
        let result = Some(CommandCode::CrcMismatch);
        refused(&mut bench, &image, &swapped, result);
    }
    // The command after its first data: those are dropped, the rest is too short.
    let mut swapped = frames.clone();
    swapped.swap(0, 1);
    refused(&mut bench, &image, &swapped, None);
}

#[test]
fn another_command_in_between_ends_the_transfer() {
    let (mut bench, image, frames) = begun();
    for at in [1, 2, 256, 512, 513] {
        let version = bench.command_frame(Command::GetFirmwareVersion, 0, 0);
        let mut mixed = frames.clone();
        mixed.insert(at, version);
        let result = Some(CommandCode::NoError);
        // The answer is that of the command in between; of the page nothing is left.
        refused(&mut bench, &image, &mixed, result);
        bench.take_sent();
    }
}

#[test]
fn the_data_of_another_host_spoil_the_page_and_are_noticed() {
    let (mut bench, image, frames) = begun();
    let foreign = bench.data_frames(&[0xA5; 8])[0];
    for at in [1, 2, 256, 513] {
        let mut mixed = frames.clone();
        mixed.insert(at, foreign);
        let result = Some(CommandCode::DataReceivedMore);
        refused(&mut bench, &image, &mixed, result);
        let mut replaced = frames.clone();
        replaced[at] = foreign.shortened(frames[at].dlc());
        let result = Some(CommandCode::CrcMismatch);
        refused(&mut bench, &image, &replaced, result);
    }
}

#[test]
fn bus_off_in_the_middle_ends_the_transfer_and_the_session() {
    let (mut bench, image, frames) = begun();
    let operations = bench.chip.operations();
    for frame in &frames[..300] {
        bench.feed(frame);
    }
    bench.lose_bus();
    for frame in &frames[300..] {
        bench.feed(frame);
    }
    assert_eq!(bench.answer(), None);
    assert_eq!(bench.chip.operations(), operations);
    // In the new session the update goes on where it was.
    for page in [PAGE, 0] {
        assert_eq!(
            bench.send_page(page, &image.pages[&page], 0),
            Some(CommandCode::NoError)
        );
    }
    bench.soft_reset();
    assert!(bench.holds(&image));
}

#[test]
fn updates_over_a_bus_that_loses_frames_end_in_the_image() {
    // Ten times the loss of the whole run, so that something is lost in these few.
    let report = lossy_updates::run(20, lossy_updates::LOSS / 10, 3);
    assert!(report.lost > 50, "{report:?}");
    assert_eq!(report.wrong, 0, "{report:?}");
}
