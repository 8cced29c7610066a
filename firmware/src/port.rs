//! What a board offers to thread mode.

use embedded_storage::nor_flash::NorFlash;
use windlass_core::engine::snapshot::Faults;
use windlass_core::frame::Frame;
use windlass_core::led::Leds;
use windlass_core::management::vendor::{PinTest, TestPin};
use windlass_core::node::{Handover, Transmission, TxOutcome};
use windlass_core::params::journal::SaveError;
use windlass_core::reset::Reset;
use windlass_core::time::Instant;

use crate::kept::Kept;

/// What happened on the bus.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum BusEvent {
    /// A frame was received without error.
    Received(Frame),
    /// The transmission that was started last has ended.
    Ended(TxOutcome),
    /// The controller left the bus (error passive or bus-off) and flushed its mailbox.
    Lost,
}

/// What is worth a line in the log.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Event {
    /// The program has started.
    Started(Reset),
    /// A bus was seen.
    Connected {
        /// Session id.
        session: u16,
    },
    /// The bus was lost.
    Disconnected,
    /// The active faults have changed.
    Faults(Faults),
    /// Settings have been saved.
    Saved,
    /// Settings could not be saved.
    NotSaved(SaveError),
    /// The node restarts because it was told to.
    Restart(Handover),
    /// Received frames were lost: so many since power-on.
    Dropped(u32),
}

/// The node's CAN bus.
pub trait Bus {
    /// The oldest event that was not taken yet. Never waits.
    fn poll(&mut self, now: Instant) -> Option<BusEvent>;

    /// Starts a transmission. Called only while none is on its way; its end is reported by
    /// [`Bus::poll`].
    fn transmit(&mut self, now: Instant, transmission: &Transmission);

    /// Received frames that were lost since power-on because nobody took them; wraps.
    fn dropped(&self) -> u32;

    /// Error frames that the controller has seen since it was started; wraps.
    fn errors(&self) -> u32;
}

/// A board as thread mode sees it.
pub trait Board {
    /// Its bus.
    type Bus: Bus;
    /// Memory of the settings journal.
    type Settings: NorFlash;
    /// Memory of the application's slot.
    type Application: NorFlash;

    /// Time since power-on.
    fn now(&mut self) -> Instant;

    /// The bus.
    fn bus(&mut self) -> &mut Self::Bus;

    /// Settings and image.
    fn kept(&mut self) -> &mut Kept<Self::Settings, Self::Application>;

    /// Resets the processor; bridge off.
    fn restart(&mut self, handover: Handover) -> !;

    /// Shows the LEDs; called once a tick at most.
    fn show(&mut self, leds: Leds);

    /// True once for every press of the brake/coast button.
    fn button_pressed(&mut self) -> bool;

    /// Tests the expansion header; gives the pin that failed.
    fn test_pins(&mut self, test: PinTest) -> Option<TestPin>;

    /// Thread mode and tick are alive: restarts the watchdog.
    fn feed_watchdog(&mut self);

    /// Writes a line into the log. Called in thread mode only.
    fn log(&mut self, event: Event);

    /// Waits for the next interrupt; the board's own work of thread mode, if it has any.
    fn idle(&mut self);
}
