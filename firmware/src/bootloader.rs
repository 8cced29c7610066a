//! The bootloader: what to start, and the loader on the bus if there is nothing to start.
//!
//! The decision is made before anything but the watchdog is set up, so that an application finds the chip as a
//! reset has left it. Nothing here touches a pin of the bridge: they stay inputs, and the bridge off.

use windlass_core::boot::image::Page;
use windlass_core::boot::loader::{Loader, LoaderConfig, Memory};
use windlass_core::boot::slots::{self, Booted};
use windlass_core::led::Leds;
use windlass_core::node::{Handover, PRODUCT_DMC60C, Tag};
use windlass_core::reset::ResetCause;
use windlass_core::time::Instant;

use embedded_storage::nor_flash::NorFlash;

use crate::port::{Bus, BusEvent};
use crate::record::{Cause, PassedOn, Record, Start};

/// Version of the bootloader (`fwverBoot`), major and minor byte.
pub const VERSION: u16 = 0x0109;

/// A board as the bootloader sees it.
pub trait Station {
    /// Its bus.
    type Bus: Bus;

    /// Time since the start.
    fn now(&mut self) -> Instant;

    /// The bus.
    fn bus(&mut self) -> &mut Self::Bus;

    /// Shows the LEDs.
    fn show(&mut self, leds: Leds);

    /// Restarts the watchdog.
    fn feed_watchdog(&mut self);
}

/// Decides what runs, and leaves for the application what it has to know. An error tells how the loader is to be
/// made. `hardware` is the cause of the start that the chip tells, `hardware_id` and `seed` are the board's.
///
/// # Errors
/// The bootloader stays.
// Not inlined: what it needs of the stack is free again before the loader is made.
#[inline(never)]
pub fn decide<A: NorFlash, F: NorFlash, J: NorFlash>(
    memory: &mut Memory<'_, A, F, J>,
    record: &Record,
    hardware: ResetCause,
    hardware_id: u32,
    seed: u32,
) -> Result<(), LoaderConfig> {
    let start = record.start(hardware);
    let Start {
        reset,
        handover,
        crashes,
    } = start;
    let booted: Booted = windlass_core::boot::loader::start(
        memory,
        &slots::Start {
            cause: reset.cause,
            handover,
            crashes,
        },
    );
    match booted.start {
        Ok(_) => {
            record.pass_on(&PassedOn {
                start,
                bootloader_version: VERSION,
            });
            Ok(())
        }
        Err(reason) => Err(LoaderConfig {
            product_id: PRODUCT_DMC60C,
            hardware: hardware_id,
            bootloader_version: VERSION,
            seed,
            handover,
            reason,
        }),
    }
}

/// One pass of the loader: what has happened on the bus, what it asks of the flash, and what is to be sent. Gives
/// the restart that was asked for.
pub fn pass<S: Station, A: NorFlash, F: NorFlash, J: NorFlash>(
    station: &mut S,
    loader: &mut Loader<&'static mut Page>,
    memory: &mut Memory<'_, A, F, J>,
    on_the_way: &mut Option<Tag>,
) -> Option<Handover> {
    let now = station.now();
    station.feed_watchdog();
    match station.bus().poll(now) {
        Some(BusEvent::Received(frame)) => {
            loader.on_frame(now, &frame);
            loader.work(memory);
        }
        Some(BusEvent::Ended(outcome)) => {
            if let Some(tag) = on_the_way.take() {
                loader.on_transmitted(now, tag, outcome);
            }
        }
        Some(BusEvent::Lost) => {
            *on_the_way = None;
            loader.on_bus_lost();
        }
        None => {}
    }
    if on_the_way.is_none()
        && let Some(transmission) = loader.poll_tx(now)
    {
        *on_the_way = Some(transmission.tag);
        station.bus().transmit(now, &transmission);
    }
    station.show(loader.leds(now));
    loader.take_reset()
}

/// The loader on the bus, until it restarts.
pub fn stay<S: Station, A: NorFlash, F: NorFlash, J: NorFlash>(
    station: &mut S,
    loader: &mut Loader<&'static mut Page>,
    memory: &mut Memory<'_, A, F, J>,
) -> Cause {
    let mut on_the_way = None;
    loop {
        if let Some(handover) = pass(station, loader, memory, &mut on_the_way) {
            return Cause::Requested(handover);
        }
    }
}
