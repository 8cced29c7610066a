//! Configuration: the table of parameters, their values, and how they are kept.

pub mod compile;
pub mod journal;
pub mod store;
pub mod table;

pub use store::{FaultLog, SaveRule, SaveTimer, SettingsState, Stored};
use table::{COUNT, Kind, ParameterId, RULES, Storage};

/// Why a parameter was not written.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum WriteError {
    /// The value is outside the parameter's range.
    BadValue,
}

/// Values of all parameters, raw as on the wire.
///
/// Invariant: every value is allowed by its row in [`TABLE`](table::TABLE).
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Params {
    values: [u32; COUNT],
}

impl Default for Params {
    fn default() -> Self {
        Self::new()
    }
}

impl Params {
    /// All defaults.
    #[must_use]
    pub fn new() -> Self {
        let mut values = [0; COUNT];
        for (value, row) in values.iter_mut().zip(&RULES) {
            *value = row.default;
        }
        Self { values }
    }

    /// Raw value; 0 for parameters that are computed when read.
    // Not inlined: it is called for every setting, and never in the tick.
    #[inline(never)]
    #[must_use]
    pub fn get(&self, id: ParameterId) -> u32 {
        self.values.get(id.position()).copied().unwrap_or(0)
    }

    /// Value of a signed parameter.
    #[must_use]
    pub fn signed(&self, id: ParameterId) -> i32 {
        self.get(id) as i32
    }

    /// Value of a flag.
    #[must_use]
    pub fn flag(&self, id: ParameterId) -> bool {
        self.get(id) != 0
    }

    /// Writes a value; tells whether that changed anything.
    ///
    /// # Errors
    /// [`WriteError::BadValue`] if the table does not allow the value; nothing is changed then. Computed
    /// parameters are not held here and refuse every value.
    pub fn set(&mut self, id: ParameterId, value: u32) -> Result<bool, WriteError> {
        let kind = id.rule().kind;
        if kind == Kind::Computed || !kind.allows(value) {
            return Err(WriteError::BadValue);
        }
        match self.values.get_mut(id.position()) {
            Some(slot) => Ok(core::mem::replace(slot, value) != value),
            None => Err(WriteError::BadValue),
        }
    }

    /// The same values with everything that is not kept over a power cycle at its default.
    #[must_use]
    pub fn persistent(&self) -> Self {
        let mut kept = Self::new();
        for ((value, row), own) in kept.values.iter_mut().zip(&RULES).zip(&self.values) {
            if row.storage == Storage::Persistent {
                *value = *own;
            }
        }
        kept
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    #[test]
    fn defaults_are_those_of_the_guide() {
        // Guide, "Configuration Parameter Summary"; 0x816 by docs/dmc60c.md.
        let params = Params::new();
        let table = [
            (ParameterId::CurrentMultiplier, 0x816),
            (ParameterId::Slot0ForwardMax, 32767),
            (ParameterId::Slot0ReverseMax, 0xFFFF_8000),
            (ParameterId::CurrentLimitP, 0x0064_0000),
            (ParameterId::CurrentLimitI, 0x003C_0000),
            (ParameterId::CurrentLimitIZone, 0x014C_C888),
            (ParameterId::ContinuousCurrent, 40 << 16),
            (ParameterId::PeakCurrent, 60 << 16),
            (ParameterId::PeakDuration, 500),
            (ParameterId::AnalogPeriod, 100),
            (ParameterId::EncoderPeriod, 100),
            (ParameterId::GeneralPeriod, 10),
        ];
        for (id, value) in table {
            assert_eq!(params.get(id), value, "{id:?}");
        }
    }

    #[test]
    fn ranges_are_those_of_the_guide() {
        let mut params = Params::new();
        let table: [(ParameterId, &[u32], &[u32]); 8] = [
            (ParameterId::ForwardLimitDisabled, &[0, 1], &[2, u32::MAX]),
            (
                ParameterId::Slot0ForwardMax,
                &[0, 32767],
                &[32768, -1_i32 as u32],
            ),
            (
                ParameterId::Slot0ReverseMax,
                &[0, -32768_i32 as u32],
                &[1, -32769_i32 as u32],
            ),
            (ParameterId::Slot1IZone, &[0, 0x7FFF_FFFF], &[0x8000_0000]),
            (ParameterId::PeakDuration, &[0, 65535], &[65536]),
            (ParameterId::AnalogPeriod, &[1, 30_000], &[0, 30_001]),
            (ParameterId::GeneralPeriod, &[1, 50], &[0, 51]),
            (
                ParameterId::ContinuousCurrent,
                &[0, 64 << 16],
                &[-1_i32 as u32],
            ),
        ];
        for (id, good, bad) in table {
            for value in good {
                params.set(id, *value).unwrap();
                assert_eq!(params.get(id), *value);
            }
            for value in bad {
                let before = params.get(id);
                assert_eq!(
                    params.set(id, *value),
                    Err(WriteError::BadValue),
                    "{id:?} {value}"
                );
                assert_eq!(params.get(id), before);
            }
        }
    }

    #[test]
    fn volatile_values_are_not_kept() {
        let mut params = Params::new();
        params.set(ParameterId::AnalogPeriod, 7).unwrap();
        params.set(ParameterId::Slot0P, 7).unwrap();
        let kept = params.persistent();
        assert_eq!(kept.get(ParameterId::AnalogPeriod), 100);
        assert_eq!(kept.get(ParameterId::Slot0P), 7);
    }

    proptest! {
        #[test]
        fn every_allowed_value_reads_back_and_every_other_changes_nothing(code: u8, value: u32) {
            let mut params = Params::new();
            if let Some(id) = ParameterId::from_code(code) {
                let before = params.get(id);
                let after = if params.set(id, value).is_ok() { value } else { before };
                prop_assert_eq!(params.get(id), after);
            }
        }
    }
}
