//! What outlives the node on a board without a settings memory: kept in RAM, lost with the power.

use windlass_core::engine;
use windlass_core::management::wire::ImageType;
use windlass_core::node::{Handover, NodeConfig};
use windlass_core::params::Stored;
use windlass_core::reset::{Reset, ResetCause};

use crate::record::{Cause, Record, Start};

/// Settings, and the order that the node before has left.
#[derive(Clone, Debug)]
pub struct Kept {
    record: &'static Record,
    board: engine::Board,
    seed: u32,
    reset: Reset,
    /// Left by the node before.
    handover: Option<Handover>,
    /// Settings that were saved last.
    pub stored: Option<Stored>,
}

impl Kept {
    /// At the start of the program. `hardware` is the cause of the start that the chip tells, `board` converts
    /// what is measured, and `seed` differs from specimen to specimen.
    #[must_use]
    pub fn new(
        record: &'static Record,
        hardware: ResetCause,
        board: engine::Board,
        seed: u32,
    ) -> Self {
        let Start { reset, handover } = record.start(hardware);
        Self {
            record,
            board,
            seed,
            reset,
            handover,
            stored: None,
        }
    }

    /// The node restarts on purpose. The program goes on, because a reset of the processor would lose the
    /// settings; what the next node learns is the same.
    pub fn restart(&mut self, handover: Handover) {
        self.record.set(Cause::Requested(handover));
        let Start { reset, handover } = self.record.start(ResetCause::Requested);
        self.reset = reset;
        self.handover = handover;
    }

    /// Why the present node has started.
    #[must_use]
    pub const fn reset(&self) -> Reset {
        self.reset
    }

    /// What the next node is made from: there is no bootloader of its own, so that the node plays it when
    /// it is told to stay there.
    #[must_use]
    pub const fn node_config(&self) -> NodeConfig {
        let image = match self.handover {
            Some(handover) if handover.stay_in_bootloader => ImageType::Bootloader,
            _ => ImageType::Application,
        };
        NodeConfig {
            image,
            board: self.board,
            handover: self.handover,
            reset: self.reset,
            ..NodeConfig::dmc60c(self.seed)
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn only_an_order_to_stay_leads_to_the_bootloader() {
        static RECORD: Record = Record::new();
        let mut kept = Kept::new(&RECORD, ResetCause::PowerOn, engine::Board::REFERENCE, 1);
        assert_eq!(kept.node_config().image, ImageType::Application);
        for (stay_in_bootloader, image) in [
            (false, ImageType::Application),
            (true, ImageType::Bootloader),
        ] {
            let handover = Handover {
                session: 7,
                stay_in_bootloader,
            };
            kept.restart(handover);
            let config = kept.node_config();
            assert_eq!((config.image, config.handover), (image, Some(handover)));
            assert_eq!(config.reset.cause, ResetCause::Requested);
        }
        assert_eq!(kept.reset().count, 2);
    }
}
