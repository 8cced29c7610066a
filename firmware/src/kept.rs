//! What outlives the node on a board without a settings memory: kept in RAM, lost with the power.

use windlass_core::management::wire::ImageType;
use windlass_core::node::{Handover, NodeConfig};
use windlass_core::params::Stored;

/// Settings, and the order that the node before has left.
#[derive(Clone, Debug, Default)]
pub struct Kept {
    /// Differs from board to board.
    pub seed: u32,
    /// Left by the node before.
    pub handover: Option<Handover>,
    /// Settings that were saved last.
    pub stored: Option<Stored>,
}

impl Kept {
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
            handover: self.handover,
            ..NodeConfig::dmc60c(self.seed)
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn only_an_order_to_stay_leads_to_the_bootloader() {
        let mut kept = Kept::default();
        assert_eq!(kept.node_config().image, ImageType::Application);
        for (stay_in_bootloader, image) in [
            (false, ImageType::Application),
            (true, ImageType::Bootloader),
        ] {
            kept.handover = Some(Handover {
                session: 7,
                stay_in_bootloader,
            });
            let config = kept.node_config();
            assert_eq!((config.image, config.handover), (image, kept.handover));
        }
    }
}
