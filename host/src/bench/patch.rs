//! The fields of `PATCH /api/sim/nodes/{id}`.

use serde_json::{Map, Value};
use windlass_sim::Poke;

use super::http::Refusal;
use super::json::Fields;

/// Largest voltage on AIN1; its conversion ends at 3.3 V.
const LARGEST_ANALOG_V: f64 = 5.0;
/// Largest battery voltage; the conversion of the bus voltage ends at 36.3 V.
const LARGEST_BATTERY_V: f64 = 40.0;
/// Temperatures that the sensor can tell.
const TEMPERATURES_C: (f64, f64) = (-40.0, 150.0);
/// Largest torque on the shaft, many times a CIM motor's 2.41 N·m at stall.
const LARGEST_LOAD_NM: f64 = 100.0;
/// Longest RC pulse: its period.
const LONGEST_PULSE_US: u64 = 20_000;

/// A request that is right as a whole.
#[derive(Debug)]
pub(super) struct Patch {
    /// What to do, in this order.
    pub(super) pokes: Vec<Poke>,
    /// Fields that stay in force and show nowhere else in the node's state; null ends one.
    pub(super) held: Map<String, Value>,
}

/// Reads a whole request; nothing of it may be applied unless every field is right.
pub(super) fn parse(body: &[u8]) -> Result<Patch, Refusal> {
    let mut fields = Fields::parse(body)?;
    let mut patch = Patch {
        pokes: Vec::new(),
        held: Map::new(),
    };
    patch.read_switches(&mut fields)?;
    patch.read_levels(&mut fields)?;
    patch.read_connections(&mut fields)?;
    fields.finish()?;
    Ok(patch)
}

impl Patch {
    fn read_switches(&mut self, fields: &mut Fields) -> Result<(), Refusal> {
        let forward = fields.boolean("fwd_limit_closed")?;
        self.pokes.extend(forward.map(Poke::ForwardLimitClosed));
        let reverse = fields.boolean("rev_limit_closed")?;
        self.pokes.extend(reverse.map(Poke::ReverseLimitClosed));
        for (name, poke) in [
            ("stall", Poke::Stall as fn(bool) -> Poke),
            ("encoder_unplugged", Poke::EncoderUnplugged),
            ("short_circuit", Poke::ShortCircuit),
            ("gate_driver_fault", Poke::GateDriverFault),
            ("j1_loopback", Poke::J1Loopback),
            ("hang", Poke::Hang),
        ] {
            let value = fields.boolean(name)?;
            self.hold(name, value, poke);
        }
        Ok(())
    }

    fn read_levels(&mut self, fields: &mut Fields) -> Result<(), Refusal> {
        let index = fields.boolean_or_null("index_pin")?;
        self.hold("index_pin", index, Poke::IndexPin);
        let (coldest, hottest) = TEMPERATURES_C;
        for (name, range, unit, poke) in [
            (
                "analog_v",
                0.0..=LARGEST_ANALOG_V,
                "V",
                Poke::AnalogVolts as fn(Option<f64>) -> Poke,
            ),
            (
                "battery_v",
                0.0..=LARGEST_BATTERY_V,
                "V",
                Poke::BatteryVolts,
            ),
            ("temp_c", coldest..=hottest, "°C", Poke::TemperatureCelsius),
        ] {
            let value = fields.number_or_null(name, range, unit)?;
            self.hold(name, value, poke);
        }
        let load = fields.number("load_nm", -LARGEST_LOAD_NM..=LARGEST_LOAD_NM, "N·m")?;
        self.hold("load_nm", load, Poke::LoadNewtonMetres);
        let width = fields.integer_or_null("pulse_width_us", 0..=LONGEST_PULSE_US)?;
        self.hold("pulse_width_us", width, |width| {
            Poke::PulseWidthUs(width.map(|width| width as u16))
        });
        Ok(())
    }

    fn read_connections(&mut self, fields: &mut Fields) -> Result<(), Refusal> {
        let bus = fields.boolean("bus_connected")?;
        self.pokes.extend(bus.map(Poke::BusConnected));
        let press = fields.boolean("press_button")?;
        if press == Some(true) {
            self.pokes.push(Poke::Button);
        }
        let powered = fields.boolean("powered")?;
        self.pokes.extend(powered.map(Poke::Powered));
        Ok(())
    }

    fn hold<T: Copy + Into<Value>>(
        &mut self,
        name: &str,
        value: Option<T>,
        poke: impl FnOnce(T) -> Poke,
    ) {
        if let Some(value) = value {
            self.held.insert(name.to_owned(), value.into());
            self.pokes.push(poke(value));
        }
    }
}

#[cfg(test)]
mod tests {
    use serde_json::json;

    use super::*;

    #[test]
    fn every_field_becomes_its_poke() {
        let body = json!({
            "fwd_limit_closed": true, "rev_limit_closed": false, "stall": true,
            "encoder_unplugged": false, "short_circuit": true, "gate_driver_fault": true,
            "j1_loopback": true, "hang": true, "index_pin": true, "analog_v": 1.5, "battery_v": null,
            "temp_c": 110, "load_nm": -0.5, "pulse_width_us": 1700, "bus_connected": false,
            "press_button": true, "powered": false,
        });
        let patch = parse(body.to_string().as_bytes()).unwrap();
        let expected = [
            Poke::ForwardLimitClosed(true),
            Poke::ReverseLimitClosed(false),
            Poke::Stall(true),
            Poke::EncoderUnplugged(false),
            Poke::ShortCircuit(true),
            Poke::GateDriverFault(true),
            Poke::J1Loopback(true),
            Poke::Hang(true),
            Poke::IndexPin(Some(true)),
            Poke::AnalogVolts(Some(1.5)),
            Poke::BatteryVolts(None),
            Poke::TemperatureCelsius(Some(110.0)),
            Poke::LoadNewtonMetres(-0.5),
            Poke::PulseWidthUs(Some(1700)),
            Poke::BusConnected(false),
            Poke::Button,
            Poke::Powered(false),
        ];
        assert_eq!(patch.pokes, expected);
        assert_eq!(patch.held["battery_v"], Value::Null);
        assert_eq!(patch.held["load_nm"], json!(-0.5));
    }

    #[test]
    fn a_wrong_field_is_named() {
        for (body, name) in [
            (json!({ "stall": 1 }), "stall"),
            (json!({ "stall": null }), "stall"),
            (json!({ "battery_v": "12" }), "battery_v"),
            (json!({ "battery_v": 41 }), "battery_v"),
            (json!({ "temp_c": -41 }), "temp_c"),
            (json!({ "analog_v": -0.1 }), "analog_v"),
            (json!({ "load_nm": null }), "load_nm"),
            (json!({ "load_nm": 1e9 }), "load_nm"),
            (json!({ "pulse_width_us": 20_001 }), "pulse_width_us"),
            (json!({ "pulse_width_us": 1.5 }), "pulse_width_us"),
            (json!({ "index_pin": 0 }), "index_pin"),
            (json!({ "number": 5 }), "number"),
        ] {
            let refusal = format!("{:?}", parse(body.to_string().as_bytes()).unwrap_err());
            assert!(refusal.contains(&format!("\\\"{name}\\\"")), "{refusal}");
        }
    }
}
