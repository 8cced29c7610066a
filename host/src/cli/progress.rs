//! What `windlass flash` shows while it works: a row for each device on a terminal, a line for each phase
//! elsewhere, nothing with `--json`.

use std::io::{self, IsTerminal};
use std::time::Duration;

use indicatif::{MultiProgress, ProgressBar, ProgressDrawTarget, ProgressStyle};
use windlass_core::boot::image::PAGE_SIZE;

use super::output::say;
use super::{Failure, interrupted};
use crate::client::{Address, Device};
use crate::flash::{Observer, Phase, Report};
use crate::remark::remark;

/// How a row looks: device, phase, bar, pages, rate and time left.
const ROW: &str = "{prefix:<12} [{bar:31}] {pos:>2}/{len}  {wide_msg}";

#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Style {
    Rows,
    Lines,
    Silent,
}

/// The rows of all devices.
pub(super) struct Progress {
    style: Style,
    rows: MultiProgress,
}

impl Progress {
    pub(super) fn new(json: bool) -> Self {
        let style = if json {
            Style::Silent
        } else if io::stdout().is_terminal() && io::stderr().is_terminal() {
            Style::Rows
        } else {
            Style::Lines
        };
        let rows = MultiProgress::with_draw_target(ProgressDrawTarget::stderr());
        Self { style, rows }
    }

    /// Ends the rows: the results follow below them, in full length.
    pub(super) fn end<'a>(self, reports: impl Iterator<Item = &'a Report>) -> Result<(), Failure> {
        if self.style != Style::Rows {
            return Ok(());
        }
        drop(self.rows);
        remark(format_args!(""));
        for report in reports {
            say!("device {}: {}", report.address, summary(report))?;
        }
        Ok(())
    }

    /// The row of one device, which waits for its turn.
    pub(super) fn row(&self, device: &Device) -> Row {
        let name = device.address.to_string();
        let bar = (self.style == Style::Rows).then(|| {
            let style = ProgressStyle::with_template(ROW);
            let bar = ProgressBar::new(0).with_prefix(name.clone());
            let bar = bar.with_style(style.unwrap_or_else(|_| ProgressStyle::default_bar()));
            let bar = self.rows.add(bar);
            bar.set_message("waiting");
            bar
        });
        Row {
            style: self.style,
            name,
            bar,
            phase: None,
            first: None,
            failed: None,
        }
    }
}

/// The row of one device.
pub(super) struct Row {
    style: Style,
    name: String,
    bar: Option<ProgressBar>,
    phase: Option<Phase>,
    /// Pages and time when the writing began, for the rate.
    first: Option<(usize, Duration)>,
    /// Output that failed, to be told at the end.
    failed: Option<Failure>,
}

impl Row {
    /// The device's turn has come.
    pub(super) fn begin(&mut self) {
        self.show("look");
    }

    /// The device is done. Also tells output errors of the way there.
    pub(super) fn end(&mut self, result: &Result<Report, Failure>) -> Result<(), Failure> {
        let text = match result {
            Ok(report) => summary(report),
            Err(_) => "failed".to_owned(),
        };
        if let Some(bar) = &self.bar {
            bar.abandon_with_message(match result {
                Ok(report) => format!("version {} runs", report.version),
                Err(_) => text.clone(),
            });
        }
        if let Some(failure) = self.failed.take() {
            return Err(failure);
        }
        match (self.style, result) {
            (Style::Silent | Style::Rows, _) => Ok(()),
            (Style::Lines, Ok(report)) => say!("device {}: {text}", report.address),
            (Style::Lines, Err(_)) => say!("{}  failed", self.name),
        }
    }

    fn show(&mut self, text: &str) {
        match (self.style, &self.bar) {
            (Style::Rows, Some(bar)) => bar.set_message(text.to_owned()),
            (Style::Lines, _) => {
                let shown = say!("{}  {text}", self.name);
                self.failed = self.failed.take().or(shown.err());
            }
            _ => {}
        }
    }
}

/// A finished update in one line.
fn summary(report: &Report) -> String {
    let before = match report.before {
        Some(before) => format!("before: {before}"),
        None => "before: none".to_owned(),
    };
    let seconds = report.took.as_secs_f64();
    let sent = match (report.pages, report.sent) {
        (0, _) => String::new(),
        (_, 0) => ", had every page already".to_owned(),
        (pages, sent) => format!(", {sent} of {pages} pages sent"),
    };
    let trial = match report.confirmed {
        Some(false) => ", on trial",
        _ => "",
    };
    format!(
        "version {} runs ({before}{sent}{trial}, {seconds:.1} s)",
        report.version
    )
}

impl Observer for Row {
    fn phase(&mut self, phase: Phase) {
        if self.phase == Some(phase) {
            return;
        }
        self.phase = Some(phase);
        self.first = None;
        self.show(phase.name());
    }

    fn pages(&mut self, stored: usize, of: usize, now: Duration) {
        let Some(bar) = &self.bar else {
            return;
        };
        bar.set_length(of as u64);
        bar.set_position(stored as u64);
        let (pages, since) = *self.first.get_or_insert((stored, now));
        let seconds = now.saturating_sub(since).as_secs_f64();
        let written = stored.saturating_sub(pages);
        let phase = self.phase.map_or("", Phase::name);
        if written == 0 || seconds <= 0.0 {
            bar.set_message(phase.to_owned());
            return;
        }
        let rate = (written * PAGE_SIZE) as f64 / seconds / 1000.0;
        let left = of.saturating_sub(stored) as f64 * seconds / written as f64;
        bar.set_message(format!("{phase}  {rate:.1} kB/s, {left:.1} s left"));
    }

    fn lost(&mut self, reason: &str) {
        self.phase = None;
        self.show(&format!("lost: {reason}; looking for it"));
    }

    fn found(&mut self, address: Address) {
        self.show(&format!("found as {address}, going on"));
    }

    fn is_cancelled(&self) -> bool {
        interrupted() || self.failed.is_some()
    }
}
