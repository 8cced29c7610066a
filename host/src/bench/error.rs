//! Why a bench does not start or refuses something.

use std::io::{self, ErrorKind};
use std::net::SocketAddr;

/// An error of the bench. Its text names the cause, [`BenchError::next_step`] the way out.
#[derive(Debug, thiserror::Error)]
pub enum BenchError {
    /// An address cannot be listened on.
    #[error("cannot serve {what} on {address}: {source}")]
    Listen {
        /// What was to be served there.
        what: &'static str,
        /// Where.
        address: SocketAddr,
        /// What the system says.
        source: io::Error,
    },
    /// There is no pseudo-terminal.
    #[error("cannot make a pseudo-terminal: {0}")]
    Pty(#[source] io::Error),
    /// The system refuses a thread.
    #[error("cannot start a thread of the bench: {0}")]
    Thread(#[source] io::Error),
    /// A step was asked of a bench that runs by the clock.
    #[error("the bench runs in real time and cannot be stepped")]
    NotPaused,
    /// The bench has ended.
    #[error("the bench has stopped")]
    Stopped,
    /// A thread of the bench has panicked.
    #[error("a thread of the bench has panicked")]
    Panicked,
}

impl BenchError {
    /// What the user can do about it.
    #[must_use]
    pub fn next_step(&self) -> String {
        match self {
            Self::Listen {
                what,
                address,
                source,
            } => listen_next_step(what, *address, source),
            Self::Pty(_) => "leave --pty out and use the SLCAN port on TCP".to_owned(),
            Self::Thread(_) => "close other programs or raise the limit of processes".to_owned(),
            Self::NotPaused => "start the bench with --paused to step it".to_owned(),
            Self::Stopped => "start the bench again".to_owned(),
            Self::Panicked => {
                "report the message above as a defect, with the command that led to it".to_owned()
            }
        }
    }
}

fn listen_next_step(what: &str, address: SocketAddr, source: &io::Error) -> String {
    let option = what.to_lowercase();
    let host = address.ip();
    match source.kind() {
        ErrorKind::AddrInUse => format!(
            "end the program that uses port {}, or take a free port with --{option} {host}:0",
            address.port()
        ),
        ErrorKind::PermissionDenied => {
            format!("take a port above 1023, for example with --{option} {host}:0")
        }
        ErrorKind::AddrNotAvailable => {
            format!("use an address of this machine, for example --{option} 127.0.0.1:0")
        }
        _ => format!("try --{option} 127.0.0.1:0"),
    }
}
