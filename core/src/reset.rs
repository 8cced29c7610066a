//! Why a controller started: causes with their codes and names, and what goes with them.

use crate::management::vendor::named_codes;
use crate::time::Duration;

named_codes! {
    /// Why a controller started. The codes are the values of `paramResetCause` and this project's own.
    ///
    /// The first six are told by the chip (RM0090 7.3.21 and RM0440 7.4.28, `RCC_CSR`), the others by the
    /// program that has ended itself.
    pub enum ResetCause {
        /// The board cannot tell.
        Unknown = 0, "unknown";
        /// The supply was switched on.
        PowerOn = 1, "power-on";
        /// The reset pin was pulled low: a button or a debug probe.
        ResetPin = 2, "reset pin";
        /// The supply fell below the brown-out level and came back.
        BrownOut = 3, "brown-out";
        /// A restart that was asked for: `vcmdSoftReset`, `vcmdEnterBootloader`, a debug probe.
        Requested = 4, "software request";
        /// Tick or thread mode made no progress.
        Watchdog = 5, "watchdog";
        /// The program found itself in a state that must not be. Detail: line; place: hash of the file's name.
        Panic = 6, "panic";
        /// A fault of the processor. Detail: Configurable Fault Status Register; place: address of the
        /// instruction.
        ProcessorFault = 7, "processor fault";
        /// An interrupt that nothing handles. Detail: its exception number.
        UnexpectedInterrupt = 8, "unexpected interrupt";
        /// The stack has overflowed. Detail: Configurable Fault Status Register; place: stack pointer.
        StackGuard = 9, "stack overflow";
        /// The clock or the power went away in a way that this firmware never asks for: low-power mode,
        /// window watchdog or option byte loader.
        Other = 10, "other hardware reset";
    }
}

impl ResetCause {
    /// True if the program that ran before has failed: a new image that does so is on its way out
    /// (docs/updates.md).
    #[must_use]
    pub const fn is_failure(self) -> bool {
        matches!(
            self,
            Self::Watchdog
                | Self::Panic
                | Self::ProcessorFault
                | Self::UnexpectedInterrupt
                | Self::StackGuard
        )
    }
}

/// An application that has run so long works, whether anybody has asked it or not.
pub const HEALTHY_AFTER: Duration = Duration::from_millis(10_000);

/// How often in a row the application has failed ([`ResetCause::is_failure`]) before it has shown that it works: by an
/// answer, or by running for [`HEALTHY_AFTER`]. Kept in RAM over a reset; a loss of power forgets it, so that the application is tried again.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Crashes(pub u8);

impl Crashes {
    /// None.
    pub const NONE: Self = Self(0);

    /// The count after one more reset.
    #[must_use]
    pub const fn after(self, cause: ResetCause) -> Self {
        if cause.is_failure() {
            Self(self.0.saturating_add(1))
        } else {
            Self::NONE
        }
    }
}

/// How the present run began.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub struct Reset {
    /// Why.
    pub cause: ResetCause,
    /// What [`ResetCause`] says of it, else 0.
    pub detail: u32,
    /// Where, as [`ResetCause`] says, else 0.
    pub place: u32,
    /// Restarts since power-on, of whatever cause; saturates.
    pub count: u32,
}

impl Reset {
    /// The supply was switched on.
    pub const POWER_ON: Self = Self::first(ResetCause::PowerOn);

    /// The first start that is known of.
    #[must_use]
    pub const fn first(cause: ResetCause) -> Self {
        Self {
            cause,
            detail: 0,
            place: 0,
            count: 0,
        }
    }

    /// The start after this one, for a cause that has no detail.
    #[must_use]
    pub const fn again(self, cause: ResetCause) -> Self {
        Self {
            count: self.count.saturating_add(1),
            ..Self::first(cause)
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn codes_are_in_order_and_every_cause_is_found_by_its_own() {
        for (at, (cause, name)) in ResetCause::TABLE.iter().enumerate() {
            assert_eq!(*cause as usize, at);
            assert_eq!(ResetCause::from_code(at as u8), Some(*cause));
            assert_eq!(cause.name(), *name);
        }
        assert_eq!(ResetCause::from_code(ResetCause::TABLE.len() as u8), None);
    }

    #[test]
    fn failures_in_a_row_are_counted_and_anything_else_ends_the_row() {
        for (cause, _) in ResetCause::TABLE {
            let after = Crashes(3).after(*cause);
            let expected = if cause.is_failure() { 4 } else { 0 };
            assert_eq!(after, Crashes(expected), "{cause:?}");
        }
        assert_eq!(Crashes(255).after(ResetCause::Panic), Crashes(255));
    }

    #[test]
    fn a_restart_counts_and_forgets_the_detail_of_the_one_before() {
        let crashed = Reset {
            cause: ResetCause::Panic,
            detail: 7,
            place: 8,
            count: u32::MAX - 1,
        };
        let again = crashed.again(ResetCause::Requested);
        assert_eq!((again.detail, again.place, again.count), (0, 0, u32::MAX));
        assert_eq!(again.again(ResetCause::Watchdog).count, u32::MAX);
    }
}
