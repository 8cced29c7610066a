//! The log: defmt frames over RTT on boards, over semihosting in the emulator.
//!
//! The level is chosen by `DEFMT_LOG` at build; without the feature `log` nothing is compiled in. Only thread mode
//! writes: the tick and interrupts format nothing, and a crash is told by the next start.

use crate::port::Event;

#[cfg(feature = "log")]
mod lines {
    use windlass_core::reset::ResetCause;

    use super::Event;
    use crate::board;

    #[cfg(not(feature = "board-qemu"))]
    use defmt_rtt as _;

    defmt::timestamp!("{=u64:us}", board::micros());

    pub(super) fn write(event: Event) {
        match event {
            Event::Started(reset) => match reset.cause {
                ResetCause::PowerOn | ResetCause::ResetPin | ResetCause::Requested => {
                    defmt::info!("started: {}", reset);
                }
                _ => defmt::error!("started: {}", reset),
            },
            Event::Connected { session } => defmt::info!("bus seen, session {=u16:#x}", session),
            Event::Disconnected => defmt::warn!("bus lost"),
            Event::Faults(faults) if faults.bits() == 0 => defmt::info!("faults over"),
            Event::Faults(faults) => defmt::error!("faults {=u8:#b}", faults.bits()),
            Event::NotSaved(error) => {
                defmt::warn!("settings not saved, code {=u8}", error as u8);
            }
            Event::Saved => defmt::debug!("settings saved"),
            Event::Restart(handover) => defmt::info!("restart: {}", handover),
            Event::Dropped(frames) => defmt::warn!("{=u32} frames dropped", frames),
        }
    }

    pub(super) fn brown_out_level(level: u8, wanted: u8) {
        if level != wanted {
            defmt::warn!(
                "brown-out level {=u8} in the option bytes instead of {=u8}",
                level,
                wanted
            );
        }
    }
}

/// Writes a line.
#[inline]
pub fn event(event: Event) {
    #[cfg(feature = "log")]
    lines::write(event);
    #[cfg(not(feature = "log"))]
    let _ = event;
}

/// Writes a line if the chip's brown-out level is not the one that it should have.
#[inline]
pub fn brown_out_level(level: u8, wanted: u8) {
    #[cfg(feature = "log")]
    lines::brown_out_level(level, wanted);
    #[cfg(not(feature = "log"))]
    let _ = (level, wanted);
}
