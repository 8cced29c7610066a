//! `windlass demo`: a bench of its own, and a motor that turns because a client of the bus drives it.

mod moves;
mod screen;

use std::time::{Duration, Instant};

use super::output::say;
use super::{Failure, Global, Kind, Outcome, interrupted};
use crate::bench::{Config, Server};
use crate::client::{Address, Client};
use crate::transport::{Bus, Transport};

use moves::{PROGRAMME, Report};
use screen::Screen;

/// The controllers of the demo: one that is driven and one that has no number yet.
const NODES: [&str; 2] = ["dmc60c:1", "dmc60c:0"];
/// The number of the one that is driven.
const DRIVEN: u8 = 1;
/// Time for the last frame, which switches the output off, to reach the bus.
const SWITCH_OFF_TIME: Duration = Duration::from_millis(60);

/// Arguments of `windlass demo`.
#[derive(Clone, Debug, Default, clap::Args)]
pub struct Arguments {
    /// End after this many seconds with a summary; without it the demo goes on until Ctrl-C.
    #[arg(long, value_name = "SECONDS", value_parser = clap::value_parser!(u64).range(1..=86_400))]
    pub seconds: Option<u64>,
}

/// Runs the demo. It has its own bus and does not use `--transport`.
///
/// # Errors
/// The bench cannot be started, or its bus fails.
pub fn run(arguments: &Arguments, global: &Global) -> Result<Outcome, Failure> {
    let end = arguments
        .seconds
        .map(|seconds| Instant::now() + Duration::from_secs(seconds));
    let nodes = NODES.iter().filter_map(|node| node.parse().ok()).collect();
    let server = Server::start(&Config {
        nodes,
        ..Config::default()
    })?;
    if !global.json {
        introduce(&server)?;
    }
    let bus = Transport::Tcp {
        host: server.slcan().ip().to_string(),
        port: server.slcan().port(),
    };
    let timeout = Duration::from_millis(global.timeout);
    let mut demo = Demo {
        client: Client::new(bus.open()?).with_answer_timeout(timeout),
        screen: Screen::new(global.json),
        quiet: global.json,
        end,
        reports: Vec::new(),
    };
    let driven = demo.drive();
    // Whatever ended the drive, the motor is switched off before the bench goes.
    let off = demo.client.switch_off(DRIVEN);
    let off = off.and_then(|()| demo.client.listen(SWITCH_OFF_TIME));
    driven?;
    off?;
    let missed = demo.summarise()?;
    server.stop()?;
    Ok(if missed {
        Outcome::FaultReported
    } else {
        Outcome::Done
    })
}

fn introduce(server: &Server) -> Result<(), Failure> {
    let (slcan, http) = (server.slcan(), server.http());
    say!(
        "A virtual 1 Mbit/s CAN bus with two simulated motor controllers. This demo is a client of it;"
    )?;
    say!("others can join while it runs:")?;
    say!("  browser     http://{http}/")?;
    say!("  python-can  can.Bus(interface='slcan', channel='socket://{slcan}', bitrate=1000000)")?;
    say!("  windlass    windlass monitor --transport tcp:{slcan}")?;
    say!("")
}

struct Demo {
    client: Client<Box<dyn Bus>>,
    screen: Screen,
    quiet: bool,
    end: Option<Instant>,
    reports: Vec<Report>,
}

impl Demo {
    /// Moves until Ctrl-C or the end of the time.
    fn drive(&mut self) -> Result<(), Failure> {
        let device = self.find()?;
        moves::configure(&mut self.client, device)?;
        for part in PROGRAMME.into_iter().cycle() {
            let mut output = Ok(());
            let end = self.end;
            let screen = &mut self.screen;
            let report = moves::perform(&mut self.client, device, part, |client| {
                output = screen.show(client, device.number, part);
                output.is_ok() && !is_over(end)
            })?;
            output?;
            if let Some(report) = report {
                self.screen.finished(&report)?;
                self.reports.push(report);
            }
            if is_over(end) {
                break;
            }
        }
        Ok(())
    }

    /// Looks who is on the bus and takes the controller to be driven.
    fn find(&mut self) -> Result<Address, Failure> {
        let devices = self.client.scan()?;
        if !self.quiet {
            for device in &devices {
                let address = device.address;
                let (number, session) = (address.number, address.session);
                say!(
                    "found number {number}, session {session:#06x}, {}",
                    device.image_name()
                )?;
            }
            say!("")?;
        }
        let driven = devices
            .iter()
            .find(|device| device.address.number == DRIVEN);
        driven.map(|device| device.address).ok_or_else(|| {
            Failure::new(
                Kind::NoDevice,
                format!("controller {DRIVEN} of the demo did not answer"),
                "start the demo again when the machine is less busy",
            )
        })
    }

    /// Tells how the moves went; true if one missed its target.
    fn summarise(&self) -> Result<bool, Failure> {
        let missed = self.reports.iter().filter(|report| report.missed()).count();
        if !self.quiet {
            say!("")?;
            match self.reports.len() {
                0 => say!("no move was finished; give it more seconds")?,
                count => {
                    say!("{count} moves:")?;
                    for report in &self.reports {
                        say!("  {}", screen::summary(report))?;
                    }
                    say!(
                        "{} of {count} reached their target within 2 %",
                        count - missed
                    )?;
                }
            }
        }
        Ok(missed > 0)
    }
}

fn is_over(end: Option<Instant>) -> bool {
    interrupted() || end.is_some_and(|end| Instant::now() >= end)
}
