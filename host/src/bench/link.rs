//! One SLCAN client: its byte stream, its channel and what waits to be written.

use std::collections::VecDeque;
use std::io::{self, ErrorKind, Read, Write};
use std::net::{Shutdown, TcpStream};
use std::time::Duration;

use windlass_core::frame::Frame;
use windlass_core::slcan::{Channel, flag};
use windlass_core::time::Instant;
use windlass_sim::{ErrorState, ParticipantId, ParticipantStatistics};

/// Unwritten bytes at which a client that does not read is disconnected.
pub(super) const LARGEST_BACKLOG: usize = 1 << 20;
/// Waiting for a client without any progress after which it is disconnected.
pub(super) const LONGEST_WAIT: Duration = Duration::from_secs(5);
/// Bytes read from one client in one go.
const READ_CHUNK: usize = 4096;
/// Error count at which CAN controllers warn.
const WARNING_FROM: u16 = 96;

/// A byte stream that never blocks.
pub(super) trait Port: Read + Write + Send {
    /// Ends the stream.
    fn close(&mut self);
}

/// One client of the bench.
pub(super) struct Link {
    name: String,
    participant: ParticipantId,
    port: Box<dyn Port>,
    channel: Channel,
    output: VecDeque<u8>,
    waited: Duration,
    frames_out: u64,
    ended_at: Option<Instant>,
    /// Both error counters at the latest look.
    errors: (u16, u16),
}

impl Link {
    pub(super) fn new(
        name: String,
        participant: ParticipantId,
        port: Box<dyn Port>,
        frame_replies: bool,
    ) -> Self {
        let mut channel = Channel::new();
        channel.set_frame_replies(frame_replies);
        Self {
            name,
            participant,
            port,
            channel,
            output: VecDeque::new(),
            waited: Duration::ZERO,
            frames_out: 0,
            ended_at: None,
            errors: (0, 0),
        }
    }

    /// Sets the status flags for the client's CAN controller.
    pub(super) fn note_controller(&mut self, own: &ParticipantStatistics) {
        let before = std::mem::replace(&mut self.errors, (own.tec, own.rec));
        let mut flags = 0;
        if own.tec > before.0 || own.rec > before.1 {
            flags |= flag::BUS_ERROR;
        }
        if own.tec.max(own.rec) >= WARNING_FROM {
            flags |= flag::ERROR_WARNING;
        }
        if own.state != ErrorState::Active {
            flags |= flag::ERROR_PASSIVE;
        }
        self.channel.raise(flags);
    }

    pub(super) fn name(&self) -> &str {
        &self.name
    }

    pub(super) fn participant(&self) -> ParticipantId {
        self.participant
    }

    pub(super) fn channel(&self) -> &Channel {
        &self.channel
    }

    /// Bytes not yet taken by the kernel.
    pub(super) fn backlog(&self) -> usize {
        self.output.len()
    }

    /// Frames from the bus that were given to this client.
    pub(super) fn frames_out(&self) -> u64 {
        self.frames_out
    }

    /// Whether the client went away.
    pub(super) fn has_ended(&self) -> bool {
        self.ended_at.is_some()
    }

    /// When the client went away, if it did.
    pub(super) fn ended_at(&self) -> Option<Instant> {
        self.ended_at
    }

    /// Takes the next bytes that the client has sent and gives each frame in them to `transmit`. False
    /// when nothing more is waiting.
    pub(super) fn read(&mut self, now: Instant, mut transmit: impl FnMut(Frame)) -> bool {
        if self.has_ended() {
            return false;
        }
        let mut bytes = [0; READ_CHUNK];
        let count = match self.port.read(&mut bytes) {
            Ok(count) if count > 0 => count,
            Err(error) if error.kind() == ErrorKind::Interrupted => return true,
            Err(error) if error.kind() == ErrorKind::WouldBlock => return false,
            Ok(_) | Err(_) => {
                self.close(now);
                return false;
            }
        };
        for byte in bytes.iter().take(count) {
            if let Some(answer) = self.channel.push(*byte) {
                self.output.extend(answer.reply.iter());
                if let Some(frame) = answer.transmit {
                    transmit(frame);
                }
            }
        }
        true
    }

    /// Queues a frame from the bus for the client.
    pub(super) fn deliver(&mut self, frame: &Frame, at: Instant) {
        if self.has_ended() {
            return;
        }
        if let Some(line) = self.channel.received(frame, at.as_micros() / 1000) {
            self.output.extend(line.iter());
            self.frames_out += 1;
        }
    }

    /// Writes what the kernel takes now. True if it took anything.
    pub(super) fn flush(&mut self, now: Instant) -> bool {
        let before = self.output.len();
        while !self.output.is_empty() && !self.has_ended() {
            let (front, _) = self.output.as_slices();
            match self.port.write(front) {
                Ok(0) => self.close(now),
                Ok(count) => drop(self.output.drain(..count)),
                Err(error) => match error.kind() {
                    ErrorKind::Interrupted => {}
                    ErrorKind::WouldBlock => break,
                    _ => self.close(now),
                },
            }
        }
        let progress = self.output.len() < before;
        if progress {
            self.waited = Duration::ZERO;
        }
        progress
    }

    /// Counts time spent waiting for this client to read.
    pub(super) fn add_wait(&mut self, span: Duration) {
        if !self.output.is_empty() {
            self.waited += span;
        }
    }

    /// Why the client must be disconnected, if it must.
    pub(super) fn overdue(&self) -> Option<String> {
        if self.has_ended() {
            None
        } else if self.output.len() > LARGEST_BACKLOG {
            Some(format!("{} bytes wait to be read by it", self.output.len()))
        } else if self.waited >= LONGEST_WAIT {
            Some(format!("it has read nothing for {LONGEST_WAIT:?}"))
        } else {
            None
        }
    }

    /// Ends the connection; what was not written is lost.
    pub(super) fn close(&mut self, now: Instant) {
        if self.ended_at.is_none() {
            self.ended_at = Some(now);
            self.output.clear();
            self.port.close();
        }
    }
}

/// A client on TCP.
pub(super) struct TcpPort(TcpStream);

impl TcpPort {
    /// Takes an accepted connection: bytes leave at once, and nothing blocks.
    pub(super) fn new(stream: TcpStream) -> io::Result<Self> {
        stream.set_nodelay(true)?;
        stream.set_nonblocking(true)?;
        let port = Self(stream);
        port.acknowledge_at_once();
        Ok(port)
    }

    /// A client that leaves Nagle's algorithm on sends its next line only after the last one was
    /// acknowledged, and Linux delays that by up to 40 ms unless told otherwise again and again.
    fn acknowledge_at_once(&self) {
        // Only a matter of latency, so a refusal is no error.
        #[cfg(target_os = "linux")]
        let _ = rustix::net::sockopt::set_tcp_quickack(&self.0, true);
    }
}

impl Read for TcpPort {
    fn read(&mut self, buffer: &mut [u8]) -> io::Result<usize> {
        let count = self.0.read(buffer)?;
        self.acknowledge_at_once();
        Ok(count)
    }
}

impl Write for TcpPort {
    fn write(&mut self, bytes: &[u8]) -> io::Result<usize> {
        let count = self.0.write(bytes)?;
        self.acknowledge_at_once();
        Ok(count)
    }

    fn flush(&mut self) -> io::Result<()> {
        self.0.flush()
    }
}

impl Port for TcpPort {
    fn close(&mut self) {
        // The client may have closed the connection first.
        let _ = self.0.shutdown(Shutdown::Both);
    }
}

#[cfg(test)]
mod tests {
    use windlass_sim::{World, WorldConfig};

    use super::*;

    /// A client that takes some bytes and then reads nothing more.
    struct Full {
        room: usize,
    }

    impl Read for Full {
        fn read(&mut self, _buffer: &mut [u8]) -> io::Result<usize> {
            Err(ErrorKind::WouldBlock.into())
        }
    }

    impl Write for Full {
        fn write(&mut self, bytes: &[u8]) -> io::Result<usize> {
            let taken = bytes.len().min(self.room);
            self.room -= taken;
            if taken == 0 {
                return Err(ErrorKind::WouldBlock.into());
            }
            Ok(taken)
        }

        fn flush(&mut self) -> io::Result<()> {
            Ok(())
        }
    }

    impl Port for Full {
        fn close(&mut self) {}
    }

    fn link(room: usize) -> Link {
        let id = World::new(WorldConfig::default()).join("test");
        Link::new("test".to_owned(), id, Box::new(Full { room }), false)
    }

    #[test]
    fn a_client_that_does_not_read_is_overdue_after_five_seconds_of_waiting() {
        let mut link = link(10);
        link.deliver(&Frame::standard(0x123, [1, 2, 3]), Instant::ZERO);
        assert!(link.flush(Instant::ZERO), "ten bytes were taken");
        assert_eq!(link.backlog(), 2);
        link.add_wait(LONGEST_WAIT - Duration::from_millis(1));
        assert_eq!(link.overdue(), None);
        link.add_wait(Duration::from_millis(1));
        assert!(link.overdue().is_some());
    }

    #[test]
    fn any_progress_starts_the_patience_anew() {
        let mut link = link(0);
        link.deliver(&Frame::standard(0x123, []), Instant::ZERO);
        link.add_wait(LONGEST_WAIT);
        link.port = Box::new(Full { room: 1 });
        assert!(link.flush(Instant::ZERO));
        assert_eq!(link.overdue(), None);
    }

    #[test]
    fn a_client_is_overdue_when_too_much_waits_for_it() {
        let mut link = link(0);
        let frame = Frame::extended(1, [0; 8]);
        let line = 27;
        for _ in 0..LARGEST_BACKLOG / line {
            link.deliver(&frame, Instant::ZERO);
        }
        assert_eq!(link.overdue(), None);
        link.deliver(&frame, Instant::ZERO);
        assert!(link.overdue().is_some());
        link.close(Instant::ZERO);
        assert_eq!((link.backlog(), link.overdue()), (0, None));
    }
}
