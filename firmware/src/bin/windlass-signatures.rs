//! Checks signatures on an emulated Cortex-M4 as the bootloader does, for `cargo xtask measure`, which builds it with
//! the bootloader's profile and counts the instructions.
//!
//! On this processor the crate `salty` multiplies in the field by machine code of its own; the bench's processor
//! takes another way. So the published vectors that the bench's tests judge are judged here too: a wrong verdict
//! ends the emulator with an error.
#![cfg_attr(target_os = "none", no_std)]
#![cfg_attr(target_os = "none", no_main)]

use core::hint::black_box;

use cortex_m_semihosting::debug;
use heapless::Vec;
use windlass_core::boot::ed25519::{Digest, Sha512, verify};
use windlass_core::boot::image::{ALL_PAGES, PAGE_SIZE, pages_of};
use windlass_firmware as _;

/// Of Project Wycheproof; a line is an id, a verdict, a key, a message and a signature.
const VECTORS: &str = include_str!("../../../tests/vectors/ed25519.txt");
/// The longest message is one of 1023 bytes.
const LONGEST: usize = 1024;
/// Bytes that the bootloader reads from flash at one time.
const CHUNK: usize = 256;

#[unsafe(no_mangle)]
#[inline(never)]
fn measured_signature(key: &[u8; 32], message: &[u8], signature: &[u8; 64]) -> bool {
    verify(key, message, signature)
}

/// The digest of the largest image: 31 pages, in the pieces in which it is read.
#[unsafe(no_mangle)]
#[inline(never)]
fn measured_digest(chunk: &[u8; CHUNK]) -> [u8; 64] {
    let mut hash = Sha512::new();
    for _ in pages_of(ALL_PAGES) {
        for _ in 0..PAGE_SIZE / CHUNK {
            hash.update(black_box(chunk));
        }
    }
    hash.finalize().into()
}

/// Bytes from hexadecimal digits; `-` is none.
fn bytes(text: &str) -> Option<Vec<u8, LONGEST>> {
    let mut bytes = Vec::new();
    for pair in text.as_bytes().chunks_exact(2) {
        let pair = core::str::from_utf8(pair).ok()?;
        bytes.push(u8::from_str_radix(pair, 16).ok()?).ok()?;
    }
    Some(bytes)
}

/// Whether the verdict on a vector is the published one; none if the line is no vector.
fn is_as_published(line: &str) -> Option<bool> {
    let mut words = line.split(' ').skip(1);
    let is_valid = words.next()? == "valid";
    let key = bytes(words.next()?)?;
    let message = bytes(words.next()?)?;
    let signature = bytes(words.next()?)?;
    let judged = <&[u8; 64]>::try_from(&signature[..]).is_ok_and(|signature| {
        key.first_chunk()
            .is_some_and(|key| measured_signature(key, &message, signature))
    });
    Some(judged == is_valid)
}

#[cortex_m_rt::entry]
fn main() -> ! {
    let mut lines = VECTORS.lines().filter(|line| !line.starts_with('#'));
    let right = lines.all(|line| is_as_published(line) == Some(true));
    black_box(measured_digest(&[0xA5; CHUNK]));
    debug::exit(if right {
        debug::EXIT_SUCCESS
    } else {
        debug::EXIT_FAILURE
    });
    loop {}
}
