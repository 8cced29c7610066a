//! What can go wrong, and what to do then.

use std::path::PathBuf;
use std::process::ExitStatus;

use crate::board;

/// Why a command failed.
#[derive(Debug, thiserror::Error)]
pub(crate) enum Error {
    /// The board does not exist.
    #[error("unknown board `{0}`; the boards are {list}", list = board::names())]
    UnknownBoard(String),
    /// Nothing can build for the microcontroller.
    #[error(
        "no toolchain for thumbv7em-none-eabihf found; either install rustup's target:\n  \
         rustup target add thumbv7em-none-eabihf\n\
         or, on Debian, a compiler with the sources of its library and a linker:\n  \
         apt-get install rustc-web cargo-web rust-web-src binutils-arm-none-eabi\n\
         (looked at: {looked_at})"
    )]
    NoToolchain {
        /// Sysroots that were looked at.
        looked_at: String,
    },
    /// The library can be built, but nothing can link.
    #[error(
        "no linker for Arm found; install one: apt-get install binutils-arm-none-eabi (or lld)"
    )]
    NoLinker,
    /// There is no chip to flash.
    #[error("the board `{0}` is emulated and cannot be flashed; `cargo xtask qemu-test` runs it")]
    Emulated(&'static str),
    /// A program is not installed.
    #[error("{program} is not installed; install it: {hint}")]
    Missing {
        /// The program.
        program: &'static str,
        /// How to get it.
        hint: &'static str,
    },
    /// A program cannot be started.
    #[error("cannot run {program}: {cause}; {hint}")]
    Start {
        /// The program.
        program: String,
        /// Why not.
        cause: std::io::Error,
        /// What to do.
        hint: &'static str,
    },
    /// A program failed.
    #[error("{program} ended with {status}; its messages stand above")]
    Failed {
        /// The program.
        program: String,
        /// How it ended.
        status: ExitStatus,
    },
    /// A file cannot be read or written.
    #[error("cannot access {}: {cause}; check the path and its permissions", path.display())]
    File {
        /// The file.
        path: PathBuf,
        /// Why not.
        cause: std::io::Error,
    },
    /// An image is not what the linker should have made.
    #[error("{} is no usable image: {what}; delete it and build again", path.display())]
    Image {
        /// The file.
        path: PathBuf,
        /// What is wrong.
        what: String,
    },
    /// Two machines disagree.
    #[error(
        "the fingerprints differ from the first line on that does not match: the engine is not \
         bit-exact; look for floats, usize arithmetic or undefined order in core/src/engine"
    )]
    Differs,
    /// A bootloader that checks signatures is too large.
    #[error(
        "the bootloader that checks signatures does not fit `{board}`: it takes {what}. Build without --signed (the \
         controller then installs no key and accepts any image for its product and hardware), or take a board with \
         a larger region: {others}"
    )]
    NoRoomForSignatures {
        /// The board.
        board: &'static str,
        /// Which region, with the sizes.
        what: String,
        /// Boards that have room.
        others: String,
    },
    /// An image is too large.
    #[error(
        "the image does not fit its region: {what}; make it smaller or choose another board \
         (regions: firmware memory map)"
    )]
    TooLarge {
        /// Which region, with the sizes.
        what: String,
    },
}
