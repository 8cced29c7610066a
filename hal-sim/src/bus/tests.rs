use super::*;

/// A bus with one CAN tool for every entry.
fn bus(tools: usize) -> Bus {
    let quiet = Disturbance {
        loss: 0.0,
        corruption: 0.0,
        delay: 0,
    };
    disturbed(tools, quiet)
}

fn disturbed(tools: usize, disturbance: Disturbance) -> Bus {
    let mut bus = Bus::new(1_000_000, disturbance, Random::new(1, 1));
    for _ in 0..tools {
        bus.attach(true);
    }
    bus
}

/// One thing that was seen on the bus.
#[derive(Clone, Debug, PartialEq, Eq)]
enum Seen {
    Frame(u64, Frame, Station, Vec<Station>),
    GivenUp(u64, Station),
    Lost(u64, Station),
}

fn run(bus: &mut Bus, until: u64) -> Vec<Seen> {
    let mut seen = Vec::new();
    let mut outcome = Outcome::default();
    loop {
        let now = bus.next_event();
        if now >= until {
            return seen;
        }
        bus.advance_to(now, &mut outcome);
        note(&outcome, now, &mut seen);
        if bus.starts_at(now) {
            bus.start(now);
        }
    }
}

fn note(outcome: &Outcome, now: u64, seen: &mut Vec<Seen>) {
    if let Some((frame, from)) = outcome.delivered {
        seen.push(Seen::Frame(now, frame, from, outcome.receivers.clone()));
    }
    for &(station, sent) in &outcome.ended {
        if !sent {
            seen.push(Seen::GivenUp(now, station));
        }
    }
    for &station in &outcome.lost {
        seen.push(Seen::Lost(now, station));
    }
}

fn order(seen: &[Seen]) -> Vec<u32> {
    seen.iter()
        .filter_map(|entry| match entry {
            Seen::Frame(_, frame, ..) => Some(frame.raw_id()),
            _ => None,
        })
        .collect()
}

const MS: u64 = 1_000_000;

#[test]
fn a_frame_is_delivered_to_everybody_else_at_its_end() {
    let mut bus = bus(3);
    let frame = Frame::standard(0, []);
    bus.enqueue(1, frame, 0);
    // 34 bits, 6 stuff bits, 10 bits trailer at 1 µs each.
    let seen = run(&mut bus, MS);
    assert_eq!(seen, [Seen::Frame(50_000, frame, 1, vec![0, 2])]);
    assert_eq!((bus.frames, bus.error_frames), (1, 0));
}

#[test]
fn the_bit_rate_scales_time() {
    let quiet = Disturbance {
        loss: 0.0,
        corruption: 0.0,
        delay: 0,
    };
    let mut bus = Bus::new(250_000, quiet, Random::new(1, 1));
    bus.attach(true);
    bus.attach(true);
    let frame = Frame::standard(0, []);
    bus.enqueue(0, frame, 0);
    assert_eq!(run(&mut bus, MS), [Seen::Frame(200_000, frame, 0, vec![1])]);
}

#[test]
fn frames_follow_each_other_after_three_bits() {
    let mut bus = bus(2);
    let frame = Frame::standard(0, []);
    bus.enqueue(0, frame, 0);
    bus.enqueue(0, frame, 0);
    let ends: Vec<u64> = run(&mut bus, MS)
        .iter()
        .filter_map(|entry| match entry {
            Seen::Frame(at, ..) => Some(*at),
            _ => None,
        })
        .collect();
    assert_eq!(ends, [50_000, 50_000 + 3_000 + 50_000]);
}

#[test]
fn the_lowest_identifier_wins_and_a_short_one_beats_a_long_one() {
    let mut bus = bus(5);
    let base = 0x100 << 18;
    bus.enqueue(0, Frame::extended(base + 7, []), 0);
    bus.enqueue(1, Frame::standard(0x101, []), 0);
    bus.enqueue(2, Frame::standard(0x100, []), 0);
    bus.enqueue(3, Frame::extended(base, []), 0);
    let seen = run(&mut bus, MS);
    assert_eq!(order(&seen), [0x100, base, base + 7, 0x101]);
}

#[test]
fn losing_the_arbitration_is_no_failed_attempt() {
    let mut bus = bus(2);
    let node = bus.attach(false);
    bus.load_mailbox(node, Frame::standard(0x500, []), Some(1), 0);
    for id in 0x100..0x110 {
        bus.enqueue(0, Frame::standard(id, []), 0);
    }
    let expected: Vec<u32> = (0x100..0x110).chain([0x500]).collect();
    assert_eq!(order(&run(&mut bus, 2 * MS)), expected);
}

#[test]
fn a_lonely_sender_becomes_passive_and_tries_for_ever() {
    let mut bus = bus(0);
    let node = bus.attach(false);
    bus.load_mailbox(node, Frame::standard(0x100, []), None, 0);
    let seen = run(&mut bus, 100 * MS);
    // 16 attempts of 34 + 6 (or fewer stuff bits) + 2 + 6 + 8 + 3 bits.
    assert!(
        matches!(seen[..], [Seen::GivenUp(..), Seen::Lost(at, _)] if at < MS),
        "{seen:?}"
    );
    assert_eq!(bus.controller(node).tec, 128);
    // The passive controller counts no further, its frame waits until somebody listens.
    bus.load_mailbox(node, Frame::standard(0x100, []), None, 100 * MS);
    assert_eq!(run(&mut bus, 200 * MS), []);
    assert_eq!(
        (bus.controller(node).tec, bus.error_frames > 1000),
        (128, true)
    );
    bus.attach(true);
    let seen = run(&mut bus, 201 * MS);
    assert_eq!(order(&seen), [0x100]);
    assert_eq!(
        (bus.controller(node).tec, bus.controller(node).state),
        (127, ErrorState::Active)
    );
}

#[test]
fn one_identifier_with_different_data_destroys_both() {
    let mut bus = bus(1);
    let nodes = [bus.attach(false), bus.attach(false)];
    bus.load_mailbox(nodes[0], Frame::standard(0x100, [1]), Some(2), 0);
    bus.load_mailbox(nodes[1], Frame::standard(0x100, [2]), Some(2), 0);
    let seen = run(&mut bus, MS);
    assert!(
        matches!(seen[..], [Seen::GivenUp(..), Seen::GivenUp(..)]),
        "{seen:?}"
    );
    assert_eq!(bus.error_frames, 2);
    let tec = nodes.map(|node| bus.controller(node).tec);
    assert_eq!((tec, bus.controller(0).rec), ([16, 16], 2));
}

#[test]
fn one_identifier_with_the_same_data_is_one_frame_for_both() {
    let mut bus = bus(1);
    let nodes = [bus.attach(false), bus.attach(false)];
    for node in nodes {
        bus.load_mailbox(node, Frame::standard(0x100, [1]), None, 0);
    }
    let seen = run(&mut bus, MS);
    assert!(
        matches!(&seen[..], [Seen::Frame(.., to)] if to == &[0]),
        "{seen:?}"
    );
    assert!(nodes.iter().all(|node| bus.mailbox_free(*node)));
}

#[test]
fn endless_collisions_end_in_bus_off_and_recovery() {
    let mut bus = bus(3);
    bus.enqueue(0, Frame::standard(0x100, [1]), 0);
    bus.enqueue(1, Frame::standard(0x100, [2]), 0);
    let seen = run(&mut bus, 10 * MS);
    let lost: Vec<(u64, Station)> = seen
        .iter()
        .filter_map(|entry| match entry {
            Seen::Lost(at, station) => Some((*at, *station)),
            _ => None,
        })
        .collect();
    assert_eq!(lost.len(), 2);
    let off_at = lost[0].0;
    assert_eq!(bus.error_frames, 32);
    assert_eq!(bus.controller(0).bus_off_count, 1);
    // 128 × 11 recessive bits after the last error frame, whose delimiter and intermission are the
    // first of them: from the end of the intermission 127 sequences remain.
    let mut again = self::bus(3);
    again.enqueue(0, Frame::standard(0x100, [1]), 0);
    again.enqueue(1, Frame::standard(0x100, [2]), 0);
    let back_at = off_at + 3_000 + 127 * 11_000;
    run(&mut again, back_at);
    assert_eq!(again.controller(0).state, ErrorState::BusOff);
    run(&mut again, back_at + 1);
    assert_eq!(again.controller(0).state, ErrorState::Active);
    assert_eq!((again.controller(0).tec, again.controller(0).rec), (0, 0));
}

#[test]
fn recovery_takes_longer_on_a_busy_bus() {
    let mut bus = bus(4);
    bus.enqueue(0, Frame::standard(0x100, [1]), 0);
    bus.enqueue(1, Frame::standard(0x100, [2]), 0);
    let seen = run(&mut bus, 3 * MS);
    let Some(Seen::Lost(off_at, _)) = seen.last() else {
        panic!("no bus-off: {seen:?}");
    };
    for _ in 0..100 {
        bus.enqueue(2, Frame::standard(0, []), *off_at);
    }
    run(&mut bus, off_at + 101 * 53_000);
    // 100 frames count one sequence each, where an idle bus would have been through long ago.
    assert_eq!(bus.controller(0).state, ErrorState::BusOff);
    run(&mut bus, off_at + 110 * 53_000);
    assert_eq!(bus.controller(0).state, ErrorState::Active);
}

#[test]
fn an_unplugged_controller_hears_nothing_and_is_not_heard() {
    let mut bus = bus(2);
    let node = bus.attach(false);
    bus.set_connected(node, false, 0);
    bus.load_mailbox(node, Frame::standard(0x100, []), None, 0);
    bus.enqueue(0, Frame::standard(0x200, []), 0);
    let seen = run(&mut bus, 10 * MS);
    assert!(
        seen.iter()
            .any(|entry| matches!(entry, Seen::Frame(_, _, 0, to) if to == &[1]))
    );
    assert!(
        seen.iter()
            .any(|entry| matches!(entry, Seen::Lost(_, station) if *station == node))
    );
    assert_eq!((bus.error_frames, bus.controller(node).tec), (0, 128));
    bus.set_connected(node, true, 10 * MS);
    bus.load_mailbox(node, Frame::standard(0x100, []), None, 10 * MS);
    assert_eq!(order(&run(&mut bus, 11 * MS)), [0x100]);
}

#[test]
fn power_off_in_the_middle_of_a_frame_destroys_it() {
    let mut bus = bus(2);
    let node = bus.attach(false);
    bus.load_mailbox(node, Frame::standard(0x100, []), None, 0);
    bus.start(0);
    bus.set_running(node, false, 10_000);
    assert_eq!(run(&mut bus, MS), []);
    assert_eq!((bus.error_frames, bus.controller(0).rec), (1, 1));
}

#[test]
fn loss_is_per_receiver_and_corruption_is_retried() {
    let noisy = Disturbance {
        loss: 0.2,
        corruption: 0.05,
        delay: 0,
    };
    let mut bus = disturbed(3, noisy);
    for count in 0..1000_u16 {
        bus.enqueue(0, Frame::standard(0x100, count.to_le_bytes()), 0);
    }
    let seen = run(&mut bus, 1000 * MS);
    assert_eq!(
        order(&seen).len(),
        1000,
        "no frame is lost for everybody by corruption"
    );
    let received: Vec<u64> = (1..3).map(|tool| bus.controller(tool).received).collect();
    assert!(
        received.iter().all(|count| (740..860).contains(count)),
        "{received:?}"
    );
    assert_eq!(received[0] + bus.controller(1).lost, 1000);
    assert!((30..80).contains(&bus.error_frames), "{}", bus.error_frames);
}

#[test]
fn delay_shifts_the_start_and_keeps_the_order() {
    let slow = Disturbance {
        loss: 0.0,
        corruption: 0.0,
        delay: MS,
    };
    let mut bus = disturbed(2, slow);
    for id in 0..20 {
        bus.enqueue(0, Frame::standard(id, []), 0);
    }
    let seen = run(&mut bus, 100 * MS);
    assert_eq!(order(&seen), (0..20).collect::<Vec<_>>());
    let Some(Seen::Frame(last, ..)) = seen.last() else {
        panic!("no frame: {seen:?}");
    };
    assert!((5 * MS..20 * MS).contains(last), "{last}");
}

#[test]
fn the_load_counts_frames_and_intermission() {
    let mut bus = bus(2);
    for period in 0..100 {
        bus.enqueue(0, Frame::standard(0, []), period * MS);
        run(&mut bus, (period + 1) * MS);
    }
    // 53 µs in every ms.
    assert!((bus.load_percent(100 * MS) - 5.3).abs() < 0.1);
}
