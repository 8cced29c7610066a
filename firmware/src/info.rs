//! What the application is: the information block in its page 0, and what its bootloader passes on.

use core::ptr;

use windlass_core::boot::image::{INFO_LENGTH, Identity, InfoBlock};
use windlass_core::engine;
use windlass_core::node::PRODUCT_DMC60C;
use windlass_core::reset::ResetCause;

use crate::fault::RECORD;
use crate::kept::Origin;
use crate::memory::HARDWARE;
use crate::record::PassedOn;

/// Version of the application, major and minor byte.
const VERSION: u16 = 0x0117;

/// Version that is told for a bootloader that did not start this program.
const NO_BOOTLOADER: u16 = 0xFFFF;

/// The linker puts it at offset 0x200 of the slot.
#[used]
#[unsafe(link_section = ".info")]
static INFO: [u8; INFO_LENGTH] = InfoBlock {
    identity: Identity {
        product: PRODUCT_DMC60C,
        hardware: HARDWARE.id,
        version: VERSION,
        rollback: 0,
    },
}
.to_bytes();

/// The version that stands in flash: a tool may have changed it there.
fn version() -> u16 {
    let mut bytes = [0; INFO_LENGTH];
    for (byte, place) in bytes.iter_mut().zip(&INFO) {
        // SAFETY: a reference to a static is valid for reads.
        *byte = unsafe { ptr::from_ref(place).read_volatile() };
    }
    InfoBlock::parse(&bytes).map_or(VERSION, |info| info.identity.version)
}

/// What the application knows of itself and of its start. Without a bootloader, as under a debugger, the chip tells
/// the cause.
pub fn origin(
    board: engine::Board,
    seed: u32,
    cause_of_chip: impl FnOnce() -> ResetCause,
) -> Origin {
    Origin {
        record: &RECORD,
        passed_on: RECORD.take_passed_on().unwrap_or_else(|| PassedOn {
            start: RECORD.start(cause_of_chip()),
            bootloader_version: NO_BOOTLOADER,
        }),
        version: version(),
        board,
        seed,
    }
}
