//! The motor's current from the shunts under the low sides of an H-bridge.
//!
//! While one way is driven, the low side of the other half-bridge is on all the time and carries the current of
//! the motor; with both low sides on, both carry it, with opposite signs. What comes out has the scale of the
//! reference board, so that `paramAdcCurrentMultiplier` keeps its default.

use windlass_core::engine::snapshot::Actuation;

/// Conversion without current; the zero of the reference board.
const ZERO: i32 = 2048;
/// Largest conversion of 12 bits.
const FULL: u16 = 4095;
/// Conversions that are averaged for the zero, with the bridge off: 8 ms, within the engine's self-check.
const AVERAGED: i32 = 16;
/// Further than this from the middle, a zero is taken for a broken amplifier and left out: 10 % of full scale.
const FARTHEST: i32 = 410;

/// One amplifier.
#[derive(Clone, Copy, Debug)]
struct Zero {
    sum: i32,
    at: i32,
}

impl Zero {
    const fn new() -> Self {
        Self { sum: 0, at: ZERO }
    }

    fn finish(&mut self) {
        let mean = self.sum / AVERAGED;
        if (mean - ZERO).abs() <= FARTHEST {
            self.at = mean;
        }
    }
}

/// Both amplifiers.
#[derive(Clone, Copy, Debug)]
pub struct Shunts {
    /// Steps of the reference board for 4096 steps of this one.
    scale: i32,
    zeros: [Zero; 2],
    averaged: i32,
    forward: bool,
}

impl Shunts {
    /// Shunts of `microamperes` for each step of the converter. The reference board has 64.7 A in 2048 steps
    /// (`docs/dmc60c.md`): 31,586 µA.
    #[must_use]
    pub const fn new(microamperes: i32) -> Self {
        Self {
            scale: microamperes * 4096 / 31_586,
            zeros: [Zero::new(); 2],
            averaged: 0,
            forward: true,
        }
    }

    /// What the tick has decided, so that the next conversions can be read.
    pub fn applied(&mut self, actuation: Actuation) {
        self.forward = actuation.duty().units() >= 0;
    }

    /// The current of the motor from the conversions below M+ and below M−, which grow with current into ground.
    /// The first conversions, with the bridge off, make the zero.
    pub fn current(&mut self, plus: u16, minus: u16) -> u16 {
        let [one, other] = &mut self.zeros;
        if self.averaged < AVERAGED {
            self.averaged += 1;
            one.sum += i32::from(plus);
            other.sum += i32::from(minus);
            if self.averaged == AVERAGED {
                one.finish();
                other.finish();
            }
        }
        let (conversion, distance) = if self.forward {
            (minus, i32::from(minus) - other.at)
        } else {
            (plus, one.at - i32::from(plus))
        };
        // A conversion at a rail stays one: the engine takes it for an over-current.
        match (conversion, self.forward) {
            (0, true) | (FULL.., false) => 0,
            (0, false) | (FULL.., true) => FULL,
            _ => (ZERO + ((distance * self.scale) >> 12)).clamp(0, i32::from(FULL)) as u16,
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use windlass_core::units::Duty;

    /// Half of the reference board's sensitivity.
    fn shunts(zero: u16) -> Shunts {
        let mut shunts = Shunts::new(15_793);
        for _ in 0..AVERAGED {
            shunts.current(zero, zero);
        }
        shunts
    }

    #[test]
    fn each_direction_is_read_where_its_current_returns() {
        let mut shunts = shunts(2048);
        shunts.applied(Actuation::Drive(Duty::new(1000)));
        assert_eq!(shunts.current(999, 2148), 2098);
        shunts.applied(Actuation::Drive(Duty::new(-1000)));
        assert_eq!(shunts.current(2148, 999), 1998);
        for actuation in [Actuation::Brake, Actuation::Off] {
            shunts.applied(actuation);
            assert_eq!(shunts.current(1948, 2148), 2098);
        }
    }

    #[test]
    fn the_zero_is_what_was_measured_at_the_start_unless_it_is_too_far_off() {
        assert_eq!(shunts(2100).current(2100, 2200), 2098);
        let broken = shunts(2600).current(2600, 2600);
        assert!(broken > 2300, "{broken}");
    }

    #[test]
    fn a_rail_stays_a_rail_in_both_directions() {
        let mut shunts = shunts(2048);
        assert_eq!(shunts.current(0, FULL), FULL);
        assert_eq!(shunts.current(0, 0), 0);
        shunts.applied(Actuation::Drive(Duty::new(-1)));
        assert_eq!(shunts.current(FULL, 0), 0);
        assert_eq!(shunts.current(0, 0), FULL);
    }
}
