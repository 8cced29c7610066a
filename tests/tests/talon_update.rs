//! Talon SRX: `.crf` files and updates (manual 2.3). The numbers are the rows of docs/talon-srx-rows.md.

use std::time::Duration;

use windlass::client::talon::FaultBits;
use windlass::client::{Client, Device, Version};
use windlass::flash::{FlashError, Observer, Options, Phase, Report, Unobserved, flash};
use windlass::image::crf::CrfError;
use windlass::image::{FileError, Format, Image, parse};
use windlass::transport::{Bus, BusError, Received, SimBus};
use windlass_core::boot::image::{Hardware, INFO_OFFSET, Identity, InfoBlock, PAGE_SIZE};
use windlass_core::crc::iso_hdlc;
use windlass_core::dialect::talon_srx::wire::{Control1, General, ModeSelect, Parameter};
use windlass_core::frame::Frame;
use windlass_core::management::vendor::CommandCode;
use windlass_core::node::PRODUCT_DMC60C;
use windlass_sim::{ParticipantId, Poke, World, WorldConfig};
use windlass_tests::talon::TalonBench;

const IDENTITY: Identity = Identity {
    product: PRODUCT_DMC60C,
    hardware: Hardware::F405.id,
    version: 0x0203,
    rollback: 0,
};

/// An image with so many pages, its last one with the header.
fn image(identity: Identity, pages: usize) -> Image {
    let mut bytes: Vec<u8> = (0..(pages - 1) * PAGE_SIZE)
        .map(|at| (at as u32).wrapping_mul(0x9E37_79B1).to_be_bytes()[0] & 0x7F)
        .collect();
    let info = InfoBlock { identity }.to_bytes();
    bytes[INFO_OFFSET..INFO_OFFSET + info.len()].copy_from_slice(&info);
    Image::packed(parse(Format::Bin, &bytes).unwrap()).unwrap()
}

fn crf(identity: Identity, pages: usize) -> Vec<u8> {
    image(identity, pages).write(Format::Crf).unwrap()
}

fn open(file: &[u8]) -> Result<Image, FileError> {
    parse(Format::Crf, file).and_then(Image::sealed)
}

/// The error of a file of which `change` has altered some bytes.
fn error_of(change: impl FnOnce(&mut Vec<u8>)) -> CrfError {
    let mut file = crf(IDENTITY, 4);
    assert!(open(&file).is_ok());
    change(&mut file);
    match open(&file).unwrap_err() {
        FileError::Crf(error) => error,
        other => panic!("{other}"),
    }
}

fn reseal(file: &mut [u8], covered: std::ops::Range<usize>) {
    let crc = iso_hdlc(&file[covered.clone()]).to_le_bytes();
    file[covered.end..covered.end + 4].copy_from_slice(&crc);
}

#[test]
fn row_14_a_damaged_header_is_error_200() {
    for at in [0, 7, 8, 13, 26] {
        let error = error_of(|file| file[at] ^= 0x40);
        assert!(matches!(error, CrfError::BadHeader(_)), "{error}");
        assert_eq!(error.code(), Some(-200));
    }
}

#[test]
fn row_14_a_file_of_another_size_is_error_201() {
    for change in [(|file| file.truncate(9000)) as fn(&mut Vec<u8>), |file| {
        file.push(0);
    }] {
        let error = error_of(change);
        assert!(matches!(error, CrfError::FileSize { .. }), "{error}");
        assert_eq!(error.code(), Some(-201));
    }
}

#[test]
fn row_13_a_file_with_another_product_code_is_error_202() {
    let error = error_of(|file| {
        file[12] ^= 1;
        reseal(file, 0..24);
    });
    assert!(matches!(error, CrfError::WrongProduct { .. }), "{error}");
    assert_eq!(error.code(), Some(-202));
}

#[test]
fn row_14_a_file_without_sections_is_error_203() {
    let error = error_of(|file| {
        file[20..24].fill(0);
        reseal(file, 0..24);
    });
    assert_eq!((&error, error.code()), (&CrfError::NoSections, Some(-203)));
}

#[test]
fn row_14_a_damaged_section_header_is_error_204() {
    for at in [28, 33, 36, 41] {
        let error = error_of(|file| file[at] ^= 1);
        assert!(
            matches!(error, CrfError::BadSectionHeader { index: 0, .. }),
            "{error}"
        );
        assert_eq!(error.code(), Some(-204));
    }
}

#[test]
fn row_14_a_section_of_another_size_is_error_205() {
    for length in [0, 1, 4097, 32 * 4096_u32] {
        let error = error_of(|file| {
            file[32..36].copy_from_slice(&length.to_le_bytes());
            reseal(file, 28..40);
        });
        assert!(
            matches!(error, CrfError::BadSectionSize { index: 0, .. }),
            "{error}"
        );
        assert_eq!(error.code(), Some(-205));
    }
}

fn find(bench: &TalonBench, number: u8) -> Device {
    let selector = format!("talon:{number}").parse().unwrap();
    bench.robot.lend(|client| client.find(&selector)).unwrap()
}

fn update(
    bench: &TalonBench,
    number: u8,
    image: &Image,
    observer: &mut dyn Observer,
) -> Result<Report, FlashError> {
    let device = find(bench, number);
    let options = Options::default();
    bench
        .robot
        .lend(|client| flash(client, &device, image, &options, observer))
}

/// Ends an update after so many pages.
struct Impatient {
    pages: usize,
    phases: Vec<Phase>,
}

impl Observer for Impatient {
    fn phase(&mut self, phase: Phase) {
        self.phases.push(phase);
    }
    fn pages(&mut self, _: usize, _: usize, _: Duration) {
        self.pages = self.pages.saturating_sub(1);
    }
    fn lost(&mut self, _: &str) {}
    fn found(&mut self, _: windlass::client::Address) {}
    fn is_cancelled(&self) -> bool {
        self.pages == 0
    }
}

#[test]
fn row_08_the_largest_crf_file_is_flashed_within_ten_seconds_and_its_version_is_read_back() {
    let bench = TalonBench::new(&["talon:3", "dmc60c:3"]);
    let image = open(&crf(IDENTITY, 31)).unwrap();
    let mut watch = Impatient {
        pages: 100,
        phases: Vec::new(),
    };
    let report = update(&bench, 3, &image, &mut watch).unwrap();
    assert_eq!((report.pages, report.version), (31, Version(0x0203)));
    assert!(report.took < Duration::from_secs(10), "{:?}", report.took);
    assert!(watch.phases.contains(&Phase::Write) && watch.phases.contains(&Phase::Confirm));
    let firmware = bench
        .talon(3)
        .parameter(Parameter::FirmwareVersion)
        .unwrap();
    assert_eq!(firmware, 0x0203);
    // The DMC60C of that number has not noticed.
    let other = "dmc60c:3".parse().unwrap();
    let versions = bench
        .robot
        .lend(|client| client.find(&other))
        .unwrap()
        .versions;
    assert_eq!(versions.unwrap().application, 0x0117);
}

#[test]
fn row_13_an_image_for_another_product_is_refused_and_the_device_stays_flashable() {
    let bench = TalonBench::new(&["talon:3"]);
    let foreign = Identity {
        product: 0x1234_5678,
        ..IDENTITY
    };
    let foreign = open(&crf(foreign, 4)).unwrap();
    // The application still runs: the host refuses, and nothing has changed.
    let refused = update(&bench, 3, &foreign, &mut Unobserved).unwrap_err();
    assert!(
        matches!(refused, FlashError::WrongProduct { .. }),
        "{refused}"
    );
    assert_eq!(find(&bench, 3).versions.unwrap().application, 0x0117);
    // In the bootloader, from a host that does not check.
    let address = bench.robot.lend(|client| {
        let device = client.find(&"talon:3".parse().unwrap()).unwrap();
        client.enter_bootloader(device.address).unwrap()
    });
    let (_, page) = foreign.pages().iter().last().unwrap();
    let patience = Duration::from_secs(3);
    let code = bench
        .robot
        .lend(|client| client.write_page(address, 30, page, patience))
        .unwrap();
    assert_eq!(code, Some(CommandCode::WrongProduct as u16));
    assert_eq!(find(&bench, 3).image_name(), "bootloader");
    let report = update(&bench, 3, &image(IDENTITY, 4), &mut Unobserved).unwrap();
    assert_eq!(report.version, Version(0x0203));
}

#[test]
fn row_10_row_12_a_cut_update_leaves_the_bootloader_with_255_255_and_its_number_on_the_same_bus() {
    let image = image(IDENTITY, 5);
    for pages in 1..5 {
        let bench = TalonBench::new(&["talon:3", "talon:4"]);
        let mut watch = Impatient {
            pages,
            phases: Vec::new(),
        };
        let error = update(&bench, 3, &image, &mut watch).unwrap_err();
        assert!(matches!(error, FlashError::Cancelled { .. }), "{error}");
        bench.world(|world| world.power_cycle(0));
        bench.run(500);
        let device = find(&bench, 3);
        assert_eq!(device.image_name(), "bootloader");
        assert_eq!(
            device.versions.unwrap().application.to_be_bytes(),
            [255, 255]
        );
        // The identifiers are still a Talon's, and so is the rule for numbers.
        let renumbered = bench
            .robot
            .lend(|client| client.set_device_number(device.address, 0))
            .unwrap();
        assert_eq!(renumbered.number, 0);
        let report = update(&bench, 0, &image, &mut Unobserved).unwrap();
        assert_eq!((report.before, report.version), (None, Version(0x0203)));
        assert_eq!(find(&bench, 4).image_name(), "application");
    }
}

#[test]
fn row_79_an_update_keeps_number_settings_and_sticky_flags() {
    let bench = TalonBench::new(&["talon:3"]);
    let talon = bench.talon(3);
    talon.set_p(2.5).unwrap();
    talon.config_fwd_limit_switch_normally_open(false).unwrap();
    bench.poke(0, Poke::BatteryVolts(Some(6.0)));
    bench.run(50);
    bench.poke(0, Poke::BatteryVolts(None));
    bench.run(200);
    let sticky = talon.sticky_faults().fresh().unwrap();
    assert_ne!(sticky, FaultBits::default());
    let gain = talon.parameter(Parameter::Slot0P).unwrap();
    assert_ne!(gain, 0);
    update(&bench, 3, &image(IDENTITY, 4), &mut Unobserved).unwrap();
    bench.run(300);
    assert_eq!(talon.parameter(Parameter::Slot0P).unwrap(), gain);
    let closed = talon
        .parameter(Parameter::OnBootForwardNormallyClosed)
        .unwrap();
    assert_eq!(closed, 1);
    assert_eq!(talon.sticky_faults().fresh().unwrap(), sticky);
    assert_eq!(find(&bench, 3).address.number, 3);
}

/// A bus on which another host drives the Talon 3 every 10 ms.
struct Driven {
    bus: SimBus,
    other: ParticipantId,
    next: Duration,
}

impl Bus for Driven {
    fn send(&mut self, frame: &Frame) -> Result<(), BusError> {
        self.bus.send(frame)
    }

    fn receive(&mut self, timeout: Duration) -> Result<Option<Received>, BusError> {
        let deadline = self.now() + timeout;
        loop {
            if self.next <= self.now() {
                let general = General {
                    mode: ModeSelect::Duty,
                    demand: 300,
                    ..General::default()
                };
                let control = Control1 {
                    token: 0,
                    general: Some(general),
                };
                self.bus.world().send(self.other, control.emit(3));
                self.next = self.now() + Duration::from_millis(10);
            }
            let span = self.next.min(deadline).saturating_sub(self.now());
            let received = self.bus.receive(span)?;
            if received.is_some() || self.now() >= deadline {
                return Ok(received);
            }
        }
    }

    fn now(&self) -> Duration {
        self.bus.now()
    }
}

#[test]
fn a_talon_that_drives_is_not_updated_and_a_resting_dmc60c_of_its_number_is() {
    let mut world = World::new(WorldConfig::default());
    for node in ["talon:3", "dmc60c:3"] {
        world.add_node(node.parse().unwrap());
    }
    let other = world.join("other");
    let mut client = Client::new(Driven {
        bus: SimBus::new(world),
        other,
        next: Duration::ZERO,
    });
    client.listen(Duration::from_millis(300)).unwrap();
    let (image, options) = (image(IDENTITY, 4), Options::default());
    let mut check = |name: &str| {
        let device = client.find(&name.parse().unwrap()).unwrap();
        windlass::flash::check(&mut client, &device, &image, &options)
    };
    let refused = check("talon:3").unwrap_err();
    assert!(matches!(refused, FlashError::Driving(_)), "{refused}");
    check("dmc60c:3").unwrap();
}
