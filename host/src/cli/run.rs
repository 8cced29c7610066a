//! `windlass run`: drive a device and watch it, then switch it off.

use std::time::Duration;

use clap::Args;
use windlass_core::dialect::dmc60c::wire::Control0;
use windlass_core::params::table::ParameterId;

use super::connect::{Connection, Seconds};
use super::output::{self, LiveLine, say};
use super::sample::Sample;
use super::{Failure, Global, Kind, Outcome, interrupted, talon};
use crate::client::talon::NeutralMode;
use crate::client::{Address, CONTROL_PERIOD, Drive, Selector, Target, ValueError};

/// Without a general status frame for this long while driving, the device counts as gone; the frame
/// comes at least every 50 ms.
const GONE_AFTER: Duration = Duration::from_secs(1);
/// Time for the frame that switches the output off, and for the status that shows it.
const SWITCH_OFF_TIME: Duration = Duration::from_millis(60);

/// Arguments of `windlass run`.
#[derive(Clone, Debug, Args)]
pub(super) struct Arguments {
    /// The device, as 5, talon:5, @0x1234 or 5@0x1234.
    device: Selector,
    #[command(flatten)]
    target: TargetArguments,
    /// Gain slot of the closed loops.
    #[arg(long, value_parser = clap::value_parser!(u8).range(0..=1), default_value_t = 0)]
    slot: u8,
    /// Largest change of the duty cycle per 500 µs in throttle units (32767 is 100 %), 0 for none; for
    /// --duty, --voltage and --follow. For a Talon per 10 ms in its units (1023 is 100 %), in every mode.
    #[arg(long, value_name = "UNITS", default_value_t = 0)]
    ramp: u16,
    /// Brake at neutral, whatever the device has stored.
    #[arg(long, conflicts_with = "coast")]
    brake: bool,
    /// Coast at neutral, whatever the device has stored.
    #[arg(long)]
    coast: bool,
    /// Drive the motor the other way round.
    #[arg(long)]
    reverse_motor: bool,
    /// Count the encoder the other way round.
    #[arg(long)]
    reverse_sensor: bool,
    /// Counts of the encoder per revolution (four times its cycles), for --rpm.
    #[arg(long, value_name = "COUNTS", default_value_t = 4096)]
    counts_per_revolution: u32,
    /// Drive this long [default: until Ctrl-C; 5 seconds on the sim transport].
    #[arg(long, value_name = "SECONDS")]
    seconds: Option<Seconds>,
    /// Milliseconds between two printed samples.
    #[arg(long, value_name = "MS", default_value_t = 100, value_parser = clap::value_parser!(u64).range(10..=60_000))]
    every: u64,
}

#[derive(Clone, Debug, Args)]
#[group(required = true, multiple = false)]
#[allow(
    clippy::struct_field_names,
    reason = "fields are the names of the options"
)]
struct TargetArguments {
    /// Duty cycle in percent, −100 to 100; the sign % may follow.
    #[arg(long, value_name = "PERCENT", allow_hyphen_values = true)]
    duty: Option<String>,
    /// Closed-loop velocity in revolutions per minute.
    #[arg(long, allow_hyphen_values = true)]
    rpm: Option<String>,
    /// Closed-loop velocity in counts per 100 ms.
    #[arg(long, value_name = "COUNTS", allow_hyphen_values = true)]
    velocity: Option<i32>,
    /// Closed-loop position in counts.
    #[arg(long, value_name = "COUNTS", allow_hyphen_values = true)]
    position: Option<i32>,
    /// Closed-loop current in amperes; the unit A may follow.
    #[arg(long, value_name = "AMPERES", allow_hyphen_values = true)]
    current: Option<String>,
    /// Output voltage in volts, whatever the bus voltage is; the unit V may follow.
    #[arg(long, value_name = "VOLTS", allow_hyphen_values = true)]
    voltage: Option<String>,
    /// The duty cycle of another device, by its number.
    #[arg(long, value_name = "NUMBER")]
    follow: Option<u8>,
}

impl TargetArguments {
    fn target(&self, counts_per_revolution: u32) -> Result<Target, ValueError> {
        if let Some(text) = &self.duty {
            return Ok(Target::Duty(quantity("--duty", text, "%")?));
        }
        if let Some(text) = &self.rpm {
            return Target::rpm(quantity("--rpm", text, "rpm")?, counts_per_revolution);
        }
        if let Some(text) = &self.current {
            return Ok(Target::Current(quantity("--current", text, "A")?));
        }
        if let Some(text) = &self.voltage {
            return Ok(Target::Voltage(quantity("--voltage", text, "V")?));
        }
        let counts = self.velocity.map(Target::Velocity);
        let counts = counts.or(self.position.map(Target::Position));
        let target = counts.or(self.follow.map(Target::Follow));
        target.ok_or_else(|| ValueError::new("a target is missing, for example --duty 20%"))
    }
}

/// A finite number that its unit may follow.
fn quantity(option: &str, text: &str, unit: &str) -> Result<f64, ValueError> {
    let number = text.strip_suffix(unit).unwrap_or(text).trim_end();
    let number = number
        .parse::<f64>()
        .ok()
        .filter(|number| number.is_finite());
    number.ok_or_else(|| {
        ValueError::new(format!("{option} \"{text}\" is no finite number of {unit}"))
    })
}

impl Arguments {
    fn control(&self) -> Result<Control0, ValueError> {
        let target = self.target.target(self.counts_per_revolution)?;
        let mut drive = Drive::new(target)?.ramp(self.ramp);
        if self.slot == 1 {
            drive = drive.slot_1();
        }
        if self.brake {
            drive = drive.brake();
        }
        if self.coast {
            drive = drive.coast();
        }
        if self.reverse_motor {
            drive = drive.reverse_motor();
        }
        if self.reverse_sensor {
            drive = drive.reverse_sensor();
        }
        Ok(drive.frame())
    }

    fn talon_drive(&self, run_time: Option<Duration>) -> Result<talon::run::Drive, ValueError> {
        let neutral = match (self.brake, self.coast) {
            (true, _) => NeutralMode::Brake,
            (_, true) => NeutralMode::Coast,
            _ => NeutralMode::Jumper,
        };
        Ok(talon::run::Drive {
            target: self.target.target(self.counts_per_revolution)?,
            slot: self.slot,
            ramp: self.ramp,
            neutral,
            reverse_motor: self.reverse_motor,
            reverse_sensor: self.reverse_sensor,
            every: Duration::from_millis(self.every),
            run_time,
        })
    }
}

/// Drives the device; whatever ends the drive, the last frame switches the output off.
pub(super) fn run(arguments: &Arguments, global: &Global) -> Result<Outcome, Failure> {
    let control = arguments.control()?;
    let run_time = global.run_time(arguments.seconds)?;
    let mut client = global.connect()?;
    let device = client.find(&arguments.device)?;
    let address = device.address;
    if talon::is_talon(&mut client, &device)? {
        let drive = arguments.talon_drive(run_time)?;
        return drive.run(&mut client, address.number, global);
    }
    let mut drive = Drives {
        client: &mut client,
        number: address.number,
        control,
        every: Duration::from_millis(arguments.every),
        json: global.json,
        live: LiveLine::new(),
    };
    let driven = drive.until(run_time);
    let finished = drive.live.finish();
    let off = switch_off(&mut client, address.number);
    let outcome = driven?;
    finished?;
    let off = off?;
    if !global.json {
        say!(
            "{}",
            if off {
                "output off"
            } else {
                "switched off; the device has not confirmed it"
            }
        )?;
    }
    match outcome {
        Outcome::Done => report_faults(&mut client, address, global.json),
        ended => Ok(ended),
    }
}

/// The faults that are active after the drive; the status frame does not carry all of them.
fn report_faults(
    client: &mut Connection,
    address: Address,
    json: bool,
) -> Result<Outcome, Failure> {
    let active = client.parameter(address, ParameterId::ActiveFaults)?;
    if active.raw == 0 {
        return Ok(Outcome::Done);
    }
    if !json {
        say!("active faults: {active}")?;
    }
    Ok(Outcome::FaultReported)
}

struct Drives<'a> {
    client: &'a mut Connection,
    number: u8,
    control: Control0,
    every: Duration,
    json: bool,
    live: LiveLine,
}

impl Drives<'_> {
    /// Drives for `run_time`, or until Ctrl-C.
    fn until(&mut self, run_time: Option<Duration>) -> Result<Outcome, Failure> {
        let start = self.client.now();
        let mut next_sample = start + self.every;
        let mut next_control = start;
        loop {
            let now = self.client.now();
            if now >= next_sample {
                self.show()?;
                next_sample += self.every;
            }
            if run_time.is_some_and(|run_time| now >= start + run_time) {
                return Ok(Outcome::Done);
            }
            if interrupted() {
                return Ok(Outcome::Interrupted);
            }
            if now >= next_control {
                self.client.control(self.number, &self.control)?;
                next_control = now + CONTROL_PERIOD;
            }
            self.check_alive(start)?;
            let wait = next_control.min(next_sample).saturating_sub(now);
            self.client.listen(wait)?;
        }
    }

    fn show(&mut self) -> Result<(), Failure> {
        let Some(status) = self.client.status(self.number) else {
            return Ok(());
        };
        let sample = Sample {
            number: self.number,
            status,
            now: self.client.now(),
            leds: None,
        };
        if self.json {
            output::json(&sample.document())?;
        } else {
            self.live.show(&sample.line())?;
        }
        Ok(())
    }

    fn check_alive(&self, start: Duration) -> Result<(), Failure> {
        let general = self
            .client
            .status(self.number)
            .and_then(|status| status.general);
        let last = general.map_or(start, |live| live.at.max(start));
        if self.client.now().saturating_sub(last) <= GONE_AFTER {
            return Ok(());
        }
        Err(Failure::new(
            Kind::NoAnswer,
            format!("device {} has stopped reporting", self.number),
            "check its power and the bus, then look for it with `windlass scan`",
        ))
    }
}

/// Sends the frame that switches the output off and waits for a status; true if it shows no output.
fn switch_off(client: &mut Connection, number: u8) -> Result<bool, Failure> {
    client.switch_off(number)?;
    client.listen(SWITCH_OFF_TIME)?;
    let general = client.status(number).and_then(|status| status.general);
    Ok(general.is_some_and(|live| live.value.duty == 0))
}
