//! `windlass info`: everything a device tells about itself.

use serde_json::{Value, json};
use windlass_core::management::vendor::Descriptor;
use windlass_core::management::wire::ImageType;
use windlass_core::params::table::ParameterId;
use windlass_core::reset::ResetCause;

use super::connect::{Connection, devices};
use super::output::{self, say};
use super::{Failure, Global, Outcome, scan};
use crate::client::{Descriptors, Device, Error, Selector, Value as Parameter, product_name};

/// Arguments of `windlass info`.
#[derive(Clone, Debug, clap::Args)]
pub(super) struct Arguments {
    /// The device, as 5, talon:5, @0x1234 or 5@0x1234; all devices if left out.
    device: Option<Selector>,
}

/// The strings with their labels and JSON names.
const STRINGS: [(Descriptor, &str, &str); 6] = [
    (Descriptor::DeviceName, "name", "device_name"),
    (
        Descriptor::ManufacturerName,
        "manufacturer",
        "manufacturer_name",
    ),
    (Descriptor::ProductName, "product", "product_name"),
    (Descriptor::ManufactureDate, "made on", "manufacture_date"),
    (Descriptor::HardwareVersion, "hardware", "hardware_version"),
    (Descriptor::SerialNumber, "serial number", "serial_number"),
];

/// What `info` reads.
struct Information {
    device: Device,
    strings: Descriptors,
    flash_writes: u32,
    /// What only this project's firmware tells.
    own: Option<Own>,
}

/// How the device started, and what it has lost since; as parameters.
struct Own {
    cause: Parameter,
    detail: Parameter,
    place: Parameter,
    count: Parameter,
    /// Cause, detail and place of the latest crash; firmware that keeps none does not know them.
    crash: Option<[Parameter; 3]>,
    dropped: Parameter,
    failed: Parameter,
    settings: Parameter,
}

/// Prints strings, versions, flash wear and the latest reset of the devices.
pub(super) fn run(arguments: &Arguments, global: &Global) -> Result<Outcome, Failure> {
    let mut client = global.connect()?;
    let mut all = Vec::new();
    for device in devices(&mut client, arguments.device.as_ref())? {
        all.push(read(&mut client, device)?);
    }
    if global.json {
        let list: Vec<Value> = all.iter().map(describe).collect();
        output::json(&json!({"devices": list}))?;
        return Ok(Outcome::Done);
    }
    for information in &all {
        print(information)?;
    }
    Ok(Outcome::Done)
}

fn read(client: &mut Connection, device: Device) -> Result<Information, Failure> {
    let strings = client.descriptors(device.address)?;
    let versions = client.firmware_versions(device.address)?;
    let flash_writes = client.flash_sequence(device.address)?;
    let device = Device {
        versions: Some(versions),
        ..device
    };
    Ok(Information {
        device,
        strings,
        flash_writes,
        own: own(client, device)?,
    })
}

/// None in a bootloader, which has no parameters, and if the device's firmware does not know the first of these.
fn own(client: &mut Connection, device: Device) -> Result<Option<Own>, Failure> {
    let image = device.versions.map(|versions| versions.image);
    if image.is_some_and(|image| image != ImageType::Application) {
        return Ok(None);
    }
    let cause = match client.parameter(device.address, ParameterId::ResetCause) {
        Err(Error::Refused { .. }) => return Ok(None),
        cause => cause?,
    };
    let crash = match client.parameter(device.address, ParameterId::CrashCause) {
        Err(Error::Refused { .. }) => None,
        cause => Some([
            cause?,
            client.parameter(device.address, ParameterId::CrashDetail)?,
            client.parameter(device.address, ParameterId::CrashPlace)?,
        ]),
    };
    let mut read = |parameter| client.parameter(device.address, parameter);
    Ok(Some(Own {
        cause,
        detail: read(ParameterId::ResetDetail)?,
        place: read(ParameterId::ResetPlace)?,
        count: read(ParameterId::ResetCount)?,
        crash: crash.filter(|[cause, ..]| cause.raw != 0),
        dropped: read(ParameterId::FramesDropped)?,
        failed: read(ParameterId::TransmissionsFailed)?,
        settings: read(ParameterId::SettingsState)?,
    }))
}

fn describe(information: &Information) -> Value {
    let mut document = scan::describe(&information.device);
    for (descriptor, _, key) in STRINGS {
        document[key] = json!(information.strings.text(descriptor));
    }
    document["flash_sequence"] = json!(information.flash_writes);
    if let Some(own) = &information.own {
        document["reset"] = json!({
            "cause": own.cause.to_string(),
            "code": own.cause.raw,
            "detail": own.detail.raw,
            "place": own.place.raw,
            "count": own.count.raw,
        });
        document["last_crash"] = own.crash.map_or(Value::Null, |[cause, detail, place]| {
            json!({
                "cause": cause.to_string(),
                "code": cause.raw,
                "detail": detail.raw,
                "place": place.raw,
            })
        });
        document["settings"] = json!(own.settings.to_string());
        document["frames_dropped"] = json!(own.dropped.raw);
        document["transmissions_failed"] = json!(own.failed.raw);
    }
    document
}

/// A cause with what is known of it.
fn told([cause, detail, place]: [Parameter; 3]) -> String {
    match ResetCause::from_code(cause.raw as u8) {
        Some(ResetCause::Panic) => format!("{cause} (line {}, file {place})", detail.raw),
        Some(ResetCause::ProcessorFault) => format!("{cause} (status {detail}, at {place})"),
        Some(ResetCause::StackGuard) => format!("{cause} (status {detail}, pointer {place})"),
        Some(ResetCause::UnexpectedInterrupt) => format!("{cause} (exception {})", detail.raw),
        _ => cause.to_string(),
    }
}

fn print(information: &Information) -> Result<(), Failure> {
    say!("device {}", information.device.address)?;
    for (descriptor, label, _) in STRINGS {
        say!("  {label:<15} {}", information.strings.text(descriptor))?;
    }
    say!(
        "  {:<15} {}",
        "running image",
        information.device.image_name()
    )?;
    let (application, bootloader) = information.device.version_names();
    say!("  {:<15} {application}", "application")?;
    say!("  {:<15} {bootloader}", "bootloader")?;
    let product_id = product_name(information.device.product_id);
    say!("  {:<15} {product_id}", "product id")?;
    say!("  {:<15} {}", "flash writes", information.flash_writes)?;
    let Some(own) = &information.own else {
        return Ok(());
    };
    say!("  {:<15} {}", "settings", own.settings)?;
    let started_by = told([own.cause, own.detail, own.place]);
    say!("  {:<15} {started_by}", "started by")?;
    if let Some(crash) = own.crash {
        say!("  {:<15} {}", "last crash", told(crash))?;
    }
    say!("  {:<15} {} since power-on", "restarts", own.count)?;
    say!(
        "  {:<15} {} received, {} given up",
        "frames lost",
        own.dropped,
        own.failed
    )
}
