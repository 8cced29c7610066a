//! Talon SRX: settings in flash, seen from the wire (manual 11.1). The numbers are the rows of
//! docs/talon-srx-rows.md.

use windlass_core::dialect::talon_srx::wire::Parameter;
use windlass_sim::Poke;
use windlass_tests::talon::{Talon, TalonBench};

/// Gains of both profiles, a soft limit and a switch type: everything that one save has to keep together.
const PARAMETERS: [Parameter; 5] = [
    Parameter::Slot0P,
    Parameter::Slot1F,
    Parameter::Slot0IZone,
    Parameter::ForwardSoftThreshold,
    Parameter::OnBootForwardNormallyClosed,
];
const OLD: [u32; 5] = [0x0040_0000, 0x0000_1234, 300, 70_000, 0];
const NEW: [u32; 5] = [0x0060_0000, 0xFFFF_0000, 1, 0xFFFF_0000, 1];

fn set(talon: &Talon, values: [u32; 5]) {
    for (parameter, value) in PARAMETERS.into_iter().zip(values) {
        talon.set_parameter(parameter, value).unwrap();
    }
}

fn get(talon: &Talon) -> [u32; 5] {
    PARAMETERS.map(|parameter| talon.parameter(parameter).unwrap())
}

/// A Talon with the old values in flash and the new ones in RAM, all of which the next save is to write: it comes
/// 15 s after the last one.
fn pending() -> (TalonBench, Talon) {
    let bench = TalonBench::new(&["talon:3"]);
    let talon = bench.talon(3);
    set(&talon, OLD);
    bench.run(31_000);
    // After 15 quiet seconds a change is saved at once.
    let saved = bench.truth(0).flash_writes;
    talon.set_parameter(Parameter::Slot0D, 7).unwrap();
    bench.run(14_000);
    let saved = saved + 1;
    assert_eq!(bench.truth(0).flash_writes, saved);
    set(&talon, NEW);
    assert_eq!(bench.truth(0).flash_writes, saved);
    (bench, talon)
}

#[test]
fn i6_row_54_every_cut_of_a_save_leaves_all_old_or_all_new_parameters() {
    let (bench, _) = pending();
    let writes = bench.truth(0).flash_writes;
    let mut written_after = 0;
    while bench.truth(0).flash_writes == writes {
        bench.run(1);
        written_after += 1000;
        assert!(written_after < 2_000_000, "no save");
    }
    let (mut old, mut new) = (0, 0);
    for micros in (written_after - 4000..written_after + 1000).step_by(73) {
        let (bench, talon) = pending();
        bench.run_us(micros);
        bench.poke(0, Poke::Powered(false));
        bench.run(10);
        bench.poke(0, Poke::Powered(true));
        bench.run(300);
        match get(&talon) {
            OLD => old += 1,
            NEW => new += 1,
            mixed => panic!("cut {micros} µs after the change: {mixed:x?}"),
        }
    }
    assert!(old > 10 && new > 5, "{old} old, {new} new");
}
