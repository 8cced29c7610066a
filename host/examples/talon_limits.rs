//! Manual 4.3, 4.4, 8 and 14: brake override, limit switches, soft limits, and the faults that they raise.
//!
//! `cargo run --example talon_limits`

use std::error::Error;
use std::time::Duration;

use windlass::client::talon::{CanTalon, LimitMode, NeutralMode, Robot, fault};
use windlass::transport::SimBus;
use windlass_sim::Poke;

fn report(motor: &CanTalon<SimBus>, what: &str) -> Result<i16, Box<dyn Error>> {
    let faults: Vec<&str> = motor.faults().fresh()?.names().collect();
    let sticky: Vec<&str> = motor.sticky_faults().fresh()?.names().collect();
    let throttle = motor.applied_throttle().fresh()?;
    println!("{what}: throttle {throttle}, faults {faults:?}, sticky {sticky:?}");
    Ok(throttle)
}

/// Runs the example in virtual time.
pub(crate) fn main() -> Result<(), Box<dyn Error>> {
    let robot = Robot::new(SimBus::with_nodes(&["talon:0".parse()?]));
    let motor = robot.talon(0)?;
    let close = |closed| {
        robot.lend(|client| {
            let world = client.bus().world();
            world
                .node_mut(0)
                .map(|node| node.poke(Poke::ForwardLimitClosed(closed)))
        })
    };
    robot.enable()?;
    motor.config_neutral_mode(NeutralMode::Brake)?;
    motor.set(0.3)?;
    robot.run(Duration::from_millis(500))?;
    let free = report(&motor, "free")?;

    close(true);
    robot.run(Duration::from_millis(100))?;
    let blocked = report(&motor, "forward switch closed")?;
    motor.config_limit_mode(LimitMode::DisableSwitchInputs)?;
    robot.run(Duration::from_millis(100))?;
    let ignored = report(&motor, "switches not used")?;
    close(false);

    // 20,000 counts from here the soft limit ends the drive.
    motor.set_position(0)?;
    motor.set_forward_soft_limit(20_000)?;
    motor.set_reverse_soft_limit(-20_000)?;
    motor.config_limit_mode(LimitMode::SoftPositionLimits)?;
    motor.clear_sticky_faults()?;
    robot.run(Duration::from_secs(5))?;
    let limited = report(&motor, "at the soft limit")?;
    if [free, blocked, ignored, limited] != [306, 0, 306, 0] {
        return Err("a limit did not do what the manual says".into());
    }
    let sticky = motor.sticky_faults().fresh()?.0;
    if sticky != fault::FORWARD_SOFT_LIMIT || motor.position().fresh()? <= 20_000 {
        return Err("the soft limit is not what ended the drive".into());
    }
    println!("{}", motor.self_test()?);
    Ok(())
}
