//! What the demo shows while it runs: one block that is rewritten on a terminal, plain lines elsewhere.

use std::fmt::Write as _;
use std::io::{self, IsTerminal, Write as _};
use std::time::{Duration, Instant};

use serde_json::json;

use super::moves::{Part, Report};
use crate::cli::output;
use crate::client::Client;
use crate::transport::Bus;

/// Time between two lines where nothing can be rewritten.
const LINE_PERIOD: Duration = Duration::from_millis(250);
/// Characters of the duty bar to each side of zero.
const BAR: usize = 20;

/// How the demo talks.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Style {
    Block,
    Lines,
    Json,
}

/// The live display.
#[derive(Debug)]
pub(super) struct Screen {
    style: Style,
    started: Instant,
    last_line: Option<Instant>,
    /// Lines of the block that is on the terminal now.
    shown: usize,
}

/// One look at the motor.
struct Sample {
    part: Part,
    measured: f64,
    current: f64,
    duty: f64,
}

impl Screen {
    /// A display on standard output.
    pub(super) fn new(as_json: bool) -> Self {
        let style = match (as_json, io::stdout().is_terminal()) {
            (true, _) => Style::Json,
            (false, true) => Style::Block,
            (false, false) => Style::Lines,
        };
        Self {
            style,
            started: Instant::now(),
            last_line: None,
            shown: 0,
        }
    }

    /// Shows where the motor is on its way.
    ///
    /// # Errors
    /// Standard output is closed.
    pub(super) fn show<B: Bus>(
        &mut self,
        client: &Client<B>,
        number: u8,
        part: Part,
    ) -> io::Result<()> {
        let Some(status) = client.status(number) else {
            return Ok(());
        };
        let sample = Sample {
            part,
            measured: part.measured(client, number).unwrap_or_default(),
            current: status.current().unwrap_or_default(),
            duty: status.duty_percent().unwrap_or_default(),
        };
        if self.style == Style::Block {
            return self.rewrite(&sample.block());
        }
        if self.last_line.is_some_and(|at| at.elapsed() < LINE_PERIOD) {
            return Ok(());
        }
        self.last_line = Some(Instant::now());
        let at = self.started.elapsed().as_secs_f64();
        if self.style == Style::Json {
            return output::json(&json!({
                "t_s": at,
                "move": part.label(),
                "measured": sample.measured,
                "current_a": sample.current,
                "duty_percent": sample.duty,
            }));
        }
        output::line(format_args!("{at:6.2} s  {}", sample.line()))
    }

    /// Shows how a move ended.
    ///
    /// # Errors
    /// Standard output is closed.
    pub(super) fn finished(&mut self, report: &Report) -> io::Result<()> {
        match self.style {
            Style::Block => {
                self.rewrite("")?;
                self.shown = 0;
                write!(io::stdout(), "\x1b[1A")?;
                output::line(format_args!("{}", summary(report)))
            }
            Style::Lines => output::line(format_args!("          {}", summary(report))),
            Style::Json => output::json(&json!({
                "move": report.part.label(),
                "reached": report.reached,
                "error_percent": report.error_percent,
                "settled_ms": report.settled.map(|time| time.as_millis() as u64),
                "missed": report.missed(),
            })),
        }
    }

    /// Replaces the block on the terminal.
    fn rewrite(&mut self, text: &str) -> io::Result<()> {
        let mut out = String::new();
        if self.shown > 0 {
            // Writing to a String cannot fail.
            let _ = write!(out, "\x1b[{}A", self.shown);
        }
        let lines = text.lines().count().max(1);
        for line in text.lines() {
            let _ = writeln!(out, "\x1b[2K{line}");
        }
        if text.is_empty() {
            out += "\x1b[J\n";
        }
        self.shown = lines;
        let mut stdout = io::stdout().lock();
        stdout.write_all(out.as_bytes())?;
        stdout.flush()
    }
}

impl Sample {
    fn line(&self) -> String {
        format!(
            "{:32}  measured {:7.0}  current {:+6.1} A  duty {:+6.1} %",
            self.part.label(),
            self.measured,
            self.current,
            self.duty,
        )
    }

    fn block(&self) -> String {
        format!(
            "  target    {}\n  measured  {:.0}\n  current   {:+.1} A\n  duty      {:+6.1} %  {}",
            self.part.label(),
            self.measured,
            self.current,
            self.duty,
            bar(self.duty),
        )
    }
}

/// A bar from the middle to one side.
fn bar(percent: f64) -> String {
    let length = ((percent.abs() / 100.0 * BAR as f64).round() as usize).min(BAR);
    let (filled, empty) = ("█".repeat(length), " ".repeat(BAR - length));
    let nothing = " ".repeat(BAR);
    if percent < 0.0 {
        format!("[{empty}{filled}|{nothing}]")
    } else {
        format!("[{nothing}|{filled}{empty}]")
    }
}

/// One line about a finished move.
pub(super) fn summary(report: &Report) -> String {
    let settled = match report.settled {
        Some(time) => format!("settled in {:4} ms", time.as_millis()),
        None => "did not settle".to_owned(),
    };
    let missed = if report.missed() { "  MISSED" } else { "" };
    format!(
        "{:32}  reached {:8.0}  error {:+6.2} %  {settled}{missed}",
        report.part.label(),
        report.reached,
        report.error_percent,
    )
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_bar_grows_from_the_middle() {
        assert_eq!(bar(0.0).chars().filter(|c| *c == '█').count(), 0);
        assert_eq!(bar(50.0).chars().filter(|c| *c == '█').count(), BAR / 2);
        assert!(bar(-100.0).starts_with("[█") && bar(100.0).ends_with("█]"));
        assert_eq!(bar(250.0).chars().count(), 2 * BAR + 3);
    }

    #[test]
    fn a_missed_move_says_so() {
        let report = Report {
            part: Part::Position(100),
            reached: 90.0,
            error_percent: -10.0,
            settled: None,
        };
        let text = summary(&report);
        assert!(text.contains("MISSED") && text.contains("did not settle"));
    }
}
