//! The management channel: discovery, identity, parameters and maintenance, the same whatever dialect
//! drives. It speaks the DMC60C's enumeration, vendor commands and parameter frames.
//!
//! [`Management`] decodes frames into [`Request`]s and holds the answers until they can be sent. It does
//! not execute anything: the node does, and hands back the outcome.

pub mod vendor;
pub mod wire;

#[cfg(test)]
mod tests;

use heapless::{Deque, Vec};
use vendor::{Command, CommandCode, Descriptor, PinTest, TestPin};
use wire::{
    EnumerateResponse0, EnumerateResponse1, FirmwareVersions, ImageType, ParameterRequest,
    ParameterResponse, ParameterSet, VendorCommand, VendorStatus, id,
};

use crate::dialect::{Bad, Outcome, Request as ParameterQuery};
use crate::frame::Frame;
use crate::frc_id::{base, number, with_number};
use crate::params::store::Descriptors;
use crate::time::{Duration, Instant};

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

/// Unit of the enumeration delay (docs/dmc60c.md).
const DELAY_UNIT: Duration = crate::time::TICK;

/// A request of the host, checked, to be executed by the node.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Request {
    /// Enumerate.
    Enumerate,
    /// Read or write a parameter.
    Parameter(ParameterQuery),
    /// Store the device number, 1 to 63.
    SetNumber(u8),
    /// Store a descriptor: [`Management::text`].
    SetDescriptor(Descriptor),
    /// Put the settings back to their defaults; `all`: device number and strings as well.
    FactoryReset {
        /// Device number and every string too, not only parameters, faults and the device's name.
        all: bool,
    },
    /// Show the identify pattern.
    Identify,
    /// Send the descriptors.
    GetDescriptors,
    /// Send the firmware versions.
    GetVersions,
    /// Send the flash sequence number.
    GetSequence,
    /// Restart into the bootloader.
    EnterBootloader,
    /// Restart.
    SoftReset,
    /// Test the expansion header.
    PinTest(PinTest),
    /// Erase and write a page: image type and page number as they came.
    WritePage {
        /// `PARAM1`.
        image: u16,
        /// `PARAM2`.
        page: u16,
    },
    /// Bytes of the transfer that [`Management::expect_data`] asked for.
    Data(Chunk),
    /// Tell which pages of an update are stored.
    GetPageCrcs,
    /// Put the fallback image back.
    RestoreFallback,
    /// Send the state of the slots.
    GetBootStatus,
    /// Install a key that comes as so many bytes.
    InstallKey(u16),
}

/// Bytes of a transfer, as one frame brought them.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Chunk {
    /// Place of the first byte in the transfer.
    pub offset: usize,
    /// The frame.
    pub frame: Frame,
    /// These are the last bytes.
    pub is_last: bool,
}

/// What a frame turned out to be.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Decoded {
    /// Not for the management channel.
    NotMine,
    /// Handled, nothing to execute.
    Done,
    /// To be executed.
    Request(Request),
    /// A frame for this device that changes nothing.
    Bad(Bad),
}

/// Which answer of the management channel a transmission carries.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Answer {
    /// First enumeration answer: the second may follow once it has been sent.
    Enumerate0,
    /// Any other of the management channel.
    Other,
    /// None of the management channel's: a frame of the dialect.
    Dialect,
}

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

/// Progress of an enumeration. The number is kept so that both answers carry the same one.
#[derive(Clone, Copy, Debug)]
enum Enumeration {
    Idle,
    /// `again`: an attempt has been destroyed already.
    Waiting {
        due: Instant,
        again: bool,
    },
    FirstOnTheWay {
        number: u8,
        again: bool,
    },
    SecondReady {
        number: u8,
    },
}

/// State of the management channel. `ANSWERS` is the number of parameter answers that may wait for the bus;
/// a bootloader has no parameters, and one place that it never uses.
#[derive(Clone, Debug)]
pub struct Management<const ANSWERS: usize = ANSWER_CAPACITY> {
    session: Option<u16>,
    image: ImageType,
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
    pub const fn new(image: ImageType) -> Self {
        Self {
            session: None,
            image,
            enumeration: Enumeration::Idle,
            status: None,
            deferred: false,
            transfer: Transfer::None,
            data: Vec::new(),
            answers: Deque::new(),
        }
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
        *self = Self::new(self.image);
    }

    /// Only an application has parameters, and only where their answers have a place.
    fn has_parameters(&self) -> bool {
        ANSWERS > 1 && self.image == ImageType::Application
    }

    /// True for the identifiers that [`Management::decode`] knows. `own` is the present device number.
    #[must_use]
    pub fn accepts(&self, own: u8, frame: &Frame) -> bool {
        let has_parameters = self.has_parameters();
        frame.extended_id().is_some_and(|id| match base(id) {
            id::ENUMERATE => true,
            id::VENDOR_COMMAND | id::VENDOR_DATA_OUT => number(id) == own,
            id::PARAMETER_REQUEST | id::PARAMETER_SET => number(id) == own && has_parameters,
            _ => false,
        })
    }

    /// Reads one frame. `own` is the present device number.
    pub fn decode(&mut self, own: u8, frame: &Frame) -> Decoded {
        let Some(id) = frame.extended_id() else {
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
            Some(Command::SetDeviceNumber) => match u8::try_from(command.param1) {
                Ok(new @ 1..=wire::MAX_DEVICE_NUMBER) => Request::SetNumber(new),
                _ => {
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

    /// Adds a descriptor as identifier, length and text (`vcmdGetDescriptors`).
    pub fn put_descriptor(&mut self, which: Descriptor, text: &[u8]) {
        self.put(&[which as u8, text.len() as u8]).put(text);
    }

    /// Sends the descriptors.
    pub fn send_descriptors(&mut self, descriptors: &Descriptors) {
        self.clear();
        for which in Descriptor::ALL {
            self.put_descriptor(which, descriptors.get(which));
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

    /// An enumeration request has come. A request during a pending answer is dropped.
    ///
    /// Numbered devices wait twice their number, others seven bits of their session id, in units of
    /// 500 µs; 0 becomes 1.
    pub fn enumerate(&mut self, now: Instant, own: u8) {
        let (Enumeration::Idle, Some(session)) = (self.enumeration, self.session) else {
            return;
        };
        let units = match own {
            0 => session_units(session),
            number => 2 * u32::from(number),
        };
        self.enumeration = Enumeration::Waiting {
            due: now + delay(units),
            again: false,
        };
    }

    /// The next frame to send. Status goes before data, and both before parameters and enumeration.
    pub fn encode(
        &mut self,
        now: Instant,
        own: u8,
        product_id: u32,
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
                    product_id,
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
        if let Enumeration::FirstOnTheWay { number, .. } = self.enumeration {
            self.enumeration = Enumeration::SecondReady { number };
        }
    }

    /// The first enumeration answer was destroyed: the session id becomes `session`, and the answer comes
    /// once more, after the delay of that session.
    pub fn enumerate_0_destroyed(&mut self, now: Instant, session: u16) {
        let Some(present) = &mut self.session else {
            return;
        };
        *present = session;
        if let Enumeration::FirstOnTheWay { again, .. } = self.enumeration {
            self.enumeration = if again {
                Enumeration::Idle
            } else {
                Enumeration::Waiting {
                    due: now + delay(session_units(session)),
                    again: true,
                }
            };
        }
    }

    /// When [`Management::encode`] has something to send next.
    #[must_use]
    pub fn next_deadline(&self) -> Option<Instant> {
        let owed = self.status.is_some()
            || matches!(self.transfer, Transfer::In { .. })
            || !self.answers.is_empty();
        match self.enumeration {
            _ if owed => Some(Instant::ZERO),
            Enumeration::Waiting { due, .. } => Some(due),
            Enumeration::SecondReady { .. } => Some(Instant::ZERO),
            Enumeration::Idle | Enumeration::FirstOnTheWay { .. } => None,
        }
    }
}

/// Source of session ids.
///
/// They are 16 bits of a 64 MHz timer on the DMC60C, and never 0. Here the board's seed and all events so
/// far take part, so that boards that were switched on together still differ.
#[derive(Clone, Debug)]
pub struct SessionIds(u32);

impl SessionIds {
    /// A source; `seed` differs from board to board.
    #[must_use]
    pub const fn new(seed: u32) -> Self {
        Self(seed)
    }

    /// The next session id.
    pub fn draw(&mut self, now: Instant) -> u16 {
        // Xorshift32 (Marsaglia 2003), whose state must not be 0.
        let mut x = (self.0 ^ now.as_micros() as u32).max(1);
        x ^= x << 13;
        x ^= x >> 17;
        x ^= x << 5;
        self.0 = x;
        ((x >> 16) as u16).max(1)
    }
}

/// Delay of a device without a number: seven bits of its session id.
fn session_units(session: u16) -> u32 {
    u32::from(session & 0x7F)
}

/// An enumeration delay, at least one unit.
fn delay(units: u32) -> Duration {
    Duration::from_micros(u64::from(units.max(1)) * DELAY_UNIT.as_micros())
}
