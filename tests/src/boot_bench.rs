//! The bootloader on a flash model, without bus and plant: images, a host that sends frames straight to
//! the loader, and power cuts.

use std::collections::BTreeMap;

use windlass_core::boot::image::{
    HEADER_OFFSET, Hardware, Header, INFO_LENGTH, INFO_OFFSET, Identity, InfoBlock, LAST_PAGE,
    PAGE_SIZE, Page, ReadPages, pack, pages_of,
};
use windlass_core::boot::loader::{Loader, LoaderConfig, Memory, start};
use windlass_core::boot::slots::{Slot, Slots, Start};
use windlass_core::boot::status::{BootStatus, Reason};
use windlass_core::crc::page_transfer;
use windlass_core::frame::Frame;
use windlass_core::frc_id::with_number;
use windlass_core::management::vendor::{Command, CommandCode};
use windlass_core::management::wire::{VendorCommand, VendorStatus, id};
use windlass_core::node::{Handover, PRODUCT_DMC60C};
use windlass_core::params::Stored;
use windlass_core::params::journal::Journal;
use windlass_core::reset::{Crashes, ResetCause};
use windlass_core::time::Instant;
use windlass_sim::nor::{Geometry, NorChip, Partition, Region, STM32F405, STM32G431, STM32G474};

/// Session that survives the restarts of these tests.
pub const SESSION: u16 = 0x5AA5;

/// A whole image in memory.
#[derive(Clone, Debug)]
pub struct Image {
    /// Its header.
    pub header: Header,
    /// Its pages.
    pub pages: BTreeMap<u8, Box<Page>>,
}

impl Image {
    /// An image of these pages (0 and the last one always) with little in them, so that programming them
    /// takes few operations.
    ///
    /// # Panics
    /// If the pages do not fit the hardware.
    #[must_use]
    pub fn small(hardware: &Hardware, version: u16, pages: &[u8]) -> Self {
        Self::with(hardware, version, pages, |page, at| {
            if at < 160 {
                (version as u8).wrapping_mul(31) ^ page ^ (at as u8).wrapping_mul(5)
            } else {
                0xFF
            }
        })
    }

    /// An image whose bytes `fill` gives by page and offset, apart from information block and header.
    ///
    /// # Panics
    /// If the pages do not fit the hardware.
    #[must_use]
    pub fn with(
        hardware: &Hardware,
        version: u16,
        pages: &[u8],
        fill: impl Fn(u8, usize) -> u8,
    ) -> Self {
        let identity = Identity {
            product: PRODUCT_DMC60C,
            hardware: hardware.id,
            version,
            rollback: 0,
        };
        let filled = |page: u8| -> Box<Page> {
            let bytes: Vec<u8> = (0..PAGE_SIZE).map(|at| fill(page, at)).collect();
            bytes.try_into().expect("as long as a page")
        };
        let mut image: BTreeMap<u8, Box<Page>> =
            pages.iter().map(|page| (*page, filled(*page))).collect();
        image.entry(0).or_insert_with(|| filled(0))[INFO_OFFSET..][..INFO_LENGTH]
            .copy_from_slice(&InfoBlock { identity }.to_bytes());
        let mut last = filled(LAST_PAGE);
        last[HEADER_OFFSET..].fill(0xFF);
        image.remove(&LAST_PAGE);
        let header = pack(|page| image.get(&page).map(|page| &**page), &mut last)
            .expect("the test's image can be packed");
        image.insert(LAST_PAGE, last);
        Self {
            header,
            pages: image,
        }
    }

    /// The pages in the order in which a host sends them: the last one first, page 0 at the end.
    #[must_use]
    pub fn order(&self) -> Vec<u8> {
        self.pages.keys().rev().copied().collect()
    }
}

/// What runs after a start.
#[derive(Debug)]
pub enum Running {
    /// The application with this header.
    Application(Header),
    /// The bootloader.
    Loader(Box<Loader>, Reason),
}

/// One controller's flash and what runs from it. `W`, `S` and `J` are the sizes of the program unit and of
/// the erase units of slots and journal.
#[derive(Debug)]
pub struct Bench<const W: usize, const S: usize, const J: usize> {
    /// The flash.
    pub chip: NorChip,
    /// What it is.
    pub hardware: Hardware,
    slots: Slots<Partition<W, S>, Partition<W, S>>,
    settings: Partition<W, J>,
    journal: Journal,
    /// What runs; nothing without power.
    pub running: Option<Running>,
    handover: Option<Handover>,
    /// Failures in a row, in RAM that a reset leaves alone.
    crashes: Crashes,
    /// Frames that the loader has sent and nobody has read.
    sent: Vec<Frame>,
}

/// An STM32F405.
pub type F405 = Bench<4, 131_072, 16_384>;
/// An STM32G474 or STM32G431.
pub type G4 = Bench<8, 2_048, 2_048>;

/// An erased STM32F405.
#[must_use]
pub fn f405(seed: u64) -> F405 {
    Bench::new(&STM32F405, Hardware::F405, seed)
}

/// An erased STM32G474.
#[must_use]
pub fn g474(seed: u64) -> G4 {
    Bench::new(&STM32G474, Hardware::G474, seed)
}

/// An erased STM32G431.
#[must_use]
pub fn g431(seed: u64) -> G4 {
    Bench::new(&STM32G431, Hardware::G431, seed)
}

impl<const W: usize, const S: usize, const J: usize> Bench<W, S, J> {
    fn new(geometry: &'static Geometry, hardware: Hardware, seed: u64) -> Self {
        let chip = NorChip::new(geometry, seed);
        let slots = Slots {
            application: Slot::new(
                chip.partition(Region::Application)
                    .expect("every chip has an application slot"),
                &hardware,
            ),
            fallback: chip
                .partition(Region::Fallback)
                .map(|flash| Slot::new(flash, &hardware)),
        };
        let mut settings = chip
            .partition(Region::Journal)
            .expect("every chip has a journal");
        let journal = Journal::open(&mut settings);
        let mut bench = Self {
            chip,
            hardware,
            slots,
            settings,
            journal,
            running: None,
            handover: None,
            crashes: Crashes::NONE,
            sent: Vec::new(),
        };
        bench.reset(ResetCause::PowerOn);
        bench
    }

    /// The slots, as the bootloader and the application see them.
    pub fn slots(&mut self) -> &mut Slots<Partition<W, S>, Partition<W, S>> {
        &mut self.slots
    }

    /// The processor restarts.
    pub fn reset(&mut self, cause: ResetCause) {
        self.running = None;
        self.sent.clear();
        let handover = self.handover.take();
        self.journal = Journal::open(&mut self.settings);
        let mut memory = Memory {
            slots: &mut self.slots,
            journal: &mut self.journal,
            settings: &mut self.settings,
        };
        self.crashes = self.crashes.after(cause);
        let booted = start(
            &mut memory,
            &Start {
                cause,
                handover,
                crashes: self.crashes,
            },
        );
        let running = match booted.start {
            Ok(header) => Running::Application(header),
            Err(reason) => {
                let config = LoaderConfig {
                    product_id: PRODUCT_DMC60C,
                    hardware: self.hardware.id,
                    bootloader_version: 0x0109,
                    seed: 1,
                    handover,
                    reason,
                };
                Running::Loader(Box::new(Loader::new(&config, &mut memory)), reason)
            }
        };
        if self.chip.is_powered() {
            self.running = Some(running);
        }
        self.pump();
    }

    /// Power off and on.
    pub fn power_cycle(&mut self) {
        self.running = None;
        self.handover = None;
        self.chip.power_off();
        self.chip.power_on();
        self.reset(ResetCause::PowerOn);
    }

    /// Restarts with an order, as `vcmdEnterBootloader` and `vcmdSoftReset` do from the application.
    pub fn restart(&mut self, stay_in_bootloader: bool) {
        self.handover = Some(Handover {
            session: SESSION,
            stay_in_bootloader,
        });
        self.reset(ResetCause::Requested);
    }

    /// Makes sure that the bootloader runs, by the command if the application does; false without power.
    pub fn enter(&mut self) -> bool {
        if !matches!(self.running, Some(Running::Loader(..))) && self.chip.is_powered() {
            self.restart(true);
        }
        matches!(self.running, Some(Running::Loader(..)))
    }

    /// One frame to the loader.
    pub fn feed(&mut self, frame: &Frame) {
        let Some(Running::Loader(loader, _)) = &mut self.running else {
            return;
        };
        loader.on_frame(Instant::ZERO, frame);
        loader.work(&mut Memory {
            slots: &mut self.slots,
            journal: &mut self.journal,
            settings: &mut self.settings,
        });
        if !self.chip.is_powered() {
            self.running = None;
            self.sent.clear();
            return;
        }
        self.pump();
        if let Some(Running::Loader(loader, _)) = &mut self.running
            && let Some(handover) = loader.take_reset()
        {
            self.handover = Some(handover);
            self.reset(ResetCause::Requested);
        }
    }

    /// The loader's CAN controller becomes error passive or bus-off.
    pub fn lose_bus(&mut self) {
        if let Some(Running::Loader(loader, _)) = &mut self.running {
            loader.on_bus_lost();
            self.sent.clear();
        }
    }

    /// The command and the data frames that carry a page.
    #[must_use]
    pub fn page_frames(&mut self, page: u8, content: &Page) -> Vec<Frame> {
        let mut data = content.to_vec();
        data.extend_from_slice(&page_transfer(content).to_le_bytes());
        let mut frames = vec![self.command_frame(Command::EraseWriteFlashPage, 0, u16::from(page))];
        frames.extend(self.data_frames(&data));
        frames
    }

    fn pump(&mut self) {
        if let Some(Running::Loader(loader, _)) = &mut self.running {
            while let Some(transmission) = loader.poll_tx(Instant::ZERO) {
                self.sent.push(transmission.frame);
            }
        }
    }

    /// Frames that the loader has sent since the last call.
    pub fn take_sent(&mut self) -> Vec<Frame> {
        std::mem::take(&mut self.sent)
    }

    fn address(&self) -> (u8, u16) {
        match &self.running {
            Some(Running::Loader(loader, _)) => (loader.number(), loader.session().unwrap_or(0)),
            _ => (0, 0),
        }
    }

    /// A vendor command for the loader.
    #[must_use]
    pub fn command_frame(&mut self, command: Command, param1: u16, param2: u16) -> Frame {
        if self.address().1 == 0 {
            // Any frame shows the bus.
            self.feed(&Frame::standard(0, []));
        }
        let (number, session) = self.address();
        VendorCommand {
            session,
            command: command.code(),
            param1,
            param2,
        }
        .emit(number)
    }

    /// Sends a command with data and gives the status code and the data that come back; none if the loader
    /// is silent.
    pub fn transact(
        &mut self,
        command: Command,
        (param1, param2): (u16, u16),
        data: &[u8],
    ) -> Option<(CommandCode, Vec<u8>)> {
        let command = self.command_frame(command, param1, param2);
        self.sent.clear();
        self.feed(&command);
        for frame in self.data_frames(data) {
            self.feed(&frame);
        }
        self.answer()
    }

    /// The frames that carry data to the loader.
    #[must_use]
    pub fn data_frames(&self, data: &[u8]) -> Vec<Frame> {
        let base = with_number(id::VENDOR_DATA_OUT, self.address().0);
        data.chunks(8)
            .map(|chunk| {
                let mut bytes = [0; 8];
                bytes[..chunk.len()].copy_from_slice(chunk);
                Frame::extended(base, bytes).shortened(chunk.len())
            })
            .collect()
    }

    /// The first status that was sent, and the data after it.
    pub fn answer(&mut self) -> Option<(CommandCode, Vec<u8>)> {
        let sent = self.take_sent();
        let mut frames = sent.iter();
        let status = frames.find_map(|frame| {
            (frame.extended_id()? & !0x3F == id::VENDOR_STATUS)
                .then(|| VendorStatus::parse(frame))?
        })?;
        let data = frames.flat_map(|frame| frame.data().to_vec()).collect();
        Some((CommandCode::from_code(status.code as u8)?, data))
    }

    /// Sends one page; `damage` is added to its CRC.
    pub fn send_page(&mut self, page: u8, content: &Page, damage: u32) -> Option<CommandCode> {
        let mut data = content.to_vec();
        let crc = page_transfer(content).wrapping_add(damage);
        data.extend_from_slice(&crc.to_le_bytes());
        self.transact(Command::EraseWriteFlashPage, (0, u16::from(page)), &data)
            .map(|(code, _)| code)
    }

    /// Sends all pages of an image; the first result that is not `NoError`, or `NoError`.
    pub fn send_image(&mut self, image: &Image) -> Option<CommandCode> {
        for page in image.order() {
            match self.send_page(page, &image.pages[&page], 0) {
                Some(CommandCode::NoError) => {}
                other => return other,
            }
        }
        Some(CommandCode::NoError)
    }

    /// State of the slots by the command.
    pub fn status(&mut self) -> Option<BootStatus> {
        let (_, data) = self.transact(Command::GetBootStatus, (0, 0), &[])?;
        BootStatus::from_bytes(&data)
    }

    /// `vcmdSoftReset`.
    pub fn soft_reset(&mut self) {
        if let Some(Running::Application(_)) = self.running {
            self.restart(false);
        } else {
            let frame = self.command_frame(Command::SoftReset, 0, 0);
            self.feed(&frame);
        }
    }

    /// The running application has answered a host.
    pub fn application_answers(&mut self) {
        if let Some(Running::Application(_)) = self.running {
            self.crashes = Crashes::NONE;
            // Without power it fails, and that is what is tested.
            let _ = self.slots.application.confirm();
            if !self.chip.is_powered() {
                self.running = None;
            }
        }
    }

    /// The running application keeps its settings.
    pub fn application_saves(&mut self, stored: &Stored) {
        if let Some(Running::Application(_)) = self.running {
            let _ = self.journal.save(&mut self.settings, stored, true);
            if !self.chip.is_powered() {
                self.running = None;
            }
        }
    }

    /// The settings that a node would start with.
    pub fn settings(&mut self) -> Stored {
        Stored::load(&self.journal, &mut self.settings)
    }

    /// True if every page of the image is in the application slot, byte for byte.
    pub fn holds(&mut self, image: &Image) -> bool {
        let mut bytes = [0; PAGE_SIZE];
        pages_of(image.header.pages).all(|page| {
            self.slots.application.read(page, 0, &mut bytes).is_ok() && bytes == *image.pages[&page]
        })
    }

    /// Version of the application that runs.
    #[must_use]
    pub fn version(&self) -> Option<u16> {
        match &self.running {
            Some(Running::Application(header)) => Some(header.identity.version),
            _ => None,
        }
    }
}
