//! The transport string: one syntax for every place where a bus is named.

use std::fmt;
use std::str::FromStr;

use windlass_sim::NodeSpec;

use super::slcan::{BIT_RATES, bit_rate_list};
use super::{Bus, BusError, SimBus, SlcanBus};

/// Bit rate of the DMC60C's bus.
const DEFAULT_BIT_RATE: u32 = 1_000_000;
/// The node of a simulated bus when none is named.
const DEFAULT_NODE: &str = "dmc60c:1";
/// Longest interface name of Linux.
const LONGEST_INTERFACE: usize = 15;

/// A parsed transport string.
///
/// | string | bus |
/// |---|---|
/// | `sim`, `sim:dmc60c:5,dmc60c:6` | a simulated bus inside this process, with these nodes |
/// | `slcan:DEVICE[@BITRATE]` | SLCAN adapter at a serial port or pty |
/// | `tcp:HOST:PORT` | SLCAN over TCP |
/// | `socketcan:INTERFACE` | CAN interface of Linux |
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum Transport {
    /// Simulated bus in this process, in virtual time.
    Sim(Vec<NodeSpec>),
    /// SLCAN over a serial port.
    Slcan {
        /// Path of the port.
        path: String,
        /// CAN bit rate in bit/s.
        bit_rate: u32,
    },
    /// SLCAN over TCP.
    Tcp {
        /// Host name or address.
        host: String,
        /// TCP port.
        port: u16,
    },
    /// Linux CAN interface.
    SocketCan(String),
}

impl Transport {
    /// Opens the bus.
    ///
    /// # Errors
    /// The device, host or interface cannot be opened.
    pub fn open(&self) -> Result<Box<dyn Bus>, BusError> {
        match self {
            Self::Sim(nodes) => Ok(Box::new(SimBus::with_nodes(nodes))),
            Self::Slcan { path, bit_rate } => Ok(Box::new(SlcanBus::serial(path, *bit_rate)?)),
            Self::Tcp { host, port } => Ok(Box::new(SlcanBus::tcp(host, *port)?)),
            Self::SocketCan(interface) => open_socketcan(interface),
        }
    }

    /// True if time on this bus is virtual: waiting costs no real time.
    #[must_use]
    pub const fn is_virtual(&self) -> bool {
        matches!(self, Self::Sim(_))
    }
}

#[cfg(target_os = "linux")]
fn open_socketcan(interface: &str) -> Result<Box<dyn Bus>, BusError> {
    Ok(Box::new(super::SocketCanBus::open(interface)?))
}

#[cfg(not(target_os = "linux"))]
fn open_socketcan(interface: &str) -> Result<Box<dyn Bus>, BusError> {
    Err(BusError::Open {
        what: format!("CAN interface {interface}"),
        reason: "SocketCAN exists on Linux only".to_owned(),
        next: "use slcan: or tcp: instead".to_owned(),
    })
}

impl FromStr for Transport {
    type Err = BusError;

    fn from_str(text: &str) -> Result<Self, BusError> {
        let (scheme, rest) = match text.split_once(':') {
            Some((scheme, rest)) => (scheme, Some(rest)),
            None => (text, None),
        };
        let parsed = match (scheme, rest) {
            ("sim", nodes) => parse_sim(nodes),
            ("slcan", Some(rest)) => parse_slcan(rest),
            ("tcp", Some(rest)) => parse_tcp(rest),
            ("socketcan", Some(rest)) => parse_socketcan(rest),
            ("slcan" | "tcp" | "socketcan", None) => {
                Err(format!("what to open is missing after \"{scheme}:\""))
            }
            _ => Err(format!("there is no transport \"{scheme}\"")),
        };
        parsed.map_err(|reason| bad(text, reason))
    }
}

impl fmt::Display for Transport {
    fn fmt(&self, out: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Sim(nodes) => {
                let names: Vec<String> = nodes.iter().map(NodeSpec::to_string).collect();
                write!(out, "sim:{}", names.join(","))
            }
            Self::Slcan { path, bit_rate } => write!(out, "slcan:{path}@{bit_rate}"),
            Self::Tcp { host, port } if host.contains(':') => write!(out, "tcp:[{host}]:{port}"),
            Self::Tcp { host, port } => write!(out, "tcp:{host}:{port}"),
            Self::SocketCan(interface) => write!(out, "socketcan:{interface}"),
        }
    }
}

fn bad(text: &str, reason: impl Into<String>) -> BusError {
    BusError::BadTransport {
        text: text.to_owned(),
        reason: reason.into(),
    }
}

fn parse_sim(nodes: Option<&str>) -> Result<Transport, String> {
    let nodes = nodes.unwrap_or(DEFAULT_NODE).split(',');
    let parsed: Result<Vec<NodeSpec>, _> = nodes.map(str::parse).collect();
    parsed
        .map(Transport::Sim)
        .map_err(|error| error.to_string())
}

/// The part after the last `@` is the bit rate, unless it contains a `/` and so belongs to the path.
fn parse_slcan(rest: &str) -> Result<Transport, String> {
    let (path, bit_rate) = match rest.rsplit_once('@') {
        Some((path, rate)) if !rate.contains('/') => (path, parse_bit_rate(rate)?),
        _ => (rest, DEFAULT_BIT_RATE),
    };
    if path.is_empty() {
        return Err("the serial port is missing".to_owned());
    }
    Ok(Transport::Slcan {
        path: path.to_owned(),
        bit_rate,
    })
}

fn parse_bit_rate(text: &str) -> Result<u32, String> {
    let rate = text.parse().ok().filter(|rate| BIT_RATES.contains(rate));
    rate.ok_or_else(|| {
        format!(
            "\"{text}\" is no bit rate of SLCAN; it knows {}",
            bit_rate_list()
        )
    })
}

fn parse_tcp(rest: &str) -> Result<Transport, String> {
    let (host, port) = rest.rsplit_once(':').ok_or("the port is missing")?;
    let host = host
        .strip_prefix('[')
        .and_then(|host| host.strip_suffix(']'))
        .unwrap_or(host);
    if host.is_empty() {
        return Err("the host is missing".to_owned());
    }
    let number = port.parse().ok().filter(|port| *port != 0);
    let port = number.ok_or_else(|| format!("\"{port}\" is no TCP port (1 to 65535)"))?;
    Ok(Transport::Tcp {
        host: host.to_owned(),
        port,
    })
}

fn parse_socketcan(interface: &str) -> Result<Transport, String> {
    let valid = |letter: char| letter.is_ascii_graphic() && letter != '/';
    if interface.is_empty() || interface.len() > LONGEST_INTERFACE || !interface.chars().all(valid)
    {
        return Err(format!(
            "\"{interface}\" is no interface name (1 to {LONGEST_INTERFACE} letters, no spaces or slashes)"
        ));
    }
    Ok(Transport::SocketCan(interface.to_owned()))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn strings_are_understood_and_written_again() {
        for (text, canonical) in [
            ("sim", "sim:dmc60c:1"),
            ("sim:dmc60c:5,dmc60c:6", "sim:dmc60c:5,dmc60c:6"),
            ("slcan:/dev/ttyACM0", "slcan:/dev/ttyACM0@1000000"),
            ("slcan:/dev/ttyACM0@500000", "slcan:/dev/ttyACM0@500000"),
            ("slcan:/dev/by@id/port", "slcan:/dev/by@id/port@1000000"),
            ("slcan:COM3", "slcan:COM3@1000000"),
            ("tcp:localhost:4000", "tcp:localhost:4000"),
            ("tcp:[::1]:4000", "tcp:[::1]:4000"),
            ("tcp:::1:4000", "tcp:[::1]:4000"),
            ("socketcan:can0", "socketcan:can0"),
        ] {
            let transport: Transport = text.parse().unwrap();
            assert_eq!(transport.to_string(), canonical);
            assert_eq!(canonical.parse::<Transport>().unwrap(), transport);
        }
    }

    #[test]
    fn bad_strings_are_refused_with_the_reason() {
        for (text, reason) in [
            ("", "no transport"),
            ("usb", "no transport \"usb\""),
            ("SIM", "no transport"),
            ("sim:", "no dialect"),
            ("sim:dmc60c:64", "64"),
            ("sim:dmc60c:1,", "no dialect"),
            ("sim:dmc99:1", "dmc99"),
            ("slcan", "missing"),
            ("slcan:", "serial port is missing"),
            ("slcan:@1000000", "serial port is missing"),
            ("slcan:/dev/ttyACM0@fast", "no bit rate"),
            ("slcan:/dev/ttyACM0@", "no bit rate"),
            ("slcan:/dev/ttyACM0@1000001", "no bit rate"),
            ("tcp:", "port is missing"),
            ("tcp:localhost", "port is missing"),
            ("tcp::4000", "host is missing"),
            ("tcp:localhost:", "no TCP port"),
            ("tcp:localhost:0", "no TCP port"),
            ("tcp:localhost:65536", "no TCP port"),
            ("socketcan:", "no interface name"),
            ("socketcan:an/interface", "no interface name"),
            ("socketcan:averyverylongname", "no interface name"),
        ] {
            let error = text.parse::<Transport>().unwrap_err();
            assert!(error.to_string().contains(reason), "{text}: {error}");
            assert!(!error.next_step().is_empty());
        }
    }
}
