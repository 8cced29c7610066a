//! Current limiting inside the engine; the limiter's own rules are tested beside it.

use super::*;

fn limited_rig() -> Rig {
    let mut rig = Rig::new();
    rig.set(ParameterId::CurrentLimitEnable, 1);
    rig
}

const FULL: Setpoint = Setpoint::Duty(Duty::MAX);

#[test]
fn peak_for_longer_than_its_duration_limits_in_both_directions() {
    for amperes in [61.0, -61.0] {
        let mut rig = limited_rig();
        rig.amperes(amperes);
        rig.drive(FULL, 1000);
        assert!(!rig.snapshot.current_limited);
        rig.drive(FULL, 1);
        assert!(rig.snapshot.current_limited);
        // 20 A too much: the cap falls by P at once and by I with every tick.
        assert!(rig.drive(FULL, 20) < 15_000);
    }
}

#[test]
fn combinations_of_the_guide() {
    // continuous, peak, duration (ms), current, limits at the first sample?
    let table = [
        (40, 60, 0, 61.0, true),
        (40, 60, 0, 50.0, false),
        (50, 50, 500, 51.0, true),
        (60, 40, 500, 61.0, true),
        (60, 40, 500, 50.0, false),
        (40, 60, 500, 61.0, false),
    ];
    for (continuous, peak, duration, amperes, at_once) in table {
        let mut rig = limited_rig();
        rig.set(ParameterId::ContinuousCurrent, continuous << 16)
            .set(ParameterId::PeakCurrent, peak << 16)
            .set(ParameterId::PeakDuration, duration);
        rig.amperes(amperes);
        rig.drive(FULL, 1);
        assert_eq!(
            rig.snapshot.current_limited, at_once,
            "{continuous} {peak} {duration} {amperes}"
        );
    }
}

#[test]
fn disabled_limiter_never_limits() {
    let mut rig = Rig::new();
    rig.amperes(61.0);
    assert_eq!(rig.drive(FULL, 3000), 32767);
    assert!(!rig.snapshot.current_limited);
}

#[test]
fn switching_off_ends_limiting() {
    let mut rig = limited_rig();
    rig.amperes(61.0);
    rig.drive(FULL, 1100);
    assert!(rig.snapshot.current_limited);
    rig.send(Setpoint::Off).tick();
    rig.drive(FULL, 1000);
    assert!(!rig.snapshot.current_limited, "the peak timer starts anew");
}
