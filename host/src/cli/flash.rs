//! `windlass flash`: update the firmware of devices.

use std::path::PathBuf;
use std::time::Duration;

use serde_json::{Value, json};

use super::connect::{Connection, Seconds};
use super::image::file_failure;
use super::output::{self, say};
use super::progress::{Progress, Row};
use super::{Failure, Global, Kind, Outcome};
use crate::client::{Client, Device, Error, Selector};
use crate::flash::{self, FlashError, Options, Report};
use crate::image::{Contents, Image, load};
use crate::transport::{Bus, ReconnectingBus};

/// Time to look for a device or a connection that is lost.
const PATIENCE: Duration = Duration::from_secs(30);

/// Arguments of `windlass flash`.
#[derive(Clone, Debug, clap::Args)]
pub(super) struct Arguments {
    /// The firmware file (.wlimg, .crf, .hex, .elf or .bin), then the devices as 5, talon:5, @0x1234 or
    /// 5@0x1234. Without a device the only one on the bus is meant.
    #[arg(value_name = "FILE] [DEVICE", required_unless_present = "rollback")]
    names: Vec<String>,
    /// Put the image back that the devices hold as fallback; no file is given.
    #[arg(long, conflicts_with_all = ["pack", "force"])]
    rollback: bool,
    /// Update every device on the bus.
    #[arg(long)]
    all: bool,
    /// Accept a file that comes straight from a linker and has no seal: it is packed first.
    #[arg(long)]
    pack: bool,
    /// Send every page even if a device has it, and update a device that does not tell its hardware.
    #[arg(long)]
    force: bool,
    /// Look this long for a device or an adapter that is lost during the update.
    #[arg(long, value_name = "SECONDS")]
    wait: Option<Seconds>,
}

/// What is to be done with each device.
enum Job {
    Update(Box<Image>),
    RollBack,
}

/// Updates the devices, one after the other.
pub(super) fn run(arguments: &Arguments, global: &Global) -> Result<Outcome, Failure> {
    let (job, names) = job(arguments, global)?;
    let selectors = selectors(names)?;
    if arguments.all && !selectors.is_empty() {
        return Err(Failure::new(
            Kind::Usage,
            "--all is given together with devices",
            "give the devices, or --all, but not both",
        ));
    }
    let patience = arguments.wait.map_or(PATIENCE, |seconds| seconds.0);
    let options = Options {
        force: arguments.force,
        patience,
    };
    let mut client = connect(global, patience)?;
    let devices = devices(&mut client, &selectors, arguments.all)?;
    if let Job::Update(image) = &job {
        // Nothing is sent to any device unless the image fits all of them.
        for device in &devices {
            flash::check(&mut client, device, image, &options)?;
        }
    }
    let progress = Progress::new(global.json);
    let rows: Vec<Row> = devices.iter().map(|device| progress.row(device)).collect();
    let mut done = Vec::new();
    for (device, mut row) in devices.iter().zip(rows) {
        row.begin();
        let result = match &job {
            Job::Update(image) => flash::flash(&mut client, device, image, &options, &mut row),
            Job::RollBack => flash::roll_back(&mut client, device, &options, &mut row),
        };
        let result = result.map_err(Failure::from);
        row.end(&result)?;
        let stop = matches!(&result, Err(failure) if failure.kind == Kind::Interrupted || failure.kind == Kind::Bus);
        done.push((*device, result));
        if stop {
            break;
        }
    }
    progress.end(done.iter().filter_map(|(_, result)| result.as_ref().ok()))?;
    report(done, global)
}

fn job<'a>(arguments: &'a Arguments, global: &Global) -> Result<(Job, &'a [String]), Failure> {
    if arguments.rollback {
        return Ok((Job::RollBack, &arguments.names));
    }
    let Some((file, names)) = arguments.names.split_first() else {
        return Err(Failure::new(
            Kind::Usage,
            "the firmware file is missing",
            "give a file, or --rollback",
        ));
    };
    let path = PathBuf::from(file);
    let contents = load(&path).map_err(|error| file_failure(&path, &error))?;
    if !global.json {
        let Contents { notices, .. } = &contents;
        notices
            .iter()
            .try_for_each(|notice| say!("note: {notice}"))?;
    }
    let image = if arguments.pack {
        Image::packed(contents)
    } else {
        Image::sealed(contents)
    };
    let image = image.map_err(|error| file_failure(&path, &error))?;
    Ok((Job::Update(Box::new(image)), names))
}

fn selectors(names: &[String]) -> Result<Vec<Selector>, Failure> {
    names
        .iter()
        .map(|name| {
            name.parse().map_err(|error: crate::client::SelectorError| {
                Failure::new(
                    Kind::Usage,
                    format!("bad device \"{name}\": {error}"),
                    "give the file first, then the devices",
                )
            })
        })
        .collect()
}

/// A client on a bus that is opened again when its connection breaks.
fn connect(global: &Global, patience: Duration) -> Result<Connection, Failure> {
    let transport = global.transport()?;
    let bus: Box<dyn Bus> = if transport.is_virtual() {
        transport.open()?
    } else {
        Box::new(ReconnectingBus::open(transport, patience)?)
    };
    let timeout = Duration::from_millis(global.timeout);
    Ok(Client::new(bus).with_answer_timeout(timeout))
}

fn devices(
    client: &mut Connection,
    selectors: &[Selector],
    all: bool,
) -> Result<Vec<Device>, Failure> {
    if selectors.is_empty() {
        let devices = client.scan()?;
        return match devices.len() {
            0 => Err(Error::NoDevice.into()),
            1 => Ok(devices),
            _ if all => Ok(devices),
            count => Err(Failure::new(
                Kind::NoDevice,
                format!("{count} devices are on this bus, and none is named"),
                "name the devices to update after the file, or give --all",
            )),
        };
    }
    let mut devices: Vec<Device> = Vec::new();
    for selector in selectors {
        let device = client.find(selector)?;
        if devices.iter().any(|named| named.address == device.address) {
            return Err(Failure::new(
                Kind::Usage,
                format!("device {} is named twice", device.address),
                "name each device once",
            ));
        }
        devices.push(device);
    }
    Ok(devices)
}

impl From<FlashError> for Failure {
    fn from(error: FlashError) -> Self {
        let kind = match error {
            FlashError::Client(error) => return error.into(),
            FlashError::WrongProduct { .. }
            | FlashError::WrongHardware { .. }
            | FlashError::RollbackRefused { .. }
            | FlashError::Unsigned(_) => Kind::File,
            FlashError::Driving(_)
            | FlashError::UnknownHardware(_)
            | FlashError::PageRefused { .. }
            | FlashError::NotStored(_)
            | FlashError::NoFallback(_)
            | FlashError::NoSignatures(_)
            | FlashError::NotStarted { .. }
            | FlashError::WrongVersion { .. } => Kind::Refused,
            FlashError::Lost { .. } => Kind::NoAnswer,
            FlashError::Cancelled { .. } | FlashError::CancelledEarly(_) => Kind::Interrupted,
        };
        Self::new(kind, error.to_string(), error.next_step())
    }
}

/// One device's result is the command's; with several, every error is told and the first decides.
fn report(
    done: Vec<(Device, Result<Report, Failure>)>,
    global: &Global,
) -> Result<Outcome, Failure> {
    let single = done.len() == 1;
    let first = done
        .iter()
        .find_map(|(_, result)| result.as_ref().err())
        .cloned();
    if let (true, Some(failure)) = (single, &first) {
        return Err(failure.clone());
    }
    if global.json {
        let list: Vec<Value> = done.iter().map(describe).collect();
        let mut document = json!({"devices": list});
        if let Some(failure) = &first {
            document["error"] = failure.describe();
        }
        output::json(&document)?;
    } else {
        for (_, result) in &done {
            if let Err(failure) = result {
                failure.print();
            }
        }
    }
    Ok(first.map_or(Outcome::Done, |failure| Outcome::Told(failure.kind)))
}

fn describe((device, result): &(Device, Result<Report, Failure>)) -> Value {
    match result {
        Ok(report) => json!({
            "device": report.address.to_string(),
            "number": report.address.number,
            "session": report.address.session,
            "before": report.before.map(|version| version.to_string()),
            "version": report.version.to_string(),
            "pages": report.pages,
            "sent": report.sent,
            "confirmed": report.confirmed,
            "seconds": report.took.as_secs_f64(),
        }),
        Err(failure) => json!({
            "device": device.address.to_string(),
            "number": device.address.number,
            "session": device.address.session,
            "error": failure.describe(),
        }),
    }
}
