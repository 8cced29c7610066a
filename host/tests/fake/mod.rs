//! Devices of a test: the management channel with the page protocol, as docs/updates.md and the guide
//! describe it, on a bus in virtual time where single frames and whole devices can be lost.

// Each test crate uses a part of this.
#![allow(dead_code)]

use std::collections::{BTreeMap, VecDeque};
use std::time::Duration;

use embedded_can::ExtendedId;
use windlass::client::Descriptors;
use windlass::transport::{Bus, BusError, Received};
use windlass_core::boot::image::{
    HEADER_OFFSET, Hardware, Header, LAST_PAGE, NO_VERSION, PAGE_COUNT, PAGE_SIZE, Page,
};
use windlass_core::boot::status::{BootStatus, Reason};
use windlass_core::crc::page_transfer;
use windlass_core::dialect::dmc60c::wire::id::STATUS_GENERAL;
use windlass_core::frame::Frame;
use windlass_core::frc_id;
use windlass_core::management::vendor::{Command, CommandCode, Descriptor};
use windlass_core::management::wire::{
    EnumerateResponse0, EnumerateResponse1, FirmwareVersions, ImageType, VendorCommand,
    VendorStatus, id,
};
use windlass_core::node::PRODUCT_DMC60C;

/// Time of one frame on the bus.
const FRAME_TIME: Duration = Duration::from_micros(140);
/// Stands for a key where a page is expected.
const KEY: u8 = 0xFF;
/// Time until a device answers.
const ANSWER_TIME: Duration = Duration::from_millis(1);

/// One device.
pub(crate) struct Device {
    pub number: u8,
    pub session: u16,
    pub serial: &'static str,
    pub in_bootloader: bool,
    /// Knows this project's own commands.
    pub is_ours: bool,
    pub hardware: Hardware,
    pub rollback: u32,
    pub key_installed: bool,
    /// Version of the committed image.
    pub version: u16,
    pub fallback: u16,
    pub pages: BTreeMap<u8, Page>,
    /// The new application does not start.
    pub is_broken: bool,
    /// Duty cycle that it reports.
    pub duty: i16,
    /// Codes that the next pages are answered with instead of being stored.
    pub refusals: VecDeque<CommandCode>,
    /// The answers to the next pages come this late.
    pub delays: VecDeque<Duration>,
    /// Every page that was stored, in order.
    pub written: Vec<u8>,
    /// Restarts into the bootloader.
    pub entered: usize,
    /// Pages that arrived and fallbacks that were put back.
    pub changes: usize,
    /// The order to install a key.
    pub order: Vec<u8>,
    /// Its bootloader takes keys.
    pub checks_signatures: bool,
    transfer: Option<(u8, Vec<u8>)>,
    expected: usize,
}

impl Device {
    pub(crate) fn new(number: u8, session: u16) -> Self {
        Self {
            number,
            session,
            serial: "UNKNOWN",
            in_bootloader: false,
            is_ours: true,
            hardware: Hardware::F405,
            rollback: 0,
            key_installed: false,
            version: 0x0117,
            fallback: NO_VERSION,
            pages: BTreeMap::new(),
            is_broken: false,
            duty: 0,
            refusals: VecDeque::new(),
            delays: VecDeque::new(),
            written: Vec::new(),
            entered: 0,
            changes: 0,
            order: Vec::new(),
            checks_signatures: true,
            transfer: None,
            expected: 0,
        }
    }

    fn versions(&self) -> FirmwareVersions {
        FirmwareVersions {
            image: if self.in_bootloader {
                ImageType::Bootloader
            } else {
                ImageType::Application
            },
            application: self.version,
            bootloader: 0x0109,
        }
    }

    fn header(&self) -> Option<Header> {
        let page = self.pages.get(&LAST_PAGE)?;
        Header::parse(&page[HEADER_OFFSET..]).ok()
    }

    fn stored(&self) -> u32 {
        self.pages.keys().fold(0, |bits, page| bits | 1 << page)
    }

    fn status(&self) -> BootStatus {
        BootStatus {
            reason: match (self.in_bootloader, self.version) {
                (false, _) => Reason::Application,
                (true, NO_VERSION) => Reason::UpdateIncomplete,
                (true, _) => Reason::Requested,
            },
            key_installed: self.key_installed,
            confirmed: !self.in_bootloader,
            has_fallback: true,
            application: self.version,
            fallback: self.fallback,
            rollback: self.rollback,
            stored: self.stored(),
            wanted: self.header().map_or(0, |header| header.pages),
            product: PRODUCT_DMC60C,
            hardware: self.hardware.id,
            room: self.hardware.pages,
            ..BootStatus::default()
        }
    }

    /// Restarts without the memory of a session.
    pub(crate) fn power_cycle(&mut self) {
        self.session = self.session.wrapping_add(0x1111);
        self.transfer = None;
        self.in_bootloader = self.version == NO_VERSION;
    }

    /// The answers to a frame with the time that each takes.
    pub(crate) fn on_frame(&mut self, frame: &Frame) -> Vec<(Duration, Frame)> {
        let identifier = frame.extended_id().unwrap();
        let base = frc_id::base(identifier);
        if base == id::ENUMERATE {
            let session = self.session;
            let first = EnumerateResponse0 {
                session,
                product_id: PRODUCT_DMC60C,
            };
            let second = EnumerateResponse1 {
                session,
                versions: self.versions(),
            };
            let number = self.number;
            return vec![
                (ANSWER_TIME, first.emit(number)),
                (ANSWER_TIME, second.emit(number)),
            ];
        }
        if frc_id::number(identifier) != self.number {
            return Vec::new();
        }
        match base {
            id::VENDOR_COMMAND => {
                let command = VendorCommand::parse(frame).unwrap();
                if command.session != self.session {
                    return Vec::new();
                }
                self.transfer = None;
                self.on_command(command)
            }
            id::VENDOR_DATA_OUT => self.on_data(frame.data()),
            _ => Vec::new(),
        }
    }

    fn code(&self, code: CommandCode) -> Vec<(Duration, Frame)> {
        vec![(ANSWER_TIME, self.sts(code, 0))]
    }

    fn sts(&self, code: CommandCode, byte_count: u16) -> Frame {
        let code = code as u16;
        VendorStatus { code, byte_count }.emit(self.number)
    }

    fn data(&self, bytes: &[u8]) -> Vec<(Duration, Frame)> {
        let identifier = frc_id::with_number(id::VENDOR_DATA_IN, self.number);
        let identifier = ExtendedId::new(identifier).unwrap();
        let mut frames = vec![(
            ANSWER_TIME,
            self.sts(CommandCode::NoError, bytes.len() as u16),
        )];
        for chunk in bytes.chunks(8) {
            frames.push((ANSWER_TIME, Frame::new(identifier, chunk).unwrap()));
        }
        frames
    }

    fn on_command(&mut self, command: VendorCommand) -> Vec<(Duration, Frame)> {
        let restart = Duration::from_millis(50);
        match Command::from_code(command.command).unwrap() {
            Command::GetFirmwareVersion => self.data(&self.versions().to_bytes()),
            Command::GetDescriptors => {
                let descriptors = Descriptors {
                    serial_number: self.serial.to_owned(),
                    ..Descriptors::default()
                };
                let text = descriptors.text(Descriptor::SerialNumber);
                let mut stream = vec![Descriptor::SerialNumber as u8, text.len() as u8];
                stream.extend(text.bytes());
                self.data(&stream)
            }
            Command::GetBootStatus if self.in_bootloader && self.is_ours => {
                self.data(&self.status().to_bytes())
            }
            Command::GetPageCrcs if self.in_bootloader && self.is_ours => {
                let mut bytes = Vec::new();
                for page in 0..PAGE_COUNT {
                    let crc = self.pages.get(&page).map_or(0, |page| page_transfer(page));
                    bytes.extend(crc.to_le_bytes());
                }
                self.data(&bytes)
            }
            Command::EnterBootloader => {
                self.entered += 1;
                self.in_bootloader = true;
                vec![(restart, self.sts(CommandCode::InBootloader, 0))]
            }
            Command::SoftReset => {
                self.in_bootloader = self.version == NO_VERSION || self.is_broken;
                if self.in_bootloader {
                    return Vec::new();
                }
                vec![(restart, self.sts(CommandCode::AcknowledgeReset, 0))]
            }
            Command::EraseWriteFlashPage if self.in_bootloader => {
                self.expected = PAGE_SIZE + 4;
                self.transfer = Some((command.param2 as u8, Vec::new()));
                Vec::new()
            }
            Command::InstallKey if self.in_bootloader && self.checks_signatures => {
                self.expected = usize::from(command.param1);
                self.transfer = Some((KEY, Vec::new()));
                Vec::new()
            }
            Command::RestoreFallback if self.in_bootloader && self.fallback != NO_VERSION => {
                self.changes += 1;
                self.version = self.fallback;
                vec![(Duration::from_secs(2), self.sts(CommandCode::NoError, 0))]
            }
            Command::RestoreFallback if self.in_bootloader => self.code(CommandCode::NoFallback),
            _ => self.code(CommandCode::NotSupported),
        }
    }

    fn on_data(&mut self, bytes: &[u8]) -> Vec<(Duration, Frame)> {
        let Some((page, data)) = &mut self.transfer else {
            return Vec::new();
        };
        data.extend(bytes);
        if data.len() > self.expected {
            self.transfer = None;
            return self.code(CommandCode::DataReceivedMore);
        }
        if data.len() < self.expected {
            return Vec::new();
        }
        let (page, data) = (*page, data.clone());
        self.transfer = None;
        if page == KEY {
            self.order = data;
            self.key_installed = true;
            return self.code(CommandCode::NoError);
        }
        self.changes += 1;
        let (contents, crc) = data.split_first_chunk::<PAGE_SIZE>().unwrap();
        let code = if crc == page_transfer(contents).to_le_bytes() {
            self.refusals
                .pop_front()
                .unwrap_or_else(|| self.store(page, contents))
        } else {
            CommandCode::CrcMismatch
        };
        let delay = self.delays.pop_front().unwrap_or(Duration::from_millis(20));
        vec![(delay, self.sts(code, 0))]
    }

    fn store(&mut self, page: u8, contents: &Page) -> CommandCode {
        if page == LAST_PAGE {
            self.pages.clear();
            self.version = NO_VERSION;
        }
        match self.pages.get(&page) {
            Some(present) if present == contents => {}
            Some(_) => return CommandCode::PageOrder,
            None => {
                self.pages.insert(page, *contents);
                self.written.push(page);
            }
        }
        let Some(header) = self.header().filter(|header| header.pages & 1 << page != 0) else {
            return CommandCode::PageOrder;
        };
        if header.pages & !self.stored() == 0 {
            self.version = header.identity.version;
        } else if page == 0 {
            return CommandCode::ImageIncomplete;
        }
        CommandCode::NoError
    }
}

/// What becomes of a frame that the host sends.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Fate {
    Delivered,
    Lost,
    Doubled,
    /// Lost, and every device restarts without its session.
    PowerCut,
    /// The connection of the host breaks.
    Broken,
}

/// Decides what becomes of the frame with this number.
pub(crate) type FateOf = Box<dyn FnMut(usize, &Frame) -> Fate>;

/// A bus with devices.
pub(crate) struct FakeBus {
    pub devices: Vec<Device>,
    /// Decides over every frame of the host, by its number from 0.
    pub fate: FateOf,
    /// Each device answers one thing after the other, and falls behind if that takes long.
    pub in_order: bool,
    /// When the devices have answered everything.
    idle: Duration,
    sent: usize,
    now: Duration,
    inbox: VecDeque<(Duration, Frame)>,
    next_status: Duration,
}

impl FakeBus {
    pub(crate) fn new(devices: Vec<Device>) -> Self {
        Self {
            devices,
            fate: Box::new(|_, _| Fate::Delivered),
            in_order: false,
            idle: Duration::ZERO,
            sent: 0,
            now: Duration::ZERO,
            inbox: VecDeque::new(),
            next_status: Duration::ZERO,
        }
    }

    fn deliver(&mut self, frame: &Frame) {
        for device in &mut self.devices {
            let mut at = self.now;
            if self.in_order {
                at = at.max(self.idle);
            }
            for (delay, answer) in device.on_frame(frame) {
                at += delay;
                self.inbox.push_back((at, answer));
                self.idle = self.idle.max(at);
            }
        }
        self.inbox.make_contiguous().sort_by_key(|(at, _)| *at);
    }

    /// Driven devices report every 10 ms.
    fn report(&mut self) {
        while self.next_status <= self.now {
            for device in self.devices.iter().filter(|device| !device.in_bootloader) {
                let mut data = [0; 8];
                data[..2].copy_from_slice(&device.duty.to_le_bytes());
                let identifier = frc_id::with_number(STATUS_GENERAL, device.number);
                let status = Frame::extended(identifier, data);
                if device.duty != 0 {
                    self.inbox.push_front((self.next_status, status));
                }
            }
            self.next_status += Duration::from_millis(10);
        }
    }
}

impl Bus for FakeBus {
    fn send(&mut self, frame: &Frame) -> Result<(), BusError> {
        let number = self.sent;
        self.sent += 1;
        self.now += FRAME_TIME;
        match (self.fate)(number, frame) {
            Fate::Delivered => self.deliver(frame),
            Fate::Lost => {}
            Fate::Doubled => {
                self.deliver(frame);
                self.deliver(frame);
            }
            Fate::PowerCut => self.devices.iter_mut().for_each(Device::power_cycle),
            Fate::Broken => {
                return Err(BusError::Lost {
                    what: "the test's bus".to_owned(),
                    source: std::io::ErrorKind::UnexpectedEof.into(),
                });
            }
        }
        Ok(())
    }

    fn receive(&mut self, timeout: Duration) -> Result<Option<Received>, BusError> {
        let deadline = self.now + timeout;
        self.report();
        let due = self.inbox.front().map(|(at, _)| *at);
        match due {
            Some(at) if at <= deadline => {
                self.now = self.now.max(at);
                let frame = self.inbox.pop_front().map(|(_, frame)| frame);
                Ok(frame.map(|frame| Received { frame, at }))
            }
            _ => {
                // In steps, so that a driven device can report.
                self.now = deadline.min(self.now + Duration::from_millis(10));
                Ok(None)
            }
        }
    }

    fn now(&self) -> Duration {
        self.now
    }
}
