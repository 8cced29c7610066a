//! What the Talon client puts on the bus and how it takes what comes, frame by frame in virtual time. A
//! DMC60C acknowledges the frames; another CAN tool plays the Talon where one is needed.

use std::time::Duration;

use windlass::client::talon::{
    CanTalon, ControlMode, EnableStyle, NeutralMode, Robot, StatusFrame, TalonError,
};
use windlass::transport::SimBus;
use windlass_core::dialect::talon_srx::wire::{FeedbackDevice, ModeSelect, Parameter, Status1, id};
use windlass_core::frame::Frame;
use windlass_core::time::Instant;
use windlass_sim::{ParticipantId, Source, World, WorldConfig};

const NUMBER: u8 = 3;

fn ms(millis: u64) -> Duration {
    Duration::from_millis(millis)
}

struct Bench {
    robot: Robot<SimBus>,
    other: ParticipantId,
}

impl Bench {
    fn new() -> Self {
        let mut world = World::new(WorldConfig::default());
        world.add_node("dmc60c:9".parse().unwrap());
        let other = world.join("other");
        let robot = Robot::new(SimBus::new(world));
        robot.run(ms(10)).unwrap();
        Self { robot, other }
    }

    fn talon(&self) -> CanTalon<SimBus> {
        self.robot.talon(NUMBER).unwrap()
    }

    /// Frames of the robot since frame number `from`, with their times, and the number of the next frame.
    fn sent(&self, from: u64) -> Vec<(Instant, Frame)> {
        self.robot.lend(|client| {
            let world = client.bus().world();
            let own = |source: &Source| *source == Source::Participant("windlass".to_owned());
            let frames = world.trace_since(from, usize::MAX).into_iter();
            frames
                .filter(|entry| own(&entry.from))
                .map(|entry| (entry.at, entry.frame))
                .collect()
        })
    }

    fn next_frame(&self) -> u64 {
        self.robot.lend(|client| client.bus().world().bus().frames)
    }

    /// The other tool sends a frame, and 1 ms passes.
    fn inject(&self, frame: Frame) {
        let other = self.other;
        self.robot
            .lend(|client| client.bus().world().send(other, frame));
        self.robot.run(ms(1)).unwrap();
    }
}

fn control(data: [u8; 8]) -> Frame {
    Frame::extended(id::CONTROL_1 | u32::from(NUMBER), data)
}

#[test]
fn row_101_set_sends_the_frames_of_the_published_clients() {
    for (mode, value, demand, last) in [
        (ControlMode::PercentVbus, 0.5, [0, 1, 0xFF], 0x00),
        (ControlMode::PercentVbus, -1.0, [0xFF, 0xFC, 0x01], 0x00),
        (ControlMode::Follower, 17.0, [0, 0, 0x11], 0x50),
        (ControlMode::Position, -2.0, [0xFF, 0xFF, 0xFE], 0x10),
        (ControlMode::Speed, 70_000.0, [1, 0x11, 0x70], 0x20),
        (ControlMode::Voltage, 6.0, [0, 6, 0], 0x40),
    ] {
        let bench = Bench::new();
        let talon = bench.talon();
        bench.robot.enable().unwrap();
        talon.set_control_mode(mode).unwrap();
        let from = bench.next_frame();
        talon.set(value).unwrap();
        bench.robot.run(ms(2)).unwrap();
        let frames: Vec<Frame> = bench
            .sent(from)
            .into_iter()
            .map(|(_, frame)| frame)
            .collect();
        let [a, b, c] = demand;
        let waiting = control([0, 0, a, b, c, 0x20, 0xF0, 0]);
        let driving = control([0, 0, a, b, c, 0x20, last, 0]);
        assert_eq!(frames[frames.len() - 2..], [waiting, driving], "{mode:?}");
    }
}

#[test]
fn row_21_the_control_frame_comes_every_period_from_1_to_95_ms() {
    for (period, count) in [(1, 1000), (10, 100), (20, 50), (95, 10)] {
        let bench = Bench::new();
        bench.robot.talon_with_period(NUMBER, period).unwrap();
        bench.robot.enable().unwrap();
        bench.robot.run(ms(5)).unwrap();
        let from = bench.next_frame();
        bench.robot.run(ms(1000)).unwrap();
        let sent = bench.sent(from).len();
        assert!(sent.abs_diff(count) <= 1, "{period} ms: {sent} frames");
    }
    let bench = Bench::new();
    for period in [0, 96, 1000] {
        let error = bench.robot.talon_with_period(NUMBER, period).unwrap_err();
        assert_eq!(error.code(), 3, "{error}");
    }
}

#[test]
fn row_02_numbers_above_62_are_refused_and_nothing_is_sent() {
    let bench = Bench::new();
    let from = bench.next_frame();
    for number in [63, 64, 255] {
        let error = bench.robot.talon(number).unwrap_err();
        assert!(error.to_string().contains("0 to 62"), "{error}");
    }
    bench.robot.enable().unwrap();
    bench.robot.run(ms(50)).unwrap();
    assert!(bench.sent(from).is_empty());
}

#[test]
fn row_66_nothing_is_sent_while_disabled_and_the_first_frame_brings_everything() {
    let bench = Bench::new();
    let talon = bench.talon();
    let from = bench.next_frame();
    talon.config_neutral_mode(NeutralMode::Brake).unwrap();
    talon.enable_limit_switch(true, false).unwrap();
    talon
        .set_feedback_device(FeedbackDevice::AnalogEncoder)
        .unwrap();
    talon.set_sensor_direction(true).unwrap();
    talon.select_profile_slot(1).unwrap();
    talon.set_voltage_ramp_rate(6.0).unwrap();
    talon.set_control_mode(ControlMode::Position).unwrap();
    talon.set(1000.0).unwrap();
    bench.robot.run(ms(200)).unwrap();
    assert!(bench.sent(from).is_empty(), "sent while disabled");
    bench.robot.enable().unwrap();
    bench.robot.run(ms(1)).unwrap();
    let first = bench.sent(from)[0].1;
    let expected = [
        0,
        0,
        0,
        0x03,
        0xE8,
        1 | 3 << 1 | 6 << 5,
        1 | 2 << 2 | 1 << 4,
        5,
    ];
    assert_eq!(first, control(expected));
}

#[test]
fn row_73_a_changed_mode_drives_nothing_until_the_next_set() {
    let bench = Bench::new();
    let talon = bench.talon();
    bench.robot.enable().unwrap();
    talon.set(0.5).unwrap();
    bench.robot.run(ms(5)).unwrap();
    let from = bench.next_frame();
    // The mode that it has again changes nothing (manual 19.2).
    talon.set_control_mode(ControlMode::PercentVbus).unwrap();
    bench.robot.run(ms(50)).unwrap();
    assert!(
        bench
            .sent(from)
            .iter()
            .all(|(_, frame)| frame.bytes()[6] >> 4 == 0)
    );
    let from = bench.next_frame();
    talon.set_control_mode(ControlMode::Speed).unwrap();
    bench.robot.run(ms(50)).unwrap();
    let sent = bench.sent(from);
    assert!(sent.len() >= 5 && sent.iter().all(|(_, frame)| frame.bytes()[6] >> 4 == 15));
    let from = bench.next_frame();
    talon.set(100.0).unwrap();
    bench.robot.run(ms(5)).unwrap();
    assert_eq!(bench.sent(from).last().unwrap().1.bytes()[6] >> 4, 2);
}

#[test]
fn row_75_motor_safety_ends_the_drive_and_enable_with_set_resumes() {
    let bench = Bench::new();
    let talon = bench.talon();
    bench.robot.enable().unwrap();
    talon.set_safety_enabled(true);
    talon.set(0.5).unwrap();
    let from = bench.next_frame();
    let mode = |frame: &Frame| ModeSelect::from_code(frame.bytes()[6] >> 4);
    // Fed every 90 ms it goes on.
    for _ in 0..5 {
        bench.robot.run(ms(90)).unwrap();
        talon.set(0.5).unwrap();
    }
    let fed_at = bench.robot.now();
    assert_eq!(talon.expirations(), 0);
    bench.robot.run(ms(150)).unwrap();
    let sent = bench.sent(from);
    let expected = Instant::from_micros((fed_at + ms(100)).as_micros() as u64);
    let (early, late): (Vec<_>, Vec<_>) = sent.iter().partition(|(at, _)| *at <= expected);
    // The frame of enabling and the demand before its mode.
    assert!(
        early
            .iter()
            .skip(2)
            .all(|(_, frame)| mode(frame) == ModeSelect::Duty)
    );
    assert!(
        late.iter()
            .all(|(_, frame)| mode(frame) == ModeSelect::NoDrive)
    );
    let ended = late.first().expect("mode 15 after 100 ms").0;
    assert!(ended.since(expected).as_micros() < 1000, "{ended:?}");
    assert_eq!(
        (talon.expirations(), talon.is_control_enabled()),
        (1, false)
    );
    // A set point alone does not resume.
    let from = bench.next_frame();
    talon.set(0.5).unwrap();
    bench.robot.run(ms(30)).unwrap();
    assert!(
        bench
            .sent(from)
            .iter()
            .all(|(_, frame)| mode(frame) == ModeSelect::NoDrive)
    );
    let from = bench.next_frame();
    talon.enable_control();
    talon.set(0.25).unwrap();
    bench.robot.run(ms(30)).unwrap();
    assert_eq!(mode(&bench.sent(from).last().unwrap().1), ModeSelect::Duty);
    // Another expiration, and switched off it never ends the drive.
    talon.set_expiration(ms(300));
    bench.robot.run(ms(250)).unwrap();
    assert_eq!(talon.expirations(), 1);
    bench.robot.run(ms(100)).unwrap();
    assert_eq!(talon.expirations(), 2);
    talon.set_safety_enabled(false);
    talon.enable_control();
    talon.set(0.5).unwrap();
    bench.robot.run(ms(2000)).unwrap();
    assert_eq!(talon.expirations(), 2);
}

#[test]
fn row_70_an_absent_device_gives_errors_and_zeros() {
    let bench = Bench::new();
    let talon = bench.talon();
    bench.robot.enable().unwrap();
    talon.set(0.5).unwrap();
    bench.robot.run(ms(300)).unwrap();
    assert_eq!((talon.position().value, talon.position().code()), (0, 1));
    assert_eq!(
        (talon.bus_voltage().value, talon.bus_voltage().code()),
        (0.0, 1)
    );
    assert_eq!(talon.output_voltage().code(), 1);
    let error = talon.applied_throttle().fresh().unwrap_err();
    assert_eq!(error.code(), 1);
    assert!(
        error.to_string().contains("Talon 3 is not responding"),
        "{error}"
    );
    let before = bench.robot.now();
    let error = talon.set_p(0.2).unwrap_err();
    assert_eq!(error.code(), 6);
    let waited = bench.robot.now() - before;
    assert!((ms(4)..ms(5)).contains(&waited), "{waited:?}");
    assert_eq!(
        talon
            .parameter(Parameter::FirmwareVersion)
            .unwrap_err()
            .code(),
        6
    );
    let report = talon.self_test().unwrap();
    assert!(!report.responding);
    assert!(report.to_string().contains("not responding"));
}

#[test]
fn a_value_is_stale_after_200_ms_and_kept() {
    let bench = Bench::new();
    let talon = bench.talon();
    let status = Status1 {
        throttle: -77,
        ..Status1::default()
    };
    bench.inject(status.emit(NUMBER));
    // Another device's frames are not this one's.
    bench.inject(Status1::default().emit(NUMBER + 1));
    assert_eq!(talon.applied_throttle().fresh().unwrap(), -77);
    bench.robot.run(ms(197)).unwrap();
    assert_eq!(talon.applied_throttle().code(), 0);
    bench.robot.run(ms(3)).unwrap();
    let reading = talon.applied_throttle();
    assert_eq!((reading.code(), reading.value), (1, -77));
    assert!(matches!(
        reading.fresh(),
        Err(TalonError::RxTimeout {
            age_ms: Some(200..=202),
            ..
        })
    ));
}

#[test]
fn row_95_a_period_is_set_with_the_whole_table_and_the_others_stay() {
    let bench = Bench::new();
    let talon = bench.talon();
    let from = bench.next_frame();
    talon
        .set_status_frame_rate_ms(StatusFrame::General, 5)
        .unwrap();
    talon
        .set_status_frame_rate_ms(StatusFrame::AnalogTempVbat, 255)
        .unwrap();
    bench.robot.run(ms(2)).unwrap();
    let frames: Vec<Frame> = bench
        .sent(from)
        .into_iter()
        .map(|(_, frame)| frame)
        .collect();
    let number = id::CONTROL_2 | u32::from(NUMBER);
    assert_eq!(
        frames,
        [
            Frame::extended(number, [5, 20, 100, 100]),
            Frame::extended(number, [5, 20, 100, 255])
        ]
    );
    let error = talon
        .set_status_frame_rate_ms(StatusFrame::Feedback, 0)
        .unwrap_err();
    assert_eq!(error.code(), 3);
}

#[test]
fn global_enable_speaks_to_everybody_every_50_ms_and_control_5_carries_the_rest() {
    let bench = Bench::new();
    let robot = bench.robot.clone().with_enable_style(EnableStyle::Global);
    let first = robot.talon(3).unwrap();
    let second = robot.talon(4).unwrap();
    first.set(0.5).unwrap();
    second.set(-0.5).unwrap();
    let from = bench.next_frame();
    robot.run(ms(100)).unwrap();
    let frames = bench.sent(from);
    let enables = |frames: &[(Instant, Frame)], byte: u8| {
        let global = Frame::extended(id::GLOBAL_ENABLE, [byte, 0, 0, 0, 0, 0, 0, 0]);
        frames.iter().filter(|(_, frame)| *frame == global).count()
    };
    assert!(enables(&frames, 0) >= 2 && enables(&frames, 1) == 0);
    let content = |frame: &Frame| frame.raw_id() & !0x3F == id::CONTROL_5;
    let contents = frames.iter().filter(|(_, frame)| content(frame)).count();
    assert!((18..=26).contains(&contents), "{contents}");
    let from = bench.next_frame();
    robot.enable().unwrap();
    robot.run(ms(500)).unwrap();
    let frames = bench.sent(from);
    assert!(enables(&frames, 1).abs_diff(10) <= 1 && enables(&frames, 0) == 0);
    let from = bench.next_frame();
    robot.disable().unwrap();
    robot.run(ms(1)).unwrap();
    assert_eq!(enables(&bench.sent(from), 0), 1);
}

#[test]
fn disabling_tells_every_device_at_once_and_ends_the_control_frames() {
    let bench = Bench::new();
    let talon = bench.talon();
    bench.robot.enable().unwrap();
    talon.set(1.0).unwrap();
    bench.robot.run(ms(100)).unwrap();
    let from = bench.next_frame();
    bench.robot.disable().unwrap();
    bench.robot.run(ms(300)).unwrap();
    let frames: Vec<Frame> = bench
        .sent(from)
        .into_iter()
        .map(|(_, frame)| frame)
        .collect();
    assert_eq!(frames, [Frame::extended(id::DISABLE_ALL, [])]);
    assert!(!bench.robot.is_enabled());
}

#[test]
fn row_64_counters_are_zero_on_a_good_bus_rise_on_a_short_and_fall_after() {
    let bench = Bench::new();
    let talon = bench.talon();
    bench.robot.enable().unwrap();
    talon.set(0.0).unwrap();
    bench.robot.run(ms(500)).unwrap();
    let health = || {
        bench
            .robot
            .lend(|client| windlass::transport::Bus::health(client.bus()).unwrap())
    };
    let good = health();
    assert_eq!((good.bus_off, good.tx_full), (Some(0), Some(0)));
    assert_eq!(
        (good.receive_errors, good.transmit_errors),
        (Some(0), Some(0))
    );
    bench
        .robot
        .lend(|client| client.bus().world().short_bus(true));
    bench.robot.run(ms(50)).unwrap();
    let shorted = health();
    assert!(shorted.bus_off >= Some(1), "{shorted}");
    bench
        .robot
        .lend(|client| client.bus().world().short_bus(false));
    bench.robot.run(ms(1000)).unwrap();
    let healed = health();
    assert_eq!(
        (healed.receive_errors, healed.transmit_errors),
        (Some(0), Some(0)),
        "{healed}"
    );
    assert!(healed.bus_off >= shorted.bus_off);
}

#[test]
fn row_64_tx_full_counts_what_is_dropped_while_nobody_acknowledges() {
    let mut world = World::new(WorldConfig::default());
    let node = world.add_node("dmc60c:9".parse().unwrap());
    world
        .node_mut(node)
        .unwrap()
        .poke(windlass_sim::Poke::BusConnected(false));
    let robot = Robot::new(SimBus::new(world));
    let _talon = robot.talon_with_period(NUMBER, 1).unwrap();
    robot.enable().unwrap();
    robot.run(ms(1500)).unwrap();
    let health = robot.lend(|client| windlass::transport::Bus::health(client.bus()).unwrap());
    assert!(
        health
            .tx_full
            .is_some_and(|count| (400..=500).contains(&count)),
        "{health}"
    );
    assert!(health.transmit_errors >= Some(128), "{health}");
}
