//! NOR flash with the faults of real flash: an interrupted program or erase leaves bits that are half
//! done or that read differently from one time to the next.
//!
//! A [`NorChip`] is one memory of several [`Region`]s; [`NorChip::partition`] gives a handle to a region
//! that implements `embedded_storage`'s `NorFlash`. Programming one unit and erasing one unit are one
//! *operation* each; operations are counted, and the power can be cut before, inside or after any of
//! them. From then on every access fails until [`NorChip::power_on`].
//!
//! Rules that are enforced: a program unit is programmed once between two erases and never bit by bit,
//! everything is aligned. A violation is an error, changes nothing and is counted.
//!
//! A unit whose programming was interrupted can read as erased, and then nobody can know that it was
//! touched. Programmed again with the very same value it is complete: the second pulse ends what the first
//! has begun. With another value it is *overprogrammed*, which has a count of its own: a chip with an
//! error-correcting code refuses, on others the bits that were half programmed stay unstable. If bits
//! change with every read, and the unit does not read as erased at that moment, it is refused and not
//! counted.

mod cells;
mod geometry;
#[cfg(test)]
mod tests;

use std::sync::{Arc, Mutex, MutexGuard, PoisonError};

use embedded_storage::nor_flash::{
    ErrorType, NorFlash, NorFlashError, NorFlashErrorKind, ReadNorFlash,
};

use crate::random::Random;
use cells::{Cells, May};
pub use geometry::{Geometry, Region, RegionGeometry, STM32F405, STM32G431, STM32G474};

/// Why an access to the flash failed.
#[derive(Clone, Copy, Debug, PartialEq, Eq, thiserror::Error)]
pub enum NorError {
    /// There is no power, or it was cut during the access.
    #[error("the power is off")]
    PowerLost,
    /// Address or length is no multiple of the unit.
    #[error("address or length is not aligned")]
    Unaligned,
    /// Part of the range is outside the region.
    #[error("the range is outside the region")]
    OutOfBounds,
    /// The unit has been programmed since it was erased.
    #[error("the unit is not erased")]
    NotErased,
    /// More bits of the unit are wrong than its error-correcting code can mend.
    #[error("the unit can not be read")]
    Uncorrectable,
}

impl NorFlashError for NorError {
    fn kind(&self) -> NorFlashErrorKind {
        match self {
            Self::Unaligned => NorFlashErrorKind::NotAligned,
            Self::OutOfBounds => NorFlashErrorKind::OutOfBounds,
            Self::PowerLost | Self::NotErased | Self::Uncorrectable => NorFlashErrorKind::Other,
        }
    }
}

/// When the power is cut, relative to one operation.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum CutPoint {
    /// The operation does not happen.
    Before,
    /// The operation is interrupted; the seed decides what it leaves.
    Inside(u64),
    /// The operation is complete, but its caller never learns.
    After,
}

/// A cut that is to come.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Cut {
    /// Number of the operation since the chip was made, from 0 ([`NorChip::operations`] is the next one).
    pub operation: u64,
    /// When, relative to it.
    pub point: CutPoint,
}

/// Everything that is in a chip, to go back to.
#[derive(Clone, Debug)]
pub struct NorState {
    geometry: &'static Geometry,
    regions: Vec<Cells>,
    powered: bool,
    cut: Option<Cut>,
    /// The power is cut when `busy_ns` reaches the first number; the second is the seed.
    deadline: Option<(u64, u64)>,
    operations: u64,
    misuses: u64,
    overprogrammed: Vec<(Region, usize)>,
    programs: u64,
    busy_ns: u64,
    random: Random,
}

/// One flash memory.
#[derive(Debug)]
pub struct NorChip {
    state: Arc<Mutex<NorState>>,
}

impl NorChip {
    /// An erased chip. The seed decides what unstable bits read as.
    #[must_use]
    pub fn new(geometry: &'static Geometry, seed: u64) -> Self {
        let regions = geometry
            .regions
            .iter()
            .map(|region| Cells::new(region.capacity(), geometry.write_size, region.erase_size))
            .collect();
        Self {
            state: Arc::new(Mutex::new(NorState {
                geometry,
                regions,
                powered: true,
                cut: None,
                deadline: None,
                operations: 0,
                misuses: 0,
                overprogrammed: Vec::new(),
                programs: 0,
                busy_ns: 0,
                random: Random::new(seed, 0xF1A5),
            })),
        }
    }

    fn state(&self) -> MutexGuard<'_, NorState> {
        self.state.lock().unwrap_or_else(PoisonError::into_inner)
    }

    /// What the chip is like.
    #[must_use]
    pub fn geometry(&self) -> &'static Geometry {
        self.state().geometry
    }

    /// A handle to a region; any number of them can be in use. `None` if the chip has no such region, or
    /// if its units are not `WRITE` and `ERASE` bytes.
    #[must_use]
    pub fn partition<const WRITE: usize, const ERASE: usize>(
        &self,
        region: Region,
    ) -> Option<Partition<WRITE, ERASE>> {
        let geometry = self.geometry();
        let index = geometry
            .regions
            .iter()
            .position(|candidate| candidate.region == region)?;
        let found = geometry.regions.get(index)?;
        (geometry.write_size == WRITE && found.erase_size == ERASE).then(|| Partition {
            state: Arc::clone(&self.state),
            index,
            capacity: found.capacity(),
        })
    }

    /// Cuts the power at an operation to come; `None` calls it off.
    pub fn cut_at(&self, cut: Option<Cut>) {
        self.state().cut = cut;
    }

    /// Cuts the power inside the operation that is under way when the memory has been busy for `us` more
    /// microseconds; the seed decides what that operation leaves.
    pub fn cut_after(&self, us: u64, seed: u64) {
        let mut state = self.state();
        state.deadline = Some((state.busy_ns + us * 1000, seed));
    }

    /// Takes the power away between two operations.
    pub fn power_off(&self) {
        self.state().powered = false;
    }

    /// Gives the power back. A cut that has not come yet stays armed.
    pub fn power_on(&self) {
        let mut state = self.state();
        let NorState {
            powered,
            regions,
            random,
            ..
        } = &mut *state;
        *powered = true;
        for cells in regions {
            cells.power_on(random);
        }
    }

    /// True unless the power was cut or taken away.
    #[must_use]
    pub fn is_powered(&self) -> bool {
        self.state().powered
    }

    /// Operations begun so far.
    #[must_use]
    pub fn operations(&self) -> u64 {
        self.state().operations
    }

    /// Units programmed so far.
    #[must_use]
    pub fn programs(&self) -> u64 {
        self.state().programs
    }

    /// Accesses that were refused because they break the rules of the memory.
    #[must_use]
    pub fn misuses(&self) -> u64 {
        self.state().misuses
    }

    /// Where another value was to be programmed over one that was interrupted and could not be seen: region
    /// and offset, in the order of the attempts.
    #[must_use]
    pub fn overprogrammed(&self) -> Vec<(Region, usize)> {
        self.state().overprogrammed.clone()
    }

    /// Time that programming and erasing took so far, in µs, by the data sheet's typical values.
    #[must_use]
    pub fn busy_us(&self) -> u64 {
        self.state().busy_ns / 1000
    }

    /// Times that each erase unit of a region was erased, interrupted ones included; empty if there is no
    /// such region.
    #[must_use]
    pub fn erases(&self, region: Region) -> Vec<u32> {
        let state = self.state();
        state
            .geometry
            .regions
            .iter()
            .position(|candidate| candidate.region == region)
            .and_then(|index| state.regions.get(index))
            .map(|cells| cells.erases().to_vec())
            .unwrap_or_default()
    }

    /// Everything that is in the chip.
    #[must_use]
    pub fn save(&self) -> NorState {
        self.state().clone()
    }

    /// Goes back to what was in the chip, counters included.
    pub fn restore(&self, saved: &NorState) {
        self.state().clone_from(saved);
    }
}

impl NorState {
    /// Begins one operation: true if it is carried out whole, else the seed of what it leaves.
    fn begin(&mut self, ns: u64) -> Result<Option<u64>, NorError> {
        if !self.powered {
            return Err(NorError::PowerLost);
        }
        if let Some((deadline, seed)) = self.deadline
            && self.busy_ns + ns > deadline
        {
            self.cut = Some(Cut {
                operation: self.operations,
                point: CutPoint::Inside(seed),
            });
        }
        let due = self.cut.filter(|cut| cut.operation <= self.operations);
        if due.is_some_and(|cut| cut.point == CutPoint::Before) {
            self.lose_power();
            return Err(NorError::PowerLost);
        }
        self.operations += 1;
        match due.map(|cut| cut.point) {
            Some(CutPoint::Inside(seed)) => {
                self.busy_ns += ns / 2;
                Ok(Some(seed))
            }
            _ => {
                self.busy_ns += ns;
                Ok(None)
            }
        }
    }

    /// Ends one operation.
    fn end(&mut self) -> Result<(), NorError> {
        if self.cut.is_some_and(|cut| cut.operation < self.operations) {
            self.lose_power();
            return Err(NorError::PowerLost);
        }
        Ok(())
    }

    fn lose_power(&mut self) {
        self.powered = false;
        self.cut = None;
        self.deadline = None;
    }

    fn misuse(&mut self, error: NorError) -> NorError {
        self.misuses += 1;
        error
    }

    /// Checks a range against the region and a unit.
    fn check(
        &mut self,
        capacity: usize,
        unit: usize,
        from: u32,
        length: usize,
    ) -> Result<usize, NorError> {
        if !self.powered {
            return Err(NorError::PowerLost);
        }
        let from = from as usize;
        if from.checked_add(length).is_none_or(|end| end > capacity) {
            return Err(self.misuse(NorError::OutOfBounds));
        }
        if !from.is_multiple_of(unit) || !length.is_multiple_of(unit) {
            return Err(self.misuse(NorError::Unaligned));
        }
        Ok(from)
    }

    fn program(&mut self, index: usize, at: usize, data: &[u8]) -> Result<(), NorError> {
        let may = self.regions[index].may_program(at, data, &mut self.random);
        match may {
            May::Yes => {}
            May::Over => {
                let region = self.geometry.regions[index].region;
                self.overprogrammed.push((region, at));
                if self.geometry.error_correction {
                    return Err(NorError::NotErased);
                }
            }
            May::No => return Err(NorError::NotErased),
            May::Misuse => return Err(self.misuse(NorError::NotErased)),
        }
        let torn = self.begin(self.geometry.program_ns)?;
        self.programs += 1;
        match torn {
            None if may == May::Over => self.regions[index].program_over(at, data),
            None => self.regions[index].program(at, data),
            Some(seed) => {
                let unreadable = self.geometry.error_correction;
                let mut random = Random::new(seed, self.operations);
                self.regions[index].tear_program(at, data, unreadable, &mut random);
            }
        }
        self.end()
    }

    fn erase(&mut self, index: usize, at: usize) -> Result<(), NorError> {
        let ns = self.geometry.regions[index].erase_ns;
        match self.begin(ns)? {
            None => self.regions[index].erase(at),
            Some(seed) => {
                let unreadable = self.geometry.error_correction;
                let mut random = Random::new(seed, self.operations);
                self.regions[index].tear_erase(at, unreadable, &mut random);
            }
        }
        self.end()
    }
}

/// A handle to one region of a [`NorChip`].
#[derive(Debug)]
pub struct Partition<const WRITE: usize, const ERASE: usize> {
    state: Arc<Mutex<NorState>>,
    index: usize,
    capacity: usize,
}

impl<const WRITE: usize, const ERASE: usize> Partition<WRITE, ERASE> {
    fn state(&self) -> MutexGuard<'_, NorState> {
        self.state.lock().unwrap_or_else(PoisonError::into_inner)
    }
}

impl<const WRITE: usize, const ERASE: usize> ErrorType for Partition<WRITE, ERASE> {
    type Error = NorError;
}

impl<const WRITE: usize, const ERASE: usize> ReadNorFlash for Partition<WRITE, ERASE> {
    const READ_SIZE: usize = 1;

    fn read(&mut self, offset: u32, bytes: &mut [u8]) -> Result<(), NorError> {
        let mut state = self.state();
        let from = state.check(self.capacity, 1, offset, bytes.len())?;
        let NorState {
            regions, random, ..
        } = &mut *state;
        regions[self.index].read(from, bytes, random)
    }

    fn capacity(&self) -> usize {
        self.capacity
    }
}

impl<const WRITE: usize, const ERASE: usize> NorFlash for Partition<WRITE, ERASE> {
    const WRITE_SIZE: usize = WRITE;
    const ERASE_SIZE: usize = ERASE;

    fn erase(&mut self, from: u32, to: u32) -> Result<(), NorError> {
        let mut state = self.state();
        let length = (to as usize).checked_sub(from as usize);
        let Some(length) = length else {
            return Err(state.misuse(NorError::OutOfBounds));
        };
        let from = state.check(self.capacity, ERASE, from, length)?;
        for at in (from..from + length).step_by(ERASE) {
            state.erase(self.index, at)?;
        }
        Ok(())
    }

    fn write(&mut self, offset: u32, bytes: &[u8]) -> Result<(), NorError> {
        let mut state = self.state();
        let from = state.check(self.capacity, WRITE, offset, bytes.len())?;
        for (at, unit) in (from..).step_by(WRITE).zip(bytes.chunks_exact(WRITE)) {
            state.program(self.index, at, unit)?;
        }
        Ok(())
    }
}
