//! Whole updates on the virtual bus, with the data sheets' flash times.

use windlass_core::boot::image::Hardware;
use windlass_core::crc::page_transfer;
use windlass_core::frame::Frame;
use windlass_core::frc_id::with_number;
use windlass_core::management::vendor::{Command, CommandCode};
use windlass_core::management::wire::{
    EnumerateResponse0, EnumerateResponse1, FirmwareVersions, ImageType, VendorCommand,
    VendorStatus, id,
};
use windlass_core::time::Duration;
use windlass_sim::nor::{Geometry, Region, STM32F405, STM32G474};
use windlass_sim::{
    Chip, NodeSpec, ParticipantId, PlantConfig, Poke, World, WorldConfig, occupied_bits,
};
use windlass_tests::boot_bench::Image;
use windlass_tests::ms;

const NUMBER: u8 = 5;

/// A controller and a host that waits for every status.
struct Rig {
    world: World,
    tool: ParticipantId,
    session: u16,
    hardware: Hardware,
}

impl Rig {
    fn new(chip: Chip) -> Self {
        let mut world = World::new(WorldConfig::default());
        let spec: NodeSpec = "dmc60c:5".parse().unwrap();
        world.add_board(spec, &PlantConfig::default(), chip);
        let tool = world.join("tool");
        let mut rig = Self {
            world,
            tool,
            session: 0,
            hardware: chip.hardware(),
        };
        rig.enumerate();
        rig
    }

    fn answer(&mut self, base: u32, span: Duration) -> Option<Frame> {
        let deadline = self.world.now() + span;
        loop {
            let frame = self
                .world
                .advance_until_received(self.tool, deadline)?
                .frame;
            if frame.extended_id() == Some(with_number(base, NUMBER)) {
                return Some(frame);
            }
        }
    }

    fn enumerate(&mut self) -> FirmwareVersions {
        self.world
            .send(self.tool, Frame::extended(id::ENUMERATE, []));
        let first = self.answer(id::ENUMERATE_RESPONSE, ms(100)).unwrap();
        self.session = EnumerateResponse0::parse(&first).unwrap().session;
        let second = self.answer(id::ENUMERATE_RESPONSE, ms(100)).unwrap();
        EnumerateResponse1::parse(&second).unwrap().versions
    }

    fn send(&mut self, command: Command, param2: u16) {
        let frame = VendorCommand {
            session: self.session,
            command: command.code(),
            param1: 0,
            param2,
        };
        self.world.send(self.tool, frame.emit(NUMBER));
    }

    fn status(&mut self, span: Duration) -> Option<CommandCode> {
        let frame = self.answer(id::VENDOR_STATUS, span)?;
        CommandCode::from_code(VendorStatus::parse(&frame).unwrap().code as u8)
    }

    fn command(&mut self, command: Command) -> Option<CommandCode> {
        self.send(command, 0);
        self.status(ms(3_000))
    }

    fn page_frames(image: &Image, page: u8) -> Vec<Frame> {
        let content = &image.pages[&page][..];
        let mut data = content.to_vec();
        data.extend_from_slice(&page_transfer(content).to_le_bytes());
        let base = with_number(id::VENDOR_DATA_OUT, NUMBER);
        data.chunks(8)
            .map(|chunk| {
                let mut bytes = [0; 8];
                bytes[..chunk.len()].copy_from_slice(chunk);
                Frame::extended(base, bytes).shortened(chunk.len())
            })
            .collect()
    }

    fn page(&mut self, image: &Image, page: u8) -> Option<CommandCode> {
        self.send(Command::EraseWriteFlashPage, u16::from(page));
        for frame in Self::page_frames(image, page) {
            self.world.send(self.tool, frame);
        }
        self.status(ms(10_000))
    }

    fn update(&mut self, image: &Image) {
        assert_eq!(
            self.command(Command::EnterBootloader),
            Some(CommandCode::InBootloader)
        );
        for page in image.order() {
            assert_eq!(self.page(image, page), Some(CommandCode::NoError), "{page}");
        }
        assert_eq!(
            self.command(Command::SoftReset),
            Some(CommandCode::AcknowledgeReset)
        );
        let versions = self.enumerate();
        assert_eq!(
            (versions.image, versions.application),
            (ImageType::Application, image.header.identity.version)
        );
    }
}

/// A whole image without a blank unit.
fn full(hardware: &Hardware, version: u16) -> Image {
    let pages: Vec<u8> = (0..31)
        .filter(|page| hardware.pages >> page & 1 != 0)
        .collect();
    Image::with(hardware, version, &pages, |page, at| {
        let mixed = (at as u32 * 31 + u32::from(page)).wrapping_mul(0x9E37_79B1);
        (mixed >> 24) as u8 & 0x7F
    })
}

/// The least time that an update can take for a host that waits for each status: frames on the wire, with
/// the intermission between them, then the flash.
fn limit(geometry: &Geometry, image: &Image) -> Duration {
    let mut bits = 0;
    let mut count = |frame: &Frame| bits += occupied_bits(frame);
    let mut units = 0;
    for page in image.order() {
        count(
            &VendorCommand {
                session: 0x5555,
                command: Command::EraseWriteFlashPage.code(),
                param1: 0,
                param2: u16::from(page),
            }
            .emit(NUMBER),
        );
        Rig::page_frames(image, page).iter().for_each(&mut count);
        count(
            &VendorStatus {
                code: 0,
                byte_count: 0,
            }
            .emit(NUMBER),
        );
        units += image.pages[&page]
            .chunks(geometry.write_size)
            .filter(|unit| unit.iter().any(|byte| *byte != 0xFF))
            .count() as u64;
    }
    let slot = geometry
        .regions
        .iter()
        .find(|region| region.region == Region::Application)
        .unwrap();
    let erases = if slot.erase_units == 1 {
        1
    } else {
        (image.pages.len() * 4096 / slot.erase_size) as u64
    };
    let nanos = bits * 1000 + units * geometry.program_ns + erases * slot.erase_ns;
    Duration::from_micros(nanos / 1000)
}

#[test]
fn a_31_page_update_takes_no_more_than_the_wire_and_the_flash_need() {
    for (chip, geometry) in [(Chip::Stm32F405, &STM32F405), (Chip::Stm32G474, &STM32G474)] {
        let mut rig = Rig::new(chip);
        let image = full(&rig.hardware, 0x0203);
        assert_eq!(
            rig.command(Command::EnterBootloader),
            Some(CommandCode::InBootloader)
        );
        let begin = rig.world.now();
        for page in image.order() {
            assert_eq!(rig.page(&image, page), Some(CommandCode::NoError), "{page}");
        }
        let taken = rig.world.now().since(begin).as_micros();
        let least = limit(geometry, &image).as_micros();
        let percent = least as f64 / taken as f64 * 100.0;
        println!(
            "{}: {taken} us, limit {least} us, {percent:.2} %",
            geometry.name
        );
        assert!((97.0..=100.0).contains(&percent), "{percent}");
    }
}

#[test]
fn an_update_ends_in_the_new_version_and_is_confirmed_by_the_answer() {
    for chip in [Chip::Stm32F405, Chip::Stm32G474, Chip::Stm32G431] {
        let mut rig = Rig::new(chip);
        assert_eq!(rig.enumerate().application, 0x0117);
        let image = Image::small(&rig.hardware, 0x0205, &[0, 1]);
        rig.update(&image);
        // It has answered: failures do not bring the old image back.
        hang(&mut rig, 5);
        assert_eq!(rig.enumerate().application, 0x0205);
    }
}

/// Lets the application hang until the watchdog has reset it this often.
fn hang(rig: &mut Rig, times: u32) {
    let node = rig.world.node_mut(0).unwrap();
    node.poke(Poke::Hang(true));
    // A reset takes 25 ms: watchdog and start. Restoring takes as long as erasing a sector does.
    for _ in 0..times {
        rig.world.advance(ms(26));
    }
    rig.world.node_mut(0).unwrap().poke(Poke::Hang(false));
    rig.world.advance(ms(6_000));
}

#[test]
fn an_image_that_hangs_before_it_has_answered_is_replaced_by_the_one_before() {
    for chip in [Chip::Stm32F405, Chip::Stm32G474] {
        let mut rig = Rig::new(chip);
        let image = Image::small(&rig.hardware, 0x0205, &[0, 1]);
        rig.command(Command::EnterBootloader);
        for page in image.order() {
            rig.page(&image, page);
        }
        // The new image hangs before it can answer anything.
        rig.world.node_mut(0).unwrap().poke(Poke::Hang(true));
        rig.send(Command::SoftReset, 0);
        rig.world.advance(ms(6));
        hang(&mut rig, 4);
        assert_eq!(rig.enumerate().application, 0x0117, "{chip:?}");
    }
}

#[test]
fn power_cut_in_the_middle_of_an_update_leaves_a_bootloader_that_goes_on() {
    for chip in [Chip::Stm32F405, Chip::Stm32G474, Chip::Stm32G431] {
        let mut rig = Rig::new(chip);
        let image = Image::small(&rig.hardware, 0x0205, &[0, 1, 2]);
        rig.command(Command::EnterBootloader);
        assert_eq!(rig.page(&image, 30), Some(CommandCode::NoError));
        assert_eq!(rig.page(&image, 2), Some(CommandCode::NoError));
        rig.world.power_cycle(0);
        rig.world.advance(ms(100));
        let versions = rig.enumerate();
        assert_eq!(
            (versions.image, versions.application),
            (ImageType::Bootloader, 0xFFFF)
        );
        assert_eq!(rig.page(&image, 1), Some(CommandCode::NoError));
        assert_eq!(rig.page(&image, 0), Some(CommandCode::NoError));
        rig.send(Command::SoftReset, 0);
        assert_eq!(rig.status(ms(3_000)), Some(CommandCode::AcknowledgeReset));
        assert_eq!(rig.enumerate().application, 0x0205);
    }
}

#[test]
fn power_cut_while_the_flash_is_busy_leaves_a_controller_that_can_be_flashed() {
    for at in [1, 200, 900, 1_010, 1_060] {
        let mut rig = Rig::new(Chip::Stm32F405);
        let image = Image::small(&rig.hardware, 0x0205, &[0, 1]);
        rig.command(Command::EnterBootloader);
        rig.send(Command::EraseWriteFlashPage, 30);
        for frame in Rig::page_frames(&image, 30) {
            rig.world.send(rig.tool, frame);
        }
        // The page takes some 70 ms on the wire, then the sector 1 s to erase.
        rig.world.advance(ms(60 + at));
        rig.world.power_cycle(0);
        rig.world.advance(ms(3_000));
        rig.enumerate();
        rig.update(&image);
    }
}
