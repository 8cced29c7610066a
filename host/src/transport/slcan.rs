//! SLCAN (Lawicel text protocol) over a serial port, a pty or a TCP stream.

use std::collections::VecDeque;
use std::io::{self, Read, Write};
use std::net::{TcpStream, ToSocketAddrs};
use std::time::{Duration, Instant};

use windlass_core::frame::Frame;
use windlass_core::slcan::{self, Line, LineReader};

use super::{Bus, BusError, Flags, Health, Received};

/// Bit rates of the `S` command, in the order of its digit.
pub const BIT_RATES: [u32; 9] = [
    10_000, 20_000, 50_000, 100_000, 125_000, 250_000, 500_000, 800_000, 1_000_000,
];

/// Speed of a serial port in bit/s. USB adapters and ptys ignore it.
const SERIAL_SPEED: u32 = 115_200;
/// How long to wait for a TCP connection.
const CONNECT_TIMEOUT: Duration = Duration::from_secs(3);
/// Shortest wait that every operating system accepts as a read timeout.
const SHORTEST_WAIT: Duration = Duration::from_millis(1);
/// Longest time in which an adapter takes no byte at all before it counts as gone.
const LONGEST_STALL: Duration = Duration::from_secs(3);

/// A byte stream that can wait for data for a limited time.
pub trait Stream: Read + Write {
    /// Sets how long the next reads may wait; never zero.
    ///
    /// # Errors
    /// The operating system refuses.
    fn limit_wait(&mut self, timeout: Duration) -> io::Result<()>;
}

impl Stream for TcpStream {
    fn limit_wait(&mut self, timeout: Duration) -> io::Result<()> {
        self.set_read_timeout(Some(timeout))
    }
}

impl Stream for Box<dyn serialport::SerialPort> {
    fn limit_wait(&mut self, timeout: Duration) -> io::Result<()> {
        self.set_timeout(timeout).map_err(io::Error::from)
    }
}

/// A bus behind an SLCAN adapter.
#[derive(Debug)]
pub struct SlcanBus<S: Stream> {
    stream: S,
    name: String,
    lines: LineReader,
    ready: VecDeque<Received>,
    opened: Instant,
    /// What the adapter's answers to `F` said so far and how often its transmit queue was full; none
    /// before the first answer.
    told: Option<(Flags, u64)>,
}

impl SlcanBus<Box<dyn serialport::SerialPort>> {
    /// Opens a serial port or pty and the adapter's channel with `bit_rate`, one of [`BIT_RATES`].
    ///
    /// # Errors
    /// No such port, no permission, or the port is in use.
    pub fn serial(path: &str, bit_rate: u32) -> Result<Self, BusError> {
        let port = serialport::new(path, SERIAL_SPEED)
            .timeout(SHORTEST_WAIT)
            .open()
            .map_err(|error| serial_error(path, &error))?;
        Self::start(port, format!("serial port {path}"), bit_rate)
    }
}

impl SlcanBus<TcpStream> {
    /// Connects to an SLCAN server. The bit rate is the server's business; the `S` command asks for
    /// 1 Mbit/s.
    ///
    /// # Errors
    /// Unknown host, nobody listens, or no answer within three seconds.
    pub fn tcp(host: &str, port: u16) -> Result<Self, BusError> {
        let name = format!("{host}:{port}");
        let addresses = (host, port)
            .to_socket_addrs()
            .map_err(|error| BusError::Open {
                what: name.clone(),
                reason: format!("unknown host: {error}"),
                next: "check the spelling of the host, or give its IP address".to_owned(),
            })?;
        let mut last = io::Error::from(io::ErrorKind::AddrNotAvailable);
        for address in addresses {
            match TcpStream::connect_timeout(&address, CONNECT_TIMEOUT) {
                Ok(stream) => return Self::connected(stream, name),
                Err(error) => last = error,
            }
        }
        Err(tcp_error(name, &last))
    }

    fn connected(stream: TcpStream, name: String) -> Result<Self, BusError> {
        // Control frames must not wait for a full segment.
        let ready = stream
            .set_nodelay(true)
            .and_then(|()| stream.set_write_timeout(Some(CONNECT_TIMEOUT)));
        match ready {
            Ok(()) => Self::start(stream, name, 1_000_000),
            Err(source) => Err(BusError::Lost { what: name, source }),
        }
    }
}

impl<S: Stream> SlcanBus<S> {
    /// Closes the adapter's channel in case it was left open, sets the bit rate and opens it. Answers
    /// are not awaited: some adapters give none, and `C` on a closed channel is refused by most.
    fn start(stream: S, name: String, bit_rate: u32) -> Result<Self, BusError> {
        let digit = BIT_RATES.iter().position(|rate| *rate == bit_rate);
        let digit = digit.ok_or_else(|| bad_bit_rate(&name))?;
        let mut bus = Self {
            stream,
            name,
            lines: LineReader::new(),
            ready: VecDeque::new(),
            opened: Instant::now(),
            told: None,
        };
        bus.write(format!("\rC\rS{digit}\rO\r").as_bytes())?;
        Ok(bus)
    }

    fn write(&mut self, bytes: &[u8]) -> Result<(), BusError> {
        self.push_out(bytes).map_err(|source| self.lost(source))
    }

    /// Writes everything. A slow adapter takes a long transfer in parts, and a serial port's write gives
    /// up after the timeout that was last set for reading.
    fn push_out(&mut self, mut bytes: &[u8]) -> io::Result<()> {
        let mut progress = Instant::now();
        while !bytes.is_empty() {
            match self.stream.write(bytes) {
                Ok(0) => return Err(io::ErrorKind::WriteZero.into()),
                Ok(count) => {
                    bytes = bytes.get(count..).unwrap_or_default();
                    progress = Instant::now();
                }
                Err(error) if is_timeout(&error) && progress.elapsed() < LONGEST_STALL => {}
                Err(error) => return Err(error),
            }
        }
        self.stream.flush()
    }

    fn lost(&self, source: io::Error) -> BusError {
        BusError::Lost {
            what: self.name.clone(),
            source,
        }
    }

    /// Reads what is there or waits for it; false if nothing came in time.
    fn fill(&mut self, timeout: Duration) -> Result<bool, BusError> {
        let mut buffer = [0; 4096];
        let limited = self.stream.limit_wait(timeout.max(SHORTEST_WAIT));
        match limited.and_then(|()| self.stream.read(&mut buffer)) {
            Ok(0) => Err(self.lost(io::Error::from(io::ErrorKind::UnexpectedEof))),
            Ok(count) => {
                let at = self.now();
                for byte in buffer.iter().take(count) {
                    self.take(*byte, at);
                }
                Ok(true)
            }
            Err(error) if is_timeout(&error) => Ok(false),
            Err(error) => Err(self.lost(error)),
        }
    }

    /// Takes one byte. Of the lines that are no frames only the answer to `F` says something; a bell stands
    /// for a refused command and ends no line.
    fn take(&mut self, byte: u8, at: Duration) {
        if byte == slcan::BEL {
            self.lines.clear();
            return;
        }
        let Some(Line::Content(line)) = self.lines.push(byte) else {
            return;
        };
        if let Some((frame, _)) = slcan::parse(&line) {
            self.ready.push_back(Received { frame, at });
        } else if let Some(flags) = status_flags(&line) {
            let (before, tx_full) = self.told.unwrap_or_default();
            let full = flags & slcan::flag::TRANSMIT_QUEUE_FULL != 0;
            self.told = Some((Flags(before.0 | flags), tx_full + u64::from(full)));
        }
    }
}

/// The flags in an answer to `F`.
fn status_flags(line: &[u8]) -> Option<u8> {
    let [b'F', digits @ ..] = line else {
        return None;
    };
    let digits = std::str::from_utf8(digits).ok()?;
    (digits.len() == 2)
        .then(|| u8::from_str_radix(digits, 16).ok())
        .flatten()
}

impl<S: Stream> Bus for SlcanBus<S> {
    fn send(&mut self, frame: &Frame) -> Result<(), BusError> {
        self.write(&slcan::format(frame, None))
    }

    fn send_all(&mut self, frames: &[Frame]) -> Result<(), BusError> {
        let mut text = Vec::new();
        for frame in frames {
            text.extend(slcan::format(frame, None));
        }
        self.write(&text)
    }

    fn receive(&mut self, timeout: Duration) -> Result<Option<Received>, BusError> {
        let deadline = self.now() + timeout;
        while self.ready.is_empty() {
            let left = deadline.saturating_sub(self.now());
            let more = self.fill(left)?;
            if !more && self.now() >= deadline {
                break;
            }
        }
        Ok(self.ready.pop_front())
    }

    fn now(&self) -> Duration {
        self.opened.elapsed()
    }

    /// SLCAN has flags and no counters. An adapter that does not know `F` answers with a bell or not at all.
    fn health(&mut self) -> Result<Health, BusError> {
        self.write(b"F\r")?;
        let mut health = Health::default();
        if let Some((flags, tx_full)) = self.told {
            health.flags = flags;
            health.tx_full = Some(tx_full);
        }
        Ok(health)
    }
}

impl<S: Stream> Drop for SlcanBus<S> {
    fn drop(&mut self) {
        // The adapter may be gone already; there is nobody left to tell.
        let _ = self.stream.write_all(b"C\r");
        let _ = self.stream.flush();
    }
}

/// Interrupted calls (Ctrl-C) count as "nothing came", so that the caller looks at its own flags.
fn is_timeout(error: &io::Error) -> bool {
    matches!(
        error.kind(),
        io::ErrorKind::WouldBlock | io::ErrorKind::TimedOut | io::ErrorKind::Interrupted
    )
}

fn bad_bit_rate(name: &str) -> BusError {
    BusError::Open {
        what: name.to_owned(),
        reason: "SLCAN has no command for this bit rate".to_owned(),
        next: format!("use one of {}", bit_rate_list()),
    }
}

/// The bit rates that SLCAN knows, for messages.
pub(super) fn bit_rate_list() -> String {
    BIT_RATES.map(|rate| rate.to_string()).join(", ")
}

fn serial_error(path: &str, error: &serialport::Error) -> BusError {
    use serialport::ErrorKind;
    let next = match error.kind {
        ErrorKind::Io(io::ErrorKind::PermissionDenied) => {
            "add your user to the group of the port (often dialout) and log in again".to_owned()
        }
        ErrorKind::NoDevice | ErrorKind::Io(io::ErrorKind::NotFound) => known_ports(),
        _ => {
            "check that no other program has the port open and that it is a serial port".to_owned()
        }
    };
    BusError::Open {
        what: format!("serial port {path}"),
        reason: error.description.clone(),
        next,
    }
}

fn known_ports() -> String {
    let ports = serialport::available_ports().unwrap_or_default();
    let names: Vec<String> = ports.into_iter().map(|port| port.port_name).collect();
    if names.is_empty() {
        "plug the adapter in; no serial port was found on this machine".to_owned()
    } else {
        format!("plug the adapter in, or use one of {}", names.join(", "))
    }
}

fn tcp_error(name: String, error: &io::Error) -> BusError {
    let next = match error.kind() {
        io::ErrorKind::ConnectionRefused => format!(
            "nobody listens there: start the bench with `windlass sim --slcan {name}`, or check the port"
        ),
        _ => "check the address, and that no firewall is in the way".to_owned(),
    };
    BusError::Open {
        what: name,
        reason: error.to_string(),
        next,
    }
}
