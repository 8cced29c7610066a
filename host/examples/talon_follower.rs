//! Manual 6 and 9: a slave follows a ramped master, turned round, and stops when the master's power fails.
//!
//! `cargo run --example talon_follower`

use std::error::Error;
use std::time::Duration;

use windlass::client::talon::{ControlMode, Robot};
use windlass::transport::SimBus;
use windlass_sim::Poke;

/// Runs the example in virtual time.
pub(crate) fn main() -> Result<(), Box<dyn Error>> {
    let nodes = ["talon:2".parse()?, "talon:3".parse()?];
    let robot = Robot::new(SimBus::with_nodes(&nodes));
    let (master, slave) = (robot.talon(2)?, robot.talon(3)?);
    robot.enable()?;
    slave.set_control_mode(ControlMode::Follower)?;
    slave.set(f64::from(master.device_id()))?;
    slave.reverse_output(true)?;
    // 0 V to 6 V in one second.
    master.set_voltage_ramp_rate(6.0)?;
    master.set(0.5)?;
    let mut seen = Vec::new();
    for _ in 0..6 {
        robot.run(Duration::from_millis(250))?;
        seen.push((
            master.applied_throttle().fresh()?,
            slave.applied_throttle().fresh()?,
        ));
    }
    println!("master and slave every 250 ms: {seen:?}");
    if seen
        .iter()
        .any(|(master, slave)| (master + slave).abs() > 10)
    {
        return Err("the slave does not mirror the master".into());
    }
    if seen.last() != Some(&(511, -511)) || seen.first().is_none_or(|first| first.0 > 150) {
        return Err("the ramp is wrong".into());
    }
    robot.lend(|client| {
        let world = client.bus().world();
        world
            .node_mut(0)
            .map(|node| node.poke(Poke::Powered(false)))
    });
    robot.run(Duration::from_millis(150))?;
    let left = slave.applied_throttle().fresh()?;
    println!("150 ms after the master lost its power: {left}");
    if left != 0 || master.applied_throttle().age < Some(Duration::from_millis(100)) {
        return Err("the slave went on without its master".into());
    }
    Ok(())
}
