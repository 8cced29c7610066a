//! The whole sweep of I6 for images: `cargo run --release -p windlass-tests --example power_cuts [WAYS]`.
//!
//! `WAYS` are the different ways to interrupt each operation, 48 unless told.

use std::process::ExitCode;
use std::time::Instant;

use windlass_tests::boot_cuts::{Chip, Extent, Report, scenarios};
use windlass_tests::guide_scheme;
use windlass_tests::parallel::in_order;

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
    let scenarios = scenarios();
    let mut sum = Report::default();
    in_order(
        scenarios.len() * Chip::ALL.len(),
        |piece| {
            let (index, chip) = (piece / Chip::ALL.len(), Chip::ALL[piece % Chip::ALL.len()]);
            let report = chip.sweep(&scenarios[index], extent, index as u64 + 1);
            (scenarios[index].name, chip.name(), report)
        },
        |_, (scenario, chip, report)| {
            print(scenario, chip, &report);
            sum = sum.with(report);
        },
    );
    print("all", "", &sum);
    println!("\nThe guide's scheme, on the flash of the STM32G474:");
    let mut guide = guide_scheme::Report::default();
    in_order(
        scenarios.len(),
        |index| guide_scheme::sweep(&scenarios[index], extent, index as u64 + 1),
        |index, report| {
            println!("{:<28} {report}", scenarios[index].name);
            guide = guide.with(report);
        },
    );
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
