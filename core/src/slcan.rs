//! SLCAN (Lawicel) text protocol: CAN frames as lines of ASCII over a serial line or a TCP stream.
//!
//! [`Channel`] is the device's side: it takes bytes one at a time, keeps the state of one connection
//! and says what to put on the bus and what to answer. [`format()`], [`parse`] and [`LineReader`] are the
//! codec alone and serve the host's side as well. Everything is total: any byte string gives an answer
//! or a counted refusal.
//!
//! A line ends at carriage return; line feeds are skipped; both hex cases are read and upper case is
//! written.
//!
//! | line | meaning | answer |
//! |---|---|---|
//! | (empty) | clears a half-sent line | none, see below |
//! | `tIIILDD…` `TIIIIIIIILDD…` | data frame with 11-bit or 29-bit identifier | none, or `z`/`Z` CR |
//! | `rIIIL` `RIIIIIIIIL` | remote frame | none, or `z`/`Z` CR |
//! | `S0`–`S8` | bit rate 10, 20, 50, 100, 125, 250, 500, 800, 1000 kbit/s | CR |
//! | `O` / `L` / `C` | open / open listen-only / close | CR |
//! | `Z0` / `Z1` | time stamps off / on: four hex digits of milliseconds modulo 60 000 | CR |
//! | `V` `N` `F` | version, serial number, status flags (cleared by reading) | text CR |
//!
//! Everything else, a frame while closed or listen-only, `S`, `O`, `L` or `Z` on a channel that was
//! opened, and `C` or `F` on a closed one are answered with BEL, as Lawicel's adapters do.
//!
//! Where this differs from Lawicel, and why (SC-25 guide and its public clients): the channel is open
//! after start-up, because the SC-25's clients send frames without opening it, and until the first `O`,
//! `L` or `C` it also accepts what only a closed channel accepts; frames are not acknowledged
//! unless [`Channel::set_frame_replies`] asks for it, because no client needs it; an empty line gets no
//! answer, because a terminal with echo turns each answered carriage return into the next empty line.

use embedded_can::{ExtendedId, Id, StandardId};
use heapless::Vec;

use crate::frame::Frame;

/// Carriage return: ends a line and, alone, means "done".
pub const CR: u8 = b'\r';
/// Bell: "refused".
pub const BEL: u8 = 0x07;
/// Longest line without its carriage return: `T`, eight identifier digits, length, sixteen data
/// digits, four time stamp digits.
pub const LINE_CAPACITY: usize = 30;
/// Time stamps count milliseconds from 0 to 59 999.
pub const STAMP_MODULUS: u64 = 60_000;
/// Answer to `V`: hardware 01, protocol 01.
pub const VERSION: &[u8; 5] = b"V0101";
/// Answer to `N`: the same for every device, as this port has no serial number of its own.
pub const SERIAL_NUMBER: &[u8; 5] = b"NWNDL";

/// Bits of the answer to `F`, as in the Lawicel CAN232 manual.
pub mod flag {
    /// The receive queue overflowed.
    pub const RECEIVE_QUEUE_FULL: u8 = 1 << 0;
    /// The transmit queue overflowed.
    pub const TRANSMIT_QUEUE_FULL: u8 = 1 << 1;
    /// An error counter reached the warning level.
    pub const ERROR_WARNING: u8 = 1 << 2;
    /// A received frame was lost.
    pub const DATA_OVERRUN: u8 = 1 << 3;
    /// The controller is error passive.
    pub const ERROR_PASSIVE: u8 = 1 << 5;
    /// A transmission lost arbitration.
    pub const ARBITRATION_LOST: u8 = 1 << 6;
    /// The controller saw a bus error.
    pub const BUS_ERROR: u8 = 1 << 7;
}

/// One line of text with its carriage return.
pub type Text = Vec<u8, { LINE_CAPACITY + 1 }>;

/// The content of one line without its carriage return.
pub type Content = Vec<u8, LINE_CAPACITY>;

/// One completed line as [`LineReader`] found it.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum Line {
    /// The content without its carriage return; may be empty.
    Content(Content),
    /// More than [`LINE_CAPACITY`] bytes; they are gone.
    TooLong,
}

/// Cuts a stream of bytes into lines.
#[derive(Clone, Debug, Default)]
pub struct LineReader {
    content: Content,
    overflow: bool,
}

impl LineReader {
    /// A reader at the start of a line.
    #[must_use]
    pub const fn new() -> Self {
        Self {
            content: Vec::new(),
            overflow: false,
        }
    }

    /// Takes the next byte; returns a line when `byte` is the carriage return that ends it.
    pub fn push(&mut self, byte: u8) -> Option<Line> {
        match byte {
            b'\n' => None,
            CR => {
                let finished = core::mem::take(self);
                Some(if finished.overflow {
                    Line::TooLong
                } else {
                    Line::Content(finished.content)
                })
            }
            _ => {
                self.overflow |= self.content.push(byte).is_err();
                None
            }
        }
    }

    /// Forgets a half-received line.
    pub fn clear(&mut self) {
        *self = Self::new();
    }
}

/// A frame as a line with its carriage return; `stamp` in milliseconds is appended when given.
#[must_use]
pub fn format(frame: &Frame, stamp: Option<u16>) -> Text {
    let mut text = Text::new();
    let (letter, digits) = match (frame.is_extended(), frame.is_remote()) {
        (false, false) => (b't', 3),
        (true, false) => (b'T', 8),
        (false, true) => (b'r', 3),
        (true, true) => (b'R', 8),
    };
    append(&mut text, letter);
    append_hex(&mut text, frame.raw_id(), digits);
    append_hex(&mut text, frame.dlc() as u32, 1);
    for byte in frame.data() {
        append_hex(&mut text, u32::from(*byte), 2);
    }
    if let Some(stamp) = stamp {
        append_hex(&mut text, u32::from(stamp), 4);
    }
    append(&mut text, CR);
    text
}

/// Reads a line without its carriage return as a frame and, if it carries one, its time stamp in
/// milliseconds. `None` for any other line, wrong length, an identifier that is too large or a data
/// length code above 8.
#[must_use]
pub fn parse(line: &[u8]) -> Option<(Frame, Option<u16>)> {
    let (letter, rest) = line.split_first()?;
    let (digits, remote) = match letter {
        b't' => (3, false),
        b'T' => (8, false),
        b'r' => (3, true),
        b'R' => (8, true),
        _ => return None,
    };
    let (raw_id, rest) = take_hex(rest, digits)?;
    let id = if digits == 3 {
        Id::Standard(StandardId::new(u16::try_from(raw_id).ok()?)?)
    } else {
        Id::Extended(ExtendedId::new(raw_id)?)
    };
    let (dlc, mut rest) = take_hex(rest, 1)?;
    let dlc = usize::try_from(dlc).ok().filter(|dlc| *dlc <= 8)?;
    let frame = if remote {
        Frame::remote(id, dlc)?
    } else {
        let mut data = [0; 8];
        for slot in data.iter_mut().take(dlc) {
            let (byte, after) = take_hex(rest, 2)?;
            *slot = u8::try_from(byte).ok()?;
            rest = after;
        }
        Frame::new(id, data.get(..dlc)?)?
    };
    if rest.is_empty() {
        return Some((frame, None));
    }
    let (stamp, rest) = take_hex(rest, 4)?;
    let stamp = u16::try_from(stamp).ok()?;
    rest.is_empty().then_some((frame, Some(stamp)))
}

/// The capacity of [`Text`] is that of the longest line, so nothing is ever dropped here.
fn append(text: &mut Text, byte: u8) {
    let _ = text.push(byte);
}

fn append_hex(text: &mut Text, value: u32, digits: u32) {
    for position in (0..digits).rev() {
        let nibble = (value >> (position * 4)) & 0xF;
        let digit = char::from_digit(nibble, 16).unwrap_or('0');
        append(text, digit.to_ascii_uppercase() as u8);
    }
}

/// The value of the first `digits` (at most 8) hex digits and what follows them.
fn take_hex(text: &[u8], digits: usize) -> Option<(u32, &[u8])> {
    let (head, rest) = text.split_at_checked(digits)?;
    let mut value = 0;
    for byte in head {
        value = value << 4 | char::from(*byte).to_digit(16)?;
    }
    Some((value, rest))
}

/// State of one SLCAN connection.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum State {
    /// Open since start-up, without a command; also takes the commands of a closed channel.
    OpenAtStart,
    /// Opened with `O`.
    Open,
    /// Opened with `L`: receives, never transmits.
    ListenOnly,
    /// Closed with `C`.
    Closed,
}

/// What one completed line asks for.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct Answer {
    /// The frame to put on the bus.
    pub transmit: Option<Frame>,
    /// The bytes to send back; may be empty.
    pub reply: Text,
}

impl Answer {
    fn text(content: &[u8]) -> Self {
        let mut reply = Text::new();
        for byte in content {
            append(&mut reply, *byte);
        }
        Self {
            transmit: None,
            reply,
        }
    }

    fn done() -> Self {
        Self::text(&[CR])
    }
}

/// What a channel has seen since it was made; each count saturates.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Counters {
    /// Frames accepted for the bus.
    pub frames: u32,
    /// Lines that are too long or no SLCAN.
    pub malformed: u32,
    /// Well-formed lines that the state of the channel forbids.
    pub refused: u32,
}

/// Why a line was answered with BEL.
enum Refusal {
    Malformed,
    WrongState,
}

/// The device's side of one SLCAN connection.
#[derive(Clone, Debug)]
pub struct Channel {
    reader: LineReader,
    state: State,
    bit_rate: u32,
    stamps: bool,
    frame_replies: bool,
    flags: u8,
    counters: Counters,
}

impl Default for Channel {
    fn default() -> Self {
        Self::new()
    }
}

impl Channel {
    /// A channel as after power-up: open, 1 Mbit/s, no time stamps, frames not acknowledged.
    #[must_use]
    pub const fn new() -> Self {
        Self {
            reader: LineReader::new(),
            state: State::OpenAtStart,
            bit_rate: 1_000_000,
            stamps: false,
            frame_replies: false,
            flags: 0,
            counters: Counters {
                frames: 0,
                malformed: 0,
                refused: 0,
            },
        }
    }

    /// Whether an accepted frame is answered with `z` CR (11-bit) or `Z` CR (29-bit).
    pub fn set_frame_replies(&mut self, enabled: bool) {
        self.frame_replies = enabled;
    }

    /// Adds bits of [`flag`] to the next answer to `F`.
    pub fn raise(&mut self, flags: u8) {
        self.flags |= flags;
    }

    /// Whether the channel is open and how.
    #[must_use]
    pub const fn state(&self) -> State {
        self.state
    }

    /// The bit rate last asked for, in bit/s.
    #[must_use]
    pub const fn bit_rate(&self) -> u32 {
        self.bit_rate
    }

    /// What was seen so far.
    #[must_use]
    pub const fn counters(&self) -> &Counters {
        &self.counters
    }

    /// The line for a frame that was received from the bus at `now_ms` milliseconds; `None` while the
    /// channel is closed.
    #[must_use]
    pub fn received(&self, frame: &Frame, now_ms: u64) -> Option<Text> {
        if self.state == State::Closed {
            return None;
        }
        let stamp = self.stamps.then_some((now_ms % STAMP_MODULUS) as u16);
        Some(format(frame, stamp))
    }

    /// Takes the next byte from the client; an [`Answer`] when it completes a line.
    pub fn push(&mut self, byte: u8) -> Option<Answer> {
        let outcome = match self.reader.push(byte)? {
            Line::Content(line) => self.execute(&line),
            Line::TooLong => Err(Refusal::Malformed),
        };
        Some(outcome.unwrap_or_else(|refusal| {
            let count = match refusal {
                Refusal::Malformed => &mut self.counters.malformed,
                Refusal::WrongState => &mut self.counters.refused,
            };
            *count = count.saturating_add(1);
            Answer::text(&[BEL])
        }))
    }

    fn execute(&mut self, line: &[u8]) -> Result<Answer, Refusal> {
        match line {
            [] => Ok(Answer::default()),
            [b't' | b'T' | b'r' | b'R', ..] => self.transmit(line),
            [b'S', digit] => self.set_bit_rate(*digit),
            [b'O'] => self.open(State::Open),
            [b'L'] => self.open(State::ListenOnly),
            [b'C'] => {
                self.require(self.state != State::Closed)?;
                self.state = State::Closed;
                Ok(Answer::done())
            }
            [b'Z', choice @ (b'0' | b'1')] => {
                self.require(self.configurable())?;
                self.stamps = *choice == b'1';
                Ok(Answer::done())
            }
            [b'V'] => Ok(with_cr(VERSION)),
            [b'N'] => Ok(with_cr(SERIAL_NUMBER)),
            [b'F'] => {
                self.require(self.state != State::Closed)?;
                let mut answer = Answer::text(b"F");
                append_hex(&mut answer.reply, u32::from(self.flags), 2);
                append(&mut answer.reply, CR);
                self.flags = 0;
                Ok(answer)
            }
            _ => Err(Refusal::Malformed),
        }
    }

    fn transmit(&mut self, line: &[u8]) -> Result<Answer, Refusal> {
        let Some((frame, None)) = parse(line) else {
            return Err(Refusal::Malformed);
        };
        self.require(matches!(self.state, State::Open | State::OpenAtStart))?;
        self.counters.frames = self.counters.frames.saturating_add(1);
        let mut answer = match (self.frame_replies, frame.is_extended()) {
            (false, _) => Answer::default(),
            (true, false) => Answer::text(&[b'z', CR]),
            (true, true) => Answer::text(&[b'Z', CR]),
        };
        answer.transmit = Some(frame);
        Ok(answer)
    }

    fn set_bit_rate(&mut self, digit: u8) -> Result<Answer, Refusal> {
        let bit_rate = match digit {
            b'0' => 10_000,
            b'1' => 20_000,
            b'2' => 50_000,
            b'3' => 100_000,
            b'4' => 125_000,
            b'5' => 250_000,
            b'6' => 500_000,
            b'7' => 800_000,
            b'8' => 1_000_000,
            _ => return Err(Refusal::Malformed),
        };
        self.require(self.configurable())?;
        self.bit_rate = bit_rate;
        Ok(Answer::done())
    }

    fn open(&mut self, state: State) -> Result<Answer, Refusal> {
        self.require(self.configurable())?;
        self.state = state;
        Ok(Answer::done())
    }

    fn configurable(&self) -> bool {
        matches!(self.state, State::Closed | State::OpenAtStart)
    }

    fn require(&self, allowed: bool) -> Result<(), Refusal> {
        if allowed {
            Ok(())
        } else {
            Err(Refusal::WrongState)
        }
    }
}

fn with_cr(content: &[u8]) -> Answer {
    let mut answer = Answer::text(content);
    append(&mut answer.reply, CR);
    answer
}

#[cfg(test)]
mod tests;
