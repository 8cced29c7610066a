//! A pseudo-terminal as a serial port: programs open its path like an adapter's device file.

use std::fs::File;
use std::io::{self, ErrorKind, Read, Write};
use std::os::fd::OwnedFd;
use std::path::{Path, PathBuf};

use rustix::event::{PollFd, PollFlags, Timespec, poll};
use rustix::fs::{Mode, OFlags, fcntl_getfl, fcntl_setfl};
use rustix::pty::{OpenptFlags, grantpt, openpt, ptsname, unlockpt};
use rustix::termios::{OptionalActions, QueueSelector, tcflush, tcgetattr, tcsetattr};

use super::link::Port;

/// The bench's end of a pseudo-terminal.
pub(super) struct Pty {
    master: File,
    path: PathBuf,
}

impl Pty {
    /// Makes a pseudo-terminal in raw mode without echo.
    pub(super) fn open() -> io::Result<Self> {
        let flags = OpenptFlags::RDWR | OpenptFlags::NOCTTY | OpenptFlags::CLOEXEC;
        let master = openpt(flags)?;
        grantpt(&master)?;
        unlockpt(&master)?;
        let name = ptsname(&master, Vec::new())?;
        let path = PathBuf::from(name.to_string_lossy().into_owned());
        // Until the other end has been open once, the kernel does not tell that nobody has it open.
        drop(open_other_end(&path)?);
        fcntl_setfl(&master, fcntl_getfl(&master)? | OFlags::NONBLOCK)?;
        let pty = Self {
            master: File::from(master),
            path,
        };
        pty.make_raw()?;
        Ok(pty)
    }

    /// What a client opens.
    pub(super) fn path(&self) -> &Path {
        &self.path
    }

    /// What the other end is doing.
    pub(super) fn state(&self) -> PtyState {
        let mut descriptors = [PollFd::new(&self.master, PollFlags::IN)];
        let at_once = Timespec::default();
        match poll(&mut descriptors, Some(&at_once)) {
            Ok(_) => PtyState {
                open: !descriptors[0].revents().contains(PollFlags::HUP),
                input: descriptors[0].revents().contains(PollFlags::IN),
            },
            Err(_) => PtyState::default(),
        }
    }

    /// The stream of the program that has just opened the path.
    pub(super) fn connect(&self) -> io::Result<PtyPort> {
        self.make_raw()?;
        Ok(PtyPort {
            master: self.master.try_clone()?,
            path: self.path.clone(),
        })
    }

    /// A program that sets no terminal mode gets one that changes no byte and echoes none.
    fn make_raw(&self) -> io::Result<()> {
        let mut mode = tcgetattr(&self.master)?;
        mode.make_raw();
        Ok(tcsetattr(&self.master, OptionalActions::Now, &mode)?)
    }
}

/// What the program at the other end of a pseudo-terminal is doing.
#[derive(Clone, Copy, Debug, Default)]
pub(super) struct PtyState {
    /// It has the path open.
    pub(super) open: bool,
    /// It has sent bytes that wait to be read.
    pub(super) input: bool,
}

/// What a program opens, opened without becoming its terminal.
fn open_other_end(path: &Path) -> io::Result<OwnedFd> {
    let flags = OFlags::RDWR | OFlags::NOCTTY | OFlags::CLOEXEC | OFlags::NONBLOCK;
    Ok(rustix::fs::open(path, flags, Mode::empty())?)
}

/// The stream of one program on a pseudo-terminal.
pub(super) struct PtyPort {
    master: File,
    path: PathBuf,
}

impl PtyPort {
    /// Forgets what was written and not read. Flushing the bench's end empties the kernel's queue between
    /// both ends; what has left that queue already waits at the other end and is flushed there.
    fn discard(&self) -> io::Result<()> {
        tcflush(&self.master, QueueSelector::OFlush)?;
        let other = open_other_end(&self.path)?;
        Ok(tcflush(&other, QueueSelector::IFlush)?)
    }
}

impl Read for PtyPort {
    fn read(&mut self, buffer: &mut [u8]) -> io::Result<usize> {
        // Linux reports an input/output error when no program has the other end open.
        self.master
            .read(buffer)
            .or_else(|error| match error.kind() {
                ErrorKind::WouldBlock | ErrorKind::Interrupted => Err(error),
                _ => Ok(0),
            })
    }
}

impl Write for PtyPort {
    fn write(&mut self, bytes: &[u8]) -> io::Result<usize> {
        self.master.write(bytes)
    }

    fn flush(&mut self) -> io::Result<()> {
        self.master.flush()
    }
}

impl Port for PtyPort {
    fn close(&mut self) {
        // The next program must not read what the last one left; if that fails, it reads old frames,
        // as it would from a serial adapter.
        let _ = self.discard();
    }
}
