//! Manual 19.2: twenty Talons, of which two are wired, follow a master with motor safety. While a button is
//! held the master gets no set points and stops; the next "enable" resumes.
//!
//! `cargo run --example talon_motor_safety`

use std::error::Error;
use std::time::Duration;

use windlass::client::talon::{CanTalon, ControlMode, Robot};
use windlass::transport::SimBus;

const MASTER: u8 = 2;

/// Once at the beginning of every enabled period: a timeout of the one before must not last.
fn teleop_init(robot: &Robot<SimBus>, talons: &[CanTalon<SimBus>]) -> Result<(), Box<dyn Error>> {
    let master = &talons[usize::from(MASTER)];
    robot.enable()?;
    master.enable_control();
    master.set_safety_enabled(true);
    master.set_expiration(Duration::from_millis(100));
    master.set(0.0)?;
    Ok(())
}

/// Every 20 ms.
fn teleop_periodic(
    talons: &[CanTalon<SimBus>],
    axis: f64,
    button: bool,
) -> Result<(), Box<dyn Error>> {
    let master = &talons[usize::from(MASTER)];
    // Doing this in every loop does not hurt anything.
    master.set_control_mode(ControlMode::PercentVbus)?;
    if !button {
        master.set(axis)?;
    }
    Ok(())
}

/// Runs the example in virtual time.
pub(crate) fn main() -> Result<(), Box<dyn Error>> {
    let nodes = ["talon:2".parse()?, "talon:7".parse()?];
    let robot = Robot::new(SimBus::with_nodes(&nodes));
    // It does not matter if twenty are really wired or not.
    let mut talons = Vec::new();
    for number in 0..20 {
        let talon = robot.talon(number)?;
        talon.set_control_mode(ControlMode::Follower)?;
        talon.set(f64::from(MASTER))?;
        talons.push(talon);
    }
    talons[usize::from(MASTER)].set_control_mode(ControlMode::PercentVbus)?;
    teleop_init(&robot, &talons)?;
    let drive = |loops: u32, button: bool| -> Result<(i16, i16), Box<dyn Error>> {
        for _ in 0..loops {
            teleop_periodic(&talons, 0.5, button)?;
            robot.run(Duration::from_millis(20))?;
        }
        let throttle = |number: usize| talons[number].applied_throttle().fresh();
        Ok((throttle(usize::from(MASTER))?, throttle(7)?))
    };
    let driving = drive(25, false)?;
    let expired = drive(10, true)?;
    let still = drive(10, false)?;
    println!("driving {driving:?}, button held {expired:?}, released {still:?}");
    let mode = talons[usize::from(MASTER)].mode().fresh()?;
    println!("the master's mode is {mode:?}");
    teleop_init(&robot, &talons)?;
    let resumed = drive(25, false)?;
    println!("after enabling again {resumed:?}");
    let expected = [(511, 511), (0, 0), (0, 0), (511, 511)];
    if [driving, expired, still, resumed] != expected {
        return Err("motor safety did not do what the manual says".into());
    }
    if talons[5].applied_throttle().is_fresh() {
        return Err("a Talon that is not wired reports".into());
    }
    Ok(())
}
