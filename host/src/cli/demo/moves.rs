//! The demo's gains and moves, and what it takes to perform one: a plain client of the bus.

use std::time::Duration;

use windlass_core::params::table::ParameterId;

use crate::cli::Failure;
use crate::client::{Address, CONTROL_PERIOD, Client, Drive, Error, Target, Value, ValueError};
use crate::transport::Bus;

/// Period of the encoder status frame during the demo; the default of 100 ms is too slow to tell when a
/// move has settled.
const ENCODER_PERIOD_MS: u32 = 10;
/// How long each move lasts.
pub(super) const MOVE_TIME: Duration = Duration::from_millis(1500);
/// How long the motor brakes before the position moves.
const REST_TIME: Duration = Duration::from_millis(500);
/// A velocity has settled when it stays this close, in percent of the target.
const VELOCITY_BAND_PERCENT: f64 = 3.0;
/// A position has settled when it stays this close, in counts.
const POSITION_BAND: f64 = 2.0;
/// A move has missed when it ends further from its target, in percent.
const MISSED_PERCENT: f64 = 2.0;

const fn fixed(value: f64) -> u32 {
    (value * 65536.0) as i32 as u32
}

/// Gains for the default plant, a CIM motor with a small disc at 12 V and a 1024-cycle encoder; how they
/// were found and what they reach stands in `docs/tuning.md`. Slot 0 is for velocity, slot 1 for position.
const SETTINGS: [(ParameterId, u32); 14] = [
    (ParameterId::EncoderPeriod, ENCODER_PERIOD_MS),
    (ParameterId::Slot0P, fixed(0.25)),
    (ParameterId::Slot0I, fixed(0.003)),
    (ParameterId::Slot0IZone, 200_000),
    (ParameterId::Slot0F, fixed(0.86)),
    (ParameterId::Slot0Ramp, 200),
    (ParameterId::Slot1P, fixed(2.0)),
    (ParameterId::Slot1D, fixed(130.0)),
    (ParameterId::Slot1AllowableError, 2),
    (ParameterId::Slot1Ramp, 400),
    (ParameterId::Slot1ForwardMax, 12_000),
    (ParameterId::Slot1ReverseMax, -12_000_i32 as u32),
    (ParameterId::Slot1ForwardNominal, 600),
    (ParameterId::Slot1ReverseNominal, -600_i32 as u32),
];

/// One part of the demo.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Part {
    /// Turn at this many counts per 100 ms.
    Velocity(i32),
    /// Brake, and call the place where the shaft stands 0.
    Rest,
    /// Go to this position in counts.
    Position(i32),
}

/// What the demo repeats: 2930 rpm in both directions, then ten turns out and back.
pub(super) const PROGRAMME: [Part; 5] = [
    Part::Velocity(20_000),
    Part::Velocity(-20_000),
    Part::Rest,
    Part::Position(40_960),
    Part::Position(0),
];

impl Part {
    /// What it drives to, with its unit.
    pub(super) fn label(self) -> String {
        match self {
            Self::Velocity(target) => format!("velocity {target} counts/100 ms"),
            Self::Rest => "brake, then call this position 0".to_owned(),
            Self::Position(target) => format!("position {target} counts"),
        }
    }

    /// Target, and half of the band in which the move counts as settled.
    fn goal(self) -> Option<(f64, f64)> {
        match self {
            Self::Velocity(target) => {
                let target = f64::from(target);
                Some((target, target.abs() * VELOCITY_BAND_PERCENT / 100.0))
            }
            Self::Position(target) => Some((f64::from(target), POSITION_BAND)),
            Self::Rest => None,
        }
    }

    /// The measured value that the target is about.
    pub(super) fn measured<B: Bus>(self, client: &Client<B>, number: u8) -> Option<f64> {
        let status = client.status(number)?;
        match self {
            Self::Velocity(_) => status.velocity().map(f64::from),
            Self::Position(_) | Self::Rest => status.position().map(f64::from),
        }
    }

    fn drive(self) -> Result<Drive, ValueError> {
        Ok(match self {
            Self::Velocity(target) => Drive::new(Target::Velocity(target))?,
            Self::Position(target) => Drive::new(Target::Position(target))?.slot_1(),
            Self::Rest => Drive::new(Target::Duty(0.0))?.brake(),
        })
    }
}

/// How a move went.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct Report {
    /// What was to be done.
    pub(super) part: Part,
    /// The measured value at the end.
    pub(super) reached: f64,
    /// Distance from the target in percent: of the target velocity, or of the way to the position.
    pub(super) error_percent: f64,
    /// When the value came into its band to stay, if it did.
    pub(super) settled: Option<Duration>,
}

impl Report {
    /// True if the move ended too far from its target.
    pub(super) fn missed(&self) -> bool {
        self.error_percent.abs() > MISSED_PERCENT
    }
}

/// Sends the gains to a device.
///
/// # Errors
/// The device did not answer or refused a value.
pub(super) fn configure<B: Bus>(client: &mut Client<B>, device: Address) -> Result<(), Error> {
    for (parameter, raw) in SETTINGS {
        client.set_parameter(device, Value { parameter, raw })?;
    }
    Ok(())
}

/// Performs one part; `watch` is called every [`CONTROL_PERIOD`] and ends it early by returning false.
/// Gives no report then, nor for a part without a target.
///
/// # Errors
/// The bus failed, or the device did not answer.
pub(super) fn perform<B: Bus>(
    client: &mut Client<B>,
    device: Address,
    part: Part,
    mut watch: impl FnMut(&Client<B>) -> bool,
) -> Result<Option<Report>, Failure> {
    let control = part.drive()?.frame();
    let number = device.number;
    let start = client.now();
    let end = start
        + if part == Part::Rest {
            REST_TIME
        } else {
            MOVE_TIME
        };
    let from = part.measured(client, number).unwrap_or_default();
    let mut settled = None;
    while client.now() < end {
        client.control(number, &control)?;
        let next = end.min(client.now() + CONTROL_PERIOD);
        while client.now() < next {
            client.receive(next.saturating_sub(client.now()))?;
            if let (Some((target, band)), Some(value)) =
                (part.goal(), part.measured(client, number))
            {
                let inside = (value - target).abs() <= band;
                settled = inside.then(|| settled.unwrap_or_else(|| client.now() - start));
            }
        }
        if !watch(client) {
            return Ok(None);
        }
    }
    if part == Part::Rest {
        let zero = Value {
            parameter: ParameterId::EncoderPosition,
            raw: 0,
        };
        client.set_parameter(device, zero)?;
        // The next move measures its way from here, so a status from before must not be the latest.
        client.listen(Duration::from_millis(2 * u64::from(ENCODER_PERIOD_MS)))?;
    }
    let (Some((target, _)), Some(reached)) = (part.goal(), part.measured(client, number)) else {
        return Ok(None);
    };
    let whole = match part {
        Part::Velocity(_) | Part::Rest => target.abs(),
        Part::Position(_) => (target - from).abs(),
    };
    Ok(Some(Report {
        part,
        reached,
        error_percent: (reached - target) / whole.max(1.0) * 100.0,
        settled,
    }))
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::transport::SimBus;

    #[test]
    fn the_gains_of_the_docs_settle_on_the_default_plant() {
        let node = "dmc60c:1".parse().unwrap();
        let mut client = Client::new(SimBus::with_nodes(&[node]));
        let device = client.scan().unwrap()[0].address;
        configure(&mut client, device).unwrap();
        for part in PROGRAMME.into_iter().chain(PROGRAMME) {
            let report = perform(&mut client, device, part, |_| true).unwrap();
            let Some(report) = report else {
                assert_eq!(part, Part::Rest);
                continue;
            };
            assert!(!report.missed(), "{report:?}");
            let truth = client.bus().world().node(0).unwrap().truth();
            let limit = match part {
                Part::Velocity(target) => {
                    let error = truth.velocity_counts_per_100ms - f64::from(target);
                    assert!(error.abs() < 0.01 * f64::from(target.abs()), "{truth:?}");
                    Duration::from_millis(500)
                }
                _ => MOVE_TIME,
            };
            assert!(report.settled.is_some_and(|at| at < limit), "{report:?}");
        }
    }

    #[test]
    fn a_motor_that_is_held_misses_its_target() {
        let node = "dmc60c:1".parse().unwrap();
        let mut client = Client::new(SimBus::with_nodes(&[node]));
        let device = client.scan().unwrap()[0].address;
        configure(&mut client, device).unwrap();
        let sim = client.bus().world().node_mut(0).unwrap();
        sim.poke(windlass_sim::Poke::Stall(true));
        let report = perform(&mut client, device, PROGRAMME[0], |_| true).unwrap();
        let report = report.unwrap();
        assert!(report.missed() && report.settled.is_none(), "{report:?}");
    }

    #[test]
    fn a_move_ends_when_the_watcher_says_so() {
        let node = "dmc60c:1".parse().unwrap();
        let mut client = Client::new(SimBus::with_nodes(&[node]));
        let device = client.scan().unwrap()[0].address;
        let mut looks = 0;
        let report = perform(&mut client, device, PROGRAMME[0], |_| {
            looks += 1;
            looks < 3
        });
        assert_eq!(report, Ok(None));
        assert_eq!(looks, 3);
    }
}
