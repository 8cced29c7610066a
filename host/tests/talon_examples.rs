//! The examples repeat those of the Talon SRX manual; each ends with a check of its own, which fails here.

#[path = "../examples/talon_closed_loop.rs"]
mod closed_loop;
#[path = "../examples/talon_drive.rs"]
mod drive;
#[path = "../examples/talon_follower.rs"]
mod follower;
#[path = "../examples/talon_limits.rs"]
mod limits;
#[path = "../examples/talon_motor_safety.rs"]
mod motor_safety;

#[test]
fn row_101_basic_drive_and_signals() {
    drive::main().unwrap();
}

#[test]
fn row_101_closed_loop() {
    closed_loop::main().unwrap();
}

#[test]
fn row_101_motor_safety() {
    motor_safety::main().unwrap();
}

#[test]
fn row_101_limits_and_faults() {
    limits::main().unwrap();
}

#[test]
fn row_101_follower_and_ramp() {
    follower::main().unwrap();
}
