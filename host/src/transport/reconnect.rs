//! A bus that is opened again when its connection breaks.

use std::time::{Duration, Instant};

use windlass_core::frame::Frame;

use super::{Bus, BusError, Health, Received, Transport};

/// Time between two attempts to open the bus again.
const RETRY_PERIOD: Duration = Duration::from_millis(500);

/// A bus behind a connection that may break for a while: until it is back, frames are lost and nothing is
/// received, as on a bus whose cable is unplugged.
pub struct ReconnectingBus {
    transport: Transport,
    patience: Duration,
    bus: Option<Box<dyn Bus>>,
    opened: Instant,
    /// The time on the outer clock at which the present bus was opened.
    offset: Duration,
    /// What broke, and when.
    broken: Option<(BusError, Instant)>,
}

impl ReconnectingBus {
    /// Opens a bus. A connection that breaks later is tried again for `patience`.
    ///
    /// # Errors
    /// The bus cannot be opened now.
    pub fn open(transport: Transport, patience: Duration) -> Result<Self, BusError> {
        let bus = transport.open()?;
        Ok(Self {
            transport,
            patience,
            bus: Some(bus),
            opened: Instant::now(),
            offset: Duration::ZERO,
            broken: None,
        })
    }

    /// Does something with the bus; if that breaks, the bus is gone for now.
    fn with<T>(&mut self, work: impl FnOnce(&mut dyn Bus) -> Result<T, BusError>) -> Option<T> {
        let bus = self.bus.as_mut()?;
        match work(bus.as_mut()) {
            Ok(done) => Some(done),
            Err(error) => {
                self.bus = None;
                self.broken = Some((error, Instant::now()));
                None
            }
        }
    }

    /// Tries to open the bus again, or waits for the next attempt but no longer than `timeout`.
    fn reopen(&mut self, timeout: Duration) -> Result<(), BusError> {
        match self.transport.open() {
            Ok(bus) => {
                self.offset = self.opened.elapsed();
                self.bus = Some(bus);
                self.broken = None;
                Ok(())
            }
            Err(error) => match &self.broken {
                Some((_, since)) if since.elapsed() < self.patience => {
                    std::thread::sleep(RETRY_PERIOD.min(timeout));
                    Ok(())
                }
                _ => Err(self.broken.take().map_or(error, |(first, _)| first)),
            },
        }
    }
}

impl Bus for ReconnectingBus {
    fn send(&mut self, frame: &Frame) -> Result<(), BusError> {
        // What cannot be sent is lost, as on a bus without a cable.
        let _ = self.with(|bus| bus.send(frame));
        Ok(())
    }

    fn send_all(&mut self, frames: &[Frame]) -> Result<(), BusError> {
        let _ = self.with(|bus| bus.send_all(frames));
        Ok(())
    }

    fn receive(&mut self, timeout: Duration) -> Result<Option<Received>, BusError> {
        let offset = self.offset;
        if self.bus.is_none() {
            self.reopen(timeout)?;
            return Ok(None);
        }
        let received = self.with(|bus| bus.receive(timeout)).flatten();
        Ok(received.map(|Received { frame, at }| Received {
            frame,
            at: at + offset,
        }))
    }

    fn now(&self) -> Duration {
        self.opened.elapsed()
    }

    fn health(&mut self) -> Result<Health, BusError> {
        Ok(self.with(|bus| bus.health()).unwrap_or_default())
    }
}

impl std::fmt::Debug for ReconnectingBus {
    fn fmt(&self, out: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        out.debug_struct("ReconnectingBus")
            .field("transport", &self.transport)
            .field("broken", &self.broken)
            .finish_non_exhaustive()
    }
}
