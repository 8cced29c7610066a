//! The whole sweep of power cuts over the settings journal, and a day of constant change:
//! `cargo run --release -p windlass-tests --example journal_cuts`.

use std::process::ExitCode;

use windlass_core::time::TICK;
use windlass_tests::journal_cuts::{Extent, days, sweep_all};

fn main() -> ExitCode {
    let extent = Extent {
        saves: 1000,
        ways: 1,
        pairs: 1,
        stride: 1,
        random: 20_000,
    };
    let mut clean = true;
    println!("chip        saves  rounds     cuts   old set   new set  wrong  undecided  misuses");
    for (chip, report) in sweep_all(extent) {
        println!(
            "{chip:<10} {:>6} {:>7} {:>8} {:>9} {:>9} {:>6} {:>10} {:>8}",
            report.saves,
            report.wraps,
            report.cuts,
            report.old,
            report.new,
            report.wrong,
            report.undecided,
            report.misuses
        );
        clean &= report.is_clean() && report.wraps >= 3;
    }
    println!("24 hours of change:");
    for day in days(TICK) {
        println!(
            "{:<10} {:?}: {} saves, erases {:?}",
            day.chip, day.rule, day.saves, day.erases
        );
        let (least, most) = (day.erases.iter().min(), day.erases.iter().max());
        clean &= day.saves <= 5761 && least.zip(most).is_some_and(|(a, b)| b - a <= 1);
    }
    if clean {
        ExitCode::SUCCESS
    } else {
        ExitCode::FAILURE
    }
}
