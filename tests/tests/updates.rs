//! The bootloader's page protocol and the life of an image, on every chip.

use windlass_core::boot::image::{Hardware, LAST_PAGE, PAGE_SIZE};
use windlass_core::boot::slots::{CRASH_LIMIT, Refresh};
use windlass_core::boot::status::Reason;
use windlass_core::management::vendor::{Command, CommandCode};
use windlass_core::reset::ResetCause;
use windlass_sim::nor::{Cut, CutPoint, Region};
use windlass_tests::boot_bench::{Bench, Image, Running, f405, g431, g474};

/// Runs a test on all three chips.
macro_rules! on_every_chip {
    ($name:ident, $bench:ident, $body:block) => {
        #[test]
        fn $name() {
            {
                let mut $bench = f405(1);
                $body
            }
            {
                let mut $bench = g474(2);
                $body
            }
            {
                let mut $bench = g431(3);
                $body
            }
        }
    };
}

fn reason<const W: usize, const S: usize, const J: usize>(
    bench: &Bench<W, S, J>,
) -> Option<Reason> {
    match &bench.running {
        Some(Running::Loader(_, reason)) => Some(*reason),
        _ => None,
    }
}

/// Installs an image, which runs and answers, and restarts once more.
fn install<const W: usize, const S: usize, const J: usize>(
    bench: &mut Bench<W, S, J>,
    image: &Image,
) {
    assert!(bench.enter());
    assert_eq!(bench.send_image(image), Some(CommandCode::NoError));
    bench.soft_reset();
    assert_eq!(bench.version(), Some(image.header.identity.version));
    assert!(bench.holds(image));
    bench.application_answers();
    bench.power_cycle();
    assert_eq!(bench.version(), Some(image.header.identity.version));
    assert_eq!(bench.chip.misuses(), 0);
}

on_every_chip!(
    an_erased_controller_is_flashed_and_starts_its_image,
    bench,
    {
        assert_eq!(reason(&bench), Some(Reason::Empty));
        let image = Image::small(&bench.hardware, 0x0117, &[0, 1]);
        install(&mut bench, &image);
        let status = {
            bench.enter();
            bench.status().unwrap()
        };
        assert_eq!(status.application, 0x0117);
        assert!(status.confirmed);
        assert_eq!(status.reason, Reason::Requested);
        let expected = if bench.slots().fallback.is_some() {
            0x0117
        } else {
            0xFFFF
        };
        assert_eq!(status.fallback, expected);
    }
);

on_every_chip!(
    the_version_is_unknown_from_page_30_on_until_page_0_is_in,
    bench,
    {
        let old = Image::small(&bench.hardware, 0x0117, &[0, 1]);
        install(&mut bench, &old);
        bench.enter();
        let new = Image::small(&bench.hardware, 0x0118, &[0, 1]);
        let version = |bench: &mut Bench<_, _, _>| {
            let (code, data) = bench
                .transact(Command::GetFirmwareVersion, (0, 0), &[])
                .unwrap();
            assert_eq!(code, CommandCode::NoError);
            u16::from_le_bytes([data[2], data[3]])
        };
        assert_eq!(version(&mut bench), 0x0117);
        for page in new.order() {
            assert_eq!(
                bench.send_page(page, &new.pages[&page], 0),
                Some(CommandCode::NoError)
            );
            let expected = if page == 0 { 0x0118 } else { 0xFFFF };
            assert_eq!(version(&mut bench), expected, "after page {page}");
        }
    }
);

on_every_chip!(a_page_with_a_wrong_crc_changes_nothing, bench, {
    let old = Image::small(&bench.hardware, 0x0117, &[0, 1]);
    install(&mut bench, &old);
    bench.enter();
    let new = Image::small(&bench.hardware, 0x0118, &[0, 1]);
    let before = bench.chip.operations();
    let code = bench.send_page(LAST_PAGE, &new.pages[&LAST_PAGE], 1);
    assert_eq!(code, Some(CommandCode::CrcMismatch));
    assert_eq!(bench.chip.operations(), before);
    assert_eq!(bench.status().unwrap().application, 0x0117);
    // The other variant of the CRC is accepted.
    let mut data = new.pages[&LAST_PAGE].to_vec();
    data.extend_from_slice(&windlass_core::crc::iso_hdlc(&data).to_le_bytes());
    let answer = bench.transact(Command::EraseWriteFlashPage, (0, 30), &data);
    assert_eq!(answer, Some((CommandCode::NoError, vec![])));
});

on_every_chip!(image_types_and_page_numbers_of_the_guide, bench, {
    for (image, page, expected) in [
        (1, 0, Some(CommandCode::BadParameter)),
        (2, 0, Some(CommandCode::BadParameter)),
        (3, 0, Some(CommandCode::BadParameter)),
        (0, 31, Some(CommandCode::BadParameter)),
        (0, 0xFFFF, Some(CommandCode::BadParameter)),
        (0, 30, None),
        (0, 0, None),
    ] {
        let answer = bench.transact(Command::EraseWriteFlashPage, (image, page), &[]);
        assert_eq!(answer.map(|(code, _)| code), expected, "{image} {page}");
    }
});

on_every_chip!(a_wrong_image_is_refused_before_anything_is_erased, bench, {
    let old = Image::small(&bench.hardware, 0x0117, &[0, 1]);
    install(&mut bench, &old);
    bench.enter();
    let other = if bench.hardware == Hardware::F405 {
        Hardware::G474
    } else {
        Hardware::F405
    };
    let wrong = Image::small(&other, 0x0118, &[0, 1]);
    let before = bench.chip.operations();
    assert_eq!(bench.send_image(&wrong), Some(CommandCode::WrongHardware));
    let nothing = Box::new([0xA5; PAGE_SIZE]);
    assert_eq!(
        bench.send_page(LAST_PAGE, &nothing, 0),
        Some(CommandCode::NoImage)
    );
    assert_eq!(bench.chip.operations(), before);
    bench.soft_reset();
    assert_eq!(bench.version(), Some(0x0117));
});

on_every_chip!(pages_that_do_not_follow_are_refused, bench, {
    let image = Image::small(&bench.hardware, 0x0118, &[0, 1]);
    let page = Box::new([0x11; PAGE_SIZE]);
    // Nothing without page 30, nothing that the header does not name, nothing else in a page's place.
    assert_eq!(
        bench.send_page(1, &image.pages[&1], 0),
        Some(CommandCode::PageOrder)
    );
    let last = &image.pages[&LAST_PAGE];
    assert_eq!(
        bench.send_page(LAST_PAGE, last, 0),
        Some(CommandCode::NoError)
    );
    assert_eq!(bench.send_page(2, &page, 0), Some(CommandCode::PageOrder));
    assert_eq!(
        bench.send_page(1, &image.pages[&1], 0),
        Some(CommandCode::NoError)
    );
    let before = bench.chip.operations();
    assert_eq!(
        bench.send_page(1, &image.pages[&1], 0),
        Some(CommandCode::NoError)
    );
    assert_eq!(bench.send_page(1, &page, 0), Some(CommandCode::PageOrder));
    assert_eq!(bench.chip.operations(), before);
});

on_every_chip!(
    page_0_with_pages_missing_says_so_and_the_last_one_commits,
    bench,
    {
        let image = Image::small(&bench.hardware, 0x0118, &[0, 1]);
        for (page, code) in [
            (30, CommandCode::NoError),
            (0, CommandCode::ImageIncomplete),
        ] {
            assert_eq!(bench.send_page(page, &image.pages[&page], 0), Some(code));
        }
        assert_eq!(bench.status().unwrap().application, 0xFFFF);
        bench.soft_reset();
        assert_eq!(reason(&bench), Some(Reason::UpdateIncomplete));
        let status = bench.status().unwrap();
        assert_eq!((status.stored, status.wanted), (1 | 1 << 30, 3 | 1 << 30));
        assert_eq!(
            bench.send_page(1, &image.pages[&1], 0),
            Some(CommandCode::NoError)
        );
        bench.soft_reset();
        assert_eq!(bench.version(), Some(0x0118));
    }
);

on_every_chip!(an_update_goes_on_after_a_power_cut_between_pages, bench, {
    let image = Image::small(&bench.hardware, 0x0118, &[0, 1, 2]);
    for page in [30, 2] {
        bench.send_page(page, &image.pages[&page], 0);
    }
    bench.power_cycle();
    let (code, data) = bench.transact(Command::GetPageCrcs, (0, 0), &[]).unwrap();
    assert_eq!((code, data.len()), (CommandCode::NoError, 124));
    for (page, bytes) in data.chunks(4).enumerate() {
        let crc = u32::from_le_bytes(bytes.try_into().unwrap());
        let expected = match page {
            2 | 30 => windlass_core::crc::page_transfer(&image.pages[&(page as u8)][..]),
            _ => 0,
        };
        assert_eq!(crc, expected, "page {page}");
    }
    for page in [1, 0] {
        assert_eq!(
            bench.send_page(page, &image.pages[&page], 0),
            Some(CommandCode::NoError)
        );
    }
    bench.soft_reset();
    assert_eq!(bench.version(), Some(0x0118));
    assert!(bench.holds(&image));
});

on_every_chip!(three_failures_in_trial_put_the_old_image_back, bench, {
    let old = Image::small(&bench.hardware, 0x0117, &[0, 1]);
    let new = Image::small(&bench.hardware, 0x0118, &[0, 2]);
    install(&mut bench, &old);
    bench.enter();
    bench.send_image(&new);
    bench.soft_reset();
    // A power cut is no failure.
    bench.power_cycle();
    for _ in 0..2 {
        bench.reset(ResetCause::Watchdog);
        assert_eq!(bench.version(), Some(0x0118));
    }
    bench.reset(ResetCause::ProcessorFault);
    if bench.slots().fallback.is_some() {
        assert_eq!(bench.version(), Some(0x0117));
        assert!(bench.holds(&old));
        bench.reset(ResetCause::Watchdog);
        assert_eq!(bench.version(), Some(0x0117), "it was confirmed before");
    } else {
        assert_eq!(reason(&bench), Some(Reason::TrialFailed));
        bench.power_cycle();
        assert_eq!(reason(&bench), Some(Reason::TrialFailed));
        bench.soft_reset();
        assert_eq!(bench.version(), Some(0x0118), "an explicit order starts it");
    }
});

on_every_chip!(a_confirmed_image_is_never_replaced_by_failures, bench, {
    let old = Image::small(&bench.hardware, 0x0117, &[0, 1]);
    let new = Image::small(&bench.hardware, 0x0118, &[0, 2]);
    install(&mut bench, &old);
    install(&mut bench, &new);
    for _ in 0..50 {
        bench.reset(ResetCause::Watchdog);
        assert_eq!(bench.version(), Some(0x0118));
        bench.application_answers();
    }
    for _ in 0..50 {
        bench.reset(ResetCause::Watchdog);
        assert!(bench.holds(&new));
        assert!(matches!(bench.version(), Some(0x0118) | None));
    }
});

on_every_chip!(
    a_confirmed_image_that_crashes_at_each_start_can_be_replaced_over_the_bus,
    bench,
    {
        let old = Image::small(&bench.hardware, 0x0117, &[0, 1]);
        let new = Image::small(&bench.hardware, 0x0118, &[0, 2]);
        install(&mut bench, &old);
        let fail = |bench: &mut Bench<_, _, _>, times: u8| {
            for _ in 0..times {
                assert_eq!(bench.version(), Some(0x0117));
                bench.reset(ResetCause::Panic);
            }
        };
        bench.power_cycle();
        fail(&mut bench, CRASH_LIMIT);
        assert_eq!(reason(&bench), Some(Reason::CrashLoop));
        assert_eq!(bench.status().unwrap().reason, Reason::CrashLoop);
        assert_eq!(bench.status().unwrap().application, 0x0117);
        // The bootloader's own resets by watchdog change nothing.
        bench.reset(ResetCause::Watchdog);
        assert_eq!(reason(&bench), Some(Reason::CrashLoop));
        // A loss of power and an order try the application again, as often as before.
        bench.power_cycle();
        fail(&mut bench, CRASH_LIMIT);
        assert_eq!(reason(&bench), Some(Reason::CrashLoop));
        bench.soft_reset();
        fail(&mut bench, CRASH_LIMIT);
        assert_eq!(reason(&bench), Some(Reason::CrashLoop));
        // Another one can be sent, which works.
        assert_eq!(bench.send_image(&new), Some(CommandCode::NoError));
        bench.soft_reset();
        bench.application_answers();
        assert_eq!(bench.version(), Some(0x0118));
        bench.reset(ResetCause::Watchdog);
        assert_eq!(bench.version(), Some(0x0118));
    }
);

on_every_chip!(the_fallback_is_put_back_by_command, bench, {
    let old = Image::small(&bench.hardware, 0x0117, &[0, 1]);
    let new = Image::small(&bench.hardware, 0x0118, &[0, 2]);
    install(&mut bench, &old);
    bench.enter();
    bench.send_image(&new);
    bench.soft_reset();
    bench.enter();
    let answer = bench.transact(Command::RestoreFallback, (0, 0), &[]);
    let (code, version) = match bench.slots().fallback {
        Some(_) => (CommandCode::NoError, 0x0117),
        None => (CommandCode::NoFallback, 0x0118),
    };
    assert_eq!(answer, Some((code, vec![])));
    assert_eq!(bench.status().unwrap().application, version);
    bench.soft_reset();
    assert_eq!(bench.version(), Some(version));
});

/// Cuts `act` before, inside and after each of its flash operations, from the same state each time, and
/// shows what is there when the power is back.
fn cut_everywhere<const W: usize, const S: usize, const J: usize>(
    bench: &mut Bench<W, S, J>,
    act: impl Fn(&mut Bench<W, S, J>),
    mut look: impl FnMut(&mut Bench<W, S, J>),
) {
    let before = bench.chip.save();
    let first = bench.chip.operations();
    act(bench);
    let operations = bench.chip.operations();
    assert!(operations > first, "nothing is written");
    for operation in first..operations {
        for point in [
            CutPoint::Before,
            CutPoint::Inside(operation),
            CutPoint::After,
        ] {
            bench.chip.restore(&before);
            bench.chip.cut_at(Some(Cut { operation, point }));
            act(bench);
            bench.chip.cut_at(None);
            bench.chip.power_on();
            look(bench);
        }
    }
}

on_every_chip!(an_interrupted_restore_goes_on_by_itself, bench, {
    if bench.slots().fallback.is_some() {
        let old = Image::small(&bench.hardware, 0x0117, &[0, 1]);
        let new = Image::small(&bench.hardware, 0x0118, &[0, 1]);
        install(&mut bench, &old);
        bench.enter();
        bench.send_image(&new);
        bench.soft_reset();
        for _ in 0..2 {
            bench.reset(ResetCause::Watchdog);
        }
        let mut versions = Vec::new();
        cut_everywhere(
            &mut bench,
            |bench| bench.reset(ResetCause::Watchdog),
            |bench| {
                bench.power_cycle();
                versions.push(bench.version());
                assert!(bench.holds(&old) || bench.holds(&new));
            },
        );
        // The new image where the third failure was not recorded yet, the old one from then on.
        assert!(versions.contains(&Some(0x0118)) && versions.contains(&Some(0x0117)));
        assert!(!versions.contains(&None), "{versions:?}");
    }
});

on_every_chip!(
    a_fallback_that_is_being_written_is_known_to_be_void,
    bench,
    {
        if bench.slots().fallback.is_some() {
            let image = Image::small(&bench.hardware, 0x0118, &[0, 1]);
            assert!(bench.enter());
            bench.send_image(&image);
            bench.soft_reset();
            bench.application_answers();
            let mut seen = Vec::new();
            cut_everywhere(
                &mut bench,
                |bench| bench.reset(ResetCause::PowerOn),
                |bench| {
                    let slots = bench.slots();
                    let refresh = slots.application.log().refresh;
                    let fallback = slots.fallback.as_mut().map(|slot| slot.log());
                    let written = fallback.is_some_and(|log| log.committed().is_some());
                    assert!(!written || refresh != Refresh::Idle);
                    seen.push(refresh);
                },
            );
            for refresh in [Refresh::Idle, Refresh::Begun, Refresh::Done] {
                assert!(seen.contains(&refresh), "{refresh:?}");
            }
        }
    }
);

// An erase that is cut at its very beginning can leave everything readable, and the cells weak. So before the
// first erase the old image is void already.
on_every_chip!(an_image_is_void_before_anything_of_it_is_erased, bench, {
    if bench.slots().fallback.is_some() {
        let old = Image::small(&bench.hardware, 0x0117, &[0, 1]);
        let new = Image::small(&bench.hardware, 0x0118, &[0, 1]);
        install(&mut bench, &old);
        bench.restart(true);
        let erased =
            |bench: &Bench<_, _, _>| -> u32 { bench.chip.erases(Region::Application).iter().sum() };
        let before = erased(&bench);
        let mut seen = Vec::new();
        cut_everywhere(
            &mut bench,
            |bench| {
                bench.restart(true);
                bench.send_page(LAST_PAGE, &new.pages[&LAST_PAGE], 0);
            },
            |bench| {
                let erased = erased(bench) > before;
                bench.power_cycle();
                seen.push((bench.version(), erased));
            },
        );
        let first = seen.iter().position(|(_, erased)| *erased).unwrap();
        assert_eq!(seen[0], (Some(0x0117), false));
        // The cut right before the first erase, and all after it.
        assert!(
            seen[first - 1..]
                .iter()
                .all(|(version, _)| version.is_none())
        );
    }
});
