//! Hard and soft limits. Each blocks only its own direction, judged on the sign at the terminals.

use super::command::LimitOverride;
use super::settings::LimitSettings;
use super::snapshot::LimitStatus;

/// A set of the two directions of drive. What concerns both limits is kept and judged as one set each, a few
/// instructions for both instead of a branch for either.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Directions(u8);

impl Directions {
    /// Neither direction.
    pub const NONE: Self = Self(0);
    /// M+ above M−.
    pub const FORWARD: Self = Self(1);
    /// M− above M+.
    pub const REVERSE: Self = Self(2);
    /// Both directions.
    pub const BOTH: Self = Self(3);

    /// The set of those that are true.
    #[must_use]
    pub const fn new(forward: bool, reverse: bool) -> Self {
        Self(forward as u8 | (reverse as u8) << 1)
    }

    /// The set with forward in bit 0 and reverse in bit 1; other bits are dropped.
    #[must_use]
    pub const fn from_bits(bits: u8) -> Self {
        Self(bits & Self::BOTH.0)
    }

    /// Forward in bit 0, reverse in bit 1.
    #[must_use]
    pub const fn bits(self) -> u8 {
        self.0
    }

    /// True if forward is in the set.
    #[must_use]
    pub const fn forward(self) -> bool {
        self.0 & Self::FORWARD.0 != 0
    }

    /// True if reverse is in the set.
    #[must_use]
    pub const fn reverse(self) -> bool {
        self.0 & Self::REVERSE.0 != 0
    }

    /// True if neither is in the set.
    #[must_use]
    pub const fn is_empty(self) -> bool {
        self.0 == 0
    }

    /// Directions of either set.
    #[must_use]
    pub const fn union(self, other: Self) -> Self {
        Self(self.0 | other.0)
    }

    /// Directions of both sets.
    #[must_use]
    pub const fn intersection(self, other: Self) -> Self {
        Self(self.0 & other.0)
    }

    /// Directions of this set that are not in `other`.
    #[must_use]
    pub const fn without(self, other: Self) -> Self {
        Self(self.0 & !other.0)
    }

    /// Directions for which both sets agree, be it that both have it or that neither has.
    #[must_use]
    pub const fn agreement(self, other: Self) -> Self {
        Self((self.0 ^ other.0) ^ Self::BOTH.0)
    }
}

/// Switches in their active state: a normally open switch when it closes to ground (pin low), a normally
/// closed one when it opens (pin pulled high).
#[must_use]
pub const fn switches_hit(settings: &LimitSettings, pins_high: Directions) -> Directions {
    pins_high.agreement(settings.normally_closed)
}

/// Judges both directions. Soft limits act at the threshold itself: forward at ≥, reverse at ≤ (guide,
/// `paramLimitSoftFwdThreshold`, `paramLimitSoftRevThreshold`).
#[must_use]
pub const fn judge(
    settings: &LimitSettings,
    over: LimitOverride,
    switch_hit: Directions,
    position: i32,
) -> LimitStatus {
    let switch_disabled = if over.enabled {
        over.disabled
    } else {
        settings.switch_disabled
    };
    let reached = Directions::new(
        position >= settings.forward_threshold,
        position <= settings.reverse_threshold,
    );
    let soft_hit = reached.intersection(settings.soft_enabled);
    LimitStatus {
        switch_hit,
        switch_disabled,
        soft_hit,
        blocked: soft_hit.union(switch_hit.without(switch_disabled)),
        refused: Directions::NONE,
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const BASE: LimitSettings = LimitSettings {
        normally_closed: Directions::NONE,
        switch_disabled: Directions::NONE,
        soft_enabled: Directions::NONE,
        clears_position: Directions::NONE,
        forward_threshold: 0,
        reverse_threshold: 0,
    };
    const NO_OVERRIDE: LimitOverride = LimitOverride {
        enabled: false,
        disabled: Directions::NONE,
    };
    const SETS: [Directions; 4] = [
        Directions::NONE,
        Directions::FORWARD,
        Directions::REVERSE,
        Directions::BOTH,
    ];

    #[test]
    fn truth_table_of_type_enable_and_override() {
        for normally_closed in SETS {
            for pins in SETS {
                for switch_disabled in SETS {
                    for over in [
                        None,
                        Some(SETS[0]),
                        Some(SETS[1]),
                        Some(SETS[2]),
                        Some(SETS[3]),
                    ] {
                        let settings = LimitSettings {
                            normally_closed,
                            switch_disabled,
                            ..BASE
                        };
                        let override_flags = LimitOverride {
                            enabled: over.is_some(),
                            disabled: over.unwrap_or(Directions::BOTH),
                        };
                        let got =
                            judge(&settings, override_flags, switches_hit(&settings, pins), 0);
                        let disabled = over.unwrap_or(switch_disabled);
                        for of in [Directions::forward, Directions::reverse] {
                            let hit = if of(normally_closed) {
                                of(pins)
                            } else {
                                !of(pins)
                            };
                            assert_eq!(of(got.switch_hit), hit);
                            assert_eq!(of(got.switch_disabled), of(disabled));
                            assert_eq!(of(got.blocked), hit && !of(disabled));
                        }
                    }
                }
            }
        }
    }

    #[test]
    fn soft_limits_include_their_threshold_and_block_their_direction_only() {
        let settings = LimitSettings {
            soft_enabled: Directions::BOTH,
            forward_threshold: 100,
            reverse_threshold: -100,
            ..BASE
        };
        let blocked = |at| judge(&settings, NO_OVERRIDE, Directions::NONE, at).blocked;
        assert_eq!(
            [-101, -100, -99, 99, 100, 101].map(blocked),
            [
                Directions::REVERSE,
                Directions::REVERSE,
                Directions::NONE,
                Directions::NONE,
                Directions::FORWARD,
                Directions::FORWARD
            ]
        );
    }
}
