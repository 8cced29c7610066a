//! Starting and replacing the application: the image format, what a slot of flash holds, the decision of
//! the bootloader, and the page protocol of an update.
//!
//! See docs/updates.md for what is guaranteed and docs/image-format.md for every byte.

#[cfg(feature = "signed")]
pub mod ed25519;
pub mod image;
pub mod loader;
pub mod slots;
pub mod status;
pub mod trust;
pub mod updater;

#[cfg(test)]
mod tests;
