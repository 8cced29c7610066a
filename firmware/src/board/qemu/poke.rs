//! Pokes as text: a name and a whole number, `battery_mv 5000`, one to a line.
//!
//! The names are those of the bench's JSON interface with the unit spelt out. `release` in place of a
//! number gives a forced quantity back to the plant.

use windlass_sim::RigPoke;

/// Reads a line.
pub(super) fn parse(line: &[u8]) -> Option<RigPoke> {
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
        "fwd_limit_closed" => RigPoke::ForwardLimitClosed(flag()?),
        "rev_limit_closed" => RigPoke::ReverseLimitClosed(flag()?),
        "battery_mv" => RigPoke::BatteryVolts(milli()?),
        "temp_millicelsius" => RigPoke::TemperatureCelsius(milli()?),
        "load_mnm" => RigPoke::LoadNewtonMetres(milli()??),
        "stall" => RigPoke::Stall(flag()?),
        "encoder_unplugged" => RigPoke::EncoderUnplugged(flag()?),
        "short_circuit" => RigPoke::ShortCircuit(flag()?),
        "gate_driver_fault" => RigPoke::GateDriverFault(flag()?),
        _ => return None,
    })
}
