//! `windlass faults`: active and sticky faults with their counts.

use serde_json::{Value as Json, json};
use windlass_core::engine::snapshot::{Fault, Faults};
use windlass_core::params::table::ParameterId;

use super::connect::{Connection, devices};
use super::output::{self, say};
use super::{Failure, Global, Outcome, talon};
use crate::client::{Address, Selector, Value, fault_name};

/// Arguments of `windlass faults`.
#[derive(Clone, Debug, clap::Args)]
pub(super) struct Arguments {
    /// The device, as 5, talon:5, @0x1234 or 5@0x1234; all devices if left out.
    device: Option<Selector>,
    /// Clear sticky faults and counts after reading them.
    #[arg(long)]
    clear: bool,
}

/// The count of each fault, in the order of the fault's bit.
const COUNTS: [ParameterId; 5] = [
    ParameterId::OverCurrentCount,
    ParameterId::OverTemperatureCount,
    ParameterId::UnderVoltageCount,
    ParameterId::GateDriverCount,
    ParameterId::CommunicationCount,
];

/// The faults of one device.
pub(super) struct Report {
    pub(super) address: Address,
    pub(super) active: Faults,
    pub(super) sticky: Faults,
    pub(super) counts: [u32; 5],
}

/// Prints the faults; ends with the exit code for faults if one is active, or sticky and not cleared.
pub(super) fn run(arguments: &Arguments, global: &Global) -> Result<Outcome, Failure> {
    let mut client = global.connect()?;
    let (mut reports, mut talons) = (Vec::new(), Vec::new());
    for device in devices(&mut client, arguments.device.as_ref())? {
        if talon::is_talon(&mut client, &device)? {
            let report = talon::faults::read(&mut client, device.address, arguments.clear, global)?;
            talons.push(report);
        } else {
            reports.push(read(&mut client, device.address, arguments.clear)?);
        }
    }
    if global.json {
        let list = reports.iter().map(describe);
        let list: Vec<Json> = list
            .chain(talons.iter().map(|talon| talon.describe()))
            .collect();
        output::json(&json!({"devices": list, "cleared": arguments.clear}))?;
    } else {
        for report in &reports {
            print(report, arguments.clear)?;
        }
        for report in &talons {
            report.print()?;
        }
    }
    let remains = |report: &Report| {
        !report.active.is_empty() || (!report.sticky.is_empty() && !arguments.clear)
    };
    if reports.iter().any(remains) || talons.iter().any(talon::faults::Report::remains) {
        return Ok(Outcome::FaultReported);
    }
    Ok(Outcome::Done)
}

/// Reads the faults of a device and clears what can be cleared, if asked to.
pub(super) fn read(
    client: &mut Connection,
    address: Address,
    clear: bool,
) -> Result<Report, Failure> {
    let mut word = |parameter| -> Result<u32, Failure> {
        let value = if clear && parameter != ParameterId::ActiveFaults {
            client.set_parameter(address, Value { parameter, raw: 1 })?
        } else {
            client.parameter(address, parameter)?
        };
        Ok(value.raw)
    };
    let active = Faults::from_bits(word(ParameterId::ActiveFaults)? as u8);
    let sticky = Faults::from_bits(word(ParameterId::StickyFaults)? as u8);
    let mut counts = [0; 5];
    for (count, parameter) in counts.iter_mut().zip(COUNTS) {
        *count = word(parameter)?;
    }
    Ok(Report {
        address,
        active,
        sticky,
        counts,
    })
}

fn print(report: &Report, cleared: bool) -> Result<(), Failure> {
    say!("device {}", report.address)?;
    for (fault, count) in Fault::ALL.into_iter().zip(report.counts) {
        let active = if report.active.contains(fault) {
            "active"
        } else {
            ""
        };
        let sticky = if report.sticky.contains(fault) {
            "sticky"
        } else {
            ""
        };
        say!(
            "  {:<16} {active:<7} {sticky:<7} count {count}",
            fault_name(fault)
        )?;
    }
    if cleared {
        say!("  sticky faults and counts were cleared after this reading")?;
    }
    Ok(())
}

fn describe(report: &Report) -> Json {
    let names = |faults: Faults| -> Vec<&str> {
        let set = Fault::ALL
            .into_iter()
            .filter(|fault| faults.contains(*fault));
        set.map(fault_name).collect()
    };
    let counts: serde_json::Map<String, Json> = Fault::ALL
        .into_iter()
        .zip(report.counts)
        .map(|(fault, count)| (fault_name(fault).to_owned(), json!(count)))
        .collect();
    json!({
        "device": report.address.to_string(),
        "active": names(report.active),
        "sticky": names(report.sticky),
        "counts": counts,
    })
}
