//! Client of the management channel and of the DMC60C protocol, generic over [`Bus`]; [`talon`] drives
//! Talon SRX devices on top of it.
//!
//! [`Client`] sends requests, waits for their answers and, whatever it waits for, keeps the latest
//! status frames of every device ([`Client::status`]) and counts the traffic ([`Client::traffic`]).

mod control;
mod device;
mod enumerate;
mod error;
mod parameter;
mod selector;
mod status;
pub mod talon;
mod update;
mod vendor;

use std::collections::BTreeMap;
use std::time::Duration;

use windlass_core::dialect::dmc60c::wire::Control0;
use windlass_core::frame::Frame;

use crate::transport::{Bus, BusError, Received};

pub use control::{Drive, Target};
pub(crate) use device::image_name;
pub use device::{Address, Descriptors, Device, Version};
pub use error::{Error, ValueError};
pub use parameter::{Value, find_parameter};
pub use selector::{Selector, SelectorError};
pub use status::{ClosedLoopError, Live, Status};
pub use update::Late;
pub use vendor::PinTestResult;

pub(crate) use device::product_name;
pub(crate) use parameter::{fault_name, is_own, leds_text};
pub(crate) use status::mode_name;
pub(crate) use vendor::{check_number, check_text};

/// How often a driving frame is sent again: twice within the device's heartbeat of 104 ms.
pub const CONTROL_PERIOD: Duration = Duration::from_millis(50);

/// Attempts at a request that may be repeated without harm.
const ATTEMPTS: u32 = 3;

/// What passed on the bus since the client was made, its own frames included.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Traffic {
    /// Number of frames.
    pub frames: u64,
    /// Bit times of these frames with stuff bits and the gap of three bits after each.
    pub bits: u64,
}

/// A participant on the bus that talks to DMC60C devices.
#[derive(Debug)]
pub struct Client<B> {
    bus: B,
    answer_timeout: Duration,
    statuses: BTreeMap<u8, Status>,
    talons: BTreeMap<u8, talon::TalonStatus>,
    traffic: Traffic,
}

impl<B: Bus> Client<B> {
    /// A client on `bus` that waits 100 ms for each answer, as the vendor's client does.
    pub fn new(bus: B) -> Self {
        Self {
            bus,
            answer_timeout: Duration::from_millis(100),
            statuses: BTreeMap::new(),
            talons: BTreeMap::new(),
            traffic: Traffic::default(),
        }
    }

    /// The same client with another time to wait for each answer.
    #[must_use]
    pub fn with_answer_timeout(mut self, timeout: Duration) -> Self {
        self.answer_timeout = timeout;
        self
    }

    /// The bus underneath.
    pub fn bus(&mut self) -> &mut B {
        &mut self.bus
    }

    /// Time on the bus.
    pub fn now(&self) -> Duration {
        self.bus.now()
    }

    /// Puts a frame on the bus.
    ///
    /// # Errors
    /// The bus failed.
    pub fn send(&mut self, frame: &Frame) -> Result<(), BusError> {
        self.bus.send(frame)?;
        self.count(frame);
        Ok(())
    }

    /// Puts several frames on the bus, in this order.
    ///
    /// # Errors
    /// The bus failed; some of the frames may have been sent.
    pub fn send_all(&mut self, frames: &[Frame]) -> Result<(), BusError> {
        self.bus.send_all(frames)?;
        for frame in frames {
            self.count(frame);
        }
        Ok(())
    }

    /// Waits for the next frame, at most `timeout`, and takes note of what it says.
    ///
    /// # Errors
    /// The bus failed.
    pub fn receive(&mut self, timeout: Duration) -> Result<Option<Received>, BusError> {
        let received = self.bus.receive(timeout)?;
        if let Some(Received { frame, at }) = &received {
            self.count(frame);
            self.note_status(frame, *at);
        }
        Ok(received)
    }

    /// Lets `span` pass while taking note of every frame.
    ///
    /// # Errors
    /// The bus failed.
    pub fn listen(&mut self, span: Duration) -> Result<(), BusError> {
        let nothing: Option<()> = self.wait_for(span, |_| None)?;
        debug_assert!(nothing.is_none());
        Ok(())
    }

    /// The latest status frames of the devices with number `number`.
    pub fn status(&self, number: u8) -> Option<&Status> {
        self.statuses.get(&number)
    }

    /// The latest status frames of every device that sends any, by device number.
    pub fn statuses(&self) -> impl Iterator<Item = (u8, &Status)> {
        self.statuses
            .iter()
            .map(|(number, status)| (*number, status))
    }

    /// The latest frames of the Talons with number `number`.
    pub fn talon_status(&self, number: u8) -> Option<&talon::TalonStatus> {
        self.talons.get(&number)
    }

    /// The latest frames of every Talon that sends any, by device number.
    pub fn talon_statuses(&self) -> impl Iterator<Item = (u8, &talon::TalonStatus)> {
        self.talons.iter().map(|(number, status)| (*number, status))
    }

    /// What passed on the bus so far.
    pub const fn traffic(&self) -> Traffic {
        self.traffic
    }

    /// Sends a control frame to the devices with number `number`. It holds for 104 ms; a drive that is
    /// to go on needs it again every [`CONTROL_PERIOD`].
    ///
    /// # Errors
    /// The bus failed.
    pub fn control(&mut self, number: u8, control: &Control0) -> Result<(), BusError> {
        self.send(&control.emit(number))
    }

    /// Switches the output of the devices with number `number` off.
    ///
    /// # Errors
    /// The bus failed.
    pub fn switch_off(&mut self, number: u8) -> Result<(), BusError> {
        self.control(number, &Control0::default())
    }

    /// Drives the devices with number `number` for `span`: the control frame again and again, while
    /// noting every status frame. The output stays on at the end for the device's heartbeat time.
    ///
    /// # Errors
    /// The bus failed.
    pub fn drive_for(
        &mut self,
        number: u8,
        control: &Control0,
        span: Duration,
    ) -> Result<(), BusError> {
        let end = self.now() + span;
        while self.now() < end {
            self.control(number, control)?;
            self.listen(CONTROL_PERIOD.min(end.saturating_sub(self.now())))?;
        }
        Ok(())
    }

    /// Receives until `pick` takes something from a frame or `span` has passed.
    fn wait_for<T>(
        &mut self,
        span: Duration,
        mut pick: impl FnMut(&Frame) -> Option<T>,
    ) -> Result<Option<T>, BusError> {
        let deadline = self.now() + span;
        loop {
            let left = deadline.saturating_sub(self.now());
            if let Some(received) = self.receive(left)? {
                let picked = pick(&received.frame);
                if picked.is_some() {
                    return Ok(picked);
                }
            }
            if self.now() >= deadline {
                return Ok(None);
            }
        }
    }

    fn note_status(&mut self, frame: &Frame, at: Duration) {
        if let Some(number) = status::sender(frame) {
            self.statuses.entry(number).or_default().note(frame, at);
        } else if let Some(number) = talon::sender(frame) {
            self.talons.entry(number).or_default().note(frame, at);
        }
    }

    fn count(&mut self, frame: &Frame) {
        self.traffic.frames += 1;
        self.traffic.bits += windlass_sim::occupied_bits(frame);
    }
}
