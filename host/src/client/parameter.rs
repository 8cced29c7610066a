//! Parameters: reading and writing them, and their values in engineering units.

use std::fmt;

use windlass_core::engine::snapshot::{Fault, Faults};
use windlass_core::frame::Frame;
use windlass_core::led::{Colour, Leds};
use windlass_core::management::vendor::ParameterError;
use windlass_core::management::wire::{ParameterRequest, ParameterResponse, ParameterSet, id};
use windlass_core::params::SettingsState;
use windlass_core::params::table::{Kind, Parameter, ParameterId, TABLE};
use windlass_core::reset::ResetCause;

use super::{ATTEMPTS, Address, Client, Error, ValueError};
use crate::transport::{Bus, BusError};

/// Full forward in throttle units; 100 %.
const FULL_THROTTLE: f64 = 32767.0;
/// One in 16.16.
const ONE: f64 = 65536.0;
/// One in 10.22.
const FINE_ONE: f64 = 4_194_304.0;

/// The value of a parameter, as its raw 32 bits with their meaning.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Value {
    /// Which parameter.
    pub parameter: ParameterId,
    /// The bits on the wire.
    pub raw: u32,
}

/// How a value is written for people.
#[derive(Clone, Copy, PartialEq, Eq)]
enum Form {
    Flag,
    Fixed,
    /// 10.22.
    Fine,
    Integer,
    Faults,
    Cause,
    Settings,
    Leds,
    Word,
}

fn form(row: &Parameter) -> Form {
    match row.id {
        ParameterId::ActiveFaults | ParameterId::StickyFaults => Form::Faults,
        ParameterId::ResetCause | ParameterId::CrashCause => Form::Cause,
        ParameterId::SettingsState => Form::Settings,
        ParameterId::Leds => Form::Leds,
        ParameterId::ResetDetail
        | ParameterId::ResetPlace
        | ParameterId::CrashDetail
        | ParameterId::CrashPlace => Form::Word,
        // 31-bit unsigned in the guide, but it limits an accumulator of 16.16 amperes.
        ParameterId::CurrentLimitIZone => Form::Fixed,
        _ => match row.kind {
            Kind::Flag => Form::Flag,
            Kind::Fixed | Kind::NonNegativeFixed => Form::Fixed,
            Kind::Unsigned10Q22 | Kind::Signed10Q22 => Form::Fine,
            Kind::Unsigned31 | Kind::Signed | Kind::Range(..) | Kind::Computed => Form::Integer,
        },
    }
}

/// The parameter with this number (decimal or `0x…`) or name; letter case and the guide's prefix
/// `param` do not matter.
///
/// # Errors
/// There is no such parameter; the text names similar ones.
pub fn find_parameter(text: &str) -> Result<&'static Parameter, ValueError> {
    let number = match text.strip_prefix("0x") {
        Some(digits) => u8::from_str_radix(digits, 16).ok(),
        None => text.parse().ok(),
    };
    let wanted = plain_name(text);
    let found = TABLE
        .iter()
        .find(|row| number == Some(row.id.code()) || plain_name(row.name) == wanted);
    found.ok_or_else(|| unknown_parameter(text, &wanted))
}

/// Whether a parameter is this project's own and so unknown to the vendor's firmware.
pub(crate) const fn is_own(row: &Parameter) -> bool {
    row.id.code() >= 128
}

fn plain_name(name: &str) -> String {
    let name = name.to_ascii_lowercase();
    name.strip_prefix("param").unwrap_or(&name).to_owned()
}

fn unknown_parameter(text: &str, wanted: &str) -> ValueError {
    let similar: Vec<&str> = TABLE
        .iter()
        .map(|row| row.name)
        .filter(|name| wanted.len() > 2 && plain_name(name).contains(wanted))
        .take(5)
        .collect();
    let hint = if similar.is_empty() {
        String::new()
    } else {
        format!(" (similar: {})", similar.join(", "))
    };
    ValueError::new(format!("there is no parameter \"{text}\"{hint}"))
}

impl Value {
    /// Reads what a user wrote: hexadecimal with `0x` is the raw value; everything else is in the
    /// parameter's unit, which may follow. Throttle units may be given in percent, flags as words.
    ///
    /// # Errors
    /// Not a number, not finite, or out of the parameter's range.
    pub fn parse(row: &Parameter, text: &str) -> Result<Self, ValueError> {
        let raw = match text.strip_prefix("0x") {
            Some(digits) => u32::from_str_radix(digits, 16)
                .map_err(|_| bad_value(row, text, "no 32-bit hexadecimal number"))?,
            None => parse_engineering(row, text)?,
        };
        if !row.kind.allows(raw) {
            return Err(bad_value(row, text, "out of range"));
        }
        Ok(Self {
            parameter: row.id,
            raw,
        })
    }

    /// The value of a 10.22 number.
    fn fine(self) -> f64 {
        match self.parameter.row().kind {
            Kind::Unsigned10Q22 => f64::from(self.raw) / FINE_ONE,
            _ => f64::from(self.raw as i32) / FINE_ONE,
        }
    }

    /// The value as a number in the parameter's unit.
    #[must_use]
    pub fn number(self) -> f64 {
        let signed = f64::from(self.raw as i32);
        match form(self.parameter.row()) {
            Form::Fixed => signed / ONE,
            Form::Fine => self.fine(),
            Form::Flag | Form::Integer | Form::Faults | Form::Cause | Form::Settings => signed,
            Form::Word | Form::Leds => f64::from(self.raw),
        }
    }
}

impl fmt::Display for Value {
    /// The value with its unit.
    fn fmt(&self, out: &mut fmt::Formatter<'_>) -> fmt::Result {
        let row = self.parameter.row();
        match form(row) {
            Form::Flag => return write!(out, "{}", self.raw),
            Form::Faults => return out.write_str(&fault_names(self.raw)),
            Form::Cause => return out.write_str(cause_name(self.raw)),
            Form::Settings => return out.write_str(settings_name(self.raw)),
            Form::Leds => return out.write_str(&leds_text(Leds::from_bits(self.raw))),
            Form::Word => return write!(out, "{:#x}", self.raw),
            Form::Fixed => out.write_str(&decimal(self.number(), 5))?,
            Form::Fine => out.write_str(&decimal(self.number(), 7))?,
            Form::Integer => write!(out, "{}", self.raw as i32)?,
        }
        if !row.unit.is_empty() {
            write!(out, " {}", row.unit)?;
        }
        Ok(())
    }
}

/// Five decimals tell every 16.16 number from its neighbours, seven every 10.22 number; zeros at the end
/// are dropped.
fn decimal(number: f64, places: usize) -> String {
    let text = format!("{number:.places$}");
    text.trim_end_matches('0').trim_end_matches('.').to_owned()
}

/// The faults of a fault word, by their names in the guide.
fn fault_names(word: u32) -> String {
    let faults = Faults::from_bits(word as u8);
    let names: Vec<&str> = Fault::ALL
        .into_iter()
        .filter(|fault| faults.contains(*fault))
        .map(fault_name)
        .collect();
    if names.is_empty() {
        "none".to_owned()
    } else {
        names.join(", ")
    }
}

/// What LEDs show, for people: a ring in one colour is told by that colour.
pub(crate) fn leds_text(leds: Option<Leds>) -> String {
    let Some(Leds { ring, brake }) = leds else {
        return "?".to_owned();
    };
    let names = ring.map(Colour::name);
    let ring = match names {
        [first, rest @ ..] if rest.iter().all(|name| *name == first) => first.to_owned(),
        _ => names.join("/"),
    };
    format!("{ring}, brake {}", brake.name())
}

/// A reset cause by its name.
pub(crate) fn cause_name(code: u32) -> &'static str {
    u8::try_from(code)
        .ok()
        .and_then(ResetCause::from_code)
        .map_or("of a newer firmware", ResetCause::name)
}

/// The state of the stored settings by its name.
pub(crate) fn settings_name(code: u32) -> &'static str {
    SettingsState::ALL
        .into_iter()
        .find(|state| *state as u32 == code)
        .map_or("of a newer firmware", SettingsState::name)
}

/// A fault's name in the guide.
pub(crate) const fn fault_name(fault: Fault) -> &'static str {
    match fault {
        Fault::OverCurrent => "fltOverCurrent",
        Fault::OverTemperature => "fltOverTemp",
        Fault::UnderVoltage => "fltUnderVoltage",
        Fault::GateDriver => "fltGateDriver",
        Fault::Communication => "fltComm",
    }
}

fn parse_engineering(row: &Parameter, text: &str) -> Result<u32, ValueError> {
    if form(row) == Form::Flag {
        return parse_flag(row, text);
    }
    if let Some(percent) = text.strip_suffix('%') {
        if row.unit != "throttle" {
            return Err(bad_value(row, text, "not given in percent"));
        }
        let percent = finite(row, percent, text)?;
        return to_raw(row, text, (percent / 100.0 * FULL_THROTTLE).round());
    }
    let number = text.strip_suffix(row.unit).unwrap_or(text).trim_end();
    match form(row) {
        Form::Fixed => {
            let number = finite(row, number, text)?;
            to_raw(row, text, (number * ONE).round())
        }
        Form::Fine => {
            let raw = (finite(row, number, text)? * FINE_ONE).round();
            match row.kind {
                Kind::Unsigned10Q22 if (0.0..=f64::from(u32::MAX)).contains(&raw) => Ok(raw as u32),
                Kind::Unsigned10Q22 => Err(bad_value(row, text, "out of range")),
                _ => to_raw(row, text, raw),
            }
        }
        _ => match number.parse::<i64>() {
            Ok(number) => to_raw(row, text, number as f64),
            Err(_) => Err(bad_value(row, text, "no whole number")),
        },
    }
}

fn parse_flag(row: &Parameter, text: &str) -> Result<u32, ValueError> {
    match text.to_ascii_lowercase().as_str() {
        "1" | "on" | "true" | "yes" => Ok(1),
        "0" | "off" | "false" | "no" => Ok(0),
        _ => Err(bad_value(row, text, "no flag")),
    }
}

fn finite(row: &Parameter, number: &str, text: &str) -> Result<f64, ValueError> {
    let parsed = number.trim_end().parse::<f64>().ok();
    let parsed = parsed.filter(|number| number.is_finite());
    parsed.ok_or_else(|| bad_value(row, text, "no finite number"))
}

/// The 32 bits of a whole number; whether the parameter allows it is checked by the caller.
fn to_raw(row: &Parameter, text: &str, number: f64) -> Result<u32, ValueError> {
    if number < f64::from(i32::MIN) || number > f64::from(i32::MAX) {
        return Err(bad_value(row, text, "out of range"));
    }
    Ok(number as i32 as u32)
}

fn bad_value(row: &Parameter, text: &str, reason: &str) -> ValueError {
    ValueError::new(format!(
        "\"{text}\" is {reason} for {}; allowed: {}",
        row.name,
        allowed(row)
    ))
}

/// What a parameter takes, for messages.
fn allowed(row: &Parameter) -> String {
    let unit = if row.unit.is_empty() {
        String::new()
    } else {
        format!(" {}", row.unit)
    };
    match (form(row), row.kind) {
        (Form::Flag, _) => "0 or 1".to_owned(),
        (Form::Fixed, Kind::Fixed) => format!("-32768 to 32767.99998{unit}"),
        (Form::Fixed, _) => format!("0 to 32767.99998{unit}"),
        (Form::Fine, Kind::Unsigned10Q22) => format!("0 to 1023.9999998{unit}"),
        (Form::Fine, _) => format!("-512 to 511.9999998{unit}"),
        (_, Kind::Range(min, max)) => format!("{min} to {max}{unit}"),
        (_, Kind::Unsigned31) => format!("0 to 2147483647{unit}"),
        _ => format!("-2147483648 to 2147483647{unit}"),
    }
}

impl<B: Bus> Client<B> {
    /// Reads a parameter.
    ///
    /// # Errors
    /// No answer, or the device does not know the parameter.
    pub fn parameter(&mut self, address: Address, parameter: ParameterId) -> Result<Value, Error> {
        let request = ParameterRequest {
            session: address.session,
            parameter: parameter.code(),
        };
        self.ask(address, parameter, &request.emit(address.number), ATTEMPTS)
    }

    /// Writes a parameter and returns what the device answers: the value in force, or for the fault
    /// words and counts (51 to 57) the value before it was cleared.
    ///
    /// # Errors
    /// Value out of range, no answer, or the device refused.
    pub fn set_parameter(&mut self, address: Address, value: Value) -> Result<Value, Error> {
        let row = value.parameter.row();
        if !row.kind.allows(value.raw) {
            return Err(bad_value(row, &value.to_string(), "out of range").into());
        }
        let request = ParameterSet {
            session: address.session,
            parameter: value.parameter.code(),
            value: value.raw,
        };
        // Writing again a count that was cleared would answer 0 instead of what was cleared.
        let attempts = match row.kind {
            Kind::Computed => 1,
            _ => ATTEMPTS,
        };
        self.ask(
            address,
            value.parameter,
            &request.emit(address.number),
            attempts,
        )
    }

    /// What the LEDs show at this moment; `None` if the device does not answer at once.
    ///
    /// # Errors
    /// The bus failed.
    pub fn leds(&mut self, address: Address) -> Result<Option<Leds>, BusError> {
        let parameter = ParameterId::Leds;
        let request = ParameterRequest {
            session: address.session,
            parameter: parameter.code(),
        };
        let response = self.ask_once(address, parameter, &request.emit(address.number))?;
        let known = response.filter(|response| response.code == 0);
        Ok(known.and_then(|response| Leds::from_bits(response.value)))
    }

    fn ask(
        &mut self,
        address: Address,
        parameter: ParameterId,
        request: &Frame,
        attempts: u32,
    ) -> Result<Value, Error> {
        for _ in 0..attempts {
            if let Some(response) = self.ask_once(address, parameter, request)? {
                return accept(address, parameter, response);
            }
        }
        Err(self.silence(address, parameter.row().name))
    }

    fn ask_once(
        &mut self,
        address: Address,
        parameter: ParameterId,
        request: &Frame,
    ) -> Result<Option<ParameterResponse>, BusError> {
        self.send(&address.frame(request))?;
        let maker = address.manufacturer;
        let identifier = maker.addressed(id::PARAMETER_RESPONSE, address.number);
        self.wait_for(self.answer_timeout, |frame| {
            (frame.extended_id() == Some(identifier))
                .then(|| ParameterResponse::parse(frame))
                .flatten()
                .filter(|response| response.parameter == parameter.code())
        })
    }
}

fn accept(
    address: Address,
    parameter: ParameterId,
    response: ParameterResponse,
) -> Result<Value, Error> {
    const BAD_PARAMETER: u8 = ParameterError::BadParameter as u8;
    const BAD_VALUE: u8 = ParameterError::BadValue as u8;
    let code = match response.code {
        0 => {
            return Ok(Value {
                parameter,
                raw: response.value,
            });
        }
        BAD_PARAMETER => "percBadParameter".to_owned(),
        BAD_VALUE => "percBadValue".to_owned(),
        other => format!("unknown code {other}"),
    };
    Err(Error::Refused {
        address,
        request: parameter.row().name.to_owned(),
        code,
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn gains_of_10_22_are_read_and_shown_with_all_their_places() {
        let parse = |id: ParameterId, text: &str| Value::parse(id.row(), text);
        let value = parse(ParameterId::ThrottleSlot0P, "0.2").unwrap();
        assert_eq!(value.raw, 838_861);
        assert_eq!(value.to_string(), "0.2 throttle/count");
        let high = parse(ParameterId::ThrottleSlot0P, "1023.9999998 throttle/count").unwrap();
        assert_eq!(high.raw, u32::MAX);
        assert_eq!(high.to_string(), "1023.9999998 throttle/count");
        let signed = parse(ParameterId::ThrottleSlot1F, "-512").unwrap();
        assert_eq!(signed.raw, 0x8000_0000);
        assert_eq!(signed.number(), -512.0);
        for (id, text) in [
            (ParameterId::ThrottleSlot0P, "-0.1"),
            (ParameterId::ThrottleSlot0P, "1024"),
            (ParameterId::ThrottleSlot1F, "512"),
        ] {
            assert!(parse(id, text).is_err(), "{text}");
        }
    }

    fn parse(name: &str, text: &str) -> Result<u32, ValueError> {
        Value::parse(find_parameter(name).unwrap(), text).map(|value| value.raw)
    }

    fn show(name: &str, raw: u32) -> String {
        let parameter = find_parameter(name).unwrap().id;
        Value { parameter, raw }.to_string()
    }

    #[test]
    fn parameters_are_found_by_number_and_name() {
        for text in [
            "10",
            "0x0a",
            "paramClosedLoopPGainSlot0",
            "closedloopPGAINslot0",
        ] {
            assert_eq!(
                find_parameter(text).unwrap().id,
                ParameterId::Slot0P,
                "{text}"
            );
        }
        for text in ["", "0", "37", "256", "-1", "paramNothing"] {
            assert!(find_parameter(text).is_err(), "{text}");
        }
        let error = find_parameter("PGain").unwrap_err().to_string();
        assert!(error.contains("paramClosedLoopPGainSlot0"), "{error}");
    }

    #[test]
    fn values_are_read_in_their_unit_or_raw() {
        // Guide, paramClosedLoopFGainSlot0: 819.175 is 0x03332CCC (rounded down there, to nearest here).
        assert_eq!(parse("ClosedLoopFGainSlot0", "0x03332CCC"), Ok(0x0333_2CCC));
        assert_eq!(parse("ClosedLoopFGainSlot0", "819.175"), Ok(0x0333_2CCD));
        assert_eq!(parse("61", "40A"), Ok(40 << 16));
        assert_eq!(parse("61", "40 A"), Ok(40 << 16));
        assert_eq!(parse("10", "-1.5"), Ok(0xFFFE_8000));
        assert_eq!(parse("63", "500ms"), Ok(500));
        assert_eq!(parse("17", "50%"), Ok(16384));
        assert_eq!(parse("18", "-100%"), Ok(-32767_i32 as u32));
        assert_eq!(parse("41", "-12"), Ok(-12_i32 as u32));
        assert_eq!(parse("6", "on"), Ok(1));
        assert_eq!(parse("6", "False"), Ok(0));
        assert_eq!(parse("35", "332.783"), Ok(0x014C_C873));
    }

    #[test]
    fn nonsense_and_values_out_of_range_are_refused() {
        for (name, text) in [
            ("10", "NaN"),
            ("10", "inf"),
            ("10", "-inf"),
            ("10", "32768"),
            ("10", "-32768.1"),
            ("10", ""),
            ("10", "1.5x"),
            ("10", "50%"),
            ("10", "0x1FFFFFFFF"),
            ("61", "-1"),
            ("61", "0x80000000"),
            ("63", "65536"),
            ("63", "1.5"),
            ("17", "-1"),
            ("17", "101%"),
            ("17", "NaN%"),
            ("6", "2"),
            ("6", "0x2"),
            ("93", "51"),
            ("93", "0"),
            ("5", "2147483648"),
        ] {
            let error = parse(name, text).unwrap_err().to_string();
            assert!(error.contains("allowed: "), "{name} {text}: {error}");
        }
    }

    #[test]
    fn values_are_shown_with_their_unit() {
        assert_eq!(show("61", 40 << 16), "40 A");
        assert_eq!(show("9", 0x816), "0.03159 A/LSB");
        assert_eq!(show("18", -32768_i32 as u32), "-32768 throttle");
        assert_eq!(show("10", 0xFFFE_8000), "-1.5");
        assert_eq!(show("52", 0b10001), "fltOverCurrent, fltComm");
        assert_eq!(show("51", 0), "none");
        assert_eq!(show("35", 0x014C_C888), "332.78333 A");
        assert_eq!(show("130", 6), "panic");
        assert_eq!(show("130", 0x106), "of a newer firmware");
        assert_eq!(show("137", 0x1_4444), "green, brake red");
        assert_eq!(show("Leds", 0x0_0011), "red/red/off/off, brake off");
        assert_eq!(show("137", 0xF_0000), "?");
        assert_eq!(show("135", 0xDEAD_BEEF), "0xdeadbeef");
    }

    #[test]
    fn what_is_shown_reads_back_as_the_same_bits() {
        let named = |row: &&Parameter| {
            matches!(
                form(row),
                Form::Faults | Form::Cause | Form::Settings | Form::Leds
            )
        };
        for row in TABLE.iter().filter(|row| !named(row)) {
            for raw in [
                0,
                1,
                2,
                0x816,
                0x7FFF,
                0x1_2345,
                0x7FFF_FFFF,
                0x8000_0000,
                0xFFFF_FFFF,
            ] {
                if row.kind.allows(raw) {
                    let shown = Value {
                        parameter: row.id,
                        raw,
                    }
                    .to_string();
                    let read = Value::parse(row, &shown).unwrap();
                    assert_eq!(read.raw, raw, "{} {shown}", row.name);
                }
            }
        }
    }
}
