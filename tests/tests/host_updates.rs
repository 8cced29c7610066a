//! `windlass::flash` against the real bootloader on a model of each chip's flash: the host's side and the
//! controller's side of an update together. The application is played by the test.

use std::collections::VecDeque;
use std::time::Duration;

use windlass::client::{Address, Client, Descriptors, Device, Version};
use windlass::flash::{FlashError, Observer, Options, Phase, Report, flash, roll_back};
use windlass::image::{Format, Image, parse};
use windlass::transport::{Bus, BusError, Received};
use windlass_core::boot::image::{Hardware, INFO_OFFSET, Identity, InfoBlock, PAGE_SIZE};
use windlass_core::frame::Frame;
use windlass_core::frc_id::{self, with_number};
use windlass_core::management::vendor::{Command, CommandCode, Descriptor};
use windlass_core::management::wire::{
    EnumerateResponse0, EnumerateResponse1, FirmwareVersions, ImageType, VendorCommand,
    VendorStatus, id,
};
use windlass_core::node::{PRODUCT_DMC60C, TxOutcome};
use windlass_core::time::Instant;
use windlass_tests::boot_bench::{Bench, Running, SESSION, f405, g431, g474};

/// Time of one frame on the bus.
const FRAME_TIME: Duration = Duration::from_micros(140);

/// A bus with one controller.
struct LoaderBus<const W: usize, const S: usize, const J: usize> {
    bench: Bench<W, S, J>,
    /// The application's session.
    session: u16,
    now: Duration,
    inbox: VecDeque<Frame>,
    sent: usize,
    /// Before this frame of the host, counted from 0, the power fails and comes back.
    cut_at: Option<usize>,
    /// Frames that carried data.
    data_frames: usize,
}

impl<const W: usize, const S: usize, const J: usize> LoaderBus<W, S, J> {
    fn new(bench: Bench<W, S, J>) -> Self {
        Self {
            bench,
            session: SESSION,
            now: Duration::ZERO,
            inbox: VecDeque::new(),
            sent: 0,
            cut_at: None,
            data_frames: 0,
        }
    }

    fn is_application(&self) -> bool {
        matches!(self.bench.running, Some(Running::Application(_)))
    }

    /// The loader's frames, those that wait for their delay included.
    fn collect(&mut self) {
        self.inbox.extend(self.bench.take_sent());
        let later = Instant::from_micros(10_000_000);
        if let Some(Running::Loader(loader, _)) = &mut self.bench.running {
            while let Some(transmission) = loader.poll_tx(later) {
                self.inbox.push_back(transmission.frame);
                loader.on_transmitted(later, transmission.tag, TxOutcome::Sent);
            }
        }
    }

    fn feed_loader(&mut self, frame: &Frame) {
        let before = match &self.bench.running {
            Some(Running::Loader(loader, _)) => loader.session(),
            _ => None,
        };
        self.bench.feed(frame);
        self.collect();
        if self.is_application() {
            // The application starts with the loader's session and acknowledges the restart.
            self.session = before.unwrap_or(SESSION);
            self.status(CommandCode::AcknowledgeReset, 0);
        }
    }

    fn status(&mut self, code: CommandCode, byte_count: u16) {
        let code = code as u16;
        self.inbox
            .push_back(VendorStatus { code, byte_count }.emit(0));
    }

    fn data(&mut self, bytes: &[u8]) {
        self.status(CommandCode::NoError, bytes.len() as u16);
        let identifier = with_number(id::VENDOR_DATA_IN, 0);
        for chunk in bytes.chunks(8) {
            let mut data = [0; 8];
            data[..chunk.len()].copy_from_slice(chunk);
            let frame = Frame::extended(identifier, data).shortened(chunk.len());
            self.inbox.push_back(frame);
        }
    }

    /// What an application does with the frame, as far as an update needs it.
    fn feed_application(&mut self, frame: &Frame) {
        let versions = FirmwareVersions {
            image: ImageType::Application,
            application: self.bench.version().unwrap_or(0),
            bootloader: 0x0109,
        };
        let session = self.session;
        let base = frc_id::base(frame.extended_id().unwrap_or(0));
        if base == id::ENUMERATE {
            let product_id = PRODUCT_DMC60C;
            let first = EnumerateResponse0 {
                session,
                product_id,
            };
            self.inbox.push_back(first.emit(0));
            self.inbox
                .push_back(EnumerateResponse1 { session, versions }.emit(0));
        }
        let Some(command) = VendorCommand::parse(frame) else {
            return;
        };
        if base != id::VENDOR_COMMAND || command.session != session {
            return;
        }
        match Command::from_code(command.command) {
            Some(Command::GetFirmwareVersion) => {
                self.data(&versions.to_bytes());
                self.bench.application_answers();
            }
            Some(Command::GetDescriptors) => {
                let strings = Descriptors::default();
                let text = strings.text(Descriptor::SerialNumber);
                self.data(&[Descriptor::SerialNumber as u8, text.len() as u8]);
            }
            Some(Command::EnterBootloader) => {
                self.bench.restart(true);
                self.collect();
            }
            _ => self.status(CommandCode::NotSupported, 0),
        }
    }
}

impl<const W: usize, const S: usize, const J: usize> Bus for LoaderBus<W, S, J> {
    fn send(&mut self, frame: &Frame) -> Result<(), BusError> {
        self.now += FRAME_TIME;
        if self.cut_at == Some(self.sent) {
            self.bench.power_cycle();
            self.session = self.session.wrapping_add(1);
        }
        self.sent += 1;
        let base = frc_id::base(frame.extended_id().unwrap_or(0));
        self.data_frames += usize::from(base == id::VENDOR_DATA_OUT);
        if self.is_application() {
            self.feed_application(frame);
        } else {
            self.feed_loader(frame);
        }
        Ok(())
    }

    fn receive(&mut self, timeout: Duration) -> Result<Option<Received>, BusError> {
        let Some(frame) = self.inbox.pop_front() else {
            self.now += timeout;
            return Ok(None);
        };
        self.now += FRAME_TIME;
        let at = self.now;
        Ok(Some(Received { frame, at }))
    }

    fn now(&self) -> Duration {
        self.now
    }
}

/// Cancels after so many pages.
#[derive(Default)]
struct Watch {
    pages: usize,
    cancel_at: Option<usize>,
}

impl Observer for Watch {
    fn phase(&mut self, _phase: Phase) {}
    fn pages(&mut self, _stored: usize, _of: usize, _now: Duration) {
        self.pages += 1;
    }
    fn lost(&mut self, _reason: &str) {}
    fn found(&mut self, _address: Address) {}
    fn is_cancelled(&self) -> bool {
        self.cancel_at == Some(self.pages)
    }
}

fn image(hardware: &Hardware, version: u16, pages: usize) -> Image {
    let identity = Identity {
        product: PRODUCT_DMC60C,
        hardware: hardware.id,
        version,
        rollback: 0,
    };
    let mut bytes: Vec<u8> = (0..pages * PAGE_SIZE)
        .map(|at| (at / 5) as u8 ^ (at >> 12) as u8 ^ version as u8)
        .collect();
    let info = InfoBlock { identity }.to_bytes();
    bytes[INFO_OFFSET..INFO_OFFSET + info.len()].copy_from_slice(&info);
    Image::packed(parse(Format::Bin, &bytes).unwrap()).unwrap()
}

type Host<const W: usize, const S: usize, const J: usize> = Client<LoaderBus<W, S, J>>;

fn only<const W: usize, const S: usize, const J: usize>(host: &mut Host<W, S, J>) -> Device {
    let devices = host.scan().unwrap();
    assert_eq!(devices.len(), 1);
    devices[0]
}

fn update<const W: usize, const S: usize, const J: usize>(
    host: &mut Host<W, S, J>,
    image: &Image,
    watch: &mut Watch,
) -> Result<Report, FlashError> {
    let device = only(host);
    flash(host, &device, image, &Options::default(), watch)
}

/// The whole life of a controller: erased, flashed, upgraded, the same again, interrupted after every page,
/// cut from its power in the middle of an update, rolled back.
fn life<const W: usize, const S: usize, const J: usize>(bench: Bench<W, S, J>) {
    let hardware = bench.hardware;
    let mut host = Client::new(LoaderBus::new(bench));
    let first = image(&hardware, 0x0117, 3);
    let report = update(&mut host, &first, &mut Watch::default()).unwrap();
    assert_eq!((report.before, report.version), (None, Version(0x0117)));
    assert_eq!(report.sent, 4);

    // Settled: confirmed by the version that was read, copied by the next boot.
    host.bus().bench.power_cycle();
    let second = image(&hardware, 0x0118, 5);
    let report = update(&mut host, &second, &mut Watch::default()).unwrap();
    assert_eq!(report.before, Some(Version(0x0117)));
    let sent = host.bus().data_frames;
    let report = update(&mut host, &second, &mut Watch::default()).unwrap();
    assert_eq!((report.sent, report.version), (0, Version(0x0118)));
    assert_eq!(host.bus().data_frames, sent);

    let third = image(&hardware, 0x0119, 6);
    for pages in 1..=6 {
        let mut watch = Watch {
            cancel_at: Some(1),
            ..Watch::default()
        };
        let error = update(&mut host, &third, &mut watch).unwrap_err();
        let FlashError::Cancelled { stored, of, .. } = error else {
            panic!("{error}");
        };
        assert_eq!((stored, of), (pages, 7), "{}", hardware.name);
        host.bus().bench.power_cycle();
        assert_eq!(host.bus().bench.version(), None);
    }
    let report = update(&mut host, &third, &mut Watch::default()).unwrap();
    assert_eq!((report.sent, report.version), (1, Version(0x0119)));

    let other = if hardware == Hardware::F405 {
        Hardware::G474
    } else {
        Hardware::F405
    };
    let error = update(&mut host, &image(&other, 0x0120, 2), &mut Watch::default()).unwrap_err();
    assert!(matches!(error, FlashError::WrongHardware { .. }), "{error}");
    assert_eq!(host.bus().bench.version(), Some(0x0119));

    host.bus().bench.power_cycle();
    let fourth = image(&hardware, 0x0121, 4);
    update(&mut host, &fourth, &mut Watch::default()).unwrap();
    let device = only(&mut host);
    let options = Options::default();
    let rolled_back = roll_back(&mut host, &device, &options, &mut Watch::default());
    if hardware == Hardware::G431 {
        assert!(
            matches!(rolled_back, Err(FlashError::NoFallback(_))),
            "{rolled_back:?}"
        );
        assert_eq!(host.bus().bench.version(), Some(0x0121));
    } else {
        assert_eq!(rolled_back.unwrap().version, Version(0x0119));
        assert_eq!(host.bus().bench.version(), Some(0x0119));
    }
    assert_eq!(host.bus().bench.chip.misuses(), 0);
}

#[test]
fn a_controller_is_updated_through_its_whole_life() {
    life(f405(11));
    life(g474(12));
    life(g431(13));
}

/// The power fails in the middle of an update, at one of many frames; the same call goes on by itself.
fn cuts<const W: usize, const S: usize, const J: usize>(make: impl Fn(u64) -> Bench<W, S, J>) {
    let mut frames = 0;
    for step in 0..60 {
        let bench = make(100 + step);
        let hardware = bench.hardware;
        let mut host = Client::new(LoaderBus::new(bench));
        update(
            &mut host,
            &image(&hardware, 0x0117, 2),
            &mut Watch::default(),
        )
        .unwrap();
        // The bench's restarts into the bootloader have this session.
        host.bus().bench.power_cycle();
        host.bus().session = SESSION;
        let begin = host.bus().sent;
        // A prime, so that the cuts fall on commands, data and questions alike.
        host.bus().cut_at = Some(begin + 10 + step as usize * 43);
        let new = image(&hardware, 0x0118, 4);
        let report = update(&mut host, &new, &mut Watch::default()).unwrap();
        assert_eq!(report.version, Version(0x0118), "{} {step}", hardware.name);
        assert_eq!(host.bus().bench.version(), Some(0x0118));
        frames = host.bus().sent - begin;
    }
    assert!(frames > 5 * 513, "{frames}");
}

#[test]
fn an_update_whose_device_loses_its_power_goes_on_by_itself() {
    cuts(f405);
    cuts(g474);
}
