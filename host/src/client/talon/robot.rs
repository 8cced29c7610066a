//! The robot controller: enables, disables and sends control frames periodically.

use std::cell::RefCell;
use std::collections::BTreeMap;
use std::rc::Rc;
use std::time::Duration;

use windlass_core::dialect::talon_srx::wire::{
    Control1, Control5, General, GlobalEnable, MAX_DEVICE_NUMBER, ModeSelect, id,
};
use windlass_core::frame::Frame;

use super::can_talon::ControlMode;
use super::safety::MotorSafety;
use super::{CanTalon, TalonError, TalonStatus};
use crate::client::Client;
use crate::transport::{Bus, BusError};

/// Period of the control frame in ms when none was chosen (manual 3.4, 20.7).
pub const CONTROL_PERIOD_MS: u32 = 10;
/// Periods that a control frame may have; above, the device would take the host for gone.
const CONTROL_PERIODS_MS: std::ops::RangeInclusive<u32> = 1..=95;
/// How often [`EnableStyle::Global`] repeats its enable frame.
pub const GLOBAL_PERIOD: Duration = Duration::from_millis(50);
/// How long a parameter's answer may take.
pub const ANSWER_TIME: Duration = Duration::from_millis(4);

/// How the controllers learn that they may drive.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum EnableStyle {
    /// As the FRC robot controller: control frames are only sent while enabled, and their arrival is what
    /// enables (manual 16.2).
    #[default]
    ControlFrame,
    /// As controllers outside FRC: control frames that do not enable are always sent, and one frame to
    /// everybody, every 50 ms, enables or disables.
    Global,
}

/// What the host knows and wants of one Talon.
#[derive(Debug)]
pub(super) struct Motor {
    /// The control frame that is repeated.
    pub(super) control: General,
    /// The mode of the next set point.
    pub(super) mode: ControlMode,
    /// False after motor safety or `disable`, until `enable_control`.
    pub(super) control_enabled: bool,
    pub(super) set_point: f64,
    pub(super) safety: MotorSafety,
    /// Motor safety has ended the drive this often.
    pub(super) expirations: u32,
    pub(super) status_periods: [u8; 4],
    pub(super) last_self_test: Option<Duration>,
    period: Duration,
    due: Duration,
}

impl Motor {
    fn new(period: Duration, now: Duration) -> Self {
        Self {
            control: General {
                mode: ModeSelect::NoDrive,
                ..General::default()
            },
            mode: ControlMode::PercentVbus,
            control_enabled: true,
            set_point: 0.0,
            safety: MotorSafety::default(),
            expirations: 0,
            status_periods: [10, 20, 100, 100],
            last_self_test: None,
            period,
            due: now,
        }
    }

    /// Ends the drive until `enable_control`.
    pub(super) const fn stop(&mut self) {
        self.control.mode = ModeSelect::NoDrive;
        self.control_enabled = false;
    }
}

/// What all handles share.
#[derive(Debug)]
pub(super) struct Shared<B> {
    pub(super) client: Client<B>,
    pub(super) motors: BTreeMap<u8, Motor>,
    pub(super) answer_time: Duration,
    style: EnableStyle,
    enabled: bool,
    global_due: Duration,
    /// Stands in for devices that never sent a frame.
    silent: TalonStatus,
}

impl<B: Bus> Shared<B> {
    pub(super) fn now(&self) -> Duration {
        self.client.now()
    }

    pub(super) fn status(&self, number: u8) -> &TalonStatus {
        self.client.talon_status(number).unwrap_or(&self.silent)
    }

    fn transmits(&self) -> bool {
        self.enabled || self.style == EnableStyle::Global
    }

    /// Sends the control frame of a Talon at once; the period counts from here. Without permission to send
    /// the change waits in the frame.
    pub(super) fn flush(&mut self, number: u8) -> Result<(), BusError> {
        let now = self.now();
        if !self.transmits() {
            return Ok(());
        }
        let Some(motor) = self.motors.get_mut(&number) else {
            return Ok(());
        };
        motor.due = now + motor.period;
        let general = motor.control;
        let frame = match self.style {
            EnableStyle::ControlFrame => Control1 {
                token: 0,
                general: Some(general),
            }
            .emit(number),
            EnableStyle::Global => Control5 { bump: 0, general }.emit(number),
        };
        self.client.send(&frame)
    }

    /// Sends everything that is due and ends what motor safety ends.
    fn service(&mut self) -> Result<(), BusError> {
        let now = self.now();
        if self.style == EnableStyle::Global && now >= self.global_due {
            self.send_global()?;
        }
        let mut due = Vec::new();
        for (number, motor) in &mut self.motors {
            let expired = motor.safety.deadline().is_some_and(|at| now >= at);
            if expired && motor.control_enabled {
                motor.stop();
                motor.expirations += 1;
                due.push(*number);
            } else if now >= motor.due {
                due.push(*number);
            }
        }
        for number in due {
            self.flush(number)?;
        }
        Ok(())
    }

    fn send_global(&mut self) -> Result<(), BusError> {
        self.global_due = self.now() + GLOBAL_PERIOD;
        let enabled = self.enabled;
        self.client.send(&GlobalEnable { enabled }.emit())
    }

    /// When [`Shared::service`] has to look again.
    fn next_due(&self) -> Option<Duration> {
        let transmits = self.transmits();
        let frames = self.motors.values().map(|motor| motor.due);
        let frames = frames.filter(|_| transmits);
        let expiries = self.motors.values().filter_map(|motor| {
            let deadline = motor.safety.deadline();
            deadline.filter(|_| motor.control_enabled)
        });
        let global = (self.style == EnableStyle::Global).then_some(self.global_due);
        frames.chain(expiries).chain(global).min()
    }

    /// Lets time pass until `until`, or until `done` finds what it waits for.
    pub(super) fn run_until(
        &mut self,
        until: Duration,
        mut done: impl FnMut(&Self) -> bool,
    ) -> Result<bool, BusError> {
        loop {
            if done(self) {
                return Ok(true);
            }
            let now = self.now();
            if now >= until {
                return Ok(false);
            }
            self.service()?;
            let stop = self.next_due().map_or(until, |due| due.min(until));
            self.client.receive(stop.saturating_sub(self.now()))?;
        }
    }
}

/// The robot controller on one bus. Clones are handles to the same one.
#[derive(Debug)]
pub struct Robot<B> {
    shared: Rc<RefCell<Shared<B>>>,
}

impl<B> Clone for Robot<B> {
    fn clone(&self) -> Self {
        Self {
            shared: Rc::clone(&self.shared),
        }
    }
}

impl<B: Bus> Robot<B> {
    /// A disabled robot on a bus.
    pub fn new(bus: B) -> Self {
        Self::with_client(Client::new(bus))
    }

    /// A disabled robot that shares its bus with a client of the management channel.
    pub fn with_client(client: Client<B>) -> Self {
        Self {
            shared: Rc::new(RefCell::new(Shared {
                client,
                motors: BTreeMap::new(),
                answer_time: ANSWER_TIME,
                style: EnableStyle::default(),
                enabled: false,
                global_due: Duration::ZERO,
                silent: TalonStatus::default(),
            })),
        }
    }

    /// The same robot with another way to enable.
    #[must_use]
    pub fn with_enable_style(self, style: EnableStyle) -> Self {
        self.shared.borrow_mut().style = style;
        self
    }

    /// The same robot with another time for parameters to be answered, for slow transports.
    #[must_use]
    pub fn with_answer_time(self, time: Duration) -> Self {
        self.shared.borrow_mut().answer_time = time;
        self
    }

    /// The Talon with this number, with a control frame every 10 ms. It need not be there (manual 16.6).
    ///
    /// # Errors
    /// The number is above 62.
    pub fn talon(&self, number: u8) -> Result<CanTalon<B>, TalonError> {
        self.talon_with_period(number, CONTROL_PERIOD_MS)
    }

    /// The Talon with this number, with a control frame every `period_ms` milliseconds.
    ///
    /// # Errors
    /// The number is above 62, or the period is not within 1 to 95 ms.
    pub fn talon_with_period(&self, number: u8, period_ms: u32) -> Result<CanTalon<B>, TalonError> {
        if number > MAX_DEVICE_NUMBER {
            return Err(TalonError::invalid(format!(
                "device number {number} is out of range; allowed: 0 to {MAX_DEVICE_NUMBER}"
            )));
        }
        if !CONTROL_PERIODS_MS.contains(&period_ms) {
            return Err(TalonError::invalid(format!(
                "control period {period_ms} ms is out of range; allowed: 1 to 95 ms"
            )));
        }
        let period = Duration::from_millis(u64::from(period_ms));
        let mut shared = self.shared.borrow_mut();
        let now = shared.now();
        let motor = shared
            .motors
            .entry(number)
            .or_insert_with(|| Motor::new(period, now));
        motor.period = period;
        drop(shared);
        Ok(CanTalon::new(Rc::clone(&self.shared), number))
    }

    /// Enables: the control frame of every Talon is sent now and periodically from now on.
    ///
    /// # Errors
    /// The bus failed.
    pub fn enable(&self) -> Result<(), TalonError> {
        let mut shared = self.shared.borrow_mut();
        shared.enabled = true;
        if shared.style == EnableStyle::Global {
            shared.send_global()?;
        }
        let numbers: Vec<u8> = shared.motors.keys().copied().collect();
        for number in numbers {
            shared.flush(number)?;
        }
        Ok(())
    }

    /// Disables every device on the bus at once.
    ///
    /// # Errors
    /// The bus failed.
    pub fn disable(&self) -> Result<(), TalonError> {
        let mut shared = self.shared.borrow_mut();
        shared.enabled = false;
        match shared.style {
            EnableStyle::ControlFrame => {
                shared.client.send(&Frame::extended(id::DISABLE_ALL, []))?;
            }
            EnableStyle::Global => shared.send_global()?,
        }
        Ok(())
    }

    /// True between [`Robot::enable`] and [`Robot::disable`].
    #[must_use]
    pub fn is_enabled(&self) -> bool {
        self.shared.borrow().enabled
    }

    /// Lets `span` pass: sends what is due, notes what arrives, ends drives whose motor safety expires.
    ///
    /// # Errors
    /// The bus failed.
    pub fn run(&self, span: Duration) -> Result<(), TalonError> {
        let mut shared = self.shared.borrow_mut();
        let until = shared.now() + span;
        shared.run_until(until, |_| false)?;
        Ok(())
    }

    /// Time on the bus.
    #[must_use]
    pub fn now(&self) -> Duration {
        self.shared.borrow().now()
    }

    /// Lends the client underneath: management channel, traffic, the bus itself.
    pub fn lend<T>(&self, use_it: impl FnOnce(&mut Client<B>) -> T) -> T {
        use_it(&mut self.shared.borrow_mut().client)
    }
}
