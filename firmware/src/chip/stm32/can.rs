//! Between the node's bus and its CAN controller: what the controller's interrupts have noted, or, in a bootloader,
//! which enables none, what the controller says when it is asked.

#[cfg(not(feature = "bootloader"))]
pub use interrupted::{MAILBOX, Transfers};
#[cfg(feature = "bootloader")]
pub use polled::Transfers;
use windlass_core::frame::Frame;

use crate::mailbox::Attempt;

/// A controller that repeats nothing by itself.
pub trait Controller {
    /// Starts an attempt to send what stands in its buffer.
    fn request();

    /// How the attempt has ended, if it has since this was asked last.
    fn attempt_ended() -> Option<Attempt>;

    /// The oldest frame that it has received; also none for one that cannot be.
    fn received() -> Option<Frame>;
}

#[cfg(not(feature = "bootloader"))]
mod interrupted {
    use windlass_core::node::Attempts;

    use super::Controller;
    use crate::mailbox::Mailbox;
    use crate::port::BusEvent;

    /// What the interrupts of the one controller fill.
    pub static MAILBOX: Mailbox = Mailbox::new();

    /// The bus's side of [`MAILBOX`].
    #[derive(Debug, Default)]
    pub struct Transfers;

    impl Transfers {
        /// A transmission starts.
        pub fn begin(&mut self, attempts: Attempts) {
            MAILBOX.start(attempts);
        }

        /// The bus is lost: what is on its way is given up without an outcome.
        pub fn flush(&mut self) {
            MAILBOX.flush();
        }

        /// The next event.
        pub fn poll<C: Controller>(&mut self) -> Option<BusEvent> {
            MAILBOX.poll()
        }

        /// Frames that found no place.
        pub fn dropped(&self) -> u32 {
            MAILBOX.dropped()
        }

        /// Error frames that the controller has seen.
        pub fn errors(&self) -> u32 {
            MAILBOX.errors()
        }
    }
}

#[cfg(feature = "bootloader")]
mod polled {
    use windlass_core::node::Attempts;

    use super::Controller;
    use crate::mailbox::Line;
    use crate::port::BusEvent;

    /// The bus without interrupts.
    #[derive(Debug, Default)]
    pub struct Transfers(Line);

    impl Transfers {
        /// A transmission starts.
        pub fn begin(&mut self, attempts: Attempts) {
            self.0.start(attempts);
        }

        /// The bus is lost: what is on its way is given up without an outcome.
        pub fn flush(&mut self) {
            self.0.flush();
        }

        /// The next event, of which the controller is asked.
        pub fn poll<C: Controller>(&mut self) -> Option<BusEvent> {
            self.0.poll(C::attempt_ended(), C::request, C::received)
        }

        /// A bootloader counts nothing.
        pub fn dropped(&self) -> u32 {
            0
        }

        /// A bootloader counts nothing.
        pub fn errors(&self) -> u32 {
            0
        }
    }
}
