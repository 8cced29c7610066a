//! Engineering units to and from what the Talon's frames carry, scaled as the published clients do.
//!
//! Source: Talon SRX Software Reference Manual 17, and docs/talon-srx-client.md. Everything that goes to the
//! device is truncated towards zero, as those clients do.

use windlass_core::field::{I24_MAX, I24_MIN};

use super::TalonError;

/// Full throttle (manual 17.5).
pub const FULL_THROTTLE: i32 = 1023;
/// Nominal battery of the ramp rates in volts per second.
const NOMINAL_VOLTS: f64 = 12.0;
/// One in the 10.22 format of the gains.
const ONE: f64 = 4_194_304.0;
/// One volt in the 8.8 format of a voltage demand.
const ONE_VOLT: f64 = 256.0;
/// Longest voltage ramp step, eight bits of throttle per 10 ms.
const LARGEST_RAMP: f64 = 255.0;

/// Duty demand of −1 to 1; beyond that it is full throttle. Not a number is neutral.
#[must_use]
pub fn duty(share: f64) -> i32 {
    let share = if share.is_nan() { 0.0 } else { share };
    (f64::from(FULL_THROTTLE) * share.clamp(-1.0, 1.0)) as i32
}

/// Share of full throttle, −1 to 1.
#[must_use]
pub fn share(throttle: i16) -> f64 {
    f64::from(throttle) / f64::from(FULL_THROTTLE)
}

/// Position or velocity demand in sensor units.
///
/// # Errors
/// Not finite, or beyond 24 bits.
pub fn sensor_demand(units: f64) -> Result<i32, TalonError> {
    whole(
        "set point",
        units.trunc(),
        f64::from(I24_MIN),
        f64::from(I24_MAX),
    )
}

/// Voltage demand in 8.8 format.
///
/// # Errors
/// Not finite, or beyond 24 bits.
pub fn voltage_demand(volts: f64) -> Result<i32, TalonError> {
    whole(
        "voltage",
        (volts * ONE_VOLT).trunc(),
        f64::from(I24_MIN),
        f64::from(I24_MAX),
    )
}

/// Voltage ramp in throttle units per 10 ms from volts per second of a 12 V battery; 0 is none
/// (manual 6 and 17.6).
///
/// # Errors
/// Negative, not finite, above 255 steps (300 V/s), or so slow that it would round to "no ramp" (below
/// 1.18 V/s): the published clients drive without a ramp then, which nobody who asks for a slow one wants.
pub fn voltage_ramp(volts_per_second: f64) -> Result<u8, TalonError> {
    let steps = volts_per_second * f64::from(FULL_THROTTLE) / NOMINAL_VOLTS / 100.0;
    let steps = ramp_steps("voltage ramp rate", volts_per_second, steps, LARGEST_RAMP)?;
    Ok(steps as u8)
}

/// Closed-loop ramp in throttle units per 1 ms from volts per second of a 12 V battery; 0 is none
/// (manual 17.7).
///
/// # Errors
/// As [`voltage_ramp`]; the slowest is 11.8 V/s, the fastest 1023 steps.
pub fn closed_loop_ramp(volts_per_second: f64) -> Result<i32, TalonError> {
    let steps = volts_per_second * f64::from(FULL_THROTTLE) / NOMINAL_VOLTS / 1000.0;
    ramp_steps(
        "closed-loop ramp rate",
        volts_per_second,
        steps,
        f64::from(FULL_THROTTLE),
    )
}

/// Volts per second of closed-loop ramp steps.
#[must_use]
pub fn closed_loop_rate(steps: f64) -> f64 {
    steps * 1000.0 * NOMINAL_VOLTS / f64::from(FULL_THROTTLE)
}

fn ramp_steps(what: &str, rate: f64, steps: f64, most: f64) -> Result<i32, TalonError> {
    let slowest = rate / steps;
    let too_slow = rate != 0.0 && steps < 1.0;
    if rate.is_finite() && rate >= 0.0 && !too_slow && steps.trunc() <= most {
        return Ok(steps as i32);
    }
    let slowest = if slowest.is_finite() { slowest } else { 0.0 };
    Err(TalonError::invalid(format!(
        "{what} {rate} V/s cannot be sent; allowed: 0 for none, or {slowest:.2} to {:.0} V/s",
        slowest * (most + 1.0)
    )))
}

/// A proportional, integral or derivative gain in unsigned 10.22 format.
///
/// # Errors
/// Not within 0 to 1023.
pub fn gain(value: f64) -> Result<i32, TalonError> {
    whole("gain", (value * ONE).trunc(), 0.0, 1023.0 * ONE)
}

/// A feed-forward gain in signed 10.22 format.
///
/// # Errors
/// Not within −512 to 511.9999998.
pub fn feed_forward(value: f64) -> Result<i32, TalonError> {
    whole(
        "feed-forward gain",
        (value * ONE).trunc(),
        f64::from(i32::MIN),
        f64::from(i32::MAX),
    )
}

/// A gain from its unsigned 10.22 bits.
#[must_use]
pub fn gain_from(raw: i32) -> f64 {
    f64::from(raw as u32) / ONE
}

/// A feed-forward gain from its signed 10.22 bits.
#[must_use]
pub fn feed_forward_from(raw: i32) -> f64 {
    f64::from(raw) / ONE
}

/// A whole number within bounds, both included; NaN never is.
fn whole(what: &str, number: f64, min: f64, max: f64) -> Result<i32, TalonError> {
    if number >= min && number <= max {
        // Gains above 511 use the sign bit: the device reads these bits as unsigned.
        return Ok(number as i64 as i32);
    }
    Err(TalonError::invalid(format!("{what} is out of range")))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn row_87_throttle_is_1023_at_full_and_0_at_neutral() {
        assert_eq!((duty(1.0), duty(-1.0), duty(0.0)), (1023, -1023, 0));
        assert_eq!((duty(0.5), duty(-0.5)), (511, -511));
        assert_eq!((duty(7.0), duty(f64::NAN)), (1023, 0));
        assert_eq!((share(1023), share(-1023)), (1.0, -1.0));
    }

    #[test]
    fn row_37_ramp_api_scales_volts_per_second() {
        assert_eq!(voltage_ramp(6.0).unwrap(), 5);
        assert_eq!(voltage_ramp(12.0).unwrap(), 10);
        assert_eq!(voltage_ramp(0.0).unwrap(), 0);
        assert_eq!(closed_loop_ramp(12.0).unwrap(), 1);
        assert_eq!(closed_loop_ramp(0.0).unwrap(), 0);
    }

    #[test]
    fn ramps_that_would_silently_be_another_are_refused() {
        // The published clients send 0 (no ramp) for the first and wrap the second to 0x55.
        for rate in [1.0, 400.0, -6.0, f64::NAN, f64::INFINITY] {
            assert!(voltage_ramp(rate).is_err(), "{rate}");
        }
        let text = voltage_ramp(1.0).unwrap_err().to_string();
        assert!(text.contains("1.17 to 300 V/s"), "{text}");
        assert!(closed_loop_ramp(6.0).is_err());
    }

    #[test]
    fn gains_are_10_22_and_truncate() {
        assert_eq!(gain(0.2).unwrap(), 838_860);
        assert_eq!(gain(1023.0).unwrap() as u32, 1023 << 22);
        assert_eq!(gain_from(gain(1023.0).unwrap()), 1023.0);
        assert_eq!(feed_forward(-512.0).unwrap(), i32::MIN);
        assert_eq!(feed_forward_from(i32::MIN), -512.0);
        for bad in [-0.1, 1023.1, f64::NAN] {
            assert!(gain(bad).is_err(), "{bad}");
        }
        assert!(feed_forward(512.0).is_err());
    }

    #[test]
    fn demands_truncate_towards_zero() {
        assert_eq!(voltage_demand(6.0).unwrap(), 1536);
        assert_eq!(sensor_demand(-2.9).unwrap(), -2);
        assert!(sensor_demand(1e9).is_err());
    }
}
