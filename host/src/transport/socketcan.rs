//! SocketCAN, the CAN interfaces of Linux.

use std::io;
use std::time::{Duration, Instant};

use embedded_can::Frame as _;
use socketcan::{CanFrame, CanSocket, Socket as _};
use windlass_core::frame::Frame;

use super::{Bus, BusError, Received};

/// `EAFNOSUPPORT`: the kernel has no CAN sockets.
const ADDRESS_FAMILY_NOT_SUPPORTED: i32 = 97;
/// `ENODEV`: no interface of that name.
const NO_SUCH_DEVICE: i32 = 19;
/// `ENETDOWN`: the interface is not up.
const NETWORK_IS_DOWN: i32 = 100;
/// `ENOBUFS`: the interface's transmit queue, ten frames long by default, is full.
const NO_BUFFER_SPACE: i32 = 105;
/// How long to wait for a place in that queue: about the time of two frames at 1 Mbit/s.
const QUEUE_PERIOD: Duration = Duration::from_micros(300);
/// Time without a place after which nobody on the bus can be there to acknowledge anything.
const LONGEST_STALL: Duration = Duration::from_secs(1);

/// A bus behind a CAN interface of the kernel.
#[derive(Debug)]
pub struct SocketCanBus {
    socket: CanSocket,
    interface: String,
    opened: Instant,
}

impl SocketCanBus {
    /// Opens an interface that is already configured and up.
    ///
    /// # Errors
    /// No CAN support in the kernel, or no such interface.
    pub fn open(interface: &str) -> Result<Self, BusError> {
        let socket = CanSocket::open(interface)
            .map_err(|error| open_error(interface, &without_can_support().unwrap_or(error)))?;
        Ok(Self {
            socket,
            interface: interface.to_owned(),
            opened: Instant::now(),
        })
    }

    fn failed(&self, error: io::Error) -> BusError {
        if error.raw_os_error() == Some(NETWORK_IS_DOWN) {
            return open_error(&self.interface, &error);
        }
        BusError::Lost {
            what: format!("CAN interface {}", self.interface),
            source: error,
        }
    }
}

impl Bus for SocketCanBus {
    fn send(&mut self, frame: &Frame) -> Result<(), BusError> {
        let frame = if frame.is_remote() {
            CanFrame::new_remote(frame.id(), frame.dlc())
        } else {
            CanFrame::new(frame.id(), frame.data())
        };
        let Some(frame) = frame else {
            return Err(self.failed(io::Error::from(io::ErrorKind::InvalidInput)));
        };
        let begin = Instant::now();
        loop {
            match self.socket.write_frame_insist(&frame) {
                Err(error)
                    if error.raw_os_error() == Some(NO_BUFFER_SPACE)
                        && begin.elapsed() < LONGEST_STALL =>
                {
                    std::thread::sleep(QUEUE_PERIOD);
                }
                sent => return sent.map_err(|error| self.failed(error)),
            }
        }
    }

    fn receive(&mut self, timeout: Duration) -> Result<Option<Received>, BusError> {
        let deadline = self.now() + timeout;
        loop {
            let left = deadline.saturating_sub(self.now());
            match self.socket.read_frame_timeout(left) {
                Ok(frame) => {
                    if let Some(frame) = classic(&frame) {
                        let at = self.now();
                        return Ok(Some(Received { frame, at }));
                    }
                }
                Err(error) => match error.kind() {
                    io::ErrorKind::WouldBlock
                    | io::ErrorKind::TimedOut
                    | io::ErrorKind::Interrupted => return Ok(None),
                    _ => return Err(self.failed(error)),
                },
            }
        }
    }

    fn now(&self) -> Duration {
        self.opened.elapsed()
    }
}

/// The kernel's error if it has no CAN sockets at all. Opening a named interface looks the name up first
/// and would blame that; interface 0 stands for all.
fn without_can_support() -> Option<io::Error> {
    let error = CanSocket::open_iface(0).err()?;
    (error.raw_os_error() == Some(ADDRESS_FAMILY_NOT_SUPPORTED)).then_some(error)
}

/// The frame as this project's type; `None` for the kernel's error frames.
fn classic(frame: &CanFrame) -> Option<Frame> {
    match frame {
        CanFrame::Data(_) => Frame::new(frame.id(), frame.data()),
        CanFrame::Remote(_) => Frame::remote(frame.id(), frame.dlc()),
        CanFrame::Error(_) => None,
    }
}

fn open_error(interface: &str, error: &io::Error) -> BusError {
    let next = match error.raw_os_error() {
        Some(ADDRESS_FAMILY_NOT_SUPPORTED) => {
            "this kernel has no CAN support: run `sudo modprobe can_raw`, or use slcan: or tcp: instead"
                .to_owned()
        }
        Some(NO_SUCH_DEVICE) => {
            "list the interfaces with `ip -br link`; for slcand or vcan see docs/transports.md".to_owned()
        }
        Some(NETWORK_IS_DOWN) => {
            format!("bring it up: `sudo ip link set {interface} up type can bitrate 1000000`")
        }
        _ => "see docs/transports.md on how to set up a CAN interface".to_owned(),
    };
    BusError::Open {
        what: format!("CAN interface {interface}"),
        reason: error.to_string(),
        next,
    }
}
