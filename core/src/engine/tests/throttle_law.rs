//! The control law in throttle units: the table of steps, and any sequence against a plain restatement.

use crate::engine::throttle_law::{Input, ThrottleGains, ThrottleLaw, zone};
use proptest::prelude::*;

extern crate std;
use std::string::{String, ToString};
use std::vec::Vec;

/// Every row of the table: error, accumulator, output and clamped throttle, bit for bit.
#[test]
fn every_row_of_the_table_is_met() {
    let mut lines = include_str!("throttle_law.csv")
        .lines()
        .filter(|line| !line.starts_with('#'));
    let names: Vec<&str> = lines.next().unwrap().split(',').collect();
    let mut law = ThrottleLaw::new();
    let mut vector = String::new();
    let mut rows = 0;
    for line in lines {
        // Names of vectors hold no commas; `throttle_if_floor` is for the reader.
        let cells: Vec<&str> = line.split(',').collect();
        assert_eq!(cells.len(), names.len(), "{line}");
        let text = |name: &str| cells[names.iter().position(|at| *at == name).unwrap()];
        let number = |name: &str| -> i64 { text(name).parse().unwrap() };
        if text("vector") != vector {
            vector = text("vector").to_string();
            law = ThrottleLaw::new();
        }
        match text("event") {
            "reset" => law = ThrottleLaw::new(),
            "clear_iaccum" => law.set_accumulator(0),
            "" => {}
            other => panic!("unknown event {other}"),
        }
        let gains = ThrottleGains {
            p: number("P_raw") as u32,
            i: number("I_raw") as u32,
            d: number("D_raw") as u32,
            f: number("F_raw") as i32,
            zone: zone(number("izone") as i32),
            ramp: number("ramp_per_ms") as i32,
        };
        let input = Input {
            target: number("target") as i32,
            measured: number("pos") as i32,
            applied: number("throttle_in") as i32,
            reverse: number("rev") != 0,
            one_direction: number("one_dir") != 0,
        };
        let out = law.step(&gains, &input);
        let got = [law.error(), law.accumulator(), out, out.clamp(-1023, 1023)].map(i64::from);
        let expected = ["err", "iaccum", "out", "throttle"].map(number);
        assert_eq!(got, expected, "{line}");
        rows += 1;
    }
    assert_eq!(rows, 51);
}

/// The listing of the manual, line by line, in 128 bits with the saturations of `docs/talon-srx.md`.
#[derive(Default)]
struct Listing {
    /// As the parameter has it: 0 = never cleared.
    zone: i32,
    not_first: bool,
    previous: i128,
    accumulator: i128,
    out: i128,
}

fn saturated(value: i128) -> i128 {
    value.clamp(i128::from(i32::MIN), i128::from(i32::MAX))
}

impl Listing {
    fn step(&mut self, gains: &ThrottleGains, input: &Input) -> i128 {
        // Division of integers truncates toward zero.
        let multiply = |value: i128, gain: i128| saturated(value * gain / (1 << 22));
        let (target, position) = (i128::from(input.target), i128::from(input.measured));
        let error = saturated(target - position);
        let zone = i128::from(self.zone);
        if !self.not_first {
            self.accumulator = 0;
            self.out = i128::from(input.applied);
        } else if zone == 0 || error.abs() < zone {
            self.accumulator = saturated(self.accumulator + error);
        } else {
            self.accumulator = 0;
        }
        let change = if self.not_first {
            saturated(error - self.previous)
        } else {
            0
        };
        let mut before = multiply(error, i128::from(gains.p));
        if self.accumulator != 0 && gains.i != 0 {
            before = saturated(before + multiply(self.accumulator, i128::from(gains.i)));
        }
        before = saturated(before + multiply(change, i128::from(gains.d)));
        before = saturated(before + multiply(target, i128::from(gains.f)));
        self.previous = error;
        self.not_first = true;
        if input.one_direction && before < 0 {
            before = 0;
        }
        if input.reverse {
            before = saturated(-before);
        }
        let ramp = i128::from(gains.ramp);
        if ramp == 0 {
            self.out = before;
        } else if before >= self.out {
            self.out += (before - self.out).min(ramp);
        } else {
            self.out -= (self.out - before).min(ramp);
        }
        self.out
    }
}

/// Mostly gains and errors of a size that people use, and now and then the ends of the range.
fn any_size() -> impl Strategy<Value = i32> {
    prop_oneof![-2000..2000, -0x80_0000..0x80_0000, any::<i32>()]
}

proptest! {
    #[test]
    fn any_sequence_equals_the_listing(
        p in any_size(), i in any_size(), d in any_size(), f in any_size(),
        zone_parameter in prop_oneof![Just(0), 0..5000, any::<i32>()],
        ramp in prop_oneof![Just(0), 1..500, 0..i32::MAX],
        inputs in proptest::collection::vec(
            (any_size(), any_size(), -1023..=1023, any::<[bool; 2]>(), 0..12_u8), 1..40,
        ),
    ) {
        let zone = zone(zone_parameter);
        let gains = ThrottleGains { p: p as u32, i: i as u32, d: d as u32, f, zone, ramp };
        let listing_anew = || Listing { zone: zone_parameter, ..Listing::default() };
        let (mut law, mut listing) = (ThrottleLaw::new(), listing_anew());
        for (target, measured, applied, [reverse, one_direction], event) in inputs {
            match event {
                0 => (law, listing) = (ThrottleLaw::new(), listing_anew()),
                1 => {
                    law.set_accumulator(0);
                    listing.accumulator = 0;
                }
                _ => {}
            }
            let input = Input { target, measured, applied, reverse, one_direction };
            prop_assert_eq!(i128::from(law.step(&gains, &input)), listing.step(&gains, &input));
            prop_assert_eq!(i128::from(law.accumulator()), listing.accumulator);
            prop_assert_eq!(i128::from(law.error()), listing.previous);
        }
    }
}
