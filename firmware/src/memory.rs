//! The flash regions of the board's memory map as memories: the one place where regions, units and hardware meet.

use windlass_core::boot::image::{Hardware, PAGE_SIZE};
use windlass_core::boot::slots::{Slot, Slots, TRAILER_SIZE};

use crate::chip::family::flash::{Flash, JOURNAL_UNIT, SLOT_UNIT};
#[cfg(any(feature = "stm32g431", feature = "board-qemu"))]
use crate::partition::Missing;
use crate::partition::{Partition, Region};

/// The board's memory map, from its linker script.
#[allow(dead_code, reason = "every board has the regions that it uses")]
mod map {
    use crate::partition::Region;
    include!(concat!(env!("OUT_DIR"), "/map.rs"));
}

/// The application's pages.
pub const PAGES: Region = map::FLASH;
/// Pages and trailer of the application.
pub const SLOT: Region = PAGES.with(map::TRAILER);

/// The hardware that images are for.
#[cfg(any(feature = "stm32f405", feature = "board-qemu"))]
pub const HARDWARE: Hardware = Hardware::F405;
/// The hardware that images are for.
#[cfg(feature = "stm32g474")]
pub const HARDWARE: Hardware = Hardware::G474;
/// The hardware that images are for.
#[cfg(feature = "stm32g431")]
pub const HARDWARE: Hardware = Hardware::G431;

/// The settings journal.
pub type Settings = Partition<Flash, JOURNAL_UNIT>;
/// Where the application runs from.
pub type Application = Partition<Flash, SLOT_UNIT>;
/// Where the copy of the last confirmed image stands.
#[cfg(any(feature = "stm32f405", feature = "stm32g474"))]
pub type Fallback = Application;
/// There is no room for a copy of the last confirmed image.
#[cfg(any(feature = "stm32g431", feature = "board-qemu"))]
pub type Fallback = Missing;

const _: () = assert!(
    SLOT.length as usize == HARDWARE.pages.count_ones() as usize * PAGE_SIZE + TRAILER_SIZE,
    "the slot holds the pages of this hardware and a trailer"
);

/// What the emulator loads for the slot.
#[cfg(feature = "board-qemu")]
pub const FACTORY: Region = map::FACTORY;
/// The settings journal.
#[cfg(feature = "board-qemu")]
pub const JOURNAL: Region = map::SETTINGS;

/// The settings journal's memory.
#[must_use]
pub const fn settings() -> Settings {
    const SETTINGS: Settings = Partition::new(map::SETTINGS);
    SETTINGS
}

/// The application's slot.
#[must_use]
pub fn application() -> Slot<Application> {
    const APPLICATION: Application = Partition::new(SLOT);
    Slot::new(APPLICATION, &HARDWARE)
}

/// All slots.
#[must_use]
pub fn slots() -> Slots<Application, Fallback> {
    Slots {
        application: application(),
        fallback: fallback(),
    }
}

#[cfg(any(feature = "stm32f405", feature = "stm32g474"))]
fn fallback() -> Option<Slot<Fallback>> {
    const FALLBACK: Fallback = Partition::new(map::FALLBACK);
    const { assert!(map::FALLBACK.length == SLOT.length) };
    Some(Slot::new(FALLBACK, &HARDWARE))
}

#[cfg(any(feature = "stm32g431", feature = "board-qemu"))]
const fn fallback() -> Option<Slot<Fallback>> {
    None
}
