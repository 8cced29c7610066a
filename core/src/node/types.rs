//! What a node is made from, and the values that it exchanges with its platform.

use crate::dialect::Bad;
use crate::engine::settings::Board;
use crate::frame::Frame;
use crate::management::Answer;
use crate::management::vendor::PinTest;
use crate::management::wire::ImageType;
use crate::params::journal::Crash;
use crate::reset::Reset;

/// Product identifier of the DMC60C: product 0x602, variant 1, firmware id 3 (docs/dmc60c.md). Firmware images
/// of every board have it, whatever dialect drives.
pub const PRODUCT_DMC60C: u32 = 0x6020_0103;

/// What survives a restart that was asked for, and nothing else (guide, `vcmdEnterBootloader`).
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub struct Handover {
    /// Session id that goes on.
    pub session: u16,
    /// The bootloader is to stay instead of starting the application.
    pub stay_in_bootloader: bool,
}

/// What a node is made from.
#[derive(Clone, Copy, Debug)]
pub struct NodeConfig {
    /// Conversion factors and limits of the board.
    pub board: Board,
    /// Application version (`fwverApp`), major and minor byte; 0xFFFF if there is no application.
    pub application_version: u16,
    /// Bootloader version (`fwverBoot`).
    pub bootloader_version: u16,
    /// Which image runs.
    pub image: ImageType,
    /// Differs from board to board; session ids are drawn from it and the time.
    pub seed: u32,
    /// Left by the image before, if it restarted on purpose.
    pub handover: Option<Handover>,
    /// What is stored is of a newer format: the node runs on defaults and saves nothing.
    pub newer_settings: bool,
    /// Why the controller started.
    pub reset: Reset,
    /// The latest crash, if one is kept.
    pub crash: Option<Crash>,
}

impl NodeConfig {
    /// A DMC60C application with the versions of the guide's cover page (1.23 and 1.9), at power-on.
    #[must_use]
    pub const fn dmc60c(seed: u32) -> Self {
        Self {
            board: Board::REFERENCE,
            application_version: 0x0117,
            bootloader_version: 0x0109,
            image: ImageType::Application,
            seed,
            handover: None,
            newer_settings: false,
            reset: Reset::POWER_ON,
            crash: None,
        }
    }
}

/// How often a frame may be sent before it is given up.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Attempts {
    /// Until it gets through.
    UntilSent,
    /// Given up once it has been destroyed by an error frame this often. Waiting for a busy bus is no
    /// attempt, and neither is a missing acknowledge, which ends when the controller is error passive.
    AtMost(u8),
}

/// Tells the node which of its frames a result belongs to.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Tag(pub(crate) Answer);

/// A frame to send.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Transmission {
    /// The frame.
    pub frame: Frame,
    /// To be handed back with the result.
    pub tag: Tag,
    /// How hard to try.
    pub attempts: Attempts,
}

/// What became of a transmission.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub enum TxOutcome {
    /// Sent and acknowledged.
    Sent,
    /// Destroyed more often than allowed, or flushed.
    Failed,
}

/// What the platform has to do for the node.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Action {
    /// Keep [`Node::stored`](super::Node::stored), then call [`Node::save_ended`](super::Node::save_ended).
    Save,
    /// Restart with this handover.
    Reset(Handover),
    /// The image has answered a host for the first time since it started: end its trial with
    /// [`Slot::confirm`](crate::boot::slots::Slot::confirm) where there are slots, and forget failures in a row as for
    /// [`Action::Healthy`].
    Confirm,
    /// The image has run for [`HEALTHY_AFTER`](crate::reset::HEALTHY_AFTER): forget its failures in a row
    /// ([`Crashes`](crate::reset::Crashes)).
    Healthy,
    /// Test the expansion header, then call [`Node::pin_test_done`](super::Node::pin_test_done).
    PinTest(PinTest),
}

/// Frames counted by what became of them; all wrap.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub struct Counters {
    /// Frames received, for whomever.
    pub received: u32,
    /// Frames that meant nothing to this device.
    pub ignored: u32,
    /// Refused for their data length.
    pub bad_length: u32,
    /// Refused because they were remote frames.
    pub remote: u32,
    /// Refused for another session id.
    pub wrong_session: u32,
    /// Refused because nothing had asked for them.
    pub unexpected: u32,
    /// Parameter answers that found no place.
    pub answers_lost: u32,
    /// Losses of the bus.
    pub bus_losses: u32,
    /// Received by the controller and lost before the node saw them.
    pub dropped: u32,
    /// Transmissions that were given up.
    pub given_up: u32,
    /// Error frames that the CAN controller has seen since it was initialised.
    pub bus_errors: u32,
}

impl Counters {
    pub(crate) fn count_bad(&mut self, bad: Bad) {
        let counter = match bad {
            Bad::Length => &mut self.bad_length,
            Bad::Remote => &mut self.remote,
            Bad::Session => &mut self.wrong_session,
            Bad::Unexpected => &mut self.unexpected,
        };
        *counter = counter.wrapping_add(1);
    }
}
