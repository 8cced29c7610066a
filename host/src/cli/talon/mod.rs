//! What the verbs do with Talon-driven devices.

pub(super) mod faults;
mod press;
pub(super) mod run;
pub(super) mod sample;
pub(super) mod test;

use std::time::Duration;

use windlass_core::management::wire::ImageType;

use super::connect::Connection;
use super::{Failure, Global};
use crate::client::talon::Robot;
use crate::client::{Device, Selector};
use crate::transport::Bus;

/// Name of the dialect.
const DIALECT: &str = "talon";

/// A robot controller that borrows a connection's bus.
type Borrowed<'a> = Robot<&'a mut Box<dyn Bus>>;

/// True if the application of this device is driven as a Talon.
pub(super) fn is_talon(client: &mut Connection, device: &Device) -> Result<bool, Failure> {
    let image = device.versions.map(|versions| versions.image);
    if image == Some(ImageType::Bootloader) {
        return Ok(false);
    }
    let dialect = client.dialect(device.address)?;
    Ok(dialect.is_some_and(|dialect| dialect.name() == DIALECT))
}

/// True for the name of the Talon's dialect.
pub(super) fn is_name(dialect: Option<&str>) -> bool {
    dialect == Some(DIALECT)
}

/// The number of the Talon that a selector names without a session, whether it is there or not.
pub(super) fn named(selector: Option<&Selector>) -> Option<u8> {
    let selector = selector?;
    let talon = selector.dialect?.name() == DIALECT;
    selector
        .number
        .filter(|_| talon && selector.session.is_none())
}

fn robot<'a>(client: &'a mut Connection, global: &Global) -> Borrowed<'a> {
    Robot::new(client.bus()).with_answer_time(Duration::from_millis(global.timeout))
}
