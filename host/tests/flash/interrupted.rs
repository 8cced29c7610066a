//! Updates that are cut, disturbed or held up, and go on.

use super::*;

#[test]
fn an_interrupted_update_goes_on_where_it_stopped() {
    for pages in 0..7 {
        let mut bench = Bench::new(Device::new(5, 0x1234));
        bench.watch.cancel_at = Some(pages);
        let error = bench.flash(&image()).unwrap_err();
        if pages == 0 {
            assert!(matches!(error, FlashError::CancelledEarly(_)), "{error}");
            assert_eq!(bench.device().changes, 0);
            continue;
        }
        let FlashError::Cancelled { stored, of: 7, .. } = error else {
            panic!("{error}");
        };
        assert_eq!(stored, pages);
        assert_eq!(bench.device().version, NO_VERSION);
        bench.watch = Watch::default();
        let report = bench.flash(&image()).unwrap();
        assert_eq!(report.sent, 7 - pages);
        assert_eq!(bench.watch.stored.first(), Some(&(pages + 1)));
        assert!(bench.has(&image()));
        assert_eq!(bench.device().written, [30, 5, 4, 3, 2, 1, 0]);
    }
}

#[test]
fn a_half_written_other_image_is_begun_anew() {
    let mut bench = Bench::new(Device::new(5, 0x1234));
    bench.watch.cancel_at = Some(3);
    bench.flash(&image_of(IDENTITY, 0x55)).unwrap_err();
    bench.watch = Watch::default();
    let report = bench.flash(&image()).unwrap();
    assert_eq!(report.sent, 7);
    assert!(bench.has(&image()));
}

#[test]
fn a_power_cut_in_the_middle_is_survived_and_only_missing_pages_are_sent() {
    for at in [100, 514, 1200, 2000, 3500] {
        let mut bench = Bench::new(Device::new(5, 0x1234));
        bench.device().serial = "0102030405FF";
        let mut data = 0;
        bench.on_frame(move |_, frame| {
            data += usize::from(is_data(frame));
            match is_data(frame) && data == at {
                true => Fate::PowerCut,
                false => Fate::Delivered,
            }
        });
        let report = bench.flash(&image()).unwrap();
        assert_eq!(bench.watch.lost, 1, "cut at {at}");
        assert_eq!(report.address, bench.watch.found.unwrap());
        assert_ne!(report.address.session, 0x1234);
        assert_eq!(report.sent, 7);
        assert_eq!(bench.device().written, [30, 5, 4, 3, 2, 1, 0]);
        assert!(bench.has(&image()));
    }
}

#[test]
fn after_a_power_cut_the_device_is_known_by_its_serial_number() {
    // Its sessions are lower, so that it is asked first.
    let mut other = Device::new(5, 0x0001);
    other.serial = "AAAAAAAAAAAA";
    let mut device = Device::new(5, 0x1234);
    device.serial = "BBBBBBBBBBBB";
    let mut bench = Bench::with(vec![device, other]);
    let mut data = 0;
    bench.on_frame(move |_, frame| {
        data += usize::from(is_data(frame));
        match is_data(frame) && data == 700 {
            true => Fate::PowerCut,
            false => Fate::Delivered,
        }
    });
    bench.flash(&image()).unwrap();
    assert!(bench.has(&image()));
    assert_eq!(bench.client.bus().devices[1].changes, 0);
}

#[test]
fn without_serial_numbers_two_devices_of_one_number_are_not_mixed_up() {
    let mut bench = Bench::with(vec![Device::new(5, 0x1234), Device::new(5, 0x7777)]);
    let mut data = 0;
    bench.on_frame(move |_, frame| {
        data += usize::from(is_data(frame));
        match is_data(frame) && data == 700 {
            true => Fate::PowerCut,
            false => Fate::Delivered,
        }
    });
    let error = bench.flash(&image()).unwrap_err();
    assert!(matches!(error, FlashError::Lost { .. }), "{error}");
    assert_eq!(bench.client.bus().devices[1].changes, 0);
}

#[test]
fn a_device_that_stays_away_is_given_up_with_the_way_to_go_on() {
    let mut bench = Bench::new(Device::new(5, 0x1234));
    let mut data = 0;
    bench.on_frame(move |_, frame| {
        data += usize::from(is_data(frame));
        if data < 600 {
            Fate::Delivered
        } else {
            Fate::Lost
        }
    });
    let before = bench.client.now();
    let error = bench.flash(&image()).unwrap_err();
    assert!(matches!(error, FlashError::Lost { .. }), "{error}");
    assert!(error.next_step().contains("same command again"));
    let waited = bench.client.now() - before;
    assert!(waited < Duration::from_secs(60), "{waited:?}");
    bench.on_frame(|_, _| Fate::Delivered);
    let report = bench.flash(&image()).unwrap();
    assert_eq!(report.sent, 6);
}

#[test]
fn a_connection_that_breaks_is_the_bus_s_error() {
    let mut bench = Bench::new(Device::new(5, 0x1234));
    bench.on_frame(|number, _| {
        if number < 900 {
            Fate::Delivered
        } else {
            Fate::Broken
        }
    });
    let error = bench.flash(&image()).unwrap_err();
    assert!(
        matches!(error, FlashError::Client(Error::Bus(_))),
        "{error}"
    );
}

#[test]
fn every_single_frame_of_a_page_may_be_lost_or_doubled() {
    let frames = 1 + PAGE_SIZE / 8 + 1;
    for fate in [Fate::Lost, Fate::Doubled] {
        for victim in 0..frames {
            let mut bench = Bench::new(Device::new(5, 0x1234));
            let (mut at, mut in_page) = (0, false);
            bench.on_frame(move |_, frame| {
                if let Some(page) = page_command(frame) {
                    in_page = page == 3;
                }
                if !in_page {
                    return Fate::Delivered;
                }
                at += 1;
                if at == victim + 1 {
                    fate
                } else {
                    Fate::Delivered
                }
            });
            bench.flash(&image()).unwrap();
            assert!(bench.has(&image()), "{fate:?} {victim}");
        }
    }
}

#[test]
fn a_disturbed_page_is_sent_again() {
    for code in [
        CommandCode::CrcMismatch,
        CommandCode::DataReceivedMore,
        CommandCode::FlashWriteFailed,
    ] {
        let mut bench = Bench::new(Device::new(5, 0x1234));
        bench.device().refusals.extend([code; 4]);
        bench.flash(&image()).unwrap();
        assert!(bench.has(&image()));
    }
}

#[test]
fn worn_out_flash_is_reported_with_page_and_code() {
    let mut bench = Bench::new(Device::new(5, 0x1234));
    bench
        .device()
        .refusals
        .extend([CommandCode::FlashWriteFailed; 5]);
    let error = bench.flash(&image()).unwrap_err();
    let FlashError::PageRefused {
        page: LAST_PAGE, ..
    } = error
    else {
        panic!("{error}");
    };
    assert!(
        error.to_string().contains("cercFlashWriteFailed"),
        "{error}"
    );
}

#[test]
fn a_device_that_lost_the_order_is_begun_anew() {
    let mut bench = Bench::new(Device::new(5, 0x1234));
    // Three pages are stored, then the device wants to begin again.
    bench.watch.cancel_at = Some(3);
    bench.flash(&image()).unwrap_err();
    bench.watch = Watch::default();
    bench.device().refusals.push_back(CommandCode::PageOrder);
    let report = bench.flash(&image()).unwrap();
    assert_eq!(report.sent, 7);
    assert!(bench.has(&image()));
}

#[test]
fn a_device_that_falls_behind_is_updated_all_the_same() {
    // Every page takes this long, and what is asked meanwhile is answered afterwards.
    for millis in [1900, 2050, 2100, 3000, 4500, 7000] {
        let mut bench = Bench::new(Device::new(5, 0x1234));
        bench.client.bus().in_order = true;
        let late = Duration::from_millis(millis);
        bench.device().delays.extend([late; 200]);
        let report = bench.flash(&image()).map_err(|error| error.to_string());
        assert!(report.is_ok(), "{millis}: {report:?}");
        assert!(bench.has(&image()), "{millis}");
        if millis <= 3000 {
            let pages = image().pages().len();
            assert_eq!(
                bench.device().changes,
                pages,
                "{millis}: none was sent twice"
            );
        }
    }
}

#[test]
fn a_status_that_comes_late_is_not_taken_for_another_page_s() {
    // Page 30 is answered after its patience is over, so that its status meets the repetition.
    for late in [2001, 2050, 2100, 2500, 6001, 6050, 6100] {
        for pages_before in 0..4 {
            let mut bench = Bench::new(Device::new(5, 0x1234));
            let quick = Duration::from_millis(20);
            bench.device().delays.extend(vec![quick; pages_before]);
            bench.device().delays.push_back(Duration::from_millis(late));
            bench.flash(&image()).unwrap();
            assert!(bench.has(&image()), "{late} {pages_before}");
        }
    }
}
