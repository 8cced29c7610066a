//! The management channel by itself: golden frames, lengths, transfers, delays.

use super::wire::*;
use super::*;
use crate::time::{Duration, Instant};
use proptest::prelude::*;

/// As in an application.
type Management = super::Management;

const SESSION: u16 = 0x1234;
const VERSIONS: FirmwareVersions = FirmwareVersions {
    image: ImageType::Application,
    application: 0x0117,
    bootloader: 0x0109,
};

fn channel() -> Management {
    let mut channel = Management::new(ImageType::Application, &Identity::DMC60C);
    channel.start(SESSION);
    channel
}

fn command(command: u16, param1: u16) -> Frame {
    VendorCommand {
        session: SESSION,
        command,
        param1,
        param2: 0,
    }
    .emit(5)
}

fn data_out(bytes: &[u8]) -> Frame {
    Frame::new(
        embedded_can::ExtendedId::new(id::VENDOR_DATA_OUT | 5).unwrap(),
        bytes,
    )
    .unwrap()
}

fn next(channel: &mut Management) -> Option<Frame> {
    channel
        .encode(Instant::ZERO, 5, VERSIONS)
        .map(|(frame, _)| frame)
}

fn status(channel: &mut Management) -> (u16, u16) {
    let frame = next(channel).expect("a status");
    assert_eq!(frame.extended_id(), Some(0x0206_FCC5));
    let status = VendorStatus::parse(&frame).unwrap();
    (status.code, status.byte_count)
}

#[test]
fn golden_frames() {
    // Layouts and the product id's tail bytes: docs/dmc60c.md.
    let first = EnumerateResponse0 {
        session: 0xBEEF,
        product_id: 0x6020_0103,
    }
    .emit(7);
    assert_eq!(first.extended_id(), Some(0x0206_F007));
    assert_eq!(first.data(), [0xEF, 0xBE, 0x03, 0x01, 0x20, 0x60]);
    let second = EnumerateResponse1 {
        session: 0xBEEF,
        versions: VERSIONS,
    }
    .emit(7);
    assert_eq!(second.data(), [0xEF, 0xBE, 0, 0, 0x17, 0x01, 0x09, 0x01]);
    let set = ParameterSet {
        session: 0xBEEF,
        parameter: 16,
        value: 0x0102_0304,
    }
    .emit(7);
    assert_eq!(set.extended_id(), Some(0x0206_1887));
    assert_eq!(set.data(), [0xEF, 0xBE, 16, 4, 3, 2, 1]);
    let request = ParameterRequest {
        session: 0xBEEF,
        parameter: 16,
    }
    .emit(7);
    assert_eq!(
        (request.extended_id(), request.data()),
        (Some(0x0206_1807), &[0xEF, 0xBE, 16][..])
    );
    let response = ParameterResponse {
        parameter: 16,
        value: 0x0102_0304,
        code: 2,
    }
    .emit(7);
    assert_eq!(response.extended_id(), Some(0x0206_1847));
    assert_eq!(response.data(), [16, 4, 3, 2, 1, 2]);
    assert_eq!(command(0x60, 0).data(), [0x34, 0x12, 0x60, 0, 0, 0, 0, 0]);
}

#[test]
fn enumeration_is_answered_after_twice_the_number_or_seven_bits_of_the_session() {
    for (own, session, ticks) in [
        (1, 1, 2),
        (63, 1, 126),
        (0, 0x0080, 1),
        (0, 0xFF7F, 127),
        (0, 0x0105, 5),
    ] {
        let mut channel = Management::new(ImageType::Application, &Identity::DMC60C);
        channel.start(session);
        channel.enumerate(Instant::ZERO, own);
        let due = Instant::ZERO + Duration::from_ticks(ticks);
        assert_eq!(channel.next_deadline(), Some(due));
        let early = due - Duration::from_micros(1);
        assert!(channel.encode(early, own, VERSIONS).is_none());
        let (first, answer) = channel.encode(due, own, VERSIONS).unwrap();
        assert_eq!(EnumerateResponse0::parse(&first).unwrap().session, session);
        assert_eq!(answer, Answer::Enumerate0);
        // The second follows the first, under the number that the first had.
        assert!(channel.encode(due, own, VERSIONS).is_none());
        channel.enumerate_0_sent();
        let (second, _) = channel.encode(due, 44, VERSIONS).unwrap();
        assert_eq!(second.extended_id(), Some(0x0206_F000 | u32::from(own)));
        assert!(channel.encode(due, own, VERSIONS).is_none());
    }
}

#[test]
fn a_destroyed_answer_comes_once_more_after_the_new_session_s_delay() {
    let mut channel = channel();
    channel.enumerate(Instant::ZERO, 10);
    let first = Instant::from_micros(10_000);
    assert!(channel.encode(first, 10, VERSIONS).is_some());
    channel.enumerate_0_destroyed(first, 0x0107);
    let again = first + Duration::from_ticks(7);
    assert_eq!(channel.next_deadline(), Some(again));
    let (frame, _) = channel.encode(again, 10, VERSIONS).unwrap();
    assert_eq!(EnumerateResponse0::parse(&frame).unwrap().session, 0x0107);
    channel.enumerate_0_destroyed(again, 0x0109);
    assert_eq!(channel.next_deadline(), None, "no third attempt");
    assert_eq!(channel.session(), Some(0x0109));
}

#[test]
fn a_request_during_a_pending_answer_is_dropped() {
    let mut channel = channel();
    channel.enumerate(Instant::ZERO, 10);
    let due = channel.next_deadline();
    channel.enumerate(Instant::from_micros(5_000), 10);
    assert_eq!(channel.next_deadline(), due);
}

#[test]
fn enumeration_ignores_the_low_six_bits_and_the_length() {
    for frame in [
        Frame::extended(0x240, []),
        Frame::extended(0x245, [0; 8]),
        Frame::extended(0x27F, [1, 2]),
    ] {
        assert_eq!(
            channel().decode(5, &frame),
            Decoded::Request(Request::Enumerate)
        );
    }
    assert_eq!(
        channel().decode(5, &Frame::standard(0x240, [])),
        Decoded::NotMine
    );
    let remote = Frame::remote(Frame::extended(0x240, []).id(), 0).unwrap();
    assert_eq!(channel().decode(5, &remote), Decoded::Bad(Bad::Remote));
}

#[test]
fn lengths_are_exact_and_sessions_must_match() {
    let frames = [
        command(0x61, 0),
        ParameterRequest {
            session: SESSION,
            parameter: 1,
        }
        .emit(5),
        ParameterSet {
            session: SESSION,
            parameter: 1,
            value: 0,
        }
        .emit(5),
    ];
    for frame in frames {
        assert!(matches!(channel().decode(5, &frame), Decoded::Request(_)));
        for len in 0..frame.dlc() {
            assert_eq!(
                channel().decode(5, &frame.shortened(len)),
                Decoded::Bad(Bad::Length)
            );
        }
        assert_eq!(channel().decode(6, &frame), Decoded::NotMine);
        for other in [0, 0xFFFF, SESSION + 1] {
            let mut channel = Management::new(ImageType::Application, &Identity::DMC60C);
            channel.start(other.max(1));
            assert_eq!(channel.decode(5, &frame), Decoded::Bad(Bad::Session));
            assert_eq!(next(&mut channel), None);
        }
    }
}

#[test]
fn commands_are_compared_as_16_bits() {
    let mut channel = channel();
    assert_eq!(channel.decode(5, &command(0x0161, 0)), Decoded::Done);
    assert_eq!(status(&mut channel), (CommandCode::NotSupported as u16, 0));
    for unknown in [0, 0x08, 0x4F, 0x63, 0xE5, 0xF5, 0xFFFF] {
        channel.decode(5, &command(unknown, 0));
        assert_eq!(status(&mut channel), (CommandCode::NotSupported as u16, 0));
    }
}

#[test]
fn device_numbers_1_to_63_only() {
    for (number, good) in [
        (0, false),
        (1, true),
        (63, true),
        (64, false),
        (0x0101, false),
    ] {
        let mut channel = channel();
        let decoded = channel.decode(5, &command(0x01, number));
        if good {
            assert_eq!(decoded, Decoded::Request(Request::SetNumber(number as u8)));
        } else {
            assert_eq!(decoded, Decoded::Done);
            assert_eq!(status(&mut channel), (CommandCode::BadParameter as u16, 0));
        }
    }
}

/// A device that is managed as a Talon: everything under manufacturer 4, numbers 0 to 62.
fn talon() -> Management {
    let mut channel = Management::new(
        ImageType::Application,
        crate::dialect::DialectKind::TalonSrx.identity(),
    );
    channel.start(SESSION);
    channel
}

#[test]
fn a_talon_is_managed_under_its_own_manufacturer() {
    let to_talon = |frame: Frame| frame.with_extended_id(frame.raw_id() ^ 0x0002_0000);
    let mut channel = talon();
    assert_eq!(
        channel.decode(5, &Frame::extended(id::ENUMERATE, [])),
        Decoded::Request(Request::Enumerate)
    );
    channel.enumerate(Instant::ZERO, 5);
    let due = channel.next_deadline().unwrap();
    let (first, _) = channel.encode(due, 5, VERSIONS).unwrap();
    assert_eq!(first.extended_id(), Some(0x0204_F005));
    assert_eq!(first.data(), [0x34, 0x12, 0x01, 0x01, 0x40, 0x20]);
    channel.enumerate_0_sent();
    let (second, _) = channel.encode(due, 5, VERSIONS).unwrap();
    assert_eq!(second.extended_id(), Some(0x0204_F005));
    let question = to_talon(command(0x61, 0));
    assert_eq!(question.extended_id(), Some(0x0204_FC05));
    assert_eq!(
        channel.decode(5, &question),
        Decoded::Request(Request::GetVersions)
    );
    channel.send_versions(VERSIONS);
    let answers = [next(&mut channel), next(&mut channel)].map(Option::unwrap);
    assert_eq!(
        answers.map(|frame| frame.raw_id()),
        [0x0204_FCC5, 0x0204_FC85]
    );
    let set = Frame::extended(0x0204_FD85, [0x34, 0x12, 128, 0, 0, 0, 0]);
    assert_eq!(
        channel.decode(5, &set),
        Decoded::Request(Request::Parameter(ParameterQuery::Write(128, 0)))
    );
    channel.answer_parameter(Outcome {
        parameter: 128,
        result: Ok(0),
    });
    assert_eq!(next(&mut channel).unwrap().raw_id(), 0x0204_FD45);
    channel.decode(5, &to_talon(command(0x04, 4)));
    let last = channel.decode(5, &to_talon(data_out(b"abc\0")));
    assert!(matches!(last, Decoded::Request(Request::SetDescriptor(..))));
}

#[test]
fn i5_neither_kind_of_device_takes_the_other_s_frames() {
    let dmc60c = [
        command(0x61, 0),
        data_out(b"a"),
        Frame::extended(0x0206_1805, [0x34, 0x12, 1]),
    ];
    for frame in dmc60c {
        assert!(channel().accepts(5, &frame) && !talon().accepts(5, &frame));
        assert_eq!(talon().decode(5, &frame), Decoded::NotMine, "{frame:?}");
    }
    let talons = [
        command(0x61, 0).with_extended_id(0x0204_FC05),
        data_out(b"a").with_extended_id(0x0204_FC45),
        Frame::extended(0x0204_FD05, [0x34, 0x12, 1]),
    ];
    for frame in talons {
        assert!(talon().accepts(5, &frame) && !channel().accepts(5, &frame));
        assert_eq!(channel().decode(5, &frame), Decoded::NotMine, "{frame:?}");
    }
    // The Talon's own parameter frames stand where the DMC60C's would.
    let own = Frame::extended(0x0204_1805, [0x34, 0x12, 1]);
    assert_eq!(talon().decode(5, &own), Decoded::NotMine);
}

#[test]
fn a_talon_is_given_the_numbers_0_to_62() {
    for (number, good) in [(0, true), (62, true), (63, false), (0x0100, false)] {
        let mut channel = talon();
        let decoded = channel.decode(5, &command(0x01, number).with_extended_id(0x0204_FC05));
        if good {
            assert_eq!(decoded, Decoded::Request(Request::SetNumber(number as u8)));
        } else {
            assert_eq!(decoded, Decoded::Done);
            let refused = next(&mut channel).unwrap();
            assert_eq!(refused.data(), [CommandCode::BadParameter as u8, 0, 0, 0]);
        }
    }
}

#[test]
fn a_string_arrives_in_frames_of_any_length() {
    for chunk in [1, 7, 8] {
        let mut channel = channel();
        assert_eq!(channel.decode(5, &command(0x02, 12)), Decoded::Done);
        assert_eq!(next(&mut channel), None, "no status before the data");
        let mut last = Decoded::Done;
        for bytes in b"hello world\0".chunks(chunk) {
            assert_eq!(last, Decoded::Done);
            last = channel.decode(5, &data_out(bytes));
        }
        assert_eq!(
            last,
            Decoded::Request(Request::SetDescriptor(Descriptor::DeviceName))
        );
        assert_eq!(channel.text(), b"hello world");
    }
}

#[test]
fn a_missing_terminator_is_forced() {
    let mut channel = channel();
    channel.decode(5, &command(0x06, 5));
    assert_eq!(
        channel.decode(5, &data_out(b"E.123")),
        Decoded::Request(Request::SetDescriptor(Descriptor::HardwareVersion))
    );
    assert_eq!(channel.text(), b"E.12");
}

#[test]
fn string_lengths_of_the_guide() {
    for (code, capacity) in [(2, 64), (3, 28), (4, 28), (5, 20), (6, 8), (7, 12)] {
        for (length, good) in [
            (0, false),
            (1, true),
            (capacity + 1, true),
            (capacity + 2, false),
        ] {
            let mut channel = channel();
            channel.decode(5, &command(code, length));
            if good {
                assert_eq!(next(&mut channel), None);
            } else {
                assert_eq!(status(&mut channel), (CommandCode::BadParameter as u16, 0));
            }
        }
    }
}

#[test]
fn one_byte_too_many_cancels_the_transfer() {
    let mut channel = channel();
    channel.decode(5, &command(0x02, 3));
    assert_eq!(channel.decode(5, &data_out(b"abcd")), Decoded::Done);
    assert_eq!(
        status(&mut channel),
        (CommandCode::DataReceivedMore as u16, 0)
    );
    assert_eq!(
        channel.decode(5, &data_out(b"a")),
        Decoded::Bad(Bad::Unexpected)
    );
}

#[test]
fn a_new_command_cancels_transfers_and_an_unsent_status() {
    let mut channel = channel();
    channel.decode(5, &command(0x02, 3));
    channel.decode(5, &command(0x01, 0));
    channel.decode(5, &command(0xEE, 0));
    assert_eq!(status(&mut channel), (CommandCode::NotSupported as u16, 0));
    assert_eq!(next(&mut channel), None);
    assert_eq!(
        channel.decode(5, &data_out(b"ab\0")),
        Decoded::Bad(Bad::Unexpected)
    );
    channel.send_sequence(1);
    channel.decode(5, &command(0xEE, 0));
    assert_eq!(status(&mut channel).0, CommandCode::NotSupported as u16);
    assert_eq!(next(&mut channel), None, "the data is discarded");
}

#[test]
fn default_descriptors_are_73_bytes_in_the_order_of_their_identifiers() {
    let mut channel = channel();
    channel.send_descriptors(&Descriptors::default());
    let (code, count) = status(&mut channel);
    assert_eq!((code, count), (0, 16 + 8 + 15 + 3 * 7 + 12));
    let mut bytes = std::vec::Vec::new();
    while let Some(frame) = next(&mut channel) {
        assert_eq!(frame.extended_id(), Some(0x0206_FC85));
        bytes.extend_from_slice(frame.data());
    }
    assert_eq!(bytes.len(), usize::from(count));
    assert_eq!(&bytes[..18], b"\x01\x10Motor Controller");
    assert!(bytes.ends_with(b"\x05\x07UNKNOWN\x06\x07UNKNOWN"));
}

#[test]
fn longest_descriptors_fit() {
    let mut descriptors = Descriptors::default();
    for which in Descriptor::ALL {
        descriptors.set(which, &[b'x'; 64]);
    }
    let mut channel = channel();
    channel.send_descriptors(&descriptors);
    assert_eq!(status(&mut channel), (0, 172));
    assert_eq!(
        core::iter::from_fn(|| next(&mut channel))
            .map(|frame| frame.dlc())
            .sum::<usize>(),
        172
    );
}

#[test]
fn a_failed_pin_stands_in_the_high_byte() {
    let mut channel = channel();
    channel.finish_pin_test(Some(TestPin::EncoderIndex));
    assert_eq!(status(&mut channel), (0x0609, 0));
    channel.finish_pin_test(None);
    assert_eq!(status(&mut channel), (8, 0));
}

#[test]
fn in_the_bootloader_there_are_no_parameters_and_enter_is_answered_at_once() {
    let mut channel = Management::new(ImageType::Bootloader, &Identity::DMC60C);
    channel.start(SESSION);
    let request = ParameterRequest {
        session: SESSION,
        parameter: 1,
    }
    .emit(5);
    assert_eq!(channel.decode(5, &request), Decoded::NotMine);
    assert_eq!(channel.decode(5, &command(0xF0, 0)), Decoded::Done);
    assert_eq!(status(&mut channel), (CommandCode::InBootloader as u16, 0));
}

extern crate std;

proptest! {
    /// I1 for the decoder, whatever the order of frames.
    #[test]
    fn i1_no_frame_panics_the_channel(
        frames in proptest::collection::vec((0..12_u32, any::<[u8; 8]>(), 0..=8_usize, any::<bool>()), 1..60)
    ) {
        let mut channel = channel();
        for (kind, mut data, len, with_session) in frames {
            if with_session {
                data[..2].copy_from_slice(&SESSION.to_le_bytes());
                data[3] = 0;
            }
            let base = [id::ENUMERATE, id::VENDOR_COMMAND, id::VENDOR_DATA_OUT, id::PARAMETER_REQUEST, id::PARAMETER_SET]
                .get(kind as usize / 2).copied().unwrap_or(id::VENDOR_DATA_OUT);
            let frame = Frame::extended(base | 5, data).shortened(len);
            if let Decoded::Request(Request::SetDescriptor(which)) = channel.decode(5, &frame) {
                prop_assert!(channel.text().len() <= which.capacity());
            }
            let _ = next(&mut channel);
        }
    }

    /// I7 for the management frames.
    #[test]
    fn i7_encode_of_decode_is_the_frame(data: [u8; 8]) {
        let frame = Frame::extended(id::VENDOR_COMMAND | 5, data);
        prop_assert_eq!(VendorCommand::parse(&frame).unwrap().emit(5), frame);
        let frame = Frame::extended(id::VENDOR_STATUS | 5, data).shortened(4);
        prop_assert_eq!(VendorStatus::parse(&frame).unwrap().emit(5), frame);
        let frame = Frame::extended(id::PARAMETER_REQUEST | 5, data).shortened(3);
        prop_assert_eq!(ParameterRequest::parse(&frame).unwrap().emit(5), frame);
        let frame = Frame::extended(id::PARAMETER_SET | 5, data).shortened(7);
        prop_assert_eq!(ParameterSet::parse(&frame).unwrap().emit(5), frame);
        let frame = Frame::extended(id::PARAMETER_RESPONSE | 5, data).shortened(6);
        prop_assert_eq!(ParameterResponse::parse(&frame).unwrap().emit(5), frame);
        let frame = Frame::extended(id::ENUMERATE_RESPONSE | 5, data).shortened(6);
        prop_assert_eq!(EnumerateResponse0::parse(&frame).unwrap().emit(5), frame);
        let mut clean = data;
        clean[2] &= 3;
        clean[3] = 0;
        let frame = Frame::extended(id::ENUMERATE_RESPONSE | 5, clean);
        prop_assert_eq!(EnumerateResponse1::parse(&frame).unwrap().emit(5), frame);
    }
}
