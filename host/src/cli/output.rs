//! Standard output: whole lines, a live line that is rewritten on a terminal, and an error instead of a
//! panic when the reader has gone.

use std::fmt::Arguments;
use std::io::{self, IsTerminal, Write};

/// Writes one line.
///
/// # Errors
/// The reader has closed the pipe, or the disk is full.
pub fn line(text: Arguments<'_>) -> io::Result<()> {
    let mut out = io::stdout().lock();
    out.write_fmt(text)?;
    out.write_all(b"\n")?;
    out.flush()
}

/// Writes one line of text made like `format!`, giving a
/// [`Failure`](super::Failure) when that fails.
macro_rules! say {
    ($($text:tt)*) => {
        $crate::cli::output::line(format_args!($($text)*)).map_err($crate::cli::Failure::from)
    };
}
pub(crate) use say;

/// Writes a JSON document as one line.
///
/// # Errors
/// As [`line()`].
pub fn json(document: &serde_json::Value) -> io::Result<()> {
    line(format_args!("{document}"))
}

/// A line that shows the present state: rewritten in place on a terminal, one line after the other
/// elsewhere, so that a log stays readable.
#[derive(Debug)]
pub struct LiveLine {
    terminal: bool,
    open: bool,
}

impl LiveLine {
    /// A live line on standard output.
    #[must_use]
    pub fn new() -> Self {
        Self {
            terminal: io::stdout().is_terminal(),
            open: false,
        }
    }

    /// Shows `text`.
    ///
    /// # Errors
    /// As [`line()`].
    pub fn show(&mut self, text: &str) -> io::Result<()> {
        if !self.terminal {
            return line(format_args!("{text}"));
        }
        let mut out = io::stdout().lock();
        write!(out, "\r\x1b[2K{text}")?;
        self.open = true;
        out.flush()
    }

    /// Ends the line, so that the next output starts on a line of its own.
    ///
    /// # Errors
    /// As [`line()`].
    pub fn finish(&mut self) -> io::Result<()> {
        if std::mem::take(&mut self.open) {
            return line(format_args!(""));
        }
        Ok(())
    }
}

impl Default for LiveLine {
    fn default() -> Self {
        Self::new()
    }
}
