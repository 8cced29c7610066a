//! 10,000 updates of 31 pages at a frame loss of 0.01 %:
//! `cargo run --release -p windlass-tests --example lossy_updates`.

use std::process::ExitCode;

use windlass_tests::lossy_updates::{LOSS, run};

fn main() -> ExitCode {
    let updates = std::env::args()
        .nth(1)
        .and_then(|updates| updates.parse().ok())
        .unwrap_or(10_000);
    let report = run(updates, LOSS, 1);
    println!(
        "{} updates, {} frames lost, {} pages sent again, {} wrong images",
        report.updates, report.lost, report.repeated, report.wrong
    );
    if report.wrong == 0 {
        ExitCode::SUCCESS
    } else {
        ExitCode::FAILURE
    }
}
