//! From the global options to a client on a bus, and from a selector to devices.

use std::time::Duration;

use super::{Failure, Global};
use crate::client::{Client, Device, Error, Selector};
use crate::transport::{Bus, Transport};

/// A client on whatever bus the user named.
pub(super) type Connection = Client<Box<dyn Bus>>;

/// Time that a live verb runs on a simulated bus when none is given; virtual time does not slow down to
/// be watched.
const VIRTUAL_RUN: Duration = Duration::from_secs(5);

impl Global {
    /// The bus that the user named.
    pub(super) fn transport(&self) -> Result<Transport, Failure> {
        Ok(self.transport.parse()?)
    }

    /// Opens the bus.
    pub(super) fn connect(&self) -> Result<Connection, Failure> {
        let bus = self.transport()?.open()?;
        let timeout = Duration::from_millis(self.timeout);
        Ok(Client::new(bus).with_answer_timeout(timeout))
    }

    /// How long a live verb runs: as asked, else until Ctrl-C, but five virtual seconds in a simulation.
    pub(super) fn run_time(&self, seconds: Option<Seconds>) -> Result<Option<Duration>, Failure> {
        if let Some(seconds) = seconds {
            return Ok(Some(seconds.0));
        }
        Ok(self.transport()?.is_virtual().then_some(VIRTUAL_RUN))
    }
}

/// The devices that a verb works on: the one that is named, or all.
pub(super) fn devices(
    client: &mut Connection,
    selector: Option<&Selector>,
) -> Result<Vec<Device>, Failure> {
    if let Some(selector) = selector {
        return Ok(vec![client.find(selector)?]);
    }
    let devices = client.scan().map_err(Failure::from)?;
    if devices.is_empty() {
        return Err(Error::NoDevice.into());
    }
    Ok(devices)
}

/// A positive number of seconds on the command line.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) struct Seconds(pub(super) Duration);

impl std::str::FromStr for Seconds {
    type Err = String;

    fn from_str(text: &str) -> Result<Self, String> {
        let seconds = text.parse::<f64>().ok().filter(|seconds| *seconds > 0.0);
        let span = seconds.and_then(|seconds| Duration::try_from_secs_f64(seconds).ok());
        span.map(Self)
            .ok_or_else(|| "a positive number of seconds is wanted".to_owned())
    }
}
