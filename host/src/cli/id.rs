//! `windlass id`: show which device is which, and give it a number or a name.

use clap::{Args, Subcommand};
use serde_json::json;
use windlass_core::management::vendor::Descriptor;

use super::output::{self, say};
use super::{Failure, Global, Outcome};
use crate::client::{Selector, check_number, check_text};

/// Arguments of `windlass id`.
#[derive(Clone, Debug, Args)]
pub(super) struct Arguments {
    #[command(subcommand)]
    action: Action,
}

#[derive(Clone, Debug, Subcommand)]
enum Action {
    /// Let the device show a rainbow on its LEDs for five seconds.
    Blink {
        /// The device, as 5, talon:5, @0x1234 or 5@0x1234.
        device: Selector,
    },
    /// Give the device a number, a name or the strings of its manufacture.
    Set(SetArguments),
}

#[derive(Clone, Debug, Args)]
struct SetArguments {
    /// The device, as 5, talon:5, @0x1234 or 5@0x1234.
    device: Selector,
    #[command(flatten)]
    changes: Changes,
}

#[derive(Clone, Debug, Args)]
#[group(required = true, multiple = true)]
struct Changes {
    /// New device number, 1 to 63; of a Talon 0 to 62.
    number: Option<u8>,
    /// Device name, up to 64 bytes.
    #[arg(long, value_name = "TEXT")]
    name: Option<String>,
    /// Manufacturer name, up to 28 bytes.
    #[arg(long, value_name = "TEXT")]
    manufacturer: Option<String>,
    /// Product name, up to 28 bytes.
    #[arg(long, value_name = "TEXT")]
    product: Option<String>,
    /// Manufacture date, mm/dd/yy, up to 20 bytes.
    #[arg(long, value_name = "TEXT")]
    date: Option<String>,
    /// Hardware version, up to 8 bytes.
    #[arg(long, value_name = "TEXT")]
    hardware: Option<String>,
    /// Serial number, up to 12 bytes.
    #[arg(long, value_name = "TEXT")]
    serial: Option<String>,
}

impl Changes {
    fn strings(&self) -> [(Descriptor, Option<&String>); 6] {
        [
            (Descriptor::DeviceName, self.name.as_ref()),
            (Descriptor::ManufacturerName, self.manufacturer.as_ref()),
            (Descriptor::ProductName, self.product.as_ref()),
            (Descriptor::ManufactureDate, self.date.as_ref()),
            (Descriptor::HardwareVersion, self.hardware.as_ref()),
            (Descriptor::SerialNumber, self.serial.as_ref()),
        ]
    }
}

/// Runs the action.
pub(super) fn run(arguments: &Arguments, global: &Global) -> Result<Outcome, Failure> {
    match &arguments.action {
        Action::Blink { device } => blink(device, global),
        Action::Set(arguments) => set(arguments, global),
    }
}

fn blink(selector: &Selector, global: &Global) -> Result<Outcome, Failure> {
    let mut client = global.connect()?;
    let device = client.find(selector)?;
    client.flash_leds(device.address)?;
    let name = device.address.to_string();
    if global.json {
        output::json(&json!({"device": name, "blinking_s": 5}))?;
    } else {
        say!("device {name} shows a rainbow for 5 seconds")?;
    }
    Ok(Outcome::Done)
}

/// Checks everything first, so that a bad value leaves the device as it was.
fn set(arguments: &SetArguments, global: &Global) -> Result<Outcome, Failure> {
    let changes = &arguments.changes;
    if let Some(number) = changes.number {
        let dialect = arguments.device.dialect;
        let maker = dialect.map(|dialect| dialect.identity().manufacturer);
        check_number(number, maker)?;
    }
    for (descriptor, text) in changes.strings() {
        text.map_or(Ok(()), |text| check_text(descriptor, text))?;
    }
    let mut client = global.connect()?;
    let device = client.find(&arguments.device)?;
    let before = device.address;
    if let Some(number) = changes.number {
        check_number(number, Some(before.manufacturer))?;
    }
    for (descriptor, text) in changes.strings() {
        if let Some(text) = text {
            client.set_descriptor(before, descriptor, text)?;
        }
    }
    let after = match changes.number {
        Some(number) => client.set_device_number(before, number)?,
        None => before,
    };
    let strings = client.descriptors(after)?;
    if global.json {
        output::json(&json!({
            "before": before.to_string(),
            "device": after.to_string(),
            "number": after.number,
            "session": after.session,
            "device_name": strings.device_name,
        }))?;
        return Ok(Outcome::Done);
    }
    if before == after {
        say!("device {after} is \"{}\"", strings.device_name)?;
    } else {
        say!(
            "device {before} is now {after}, \"{}\"",
            strings.device_name
        )?;
    }
    Ok(Outcome::Done)
}
