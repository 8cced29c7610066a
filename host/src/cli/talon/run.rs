//! `windlass run` of a Talon: enable, drive, watch, switch off.

use std::time::Duration;

use super::sample::Sample;
use super::{Connection, robot};
use crate::cli::output::{self, LiveLine, say};
use crate::cli::{Failure, Global, Kind, Outcome, interrupted};
use crate::client::talon::{CanTalon, ControlMode, NeutralMode, Robot, TalonStatus};
use crate::client::{Target, ValueError};
use crate::transport::Bus;

/// Without a frame for this long while driving, the device counts as gone.
const GONE_AFTER: Duration = Duration::from_secs(1);
/// Time for the frame that switches the output off, and for the status that shows it.
const SWITCH_OFF_TIME: Duration = Duration::from_millis(60);
/// Longest wait between two looks at Ctrl-C.
const LOOK: Duration = Duration::from_millis(50);

/// What to drive and how.
pub(in crate::cli) struct Drive {
    pub(in crate::cli) target: Target,
    pub(in crate::cli) slot: u8,
    pub(in crate::cli) ramp: u16,
    pub(in crate::cli) neutral: NeutralMode,
    pub(in crate::cli) reverse_motor: bool,
    pub(in crate::cli) reverse_sensor: bool,
    pub(in crate::cli) every: Duration,
    pub(in crate::cli) run_time: Option<Duration>,
}

impl Drive {
    /// Mode and set point of the target.
    fn set_point(&self) -> Result<(ControlMode, f64), ValueError> {
        let unsupported = |what: &str| {
            ValueError::new(format!(
                "a Talon with firmware 1.1 has no {what} mode; use --duty, --velocity, --position or --follow"
            ))
        };
        match self.target {
            Target::Duty(percent) if self.reverse_motor => Err(ValueError::new(format!(
                "a Talon reverses the output of closed loops and of following only; use --duty {}",
                -percent
            ))),
            Target::Duty(percent) => Ok((ControlMode::PercentVbus, percent / 100.0)),
            Target::Velocity(counts) => Ok((ControlMode::Speed, f64::from(counts))),
            Target::Position(counts) => Ok((ControlMode::Position, f64::from(counts))),
            Target::Follow(number) => Ok((ControlMode::Follower, f64::from(number))),
            Target::Current(_) => Err(unsupported("current")),
            Target::Voltage(_) => Err(unsupported("voltage compensation")),
        }
    }

    fn ramp(&self) -> Result<u8, ValueError> {
        u8::try_from(self.ramp).map_err(|_| {
            ValueError::new(format!(
                "--ramp {} is out of range for a Talon; allowed: 0 to 255 units of 1023 per 10 ms",
                self.ramp
            ))
        })
    }

    /// Drives the Talon; whatever ends the drive, the last frame switches the output off.
    pub(in crate::cli) fn run(
        &self,
        client: &mut Connection,
        number: u8,
        global: &Global,
    ) -> Result<Outcome, Failure> {
        let (mode, value) = self.set_point()?;
        let ramp = self.ramp()?;
        let robot = robot(client, global);
        let talon = robot.talon(number)?;
        talon.select_profile_slot(self.slot)?;
        talon.set_ramp_steps(ramp)?;
        talon.config_neutral_mode(self.neutral)?;
        talon.reverse_output(self.reverse_motor)?;
        talon.set_sensor_direction(self.reverse_sensor)?;
        talon.set_control_mode(mode)?;
        talon.set(value)?;
        let mut live = LiveLine::new();
        let driven = self.until(&robot, &talon, &mut live, global.json);
        let finished = live.finish();
        let off = switch_off(&robot, &talon);
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
        if outcome != Outcome::Done {
            return Ok(outcome);
        }
        let faults = talon.faults().value;
        if faults.is_empty() {
            return Ok(Outcome::Done);
        }
        if !global.json {
            let names: Vec<&str> = faults.names().collect();
            say!("active faults: {}", names.join(", "))?;
        }
        Ok(Outcome::FaultReported)
    }

    fn until<B: Bus>(
        &self,
        robot: &Robot<B>,
        talon: &CanTalon<B>,
        live: &mut LiveLine,
        json: bool,
    ) -> Result<Outcome, Failure> {
        robot.enable()?;
        let start = robot.now();
        let mut next_sample = start + self.every;
        loop {
            let now = robot.now();
            let status = talon.status();
            if now >= next_sample {
                show(talon.device_id(), &status, now, live, json)?;
                next_sample += self.every;
            }
            if self
                .run_time
                .is_some_and(|run_time| now >= start + run_time)
            {
                return Ok(Outcome::Done);
            }
            if interrupted() {
                return Ok(Outcome::Interrupted);
            }
            let last = status
                .general
                .map_or(start, |stamped| stamped.at.max(start));
            if now.saturating_sub(last) > GONE_AFTER {
                return Err(Failure::new(
                    Kind::NoAnswer,
                    format!("device {} has stopped reporting", talon.device_id()),
                    "check its power and the bus, then look for it with `windlass scan`",
                ));
            }
            let end = self
                .run_time
                .map_or(next_sample, |run_time| start + run_time);
            robot.run(next_sample.min(end).saturating_sub(now).min(LOOK))?;
        }
    }
}

fn show(
    number: u8,
    status: &TalonStatus,
    now: Duration,
    live: &mut LiveLine,
    json: bool,
) -> Result<(), Failure> {
    let sample = Sample {
        number,
        status,
        now,
        leds: None,
    };
    if json {
        output::json(&sample.document())?;
    } else {
        live.show(&sample.line())?;
    }
    Ok(())
}

/// Sends the frame that switches the output off and waits for a status; true if it shows no output.
fn switch_off<B: Bus>(robot: &Robot<B>, talon: &CanTalon<B>) -> Result<bool, Failure> {
    talon.disable()?;
    robot.run(SWITCH_OFF_TIME)?;
    let throttle = talon.applied_throttle();
    Ok(throttle.is_fresh() && throttle.value == 0)
}
