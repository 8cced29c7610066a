use super::*;
use crate::kept::{Kept, Origin};
use crate::record::{PassedOn, Start};
use std::collections::VecDeque;
use std::vec::Vec;
use windlass_core::boot::image::Hardware;
use windlass_core::boot::slots::Slot;
use windlass_core::dialect::dmc60c::wire::id::CONTROL_0;
use windlass_core::engine::command::Setpoint;
use windlass_core::engine::snapshot::{Actuation, Fault};
use windlass_core::frame::Frame;
use windlass_core::led::Leds;
use windlass_core::management::vendor::{PinTest, TestPin};
use windlass_core::node::{Transmission, TxOutcome};
use windlass_core::reset::{Crashes, Reset};
use windlass_core::time::Duration;

use windlass_core::units::Duty;
use windlass_sim::nor::{NorChip, Partition, Region, STM32F405};

type Settings = Partition<4, 16_384>;
type Application = Partition<4, 131_072>;

/// A bus that a test fills and reads.
#[derive(Default)]
struct FakeBus {
    events: VecDeque<BusEvent>,
    sent: Vec<Frame>,
    dropped: u32,
    errors: u32,
}

impl Bus for FakeBus {
    fn poll(&mut self, _: Instant) -> Option<BusEvent> {
        self.events.pop_front()
    }

    fn transmit(&mut self, _: Instant, transmission: &Transmission) {
        self.sent.push(transmission.frame);
    }

    fn dropped(&self) -> u32 {
        self.dropped
    }

    fn errors(&self) -> u32 {
        self.errors
    }
}

/// A board.
struct FakeBoard {
    bus: FakeBus,
    now: Instant,
    kept: Kept<Settings, Application>,
    chip: NorChip,
    fed: u32,
    log: Vec<Event>,
}

impl Board for FakeBoard {
    type Bus = FakeBus;
    type Settings = Settings;
    type Application = Application;

    fn now(&mut self) -> Instant {
        self.now
    }

    fn bus(&mut self) -> &mut FakeBus {
        &mut self.bus
    }

    fn kept(&mut self) -> &mut Kept<Settings, Application> {
        &mut self.kept
    }

    fn restart(&mut self, handover: Handover) -> ! {
        panic!("the tests restart by themselves: {handover:?}")
    }

    fn show(&mut self, _: Leds) {}

    fn button_pressed(&mut self) -> bool {
        false
    }

    fn test_pins(&mut self, _: PinTest) -> Option<TestPin> {
        None
    }

    fn feed_watchdog(&mut self) {
        self.fed += 1;
    }

    fn log(&mut self, event: Event) {
        self.log.push(event);
    }

    fn idle(&mut self) {}
}

fn receive(board: &mut FakeBoard, frame: Frame) {
    board.bus.events.push_back(BusEvent::Received(frame));
}

fn origin(handover: Option<Handover>) -> Origin {
    Origin {
        // Each test's own.
        record: std::boxed::Box::leak(std::boxed::Box::default()),
        passed_on: PassedOn {
            start: Start {
                reset: Reset::POWER_ON,
                handover,
                crashes: Crashes::NONE,
            },
            bootloader_version: 0x0201,
        },
        version: 0x0305,
        board: windlass_core::engine::Board::REFERENCE,
        seed: 1,
    }
}

/// The board's flash as the application sees it.
fn kept(chip: &NorChip, handover: Option<Handover>) -> Kept<Settings, Application> {
    let settings = chip.partition(Region::Journal).expect("a journal");
    let slot = chip.partition(Region::Application).expect("a slot");
    Kept::new(origin(handover), settings, Slot::new(slot, &Hardware::F405))
}

/// The program starts on a board.
fn boot(mut board: FakeBoard) -> (FakeBoard, Crossing, Thread) {
    let stored = board.kept.load();
    let config = board.kept.node_config();
    let thread = Thread::new(board.now(), &config, Some(&stored));
    (board, Crossing::new(), thread)
}

fn start() -> (FakeBoard, Crossing, Thread) {
    let chip = NorChip::new(&STM32F405, 1);
    boot(FakeBoard {
        bus: FakeBus::default(),
        now: Instant::ZERO,
        kept: kept(&chip, None),
        chip,
        fed: 0,
        log: Vec::new(),
    })
}

#[test]
fn a_control_frame_reaches_the_tick_once() {
    let (mut board, crossing, mut thread) = start();
    receive(
        &mut board,
        Frame::extended(CONTROL_0, [0, 0, 0, 0, 0x34, 0x12, 0, 0]),
    );
    assert_eq!(thread.pass(&mut board, &crossing), None);
    assert!(crossing.settings.take().is_some());
    let command = crossing.command.take().expect("a command");
    assert_eq!(command.setpoint, Setpoint::Duty(Duty::new(0x1234)));
    thread.pass(&mut board, &crossing);
    assert_eq!(crossing.command.take(), None);
    assert_eq!(crossing.settings.take(), None);
}

#[test]
fn one_transmission_is_on_its_way_until_the_bus_reports_its_end() {
    let (mut board, crossing, mut thread) = start();
    receive(&mut board, Frame::standard(0, []));
    board.now = Instant::ZERO + Duration::from_millis(200);
    thread.pass(&mut board, &crossing);
    board.now = board.now + Duration::from_millis(200);
    thread.pass(&mut board, &crossing);
    assert_eq!(board.bus.sent.len(), 1);
    board.bus.events.push_back(BusEvent::Ended(TxOutcome::Sent));
    thread.pass(&mut board, &crossing);
    assert_eq!(board.bus.sent.len(), 2);
    // A lost bus has flushed the mailbox, and without a bus nothing is sent.
    board.bus.events.push_back(BusEvent::Lost);
    board.now = board.now + Duration::from_millis(200);
    thread.pass(&mut board, &crossing);
    assert_eq!(board.bus.sent.len(), 2);
}

#[test]
fn the_watchdog_is_fed_once_for_every_tick_and_never_without_one() {
    let (mut board, crossing, mut thread) = start();
    for _ in 0..10 {
        thread.pass(&mut board, &crossing);
    }
    assert_eq!(board.fed, 0);
    crossing.skip();
    thread.pass(&mut board, &crossing);
    thread.pass(&mut board, &crossing);
    assert_eq!(board.fed, 1);
}

#[test]
fn every_change_is_logged_once() {
    let (mut board, crossing, mut thread) = start();
    thread.pass(&mut board, &crossing);
    assert_eq!(board.log, []);
    receive(&mut board, Frame::standard(0, []));
    thread.pass(&mut board, &crossing);
    let session = thread.node().session().expect("the bus was seen");
    let faults = Faults::NONE.with(Fault::GateDriver);
    crossing.snapshot.offer(Snapshot {
        faults,
        ..Snapshot::default()
    });
    board.bus.dropped = 3;
    crossing.skip();
    board.bus.events.push_back(BusEvent::Lost);
    for _ in 0..10 {
        thread.pass(&mut board, &crossing);
    }
    let expected = [
        Event::Connected { session },
        Event::Disconnected,
        Event::Faults(faults),
        Event::Dropped(3),
    ];
    let changes: Vec<Event> = board
        .log
        .into_iter()
        .filter(|event| *event != Event::Saved)
        .collect();
    assert_eq!(changes, expected);
}

#[test]
fn frames_that_the_bus_has_lost_reach_the_node() {
    let (mut board, crossing, mut thread) = start();
    board.bus.dropped = 3;
    board.bus.errors = 2;
    crossing.skip();
    thread.pass(&mut board, &crossing);
    assert_eq!(thread.node().counters().dropped, 3);
    assert_eq!(thread.node().counters().bus_errors, 2);
}

#[test]
fn a_saved_number_outlives_a_restart_and_the_session_goes_on() {
    let (mut board, crossing, mut thread) = start();
    receive(&mut board, Frame::standard(0, []));
    thread.pass(&mut board, &crossing);
    let session = thread.node().session().expect("the bus was seen");
    let [low, high] = session.to_le_bytes();
    // vcmdSetDeviceNumber 9, then vcmdSoftReset.
    receive(
        &mut board,
        Frame::extended(0x0206_FC00, [low, high, 1, 0, 9, 0, 0, 0]),
    );
    thread.pass(&mut board, &crossing);
    assert_eq!(board.kept.load().number, 9);
    receive(
        &mut board,
        Frame::extended(0x0206_FC09, [low, high, 0xF1, 0, 0, 0, 0, 0]),
    );
    let handover = thread.pass(&mut board, &crossing).expect("a restart");
    assert_eq!(handover.session, session);
    board.kept = kept(&board.chip, Some(handover));
    let (_, _, thread) = boot(board);
    assert_eq!(
        (thread.node().number(), thread.node().session()),
        (9, Some(session))
    );
}

#[test]
fn while_the_motor_may_move_nothing_is_erased() {
    let (mut board, crossing, mut thread) = start();
    receive(&mut board, Frame::standard(0, []));
    // A snapshot of a bridge that drives, and a second in which it goes on.
    let driving = Snapshot {
        actuation: Actuation::Drive(Duty::new(1000)),
        ..Snapshot::default()
    };
    let erases = |board: &FakeBoard| board.chip.erases(Region::Journal).iter().sum::<u32>();
    for _ in 0..3_000 {
        crossing.snapshot.offer(driving);
        crossing.skip();
        board.now = board.now + Duration::from_micros(500);
        thread.pass(&mut board, &crossing);
    }
    assert_eq!(erases(&board), 0);
    // Off for a second: the journal's next unit is erased in advance.
    for _ in 0..3_000 {
        crossing.snapshot.offer(Snapshot::default());
        crossing.skip();
        board.now = board.now + Duration::from_micros(500);
        thread.pass(&mut board, &crossing);
    }
    assert_eq!(erases(&board), 1);
}
