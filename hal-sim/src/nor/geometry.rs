//! The flash memories of the supported chips: regions, unit sizes and data sheet times.

/// A part of a chip that is erased and programmed on its own.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub enum Region {
    /// Settings journal.
    Journal,
    /// Slot that the application runs from.
    Application,
    /// Slot of the copy that can be put back.
    Fallback,
}

/// Erase units of one size.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct RegionGeometry {
    /// Which region.
    pub region: Region,
    /// Bytes of an erase unit.
    pub erase_size: usize,
    /// Number of erase units.
    pub erase_units: usize,
    /// Typical time to erase one of them, in ns.
    pub erase_ns: u64,
}

impl RegionGeometry {
    /// Bytes in all.
    #[must_use]
    pub const fn capacity(&self) -> usize {
        self.erase_size * self.erase_units
    }
}

/// What a chip's flash is like.
#[derive(Debug, PartialEq, Eq)]
pub struct Geometry {
    /// Name of the chip.
    pub name: &'static str,
    /// Bytes of a program unit: written whole, once between two erases.
    pub write_size: usize,
    /// Typical time to program one unit, in ns.
    pub program_ns: u64,
    /// Program units carry an error-correcting code: a torn one can be unreadable.
    pub error_correction: bool,
    /// The regions.
    pub regions: &'static [RegionGeometry],
}

/// Bytes of a page of the G4 (RM0440, section 3.3.1; dual bank on the G474).
const G4_PAGE: usize = 2048;
/// Typical time to erase such a page (DS12288 and DS12589, table "Flash memory characteristics").
const G4_ERASE_NS: u64 = 22_020_000;
/// Typical time to program 64 bits (same table).
const G4_PROGRAM_NS: u64 = 81_700;

/// STM32F405: sectors 2 and 3, 5 and 6 (RM0090, section 3.3). Times with 32-bit parallelism (DS8626,
/// table "Flash memory programming").
pub const STM32F405: Geometry = Geometry {
    name: "STM32F405",
    write_size: 4,
    program_ns: 16_000,
    error_correction: false,
    regions: &[
        RegionGeometry {
            region: Region::Journal,
            erase_size: 16 * 1024,
            erase_units: 2,
            erase_ns: 250_000_000,
        },
        RegionGeometry {
            region: Region::Application,
            erase_size: 128 * 1024,
            erase_units: 1,
            erase_ns: 1_000_000_000,
        },
        RegionGeometry {
            region: Region::Fallback,
            erase_size: 128 * 1024,
            erase_units: 1,
            erase_ns: 1_000_000_000,
        },
    ],
};

const fn g4_region(region: Region, erase_units: usize) -> RegionGeometry {
    RegionGeometry {
        region,
        erase_size: G4_PAGE,
        erase_units,
        erase_ns: G4_ERASE_NS,
    }
}

/// STM32G474: two slots of 31 protocol pages and a trailer.
pub const STM32G474: Geometry = Geometry {
    name: "STM32G474",
    write_size: 8,
    program_ns: G4_PROGRAM_NS,
    error_correction: true,
    regions: &[
        g4_region(Region::Journal, 8),
        g4_region(Region::Application, 64),
        g4_region(Region::Fallback, 64),
    ],
};

/// STM32G431: one slot of 24 protocol pages and a trailer, no fallback.
pub const STM32G431: Geometry = Geometry {
    name: "STM32G431",
    write_size: 8,
    program_ns: G4_PROGRAM_NS,
    error_correction: true,
    regions: &[
        g4_region(Region::Journal, 4),
        g4_region(Region::Application, 50),
    ],
};
