//! Updates of simulated controllers, in virtual time with the data sheets' flash times.

use std::collections::VecDeque;
use std::time::Duration;

use ed25519_dalek::SigningKey;
use windlass::client::{Address, Client, Device, Version};
use windlass::flash::{
    FlashError, Observer, Options, Phase, Report, flash, install_key, roll_back,
};
use windlass::image::{Format, Image, key, parse};
use windlass::transport::{Bus, BusError, Received, SimBus};
use windlass_core::boot::image::{Hardware, INFO_OFFSET, Identity, InfoBlock, PAGE_SIZE};
use windlass_core::frame::Frame;
use windlass_core::node::PRODUCT_DMC60C;
use windlass_sim::{Chip, PlantConfig, Poke, World, WorldConfig};

/// The simulated bus with things that happen to the first controller at given times.
struct Trouble {
    bus: SimBus,
    script: VecDeque<(Duration, Poke)>,
}

impl Trouble {
    fn happen(&mut self) {
        while let Some((at, poke)) = self.script.front().copied() {
            if at > self.bus.now() {
                break;
            }
            self.script.pop_front();
            self.bus.world().node_mut(0).unwrap().poke(poke);
        }
    }
}

impl Bus for Trouble {
    fn send(&mut self, frame: &Frame) -> Result<(), BusError> {
        self.bus.send(frame)
    }

    fn receive(&mut self, timeout: Duration) -> Result<Option<Received>, BusError> {
        let deadline = self.now() + timeout;
        loop {
            self.happen();
            let next = self.script.front().map_or(deadline, |(at, _)| *at);
            let span = next.min(deadline).saturating_sub(self.now());
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

#[derive(Default)]
struct Watch {
    pages: usize,
    cancel_after: Option<usize>,
    lost: usize,
}

impl Observer for Watch {
    fn phase(&mut self, _phase: Phase) {}

    fn pages(&mut self, _stored: usize, _of: usize, _now: Duration) {
        self.pages += 1;
    }

    fn lost(&mut self, _reason: &str) {
        self.lost += 1;
    }

    fn found(&mut self, _address: Address) {}

    fn is_cancelled(&self) -> bool {
        self.cancel_after == Some(self.pages)
    }
}

struct Bench {
    client: Client<Trouble>,
    watch: Watch,
    /// What happens to the first controller so long after the next update has begun.
    mishaps: Vec<(Duration, Poke)>,
}

impl Bench {
    fn new(chips: &[Chip], loss: f64) -> Self {
        let mut world = World::new(WorldConfig {
            loss,
            ..WorldConfig::default()
        });
        for (number, chip) in (5..).zip(chips) {
            let spec = format!("dmc60c:{number}").parse().unwrap();
            world.add_board(spec, &PlantConfig::default(), *chip);
        }
        let trouble = Trouble {
            bus: SimBus::new(world),
            script: VecDeque::new(),
        };
        Self {
            client: Client::new(trouble),
            watch: Watch::default(),
            mishaps: Vec::new(),
        }
    }

    fn device(&mut self, number: u8) -> Device {
        self.client
            .find(&number.to_string().parse().unwrap())
            .unwrap()
    }

    fn flash(&mut self, number: u8, image: &Image) -> Result<Report, FlashError> {
        let device = self.device(number);
        let now = self.client.now();
        self.client.bus().script.extend(
            self.mishaps
                .drain(..)
                .map(|(after, poke)| (now + after, poke)),
        );
        let options = Options::default();
        flash(&mut self.client, &device, image, &options, &mut self.watch)
    }

    fn later(&mut self, millis: u64, poke: Poke) {
        self.mishaps.push((Duration::from_millis(millis), poke));
    }

    fn version(&mut self, number: u8) -> Version {
        let address = self.device(number).address;
        Version(self.client.firmware_versions(address).unwrap().application)
    }
}

fn image(hardware: &Hardware, version: u16, pages: usize) -> Image {
    counted_image(hardware, version, pages, 0)
}

/// An image with an anti-rollback counter.
fn counted_image(hardware: &Hardware, version: u16, pages: usize, rollback: u32) -> Image {
    let identity = Identity {
        product: PRODUCT_DMC60C,
        hardware: hardware.id,
        version,
        rollback,
    };
    let mut bytes: Vec<u8> = (0..pages * PAGE_SIZE)
        .map(|at| (at as u32).wrapping_mul(0x9E37_79B1).to_be_bytes()[0] & 0x7F)
        .collect();
    let info = InfoBlock { identity }.to_bytes();
    bytes[INFO_OFFSET..INFO_OFFSET + info.len()].copy_from_slice(&info);
    Image::packed(parse(Format::Bin, &bytes).unwrap()).unwrap()
}

fn largest(hardware: &Hardware, version: u16) -> Image {
    image(hardware, version, hardware.pages.count_ones() as usize - 1)
}

#[test]
fn the_largest_image_of_every_chip_is_flashed_and_flashed_again() {
    // Limits for a host that waits: 3.74 s and 4.89 s for 31 pages; two restarts, looking and verifying
    // come on top.
    for (chip, millis) in [
        (Chip::Stm32F405, 5_200),
        (Chip::Stm32G474, 6_200),
        (Chip::Stm32G431, 5_200),
    ] {
        let mut bench = Bench::new(&[chip], 0.0);
        let image = largest(&chip.hardware(), 0x0119);
        let report = bench.flash(5, &image).unwrap();
        assert_eq!(
            (report.before, report.version),
            (Some(Version(0x0117)), Version(0x0119))
        );
        assert_eq!(report.sent, image.pages().len());
        assert!(
            report.took < Duration::from_millis(millis),
            "{chip:?}: {:?}",
            report.took
        );
        println!("{chip:?}: {} pages in {:?}", report.pages, report.took);
        let report = bench.flash(5, &image).unwrap();
        assert_eq!((report.sent, report.version), (0, Version(0x0119)));
    }
}

#[test]
fn a_power_cut_at_any_time_of_an_update_is_survived_by_the_same_call() {
    let image = image(&Hardware::F405, 0x0119, 5);
    for millis in (0..2_400).step_by(110) {
        let mut bench = Bench::new(&[Chip::Stm32F405], 0.0);
        bench.later(millis, Poke::Powered(false));
        bench.later(millis + 50, Poke::Powered(true));
        let report = bench.flash(5, &image).unwrap();
        assert_eq!(report.version, Version(0x0119), "{millis} ms");
        assert!(
            bench.watch.pages < 13,
            "{millis} ms: {} pages",
            bench.watch.pages
        );
    }
}

#[test]
fn an_unplugged_bus_is_waited_for() {
    let image = image(&Hardware::G474, 0x0119, 8);
    for millis in (0..1_700).step_by(170) {
        let mut bench = Bench::new(&[Chip::Stm32G474], 0.0);
        bench.later(millis, Poke::BusConnected(false));
        bench.later(millis + 15_000, Poke::BusConnected(true));
        let report = bench.flash(5, &image).unwrap();
        assert_eq!(report.version, Version(0x0119), "{millis} ms");
        assert!(report.sent <= 10, "{millis} ms: {}", report.sent);
    }
}

#[test]
fn an_interrupted_update_leaves_version_255_255_and_goes_on() {
    let image = image(&Hardware::F405, 0x0119, 5);
    for pages in 1..6 {
        let mut bench = Bench::new(&[Chip::Stm32F405], 0.0);
        bench.watch.cancel_after = Some(pages);
        let error = bench.flash(5, &image).unwrap_err();
        assert!(matches!(error, FlashError::Cancelled { .. }), "{error}");
        assert_eq!(bench.version(5), Version::NONE);
        bench.client.bus().bus.world().power_cycle(0);
        bench.client.listen(Duration::from_millis(500)).unwrap();
        assert_eq!(bench.version(5), Version::NONE);
        bench.watch = Watch::default();
        let report = bench.flash(5, &image).unwrap();
        assert_eq!((report.before, report.sent), (None, 6 - pages));
    }
}

#[test]
fn several_controllers_of_several_kinds_each_take_their_own_image() {
    let chips = [Chip::Stm32F405, Chip::Stm32G474, Chip::Stm32G431];
    let mut bench = Bench::new(&chips, 0.0);
    for (number, chip) in (5..).zip(chips) {
        for other in chips.into_iter().filter(|other| *other != chip) {
            let error = bench
                .flash(number, &image(&other.hardware(), 0x0119, 2))
                .unwrap_err();
            assert!(matches!(error, FlashError::WrongHardware { .. }), "{error}");
        }
        assert_eq!(bench.version(number), Version(0x0117));
        let report = bench
            .flash(number, &image(&chip.hardware(), 0x0119, 2))
            .unwrap();
        assert_eq!(report.version, Version(0x0119));
    }
}

#[test]
fn the_fallback_is_put_back_and_refreshed() {
    for chip in [Chip::Stm32F405, Chip::Stm32G474] {
        let mut bench = Bench::new(&[chip], 0.0);
        let new = image(&chip.hardware(), 0x0119, 4);
        bench.flash(5, &new).unwrap();
        let device = bench.device(5);
        let options = Options::default();
        let report = roll_back(&mut bench.client, &device, &options, &mut bench.watch).unwrap();
        assert_eq!(report.version, Version(0x0117), "{chip:?}");

        // Confirmed by an answer and copied by the next start, the new one is what is put back.
        bench.flash(5, &new).unwrap();
        bench.client.listen(Duration::from_secs(1)).unwrap();
        bench.client.bus().bus.world().power_cycle(0);
        bench.client.listen(Duration::from_secs(10)).unwrap();
        bench.flash(5, &image(&chip.hardware(), 0x0120, 3)).unwrap();
        let device = bench.device(5);
        let report = roll_back(&mut bench.client, &device, &options, &mut bench.watch).unwrap();
        assert_eq!(report.version, Version(0x0119), "{chip:?}");
    }
}

#[test]
fn a_lossy_bus_costs_time_and_nothing_else() {
    let mut bench = Bench::new(&[Chip::Stm32F405], 0.0005);
    let image = largest(&Hardware::F405, 0x0119);
    let report = bench.flash(5, &image).unwrap();
    assert_eq!(report.version, Version(0x0119));
}

#[test]
fn with_a_key_installed_only_images_that_it_has_signed_run() {
    let (ours, theirs) = (
        SigningKey::from_bytes(&[7; 32]),
        SigningKey::from_bytes(&[8; 32]),
    );
    for chip in [Chip::Stm32F405, Chip::Stm32G474, Chip::Stm32G431] {
        let mut bench = Bench::new(&[chip], 0.0);
        let plain = image(&chip.hardware(), 0x0119, 3);
        let device = bench.device(5);
        let order = key::install_order(&ours.verifying_key(), None);
        install_key(&mut bench.client, &device, &order, &mut bench.watch).unwrap();

        let error = bench.flash(5, &plain).unwrap_err();
        assert!(matches!(error, FlashError::Unsigned(_)), "{error}");
        assert_eq!(bench.version(5), Version(0x0117), "nothing was changed");

        let report = bench.flash(5, &plain.clone().signed(&ours)).unwrap();
        assert_eq!(report.version, Version(0x0119), "{chip:?}");

        // A signature can only be checked when all is there: the device is left without an application,
        // and takes a good image.
        let next = image(&chip.hardware(), 0x0120, 4);
        let error = bench.flash(5, &next.clone().signed(&theirs)).unwrap_err();
        assert!(error.to_string().contains("cercBadSignature"), "{error}");
        assert_eq!(bench.version(5), Version::NONE);
        let report = bench.flash(5, &next.signed(&ours)).unwrap();
        assert_eq!(report.version, Version(0x0120), "{chip:?}");
    }
}

#[test]
fn a_key_is_replaced_by_its_owner_only() {
    let keys = [7, 8, 9].map(|seed| SigningKey::from_bytes(&[seed; 32]));
    let [first, second, stranger] = &keys;
    let mut bench = Bench::new(&[Chip::Stm32F405], 0.0);
    let mut install = |key: &SigningKey, by: Option<&SigningKey>| {
        let device = bench.device(5);
        let order = key::install_order(&key.verifying_key(), by);
        let done = install_key(&mut bench.client, &device, &order, &mut bench.watch);
        bench.client.listen(Duration::from_millis(500)).unwrap();
        done.is_ok()
    };
    assert!(install(first, None));
    assert!(!install(second, None));
    assert!(!install(second, Some(stranger)));
    assert!(install(second, Some(first)));
    let image = image(&Hardware::F405, 0x0119, 3);
    assert!(bench.flash(5, &image.clone().signed(first)).is_err());
    let report = bench.flash(5, &image.signed(second)).unwrap();
    assert_eq!(report.version, Version(0x0119));
}

#[test]
fn an_older_counter_than_a_confirmed_image_s_is_refused() {
    let mut bench = Bench::new(&[Chip::Stm32F405], 0.0);
    let hardware = Hardware::F405;
    bench
        .flash(5, &counted_image(&hardware, 0x0119, 3, 4))
        .unwrap();
    // Confirmed by the answers so far; the next start keeps the counter.
    bench.client.listen(Duration::from_secs(1)).unwrap();
    bench.client.bus().bus.world().power_cycle(0);
    bench.client.listen(Duration::from_secs(10)).unwrap();
    let error = bench
        .flash(5, &counted_image(&hardware, 0x0120, 3, 3))
        .unwrap_err();
    assert!(
        matches!(
            error,
            FlashError::RollbackRefused {
                image: 3,
                device: 4,
                ..
            }
        ),
        "{error}"
    );
    assert_eq!(bench.version(5), Version(0x0119));
    let report = bench
        .flash(5, &counted_image(&hardware, 0x0118, 3, 4))
        .unwrap();
    assert_eq!(report.version, Version(0x0118));
}
