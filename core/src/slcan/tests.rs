extern crate std;

use std::{string::String, vec::Vec};

use embedded_can::{ExtendedId, StandardId};
use proptest::prelude::*;

use super::*;

/// Feeds a whole text; returns every reply byte and every frame.
fn feed(channel: &mut Channel, text: &[u8]) -> (Vec<u8>, Vec<Frame>) {
    let mut replies = Vec::new();
    let mut frames = Vec::new();
    for answer in text.iter().filter_map(|byte| channel.push(*byte)) {
        replies.extend_from_slice(&answer.reply);
        frames.extend(answer.transmit);
    }
    (replies, frames)
}

fn reply(channel: &mut Channel, text: &[u8]) -> String {
    String::from_utf8(feed(channel, text).0).unwrap()
}

#[test]
fn the_published_sc25_line_is_its_frame() {
    let line = b"t2058200000000000C842\r";
    let frame = Frame::standard(0x205, [0x20, 0, 0, 0, 0, 0, 0xC8, 0x42]);
    let (replies, frames) = feed(&mut Channel::new(), line);
    assert_eq!(frames, [frame]);
    assert!(replies.is_empty());
    assert_eq!(format(&frame, None).as_slice(), line);
}

#[test]
fn extended_and_remote_frames_have_their_letters() {
    let extended = Frame::extended(0x0206_0005, [0xAB, 0x0C]);
    assert_eq!(format(&extended, None).as_slice(), b"T020600052AB0C\r");
    let remote = Frame::remote(StandardId::MAX, 3).unwrap();
    assert_eq!(format(&remote, None).as_slice(), b"r7FF3\r");
    let remote = Frame::remote(ExtendedId::MAX, 0).unwrap();
    assert_eq!(
        format(&remote, Some(0xEA5F)).as_slice(),
        b"R1FFFFFFF0EA5F\r"
    );
}

#[test]
fn both_hex_cases_are_read() {
    let (_, frames) = feed(&mut Channel::new(), b"T0206f0051aB\rt7fF1cD\r");
    assert_eq!(
        frames,
        [
            Frame::extended(0x0206_F005, [0xAB]),
            Frame::standard(0x7FF, [0xCD])
        ]
    );
}

#[test]
fn line_feeds_are_skipped_and_empty_lines_are_silent() {
    let (replies, frames) = feed(&mut Channel::new(), b"\r\r\n\rt10\n0\n0\r\n");
    assert_eq!(frames, [Frame::standard(0x100, [])]);
    assert!(replies.is_empty());
}

#[test]
fn an_echoing_terminal_does_not_start_a_dialogue() {
    // A terminal in its default mode sends every line back as carriage return and line feed, and a
    // bell as the two characters ^G.
    let mut channel = Channel::new();
    let mut input: Vec<u8> = b"S8\rO\rO\r".to_vec();
    for _round in 0..3 {
        let (replies, _) = feed(&mut channel, &input);
        input.clear();
        for byte in replies {
            match byte {
                CR => input.extend_from_slice(b"\r\n"),
                BEL => input.extend_from_slice(b"^G"),
                other => input.push(other),
            }
        }
    }
    assert!(input.is_empty(), "still talking: {input:?}");
}

#[test]
fn malformed_lines_are_answered_with_bell_and_counted() {
    let lines: [&[u8]; 14] = [
        b"x\r",
        b"t\r",
        b"t8000\r",
        b"T200000000\r",
        b"t1009112233445566778899\r",
        b"t1002AB\r",
        b"t1002AABBC\r",
        b"t100200G0\r",
        b"t1000EA5F\r",
        b"S9\r",
        b"Z2\r",
        b"O1\r",
        b"s031C\r",
        b"T000000008001122334455667700000000\r",
    ];
    let mut channel = Channel::new();
    for line in lines {
        let (replies, frames) = feed(&mut channel, line);
        assert_eq!(replies, [BEL], "{:?}", core::str::from_utf8(line));
        assert!(frames.is_empty());
    }
    assert_eq!(channel.counters().malformed, 14);
    assert_eq!(feed(&mut channel, b"t1000\r").1.len(), 1, "and recovers");
}

#[test]
fn commands_follow_the_state_of_the_channel() {
    let mut channel = Channel::new();
    assert_eq!(reply(&mut channel, b"S8\rO\r"), "\r\r", "open at start-up");
    assert_eq!(channel.state(), State::Open);
    assert_eq!(reply(&mut channel, b"S6\rO\rL\rZ1\r"), "\x07\x07\x07\x07");
    assert_eq!(channel.counters().refused, 4);
    assert_eq!(channel.bit_rate(), 1_000_000);
    assert_eq!(reply(&mut channel, b"V\rN\rF\r"), "V0101\rNWNDL\rF00\r");
    assert_eq!(reply(&mut channel, b"C\rC\rF\r"), "\r\x07\x07");
    assert_eq!(reply(&mut channel, b"S6\r"), "\r");
    assert_eq!(channel.bit_rate(), 500_000);
    assert_eq!(reply(&mut channel, b"t1000\r"), "\x07", "closed");
    assert_eq!(reply(&mut channel, b"L\rt1000\r"), "\r\x07", "listen-only");
    assert_eq!(channel.counters().frames, 0);
}

#[test]
fn python_cans_opening_sequence_leaves_the_channel_open() {
    let mut channel = Channel::new();
    assert_eq!(reply(&mut channel, b"C\rS8\r\rO\rO\r"), "\r\r\r\x07");
    assert_eq!(channel.state(), State::Open);
}

#[test]
fn frames_are_acknowledged_only_when_asked_for() {
    let mut channel = Channel::new();
    channel.set_frame_replies(true);
    assert_eq!(
        reply(&mut channel, b"t1000\rT000001000\rr1000\rR000001000\r"),
        "z\rZ\rz\rZ\r"
    );
}

#[test]
fn flags_are_cleared_by_reading() {
    let mut channel = Channel::new();
    channel.raise(flag::TRANSMIT_QUEUE_FULL);
    channel.raise(flag::BUS_ERROR);
    assert_eq!(reply(&mut channel, b"F\rF\r"), "F82\rF00\r");
}

#[test]
fn received_frames_carry_a_time_stamp_when_asked_and_none_when_closed() {
    let frame = Frame::standard(0x123, [1]);
    let mut channel = Channel::new();
    assert_eq!(channel.received(&frame, 7).unwrap(), b"t123101\r");
    assert_eq!(reply(&mut channel, b"C\rZ1\rO\r"), "\r\r\r");
    assert_eq!(channel.received(&frame, 59_999).unwrap(), b"t123101EA5F\r");
    assert_eq!(channel.received(&frame, 60_000).unwrap(), b"t1231010000\r");
    assert_eq!(reply(&mut channel, b"C\r"), "\r");
    assert!(channel.received(&frame, 7).is_none());
}

fn frames() -> impl Strategy<Value = Frame> {
    let id = prop_oneof![
        (0..=0x7FF_u16).prop_map(|raw| Id::from(StandardId::new(raw).unwrap())),
        (0..=0x1FFF_FFFF_u32).prop_map(|raw| Id::from(ExtendedId::new(raw).unwrap())),
    ];
    (
        id,
        proptest::collection::vec(any::<u8>(), 0..=8),
        any::<bool>(),
    )
        .prop_map(|(id, data, remote)| {
            if remote {
                Frame::remote(id, data.len()).unwrap()
            } else {
                Frame::new(id, &data).unwrap()
            }
        })
}

proptest! {
    #[test]
    fn a_formatted_frame_parses_as_itself(frame in frames(), stamp in proptest::option::of(0..60_000_u16)) {
        let text = format(&frame, stamp);
        let (last, line) = text.split_last().unwrap();
        prop_assert_eq!(*last, CR);
        prop_assert_eq!(parse(line), Some((frame, stamp)));
    }

    #[test]
    fn no_byte_string_panics_and_every_line_that_parses_is_a_frame(bytes in proptest::collection::vec(any::<u8>(), 0..200)) {
        let mut channel = Channel::new();
        let (_, frames) = feed(&mut channel, &bytes);
        prop_assert_eq!(frames.len() as u32, channel.counters().frames);
        let _ = parse(&bytes);
    }

    #[test]
    fn no_sequence_of_likely_characters_panics(text in "[tTrRSOLCVNFZ0-9a-fA-F\r\n]{0,300}") {
        let mut channel = Channel::new();
        let returns = text.bytes().filter(|byte| *byte == CR).count();
        let answers = text.bytes().filter_map(|byte| channel.push(byte)).count();
        prop_assert_eq!(answers, returns, "each line has one answer");
    }
}
