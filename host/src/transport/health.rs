//! What a transport knows about the CAN controller behind it.

use std::fmt;

/// Health of a CAN controller as far as the transport can know it: `None` is "cannot be known here".
///
/// On a good bus all of them are 0. They rise when the wires are shorted or pulled, and the error counters
/// fall again with every good frame afterwards (Talon manual 15).
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Health {
    /// Times that the controller went bus-off.
    pub bus_off: Option<u64>,
    /// Frames that were dropped because the buffer of outgoing frames was full. An adapter that only has a
    /// flag for it counts how often the flag was seen.
    pub tx_full: Option<u64>,
    /// Receive error counter.
    pub receive_errors: Option<u16>,
    /// Transmit error counter.
    pub transmit_errors: Option<u16>,
    /// What an adapter with flags instead of counters has said since it was opened.
    pub flags: Flags,
}

/// Flags of an SLCAN adapter, as in the Lawicel CAN232 manual.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Flags(pub u8);

impl Flags {
    const NAMES: [(u8, &'static str); 5] = [
        (
            windlass_core::slcan::flag::RECEIVE_QUEUE_FULL,
            "receive queue full",
        ),
        (windlass_core::slcan::flag::ERROR_WARNING, "error warning"),
        (windlass_core::slcan::flag::DATA_OVERRUN, "frame lost"),
        (windlass_core::slcan::flag::ERROR_PASSIVE, "error passive"),
        (windlass_core::slcan::flag::BUS_ERROR, "bus error"),
    ];

    /// The flags that tell of trouble, as words. Lost arbitration is none.
    pub fn names(self) -> impl Iterator<Item = &'static str> {
        Self::NAMES
            .into_iter()
            .filter(move |(bit, _)| self.0 & bit != 0)
            .map(|(_, name)| name)
    }
}

impl fmt::Display for Health {
    fn fmt(&self, out: &mut fmt::Formatter<'_>) -> fmt::Result {
        let counters = [
            ("bus-off", self.bus_off),
            ("TX full", self.tx_full),
            ("receive errors", self.receive_errors.map(u64::from)),
            ("transmit errors", self.transmit_errors.map(u64::from)),
        ];
        for (index, (name, count)) in counters.into_iter().enumerate() {
            let gap = if index == 0 { "" } else { "  " };
            match count {
                Some(count) => write!(out, "{gap}{name} {count}")?,
                None => write!(out, "{gap}{name} ?")?,
            }
        }
        for name in self.flags.names() {
            write!(out, "  {name}")?;
        }
        Ok(())
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn what_cannot_be_known_is_a_question_mark() {
        let health = Health {
            tx_full: Some(3),
            flags: Flags(0xC0),
            ..Health::default()
        };
        assert_eq!(
            health.to_string(),
            "bus-off ?  TX full 3  receive errors ?  transmit errors ?  bus error"
        );
    }
}
