//! Hard and soft limits. Each blocks only its own direction, judged on the sign at the terminals.

use super::command::LimitOverride;
use super::settings::LimitSettings;
use super::snapshot::LimitStatus;

/// Direction of a limit.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Direction {
    /// M+ above M−.
    Forward,
    /// M− above M+.
    Reverse,
}

/// True if the switch is in its active state: a normally open switch when it closes to ground (pin low),
/// a normally closed one when it opens (pin pulled high).
#[must_use]
pub const fn switch_hit(settings: &LimitSettings, pin_high: bool) -> bool {
    pin_high == settings.normally_closed
}

/// Judges one direction. Soft limits act at the threshold itself: forward at ≥, reverse at ≤ (guide,
/// `paramLimitSoftFwdThreshold`, `paramLimitSoftRevThreshold`).
#[must_use]
pub const fn judge(
    direction: Direction,
    settings: &LimitSettings,
    over: LimitOverride,
    pin_high: bool,
    position: i32,
) -> LimitStatus {
    let (disabled_by_override, reached) = match direction {
        Direction::Forward => (over.disable_forward, position >= settings.soft_threshold),
        Direction::Reverse => (over.disable_reverse, position <= settings.soft_threshold),
    };
    let switch_disabled = if over.enabled {
        disabled_by_override
    } else {
        settings.switch_disabled
    };
    let switch_hit = switch_hit(settings, pin_high);
    let soft_hit = settings.soft_enabled && reached;
    LimitStatus {
        switch_hit,
        switch_disabled,
        soft_hit,
        blocked: soft_hit || (switch_hit && !switch_disabled),
        refused: false,
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const BASE: LimitSettings = LimitSettings {
        normally_closed: false,
        switch_disabled: false,
        soft_enabled: false,
        soft_threshold: 0,
        clears_position: false,
    };
    const NO_OVERRIDE: LimitOverride = LimitOverride {
        enabled: false,
        disable_forward: false,
        disable_reverse: false,
    };

    #[test]
    fn truth_table_of_type_enable_and_override() {
        for normally_closed in [false, true] {
            for pin_high in [false, true] {
                for switch_disabled in [false, true] {
                    for over in [None, Some(false), Some(true)] {
                        let settings = LimitSettings {
                            normally_closed,
                            switch_disabled,
                            ..BASE
                        };
                        let override_flags = LimitOverride {
                            enabled: over.is_some(),
                            disable_forward: over == Some(true),
                            disable_reverse: over == Some(true),
                        };
                        let hit = if normally_closed { pin_high } else { !pin_high };
                        let disabled = over.unwrap_or(switch_disabled);
                        for direction in [Direction::Forward, Direction::Reverse] {
                            let got = judge(direction, &settings, override_flags, pin_high, 0);
                            assert_eq!(got.switch_hit, hit);
                            assert_eq!(got.switch_disabled, disabled);
                            assert_eq!(got.blocked, hit && !disabled);
                        }
                    }
                }
            }
        }
    }

    #[test]
    fn soft_limits_include_their_threshold() {
        let settings = LimitSettings {
            soft_enabled: true,
            soft_threshold: -100,
            ..BASE
        };
        let forward = |at| judge(Direction::Forward, &settings, NO_OVERRIDE, true, at).blocked;
        let reverse = |at| judge(Direction::Reverse, &settings, NO_OVERRIDE, true, at).blocked;
        assert_eq!(
            [forward(-101), forward(-100), forward(-99)],
            [false, true, true]
        );
        assert_eq!(
            [reverse(-101), reverse(-100), reverse(-99)],
            [true, true, false]
        );
    }
}
