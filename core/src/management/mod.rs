//! The management channel: discovery, identity, parameters and maintenance, the same whatever dialect
//! drives. It speaks the DMC60C's enumeration, vendor commands and parameter frames, under the manufacturer
//! that the dialect's [`Identity`] names.
//!
//! [`Management`] decodes frames into [`Request`]s and holds the answers until they can be sent. It does
//! not execute anything: the node does, and hands back the outcome.

mod enumeration;
pub mod identity;
mod session;
#[cfg(test)]
mod tests;
mod types;
pub mod vendor;
pub mod wire;

pub use identity::Identity;
pub use session::SessionIds;
pub use types::{Answer, Chunk, Decoded, Request};

use enumeration::Enumeration;
use heapless::{Deque, Vec};
use vendor::{Command, CommandCode, Descriptor, TestPin};
use wire::{
    EnumerateResponse0, EnumerateResponse1, FirmwareVersions, ImageType, ParameterRequest,
    ParameterResponse, ParameterSet, VendorCommand, VendorStatus, id,
};

use crate::dialect::{Bad, Outcome, Request as ParameterQuery};
use crate::frame::Frame;
use crate::frc_id::{base, number, with_number};
use crate::params::store::Descriptors;
use crate::time::Instant;

/// Capacity for bulk data: to the host all six descriptors with identifier and length each; to the device the longest
/// string with its terminator is less.
const DATA_CAPACITY: usize = 64 + 28 + 28 + 20 + 8 + 12 + 6 * 2;

/// Parameter answers that may wait for the bus at one time. Requests have the higher priority on the bus, so
/// a host that asks for every parameter in one burst gets its first answer after its last question.
const ANSWER_CAPACITY: usize = 96;

/// Attempts for the first enumeration answer. A destroyed one most likely met the answer of a controller
/// with the same number and the same delay; sending it again at once would only repeat that, so it is
/// withdrawn and comes once more after another delay (docs/dmc60c.md).
pub const ENUMERATION_ATTEMPTS: u8 = 1;

/// Bulk data transfer of a vendor command.
#[derive(Clone, Copy, Debug, Default)]
enum Transfer {
    #[default]
    None,
    /// A text to the device.
    Text { which: Descriptor, expected: usize },
    /// Data to the device that its owner keeps.
    Chunks { expected: usize, received: usize },
    /// Data to the host.
    In { sent: usize },
}

/// State of the management channel. `ANSWERS` is the number of parameter answers that may wait for the bus;
/// a bootloader has no parameters, and one place that it never uses.
#[derive(Clone, Debug)]
pub struct Management<const ANSWERS: usize = ANSWER_CAPACITY> {
    session: Option<u16>,
    image: ImageType,
    identity: &'static Identity,
    enumeration: Enumeration,
    status: Option<VendorStatus>,
    /// The answer of the latest command comes when what it has changed is written.
    deferred: bool,
    transfer: Transfer,
    /// What is transferred, except chunks.
    data: Vec<u8, DATA_CAPACITY>,
    answers: Deque<ParameterResponse, ANSWERS>,
}

impl<const ANSWERS: usize> Management<ANSWERS> {
    /// A channel that waits for a bus.
    #[must_use]
    pub const fn new(image: ImageType, identity: &'static Identity) -> Self {
        Self {
            session: None,
            image,
            identity,
            enumeration: Enumeration::Idle,
            status: None,
            deferred: false,
            transfer: Transfer::None,
            data: Vec::new(),
            answers: Deque::new(),
        }
    }

    /// As what the controller is managed.
    #[must_use]
    pub const fn identity(&self) -> &'static Identity {
        self.identity
    }

    /// The session id; none while no bus is seen.
    #[must_use]
    pub const fn session(&self) -> Option<u16> {
        self.session
    }

    /// The bus has appeared under this session id, which may not be 0.
    pub fn start(&mut self, session: u16) {
        self.session = Some(session);
    }

    /// The bus is lost: session, transfers and pending answers are void.
    pub fn stop(&mut self) {
        *self = Self::new(self.image, self.identity);
    }

    /// Only an application has parameters, and only where their answers have a place.
    fn has_parameters(&self) -> bool {
        ANSWERS > 1 && self.image == ImageType::Application
    }

    /// True for the identifiers that [`Management::decode`] knows. `own` is the present device number.
    #[must_use]
    pub fn accepts(&self, own: u8, frame: &Frame) -> bool {
        let has_parameters = self.has_parameters();
        self.guide_identifier(frame)
            .is_some_and(|id| match base(id) {
                id::ENUMERATE => true,
                id::VENDOR_COMMAND | id::VENDOR_DATA_OUT => number(id) == own,
                id::PARAMETER_REQUEST | id::PARAMETER_SET => number(id) == own && has_parameters,
                _ => false,
            })
    }

    /// The identifier that the guide has for this frame.
    fn guide_identifier(&self, frame: &Frame) -> Option<u32> {
        let maker = self.identity.manufacturer;
        maker.guide_identifier(frame.extended_id()?)
    }

    /// Reads one frame. `own` is the present device number.
    pub fn decode(&mut self, own: u8, frame: &Frame) -> Decoded {
        let Some(id) = self.guide_identifier(frame) else {
            return Decoded::NotMine;
        };
        match base(id) {
            id::ENUMERATE if frame.is_remote() => Decoded::Bad(Bad::Remote),
            id::ENUMERATE => Decoded::Request(Request::Enumerate),
            _ if number(id) != own => Decoded::NotMine,
            id::PARAMETER_REQUEST | id::PARAMETER_SET if !self.has_parameters() => Decoded::NotMine,
            id::VENDOR_COMMAND
            | id::VENDOR_DATA_OUT
            | id::PARAMETER_REQUEST
            | id::PARAMETER_SET
                if frame.is_remote() =>
            {
                Decoded::Bad(Bad::Remote)
            }
            id::VENDOR_COMMAND => self.vendor_command(frame),
            id::VENDOR_DATA_OUT => self.data_out(frame),
            id::PARAMETER_REQUEST => match ParameterRequest::parse(frame) {
                Some(request) => {
                    self.for_session(request.session, ParameterQuery::Read(request.parameter))
                }
                None => Decoded::Bad(Bad::Length),
            },
            id::PARAMETER_SET => match ParameterSet::parse(frame) {
                Some(set) => {
                    self.for_session(set.session, ParameterQuery::Write(set.parameter, set.value))
                }
                None => Decoded::Bad(Bad::Length),
            },
            _ => Decoded::NotMine,
        }
    }

    fn for_session(&self, session: u16, query: ParameterQuery) -> Decoded {
        if self.session == Some(session) {
            Decoded::Request(Request::Parameter(query))
        } else {
            Decoded::Bad(Bad::Session)
        }
    }

    fn vendor_command(&mut self, frame: &Frame) -> Decoded {
        let Some(command) = VendorCommand::parse(frame) else {
            return Decoded::Bad(Bad::Length);
        };
        if self.session != Some(command.session) {
            return Decoded::Bad(Bad::Session);
        }
        // A new command ends whatever the one before has left (guide, "Vendor Commands").
        self.status = None;
        self.deferred = false;
        self.transfer = Transfer::None;
        let request = match Command::from_code(command.command) {
            None => {
                self.finish(CommandCode::NotSupported);
                return Decoded::Done;
            }
            Some(Command::EraseWriteFlashPage) => Request::WritePage {
                image: command.param1,
                page: command.param2,
            },
            Some(Command::GetPageCrcs) => Request::GetPageCrcs,
            Some(Command::RestoreFallback) => Request::RestoreFallback,
            Some(Command::GetBootStatus) => Request::GetBootStatus,
            Some(Command::InstallKey) => Request::InstallKey(command.param1),
            Some(Command::SetDeviceNumber) => match self.identity.assignable(command.param1) {
                Some(number) => Request::SetNumber(number),
                None => {
                    self.finish(CommandCode::BadParameter);
                    return Decoded::Done;
                }
            },
            Some(Command::SetDescriptor(which)) => {
                let expected = usize::from(command.param1);
                if expected == 0 || expected > which.capacity() + 1 {
                    self.finish(CommandCode::BadParameter);
                } else {
                    self.data.clear();
                    self.transfer = Transfer::Text { which, expected };
                }
                return Decoded::Done;
            }
            Some(Command::FactoryReset) if command.param1 <= 1 => Request::FactoryReset {
                all: command.param1 == 1,
            },
            Some(Command::FactoryReset) => {
                self.finish(CommandCode::BadParameter);
                return Decoded::Done;
            }
            Some(Command::FlashLeds) => Request::Identify,
            Some(Command::GetDescriptors) => Request::GetDescriptors,
            Some(Command::GetFirmwareVersion) => Request::GetVersions,
            Some(Command::GetFlashSequence) => Request::GetSequence,
            Some(Command::EnterBootloader) => {
                if self.image != ImageType::Application {
                    self.finish(CommandCode::InBootloader);
                    return Decoded::Done;
                }
                Request::EnterBootloader
            }
            Some(Command::SoftReset) => Request::SoftReset,
            Some(Command::PinTest(test)) => Request::PinTest(test),
        };
        Decoded::Request(request)
    }

    /// The command that was decoded last is followed by so many bytes, which come as [`Request::Data`].
    pub fn expect_data(&mut self, expected: usize) {
        self.transfer = Transfer::Chunks {
            expected,
            received: 0,
        };
    }

    fn data_out(&mut self, frame: &Frame) -> Decoded {
        let bytes = frame.data();
        if let Transfer::Chunks { expected, received } = &mut self.transfer {
            let offset = *received;
            *received += bytes.len();
            let (received, expected) = (*received, *expected);
            if received >= expected {
                self.transfer = Transfer::None;
            }
            if received > expected {
                self.finish(CommandCode::DataReceivedMore);
                return Decoded::Done;
            }
            return Decoded::Request(Request::Data(Chunk {
                offset,
                frame: *frame,
                is_last: received == expected,
            }));
        }
        let Transfer::Text { which, expected } = self.transfer else {
            return Decoded::Bad(Bad::Unexpected);
        };
        // The capacity is larger than any text, and a frame that goes beyond the text ends it.
        let taken = self.data.extend_from_slice(bytes);
        if self.data.len() > expected || taken.is_err() {
            self.transfer = Transfer::None;
            self.finish(CommandCode::DataReceivedMore);
            return Decoded::Done;
        }
        if self.data.len() < expected {
            return Decoded::Done;
        }
        self.transfer = Transfer::None;
        // The last byte is the terminator, whatever was sent in its place.
        self.data.pop();
        Decoded::Request(Request::SetDescriptor(which))
    }

    /// The text of [`Request::SetDescriptor`], until the next frame.
    #[must_use]
    pub fn text(&self) -> &[u8] {
        self.data
            .split(|byte| *byte == 0)
            .next()
            .unwrap_or_default()
    }

    /// Ends a vendor command with a code and no data.
    pub fn finish(&mut self, code: CommandCode) {
        self.status = Some(VendorStatus {
            code: code as u16,
            byte_count: 0,
        });
    }

    /// The command that was just given is answered later, by [`Management::finish_deferred`].
    pub const fn defer(&mut self) {
        self.deferred = true;
    }

    /// Answers a command that was deferred, unless a new one has ended it.
    pub fn finish_deferred(&mut self, code: CommandCode) {
        if core::mem::take(&mut self.deferred) {
            self.finish(code);
        }
    }

    /// Ends a pin test.
    pub fn finish_pin_test(&mut self, failed: Option<TestPin>) {
        let code = match failed {
            None => CommandCode::TestPassed as u16,
            Some(pin) => CommandCode::TestFailed as u16 | (pin as u16) << 8,
        };
        self.status = Some(VendorStatus {
            code,
            byte_count: 0,
        });
    }

    /// Ends a vendor command with data for the host: [`Management::put`] them, then [`Management::send`].
    pub fn clear(&mut self) -> &mut Self {
        self.data.clear();
        self
    }

    /// Adds data for the host; what is beyond the capacity, which is that of all six descriptors, is dropped.
    pub fn put(&mut self, bytes: &[u8]) -> &mut Self {
        for byte in bytes {
            let _ = self.data.push(*byte);
        }
        self
    }

    /// Adds a descriptor as identifier, length and text (`vcmdGetDescriptors`); `stored` is what has been set.
    pub fn put_descriptor(&mut self, which: Descriptor, stored: Option<&[u8]>) {
        let text = stored.unwrap_or(self.identity.default_text(which).as_bytes());
        self.put(&[which as u8, text.len() as u8]).put(text);
    }

    /// Sends the descriptors.
    pub fn send_descriptors(&mut self, descriptors: &Descriptors) {
        self.clear();
        for which in Descriptor::ALL {
            self.put_descriptor(which, descriptors.stored(which));
        }
        self.send();
    }

    /// Sends the data that were put.
    pub fn send(&mut self) {
        self.status = Some(VendorStatus {
            code: CommandCode::NoError as u16,
            byte_count: self.data.len() as u16,
        });
        self.transfer = Transfer::In { sent: 0 };
    }

    /// Sends the firmware versions (`FWVERRSP`).
    pub fn send_versions(&mut self, versions: FirmwareVersions) {
        self.clear().put(&versions.to_bytes()).send();
    }

    /// Sends the flash sequence number, low byte first.
    pub fn send_sequence(&mut self, sequence: u32) {
        self.clear().put(&sequence.to_le_bytes()).send();
    }

    /// Answers a parameter request; false if too many answers are waiting.
    pub fn answer_parameter(&mut self, outcome: Outcome) -> bool {
        let (value, code) = match outcome.result {
            Ok(value) => (value, 0),
            Err(error) => (0, error as u8),
        };
        let response = ParameterResponse {
            parameter: outcome.parameter,
            value,
            code,
        };
        self.answers.push_back(response).is_ok()
    }

    /// An enumeration request has come.
    pub fn enumerate(&mut self, now: Instant, own: u8) {
        if let Some(session) = self.session {
            self.enumeration.request(now, own, session);
        }
    }

    /// The next frame to send. Status goes before data, and both before parameters and enumeration.
    pub fn encode(
        &mut self,
        now: Instant,
        own: u8,
        versions: FirmwareVersions,
    ) -> Option<(Frame, Answer)> {
        let (frame, answer) = self.encode_guide(now, own, versions)?;
        let maker = self.identity.manufacturer;
        Some((
            frame.with_extended_id(maker.identifier(frame.raw_id())),
            answer,
        ))
    }

    /// The next frame, with the guide's identifier.
    fn encode_guide(
        &mut self,
        now: Instant,
        own: u8,
        versions: FirmwareVersions,
    ) -> Option<(Frame, Answer)> {
        let session = self.session?;
        if let Some(status) = self.status.take() {
            return Some((status.emit(own), Answer::Other));
        }
        if let Some(frame) = self.data_in(own) {
            return Some((frame, Answer::Other));
        }
        if self.has_parameters()
            && let Some(response) = self.answers.pop_front()
        {
            return Some((response.emit(own), Answer::Other));
        }
        match self.enumeration {
            Enumeration::Waiting { due, again } if due <= now => {
                self.enumeration = Enumeration::FirstOnTheWay { number: own, again };
                let response = EnumerateResponse0 {
                    session,
                    product_id: self.identity.product_id,
                };
                Some((response.emit(own), Answer::Enumerate0))
            }
            Enumeration::SecondReady { number } => {
                self.enumeration = Enumeration::Idle;
                let response = EnumerateResponse1 { session, versions };
                Some((response.emit(number), Answer::Other))
            }
            _ => None,
        }
    }

    fn data_in(&mut self, own: u8) -> Option<Frame> {
        let Transfer::In { sent } = &mut self.transfer else {
            return None;
        };
        let rest = self.data.get(*sent..)?;
        let chunk = rest.get(..rest.len().min(8))?;
        let id = with_number(id::VENDOR_DATA_IN, own);
        let frame = Frame::new(embedded_can::ExtendedId::new(id)?, chunk)?;
        *sent += chunk.len();
        if *sent >= self.data.len() {
            self.transfer = Transfer::None;
        }
        Some(frame)
    }

    /// The first enumeration answer has been sent: the second follows.
    pub fn enumerate_0_sent(&mut self) {
        self.enumeration.first_sent();
    }

    /// The first enumeration answer was destroyed: the session id becomes `session`, and the answer comes
    /// once more, after the delay of that session.
    pub fn enumerate_0_destroyed(&mut self, now: Instant, session: u16) {
        if let Some(present) = &mut self.session {
            *present = session;
            self.enumeration.first_destroyed(now, session);
        }
    }

    /// When [`Management::encode`] has something to send next.
    #[must_use]
    pub fn next_deadline(&self) -> Option<Instant> {
        let owed = self.status.is_some()
            || matches!(self.transfer, Transfer::In { .. })
            || !self.answers.is_empty();
        if owed {
            return Some(Instant::ZERO);
        }
        self.enumeration.due()
    }
}
