//! The smallest useful dialect: the worked example of `docs/new-dialect.md`.
//!
//! 11-bit identifiers, device number 0 to 127 in the low bits:
//!
//! | identifier | direction | data |
//! |---|---|---|
//! | 0x100 + n | to the device | `i16` LE duty cycle, every 200 ms at least; no data: off |
//! | 0x180 + n | from the device | every 50 ms: `i16` LE duty cycle, `i32` LE position |
//! | 0x200 + n | to the device | parameter number: read it |
//! | 0x280 + n | from the device | parameter number, `u32` LE value; only the number if there is none |

use embedded_can::Id;

use super::schedule::Periodic;
use super::{Bad, Decoded, Dialect, Intent, Outcome, Outgoing, Request, View};
use crate::engine::command::{DriveOpts, Setpoint};
use crate::engine::settings::{Policy, Resume};
use crate::frame::Frame;
use crate::params::Params;
use crate::time::{Duration, Instant, TICKS_PER_MS};
use crate::units::Duty;

const COMMAND: u16 = 0x100;
const STATUS: u16 = 0x180;
const READ: u16 = 0x200;
const VALUE: u16 = 0x280;
const NUMBER_MASK: u16 = 0x7F;
const STATUS_PERIOD: Duration = Duration::from_millis(50);

/// What the dialect remembers.
#[derive(Clone, Debug, Default)]
pub struct Minimal {
    status: Periodic,
    owed: Option<Outcome>,
}

impl Dialect for Minimal {
    const NAME: &'static str = "minimal";

    const POLICY: Policy = Policy {
        command_timeout_ticks: (200 * TICKS_PER_MS) as u16,
        master_timeout_ticks: 0,
        fault_hold_ticks: (1000 * TICKS_PER_MS) as u16,
        resume: Resume::AnyCommand,
        ..Policy::BASE
    };

    fn decode(&mut self, number: u8, frame: &Frame) -> Decoded {
        let Id::Standard(id) = frame.id() else { return Decoded::Ignored };
        let id = id.as_raw();
        let mine = id & NUMBER_MASK == u16::from(number);
        if !mine || !matches!(id & !NUMBER_MASK, COMMAND | READ) {
            return Decoded::Ignored;
        }
        if frame.is_remote() {
            return Decoded::Bad(Bad::Remote);
        }
        let drive = |setpoint| Decoded::Intent(Intent::Drive(setpoint, DriveOpts::default()));
        match (id & !NUMBER_MASK, frame.data()) {
            (COMMAND, []) => drive(Setpoint::Off),
            (COMMAND, &[low, high]) => {
                drive(Setpoint::Duty(Duty::new(i16::from_le_bytes([low, high]))))
            }
            (READ, &[parameter]) => Decoded::Request(Request::Read(parameter)),
            _ => Decoded::Bad(Bad::Length),
        }
    }

    fn answer(&mut self, outcome: Outcome) {
        self.owed = Some(outcome);
    }

    fn start(&mut self, now: Instant, _: &Params) {
        self.status.start(now, STATUS_PERIOD);
    }

    fn stop(&mut self) {
        *self = Self::default();
    }

    fn encode(&mut self, now: Instant, view: &View<'_>) -> Option<Outgoing> {
        let own = u16::from(view.number) & NUMBER_MASK;
        if let Some(outcome) = self.owed.take() {
            return Some(Outgoing::Answer(match outcome.result {
                Ok(value) => {
                    let [a, b, c, d] = value.to_le_bytes();
                    Frame::standard(VALUE | own, [outcome.parameter, a, b, c, d])
                }
                Err(_) => Frame::standard(VALUE | own, [outcome.parameter]),
            }));
        }
        self.status.take(now, STATUS_PERIOD).then(|| {
            let [low, high] = view.snapshot.duty().units().to_le_bytes();
            let [a, b, c, d] = view.snapshot.position.to_le_bytes();
            Outgoing::Status(Frame::standard(STATUS | own, [low, high, a, b, c, d]))
        })
    }

    fn next_deadline(&self) -> Option<Instant> {
        if self.owed.is_some() { Some(Instant::ZERO) } else { self.status.due() }
    }
}
