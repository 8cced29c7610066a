//! The manual's self-test: everything a Talon reports, captured at one moment (manual 2.4).

use std::fmt;
use std::time::Duration;

use windlass_core::dialect::talon_srx::wire::{
    self, FeedbackDevice, LimitOverride, ModeSelect, Status1, Status2, Status3, Status4,
};

use super::getters::FaultBits;
use super::{CanTalon, TalonError, TalonStatus, units};
use crate::transport::Bus;

/// A self-test within this time after the one before clears the sticky faults (manual 2.4.1, "in a rapid
/// fashion").
pub const QUICK_SUCCESSION: Duration = Duration::from_secs(3);
/// Time in which every periodic frame comes at least once: their longest period and some more.
const CAPTURE_TIME: Duration = Duration::from_millis(300);
/// Time for the cleared faults to show: two periods of the feedback status and some more.
const CLEAR_TIME: Duration = Duration::from_millis(60);

/// A limit switch.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Pin {
    /// The switch connects its pin to ground.
    pub closed: bool,
    /// Whether the control frame forces the switch on or off; none if what is stored counts.
    pub forced: Option<bool>,
}

/// A report. Without a response it shows the last values that were known, zeros if there were none.
#[derive(Clone, Debug, PartialEq)]
pub struct SelfTest {
    /// Device number.
    pub number: u8,
    /// Frames came within the last 200 ms.
    pub responding: bool,
    /// Firmware version, major and minor, if the device told it.
    pub version: Option<(u8, u8)>,
    /// The sticky faults were cleared by this self-test.
    pub cleared: bool,
    /// There are values to show: frames came once.
    known: bool,
    general: Status1,
    feedback: Status2,
    encoder: Status3,
    analog: Status4,
}

impl<B: Bus> CanTalon<B> {
    /// Captures a report. A second one in quick succession clears the sticky faults first, as a double
    /// click on the web page's button does (manual 2.4.1).
    ///
    /// # Errors
    /// The bus failed. A device that is not there is no error: the report says so.
    pub fn self_test(&self) -> Result<SelfTest, TalonError> {
        let (now, before) = {
            let mut shared = self.shared.borrow_mut();
            let now = shared.now();
            let motor = shared.motors.get_mut(&self.number);
            (
                now,
                motor.and_then(|motor| motor.last_self_test.replace(now)),
            )
        };
        let again = before.is_some_and(|before| now.saturating_sub(before) <= QUICK_SUCCESSION);
        self.self_test_clearing(again)
    }

    /// Captures a report, after clearing the sticky faults if `clear` says so.
    ///
    /// # Errors
    /// As [`CanTalon::self_test`].
    pub fn self_test_clearing(&self, clear: bool) -> Result<SelfTest, TalonError> {
        if clear {
            self.clear_sticky_faults()?;
            let mut shared = self.shared.borrow_mut();
            let until = shared.now() + CLEAR_TIME;
            shared.run_until(until, |_| false)?;
        }
        {
            let mut shared = self.shared.borrow_mut();
            let (from, number) = (shared.now(), self.number);
            shared.run_until(from + CAPTURE_TIME, |shared| {
                is_complete(shared.status(number), from)
            })?;
        }
        let version = match self.firmware_version() {
            Ok(version) => Some(version),
            Err(TalonError::NotUpdated { .. }) => None,
            Err(error) => return Err(error),
        };
        let now = self.shared.borrow().now();
        let mut report = SelfTest::capture(self.number, &self.status(), now);
        report.version = version.or(report.version);
        report.cleared = clear;
        Ok(report)
    }
}

/// True if every periodic frame has come since `from`.
fn is_complete(status: &TalonStatus, from: Duration) -> bool {
    let times = [
        status.general.map(|stamped| stamped.at),
        status.feedback.map(|stamped| stamped.at),
        status.encoder.map(|stamped| stamped.at),
        status.analog.map(|stamped| stamped.at),
    ];
    times.iter().all(|at| at.is_some_and(|at| at >= from))
}

impl SelfTest {
    /// The report of a status at `now`, without the version a running device tells on request.
    #[must_use]
    pub fn capture(number: u8, status: &TalonStatus, now: Duration) -> Self {
        Self {
            number,
            responding: !status.is_stale(now),
            version: status
                .start_up
                .map(|stamped| (stamped.value.version[0], stamped.value.version[1])),
            cleared: false,
            known: status.general.is_some() || status.feedback.is_some() || status.analog.is_some(),
            general: status
                .general
                .map(|stamped| stamped.value)
                .unwrap_or_default(),
            feedback: status
                .feedback
                .map(|stamped| stamped.value)
                .unwrap_or_default(),
            encoder: status
                .encoder
                .map(|stamped| stamped.value)
                .unwrap_or_default(),
            analog: status
                .analog
                .map(|stamped| stamped.value)
                .unwrap_or_default(),
        }
    }

    /// True while the device accepts to be driven.
    #[must_use]
    pub const fn enabled(&self) -> bool {
        self.general.token_locked
    }

    /// The mode in force.
    #[must_use]
    pub const fn mode(&self) -> ModeSelect {
        self.general.mode
    }

    /// Faults that are present.
    #[must_use]
    pub fn faults(&self) -> FaultBits {
        self.general.faults.into()
    }

    /// Faults that have been present since they were last cleared.
    #[must_use]
    pub fn sticky_faults(&self) -> FaultBits {
        self.feedback.sticky.into()
    }

    /// The forward limit switch.
    #[must_use]
    pub const fn forward_limit(&self) -> Pin {
        let forced = match self.general.limits {
            LimitOverride::Forced { forward, .. } => Some(forward),
            LimitOverride::Stored(_) => None,
        };
        Pin {
            closed: self.general.forward_closed,
            forced,
        }
    }

    /// The reverse limit switch.
    #[must_use]
    pub const fn reverse_limit(&self) -> Pin {
        let forced = match self.general.limits {
            LimitOverride::Forced { reverse, .. } => Some(reverse),
            LimitOverride::Stored(_) => None,
        };
        Pin {
            closed: self.general.reverse_closed,
            forced,
        }
    }

    /// Battery voltage in volts.
    #[must_use]
    pub fn battery(&self) -> f64 {
        wire::battery(self.analog.battery).to_num()
    }

    /// Temperature in degrees Celsius.
    #[must_use]
    pub fn temperature(&self) -> f64 {
        wire::temperature(self.analog.temperature).to_num()
    }

    /// Motor current in amperes.
    #[must_use]
    pub fn current(&self) -> f64 {
        wire::current(self.feedback.current).to_num()
    }

    /// Every line of the report with its label; none if no frame ever came.
    #[must_use]
    pub fn lines(&self) -> Vec<(&'static str, String)> {
        if !self.known {
            return Vec::new();
        }
        let (general, feedback) = (&self.general, &self.feedback);
        let (encoder, analog) = (&self.encoder, &self.analog);
        let share = units::share(general.throttle);
        let level = |high: bool| if high { "high" } else { "low" };
        vec![
            ("Mode", mode_name(general.mode).to_owned()),
            ("Faults", fault_text(self.faults(), general.faults.hardware)),
            ("Sticky faults", fault_text(self.sticky_faults(), false)),
            ("Fwd. limit switch", self.forward_limit().to_string()),
            ("Rev. limit switch", self.reverse_limit().to_string()),
            (
                "Applied throttle",
                format!("{} ({:+.1} %)", general.throttle, share * 100.0),
            ),
            ("Output voltage", format!("{:.2} V", share * self.battery())),
            ("Current", format!("{:.3} A", self.current())),
            (
                "Brake during neutral",
                if feedback.brake { "brake" } else { "coast" }.to_owned(),
            ),
            ("Profile slot", u8::from(feedback.slot_1).to_string()),
            ("Closed-loop error", general.error.to_string()),
            ("Selected device", device_name(general.feedback)),
            ("  position", TalonStatus::position(*feedback).to_string()),
            ("  velocity", TalonStatus::velocity(*feedback).to_string()),
            (
                "Quadrature encoder",
                format!(
                    "position {}, velocity {}",
                    encoder.position, encoder.velocity
                ),
            ),
            (
                "  pins",
                format!(
                    "A {}, B {}, index {} ({} rises)",
                    level(encoder.pin_a),
                    level(encoder.pin_b),
                    level(encoder.pin_index),
                    encoder.index_rises
                ),
            ),
            (
                "Analog input",
                format!("position {}, velocity {}", analog.position, analog.velocity),
            ),
            ("  ADC", (analog.position & 0x3FF).to_string()),
            ("Battery", format!("{:.2} V", self.battery())),
            ("Temperature", format!("{:.1} C", self.temperature())),
        ]
    }
}

impl fmt::Display for SelfTest {
    fn fmt(&self, out: &mut fmt::Formatter<'_>) -> fmt::Result {
        if !self.responding {
            writeln!(
                out,
                "X  Talon SRX (Device ID {}) is not responding{}",
                self.number,
                if self.known {
                    "; the values below are the last ones known"
                } else {
                    ""
                }
            )?;
        } else if self.enabled() {
            writeln!(out, "Talon SRX (Device ID {}) is ENABLED", self.number)?;
        } else {
            writeln!(out, "TALON IS NOT ENABLED!  (Device ID {})", self.number)?;
        }
        for (label, text) in self.lines() {
            writeln!(out, "  {label:<21} {text}")?;
        }
        if self.cleared {
            writeln!(out, "  sticky faults were cleared by this second self-test")?;
        }
        let version = match self.version {
            Some((major, minor)) => format!("{major}.{minor}"),
            None => "?".to_owned(),
        };
        writeln!(out, "  {:<21} {version}", "Firmware")?;
        write!(
            out,
            "  {:<21} windlass {}, built {}",
            "Library",
            env!("CARGO_PKG_VERSION"),
            build_time()
        )
    }
}

impl fmt::Display for Pin {
    fn fmt(&self, out: &mut fmt::Formatter<'_>) -> fmt::Result {
        out.write_str(if self.closed { "closed" } else { "open" })?;
        match self.forced {
            Some(true) => out.write_str(", forced ON"),
            Some(false) => out.write_str(", forced OFF"),
            None => Ok(()),
        }
    }
}

fn fault_text(faults: FaultBits, hardware: bool) -> String {
    let mut names: Vec<&str> = faults.names().collect();
    if hardware {
        names.push("Hardware Failure");
    }
    if names.is_empty() {
        return "none".to_owned();
    }
    names.join(", ")
}

/// A mode as the manual's self-test calls it.
#[must_use]
pub fn mode_name(mode: ModeSelect) -> &'static str {
    match mode {
        ModeSelect::Duty => "Throttle (duty cycle)",
        ModeSelect::Position => "Position closed loop",
        ModeSelect::Velocity => "Velocity closed loop",
        ModeSelect::Current => "Current closed loop (not supported)",
        ModeSelect::VoltageCompensation => "Voltage compensation (not supported)",
        ModeSelect::Follower => "Slave follower",
        ModeSelect::NoDrive => "No Drive",
        ModeSelect::Reserved(_) => "unknown (not supported)",
    }
}

fn device_name(device: FeedbackDevice) -> String {
    match device {
        FeedbackDevice::Quadrature => "Quadrature Encoder".to_owned(),
        FeedbackDevice::AnalogPotentiometer => "Analog Potentiometer".to_owned(),
        FeedbackDevice::AnalogEncoder => "Analog Encoder".to_owned(),
        FeedbackDevice::RisingEdges => "EncRising".to_owned(),
        FeedbackDevice::Unsupported(code) => format!("code {code} (not supported)"),
    }
}

/// When this library was built, in UTC.
fn build_time() -> String {
    let seconds: i64 = env!("WINDLASS_BUILD_SECONDS").parse().unwrap_or_default();
    utc(seconds)
}

/// Seconds since 1970 as date and time (the days-to-civil algorithm over 400-year eras that start in March).
fn utc(seconds: i64) -> String {
    let (days, second) = (seconds.div_euclid(86_400), seconds.rem_euclid(86_400));
    let shifted = days + 719_468;
    let (era, day_of_era) = (shifted.div_euclid(146_097), shifted.rem_euclid(146_097));
    let year_of_era =
        (day_of_era - day_of_era / 1_460 + day_of_era / 36_524 - day_of_era / 146_096) / 365;
    let day_of_year = day_of_era - (365 * year_of_era + year_of_era / 4 - year_of_era / 100);
    let month_from_march = (5 * day_of_year + 2) / 153;
    let day = day_of_year - (153 * month_from_march + 2) / 5 + 1;
    let month = if month_from_march < 10 {
        month_from_march + 3
    } else {
        month_from_march - 9
    };
    let year = year_of_era + era * 400 + i64::from(month <= 2);
    let (hour, minute) = (second / 3600, second / 60 % 60);
    format!("{year:04}-{month:02}-{day:02} {hour:02}:{minute:02} UTC")
}

#[cfg(test)]
mod tests {
    use super::*;
    use windlass_core::dialect::talon_srx::wire::{LiveFaults, Sticky};

    use super::super::Stamped;

    fn status(general: Status1, feedback: Status2) -> TalonStatus {
        fn at<T>(value: T) -> Option<Stamped<T>> {
            Some(Stamped {
                value,
                at: Duration::ZERO,
            })
        }
        TalonStatus {
            general: at(general),
            feedback: at(feedback),
            encoder: at(Status3::default()),
            analog: at(Status4 {
                battery: 174,
                ..Status4::default()
            }),
            ..TalonStatus::default()
        }
    }

    #[test]
    fn row_17_a_disabled_talon_is_told_at_the_top() {
        let status = status(Status1::default(), Status2::default());
        let text = SelfTest::capture(3, &status, Duration::ZERO).to_string();
        assert!(text.starts_with("TALON IS NOT ENABLED!"), "{text}");
        assert!(text.contains("No Drive"), "{text}");
        let last = text.lines().last().unwrap();
        assert!(last.contains("built 2"), "{last}");
    }

    #[test]
    fn row_16_the_report_shows_forced_states_faults_and_battery() {
        let general = Status1 {
            token_locked: true,
            throttle: -512,
            mode: ModeSelect::Duty,
            forward_closed: true,
            limits: LimitOverride::Forced {
                forward: false,
                reverse: true,
            },
            faults: LiveFaults {
                reverse_limit: true,
                ..LiveFaults::default()
            },
            ..Status1::default()
        };
        let feedback = Status2 {
            sticky: Sticky {
                under_voltage: true,
                ..Sticky::default()
            },
            brake: true,
            ..Status2::default()
        };
        let report = SelfTest::capture(3, &status(general, feedback), Duration::ZERO);
        let text = report.to_string();
        for part in [
            "is ENABLED",
            "closed, forced OFF",
            "open, forced ON",
            "Rev. Limit Switch",
            "Under Vbat",
            "-512 (-50.0 %)",
            "12.70 V",
            "brake",
        ] {
            assert!(text.contains(part), "{part} is missing in\n{text}");
        }
    }

    #[test]
    fn row_77_a_device_that_does_not_respond_is_marked_and_shows_stale_values() {
        let general = Status1 {
            error: 42,
            ..Status1::default()
        };
        let old = status(general, Status2::default());
        let text = SelfTest::capture(3, &old, Duration::from_millis(201)).to_string();
        assert!(
            text.starts_with("X  ") && text.contains("not responding"),
            "{text}"
        );
        assert!(text.contains("42"), "{text}");
    }

    #[test]
    fn dates_are_right_around_leap_days() {
        assert_eq!(utc(0), "1970-01-01 00:00 UTC");
        assert_eq!(utc(951_782_399), "2000-02-28 23:59 UTC");
        assert_eq!(utc(951_782_400), "2000-02-29 00:00 UTC");
        assert_eq!(utc(1_767_225_599), "2025-12-31 23:59 UTC");
    }
}
