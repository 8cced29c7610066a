//! Ways to reach a CAN bus, behind one trait and one transport string.

mod error;
mod health;
mod reconnect;
mod sim;
mod slcan;
#[cfg(target_os = "linux")]
mod socketcan;
mod spec;

use std::time::Duration;

use windlass_core::frame::Frame;

pub use error::BusError;
pub use health::{Flags, Health};
pub use reconnect::ReconnectingBus;
pub use sim::SimBus;
pub use slcan::{BIT_RATES, SlcanBus, Stream};
#[cfg(target_os = "linux")]
pub use socketcan::SocketCanBus;
pub use spec::Transport;

/// A frame from the bus.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Received {
    /// The frame.
    pub frame: Frame,
    /// When it arrived, on the clock of [`Bus::now`].
    pub at: Duration,
}

/// One participant on a classic CAN bus.
///
/// All waiting goes through [`Bus::receive`]: a simulated bus lets its virtual time pass there instead
/// of sleeping.
pub trait Bus {
    /// Queues a frame for transmission.
    ///
    /// # Errors
    /// The adapter or the connection to it has failed.
    fn send(&mut self, frame: &Frame) -> Result<(), BusError>;

    /// Queues several frames for transmission, in this order. Adapters behind a byte stream take them in
    /// one piece, so that a long transfer is as fast as the bus.
    ///
    /// # Errors
    /// The adapter or the connection to it has failed; some of the frames may have been sent.
    fn send_all(&mut self, frames: &[Frame]) -> Result<(), BusError> {
        frames.iter().try_for_each(|frame| self.send(frame))
    }

    /// Waits for the next frame, at most `timeout`; `None` if nothing came.
    ///
    /// # Errors
    /// The adapter or the connection to it has failed.
    fn receive(&mut self, timeout: Duration) -> Result<Option<Received>, BusError>;

    /// Time on this bus since it was opened: virtual for a simulated bus.
    fn now(&self) -> Duration;

    /// What is known about the CAN controller. An adapter that has to be asked is asked now, and its answer
    /// is part of a later call's value.
    ///
    /// # Errors
    /// The adapter or the connection to it has failed.
    fn health(&mut self) -> Result<Health, BusError> {
        Ok(Health::default())
    }
}

impl<B: Bus + ?Sized> Bus for Box<B> {
    fn send(&mut self, frame: &Frame) -> Result<(), BusError> {
        (**self).send(frame)
    }

    fn send_all(&mut self, frames: &[Frame]) -> Result<(), BusError> {
        (**self).send_all(frames)
    }

    fn receive(&mut self, timeout: Duration) -> Result<Option<Received>, BusError> {
        (**self).receive(timeout)
    }

    fn now(&self) -> Duration {
        (**self).now()
    }

    fn health(&mut self) -> Result<Health, BusError> {
        (**self).health()
    }
}

impl<B: Bus + ?Sized> Bus for &mut B {
    fn send(&mut self, frame: &Frame) -> Result<(), BusError> {
        (**self).send(frame)
    }

    fn send_all(&mut self, frames: &[Frame]) -> Result<(), BusError> {
        (**self).send_all(frames)
    }

    fn receive(&mut self, timeout: Duration) -> Result<Option<Received>, BusError> {
        (**self).receive(timeout)
    }

    fn now(&self) -> Duration {
        (**self).now()
    }

    fn health(&mut self) -> Result<Health, BusError> {
        (**self).health()
    }
}

/// Opens the bus that a transport string names; see [`Transport`] for the syntax.
///
/// # Errors
/// The string makes no sense, or what it names cannot be opened.
pub fn open(text: &str) -> Result<Box<dyn Bus>, BusError> {
    text.parse::<Transport>()?.open()
}
