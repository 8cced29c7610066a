//! Vendor commands: strings, device number, versions, resets and tests.

use std::time::Duration;

use windlass_core::dialect;
use windlass_core::frame::Frame;
use windlass_core::frc_id::with_number;
use windlass_core::management::identity::Manufacturer;
use windlass_core::management::vendor::{Command, CommandCode, Descriptor, PinTest, TestPin};
use windlass_core::management::wire::{
    FirmwareVersions, MAX_DEVICE_NUMBER, VendorCommand, VendorStatus, id,
};

use super::{ATTEMPTS, Address, Client, Descriptors, Error, Selector, ValueError};
use crate::transport::{Bus, BusError};

/// Time for a command that writes to flash, which stops the device's processor.
const WRITE_TIME: Duration = Duration::from_millis(500);
/// Time for a restart, after which the device answers by itself.
const RESTART_TIME: Duration = Duration::from_secs(3);
/// Time for a test of the expansion header.
const TEST_TIME: Duration = Duration::from_secs(2);

/// One vendor command with everything that belongs to it.
pub(super) struct Exchange<'a> {
    pub(super) command: Command,
    pub(super) param1: u16,
    pub(super) param2: u16,
    /// Bytes to the device.
    pub(super) payload: &'a [u8],
    /// Number under which the device answers.
    pub(super) answers_as: u8,
    /// Shortest time to wait for the status.
    pub(super) patience: Duration,
    pub(super) attempts: u32,
    /// The answer may come under another manufacturer: a changed dialect is in force after a restart.
    pub(super) restarts: bool,
}

impl Exchange<'static> {
    /// A command without parameters that may be repeated.
    pub(super) const fn plain(command: Command, number: u8) -> Self {
        Self {
            command,
            param1: 0,
            param2: 0,
            payload: &[],
            answers_as: number,
            patience: Duration::ZERO,
            attempts: ATTEMPTS,
            restarts: false,
        }
    }
}

/// The device's answer.
pub(super) struct Reply {
    pub(super) code: u16,
    pub(super) data: Vec<u8>,
    /// Whose identifier it came with.
    pub(super) manufacturer: Manufacturer,
}

impl<B: Bus> Client<B> {
    /// Gives the device another number, 1 to 63 (a Talon 0 to 62), and returns its new address.
    ///
    /// # Errors
    /// Number out of range, no answer, or the device refused.
    pub fn set_device_number(&mut self, address: Address, number: u8) -> Result<Address, Error> {
        check_number(number, Some(address.manufacturer))?;
        let renumbered = Address { number, ..address };
        let exchange = Exchange {
            param1: u16::from(number),
            answers_as: number,
            patience: WRITE_TIME,
            attempts: 1,
            ..Exchange::plain(Command::SetDeviceNumber, address.number)
        };
        match self.transact(address, &exchange) {
            Ok(reply) => expect(
                address,
                Command::SetDeviceNumber,
                &reply,
                CommandCode::NoError,
            )?,
            // The answer may have been lost although the number has changed, so ask around.
            Err(Error::NoAnswer { .. }) => {
                self.find(&Selector::from(renumbered))?;
            }
            Err(error) => return Err(error),
        }
        Ok(renumbered)
    }

    /// Stores one of the device's strings.
    ///
    /// # Errors
    /// Text too long or with control characters, no answer, or the device refused.
    pub fn set_descriptor(
        &mut self,
        address: Address,
        descriptor: Descriptor,
        text: &str,
    ) -> Result<(), Error> {
        check_text(descriptor, text)?;
        let mut payload = text.as_bytes().to_vec();
        payload.push(0);
        let command = Command::SetDescriptor(descriptor);
        let exchange = Exchange {
            param1: payload.len() as u16,
            payload: &payload,
            patience: WRITE_TIME,
            ..Exchange::plain(command, address.number)
        };
        let reply = self.transact(address, &exchange)?;
        expect(address, command, &reply, CommandCode::NoError)
    }

    /// Puts parameters, faults and the name of the device back to their defaults; with `all` also its number
    /// and the strings of its manufacture. Returns its address afterwards.
    ///
    /// # Errors
    /// No answer, or the device refused: a motor that is driven comes first.
    pub fn factory_reset(&mut self, address: Address, all: bool) -> Result<Address, Error> {
        let number = if all { 0 } else { address.number };
        let exchange = Exchange {
            param1: u16::from(all),
            answers_as: number,
            patience: WRITE_TIME,
            attempts: 1,
            ..Exchange::plain(Command::FactoryReset, address.number)
        };
        let reply = self.transact(address, &exchange)?;
        expect(address, Command::FactoryReset, &reply, CommandCode::NoError)?;
        Ok(Address { number, ..address })
    }

    /// Lets the device show a rainbow on its LEDs for five seconds.
    ///
    /// # Errors
    /// No answer, or the device refused.
    pub fn flash_leds(&mut self, address: Address) -> Result<(), Error> {
        self.fetch(address, Command::FlashLeds).map(drop)
    }

    /// Reads the device's strings.
    ///
    /// # Errors
    /// No answer, or an answer that makes no sense.
    pub fn descriptors(&mut self, address: Address) -> Result<Descriptors, Error> {
        let data = self.fetch(address, Command::GetDescriptors)?;
        Descriptors::parse(&data)
            .ok_or_else(|| bad_answer(address, Command::GetDescriptors, "a string is cut short"))
    }

    /// Reads the running image and the versions.
    ///
    /// # Errors
    /// No answer, or an answer that makes no sense.
    pub fn firmware_versions(&mut self, address: Address) -> Result<FirmwareVersions, Error> {
        let bytes = self.fetch_exactly(address, Command::GetFirmwareVersion)?;
        Ok(FirmwareVersions::from_bytes(bytes))
    }

    /// Reads how often the device has written its settings to flash.
    ///
    /// # Errors
    /// No answer, or an answer that makes no sense.
    pub fn flash_sequence(&mut self, address: Address) -> Result<u32, Error> {
        let bytes = self.fetch_exactly(address, Command::GetFlashSequence)?;
        Ok(u32::from_le_bytes(bytes))
    }

    /// Restarts the device into its bootloader and waits until that answers. The session stays; returned is the
    /// address, whose manufacturer is another one if the stored dialect has been changed.
    ///
    /// # Errors
    /// No answer within three seconds, or the device refused.
    pub fn enter_bootloader(&mut self, address: Address) -> Result<Address, Error> {
        self.restart(address, Command::EnterBootloader, CommandCode::InBootloader)
    }

    /// Restarts the device and waits until its application answers. The session stays; returned is the
    /// address, as by [`Client::enter_bootloader`]. Without an application the device gives no answer.
    ///
    /// # Errors
    /// No answer within three seconds, or the device refused.
    pub fn soft_reset(&mut self, address: Address) -> Result<Address, Error> {
        self.restart(address, Command::SoftReset, CommandCode::AcknowledgeReset)
    }

    /// Tests the pins of the expansion header.
    ///
    /// # Errors
    /// No answer, or the device refused.
    pub fn pin_test(&mut self, address: Address, test: PinTest) -> Result<PinTestResult, Error> {
        let command = Command::PinTest(test);
        let exchange = Exchange {
            patience: TEST_TIME,
            attempts: 1,
            ..Exchange::plain(command, address.number)
        };
        let reply = self.transact(address, &exchange)?;
        match CommandCode::from_code(reply.code as u8) {
            Some(CommandCode::TestPassed) => Ok(PinTestResult::Passed),
            Some(CommandCode::TestFailed) => {
                let [_, pin] = reply.code.to_le_bytes();
                Ok(PinTestResult::Failed(TestPin::from_code(pin)))
            }
            _ => Err(refused(address, command, reply.code)),
        }
    }

    fn restart(
        &mut self,
        address: Address,
        command: Command,
        expected: CommandCode,
    ) -> Result<Address, Error> {
        let exchange = Exchange {
            patience: RESTART_TIME,
            attempts: 1,
            restarts: true,
            ..Exchange::plain(command, address.number)
        };
        let reply = self.transact(address, &exchange)?;
        expect(address, command, &reply, expected)?;
        Ok(Address {
            manufacturer: reply.manufacturer,
            ..address
        })
    }

    /// Runs a command without parameters that returns `N` bytes.
    fn fetch_exactly<const N: usize>(
        &mut self,
        address: Address,
        command: Command,
    ) -> Result<[u8; N], Error> {
        let data = self.fetch(address, command)?;
        data.try_into()
            .map_err(|_| bad_answer(address, command, &format!("not {N} bytes")))
    }

    /// Runs a command without parameters and gives the data it returns.
    fn fetch(&mut self, address: Address, command: Command) -> Result<Vec<u8>, Error> {
        let reply = self.transact(address, &Exchange::plain(command, address.number))?;
        expect(address, command, &reply, CommandCode::NoError)?;
        Ok(reply.data)
    }

    /// What runs on the device with this address; `None` if there is no such device. Every image knows
    /// the command that is asked.
    pub(super) fn probe(&mut self, address: Address) -> Result<Option<FirmwareVersions>, BusError> {
        let question = Exchange::plain(Command::GetFirmwareVersion, address.number);
        for _ in 0..question.attempts {
            let reply = self.attempt(address, &question)?;
            let bytes = reply.and_then(|reply| reply.data.try_into().ok());
            if let Some(bytes) = bytes {
                return Ok(Some(FirmwareVersions::from_bytes(bytes)));
            }
        }
        Ok(None)
    }

    /// The number of the device of this manufacturer with this session, asked of all numbers at once: only the
    /// device whose session it is answers.
    pub(super) fn number_of(
        &mut self,
        session: u16,
        manufacturer: Manufacturer,
    ) -> Result<Option<u8>, BusError> {
        let question = VendorCommand {
            session,
            command: Command::GetFirmwareVersion.code(),
            param1: 0,
            param2: 0,
        };
        for number in 0..=MAX_DEVICE_NUMBER {
            let address = Address {
                number,
                session,
                manufacturer,
            };
            self.send(&address.frame(&question.emit(number)))?;
        }
        self.wait_for(self.answer_timeout, |frame| {
            let (sender, _) = status_of(frame)?;
            (sender.0 == manufacturer).then_some(sender.1)
        })
    }

    pub(super) fn transact(
        &mut self,
        address: Address,
        exchange: &Exchange<'_>,
    ) -> Result<Reply, Error> {
        for _ in 0..exchange.attempts {
            if let Some(reply) = self.attempt(address, exchange)? {
                return Ok(reply);
            }
        }
        Err(self.silence(address, name(exchange.command)))
    }

    pub(super) fn attempt(
        &mut self,
        address: Address,
        exchange: &Exchange<'_>,
    ) -> Result<Option<Reply>, BusError> {
        self.post(address, exchange)?;
        self.answer(address, exchange)
    }

    /// Sends a command.
    pub(super) fn post(
        &mut self,
        address: Address,
        exchange: &Exchange<'_>,
    ) -> Result<(), BusError> {
        let command = VendorCommand {
            session: address.session,
            command: exchange.command.code(),
            param1: exchange.param1,
            param2: exchange.param2,
        };
        let chunks = exchange.payload.chunks(8);
        let data = chunks.filter_map(|chunk| data_out(address.number, chunk));
        let frames: Vec<Frame> = std::iter::once(command.emit(address.number))
            .chain(data)
            .map(|frame| address.frame(&frame))
            .collect();
        self.send_all(&frames)
    }

    /// Waits for the next answer of a device.
    pub(super) fn answer(
        &mut self,
        address: Address,
        exchange: &Exchange<'_>,
    ) -> Result<Option<Reply>, BusError> {
        let wait = self.answer_timeout.max(exchange.patience);
        let numbers = [exchange.answers_as, address.number];
        let answer = self.wait_for(wait, |frame| {
            let ((maker, number), status) = status_of(frame)?;
            let is_its = exchange.restarts || maker == address.manufacturer;
            (is_its && numbers.contains(&number)).then_some((maker, status))
        })?;
        match answer {
            Some((maker, status)) => self.collect((maker, exchange.answers_as), status),
            None => Ok(None),
        }
    }

    /// Receives the data that a status announces. A second status means that the device has started
    /// the answer again (an earlier request was answered late); `None` if data is missing.
    fn collect(
        &mut self,
        sender: Sender,
        mut status: VendorStatus,
    ) -> Result<Option<Reply>, BusError> {
        let (manufacturer, number) = sender;
        let mut data = Vec::new();
        while data.len() < usize::from(status.byte_count) {
            let part = self.wait_for(self.answer_timeout, |frame| {
                if let Some((_, status)) = status_of(frame).filter(|found| found.0 == sender) {
                    return Some(Part::Again(status));
                }
                let data_in = manufacturer.addressed(id::VENDOR_DATA_IN, number);
                (frame.extended_id() == Some(data_in)).then(|| Part::Data(frame.data().to_vec()))
            })?;
            match part {
                Some(Part::Data(bytes)) => data.extend(bytes),
                Some(Part::Again(newer)) => {
                    status = newer;
                    data.clear();
                }
                None => return Ok(None),
            }
        }
        let code = status.code;
        Ok(Some(Reply {
            code,
            data,
            manufacturer,
        }))
    }
}

/// Result of [`Client::pin_test`].
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum PinTestResult {
    /// No pin failed.
    Passed,
    /// A pin failed: the last one, if the device names it.
    Failed(Option<TestPin>),
}

enum Part {
    Data(Vec<u8>),
    Again(VendorStatus),
}

/// Under whose identifier and number an answer came.
type Sender = (Manufacturer, u8);

fn status_of(frame: &Frame) -> Option<(Sender, VendorStatus)> {
    let sender = Manufacturer::sender(id::VENDOR_STATUS, frame.extended_id()?)?;
    Some((sender, VendorStatus::parse(frame)?))
}

fn data_out(number: u8, chunk: &[u8]) -> Option<Frame> {
    let identifier = with_number(id::VENDOR_DATA_OUT, number);
    Frame::new(embedded_can::ExtendedId::new(identifier)?, chunk)
}

/// Whether a device of this manufacturer, or any device, may be given this number.
pub(crate) fn check_number(
    number: u8,
    manufacturer: Option<Manufacturer>,
) -> Result<(), ValueError> {
    let kinds = dialect::ALL.iter().map(|kind| kind.identity());
    let mut kinds = kinds
        .filter(|kind| manufacturer.is_none_or(|manufacturer| manufacturer == kind.manufacturer));
    if kinds
        .clone()
        .any(|kind| kind.assignable(u16::from(number)).is_some())
    {
        return Ok(());
    }
    let range = match (manufacturer, kinds.next()) {
        (Some(_), Some(kind)) => format!(
            " for a {} ({} to {})",
            kind.product_name, kind.first_number, kind.last_number
        ),
        _ => format!(" (1 to {MAX_DEVICE_NUMBER})"),
    };
    Err(ValueError::new(format!(
        "device number {number} is out of range{range}"
    )))
}

/// Whether a device can store this text.
pub(crate) fn check_text(descriptor: Descriptor, text: &str) -> Result<(), ValueError> {
    let capacity = descriptor.capacity();
    if text.len() > capacity {
        return Err(ValueError::new(format!(
            "the text has {} bytes, the device stores {capacity} at most",
            text.len()
        )));
    }
    if text.chars().any(char::is_control) {
        return Err(ValueError::new("the text contains control characters"));
    }
    Ok(())
}

pub(super) fn name(command: Command) -> &'static str {
    let row = Command::TABLE.iter().find(|row| row.2 == command);
    row.map_or("a vendor command", |row| row.1)
}

pub(super) fn expect(
    address: Address,
    command: Command,
    reply: &Reply,
    expected: CommandCode,
) -> Result<(), Error> {
    if CommandCode::from_code(reply.code as u8) == Some(expected) {
        Ok(())
    } else {
        Err(refused(address, command, reply.code))
    }
}

pub(super) fn refused(address: Address, command: Command, code: u16) -> Error {
    Error::Refused {
        address,
        request: name(command).to_owned(),
        code: match CommandCode::from_code(code as u8) {
            Some(known) => known.name().to_owned(),
            None => format!("unknown code {code}"),
        },
    }
}

pub(super) fn bad_answer(address: Address, command: Command, reason: &str) -> Error {
    Error::BadAnswer {
        address,
        request: name(command).to_owned(),
        reason: reason.to_owned(),
    }
}
