//! The whole sweep of I6 for images: `cargo run --release -p windlass-tests --example power_cuts`.

use std::process::ExitCode;
use std::time::Instant;

use windlass_tests::boot_cuts::{Chip, Extent, Report, scenarios};
use windlass_tests::guide_scheme;

fn main() -> ExitCode {
    let ways = std::env::args()
        .nth(1)
        .and_then(|ways| ways.parse().ok())
        .unwrap_or(48);
    let extent = Extent {
        stride: 1,
        ways,
        pairs: 700,
    };
    let begin = Instant::now();
    println!(
        "{:<28} {:<10} {:>5} {:>7} {:>6} {:>7} {:>7} {:>7} {:>5} {:>6} {:>8} {:>7} {:>5}",
        "scenario",
        "chip",
        "ops",
        "cuts",
        "pairs",
        "old",
        "new",
        "stayed",
        "wrong",
        "bricks",
        "settings",
        "misuses",
        "over"
    );
    let mut sum = Report::default();
    for (index, scenario) in scenarios().iter().enumerate() {
        for chip in Chip::ALL {
            let report = chip.sweep(scenario, extent, index as u64 + 1);
            print(scenario.name, chip.name(), &report);
            sum = sum.with(report);
        }
    }
    print("all", "", &sum);
    println!("\nThe guide's scheme, on the flash of the STM32G474:");
    let mut guide = guide_scheme::Report::default();
    for (index, scenario) in scenarios().iter().enumerate() {
        let report = guide_scheme::sweep(scenario, extent, index as u64 + 1);
        println!("{:<28} {report}", scenario.name);
        guide = guide.with(report);
    }
    println!("{:<28} {guide}", "all");
    println!("{:.0} s", begin.elapsed().as_secs_f64());
    if sum.is_clean() {
        ExitCode::SUCCESS
    } else {
        ExitCode::FAILURE
    }
}

fn print(name: &str, chip: &str, report: &Report) {
    println!(
        "{name:<28} {chip:<10} {:>5} {:>7} {:>6} {:>7} {:>7} {:>7} {:>5} {:>6} {:>8} {:>7} {:>5}",
        report.operations,
        report.cuts,
        report.pairs,
        report.old,
        report.new,
        report.stayed,
        report.wrong,
        report.bricks,
        report.settings,
        report.misuses,
        report.overprogrammed
    );
}
