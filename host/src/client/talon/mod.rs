//! Client of the Talon SRX protocol, with the API that its manual teaches.
//!
//! [`Robot`] stands for the robot controller: it owns the bus, enables and disables, and sends the control
//! frame of every [`CanTalon`] again and again while [`Robot::run`] lets time pass, virtual on a simulated
//! bus and real on others. [`CanTalon`] is one motor controller: what is set goes into its control frame,
//! what is read comes from its status frames.
//!
//! ```
//! use std::time::Duration;
//! use windlass::client::talon::Robot;
//! use windlass::transport::SimBus;
//!
//! let robot = Robot::new(SimBus::with_nodes(&["talon:3".parse()?]));
//! let motor = robot.talon(3)?;
//! robot.enable()?;
//! motor.set(0.5)?;
//! robot.run(Duration::from_millis(500))?;
//! assert_eq!(motor.applied_throttle().fresh()?, 511);
//! # Ok::<(), Box<dyn std::error::Error>>(())
//! ```
//!
//! Source: Talon SRX Software Reference Manual; docs/talon-srx-client.md tells how the names of its C++ and
//! Java examples are called here.

mod can_talon;
mod error;
mod getters;
mod parameters;
mod robot;
mod safety;
mod self_test;
mod status;
pub mod units;

pub use can_talon::{CanTalon, ControlMode, LimitMode, NeutralMode, StatusFrame};
pub use error::TalonError;
pub use getters::{FaultBits, fault};
pub use parameters::Profile;
pub use robot::{ANSWER_TIME, CONTROL_PERIOD_MS, EnableStyle, GLOBAL_PERIOD, Robot};
pub use safety::DEFAULT_EXPIRATION;
pub use self_test::{Pin, QUICK_SUCCESSION, SelfTest, mode_name};
pub(crate) use status::mode_word;
pub use status::{Reading, STALE_AFTER, Stamped, TalonStatus};

pub(super) use status::sender;
