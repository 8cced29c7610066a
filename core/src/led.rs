//! What the LEDs show: a pure function of the state and the time.
//!
//! Four LEDs stand in a circle, numbered clockwise; the fifth shows brake or coast. Sources: DMC60C guide
//! (`vcmdFlashLEDS`, halted state), its hardware reference manual (neutral, direction, brake/coast), and
//! `docs/leds.md` for everything that no source tells.

use crate::engine::command::Neutral;
use crate::engine::snapshot::{DriveState, Snapshot};
use crate::time::{Duration, Instant};
use crate::units::Duty;

/// Colour of one LED.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum Colour {
    /// Dark.
    #[default]
    Off,
    /// Red.
    Red,
    /// Orange.
    Orange,
    /// Yellow.
    Yellow,
    /// Green.
    Green,
    /// Blue.
    Blue,
    /// Fuchsia.
    Fuchsia,
    /// Cyan.
    Cyan,
    /// White.
    White,
}

impl Colour {
    /// The colour's name in lower case.
    #[must_use]
    pub const fn name(self) -> &'static str {
        match self {
            Self::Off => "off",
            Self::Red => "red",
            Self::Orange => "orange",
            Self::Yellow => "yellow",
            Self::Green => "green",
            Self::Blue => "blue",
            Self::Fuchsia => "fuchsia",
            Self::Cyan => "cyan",
            Self::White => "white",
        }
    }
}

/// All LEDs at one moment.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Leds {
    /// The circle, LED1 to LED4 clockwise. LED1 and LED2 stand on the M+ (forward) side.
    pub ring: [Colour; 4],
    /// Red while neutral brakes, off while it coasts.
    pub brake: Colour,
}

/// What the LEDs have to tell, the most urgent first.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Indication {
    /// Identify command: a rainbow. Holds the time since it began.
    Identify(Duration),
    /// The bootloader runs.
    Bootloader,
    /// A fault is active; holds its bit.
    Fault(u8),
    /// Neither CAN bus nor RC-PWM pulses.
    NoLink,
    /// Connected, waiting for a command.
    Halted,
    /// A limit refuses to drive forward.
    ForwardLimit,
    /// A limit refuses to drive in reverse.
    ReverseLimit,
    /// Driving with this duty cycle, or neutral at zero.
    Drive(Duty),
}

/// Length of the identify pattern (guide, `vcmdFlashLEDS`).
pub const IDENTIFY_TIME: Duration = Duration::from_millis(5_000);

const RAINBOW: [Colour; 7] = [
    Colour::Red,
    Colour::Orange,
    Colour::Yellow,
    Colour::Green,
    Colour::Blue,
    Colour::Fuchsia,
    Colour::Cyan,
];

/// Time of each rainbow colour, of each flash of a fault code, and between the sides while halted.
const RAINBOW_STEP_MS: u32 = 100;
const FLASH_MS: u32 = 250;
const HALTED_MS: u32 = 250;
/// Half period of the 1 Hz blinking without a link.
const NO_LINK_MS: u32 = 500;
/// Time of one running step: from 250 ms near neutral to 25 ms near full duty cycle.
const SLOWEST_STEP_MS: u32 = 250;
const FASTEST_STEP_MS: u32 = 25;
const BOOTLOADER_STEP_MS: u32 = 125;

/// The indication of an application's state. `linked` tells that a CAN bus is seen.
#[must_use]
pub fn indication(linked: bool, snapshot: &Snapshot) -> Indication {
    if let Some(fault) = snapshot.faults.lowest() {
        return Indication::Fault(fault as u8);
    }
    if !linked && !snapshot.pulse_valid {
        return Indication::NoLink;
    }
    if snapshot.state != DriveState::Running {
        return Indication::Halted;
    }
    if snapshot.forward.refused {
        return Indication::ForwardLimit;
    }
    if snapshot.reverse.refused {
        return Indication::ReverseLimit;
    }
    Indication::Drive(snapshot.duty())
}

/// Milliseconds, wrapping after 49 days. Divides in steps of 16 bits, because a division of 64 bits is a function of
/// 400 bytes, which a bootloader cannot spare.
fn millis(micros: u64) -> u32 {
    let (mut quotient, mut rest) = (0_u32, 0_u32);
    for shift in [48, 32, 16, 0] {
        let part = rest << 16 | u32::from((micros >> shift) as u16);
        quotient = quotient << 16 | part / 1000;
        rest = part % 1000;
    }
    quotient
}

/// The LEDs for an indication at `now`.
#[must_use]
pub fn leds(now: Instant, indication: Indication, neutral: Neutral) -> Leds {
    let ms = millis(now.as_micros());
    let ring = match indication {
        Indication::Identify(since) => rainbow(millis(since.as_micros())),
        Indication::Bootloader => running(ms / BOOTLOADER_STEP_MS, Colour::White, true),
        Indication::Fault(bit) => [fault_flash(ms, bit); 4],
        Indication::NoLink => [blink(ms, NO_LINK_MS, Colour::Red); 4],
        Indication::Halted => {
            let (orange, off) = (Colour::Orange, Colour::Off);
            if (ms / HALTED_MS).is_multiple_of(2) {
                [orange, orange, off, off]
            } else {
                [off, off, orange, orange]
            }
        }
        Indication::ForwardLimit => [Colour::Red, Colour::Red, Colour::Off, Colour::Off],
        Indication::ReverseLimit => [Colour::Off, Colour::Off, Colour::Red, Colour::Red],
        Indication::Drive(Duty::ZERO) => [Colour::Orange; 4],
        Indication::Drive(duty) => drive(ms, duty),
    };
    let brake = match neutral {
        Neutral::Brake => Colour::Red,
        Neutral::Coast => Colour::Off,
    };
    Leds { ring, brake }
}

fn blink(ms: u32, half_period: u32, colour: Colour) -> Colour {
    if (ms / half_period).is_multiple_of(2) {
        colour
    } else {
        Colour::Off
    }
}

/// Every corner goes through the seven colours, each one step behind its neighbour.
fn rainbow(ms: u32) -> [Colour; 4] {
    [0, 1, 2, 3].map(|corner| {
        let at = (ms / RAINBOW_STEP_MS + corner) % RAINBOW.len() as u32;
        RAINBOW.get(at as usize).copied().unwrap_or_default()
    })
}

/// One LED lit, moving clockwise or back.
fn running(step: u32, colour: Colour, clockwise: bool) -> [Colour; 4] {
    let at = if clockwise { step % 4 } else { 3 - step % 4 };
    [0, 1, 2, 3].map(|led| if led == at { colour } else { Colour::Off })
}

/// Forward runs green and clockwise, reverse red and back, faster with the duty cycle; all four are solid
/// at full duty cycle.
fn drive(ms: u32, duty: Duty) -> [Colour; 4] {
    let forward = duty > Duty::ZERO;
    let colour = if forward { Colour::Green } else { Colour::Red };
    let size = u32::from(duty.magnitude());
    if size >= 32767 {
        return [colour; 4];
    }
    let step = SLOWEST_STEP_MS - (SLOWEST_STEP_MS - FASTEST_STEP_MS) * size / 32767;
    running(ms / step, colour, forward)
}

/// Red flashes on an orange ground, one more than the fault's bit, then a pause of two flashes.
fn fault_flash(ms: u32, bit: u8) -> Colour {
    let flashes = u32::from(bit) + 1;
    let slot = ms / FLASH_MS % (2 * flashes + 4);
    if slot < 2 * flashes && slot.is_multiple_of(2) {
        Colour::Red
    } else {
        Colour::Orange
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use Colour::{Cyan, Fuchsia, Green, Off, Orange, Red};

    #[test]
    fn milliseconds_are_those_of_a_division() {
        for micros in [0, 999, 1000, 65_535_999, 1 << 32, (1 << 48) - 1, u64::MAX] {
            assert_eq!(millis(micros), (micros / 1000) as u32);
        }
    }

    fn ring(ms: u32, indication: Indication) -> [Colour; 4] {
        leds(
            Instant::from_micros(u64::from(ms) * 1000),
            indication,
            Neutral::Brake,
        )
        .ring
    }

    #[test]
    fn halted_alternates_orange_side_to_side() {
        assert_eq!(ring(0, Indication::Halted), [Orange, Orange, Off, Off]);
        assert_eq!(ring(250, Indication::Halted), [Off, Off, Orange, Orange]);
        assert_eq!(ring(500, Indication::Halted), [Orange, Orange, Off, Off]);
    }

    #[test]
    fn forward_runs_clockwise_in_green_and_is_solid_at_full() {
        let slow = Indication::Drive(Duty::new(1));
        assert_eq!(ring(0, slow), [Green, Off, Off, Off]);
        assert_eq!(ring(250, slow), [Off, Green, Off, Off]);
        assert_eq!(ring(0, Indication::Drive(Duty::MAX)), [Green; 4]);
        assert_eq!(ring(0, Indication::Drive(Duty::MIN)), [Red; 4]);
        assert_eq!(
            ring(0, Indication::Drive(Duty::new(-1))),
            [Off, Off, Off, Red]
        );
        assert_eq!(ring(0, Indication::Drive(Duty::ZERO)), [Orange; 4]);
    }

    #[test]
    fn a_fault_flashes_red_as_often_as_its_bit_plus_one() {
        for bit in 0..4 {
            let period = (2 * (u32::from(bit) + 1) + 4) * FLASH_MS;
            let reds = (0..period / FLASH_MS)
                .filter(|slot| ring(slot * FLASH_MS, Indication::Fault(bit)) == [Red; 4])
                .count();
            assert_eq!(reds, usize::from(bit) + 1);
        }
    }

    #[test]
    fn identify_shows_every_colour_of_the_guide_at_every_corner() {
        for corner in 0..4 {
            let seen: Vec<_> = (0..7)
                .map(|step| {
                    leds(
                        Instant::ZERO,
                        Indication::Identify(Duration::from_millis(step * 100)),
                        Neutral::Coast,
                    )
                    .ring[corner]
                })
                .collect();
            for colour in RAINBOW {
                assert!(seen.contains(&colour));
            }
        }
        assert!(RAINBOW.contains(&Fuchsia) && RAINBOW.contains(&Cyan));
    }

    #[test]
    fn the_brake_led_follows_the_neutral_setting() {
        let brake = |neutral| leds(Instant::ZERO, Indication::Halted, neutral).brake;
        assert_eq!((brake(Neutral::Brake), brake(Neutral::Coast)), (Red, Off));
    }

    extern crate std;
    use std::vec::Vec;
}
