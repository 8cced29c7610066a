//! Signatures: the boards' own check, against published vectors and against `ed25519-dalek`.
//!
//! `PROPTEST_CASES=100000 cargo test --release -p windlass-tests --test signatures` checks as many random ones.

use ed25519_dalek::{Signature, Signer, SigningKey, Verifier, VerifyingKey};
use proptest::prelude::*;
use windlass_core::boot::ed25519::{is_key, verify};
use windlass_core::boot::trust::{KEY_LENGTH, Trust, key_message};

/// Of Project Wycheproof; those of RFC 8032, section 7.1, are among them.
const VECTORS: &str = include_str!("../vectors/ed25519.txt");

/// Order of the base point, low byte first (RFC 8032, table 1).
const ORDER: [u8; 32] = [
    0xED, 0xD3, 0xF5, 0x5C, 0x1A, 0x63, 0x12, 0x58, 0xD6, 0x9C, 0xF7, 0xA2, 0xDE, 0xF9, 0xDE, 0x14,
    0, 0, 0, 0, 0, 0, 0, 0, 0, 0, 0, 0, 0, 0, 0, 0x10,
];

/// The base point, compressed: y is 4/5 (RFC 8032, table 1).
const BASE: [u8; 32] = {
    let mut base = [0x66; 32];
    base[0] = 0x58;
    base
};

/// A number below 256, or 2^255 less such a number, as the y of a point; with the sign of x or without.
fn y(low: u8, is_high: bool, sign: bool) -> [u8; 32] {
    let mut bytes = [if is_high { 0xFF } else { 0 }; 32];
    bytes[0] = low;
    bytes[31] = bytes[31] & 0x7F | u8::from(sign) << 7;
    bytes
}

/// The y of the points of order 8, low byte first: a root of 2y² = 1 + sqrt(1 + 1/d), and its negative.
const ORDER_8: [&str; 2] = [
    "c7176a703d4dd84fba3c0b760d10670f2a2053fa2c39ccc64ec7fd7792ac037a",
    "26e8958fc2b227b045c3f489f2ef98f0d5dfac05d3c63339b13802886d53fc05",
];

/// The eight points of small order.
fn small_points() -> Vec<[u8; 32]> {
    // y is 1, -1 and, of order 4 with either sign of x, 0.
    let mut points = vec![
        y(1, false, false),
        y(0xEC, true, false),
        y(0, false, false),
        y(0, false, true),
    ];
    for text in ORDER_8 {
        let mut point: [u8; 32] = bytes(text).try_into().unwrap();
        points.push(point);
        point[31] |= 0x80;
        points.push(point);
    }
    points
}

/// Bytes from hexadecimal digits.
fn bytes(text: &str) -> Vec<u8> {
    let digits = if text == "-" { "" } else { text };
    (0..digits.len())
        .step_by(2)
        .map(|at| u8::from_str_radix(&digits[at..at + 2], 16).unwrap())
        .collect()
}

fn joined(commitment: &[u8; 32], scalar: &[u8; 32]) -> [u8; 64] {
    [*commitment, *scalar].concat().try_into().unwrap()
}

#[test]
fn every_published_vector_is_judged_as_published() {
    let mut valid = 0;
    let mut invalid = 0;
    for line in VECTORS.lines().filter(|line| !line.starts_with('#')) {
        let [id, verdict, key, message, signature] =
            line.split(' ').collect::<Vec<_>>().try_into().unwrap();
        let key = bytes(key).try_into().unwrap();
        let is_valid = <[u8; 64]>::try_from(bytes(signature))
            .is_ok_and(|signature| verify(&key, &bytes(message), &signature));
        assert_eq!(is_valid, verdict == "valid", "vector {id}");
        assert!(is_key(&key), "vector {id}");
        if is_valid {
            valid += 1;
        } else {
            invalid += 1;
        }
    }
    assert_eq!((valid, invalid), (84, 61));
}

#[test]
fn a_scalar_that_is_not_reduced_is_refused() {
    let key = SigningKey::from_bytes(&[7; 32]);
    let public = key.verifying_key().to_bytes();
    let signature = key.sign(b"once").to_bytes();
    assert!(verify(&public, b"once", &signature));
    let mut again = signature;
    let mut carry = 0;
    for (digit, order) in again[32..].iter_mut().zip(ORDER) {
        let sum = u16::from(*digit) + u16::from(order) + carry;
        (*digit, carry) = (sum as u8, sum >> 8);
    }
    assert!(!verify(&public, b"once", &again), "a second signature");
    // Of the neutral point's logarithm there is only one form.
    for scalar in [ORDER, [0xFF; 32]] {
        assert!(!verify(&public, b"once", &joined(&BASE, &scalar)));
    }
}

/// Under a key of small order everybody signs a good part of all messages: the product with the challenge vanishes.
#[test]
fn a_key_of_small_order_is_none_and_admits_nothing() {
    let one = y(1, false, false);
    let signature = joined(&BASE, &one);
    let mut taken_by_others = 0;
    for key in small_points() {
        assert!(!is_key(&key), "{key:02x?}");
        let other = VerifyingKey::from_bytes(&key).unwrap();
        assert!(other.is_weak());
        for message in 0..64_u8 {
            assert!(!verify(&key, &[message], &signature), "{key:02x?}");
            taken_by_others += u32::from(
                other
                    .verify(&[message], &Signature::from_bytes(&signature))
                    .is_ok(),
            );
        }
    }
    // With nothing but the equation of the RFC, about one of 1, 2, 4 and 8 messages.
    assert!(taken_by_others > 100, "{taken_by_others}");
}

#[test]
fn only_the_one_encoding_of_a_point_is_a_key() {
    // y beyond the prime: 0 to 18 once more.
    for low in 0xED..=0xFF {
        for sign in [false, true] {
            assert!(!is_key(&y(low, true, sign)), "{low:#x}");
        }
    }
    // Some small y, and half of all, belong to no point.
    let points = (2..=255_u8)
        .filter(|low| is_key(&y(*low, false, false)))
        .count();
    let others = (2..=255_u8)
        .filter(|low| VerifyingKey::from_bytes(&y(*low, false, false)).is_ok())
        .count();
    assert_eq!(points, others);
    assert!((64..192).contains(&points), "{points}");
}

/// What a damaged journal may give: a stored key of another length counts as 32 zeros, which are a point of order 4.
#[test]
fn a_key_of_zeros_cannot_be_replaced_by_a_forged_order() {
    let trust = Trust {
        product: 1,
        hardware: 2,
        rollback: 3,
        key: Some([0; KEY_LENGTH]),
    };
    let signature = joined(&BASE, &y(1, false, false));
    for seed in 0..32 {
        let key = SigningKey::from_bytes(&[seed; 32])
            .verifying_key()
            .to_bytes();
        assert_eq!(trust.admits_key(&[&key[..], &signature].concat()), None);
    }
}

#[test]
fn a_key_is_replaced_by_the_signature_of_the_present_one_only() {
    let [old, new, other] = [1, 2, 3].map(|seed| SigningKey::from_bytes(&[seed; 32]));
    let public = new.verifying_key().to_bytes();
    let trust = |key: Option<&SigningKey>| Trust {
        product: 1,
        hardware: 2,
        rollback: 3,
        key: key.map(|key| key.verifying_key().to_bytes()),
    };
    let order = |signer: &SigningKey, message: &[u8]| {
        [&public[..], &signer.sign(message).to_bytes()].concat()
    };
    let message = key_message(&public);
    assert_eq!(trust(None).admits_key(&public), Some(public));
    assert_eq!(trust(Some(&old)).admits_key(&public), None);
    assert_eq!(
        trust(Some(&old)).admits_key(&order(&old, &message)),
        Some(public)
    );
    assert_eq!(trust(Some(&old)).admits_key(&order(&other, &message)), None);
    assert_eq!(trust(Some(&old)).admits_key(&order(&new, &message)), None);
    assert_eq!(
        trust(Some(&old)).admits_key(&order(&old, &public)),
        None,
        "without the domain"
    );
    assert_eq!(
        trust(None).admits_key(&[0; KEY_LENGTH]),
        None,
        "a key of small order"
    );
}

proptest! {
    #[test]
    fn random_signatures_are_judged_as_by_another_library(
        seed: [u8; 32],
        message in proptest::collection::vec(any::<u8>(), 0..300),
        place in 0..96_usize,
        bit in 0..8_u8,
    ) {
        let secret = SigningKey::from_bytes(&seed);
        let mut key = secret.verifying_key().to_bytes();
        let mut signature = secret.sign(&message).to_bytes();
        prop_assert!(is_key(&key));
        prop_assert!(verify(&key, &message, &signature));
        let flipped = key.iter_mut().chain(&mut signature).nth(place);
        *flipped.unwrap() ^= 1 << bit;
        let other = VerifyingKey::from_bytes(&key);
        prop_assert_eq!(is_key(&key), other.is_ok());
        let judged = other.is_ok_and(|other| {
            other.verify_strict(&message, &Signature::from_bytes(&signature)).is_ok()
        });
        prop_assert_eq!(verify(&key, &message, &signature), judged);
        prop_assert!(!judged);
    }
}
