//! The flash model keeps the rules of flash and breaks what a cut breaks.

use super::*;

type F405Journal = Partition<4, 0x4000>;
type G4Journal = Partition<8, 0x800>;

fn f405() -> (NorChip, F405Journal) {
    let chip = NorChip::new(&STM32F405, 1);
    let partition = chip.partition(Region::Journal).unwrap();
    (chip, partition)
}

fn g474() -> (NorChip, G4Journal) {
    let chip = NorChip::new(&STM32G474, 1);
    let partition = chip.partition(Region::Journal).unwrap();
    (chip, partition)
}

fn read<const W: usize, const E: usize>(flash: &mut Partition<W, E>, at: u32) -> [u8; 8] {
    let mut bytes = [0; 8];
    flash.read(at, &mut bytes).unwrap();
    bytes
}

#[test]
fn partitions_have_the_sizes_of_the_chips() {
    let sizes = |geometry: &Geometry| -> Vec<(Region, usize)> {
        geometry
            .regions
            .iter()
            .map(|region| (region.region, region.capacity()))
            .collect()
    };
    assert_eq!(
        sizes(&STM32F405),
        [
            (Region::Journal, 32 << 10),
            (Region::Application, 128 << 10),
            (Region::Fallback, 128 << 10)
        ]
    );
    assert_eq!(
        sizes(&STM32G474),
        [
            (Region::Journal, 16 << 10),
            (Region::Application, 128 << 10),
            (Region::Fallback, 128 << 10)
        ]
    );
    assert_eq!(
        sizes(&STM32G431),
        [(Region::Journal, 8 << 10), (Region::Application, 100 << 10)]
    );
    let (chip, partition) = f405();
    assert_eq!(partition.capacity(), 32 << 10);
    assert!(chip.partition::<8, 0x4000>(Region::Journal).is_none());
    assert!(chip.partition::<4, 0x4000>(Region::Fallback).is_none());
    let small = NorChip::new(&STM32G431, 1);
    assert!(small.partition::<8, 0x800>(Region::Fallback).is_none());
}

#[test]
fn a_unit_is_programmed_once_and_erased_with_its_neighbours() {
    let (chip, mut flash) = f405();
    flash.write(8, &[1, 2, 3, 4]).unwrap();
    flash.write(0x4000, &[5; 4]).unwrap();
    assert_eq!(read(&mut flash, 4), [0xFF, 0xFF, 0xFF, 0xFF, 1, 2, 3, 4]);
    // Even a value that only turns ones into zeros.
    assert_eq!(flash.write(8, &[0; 4]), Err(NorError::NotErased));
    assert_eq!(read(&mut flash, 8)[..4], [1, 2, 3, 4]);
    assert_eq!(chip.misuses(), 1);
    flash.erase(0, 0x4000).unwrap();
    flash.write(8, &[9; 4]).unwrap();
    assert_eq!(read(&mut flash, 8)[..4], [9; 4]);
    assert_eq!(read(&mut flash, 0x4000)[..4], [5; 4]);
    assert_eq!(chip.erases(Region::Journal), [1, 0]);
    assert_eq!(chip.erases(Region::Application), [0]);
    assert_eq!((chip.programs(), chip.operations()), (3, 4));
}

#[test]
fn misuse_is_refused_and_counted() {
    let (chip, mut flash) = g474();
    let mut bytes = [0; 2];
    assert_eq!(flash.write(4, &[0; 8]), Err(NorError::Unaligned));
    assert_eq!(flash.write(0, &[0; 4]), Err(NorError::Unaligned));
    assert_eq!(flash.write(0x4000, &[0; 8]), Err(NorError::OutOfBounds));
    assert_eq!(flash.erase(0, 0x400), Err(NorError::Unaligned));
    assert_eq!(flash.erase(0x800, 0), Err(NorError::OutOfBounds));
    assert_eq!(flash.erase(0, 0x4800), Err(NorError::OutOfBounds));
    assert_eq!(flash.read(0x3FFF, &mut bytes), Err(NorError::OutOfBounds));
    assert_eq!(flash.read(u32::MAX, &mut bytes), Err(NorError::OutOfBounds));
    assert_eq!((chip.misuses(), chip.operations()), (8, 0));
}

#[test]
fn times_are_those_of_the_data_sheets() {
    let (chip, mut flash) = f405();
    flash.write(0, &[0; 4000]).unwrap();
    assert_eq!(chip.busy_us(), 16_000);
    flash.erase(0, 0x8000).unwrap();
    assert_eq!(chip.busy_us(), 516_000);
    let (chip, mut flash) = g474();
    flash.write(0, &[0; 2000]).unwrap();
    assert_eq!(chip.busy_us(), 20_425);
    flash.erase(0, 0x800).unwrap();
    assert_eq!(chip.busy_us(), 42_445);
}

#[test]
fn after_a_cut_nothing_works_until_the_power_is_back() {
    for (point, third) in [(CutPoint::Before, [0xFF; 4]), (CutPoint::After, [3; 4])] {
        let (chip, mut flash) = f405();
        chip.cut_at(Some(Cut {
            operation: 2,
            point,
        }));
        let data: Vec<u8> = [[1; 4], [2; 4], [3; 4], [4; 4]].concat();
        assert_eq!(flash.write(0, &data), Err(NorError::PowerLost));
        assert!(!chip.is_powered());
        assert_eq!(flash.write(32, &[0; 4]), Err(NorError::PowerLost));
        assert_eq!(flash.read(0, &mut [0; 4]), Err(NorError::PowerLost));
        assert_eq!(flash.erase(0, 0x4000), Err(NorError::PowerLost));
        chip.power_on();
        let mut bytes = [0; 16];
        flash.read(0, &mut bytes).unwrap();
        assert_eq!(bytes[..8], data[..8]);
        assert_eq!(bytes[8..12], third);
        assert_eq!(bytes[12..], [0xFF; 4]);
        flash.write(12, &data[12..]).unwrap();
        assert_eq!(chip.misuses(), 0);
    }
}

#[test]
fn a_torn_write_leaves_a_part_and_some_units_read_differently_twice() {
    let (mut parts, mut restless, mut changed_by_power) = (0, 0, 0);
    for seed in 0..500 {
        let (chip, mut flash) = f405();
        chip.cut_at(Some(Cut {
            operation: 1,
            point: CutPoint::Inside(seed),
        }));
        assert_eq!(flash.write(0, &[0x55; 12]), Err(NorError::PowerLost));
        chip.power_on();
        let first = read(&mut flash, 0);
        assert_eq!(first[..4], [0x55; 4]);
        assert!(
            first[4..].iter().all(|byte| byte & 0x55 == 0x55),
            "only bits that were to become 0 may have changed: {first:?}"
        );
        assert_eq!(read(&mut flash, 8), [0xFF; 8]);
        parts += u32::from(first[4..] != [0xFF; 4] && first[4..] != [0x55; 4]);
        let again = read(&mut flash, 0);
        restless += u32::from(first != again);
        chip.power_off();
        chip.power_on();
        changed_by_power += u32::from(first == again && first != read(&mut flash, 0));
        flash.erase(0, 0x4000).unwrap();
        assert_eq!(read(&mut flash, 0), [0xFF; 8]);
        assert_eq!(read(&mut flash, 0), [0xFF; 8]);
        flash.write(4, &[7; 4]).unwrap();
    }
    for count in [parts, restless, changed_by_power] {
        assert!(count > 50, "{parts} {restless} {changed_by_power}");
    }
}

/// A chip on which the programming of one unit of zeros was interrupted.
fn torn<const W: usize, const E: usize>(
    geometry: &'static Geometry,
    seed: u64,
) -> (NorChip, Partition<W, E>) {
    let chip = NorChip::new(geometry, 1);
    let mut flash = chip.partition(Region::Journal).unwrap();
    chip.cut_at(Some(Cut {
        operation: 0,
        point: CutPoint::Inside(seed),
    }));
    assert_eq!(flash.write(0, &[0; W]), Err(NorError::PowerLost));
    chip.power_on();
    (chip, flash)
}

/// True if the first `W` bytes read as erased each time.
fn looks_erased<const W: usize, const E: usize>(flash: &mut Partition<W, E>) -> bool {
    (0..8).all(|_| {
        let mut bytes = [0; W];
        flash.read(0, &mut bytes).is_ok() && bytes == [0xFF; W]
    })
}

#[test]
fn a_torn_unit_is_completed_with_its_own_value_only_while_it_reads_erased() {
    let (mut completed, mut refused, mut misused) = (0, 0, 0);
    for seed in 0..500 {
        let (chip, mut flash) = torn::<4, 0x4000>(&STM32F405, seed);
        let erased = looks_erased(&mut flash);
        match flash.write(0, &[0; 4]) {
            Ok(()) => {
                completed += 1;
                assert!((0..8).all(|_| read(&mut flash, 0)[..4] == [0; 4]));
            }
            Err(error) => {
                assert_eq!((error, erased), (NorError::NotErased, false));
                refused += 1;
                misused += chip.misuses();
            }
        }
        assert_eq!(chip.overprogrammed(), []);
    }
    assert!(
        completed > 20 && refused > misused && misused > 20,
        "{completed} {refused} {misused}"
    );
}

#[test]
fn another_value_over_a_torn_unit_stays_unstable_or_is_refused_by_error_correction() {
    let (mut over, mut unstable) = (0, 0);
    for seed in 0..500 {
        let (chip, mut flash) = torn::<4, 0x4000>(&STM32F405, seed);
        if flash.write(0, &[0xFE; 4]).is_err() {
            continue;
        }
        over += 1;
        assert_eq!(chip.overprogrammed(), [(Region::Journal, 0)]);
        let reads: Vec<_> = (0..8)
            .map(|_| {
                chip.power_on();
                let bytes = read(&mut flash, 0);
                assert!(bytes[..4].iter().all(|byte| byte & 1 == 0), "{bytes:?}");
                bytes
            })
            .collect();
        unstable += u32::from(reads.iter().any(|bytes| bytes[..4] != [0xFE; 4]));
        // It is programmed now, whatever it reads as.
        assert_eq!(flash.write(0, &[0xFE; 4]), Err(NorError::NotErased));

        let (chip, mut flash) = torn::<8, 0x800>(&STM32G474, seed);
        if looks_erased(&mut flash) {
            assert_eq!(flash.write(0, &[0xF0; 8]), Err(NorError::NotErased));
            assert_eq!(chip.overprogrammed(), [(Region::Journal, 0)]);
            assert_eq!(chip.misuses(), 0);
        }
    }
    assert!(
        over > 20 && unstable > 0 && unstable < over,
        "{over} {unstable}"
    );
}

#[test]
fn a_partial_erase_leaves_anything_until_the_next_one() {
    let (mut looks_erased, mut looks_untouched, mut restless, mut unreadable) = (0, 0, 0, 0);
    for seed in 0..200 {
        let (chip, mut flash) = g474();
        flash.write(0, &[0xA5; 0x800]).unwrap();
        flash.write(0x800, &[0x5A; 8]).unwrap();
        chip.cut_at(Some(Cut {
            operation: chip.operations(),
            point: CutPoint::Inside(seed),
        }));
        assert_eq!(flash.erase(0, 0x1000), Err(NorError::PowerLost));
        chip.power_on();
        let (mut first, mut second) = ([0; 0x800], [0; 0x800]);
        let mut failed = false;
        for (at, (a, b)) in (0..)
            .step_by(8)
            .zip(first.chunks_mut(8).zip(second.chunks_mut(8)))
        {
            failed |= flash.read(at, a).is_err() | flash.read(at, b).is_err();
        }
        unreadable += u32::from(failed);
        restless += u32::from(first != second);
        let erased = first.iter().filter(|byte| **byte == 0xFF).count();
        looks_erased += u32::from(erased > 0x700);
        looks_untouched += u32::from(first.iter().filter(|byte| **byte == 0xA5).count() > 0x80);
        assert_eq!(read(&mut flash, 0x800), [0x5A; 8]);
        assert_eq!(flash.write(0, &[0; 8]), Err(NorError::NotErased));
        flash.erase(0, 0x800).unwrap();
        flash.write(0, &[0; 8]).unwrap();
        assert_eq!(read(&mut flash, 0), [0; 8]);
        assert_eq!(chip.erases(Region::Journal)[..2], [2, 0]);
    }
    for count in [looks_erased, looks_untouched, restless, unreadable] {
        assert!(
            count > 10,
            "{looks_erased} {looks_untouched} {restless} {unreadable}"
        );
    }
}

#[test]
fn a_chip_goes_back_to_a_saved_state_and_repeats_itself() {
    let (chip, mut flash) = f405();
    flash.write(0, &[1; 4]).unwrap();
    let saved = chip.save();
    let mut ends = Vec::new();
    for _ in 0..2 {
        chip.restore(&saved);
        chip.cut_at(Some(Cut {
            operation: 1,
            point: CutPoint::Inside(3),
        }));
        assert_eq!(flash.erase(0, 0x4000), Err(NorError::PowerLost));
        chip.power_on();
        let mut bytes = [0; 256];
        flash.read(0, &mut bytes).unwrap();
        ends.push(bytes);
    }
    assert_eq!(ends[0], ends[1]);
}

#[test]
fn the_power_can_be_cut_by_time() {
    // 16 µs a word: 1000 µs end inside the 63rd.
    let (chip, mut flash) = f405();
    chip.cut_after(1000, 5);
    assert_eq!(flash.write(0, &[0; 400]), Err(NorError::PowerLost));
    assert_eq!(chip.operations(), 63);
    assert_eq!(chip.busy_us(), 1000);
}
