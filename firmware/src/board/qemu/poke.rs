//! Pokes as text: a name and a whole number, `battery_mv 5000`, one to a line.
//!
//! The names are those of the bench's JSON interface with the unit spelt out. `release` in place of a
//! number gives a forced quantity back to the plant.

use windlass_sim::Poke;

/// Reads a line.
pub(super) fn parse(line: &[u8]) -> Option<Poke> {
    let (name, value) = core::str::from_utf8(line).ok()?.split_once(' ')?;
    let number = value.parse::<i32>();
    let flag = || match number {
        Ok(0) => Some(false),
        Ok(1) => Some(true),
        _ => None,
    };
    let milli = || match (value, &number) {
        ("release", _) => Some(None),
        (_, Ok(number)) => Some(Some(f64::from(*number) / 1000.0)),
        _ => None,
    };
    Some(match name {
        "fwd_limit_closed" => Poke::ForwardLimitClosed(flag()?),
        "rev_limit_closed" => Poke::ReverseLimitClosed(flag()?),
        "battery_mv" => Poke::BatteryVolts(milli()?),
        "temp_millicelsius" => Poke::TemperatureCelsius(milli()?),
        "load_mnm" => Poke::LoadNewtonMetres(milli()??),
        "stall" => Poke::Stall(flag()?),
        "encoder_unplugged" => Poke::EncoderUnplugged(flag()?),
        "short_circuit" => Poke::ShortCircuit(flag()?),
        "gate_driver_fault" => Poke::GateDriverFault(flag()?),
        _ => return None,
    })
}
