//! The expansion header J1: switches on its pins, and the tests that a node makes of it.
//!
//! Pins in the order of the DMC60C: 3 AIN1, 4 FWDLIM, 5 QEB, 7 QEA, 8 REVLIM, 9 QEIDX. The fixture of the
//! open-circuit test joins 3–4, 5–7 and 8–9 (guide, `vcmdJ1OpenTest`).

use windlass_core::management::vendor::{PinTest, TestPin};

/// What is connected to the header, apart from an encoder.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub(crate) struct Header {
    /// The forward limit switch connects FWDLIM to ground.
    pub(crate) forward_closed: bool,
    /// The reverse limit switch connects REVLIM to ground.
    pub(crate) reverse_closed: bool,
    /// Something forces a level on QEIDX.
    pub(crate) index_held: bool,
    /// Something forces a voltage on AIN1.
    pub(crate) analog_held: bool,
    /// The loopback fixture is plugged in.
    pub(crate) loopback: bool,
}

/// The pairs that the fixture joins.
const PAIRS: [(TestPin, TestPin); 3] = [
    (TestPin::AnalogIn, TestPin::ForwardLimit),
    (TestPin::EncoderA, TestPin::EncoderB),
    (TestPin::ReverseLimit, TestPin::EncoderIndex),
];

impl Header {
    /// True if a pin does not follow the node because something outside holds it to ground or supply.
    /// The encoder's outputs do not count: they are open-collector and yield to a test.
    fn held(self, pin: TestPin) -> bool {
        match pin {
            TestPin::AnalogIn => self.analog_held,
            TestPin::ForwardLimit => self.forward_closed,
            TestPin::ReverseLimit => self.reverse_closed,
            TestPin::EncoderIndex => self.index_held,
            TestPin::EncoderA | TestPin::EncoderB => false,
        }
    }

    /// The last pin, in the order of the test error codes, that fails a test.
    ///
    /// Short test: a pin fails if it is held, or joined to another pin. Open test: the node drives one
    /// pin of a pair and reads the other, so both fail without the fixture, and both fail if one is held.
    pub(crate) fn test(self, test: PinTest) -> Option<TestPin> {
        let fails = |pin: TestPin| match test {
            PinTest::Short => self.held(pin) || self.loopback,
            PinTest::Open => {
                let pair = PAIRS
                    .iter()
                    .find(|(one, other)| *one == pin || *other == pin);
                let held = pair.is_some_and(|(one, other)| self.held(*one) || self.held(*other));
                held || !self.loopback
            }
        };
        TestPin::TABLE
            .iter()
            .map(|(pin, _)| *pin)
            .rfind(|pin| fails(*pin))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn an_empty_header_passes_the_short_test_and_fails_the_open_test() {
        let header = Header::default();
        assert_eq!(header.test(PinTest::Short), None);
        assert_eq!(header.test(PinTest::Open), Some(TestPin::EncoderIndex));
    }

    #[test]
    fn the_fixture_passes_the_open_test_and_fails_the_short_test() {
        let header = Header {
            loopback: true,
            ..Header::default()
        };
        assert_eq!(header.test(PinTest::Open), None);
        assert_eq!(header.test(PinTest::Short), Some(TestPin::EncoderIndex));
    }

    #[test]
    fn the_last_held_pin_fails_the_short_test() {
        let mut header = Header {
            analog_held: true,
            ..Header::default()
        };
        assert_eq!(header.test(PinTest::Short), Some(TestPin::AnalogIn));
        header.forward_closed = true;
        assert_eq!(header.test(PinTest::Short), Some(TestPin::ForwardLimit));
        header.reverse_closed = true;
        assert_eq!(header.test(PinTest::Short), Some(TestPin::ReverseLimit));
        header.index_held = true;
        assert_eq!(header.test(PinTest::Short), Some(TestPin::EncoderIndex));
    }

    #[test]
    fn a_held_pin_spoils_its_pair_in_the_open_test() {
        let header = Header {
            loopback: true,
            analog_held: true,
            ..Header::default()
        };
        assert_eq!(header.test(PinTest::Open), Some(TestPin::ForwardLimit));
    }
}
