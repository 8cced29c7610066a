//! What the LEDs show: a pure function of the state and the time.
//!
//! Four LEDs stand in a circle, numbered clockwise; the fifth shows brake or coast. Sources: DMC60C guide
//! (`vcmdFlashLEDS`, halted state), its hardware reference manual (neutral, direction, brake/coast), the
//! Talon SRX manual (2.2, 2.3.2, 4.1, 16.3 to 16.5, 16.13), and `docs/leds.md` for everything that no source
//! tells.

use crate::engine::command::Neutral;
use crate::engine::snapshot::{DriveState, Faults, Snapshot};
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
    /// Every colour, in the order of the codes in [`Leds::to_bits`].
    pub const ALL: [Self; 9] = [
        Self::Off,
        Self::Red,
        Self::Orange,
        Self::Yellow,
        Self::Green,
        Self::Blue,
        Self::Fuchsia,
        Self::Cyan,
        Self::White,
    ];

    /// The colour of the low 4 bits.
    fn from_code(code: u32) -> Option<Self> {
        Self::ALL.get((code & 0xF) as usize).copied()
    }

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

impl Leds {
    /// As `paramLeds` has them: 4 bits for each colour, LED1 in the lowest, the brake LED in bits 16 to 19.
    #[must_use]
    pub fn to_bits(self) -> u32 {
        let [a, b, c, d] = self.ring;
        let all = [a, b, c, d, self.brake];
        all.into_iter()
            .rev()
            .fold(0, |bits, colour| bits << 4 | colour as u32)
    }

    /// Reads the bits; `None` for a code that is no colour.
    #[must_use]
    pub fn from_bits(bits: u32) -> Option<Self> {
        let colour = |at: u32| Colour::from_code(bits >> (4 * at));
        Some(Self {
            ring: [colour(0)?, colour(1)?, colour(2)?, colour(3)?],
            brake: colour(4)?,
        })
    }
}

/// How the LEDs tell it. The dialect chooses.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum Style {
    /// One light runs around the circle.
    #[default]
    Running,
    /// All four blink together, as on a board that has one LED at either terminal.
    Blinking,
}

/// What the LEDs have to tell, the most urgent first.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Indication {
    /// Identify command: a rainbow. Holds the time since it began.
    Identify(Duration),
    /// The same in the bootloader.
    IdentifyInBootloader(Duration),
    /// The bootloader runs.
    Bootloader,
    /// A fault is active; holds its bit.
    Fault(u8),
    /// Neither CAN bus nor RC-PWM pulses.
    NoLink,
    /// An error frame was seen on the bus.
    BusError,
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

/// Length of the flash for an error frame (`docs/leds.md`).
pub const BUS_ERROR_TIME: Duration = Duration::from_millis(100);

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

/// Half periods of [`Style::Blinking`]: disabled 1 Hz, identify 8 Hz, bootloader 2 Hz (`docs/leds.md`).
const DISABLED_MS: u32 = 500;
const IDENTIFY_HALF_US: u32 = 62_500;
const BOOTLOADER_MS: u32 = 250;
/// A limit's light goes from one side to the other and pauses, 4 times a second.
const LIMIT_STEP_US: u32 = 250_000 / 3;
/// Half periods near neutral (2 Hz) and at full duty cycle (10 Hz).
const SLOWEST_BLINK_HZ: u32 = 2;
const FASTEST_BLINK_HZ: u32 = 10;

/// The indication of an application's state. `linked` tells that a CAN bus is seen, `stopping` which faults
/// keep the output off: only they are shown.
#[must_use]
pub fn indication(linked: bool, snapshot: &Snapshot, stopping: Faults) -> Indication {
    if let Some(fault) = snapshot.faults.intersection(stopping).lowest() {
        return Indication::Fault(fault as u8);
    }
    if !linked && !snapshot.pulse_valid {
        return Indication::NoLink;
    }
    if snapshot.state != DriveState::Running {
        return Indication::Halted;
    }
    if snapshot.limits.refused.forward() {
        return Indication::ForwardLimit;
    }
    if snapshot.limits.refused.reverse() {
        return Indication::ReverseLimit;
    }
    Indication::Drive(snapshot.duty())
}

/// The time in µs, which starts anew after 71 minutes, with a jump of the pattern. The division of 64 bits is a
/// function of 400 bytes, which a bootloader cannot spare.
const fn micros(now: Instant) -> u32 {
    now.as_micros() as u32
}

/// A time of a few seconds in µs.
const fn short(time: Duration) -> u32 {
    time.as_micros() as u32
}

/// The LEDs for an indication at `now`.
#[must_use]
pub fn leds(now: Instant, style: Style, indication: Indication, neutral: Neutral) -> Leds {
    let ring = match style {
        Style::Running => running_ring(now, indication),
        Style::Blinking => blinking_ring(now, indication),
    };
    let brake = match neutral {
        Neutral::Brake => Colour::Red,
        Neutral::Coast => Colour::Off,
    };
    Leds { ring, brake }
}

fn running_ring(now: Instant, indication: Indication) -> [Colour; 4] {
    let ms = micros(now) / 1000;
    match indication {
        Indication::Identify(since) | Indication::IdentifyInBootloader(since) => {
            rainbow(short(since) / 1000)
        }
        Indication::Bootloader => running(ms / BOOTLOADER_STEP_MS, Colour::White, true),
        Indication::Fault(bit) => [fault_flash(ms, bit); 4],
        Indication::NoLink => [blink(ms, NO_LINK_MS, Colour::Red); 4],
        Indication::BusError => [Colour::Red; 4],
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
    }
}

fn blinking_ring(now: Instant, indication: Indication) -> [Colour; 4] {
    let us = micros(now);
    let ms = us / 1000;
    let (red, off) = (Colour::Red, Colour::Off);
    match indication {
        Indication::Identify(since) => [blink(short(since), IDENTIFY_HALF_US, Colour::Orange); 4],
        Indication::IdentifyInBootloader(since) => [alternate(short(since) / IDENTIFY_HALF_US); 4],
        Indication::Bootloader => [alternate(ms / BOOTLOADER_MS); 4],
        Indication::Fault(bit) => [fault_flash(ms, bit); 4],
        Indication::NoLink => [blink(ms, NO_LINK_MS, red); 4],
        Indication::BusError => [red; 4],
        Indication::Halted => [blink(ms, DISABLED_MS, Colour::Orange); 4],
        Indication::ForwardLimit => match us / LIMIT_STEP_US % 3 {
            0 => [off, off, red, red],
            1 => [red, red, off, off],
            _ => [off; 4],
        },
        Indication::ReverseLimit => match us / LIMIT_STEP_US % 3 {
            0 => [red, red, off, off],
            1 => [off, off, red, red],
            _ => [off; 4],
        },
        Indication::Drive(Duty::ZERO) => [Colour::Orange; 4],
        Indication::Drive(duty) => {
            let colour = if duty > Duty::ZERO {
                Colour::Green
            } else {
                red
            };
            let span = FASTEST_BLINK_HZ - SLOWEST_BLINK_HZ;
            // In units of 1/4096 Hz, so that the rate grows evenly; never 0.
            let rate = (SLOWEST_BLINK_HZ * 32_768 + span * u32::from(duty.magnitude())) / 8;
            [blink(us, 500_000 * 4096 / rate.max(1), colour); 4]
        }
    }
}

/// Green and orange in turn.
const fn alternate(step: u32) -> Colour {
    if step.is_multiple_of(2) {
        Colour::Green
    } else {
        Colour::Orange
    }
}

/// Lit in every first half of a period; both times in the same unit.
fn blink(time: u32, half_period: u32, colour: Colour) -> Colour {
    if (time / half_period.max(1)).is_multiple_of(2) {
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

    fn ring(ms: u32, indication: Indication) -> [Colour; 4] {
        leds(
            Instant::from_micros(u64::from(ms) * 1000),
            Style::Running,
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
                        Style::Running,
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
    fn blinking_grows_from_2_to_10_hz_with_the_duty_cycle() {
        let changes = |duty| {
            let shown = |us| {
                let now = Instant::from_micros(us);
                let indication = Indication::Drive(Duty::new(duty));
                leds(now, Style::Blinking, indication, Neutral::Brake).ring
            };
            (1..10_000)
                .filter(|ms| shown(ms * 1000) != shown(ms * 1000 - 1000))
                .count()
        };
        assert!((39..=41).contains(&changes(1)), "{}", changes(1));
        assert!(
            (199..=201).contains(&changes(i16::MAX)),
            "{}",
            changes(i16::MAX)
        );
    }

    #[test]
    fn the_bits_of_the_parameter_read_back() {
        for (code, colour) in (0..).zip(Colour::ALL) {
            let leds = Leds {
                ring: [colour, Red, Off, Colour::White],
                brake: colour,
            };
            assert_eq!(leds.to_bits(), code << 16 | 0x8010 | code);
            assert_eq!(Leds::from_bits(leds.to_bits()), Some(leds));
        }
        assert_eq!(Leds::from_bits(9), None);
    }

    #[test]
    fn the_brake_led_follows_the_neutral_setting() {
        let brake =
            |neutral| leds(Instant::ZERO, Style::Running, Indication::Halted, neutral).brake;
        assert_eq!((brake(Neutral::Brake), brake(Neutral::Coast)), (Red, Off));
    }

    extern crate std;
    use std::vec::Vec;
}
