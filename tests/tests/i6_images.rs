//! I6, images: a sample of the sweep that `cargo run --release -p windlass-tests --example power_cuts` runs
//! whole.

use windlass_tests::boot_cuts::{Chip, Extent, Report, scenarios};
use windlass_tests::guide_scheme;

/// Sweeps every scenario on one chip.
fn sample(chip: Chip) -> Report {
    let extent = Extent {
        stride: 5,
        ways: 1,
        pairs: 5,
    };
    let mut sum = Report::default();
    for (index, scenario) in scenarios().iter().enumerate() {
        let report = chip.sweep(scenario, extent, 100 + index as u64);
        assert!(
            report.is_clean(),
            "{} on {}: {report:?}",
            scenario.name,
            chip.name()
        );
        sum = sum.with(report);
    }
    // All three outcomes of a cut are among the sample, or it has not been where it matters.
    assert!(sum.old > 0 && sum.new > 0 && sum.stayed > 0, "{sum:?}");
    sum
}

#[test]
fn i6_every_cut_boots_the_old_or_the_new_image_or_can_be_flashed_on_an_f405() {
    assert!(sample(Chip::F405).cuts > 500);
}

#[test]
fn i6_every_cut_boots_the_old_or_the_new_image_or_can_be_flashed_on_a_g474() {
    assert!(sample(Chip::G474).cuts > 300);
}

#[test]
fn i6_every_cut_boots_the_old_or_the_new_image_or_can_be_flashed_on_a_g431() {
    assert!(sample(Chip::G431).cuts > 300);
}

/// The sweep is known to be able to fail: the scheme of the protocol guide does, in both ways.
#[test]
fn i6_the_guide_s_scheme_fails_the_same_sweep() {
    let extent = Extent {
        stride: 3,
        ways: 1,
        pairs: 0,
    };
    let mut sum = guide_scheme::Report::default();
    for scenario in scenarios() {
        sum = sum.with(guide_scheme::sweep(&scenario, extent, 7));
    }
    assert!(sum.bricks > 0, "{sum}");
    assert!(sum.wrong > 0, "{sum}");
}
