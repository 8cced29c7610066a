//! Settings survive every power cut: I6, the half that is about settings.

use windlass_tests::journal_cuts::{Extent, sweep_all};

#[test]
fn i6_every_cut_of_a_save_leaves_the_old_or_the_new_settings() {
    let extent = Extent {
        saves: 40,
        ways: 2,
        pairs: 1,
        random: 1000,
    };
    for (chip, report) in sweep_all(extent) {
        println!("{chip}: {report:?}");
        assert!(report.is_clean(), "{chip}: {report:?}");
        assert!(report.old > 1000 && report.new > 100, "{chip}: {report:?}");
    }
}
