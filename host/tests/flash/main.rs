//! Updates of devices that lose frames, power and patience, in virtual time.

#[path = "../fake/mod.rs"]
mod fake;
mod interrupted;

use std::time::Duration;

use fake::{Device, FakeBus, Fate};
use windlass::client::{Address, Client, Error, Selector, Version};
use windlass::flash::{FlashError, Observer, Options, Phase, Report, flash, roll_back};
use windlass::image::{Format, Image, parse};
use windlass_core::boot::image::{
    Hardware, INFO_OFFSET, Identity, InfoBlock, LAST_PAGE, NO_VERSION, PAGE_SIZE,
};
use windlass_core::boot::status::Reason;
use windlass_core::frame::Frame;
use windlass_core::frc_id;
use windlass_core::management::vendor::{Command, CommandCode};
use windlass_core::management::wire::{VendorCommand, id};
use windlass_core::node::PRODUCT_DMC60C;

const NEW: u16 = 0x0119;

const IDENTITY: Identity = Identity {
    product: PRODUCT_DMC60C,
    hardware: Hardware::F405.id,
    version: NEW,
    rollback: 3,
};

fn image_of(identity: Identity, fill: u8) -> Image {
    let mut bytes: Vec<u8> = (0..6 * PAGE_SIZE)
        .map(|at| (at / 3) as u8 ^ (at >> 12) as u8 ^ fill)
        .collect();
    let info = InfoBlock { identity }.to_bytes();
    bytes[INFO_OFFSET..INFO_OFFSET + info.len()].copy_from_slice(&info);
    Image::packed(parse(Format::Bin, &bytes).unwrap()).unwrap()
}

fn image() -> Image {
    image_of(IDENTITY, 0)
}

/// Notes everything and cancels when told.
#[derive(Default)]
struct Watch {
    phases: Vec<Phase>,
    stored: Vec<usize>,
    lost: usize,
    found: Option<Address>,
    cancel_at: Option<usize>,
}

impl Observer for Watch {
    fn phase(&mut self, phase: Phase) {
        if self.phases.last() != Some(&phase) {
            self.phases.push(phase);
        }
    }

    fn pages(&mut self, stored: usize, _of: usize, _now: Duration) {
        self.stored.push(stored);
    }

    fn lost(&mut self, _reason: &str) {
        self.lost += 1;
    }

    fn found(&mut self, address: Address) {
        self.found = Some(address);
    }

    fn is_cancelled(&self) -> bool {
        self.cancel_at.is_some_and(|at| self.stored.len() >= at)
    }
}

struct Bench {
    client: Client<FakeBus>,
    watch: Watch,
    options: Options,
}

impl Bench {
    fn new(device: Device) -> Self {
        Self::with(vec![device])
    }

    fn with(devices: Vec<Device>) -> Self {
        Self {
            client: Client::new(FakeBus::new(devices)),
            watch: Watch::default(),
            options: Options::default(),
        }
    }

    fn device(&mut self) -> &mut Device {
        &mut self.client.bus().devices[0]
    }

    fn on_frame(&mut self, fate: impl FnMut(usize, &Frame) -> Fate + 'static) {
        self.client.bus().fate = Box::new(fate);
    }

    fn flash(&mut self, image: &Image) -> Result<Report, FlashError> {
        let (number, session) = (self.device().number, self.device().session);
        let selector = Selector {
            dialect: None,
            number: Some(number),
            session: Some(session),
        };
        let device = self.client.find(&selector)?;
        flash(
            &mut self.client,
            &device,
            image,
            &self.options,
            &mut self.watch,
        )
    }

    fn roll_back(&mut self) -> Result<Report, FlashError> {
        let (number, session) = (self.device().number, self.device().session);
        let selector = Selector {
            dialect: None,
            number: Some(number),
            session: Some(session),
        };
        let device = self.client.find(&selector)?;
        roll_back(&mut self.client, &device, &self.options, &mut self.watch)
    }

    fn has(&mut self, image: &Image) -> bool {
        let device = self.device();
        !device.in_bootloader
            && device.version == image.header().identity.version
            && image
                .pages()
                .iter()
                .eq(device.pages.iter().map(|(number, page)| (*number, page)))
    }
}

fn is_data(frame: &Frame) -> bool {
    let identifier = frame.extended_id().unwrap();
    frc_id::base(identifier) == id::VENDOR_DATA_OUT
}

/// The page that a frame announces.
fn page_command(frame: &Frame) -> Option<u8> {
    let identifier = frame.extended_id()?;
    let command = VendorCommand::parse(frame)?;
    let is_page = frc_id::base(identifier) == id::VENDOR_COMMAND
        && command.command == Command::EraseWriteFlashPage.code();
    is_page.then_some(command.param2 as u8)
}

#[test]
fn an_update_ends_with_the_new_version_running() {
    let mut bench = Bench::new(Device::new(5, 0x1234));
    let report = bench.flash(&image()).unwrap();
    assert_eq!(
        (report.before, report.version),
        (Some(Version(0x0117)), Version(NEW))
    );
    assert_eq!((report.sent, report.pages, report.confirmed), (7, 7, None));
    assert!(bench.has(&image()));
    assert_eq!(bench.device().written, [30, 5, 4, 3, 2, 1, 0]);
    use Phase::{Confirm, Enter, Erase, Restart, Verify, Write};
    assert_eq!(
        bench.watch.phases,
        [Enter, Erase, Write, Verify, Restart, Confirm]
    );
    assert_eq!(bench.watch.stored, [1, 2, 3, 4, 5, 6, 7]);
}

#[test]
fn a_device_without_application_and_without_number_is_updated_too() {
    let mut device = Device::new(0, 0x1234);
    device.version = NO_VERSION;
    device.in_bootloader = true;
    let mut bench = Bench::new(device);
    let report = bench.flash(&image()).unwrap();
    assert_eq!(report.before, None);
    assert!(bench.has(&image()));
}

#[test]
fn the_device_with_the_session_is_updated_among_those_with_its_number() {
    let mut bench = Bench::with(vec![Device::new(5, 0x1234), Device::new(5, 0x4321)]);
    bench.flash(&image()).unwrap();
    assert!(bench.has(&image()));
    assert_eq!(bench.client.bus().devices[1].changes, 0);
}

#[test]
fn pages_that_the_device_has_are_not_sent_again() {
    let mut bench = Bench::new(Device::new(5, 0x1234));
    bench.flash(&image()).unwrap();
    let report = bench.flash(&image()).unwrap();
    assert_eq!((report.sent, report.version), (0, Version(NEW)));
    assert_eq!(bench.device().written.len(), 7);
    bench.options.force = true;
    let report = bench.flash(&image()).unwrap();
    assert_eq!(report.sent, 7);
    assert!(bench.has(&image()));
}

#[test]
fn what_only_the_device_can_refuse_is_reported_by_its_name() {
    for (code, name) in [
        (CommandCode::WrongProduct, "cercWrongProduct"),
        (CommandCode::WrongHardware, "cercWrongHardware"),
        (CommandCode::BadSignature, "cercBadSignature"),
        (CommandCode::RollbackRefused, "cercRollbackRefused"),
        (CommandCode::ImageCrc, "cercImageCrc"),
    ] {
        let mut bench = Bench::new(Device::new(5, 0x1234));
        bench.device().refusals.push_back(code);
        let error = bench.flash(&image()).unwrap_err();
        assert!(error.to_string().contains(name), "{error}");
        assert!(!error.next_step().is_empty());
    }
}

#[test]
fn an_image_for_something_else_is_refused_before_a_page_is_sent() {
    let refused = |identity: Identity, change: fn(&mut Device)| {
        let mut bench = Bench::new(Device::new(5, 0x1234));
        change(bench.device());
        let error = bench.flash(&image_of(identity, 0)).unwrap_err();
        assert_eq!(bench.device().changes, 0, "{error}");
        // Whatever it told only in its bootloader, its application runs again.
        assert!(!bench.device().in_bootloader, "{error}");
        assert!(error.to_string().contains("nothing was changed"), "{error}");
        error
    };
    let product = Identity {
        product: 0x6020_0203,
        ..IDENTITY
    };
    let error = refused(product, |_| ());
    assert!(matches!(error, FlashError::WrongProduct { .. }), "{error}");
    // Known from the enumeration alone.
    let error = refused(product, |device| device.is_ours = false);
    assert!(matches!(error, FlashError::WrongProduct { .. }), "{error}");
    let error = refused(
        Identity {
            hardware: Hardware::G474.id,
            ..IDENTITY
        },
        |_| (),
    );
    assert!(matches!(error, FlashError::WrongHardware { .. }), "{error}");
    let error = refused(IDENTITY, |device| device.rollback = 4);
    assert!(
        matches!(error, FlashError::RollbackRefused { .. }),
        "{error}"
    );
    let error = refused(IDENTITY, |device| device.key_installed = true);
    assert!(matches!(error, FlashError::Unsigned(_)), "{error}");
    let error = refused(IDENTITY, |device| device.duty = 3000);
    assert!(matches!(error, FlashError::Driving(_)), "{error}");
}

#[test]
fn a_device_that_does_not_tell_its_hardware_is_updated_only_by_force() {
    let mut device = Device::new(5, 0x1234);
    device.is_ours = false;
    let mut bench = Bench::new(device);
    let error = bench.flash(&image()).unwrap_err();
    assert!(matches!(error, FlashError::UnknownHardware(_)), "{error}");
    assert!(bench.device().written.is_empty());
    assert!(!bench.device().in_bootloader);
    bench.options.force = true;
    let report = bench.flash(&image()).unwrap();
    assert_eq!((report.sent, report.confirmed), (7, None));
    assert!(bench.has(&image()));
}

#[test]
fn a_driven_motor_or_a_foreign_product_does_not_even_enter_the_bootloader() {
    let mut bench = Bench::new(Device::new(5, 0x1234));
    bench.device().duty = -3000;
    bench.flash(&image()).unwrap_err();
    bench.device().duty = 0;
    bench.client.listen(Duration::from_secs(1)).unwrap();
    let foreign = Identity {
        product: 1,
        ..IDENTITY
    };
    bench.flash(&image_of(foreign, 0)).unwrap_err();
    assert_eq!(bench.device().entered, 0);
}

#[test]
fn a_refused_first_page_leaves_the_old_application_running() {
    let mut bench = Bench::new(Device::new(5, 0x1234));
    bench.device().refusals.push_back(CommandCode::BadSignature);
    bench.flash(&image()).unwrap_err();
    assert!(!bench.device().in_bootloader);
    assert_eq!(bench.device().version, 0x0117);
}

#[test]
fn a_key_is_installed_and_signs_its_successor() {
    use ed25519_dalek::{Signature, SigningKey};
    use windlass::image::key::install_order;
    use windlass_core::boot::trust::key_message;
    let old = SigningKey::from_bytes(&[1; 32]);
    let new = SigningKey::from_bytes(&[2; 32]).verifying_key();
    let mut bench = Bench::new(Device::new(5, 0x1234));
    let device = bench.client.find(&"5".parse().unwrap()).unwrap();
    let order = install_order(&old.verifying_key(), None);
    windlass::flash::install_key(&mut bench.client, &device, &order, &mut bench.watch).unwrap();
    assert_eq!(bench.device().order, old.verifying_key().as_bytes());
    assert!(!bench.device().in_bootloader);
    let order = install_order(&new, Some(&old));
    windlass::flash::install_key(&mut bench.client, &device, &order, &mut bench.watch).unwrap();
    let sent = bench.device().order.clone();
    let (key, signature) = sent.split_first_chunk::<32>().unwrap();
    assert_eq!(key, new.as_bytes());
    let signature = Signature::from_slice(signature).unwrap();
    let message = key_message(key);
    assert!(
        old.verifying_key()
            .verify_strict(&message, &signature)
            .is_ok()
    );
}

#[test]
fn a_bootloader_that_takes_no_keys_is_told_from_one_that_refuses_this_one() {
    let mut bench = Bench::new(Device::new(5, 0x1234));
    bench.device().checks_signatures = false;
    let device = bench.client.find(&"5".parse().unwrap()).unwrap();
    let error =
        windlass::flash::install_key(&mut bench.client, &device, &[1; 32], &mut bench.watch)
            .unwrap_err();
    assert!(matches!(error, FlashError::NoSignatures(_)), "{error}");
    assert!(error.next_step().contains("--signed"));
    assert!(!bench.device().in_bootloader);
}

#[test]
fn success_is_not_told_unless_the_new_version_answers() {
    let mut bench = Bench::new(Device::new(5, 0x1234));
    bench.device().is_broken = true;
    let error = bench.flash(&image()).unwrap_err();
    let FlashError::NotStarted { reason, .. } = error else {
        panic!("{error}");
    };
    assert_eq!(reason, Some(Reason::Requested));
}

#[test]
fn the_acknowledgement_of_a_restart_may_be_lost() {
    for command in [Command::EnterBootloader, Command::SoftReset] {
        let mut bench = Bench::new(Device::new(5, 0x1234));
        let mut lost = false;
        bench.on_frame(move |_, frame| {
            let asked = VendorCommand::parse(frame).map(|frame| frame.command);
            if asked == Some(command.code()) && !lost {
                lost = true;
                return Fate::Lost;
            }
            Fate::Delivered
        });
        bench.flash(&image()).unwrap();
        assert!(bench.has(&image()), "{command:?}");
    }
}

#[test]
fn the_fallback_is_put_back() {
    let mut bench = Bench::new(Device::new(5, 0x1234));
    let error = bench.roll_back().unwrap_err();
    assert!(matches!(error, FlashError::NoFallback(_)), "{error}");
    assert_eq!(bench.device().changes, 0);
    assert!(!bench.device().in_bootloader);
    bench.watch = Watch::default();
    bench.device().fallback = 0x0105;
    let report = bench.roll_back().unwrap();
    assert_eq!(report.version, Version(0x0105));
    assert_eq!(
        bench.watch.phases,
        [Phase::Enter, Phase::Restore, Phase::Restart, Phase::Confirm]
    );
    assert_eq!(bench.device().version, 0x0105);
    assert!(!bench.device().in_bootloader);
}
