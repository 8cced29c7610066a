//! How the user names a device.

use std::fmt;
use std::str::FromStr;

use windlass_core::dialect::DialectKind;
use windlass_core::management::identity::Manufacturer;
use windlass_core::management::wire::MAX_DEVICE_NUMBER;

use super::Address;

/// A device by number, session or both: `5`, `talon:5`, `@0x1234`, `dmc60c:0@0x1234`. With a dialect the device
/// has to be driven by it; numbers of different dialects do not clash.
///
/// The session tells devices with the same number apart. It is written as hexadecimal with `0x` or as
/// decimal; 0 never names a session.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Selector {
    /// Driving dialect, if given.
    pub dialect: Option<DialectKind>,
    /// Device number, if given.
    pub number: Option<u8>,
    /// Session, if given.
    pub session: Option<u16>,
}

/// Why a selector makes no sense.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
#[error("{0}; write a device as 5, dmc60c:5, talon:5, @0x1234 or 5@0x1234")]
pub struct SelectorError(String);

impl Selector {
    /// True if devices of this manufacturer may be meant.
    pub(super) fn allows(&self, manufacturer: Manufacturer) -> bool {
        self.dialect
            .is_none_or(|dialect| dialect.identity().manufacturer == manufacturer)
    }

    /// True if the selector names this address. Of the dialect only the manufacturer is looked at.
    #[must_use]
    pub fn matches(&self, address: Address) -> bool {
        self.allows(address.manufacturer)
            && self.number.is_none_or(|number| number == address.number)
            && self
                .session
                .is_none_or(|session| session == address.session)
    }
}

impl From<Address> for Selector {
    fn from(address: Address) -> Self {
        Self {
            dialect: address.dialect(),
            number: Some(address.number),
            session: Some(address.session),
        }
    }
}

impl FromStr for Selector {
    type Err = SelectorError;

    fn from_str(text: &str) -> Result<Self, SelectorError> {
        let (node, session) = match text.split_once('@') {
            Some((node, session)) => (node, Some(parse_session(session)?)),
            None => (text, None),
        };
        let (dialect, number) = match (node.is_empty(), session) {
            (true, None) => return Err(SelectorError("the device is missing".to_owned())),
            (true, Some(_)) => (None, None),
            (false, _) => {
                let (dialect, number) = parse_node(node)?;
                (dialect, Some(number))
            }
        };
        Ok(Self {
            dialect,
            number,
            session,
        })
    }
}

impl fmt::Display for Selector {
    fn fmt(&self, out: &mut fmt::Formatter<'_>) -> fmt::Result {
        if let Some(number) = self.number {
            if let Some(dialect) = self.dialect {
                write!(out, "{}:", dialect.name())?;
            }
            write!(out, "{number}")?;
        }
        if let Some(session) = self.session {
            write!(out, "@{session:#06x}")?;
        }
        Ok(())
    }
}

/// The number, after a dialect's name if there is one.
fn parse_node(node: &str) -> Result<(Option<DialectKind>, u8), SelectorError> {
    let (dialect, digits) = match node.split_once(':') {
        Some((name, digits)) => {
            let dialect = DialectKind::from_name(name)
                .ok_or_else(|| SelectorError(format!("there is no dialect \"{name}\"")))?;
            (Some(dialect), digits)
        }
        None => (None, node),
    };
    let largest = dialect.map_or(MAX_DEVICE_NUMBER, |dialect| dialect.identity().last_number);
    let number = digits.parse().ok().filter(|number| *number <= largest);
    let number = number.ok_or_else(|| {
        SelectorError(format!("\"{digits}\" is no device number (0 to {largest})"))
    })?;
    Ok((dialect, number))
}

fn parse_session(text: &str) -> Result<u16, SelectorError> {
    let parsed = match text.strip_prefix("0x").or_else(|| text.strip_prefix("0X")) {
        Some(digits) => u16::from_str_radix(digits, 16),
        None => text.parse(),
    };
    let session = parsed.ok().filter(|session| *session != 0);
    session.ok_or_else(|| SelectorError(format!("\"{text}\" is no session (0x0001 to 0xffff)")))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn every_form_is_understood() {
        let dmc60c = Some(DialectKind::Dmc60c);
        for (text, dialect, number, session) in [
            ("5", None, Some(5), None),
            ("0", None, Some(0), None),
            ("dmc60c:63", dmc60c, Some(63), None),
            ("@0x1234", None, None, Some(0x1234)),
            ("@4660", None, None, Some(0x1234)),
            ("dmc60c:0@0xffff", dmc60c, Some(0), Some(0xFFFF)),
            ("7@0XABCD", None, Some(7), Some(0xABCD)),
        ] {
            let selector: Selector = text.parse().unwrap();
            let expected = Selector {
                dialect,
                number,
                session,
            };
            assert_eq!(selector, expected, "{text}");
            assert_eq!(selector.to_string().parse::<Selector>().unwrap(), selector);
        }
    }

    #[test]
    fn nonsense_is_refused_with_the_reason() {
        for (text, reason) in [
            ("", "missing"),
            ("64", "no device number"),
            ("talon:63", "no device number (0 to 62)"),
            ("-1", "no device number"),
            ("x", "no device number"),
            ("dmc60c:", "no device number"),
            ("pump:5", "no dialect"),
            ("5@", "no session"),
            ("5@0", "no session"),
            ("@0x10000", "no session"),
            ("@abcd", "no session"),
        ] {
            let error = text.parse::<Selector>().unwrap_err();
            assert!(error.to_string().contains(reason), "{text}: {error}");
        }
    }

    #[test]
    fn a_selector_matches_what_it_names() {
        let address = Address {
            number: 5,
            session: 0x1234,
            manufacturer: Manufacturer::CrossTheRoad,
        };
        for (text, matches) in [
            ("5", true),
            ("talon:5", true),
            ("dmc60c:5", false),
            ("4", false),
            ("@0x1234", true),
            ("@0x1235", false),
            ("4@0x1234", false),
        ] {
            assert_eq!(text.parse::<Selector>().unwrap().matches(address), matches);
        }
    }
}
