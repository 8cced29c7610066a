//! Keys that sign images: Ed25519, one text file each.
//!
//! A key file has two lines: what it is, and 32 bytes as 64 hexadecimal digits. The signing key is the
//! secret of RFC 8032, section 5.1.5; it is readable by its owner only and never printed.

use std::fs::{self, OpenOptions};
use std::io::{self, Write};
use std::path::{Path, PathBuf};

use ed25519_dalek::{Signature, Signer, SigningKey, VerifyingKey};
use windlass_core::boot::trust::key_message;

const SECRET_TITLE: &str = "windlass signing key 1";
const PUBLIC_TITLE: &str = "windlass public key 1";
/// No key file is longer.
const LONGEST_FILE: u64 = 256;

/// Why a key cannot be used or made.
#[derive(Debug, thiserror::Error)]
pub enum KeyError {
    /// The file cannot be read.
    #[error("cannot read the key file {}: {source}", path.display())]
    Read {
        /// Which file.
        path: PathBuf,
        /// What the system says.
        source: io::Error,
    },
    /// The file cannot be written.
    #[error("cannot write the key file {}: {source}", path.display())]
    Write {
        /// Which file.
        path: PathBuf,
        /// What the system says.
        source: io::Error,
    },
    /// There is a file of that name.
    #[error("{} exists already and is not overwritten", path.display())]
    Exists {
        /// Which file.
        path: PathBuf,
    },
    /// Others may read the secret.
    #[error("other users may read the signing key {} (mode {mode:03o})", path.display())]
    Exposed {
        /// Which file.
        path: PathBuf,
        /// Its permissions.
        mode: u32,
    },
    /// The file is no key, or the other half.
    #[error("{} is no {wanted}", path.display())]
    NotAKey {
        /// Which file.
        path: PathBuf,
        /// What was wanted.
        wanted: &'static str,
    },
    /// The system gives no random numbers.
    #[error("the system gives no random numbers: {0}")]
    NoRandom(String),
}

impl KeyError {
    /// What the user can do about it.
    #[must_use]
    pub fn next_step(&self) -> String {
        match self {
            Self::Read { .. } => "check the name; `windlass image keygen NAME` makes a pair of keys".to_owned(),
            Self::Write { .. } => "check that the folder exists and is writable".to_owned(),
            Self::Exists { .. } => {
                "give another name, or move the old key away; devices that hold it accept no other".to_owned()
            }
            Self::Exposed { path, .. } => format!(
                "run `chmod 600 {}`; if somebody may have read it, make a new key",
                path.display()
            ),
            Self::NotAKey { .. } => {
                "signing takes NAME.key, verifying and installing take NAME.pub, as `windlass image keygen` made them".to_owned()
            }
            Self::NoRandom(_) => "run the command on a machine whose system has a random number generator".to_owned(),
        }
    }
}

/// A new pair of keys: `NAME.key` for signing and `NAME.pub` for devices. Neither file may exist.
///
/// # Errors
/// A file exists or cannot be written, or the system gives no random numbers.
pub fn generate(name: &Path) -> Result<(PathBuf, PathBuf, VerifyingKey), KeyError> {
    let secret_path = with_suffix(name, ".key");
    let public_path = with_suffix(name, ".pub");
    if public_path.exists() {
        return Err(KeyError::Exists { path: public_path });
    }
    let mut secret = [0; 32];
    getrandom::fill(&mut secret).map_err(|error| KeyError::NoRandom(error.to_string()))?;
    let key = SigningKey::from_bytes(&secret);
    create(&secret_path, 0o600, SECRET_TITLE, &secret)?;
    let public = key.verifying_key();
    create(&public_path, 0o644, PUBLIC_TITLE, public.as_bytes())?;
    Ok((secret_path, public_path, public))
}

/// Reads a signing key. On Unix its file may be readable by its owner only.
///
/// # Errors
/// The file cannot be read, is no signing key, or others may read it.
pub fn read_secret(path: &Path) -> Result<SigningKey, KeyError> {
    check_permissions(path)?;
    let bytes = read(path, SECRET_TITLE, "signing key")?;
    Ok(SigningKey::from_bytes(&bytes))
}

/// Reads a public key.
///
/// # Errors
/// The file cannot be read or is no public key.
pub fn read_public(path: &Path) -> Result<VerifyingKey, KeyError> {
    let wanted = "public key";
    let bytes = read(path, PUBLIC_TITLE, wanted)?;
    let not_a_key = |_| KeyError::NotAKey {
        path: path.to_owned(),
        wanted,
    };
    let key = VerifyingKey::from_bytes(&bytes).map_err(not_a_key)?;
    if key.is_weak() {
        let path = path.to_owned();
        return Err(KeyError::NotAKey { path, wanted });
    }
    Ok(key)
}

/// Signs a message.
#[must_use]
pub fn sign(key: &SigningKey, message: &[u8]) -> [u8; 64] {
    key.sign(message).to_bytes()
}

/// Whether the signature is that of the message under this key, by the strict rules (no small-order
/// points, so that one signature fits one message and key only).
#[must_use]
pub fn verify(key: &VerifyingKey, message: &[u8], signature: &[u8; 64]) -> bool {
    key.verify_strict(message, &Signature::from_bytes(signature))
        .is_ok()
}

/// What a device is sent to install a key: the key, and if it replaces another one, that one's signature.
#[must_use]
pub fn install_order(key: &VerifyingKey, replaces: Option<&SigningKey>) -> Vec<u8> {
    let mut order = key.as_bytes().to_vec();
    if let Some(old) = replaces {
        order.extend(sign(old, &key_message(key.as_bytes())));
    }
    order
}

/// The first eight bytes of a public key as hexadecimal digits, to tell keys apart.
#[must_use]
pub fn fingerprint(key: &VerifyingKey) -> String {
    hex(key.as_bytes().get(..8).unwrap_or_default())
}

fn with_suffix(name: &Path, suffix: &str) -> PathBuf {
    let mut full = name.as_os_str().to_owned();
    full.push(suffix);
    PathBuf::from(full)
}

fn hex(bytes: &[u8]) -> String {
    bytes.iter().map(|byte| format!("{byte:02x}")).collect()
}

fn create(path: &Path, mode: u32, title: &str, key: &[u8; 32]) -> Result<(), KeyError> {
    let mut options = OpenOptions::new();
    options.write(true).create_new(true);
    #[cfg(unix)]
    std::os::unix::fs::OpenOptionsExt::mode(&mut options, mode);
    #[cfg(not(unix))]
    let _ = mode;
    let failed = |source: io::Error| match source.kind() {
        io::ErrorKind::AlreadyExists => KeyError::Exists {
            path: path.to_owned(),
        },
        _ => KeyError::Write {
            path: path.to_owned(),
            source,
        },
    };
    let mut file = options.open(path).map_err(failed)?;
    file.write_all(format!("{title}\n{}\n", hex(key)).as_bytes())
        .and_then(|()| file.sync_all())
        .map_err(failed)
}

#[cfg(unix)]
fn check_permissions(path: &Path) -> Result<(), KeyError> {
    use std::os::unix::fs::PermissionsExt;
    let metadata = fs::metadata(path).map_err(|source| KeyError::Read {
        path: path.to_owned(),
        source,
    })?;
    let mode = metadata.permissions().mode() & 0o777;
    if mode & 0o077 == 0 {
        return Ok(());
    }
    Err(KeyError::Exposed {
        path: path.to_owned(),
        mode,
    })
}

#[cfg(not(unix))]
fn check_permissions(_path: &Path) -> Result<(), KeyError> {
    Ok(())
}

fn read(path: &Path, title: &str, wanted: &'static str) -> Result<[u8; 32], KeyError> {
    let failed = |source| KeyError::Read {
        path: path.to_owned(),
        source,
    };
    let not_a_key = || KeyError::NotAKey {
        path: path.to_owned(),
        wanted,
    };
    if fs::metadata(path).map_err(failed)?.len() > LONGEST_FILE {
        return Err(not_a_key());
    }
    let bytes = fs::read(path).map_err(failed)?;
    let text = String::from_utf8(bytes).map_err(|_| not_a_key())?;
    let mut lines = text.lines();
    if lines.next() != Some(title) {
        return Err(not_a_key());
    }
    lines
        .next()
        .filter(|_| lines.next().is_none())
        .and_then(parse_hex)
        .ok_or_else(not_a_key)
}

fn parse_hex(text: &str) -> Option<[u8; 32]> {
    if text.len() != 64 || !text.bytes().all(|letter| letter.is_ascii_hexdigit()) {
        return None;
    }
    let mut bytes = [0; 32];
    for (index, byte) in bytes.iter_mut().enumerate() {
        *byte = u8::from_str_radix(text.get(2 * index..2 * index + 2)?, 16).ok()?;
    }
    Some(bytes)
}
