//! `windlass test`: a self-test report of devices, without moving the motor.

use std::time::Duration;

use serde_json::{Value as Json, json};
use windlass_core::dialect::dmc60c::wire::id;
use windlass_core::frc_id;
use windlass_core::management::vendor::{PinTest, TestPin};
use windlass_core::management::wire::ImageType;
use windlass_core::params::table::{ParameterId, TABLE};

use super::connect::{Connection, devices};
use super::output::{self, say};
use super::{Failure, Global, Kind, Outcome, faults, talon};
use crate::client::talon::SelfTest;
use crate::client::{Device, Error, PinTestResult, Selector, Value, Version, is_own};

/// How long status frames are counted.
const WATCH_TIME: Duration = Duration::from_millis(1000);
/// Supply range of the DMC60C: its under-voltage threshold to its highest rated voltage.
const SUPPLY_VOLTS: std::ops::RangeInclusive<f64> = 5.75..=28.0;
/// Case temperature at which the duty cycle is not yet derated.
const CASE_CELSIUS: std::ops::RangeInclusive<f64> = -40.0..=85.0;

/// Arguments of `windlass test`.
#[derive(Clone, Debug, clap::Args)]
pub(super) struct Arguments {
    /// The device, as 5, talon:5, @0x1234 or 5@0x1234; all devices if left out.
    device: Option<Selector>,
    /// Also test the expansion header J1 for short circuits; unplug everything from it first.
    #[arg(long)]
    short: bool,
    /// Also test the expansion header J1 for open circuits; needs a plug that joins pins 3-4, 5-7, 8-9.
    #[arg(long)]
    open: bool,
}

/// One checked property.
struct Check {
    name: &'static str,
    passed: bool,
    detail: String,
}

impl Check {
    fn new(name: &'static str, passed: bool, detail: impl Into<String>) -> Self {
        Self {
            name,
            passed,
            detail: detail.into(),
        }
    }
}

/// Tests the devices and prints a report; ends with the exit code for faults if a check failed.
pub(super) fn run(arguments: &Arguments, global: &Global) -> Result<Outcome, Failure> {
    let mut client = global.connect()?;
    let selector = arguments.device.as_ref();
    let found = match devices(&mut client, selector) {
        Err(failure) if failure.kind == Kind::NoDevice && talon::named(selector).is_some() => {
            Vec::new()
        }
        found => found?,
    };
    let mut reports = Vec::new();
    for device in &found {
        let report = if talon::is_talon(&mut client, device)? {
            Report::Talon(talon::test::examine(
                &mut client,
                device.address.number,
                global,
            )?)
        } else {
            Report::Checks(*device, examine(&mut client, *device, arguments)?)
        };
        reports.push(report);
    }
    if let (true, Some(number)) = (found.is_empty(), talon::named(selector)) {
        reports.push(Report::Talon(talon::test::examine(
            &mut client,
            number,
            global,
        )?));
    }
    if global.json {
        let list: Vec<Json> = reports.iter().map(Report::describe).collect();
        output::json(&json!({"devices": list}))?;
    } else {
        for report in &reports {
            report.print()?;
        }
    }
    let failed = reports.iter().any(|report| !report.passed());
    Ok(if failed {
        Outcome::FaultReported
    } else {
        Outcome::Done
    })
}

/// What was found out about one device.
enum Report {
    /// The checks of this tool.
    Checks(Device, Vec<Check>),
    /// The self-test of the Talon's manual.
    Talon(SelfTest),
}

impl Report {
    fn passed(&self) -> bool {
        match self {
            Self::Checks(_, checks) => passed(checks),
            Self::Talon(report) => talon::test::passed(report),
        }
    }

    fn print(&self) -> Result<(), Failure> {
        match self {
            Self::Checks(device, checks) => print(device, checks),
            Self::Talon(report) => talon::test::print(report),
        }
    }

    fn describe(&self) -> Json {
        match self {
            Self::Checks(device, checks) => describe(device, checks),
            Self::Talon(report) => talon::test::describe(report),
        }
    }
}

fn passed(checks: &[Check]) -> bool {
    checks.iter().all(|check| check.passed)
}

fn examine(
    client: &mut Connection,
    device: Device,
    arguments: &Arguments,
) -> Result<Vec<Check>, Failure> {
    let mut checks = vec![check_firmware(client, device)?];
    checks.push(check_strings(client, device)?);
    let application = checks.first().is_some_and(|check| check.passed);
    if application {
        checks.push(check_parameters(client, device)?);
        checks.push(check_faults(client, device)?);
        checks.extend(check_status_frames(client, device)?);
        checks.extend(check_measurements(client, device));
    }
    let pin_tests = [
        (arguments.short, PinTest::Short, "J1 short circuits"),
        (arguments.open, PinTest::Open, "J1 open circuits"),
    ];
    for (wanted, test, name) in pin_tests {
        if wanted {
            let result = client.pin_test(device.address, test)?;
            checks.push(pin_check(name, result));
        }
    }
    Ok(checks)
}

fn check_firmware(client: &mut Connection, device: Device) -> Result<Check, Failure> {
    let versions = client.firmware_versions(device.address)?;
    let application = Version(versions.application);
    let good = versions.image == ImageType::Application && application != Version::NONE;
    let image = Device {
        versions: Some(versions),
        ..device
    };
    let (image, bootloader) = (image.image_name(), Version(versions.bootloader));
    let detail = format!("{image} runs, application {application}, bootloader {bootloader}");
    Ok(Check::new("firmware", good, detail))
}

fn check_strings(client: &mut Connection, device: Device) -> Result<Check, Failure> {
    let strings = client.descriptors(device.address)?;
    let writes = client.flash_sequence(device.address)?;
    let (name, serial) = (&strings.device_name, &strings.serial_number);
    let detail = format!("name \"{name}\", serial number {serial}, {writes} flash writes");
    Ok(Check::new("identity", !name.is_empty(), detail))
}

/// Every parameter of the guide must be readable and hold a value that could be written to it; this
/// project's own may be missing on other firmware.
fn check_parameters(client: &mut Connection, device: Device) -> Result<Check, Failure> {
    let mut bad = Vec::new();
    let mut read = 0;
    for row in &TABLE {
        match client.parameter(device.address, row.id) {
            Ok(value) if row.kind.allows(value.raw) => read += 1,
            Ok(_) => bad.push(row.name),
            Err(Error::Refused { .. }) if is_own(row) => {}
            Err(Error::Refused { .. }) => bad.push(row.name),
            Err(error) => return Err(error.into()),
        }
    }
    let detail = if bad.is_empty() {
        format!("{read} parameters read, all within their ranges")
    } else {
        format!("unknown or out of range: {}", bad.join(", "))
    };
    Ok(Check::new("parameters", bad.is_empty(), detail))
}

fn check_faults(client: &mut Connection, device: Device) -> Result<Check, Failure> {
    let report = faults::read(client, device.address, false)?;
    let word = |parameter, bits: u8| Value {
        parameter,
        raw: u32::from(bits),
    };
    let active = word(ParameterId::ActiveFaults, report.active.bits());
    let sticky = word(ParameterId::StickyFaults, report.sticky.bits());
    let detail = format!("active: {active}; sticky: {sticky}");
    Ok(Check::new("faults", report.active.is_empty(), detail))
}

/// Counts the status frames of the device against their set periods. Four fifths must arrive; the rest
/// is for the host's own timing.
fn check_status_frames(client: &mut Connection, device: Device) -> Result<Vec<Check>, Failure> {
    let kinds = [
        (
            "general status",
            id::STATUS_GENERAL,
            ParameterId::GeneralPeriod,
        ),
        (
            "encoder status",
            id::STATUS_ENCODER,
            ParameterId::EncoderPeriod,
        ),
        (
            "analog status",
            id::STATUS_ANALOG,
            ParameterId::AnalogPeriod,
        ),
    ];
    let mut periods = [0; 3];
    for (period, (_, _, parameter)) in periods.iter_mut().zip(kinds) {
        *period = client.parameter(device.address, parameter)?.raw.max(1);
    }
    let slowest = periods.iter().max().copied().unwrap_or(1);
    let watch = WATCH_TIME.max(Duration::from_millis(u64::from(slowest) * 2));
    let mut counts = [0_u32; 3];
    let end = client.now() + watch;
    while client.now() < end {
        let left = end.saturating_sub(client.now());
        let Some(received) = client.receive(left)? else {
            continue;
        };
        for (count, (_, base, _)) in counts.iter_mut().zip(kinds) {
            let expected = frc_id::with_number(base, device.address.number);
            *count += u32::from(received.frame.extended_id() == Some(expected));
        }
    }
    let checks = kinds.into_iter().zip(periods).zip(counts);
    Ok(checks
        .map(|(((name, _, _), period), count)| {
            let expected = watch.as_millis() as u32 / period;
            let detail = format!("{count} frames of {expected} in {} ms", watch.as_millis());
            Check::new(name, count * 5 >= expected * 4, detail)
        })
        .collect())
}

fn check_measurements(client: &Connection, device: Device) -> Vec<Check> {
    let status = client
        .status(device.address.number)
        .copied()
        .unwrap_or_default();
    let within = |value: Option<f64>, range: &std::ops::RangeInclusive<f64>| {
        value.is_some_and(|value| range.contains(&value))
    };
    let show = |value: Option<f64>, unit: &str| match value {
        Some(value) => format!("{value:.2} {unit}"),
        None => "not reported".to_owned(),
    };
    let (volts, celsius) = (status.bus_voltage(), status.temperature());
    vec![
        Check::new("supply", within(volts, &SUPPLY_VOLTS), show(volts, "V")),
        Check::new(
            "temperature",
            within(celsius, &CASE_CELSIUS),
            show(celsius, "C"),
        ),
    ]
}

fn pin_check(name: &'static str, result: PinTestResult) -> Check {
    match result {
        PinTestResult::Passed => Check::new(name, true, "no pin failed"),
        PinTestResult::Failed(pin) => {
            let pin = pin.map_or("a pin that the device did not name", TestPin::name);
            Check::new(name, false, format!("last pin that failed: {pin}"))
        }
    }
}

fn print(device: &Device, checks: &[Check]) -> Result<(), Failure> {
    say!("device {}", device.address)?;
    for check in checks {
        let verdict = if check.passed { "pass" } else { "FAIL" };
        say!("  {verdict}  {:<17} {}", check.name, check.detail)?;
    }
    let failed = checks.iter().filter(|check| !check.passed).count();
    match failed {
        0 => say!("  all {} checks passed", checks.len()),
        _ => say!("  {failed} of {} checks failed", checks.len()),
    }
}

fn describe(device: &Device, checks: &[Check]) -> Json {
    let list: Vec<Json> = checks
        .iter()
        .map(|check| json!({"name": check.name, "passed": check.passed, "detail": check.detail}))
        .collect();
    json!({"device": device.address.to_string(), "passed": passed(checks), "checks": list})
}
