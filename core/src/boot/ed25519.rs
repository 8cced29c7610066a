//! Ed25519 signatures (RFC 8032, section 5.1), checked without a path to a panic.
//!
//! Points of the curve are those of the crate `salty`, SHA-512 is that of `sha2`. What `salty` makes of its
//! points is not used: its hash, its reduction modulo the group's order and its multiplication of a point index
//! arrays in ways that leave a panic at some level of optimisation, and it neither refuses a scalar that is not
//! reduced nor a key of small order.
//!
//! Key, message and signature are no secrets, so that the time may depend on them.

use salty::{CompressedY, EdwardsPoint};
/// The hash, and how bytes are put into it.
pub use sha2::{Digest, Sha512};

/// Bytes of a number, a scalar or a compressed point.
const LENGTH: usize = 32;

/// A number of 256 bits, low byte first.
type Number = [u8; LENGTH];

/// Order of the base point: 2^252 + 27742317777372353535851937790883648493 (RFC 8032, table 1).
const ORDER: Number = [
    0xED, 0xD3, 0xF5, 0x5C, 0x1A, 0x63, 0x12, 0x58, 0xD6, 0x9C, 0xF7, 0xA2, 0xDE, 0xF9, 0xDE, 0x14,
    0, 0, 0, 0, 0, 0, 0, 0, 0, 0, 0, 0, 0, 0, 0, 0x10,
];

/// The field's prime: 2^255 - 19 (RFC 8032, table 1).
const PRIME: Number = {
    let mut prime = [0xFF; LENGTH];
    prime[0] = 0xED;
    prime[LENGTH - 1] = 0x7F;
    prime
};

/// The neutral point, compressed: y is 1.
const NEUTRAL: Number = {
    let mut neutral = [0; LENGTH];
    neutral[0] = 1;
    neutral
};

/// Doublings that take every point of small order to the neutral one: the curve's cofactor is 2^3.
const COFACTOR_DOUBLINGS: u32 = 3;

/// True if the bytes are a public key: the only encoding of a point, and not one of the eight points under which
/// everybody can sign anything.
#[must_use]
pub fn is_key(key: &[u8; 32]) -> bool {
    point(key).is_some()
}

/// True if `key` has made the signature of the message (RFC 8032, section 5.1.7, without the cofactor).
#[must_use]
pub fn verify(key: &[u8; 32], message: &[u8], signature: &[u8; 64]) -> bool {
    let Some((commitment, scalar)) = halves(signature) else {
        return false;
    };
    // Another scalar of the same remainder would be a second signature of the same message.
    if !is_less(scalar, &ORDER) {
        return false;
    }
    let Some(point) = point(key) else {
        return false;
    };
    let challenge = challenge(commitment, key, message);
    combined(scalar, &challenge, &-&point) == *commitment
}

/// The digest that binds a signature to key and message, modulo [`ORDER`].
// Not inlined, like those below: hash and points need not be on the stack together.
#[inline(never)]
fn challenge(commitment: &Number, key: &Number, message: &[u8]) -> Number {
    let mut hash = Sha512::new();
    hash.update(commitment);
    hash.update(key);
    hash.update(message);
    reduced(&hash.finalize().into())
}

fn halves(signature: &[u8; 64]) -> Option<(&Number, &Number)> {
    Some((signature.first_chunk()?, signature.last_chunk()?))
}

/// A public key as a point.
#[inline(never)]
fn point(key: &Number) -> Option<EdwardsPoint> {
    let mut y = *key;
    if let Some(high) = y.last_mut() {
        // The sign of x.
        *high &= 0x7F;
    }
    if !is_less(&y, &PRIME) {
        return None;
    }
    let point = CompressedY(*key).decompressed().ok()?;
    let mut multiple = point;
    for _ in 0..COFACTOR_DOUBLINGS {
        multiple = &multiple + &multiple;
    }
    (multiple.compressed().0 != NEUTRAL).then_some(point)
}

/// `scalar` times the base point and `challenge` times `point`, added up and compressed: both products in one run over
/// their bits.
#[inline(never)]
fn combined(scalar: &Number, challenge: &Number, point: &EdwardsPoint) -> Number {
    let base = EdwardsPoint::basepoint();
    let both = &base + point;
    let mut sum = EdwardsPoint::neutral_element();
    for (scalar, challenge) in scalar.iter().zip(challenge).rev() {
        for bit in (0..u8::BITS).rev() {
            sum = &sum + &sum;
            let addend = match (scalar >> bit & 1, challenge >> bit & 1) {
                (0, 0) => continue,
                (_, 0) => &base,
                (0, _) => point,
                _ => &both,
            };
            sum = &sum + addend;
        }
    }
    sum.compressed().0
}

/// A number of 512 bits, low byte first, modulo [`ORDER`]: long division, bit by bit.
fn reduced(wide: &[u8; 64]) -> Number {
    let mut rest = [0; LENGTH];
    for byte in wide.iter().rev() {
        for bit in (0..u8::BITS).rev() {
            // The rest is below the order, and its double below 2^254.
            let mut carry = byte >> bit & 1;
            for digit in &mut rest {
                (*digit, carry) = (*digit << 1 | carry, *digit >> 7);
            }
            if !is_less(&rest, &ORDER) {
                subtract(&mut rest, &ORDER);
            }
        }
    }
    rest
}

/// Subtracts a number that is not greater.
fn subtract(from: &mut Number, other: &Number) {
    let mut borrow = false;
    for (digit, other) in from.iter_mut().zip(other) {
        (*digit, borrow) = digit.borrowing_sub(*other, borrow);
    }
}

fn is_less(left: &Number, right: &Number) -> bool {
    left.iter().rev().lt(right.iter().rev())
}
