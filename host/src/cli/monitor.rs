//! `windlass monitor`: live status of devices, and the load of the bus.

use std::time::Duration;

use serde_json::json;
use windlass_core::led::Leds;
use windlass_core::management::identity::Manufacturer;

use super::connect::{Connection, Seconds, devices};
use super::output::{self, LiveLine};
use super::sample::Sample;
use super::{Failure, Global, Outcome, interrupted, talon};
use crate::client::{Address, Selector, Traffic};
use crate::transport::{Bus, Health, Transport};

/// Arguments of `windlass monitor`.
#[derive(Clone, Debug, clap::Args)]
pub(super) struct Arguments {
    /// The device, as 5, talon:5, @0x1234 or 5@0x1234; all devices if left out.
    device: Option<Selector>,
    /// Show the bus too: its load from counted bit times with stuff bits, and what the transport knows of
    /// its CAN controller; `?` is what it cannot know.
    #[arg(long)]
    bus: bool,
    /// Show what the LEDs of each device show at the moment of the sample, too: asks every device for it each
    /// time. Without this the command only listens.
    #[arg(long)]
    leds: bool,
    /// Watch this long [default: until Ctrl-C; 5 seconds on the sim transport].
    #[arg(long, value_name = "SECONDS")]
    seconds: Option<Seconds>,
    /// Milliseconds between two samples.
    #[arg(long, value_name = "MS", default_value_t = 100, value_parser = clap::value_parser!(u64).range(10..=60_000))]
    every: u64,
}

/// Prints samples until the time is over or Ctrl-C.
pub(super) fn run(arguments: &Arguments, global: &Global) -> Result<Outcome, Failure> {
    let run_time = global.run_time(arguments.seconds)?;
    let bit_rate = global.transport()?.bit_rate();
    let mut client = global.connect()?;
    let found = devices(&mut client, arguments.device.as_ref())?;
    let mut monitor = Monitor {
        only: arguments
            .device
            .and(found.first())
            .map(|device| device.address),
        lit: found
            .iter()
            .filter(|_| arguments.leds)
            .map(|device| (device.address, None))
            .collect(),
        load: arguments.bus.then_some(bit_rate),
        json: global.json,
        live: LiveLine::new(),
        traffic: client.traffic(),
        at: client.now(),
    };
    let every = Duration::from_millis(arguments.every);
    let end = run_time.map(|run_time| client.now() + run_time);
    let outcome = loop {
        client.listen(every)?;
        monitor.look(&mut client)?;
        let health = monitor.health(&mut client)?;
        monitor.show(&client, health)?;
        if interrupted() {
            break Outcome::Interrupted;
        }
        if end.is_some_and(|end| client.now() >= end) {
            break Outcome::Done;
        }
    };
    monitor.live.finish()?;
    Ok(outcome)
}

struct Monitor {
    /// The one device to show, else all.
    only: Option<Address>,
    /// The devices whose LEDs are wanted, with what they show.
    lit: Vec<(Address, Option<Leds>)>,
    /// The bit rate, if the load is wanted.
    load: Option<u32>,
    json: bool,
    live: LiveLine,
    /// Traffic and time at the last sample.
    traffic: Traffic,
    at: Duration,
}

impl Monitor {
    /// What the transport knows, if the bus is wanted.
    fn health(&self, client: &mut Connection) -> Result<Health, Failure> {
        Ok(match self.load {
            Some(_) => client.bus().health()?,
            None => Health::default(),
        })
    }

    /// Asks for the LEDs, if they are wanted.
    fn look(&mut self, client: &mut Connection) -> Result<(), Failure> {
        for (address, leds) in &mut self.lit {
            *leds = client.leds(*address)?;
        }
        Ok(())
    }

    fn leds(&self, manufacturer: Manufacturer, number: u8) -> Option<Leds> {
        let is_it = |(address, _): &&(Address, Option<Leds>)| {
            address.number == number && address.manufacturer == manufacturer
        };
        self.lit.iter().find(is_it)?.1
    }

    /// True if the device that sends status frames of this manufacturer under this number is wanted.
    fn shows(&self, manufacturer: Manufacturer, number: u8) -> bool {
        self.only
            .is_none_or(|only| only.number == number && only.manufacturer == manufacturer)
    }

    fn show(&mut self, client: &Connection, health: Health) -> Result<(), Failure> {
        let samples: Vec<Sample<'_>> = client
            .statuses()
            .filter(|(number, _)| self.shows(Manufacturer::Digilent, *number))
            .map(|(number, status)| Sample {
                number,
                status,
                now: client.now(),
                leds: self.leds(Manufacturer::Digilent, number),
            })
            .collect();
        let talons: Vec<talon::sample::Sample<'_>> = client
            .talon_statuses()
            .filter(|(number, _)| self.shows(Manufacturer::CrossTheRoad, *number))
            .map(|(number, status)| talon::sample::Sample {
                number,
                status,
                now: client.now(),
                leds: self.leds(Manufacturer::CrossTheRoad, number),
            })
            .collect();
        let load = self.load.map(|bit_rate| self.measure(client, bit_rate));
        if self.json {
            for sample in samples {
                output::json(&sample.document())?;
            }
            for sample in talons {
                output::json(&sample.document())?;
            }
            if let Some((percent, frames_per_second)) = load {
                output::json(&json!({
                    "t_s": client.now().as_secs_f64(),
                    "bus_load_percent": percent,
                    "frames_per_second": frames_per_second,
                    "bus_off": health.bus_off,
                    "tx_full": health.tx_full,
                    "receive_errors": health.receive_errors,
                    "transmit_errors": health.transmit_errors,
                    "flags": health.flags.names().collect::<Vec<_>>(),
                }))?;
            }
            return Ok(());
        }
        let mut lines: Vec<String> = samples.iter().map(Sample::line).collect();
        lines.extend(talons.iter().map(talon::sample::Sample::line));
        if let Some((percent, frames_per_second)) = load {
            let now = client.now().as_secs_f64();
            lines.push(format!(
                "{now:8.2} s  bus load {percent:5.1} %  {frames_per_second:.0} frames/s  {health}"
            ));
        }
        self.print(&lines)
    }

    /// One line is rewritten in place on a terminal, several are printed one after the other.
    fn print(&mut self, lines: &[String]) -> Result<(), Failure> {
        if let [line] = lines {
            self.live.show(line)?;
            return Ok(());
        }
        self.live.finish()?;
        for line in lines {
            output::line(format_args!("{line}"))?;
        }
        Ok(())
    }

    /// Bus load in percent and frames per second since the last sample.
    fn measure(&mut self, client: &Connection, bit_rate: u32) -> (f64, f64) {
        let (traffic, now) = (client.traffic(), client.now());
        let span = now.saturating_sub(self.at).as_secs_f64().max(1e-6);
        let bits = (traffic.bits - self.traffic.bits) as f64;
        let frames = (traffic.frames - self.traffic.frames) as f64;
        self.traffic = traffic;
        self.at = now;
        let percent = bits / (span * f64::from(bit_rate)) * 100.0;
        (percent, frames / span)
    }
}

impl Transport {
    /// Bit rate of the bus: what an SLCAN adapter was told, else the DMC60C's 1 Mbit/s.
    const fn bit_rate(&self) -> u32 {
        match self {
            Self::Slcan { bit_rate, .. } => *bit_rate,
            Self::Sim(_) | Self::Tcp { .. } | Self::SocketCan(_) => 1_000_000,
        }
    }
}
