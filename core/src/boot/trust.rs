//! Which images a controller accepts: its product, its hardware, no older than it has seen, and signed once
//! a key is installed.

use embedded_storage::nor_flash::NorFlash;

use super::image::Header;
use super::slots::Slot;
use crate::management::vendor::CommandCode;

/// Bytes of an Ed25519 public key (RFC 8032).
pub const KEY_LENGTH: usize = 32;
/// Bytes of an order to replace the installed key: the new key and its signature by the installed one.
pub const SIGNED_KEY_LENGTH: usize = KEY_LENGTH + super::image::SIGNATURE_LENGTH;
/// Keeps the signature of a key from being taken for one over an image.
pub const KEY_DOMAIN: [u8; 16] = *b"windlass key 1\0\0";

/// An Ed25519 public key.
pub type Key = [u8; KEY_LENGTH];

/// What a controller asks of an image.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Trust {
    /// Product id.
    pub product: u32,
    /// Hardware id.
    pub hardware: u32,
    /// Smallest anti-rollback counter.
    pub rollback: u32,
    /// The key that must have signed it, if one is installed.
    pub key: Option<Key>,
}

impl Trust {
    /// That of a controller which has seen nothing yet.
    #[must_use]
    pub const fn new(product: u32, hardware: u32) -> Self {
        Self {
            product,
            hardware,
            rollback: 0,
            key: None,
        }
    }

    /// Judges an image by its header, before anything is written. `room` are the pages that the slot has.
    ///
    /// # Errors
    /// The result code of the first thing that is wrong: `WrongProduct`, `WrongHardware`,
    /// `RollbackRefused`, or `BadSignature` if a signature is asked for and there is none.
    pub const fn admits(&self, header: &Header, room: u32) -> Result<(), CommandCode> {
        let identity = &header.identity;
        if identity.product != self.product {
            return Err(CommandCode::WrongProduct);
        }
        if identity.hardware != self.hardware || header.pages & !room != 0 {
            return Err(CommandCode::WrongHardware);
        }
        if identity.rollback < self.rollback {
            return Err(CommandCode::RollbackRefused);
        }
        if self.key.is_some() && !header.signed {
            return Err(CommandCode::BadSignature);
        }
        Ok(())
    }

    /// Judges an order to install a key: free while none is installed, else signed by the installed one.
    #[must_use]
    pub fn admits_key(&self, order: &[u8]) -> Option<Key> {
        let key = order.first_chunk::<KEY_LENGTH>()?;
        let rest = order.get(KEY_LENGTH..)?;
        let admitted = match &self.key {
            None => rest.is_empty(),
            Some(present) => {
                cfg!(feature = "signed") && signature::is_by(present, &key_message(key), rest)
            }
        };
        (admitted && signature::is_key(key)).then_some(*key)
    }
}

/// What is signed to replace a key.
#[must_use]
pub fn key_message(key: &Key) -> [u8; 48] {
    let mut message = [0; 48];
    for (to, from) in message.iter_mut().zip(KEY_DOMAIN.iter().chain(key)) {
        *to = *from;
    }
    message
}

/// True if no key is installed or the stored image carries its signature.
pub(super) fn is_trusted<F: NorFlash>(slot: &mut Slot<F>, header: &Header, trust: &Trust) -> bool {
    match &trust.key {
        None => true,
        Some(key) => signature::covers(slot, header, key),
    }
}

#[cfg(feature = "signed")]
mod signature {
    use embedded_storage::nor_flash::NorFlash;

    use super::Key;
    pub(super) use crate::boot::ed25519::is_key;
    use crate::boot::ed25519::{Digest, Sha512, verify as is_signature};
    use crate::boot::image::{Header, signed_message, verify};
    use crate::boot::slots::Slot;

    /// True if `key` has signed the image in the slot. Neither inlined nor one with [`digest`]: hash and points of the
    /// curve need not be on the stack together.
    #[inline(never)]
    pub(super) fn covers<F: NorFlash>(slot: &mut Slot<F>, header: &Header, key: &Key) -> bool {
        let (Some(signature), Some(digest)) = (slot.signature(), digest(slot, header)) else {
            return false;
        };
        is_signature(key, &signed_message(header, &digest), &signature)
    }

    /// The digest of the image in the slot, if it is whole.
    #[inline(never)]
    fn digest<F: NorFlash>(slot: &mut Slot<F>, header: &Header) -> Option<[u8; 64]> {
        let mut hash = Sha512::new();
        let is_whole = verify(slot, |bytes| hash.update(bytes)) == Ok(*header);
        is_whole.then(|| hash.finalize().into())
    }

    /// True if `key` has made the signature of the message.
    pub(super) fn is_by(key: &Key, message: &[u8], signature: &[u8]) -> bool {
        signature
            .try_into()
            .is_ok_and(|signature| is_signature(key, message, signature))
    }
}

#[cfg(not(feature = "signed"))]
mod signature {
    //! This build knows no signatures: with a key installed it accepts nothing, and it installs none.

    use embedded_storage::nor_flash::NorFlash;

    use super::Key;
    use crate::boot::image::Header;
    use crate::boot::slots::Slot;

    pub(super) fn covers<F: NorFlash>(_: &mut Slot<F>, _: &Header, _: &Key) -> bool {
        false
    }

    pub(super) fn is_by(_: &Key, _: &[u8], _: &[u8]) -> bool {
        false
    }

    pub(super) fn is_key(_: &Key) -> bool {
        false
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::boot::image::Identity;

    const TRUST: Trust = Trust {
        product: 1,
        hardware: 2,
        rollback: 3,
        key: None,
    };
    const HEADER: Header = Header {
        identity: Identity {
            product: 1,
            hardware: 2,
            version: 0x0100,
            rollback: 3,
        },
        pages: 0b11,
        image_crc: 0,
        signed: false,
    };

    #[test]
    fn a_header_is_refused_for_the_first_thing_that_is_wrong() {
        let judge = |change: fn(&mut Header, &mut Trust)| {
            let (mut header, mut trust) = (HEADER, TRUST);
            change(&mut header, &mut trust);
            trust.admits(&header, 0b111)
        };
        assert_eq!(judge(|_, _| ()), Ok(()));
        assert_eq!(judge(|header, _| header.identity.rollback = 4), Ok(()));
        assert_eq!(
            judge(|header, _| header.identity.product = 0),
            Err(CommandCode::WrongProduct)
        );
        assert_eq!(
            judge(|header, _| header.identity.hardware = 0),
            Err(CommandCode::WrongHardware)
        );
        assert_eq!(
            judge(|header, _| header.pages = 0b1001),
            Err(CommandCode::WrongHardware)
        );
        assert_eq!(
            judge(|header, _| header.identity.rollback = 2),
            Err(CommandCode::RollbackRefused)
        );
        assert_eq!(
            judge(|_, trust| trust.key = Some([0; KEY_LENGTH])),
            Err(CommandCode::BadSignature)
        );
        assert_eq!(
            judge(|header, trust| {
                trust.key = Some([0; KEY_LENGTH]);
                header.signed = true;
            }),
            Ok(()),
            "whether it is a good one is known when the image is whole"
        );
    }
}
