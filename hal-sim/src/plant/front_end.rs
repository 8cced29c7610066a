//! Analog front end: amplifiers, dividers and the 12-bit converter of the reference board.

use crate::random::Random;

/// Full scale of the converter in V.
const REFERENCE: f64 = 3.3;
/// Steps of the converter.
const STEPS: f64 = 4096.0;
/// Largest conversion.
const RAIL: f64 = 4095.0;

/// The analog inputs of a controller.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct FrontEnd {
    /// Current shunt in Ω.
    pub shunt: f64,
    /// Gain of the current-sense amplifier in V/V.
    pub current_gain: f64,
    /// Its output without current in V.
    pub current_bias: f64,
    /// Standard deviation of the noise on a current conversion in steps of the converter.
    pub current_noise: f64,
    /// Bus voltage per volt at the converter.
    pub bus_divider: f64,
    /// Temperature sensor at 0 °C in V.
    pub temperature_bias: f64,
    /// Temperature sensor in V/K.
    pub temperature_slope: f64,
}

impl Default for FrontEnd {
    /// The DMC60C: amplifier of 50 V/V biased at 1.65 V (guide, paramAdcCurrentMultiplier) over the
    /// 510.1 µΩ that belong to the default multiplier 0x816 (`docs/dmc60c.md`, decision 28), about one
    /// step of noise as on a real converter next to a switching bridge. Bus divider 11:1 (36.3 V full
    /// scale) and a TMP36-like sensor (0.5 V at 0 °C, 10 mV/K) are this project's reference board.
    fn default() -> Self {
        Self {
            shunt: 510.1e-6,
            current_gain: 50.0,
            current_bias: 1.65,
            current_noise: 0.8,
            bus_divider: 11.0,
            temperature_bias: 0.5,
            temperature_slope: 0.010,
        }
    }
}

/// The front end with everything multiplied out to converter steps.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Converter {
    current_scale: f64,
    current_zero: f64,
    current_noise: f64,
    bus_scale: f64,
    temperature_scale: f64,
    temperature_zero: f64,
}

impl Converter {
    pub(crate) fn new(front_end: &FrontEnd) -> Self {
        let per_volt = STEPS / REFERENCE;
        Self {
            current_scale: front_end.shunt * front_end.current_gain * per_volt,
            current_zero: front_end.current_bias * per_volt,
            current_noise: front_end.current_noise,
            bus_scale: per_volt / front_end.bus_divider,
            temperature_scale: front_end.temperature_slope * per_volt,
            temperature_zero: front_end.temperature_bias * per_volt,
        }
    }

    /// Motor current in A.
    pub(crate) fn current(&self, amperes: f64, random: &mut Random) -> u16 {
        let noise = match self.current_noise {
            0.0 => 0.0,
            deviation => deviation * random.bell(),
        };
        convert(self.current_zero + self.current_scale * amperes + noise)
    }

    /// Bus voltage in V.
    pub(crate) fn bus_voltage(&self, volts: f64) -> u16 {
        convert(self.bus_scale * volts)
    }

    /// Case temperature in °C.
    pub(crate) fn temperature(&self, celsius: f64) -> u16 {
        convert(self.temperature_zero + self.temperature_scale * celsius)
    }

    /// Voltage at AIN1 in V.
    pub(crate) fn analog_in(&self, volts: f64) -> u16 {
        convert(volts * (STEPS / REFERENCE))
    }
}

/// Nearest step, saturated at the rails.
fn convert(steps: f64) -> u16 {
    (steps + 0.5).clamp(0.0, RAIL) as u16
}

#[cfg(test)]
mod tests {
    use super::*;

    fn quiet() -> Converter {
        Converter::new(&FrontEnd {
            current_noise: 0.0,
            ..FrontEnd::default()
        })
    }

    #[test]
    fn current_follows_the_guides_formula_and_saturates() {
        // (sample − zero) × 0x816 / 65536 amperes.
        let mut random = Random::new(1, 1);
        let amperes = |sample: u16| (f64::from(sample) - 2048.0) * f64::from(0x816) / 65536.0;
        for current in [-60.0, -20.0, 0.0, 0.5, 20.0, 60.0] {
            let measured = amperes(quiet().current(current, &mut random));
            assert!((measured - current).abs() < 0.03, "{current}: {measured}");
        }
        assert_eq!(quiet().current(131.0, &mut random), 4095);
        assert_eq!(quiet().current(-131.0, &mut random), 0);
    }

    #[test]
    fn noise_is_about_one_step() {
        let converter = Converter::new(&FrontEnd::default());
        let mut random = Random::new(1, 1);
        let samples: Vec<f64> = (0..10_000)
            .map(|_| f64::from(converter.current(0.0, &mut random)) - 2048.0)
            .collect();
        let mean = samples.iter().sum::<f64>() / 1e4;
        let variance = samples.iter().map(|value| value * value).sum::<f64>() / 1e4;
        assert!(mean.abs() < 0.05, "{mean}");
        assert!((0.6..1.1).contains(&variance.sqrt()), "{variance}");
        assert!(samples.iter().all(|value| value.abs() <= 4.0));
    }

    #[test]
    fn voltage_and_temperature_follow_the_reference_board() {
        assert_eq!(quiet().bus_voltage(12.1), 1365);
        assert_eq!(quiet().bus_voltage(40.0), 4095);
        assert_eq!(quiet().temperature(25.0), 931);
        assert_eq!(quiet().analog_in(1.65), 2048);
        assert_eq!(quiet().analog_in(-1.0), 0);
    }
}
