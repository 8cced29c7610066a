//! Bytes with their addresses, as a linker or a HEX file gives them, before they become pages.

/// Most bytes that a file may place in memory: several times the largest microcontroller's slot, little
/// enough that a hostile file cannot exhaust the host.
pub const MOST_BYTES: usize = 1 << 20;

/// What a file places in memory: contiguous runs of bytes in ascending order, none empty, none touching
/// another.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct Memory {
    runs: Vec<Run>,
    length: usize,
}

/// Bytes that stand one after the other.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Run {
    /// Address of the first byte.
    pub address: u32,
    /// The bytes; the last one's address is a 32-bit number.
    pub bytes: Vec<u8>,
}

/// Why bytes cannot be placed.
#[derive(Clone, Copy, Debug, PartialEq, Eq, thiserror::Error)]
pub enum MemoryError {
    /// Two parts of the file claim the same address.
    #[error("address {0:#010x} is given twice")]
    Overlap(u32),
    /// Bytes beyond the last 32-bit address.
    #[error("data at {0:#010x} runs over the end of the address space")]
    BeyondEnd(u32),
    /// More than [`MOST_BYTES`].
    #[error("it holds more than {} KiB of data, far more than any supported controller has", MOST_BYTES / 1024)]
    TooMuch,
}

impl Run {
    /// Address after the last byte; up to 2^32.
    fn end(&self) -> u64 {
        u64::from(self.address) + self.bytes.len() as u64
    }
}

impl Memory {
    /// Adds bytes in any order; [`Memory::finish`] sorts them.
    ///
    /// # Errors
    /// Too many bytes in all, or some beyond the last address.
    pub fn add(&mut self, address: u32, bytes: &[u8]) -> Result<(), MemoryError> {
        if bytes.is_empty() {
            return Ok(());
        }
        self.length = self.length.saturating_add(bytes.len());
        if self.length > MOST_BYTES {
            return Err(MemoryError::TooMuch);
        }
        if u64::from(address) + bytes.len() as u64 > 1 << 32 {
            return Err(MemoryError::BeyondEnd(address));
        }
        match self.runs.last_mut() {
            Some(last) if last.end() == u64::from(address) => last.bytes.extend_from_slice(bytes),
            _ => self.runs.push(Run {
                address,
                bytes: bytes.to_vec(),
            }),
        }
        Ok(())
    }

    /// Sorts and joins the runs.
    ///
    /// # Errors
    /// An address is given twice.
    pub fn finish(mut self) -> Result<Self, MemoryError> {
        self.runs.sort_by_key(|run| run.address);
        let mut joined: Vec<Run> = Vec::with_capacity(self.runs.len());
        for run in self.runs {
            match joined.last_mut() {
                Some(last) if last.end() > u64::from(run.address) => {
                    return Err(MemoryError::Overlap(run.address));
                }
                Some(last) if last.end() == u64::from(run.address) => {
                    last.bytes.extend_from_slice(&run.bytes);
                }
                _ => joined.push(run),
            }
        }
        self.runs = joined;
        Ok(self)
    }

    /// The runs in ascending order.
    #[must_use]
    pub fn runs(&self) -> &[Run] {
        &self.runs
    }

    /// Bytes from an address on; 0xFF, like erased flash, where there are none.
    #[must_use]
    pub fn read<const N: usize>(&self, address: u32) -> [u8; N] {
        let mut bytes = [0xFF; N];
        for run in &self.runs {
            let skip = u64::from(address).checked_sub(u64::from(run.address));
            let ahead = u64::from(run.address).saturating_sub(u64::from(address));
            let from = run.bytes.get(skip.unwrap_or(0) as usize..);
            let to = bytes.get_mut(ahead.min(N as u64) as usize..);
            for (to, from) in to.into_iter().flatten().zip(from.unwrap_or_default()) {
                *to = *from;
            }
        }
        bytes
    }

    /// Lowest address; none if there are no bytes.
    #[must_use]
    pub fn lowest(&self) -> Option<u32> {
        self.runs.first().map(|run| run.address)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn memory(parts: &[(u32, &[u8])]) -> Result<Memory, MemoryError> {
        let mut memory = Memory::default();
        for (address, bytes) in parts {
            memory.add(*address, bytes)?;
        }
        memory.finish()
    }

    #[test]
    fn parts_in_any_order_are_sorted_and_joined() {
        let sorted =
            memory(&[(8, &[3]), (4, &[1, 2]), (6, &[7, 7]), (20, &[9]), (30, &[])]).unwrap();
        assert_eq!(sorted.lowest(), Some(4));
        let runs: Vec<(u32, &[u8])> = sorted
            .runs()
            .iter()
            .map(|run| (run.address, run.bytes.as_slice()))
            .collect();
        assert_eq!(runs, [(4, &[1, 2, 7, 7, 3][..]), (20, &[9])]);
        assert_eq!(sorted.read(2), [0xFF, 0xFF, 1, 2]);
        assert_eq!(sorted.read(7), [7, 3, 0xFF]);
        assert_eq!(sorted.read::<14>(8)[11..], [0xFF, 9, 0xFF]);
        assert_eq!(sorted.read(u32::MAX), [0xFF; 3]);
    }

    #[test]
    fn overlaps_and_ends_are_errors() {
        assert_eq!(
            memory(&[(4, &[1, 2]), (5, &[1])]),
            Err(MemoryError::Overlap(5))
        );
        assert!(memory(&[(u32::MAX, &[1])]).is_ok());
        assert_eq!(
            memory(&[(u32::MAX, &[1, 2])]),
            Err(MemoryError::BeyondEnd(u32::MAX))
        );
        let large = vec![0; MOST_BYTES];
        assert_eq!(
            memory(&[(0, &large), (1 << 24, &[1])]),
            Err(MemoryError::TooMuch)
        );
        assert_eq!(memory(&[]).unwrap().lowest(), None);
    }
}
