//! Any frames into a bootloader: nothing panics, and no image is started that was not sent whole.
#![no_main]

use embedded_storage::nor_flash::{ErrorType, NorFlash, NorFlashErrorKind, ReadNorFlash};
use libfuzzer_sys::fuzz_target;
use windlass_core::boot::image::Hardware;
use windlass_core::boot::loader::{Loader, LoaderConfig, Memory, start};
use windlass_core::boot::slots::{Slot, Slots, Start};
use windlass_core::boot::status::Reason;
use windlass_core::frame::Frame;
use windlass_core::node::{PRODUCT_DMC60C, TxOutcome};
use windlass_core::params::journal::Journal;
use windlass_core::time::Instant;

/// Flash of 2 KiB erase units that keeps its rules.
struct Flash(Vec<u8>);

impl ErrorType for Flash {
    type Error = NorFlashErrorKind;
}

impl ReadNorFlash for Flash {
    const READ_SIZE: usize = 1;

    fn read(&mut self, offset: u32, bytes: &mut [u8]) -> Result<(), NorFlashErrorKind> {
        let from = offset as usize;
        bytes.copy_from_slice(&self.0[from..from + bytes.len()]);
        Ok(())
    }

    fn capacity(&self) -> usize {
        self.0.len()
    }
}

impl NorFlash for Flash {
    const WRITE_SIZE: usize = 8;
    const ERASE_SIZE: usize = 2048;

    fn erase(&mut self, from: u32, to: u32) -> Result<(), NorFlashErrorKind> {
        self.0[from as usize..to as usize].fill(0xFF);
        Ok(())
    }

    fn write(&mut self, offset: u32, bytes: &[u8]) -> Result<(), NorFlashErrorKind> {
        let place = &mut self.0[offset as usize..][..bytes.len()];
        assert!(place.iter().all(|byte| *byte == 0xFF), "programmed twice");
        place.copy_from_slice(bytes);
        Ok(())
    }
}

const IDS: [u32; 4] = [0x240, 0x0206_FC00, 0x0206_FC40, 0x0206_1880];

fuzz_target!(|bytes: &[u8]| {
    let hardware = Hardware::G431;
    let mut slots = Slots::<Flash, Flash> {
        application: Slot::new(Flash(vec![0xFF; 100 * 1024]), &hardware),
        fallback: None,
    };
    let mut settings = Flash(vec![0xFF; 8 * 1024]);
    let mut journal = Journal::open(&mut settings);
    let mut memory = Memory {
        slots: &mut slots,
        journal: &mut journal,
        settings: &mut settings,
    };
    let config = LoaderConfig {
        product_id: PRODUCT_DMC60C,
        hardware: hardware.id,
        bootloader_version: 0x0109,
        seed: 1,
        handover: None,
        reason: Reason::Empty,
    };
    let mut loader = Loader::new(&config, &mut memory);
    let mut now = 0;
    // One byte says what comes: identifier, length and whether the session is right; then the data.
    for event in bytes.chunks(9) {
        let (kind, data) = event.split_first().expect("a chunk is not empty");
        now += u64::from(*kind);
        let at = Instant::from_micros(now);
        if *kind == 0xFF {
            loader.on_bus_lost();
            continue;
        }
        let mut payload = [0; 8];
        payload[..data.len()].copy_from_slice(data);
        if kind & 4 != 0 {
            let session = loader.session().unwrap_or(0).to_le_bytes();
            payload[..2].copy_from_slice(&session);
            payload[3] = 0;
        }
        let id = IDS[usize::from(kind & 3)] | u32::from(loader.number());
        // A long transfer is one event repeated.
        let repeats = if kind & 0x80 != 0 { 600 } else { 1 };
        for _ in 0..repeats {
            loader.on_frame(at, &Frame::extended(id, payload).shortened(data.len()));
            loader.work(&mut memory);
        }
        while let Some(transmission) = loader.poll_tx(at) {
            let sent = if kind & 8 != 0 { TxOutcome::Sent } else { TxOutcome::Failed };
            loader.on_transmitted(at, transmission.tag, sent);
        }
        let _ = (loader.leds(at), loader.take_reset(), loader.next_deadline());
    }
    assert!(start(&mut memory, &Start::POWER_ON).start.is_err());
});
