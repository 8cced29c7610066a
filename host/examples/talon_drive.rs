//! Manual 3.4 and 5.2: a gamepad axis drives a motor, and everything the Talon reports is printed.
//!
//! `cargo run --example talon_drive`

use std::error::Error;
use std::time::Duration;

use windlass::client::talon::Robot;
use windlass::transport::SimBus;

/// Runs the example in virtual time.
pub(crate) fn main() -> Result<(), Box<dyn Error>> {
    let robot = Robot::new(SimBus::with_nodes(&["talon:0".parse()?]));
    let custom_motor = robot.talon(0)?;
    robot.enable()?;
    // The period of a robot's program is 20 ms; here the stick is pushed forward in two seconds.
    for step in 0..=100 {
        let left_axis = f64::from(step) / 100.0;
        custom_motor.set(left_axis)?;
        robot.run(Duration::from_millis(20))?;
        if step % 25 == 24 {
            println!("currentAmps: {:.3}", custom_motor.output_current().fresh()?);
            println!("outputV: {:.2}", custom_motor.output_voltage().fresh()?);
            println!("busV: {:.2}", custom_motor.bus_voltage().fresh()?);
            println!("quadEncoderPos: {}", custom_motor.enc_position().fresh()?);
            println!("quadEncoderVelocity: {}", custom_motor.enc_vel().fresh()?);
            println!("analogPos: {}", custom_motor.analog_in().fresh()?);
            println!("analogVelocity: {}", custom_motor.analog_in_vel().fresh()?);
            println!("selectedSensorPos: {}", custom_motor.position().fresh()?);
            println!("selectedSensorSpeed: {}", custom_motor.speed().fresh()?);
            println!(
                "closeLoopErr: {}\n",
                custom_motor.closed_loop_error().fresh()?
            );
        }
    }
    robot.run(Duration::from_millis(500))?;
    let (throttle, speed) = (custom_motor.applied_throttle(), custom_motor.enc_vel());
    if throttle.fresh()? != 1023 || speed.fresh()? < 10_000 {
        return Err("the motor does not run at full throttle".into());
    }
    println!("full throttle, {} counts per 100 ms", speed.value);
    Ok(())
}
