//! Manual 12 and 13: velocity and position closed loop with two motor control profiles, clearing the
//! accumulated error, and setting the sensor's position.
//!
//! `cargo run --example talon_closed_loop`

use std::error::Error;
use std::time::Duration;

use windlass::client::talon::{ControlMode, Profile, Robot};
use windlass::transport::SimBus;
use windlass_core::dialect::talon_srx::wire::FeedbackDevice;

/// Runs the example in virtual time.
pub(crate) fn main() -> Result<(), Box<dyn Error>> {
    let robot = Robot::new(SimBus::with_nodes(&["talon:0".parse()?]));
    let motor = robot.talon(0)?;
    robot.enable()?;
    robot.run(Duration::from_millis(100))?;

    motor.set_feedback_device(FeedbackDevice::Quadrature)?;
    motor.set_sensor_direction(false)?;
    // Profile 0 for velocity: the feed-forward is 1023 throttle units over the speed at full throttle.
    let velocity = Profile {
        p: 0.01,
        i: 0.0001,
        f: 0.0268,
        ..Profile::default()
    };
    // Profile 1 for position; within 200 counts the integral overcomes friction.
    let position = Profile {
        p: 0.1,
        i: 0.001,
        d: 3.0,
        i_zone: 200,
        ..Profile::default()
    };
    motor.set_profile(1, &position)?;
    motor.set_profile(0, &velocity)?;

    motor.set_control_mode(ControlMode::Speed)?;
    motor.set(15_000.0)?;
    robot.run(Duration::from_secs(2))?;
    let speed = motor.speed().fresh()?;
    println!(
        "velocity {speed} counts per 100 ms, error {}",
        motor.closed_loop_error().fresh()?
    );
    if speed.abs_diff(15_000) > 450 {
        return Err("the velocity is not reached".into());
    }

    motor.set_control_mode(ControlMode::PercentVbus)?;
    motor.set(0.0)?;
    robot.run(Duration::from_secs(2))?;
    // The armature stands in its home position now.
    motor.set_position(0)?;
    motor.select_profile_slot(1)?;
    motor.set_control_mode(ControlMode::Position)?;
    motor.set(3.0 * 4096.0)?;
    robot.run(Duration::from_secs(4))?;
    let position = motor.position().fresh()?;
    println!(
        "position {position} counts, error {}",
        motor.closed_loop_error().fresh()?
    );
    if position.abs_diff(3 * 4096) > 20 {
        return Err("the position is not reached".into());
    }
    // Close enough: no more creeping by a slowly growing integral.
    motor.clear_iaccum()?;
    println!("accumulated error {}", motor.iaccum()?);
    robot.disable()?;
    robot.run(Duration::from_millis(100))?;
    if motor.is_enabled().fresh()? {
        return Err("the motor is still enabled".into());
    }
    Ok(())
}
