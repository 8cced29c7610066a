//! `windlass scan`: who is on the bus.

use serde_json::{Value, json};
use windlass_core::dialect::DialectKind;
use windlass_core::management::wire::ImageType;

use super::connect::{Connection, devices};
use super::output::{self, say};
use super::{Failure, Global, Outcome, talon};
use crate::client::{Device, Error, product_name};

/// Arguments of `windlass scan`.
#[derive(Clone, Debug, clap::Args)]
pub(super) struct Arguments {}

/// Lists every device on the bus.
pub(super) fn run(_arguments: &Arguments, global: &Global) -> Result<Outcome, Failure> {
    let mut client = global.connect()?;
    let devices = devices(&mut client, None)?;
    let dialects = dialects(&mut client, &devices)?;
    let duplicates = duplicates(&devices, &dialects);
    if global.json {
        let list: Vec<Value> = devices
            .iter()
            .zip(&dialects)
            .map(|(device, dialect)| {
                let mut document = describe(device);
                document["dialect"] = json!(dialect);
                document
            })
            .collect();
        output::json(&json!({"devices": list, "duplicate_numbers": duplicates}))?;
        return Ok(Outcome::Done);
    }
    say!("device      dialect  image         app    boot   product")?;
    for (device, dialect) in devices.iter().zip(&dialects) {
        let dialect = dialect.unwrap_or("?");
        let address = device.address.to_string();
        let image = device.image_name();
        let (application, bootloader) = device.version_names();
        let product = product_name(device.product_id);
        say!("{address:<11} {dialect:<8} {image:<13} {application:<6} {bootloader:<6} {product}")?;
    }
    for number in duplicates {
        say!(
            "note: number {number} is used more than once; name these devices by session (N@0x…) and \
             give each a number with `windlass id set`"
        )?;
    }
    let unnumbered = |(device, dialect): (&Device, &Option<&str>)| {
        device.address.number == 0 && !talon::is_name(*dialect)
    };
    if devices.iter().zip(&dialects).any(unnumbered) {
        say!("note: a device has no number yet; give it one with `windlass id set 0 NUMBER`")?;
    }
    Ok(Outcome::Done)
}

/// What drives each device; none for devices that do not tell, as the bootloaders of DMC60C.
fn dialects(
    client: &mut Connection,
    devices: &[Device],
) -> Result<Vec<Option<&'static str>>, Failure> {
    let mut dialects = Vec::new();
    for device in devices {
        let application = device
            .versions
            .is_some_and(|versions| versions.image == ImageType::Application);
        let dialect = if application {
            match client.dialect(device.address) {
                Ok(dialect) => dialect,
                // It is there: its answer to this one question was lost.
                Err(Error::NoAnswer { .. } | Error::WrongSession { .. }) => None,
                Err(error) => return Err(error.into()),
            }
        } else {
            device.address.dialect()
        };
        dialects.push(dialect.map(DialectKind::name));
    }
    Ok(dialects)
}

/// A device as JSON, the same in every verb.
pub(super) fn describe(device: &Device) -> Value {
    let (application, bootloader) = device.version_names();
    json!({
        "device": device.address.to_string(),
        "number": device.address.number,
        "session": device.address.session,
        "image": device.image_name(),
        "application_version": application,
        "bootloader_version": bootloader,
        "product_id": device.product_id,
    })
}

/// Numbers that more than one device of a dialect has. 0 stands for "none" unless a Talon has it, whose
/// factory number it is (Talon manual 2.2).
fn duplicates(devices: &[Device], dialects: &[Option<&'static str>]) -> Vec<u8> {
    let mut seen = Vec::new();
    let mut twice = Vec::new();
    for (device, dialect) in devices.iter().zip(dialects) {
        let number = device.address.number;
        if number == 0 && !talon::is_name(*dialect) {
            continue;
        }
        if seen.contains(&(number, dialect)) && !twice.contains(&number) {
            twice.push(number);
        }
        seen.push((number, dialect));
    }
    twice
}
