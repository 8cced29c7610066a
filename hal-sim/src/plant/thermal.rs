//! Heat in the bridge.

/// The power stage of a controller.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Bridge {
    /// Resistance of the conducting path in Ω: two switches and the current shunt.
    pub resistance: f64,
    /// Resistance of a short circuit between the terminals in Ω, see the `short_circuit` poke.
    pub short_resistance: f64,
    /// Forward voltage of two free-wheeling diodes in V.
    pub diode_voltage: f64,
    /// Switching loss per ampere and volt: share of a period in which a switch sees current and voltage.
    pub switching_share: f64,
    /// Thermal resistance from case to ambient in K/W.
    pub thermal_resistance: f64,
    /// Heat capacity of the case in J/K.
    pub heat_capacity: f64,
    /// Ambient temperature in °C.
    pub ambient: f64,
}

impl Default for Bridge {
    /// A bridge that fits the DMC60C's ratings (60 A continuous without a fan): two switches of 1 mΩ and
    /// the guide's 0.51 mΩ shunt; 50 ns edges twice per 64 µs period; 60 A heat the case by about 21 K
    /// with a time constant of 2 minutes (80 g of aluminium with 0.9 J/(g·K), 1.7 K/W for its surface).
    /// The short circuit's 20 mΩ and the diodes' 2 × 0.7 V are typical figures.
    fn default() -> Self {
        Self {
            resistance: 2.0 * 0.001 + 0.000_51,
            short_resistance: 0.020,
            diode_voltage: 1.4,
            switching_share: 2.0 * 50e-9 / 64e-6,
            thermal_resistance: 1.7,
            heat_capacity: 72.0,
            ambient: 25.0,
        }
    }
}

/// Temperature of the case.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Thermal {
    celsius: f64,
    ambient: f64,
    forced: bool,
    /// K per W and tick.
    heating: f64,
    /// Share of the excess over ambient that is lost per tick.
    cooling: f64,
}

impl Thermal {
    /// A case at ambient temperature, advanced in steps of `step` seconds.
    pub(crate) fn new(bridge: &Bridge, step: f64) -> Self {
        let heating = step / bridge.heat_capacity;
        Self {
            celsius: bridge.ambient,
            ambient: bridge.ambient,
            forced: false,
            heating,
            cooling: heating / bridge.thermal_resistance,
        }
    }

    /// Case temperature in °C.
    pub(crate) fn celsius(&self) -> f64 {
        self.celsius
    }

    /// Holds the case at a temperature (°C), or lets it relax from there.
    pub(crate) fn force(&mut self, celsius: Option<f64>) {
        self.forced = celsius.is_some();
        if let Some(celsius) = celsius {
            self.celsius = celsius;
        }
    }

    /// One step with this loss in W. The explicit step is far below the time constant.
    pub(crate) fn advance(&mut self, loss: f64) {
        if !self.forced {
            self.celsius += self.heating * loss - self.cooling * (self.celsius - self.ambient);
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn after(seconds: f64, loss: f64) -> f64 {
        let mut thermal = Thermal::new(&Bridge::default(), 500e-6);
        for _ in 0..(seconds / 500e-6) as usize {
            thermal.advance(loss);
        }
        thermal.celsius()
    }

    #[test]
    fn the_case_settles_at_loss_times_resistance() {
        assert!((after(1200.0, 10.0) - (25.0 + 17.0)).abs() < 0.1);
        // One time constant: 63 %.
        assert!((after(72.0 * 1.7, 10.0) - (25.0 + 17.0 * 0.632)).abs() < 0.1);
        assert!((after(10.0, 0.0) - 25.0).abs() < 1e-9);
    }

    #[test]
    fn a_forced_temperature_holds_and_then_relaxes() {
        let mut thermal = Thermal::new(&Bridge::default(), 500e-6);
        thermal.force(Some(110.0));
        thermal.advance(100.0);
        assert!((thermal.celsius() - 110.0).abs() < 1e-9);
        thermal.force(None);
        thermal.advance(0.0);
        assert!(thermal.celsius() < 110.0);
        assert!(thermal.celsius() > 109.0);
    }
}
