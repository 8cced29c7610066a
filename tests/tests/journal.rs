//! Settings survive every power cut: I6, the half that is about settings.

use windlass_core::time::Duration;
use windlass_tests::journal_cuts::{Extent, days, sweep_all};

#[test]
fn i6_every_cut_of_a_save_leaves_the_old_or_the_new_settings() {
    let extent = Extent {
        saves: 40,
        ways: 1,
        pairs: 1,
        stride: 13,
        random: 500,
    };
    for (chip, report) in sweep_all(extent) {
        println!("{chip}: {report:?}");
        assert!(report.is_clean(), "{chip}: {report:?}");
        assert!(report.old > 1000 && report.new > 100, "{chip}: {report:?}");
    }
}

#[test]
fn i6_a_day_of_constant_change_is_5761_saves_at_most_and_wears_all_units_alike() {
    for day in days(Duration::from_millis(100)) {
        println!("{day:?}");
        assert_eq!(day.saves, 5761, "{day:?}");
        let (least, most) = (day.erases.iter().min(), day.erases.iter().max());
        assert!(most.unwrap() - least.unwrap() <= 1, "{day:?}");
    }
}
