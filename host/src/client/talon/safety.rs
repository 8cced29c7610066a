//! Motor safety: without a new set point within the expiration time the drive ends (manual 19).

use std::time::Duration;

/// Expiration time when none was set (manual 19.2).
pub const DEFAULT_EXPIRATION: Duration = Duration::from_millis(100);

/// The timer of one motor.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) struct MotorSafety {
    enabled: bool,
    expiration: Duration,
    fed_at: Duration,
}

impl Default for MotorSafety {
    /// Off, as in the published clients.
    fn default() -> Self {
        Self {
            enabled: false,
            expiration: DEFAULT_EXPIRATION,
            fed_at: Duration::ZERO,
        }
    }
}

impl MotorSafety {
    /// A set point was given at `now`.
    pub(super) const fn feed(&mut self, now: Duration) {
        self.fed_at = now;
    }

    /// Switches the timer on or off; switched on it starts anew.
    pub(super) const fn set_enabled(&mut self, enabled: bool, now: Duration) {
        if enabled && !self.enabled {
            self.fed_at = now;
        }
        self.enabled = enabled;
    }

    pub(super) const fn is_enabled(&self) -> bool {
        self.enabled
    }

    pub(super) const fn set_expiration(&mut self, expiration: Duration) {
        self.expiration = expiration;
    }

    pub(super) const fn expiration(&self) -> Duration {
        self.expiration
    }

    /// When the drive ends unless it is fed before; never while switched off.
    pub(super) fn deadline(&self) -> Option<Duration> {
        self.enabled.then(|| self.fed_at + self.expiration)
    }
}
