//! Talon SRX: LEDs. The numbers are the rows of docs/talon-srx-rows.md. The ring's first two LEDs stand on the
//! M+ side.

use windlass::client::talon::{ControlMode, NeutralMode};
use windlass_core::led::Colour;
use windlass_sim::Poke;
use windlass_tests::talon::TalonBench;

/// Every state of the ring in `millis`, one entry for each change.
fn patterns(bench: &TalonBench, index: usize, millis: u64) -> Vec<[Colour; 4]> {
    let mut seen = vec![bench.truth(index).leds.ring];
    for _ in 0..millis {
        bench.run(1);
        let ring = bench.truth(index).leds.ring;
        if seen.last() != Some(&ring) {
            seen.push(ring);
        }
    }
    seen
}

fn colours(patterns: &[[Colour; 4]]) -> Vec<Colour> {
    let mut all: Vec<Colour> = patterns.iter().flatten().copied().collect();
    all.sort_by_key(|colour| colour.name());
    all.dedup();
    all
}

#[test]
fn row_67_row_28_a_disabled_talon_blinks_orange() {
    let bench = TalonBench::new(&["talon:3"]);
    // Somebody is on the bus, but nobody drives; without any frame the light is red (row 74).
    bench
        .robot
        .lend(|client| client.find(&"talon:3".parse().unwrap()))
        .unwrap();
    bench.run(1000);
    let seen = patterns(&bench, 0, 4000);
    assert_eq!(colours(&seen), [Colour::Off, Colour::Orange]);
    assert!(
        (7..=9).contains(&(seen.len() - 1)),
        "1 Hz: {} changes in 4 s",
        seen.len() - 1
    );
}

#[test]
fn row_46_enabled_and_neutral_is_solid_orange() {
    let (bench, talon) = TalonBench::enabled();
    talon.set(0.0).unwrap();
    bench.run(100);
    assert_eq!(patterns(&bench, 0, 2000), [[Colour::Orange; 4]]);
    talon.set_control_mode(ControlMode::Follower).unwrap();
    talon.set(40.0).unwrap();
    bench.run(200);
    assert_eq!(patterns(&bench, 0, 2000), [[Colour::Orange; 4]]);
}

#[test]
fn the_direction_blinks_green_or_red_faster_with_more_throttle() {
    let (bench, talon) = TalonBench::enabled();
    for (sign, colour) in [(1.0, Colour::Green), (-1.0, Colour::Red)] {
        let changes = [0.1, 0.9].map(|value| {
            talon.set(sign * value).unwrap();
            bench.run(500);
            let seen = patterns(&bench, 0, 4000);
            assert_eq!(colours(&seen), {
                let mut both = [colour, Colour::Off];
                both.sort_by_key(|colour| colour.name());
                both
            });
            seen.len() - 1
        });
        assert!(changes[1] > changes[0] * 2, "{changes:?}");
    }
}

#[test]
fn row_24_limits_blink_red_towards_their_side() {
    for (poke, value, forward) in [
        (Poke::ForwardLimitClosed(true), 0.5, true),
        (Poke::ReverseLimitClosed(true), -0.5, false),
    ] {
        let (bench, talon) = TalonBench::enabled();
        talon.set(value).unwrap();
        bench.poke(0, poke);
        bench.run(500);
        let seen = patterns(&bench, 0, 1000);
        assert_eq!(colours(&seen), [Colour::Off, Colour::Red]);
        assert!(seen.len() > 6, "4 Hz: {seen:?}");
        // The light comes from the other side, goes to the one whose limit blocks, and pauses.
        let (red, off) = (Colour::Red, Colour::Off);
        let (plus, minus) = ([red, red, off, off], [off, off, red, red]);
        let cycle = if forward {
            [minus, plus, [off; 4]]
        } else {
            [plus, minus, [off; 4]]
        };
        let begin = seen.iter().position(|ring| *ring == cycle[0]).unwrap();
        for (ring, expected) in seen[begin..].iter().zip(cycle.iter().cycle()) {
            assert_eq!(ring, expected, "{seen:?}");
        }
    }
}

#[test]
fn row_26_row_30_the_brake_led_shows_the_active_mode() {
    let (bench, talon) = TalonBench::enabled();
    assert_eq!(bench.truth(0).leds.brake, Colour::Red);
    talon.config_neutral_mode(NeutralMode::Coast).unwrap();
    bench.run(30);
    assert_eq!(bench.truth(0).leds.brake, Colour::Off);
    // The button changes what is stored, not what is overridden (manual 16.1).
    bench.poke(0, Poke::Button);
    bench.run(200);
    assert_eq!(bench.truth(0).leds.brake, Colour::Off);
    talon.config_neutral_mode(NeutralMode::Brake).unwrap();
    bench.run(30);
    assert_eq!(bench.truth(0).leds.brake, Colour::Red);
}

#[test]
fn row_74_without_a_can_bus_the_leds_are_red() {
    let bench = TalonBench::new(&["talon:3", "talon:4"]);
    bench.poke(0, Poke::BusConnected(false));
    bench.run(3000);
    let seen = patterns(&bench, 0, 3000);
    assert!(colours(&seen).contains(&Colour::Red), "{seen:?}");
    assert!(!colours(&seen).contains(&Colour::Orange));
}

#[test]
fn row_11_without_an_application_the_leds_blink_green_and_orange() {
    let bench = TalonBench::new(&["talon:3"]);
    let address = bench
        .robot
        .lend(|client| client.find(&"3".parse().unwrap()))
        .unwrap()
        .address;
    bench
        .robot
        .lend(|client| client.enter_bootloader(address))
        .unwrap();
    bench.run(500);
    let seen = patterns(&bench, 0, 4000);
    assert_eq!(colours(&seen), [Colour::Green, Colour::Orange]);
    let slow = seen.len();
    // Identified it blinks faster (manual 2.2).
    bench
        .robot
        .lend(|client| client.flash_leds(address))
        .unwrap();
    let fast = patterns(&bench, 0, 4000).len();
    assert!(fast > slow * 2, "{slow} {fast}");
}
