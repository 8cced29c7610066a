//! Any byte stream into an SLCAN channel: nothing panics, every line has exactly one answer, and
//! every frame that comes out survives being written and read again.
#![no_main]

use libfuzzer_sys::fuzz_target;
use windlass_core::slcan::{self, BEL, CR, Channel, State};

fuzz_target!(|bytes: &[u8]| {
    let mut channel = Channel::new();
    channel.set_frame_replies(bytes.len() % 2 == 0);
    for byte in bytes {
        let answer = channel.push(*byte);
        assert_eq!(answer.is_some(), *byte == CR);
        let Some(answer) = answer else { continue };
        assert!(matches!(answer.reply.last(), None | Some(&CR | &BEL)));
        let Some(frame) = answer.transmit else { continue };
        assert!(matches!(channel.state(), State::Open | State::OpenAtStart));
        let text = slcan::format(&frame, Some(1));
        let line = text.strip_suffix(&[CR]).expect("a line ends with CR");
        assert_eq!(slcan::parse(line), Some((frame, Some(1))));
        assert!(channel.received(&frame, 60_000).is_some());
    }
    let _ = slcan::parse(bytes);
});
