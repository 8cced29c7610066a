//! The supply: a lead-acid battery behind its internal resistance.

/// A battery.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Battery {
    /// Capacity in A·s.
    pub capacity: f64,
    /// Open-circuit voltage when full, in V.
    pub voltage_full: f64,
    /// Open-circuit voltage when empty, in V.
    pub voltage_empty: f64,
    /// Resistance of cells and leads in Ω.
    pub resistance: f64,
}

impl Default for Battery {
    /// A 12 V sealed lead-acid battery of 16 A·h: 12.7 V full and 11.6 V empty at rest, nearly linear in
    /// between (common tables for AGM batteries at 25 °C), 11 mΩ internal resistance (data sheets of
    /// 17 to 18 A·h AGM batteries give 11 to 15 mΩ when new) and 2 mΩ for leads and connectors (0.5 m of
    /// 6 AWG each way is 1.3 mΩ).
    fn default() -> Self {
        Self {
            capacity: 16.0 * 3600.0,
            voltage_full: 12.7,
            voltage_empty: 11.6,
            resistance: 0.013,
        }
    }
}

/// A battery in use.
#[derive(Clone, Copy, Debug)]
pub(crate) struct BatteryState {
    battery: Battery,
    /// Charge taken out in A·s.
    drawn: f64,
    /// Open-circuit voltage forced from outside.
    forced: Option<f64>,
    volts_per_charge: f64,
}

impl BatteryState {
    /// A full battery.
    pub(crate) fn new(battery: Battery) -> Self {
        Self {
            battery,
            drawn: 0.0,
            forced: None,
            volts_per_charge: (battery.voltage_full - battery.voltage_empty) / battery.capacity,
        }
    }

    /// Forces the open-circuit voltage (V), or lets it follow the state of charge again.
    pub(crate) fn force(&mut self, voltage: Option<f64>) {
        self.forced = voltage;
    }

    pub(crate) fn resistance(&self) -> f64 {
        self.battery.resistance
    }

    /// Open-circuit voltage in V.
    pub(crate) fn open_circuit(&self) -> f64 {
        match self.forced {
            Some(voltage) => voltage,
            None => self.battery.voltage_full - self.volts_per_charge * self.drawn,
        }
    }

    /// Takes a current (A) for a time (s); a negative current charges up to full, no further.
    pub(crate) fn draw(&mut self, current: f64, seconds: f64) {
        self.drawn = (self.drawn + current * seconds).clamp(0.0, self.battery.capacity);
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn voltage_falls_with_the_charge() {
        let mut battery = BatteryState::new(Battery::default());
        assert!((battery.open_circuit() - 12.7).abs() < 1e-9);
        battery.draw(16.0, 1800.0);
        assert!((battery.open_circuit() - 12.15).abs() < 1e-9);
        battery.draw(-100.0, 1e6);
        assert!((battery.open_circuit() - 12.7).abs() < 1e-9);
    }

    #[test]
    fn a_forced_voltage_holds_until_it_is_released() {
        let mut battery = BatteryState::new(Battery::default());
        battery.force(Some(5.0));
        battery.draw(16.0, 1800.0);
        assert!((battery.open_circuit() - 5.0).abs() < 1e-9);
        battery.force(None);
        assert!((battery.open_circuit() - 12.15).abs() < 1e-9);
    }
}
