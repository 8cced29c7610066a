//! `windlass param`: read and write parameters.

use clap::{Args, Subcommand};
use serde_json::{Value as Json, json};
use windlass_core::params::table::{Parameter, TABLE};

use super::output::{self, say};
use super::{Failure, Global, Kind, Outcome};
use crate::client::{Error, Selector, Value, find_parameter, is_own};

/// Arguments of `windlass param`.
#[derive(Clone, Debug, Args)]
pub(super) struct Arguments {
    #[command(subcommand)]
    action: Action,
}

#[derive(Clone, Debug, Subcommand)]
enum Action {
    /// Read parameters; all of them if none is named.
    Get {
        /// The device, as 5, talon:5, @0x1234 or 5@0x1234.
        device: Selector,
        /// Names as in the protocol guide (with or without "param") or numbers.
        #[arg(value_name = "PARAMETER")]
        parameters: Vec<String>,
    },
    /// Write a parameter.
    Set {
        /// The device, as 5, talon:5, @0x1234 or 5@0x1234.
        device: Selector,
        /// Name as in the protocol guide (with or without "param") or number.
        parameter: String,
        /// In the parameter's unit (40A, 50%, 1.5, on), or raw as 0x00018000.
        #[arg(allow_hyphen_values = true)]
        value: String,
    },
    /// Put parameters, faults and the device's name back to their defaults.
    Reset {
        /// The device, as 5, talon:5, @0x1234 or 5@0x1234.
        device: Selector,
        /// Its number and the strings of its manufacture too.
        #[arg(long)]
        all: bool,
    },
}

/// Runs the action.
pub(super) fn run(arguments: &Arguments, global: &Global) -> Result<Outcome, Failure> {
    match &arguments.action {
        Action::Get { device, parameters } => get(device, parameters, global),
        Action::Set {
            device,
            parameter,
            value,
        } => set(device, parameter, value, global),
        Action::Reset { device, all } => reset(device, *all, global),
    }
}

fn get(selector: &Selector, names: &[String], global: &Global) -> Result<Outcome, Failure> {
    let rows = if names.is_empty() {
        TABLE.iter().collect()
    } else {
        let found: Result<Vec<_>, Failure> = names.iter().map(|name| find(name)).collect();
        found?
    };
    let mut client = global.connect()?;
    let address = client.find(selector)?.address;
    let mut values = Vec::new();
    for row in rows {
        match client.parameter(address, row.id) {
            Ok(value) => values.push(value),
            // This project's own parameters are unknown to other firmware; only who names one is told.
            Err(Error::Refused { .. }) if names.is_empty() && is_own(row) => {}
            Err(error) => return Err(error.into()),
        }
    }
    if global.json {
        let list: Vec<Json> = values.iter().map(|value| describe(*value)).collect();
        output::json(&json!({"device": address.to_string(), "parameters": list}))?;
    } else {
        for value in values {
            print(value)?;
        }
    }
    Ok(Outcome::Done)
}

fn set(selector: &Selector, name: &str, text: &str, global: &Global) -> Result<Outcome, Failure> {
    let value = Value::parse(find(name)?, text)?;
    let mut client = global.connect()?;
    let address = client.find(selector)?.address;
    let answer = client.set_parameter(address, value)?;
    if global.json {
        let mut document = describe(answer);
        document["device"] = json!(address.to_string());
        output::json(&document)?;
    } else {
        print(answer)?;
    }
    Ok(Outcome::Done)
}

fn reset(selector: &Selector, all: bool, global: &Global) -> Result<Outcome, Failure> {
    let mut client = global.connect()?;
    let address = client.find(selector)?.address;
    let after = client.factory_reset(address, all)?;
    if global.json {
        output::json(&json!({"device": after.to_string(), "reset": true, "all": all}))?;
    } else if all {
        say!("device {address} is at its defaults and has no number any more; it is {after} now")?;
    } else {
        say!("parameters, faults and name of device {address} are at their defaults")?;
    }
    Ok(Outcome::Done)
}

fn find(name: &str) -> Result<&'static Parameter, Failure> {
    find_parameter(name).map_err(|error| {
        Failure::new(
            Kind::Refused,
            error.to_string(),
            "list every parameter with `windlass param get DEVICE`",
        )
    })
}

fn print(value: Value) -> Result<(), Failure> {
    let row = value.parameter.row();
    let (number, name, raw) = (row.id.code(), row.name, value.raw);
    say!("{number:>3}  {name:<34}  {raw:#010x}  {value}")
}

fn describe(value: Value) -> Json {
    let row = value.parameter.row();
    json!({
        "number": row.id.code(),
        "name": row.name,
        "value": value.number(),
        "unit": row.unit,
        "raw": value.raw,
        "text": value.to_string(),
    })
}
