//! `windlass test` of a Talon: the manual's self-test (2.4).

use serde_json::{Map, Value as Json, json};

use super::press::Press;
use super::{Connection, robot};
use crate::cli::output::say;
use crate::cli::{Failure, Global};
use crate::client::talon::{FaultBits, Pin, SelfTest, mode_name};

/// Captures the report of the Talon with this number; a second time in quick succession clears its sticky
/// faults.
pub(in crate::cli) fn examine(
    client: &mut Connection,
    number: u8,
    global: &Global,
) -> Result<SelfTest, Failure> {
    // A simulated bus of its own begins anew with every command.
    let lasting = !global.transport()?.is_virtual();
    let press = Press::of(&global.transport, number);
    let again = lasting && press.is_again();
    let report = robot(client, global)
        .talon(number)?
        .self_test_clearing(again)?;
    if lasting {
        press.remember();
    }
    Ok(report)
}

/// True if the device responded and reports no fault.
pub(in crate::cli) fn passed(report: &SelfTest) -> bool {
    report.responding && report.faults().is_empty()
}

/// Prints the report.
pub(in crate::cli) fn print(report: &SelfTest) -> Result<(), Failure> {
    say!("{report}")
}

/// The report as JSON.
pub(in crate::cli) fn describe(report: &SelfTest) -> Json {
    let pin = |pin: Pin| json!({"closed": pin.closed, "forced": pin.forced});
    let names = |faults: FaultBits| faults.names().collect::<Vec<_>>();
    let lines: Map<String, Json> = report
        .lines()
        .into_iter()
        .map(|(label, text)| (label.trim().to_owned(), json!(text)))
        .collect();
    json!({
        "device": format!("talon:{}", report.number),
        "number": report.number,
        "responding": report.responding,
        "enabled": report.enabled(),
        "mode": mode_name(report.mode()),
        "faults": names(report.faults()),
        "sticky_faults": names(report.sticky_faults()),
        "cleared": report.cleared,
        "forward_limit": pin(report.forward_limit()),
        "reverse_limit": pin(report.reverse_limit()),
        "battery_v": report.battery(),
        "temp_c": report.temperature(),
        "current_a": report.current(),
        "firmware": report.version.map(|(major, minor)| format!("{major}.{minor}")),
        "passed": passed(report),
        "report": lines,
    })
}
