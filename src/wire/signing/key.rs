//! The secret that both ends share.

use std::fmt;

use sha2::{Digest, Sha256};
use zeroize::{Zeroize, ZeroizeOnDrop, Zeroizing};

/// Bytes of a key.
pub(super) const KEY_LEN: usize = 32;

/// A key of 32 bytes. Its memory is cleared when it is dropped, and it is never printed.
#[derive(Clone, Zeroize, ZeroizeOnDrop)]
pub struct SigningKey {
    bytes: [u8; KEY_LEN],
}

/// Why a text is no key.
#[derive(Clone, Copy, Debug, PartialEq, Eq, thiserror::Error)]
pub enum KeyError {
    /// Neither 32 bytes nor 64 hexadecimal digits.
    #[error("is neither 64 hexadecimal digits nor 32 bytes")]
    NoKey,
    /// 32 letters: nobody's random bytes.
    #[error("is text of 32 characters: a passphrase is made a key by `holdover key import`")]
    Passphrase,
    /// Nothing.
    #[error("is empty")]
    Empty,
    /// Random bytes are not to be had.
    #[error("the system gives no random bytes")]
    NoRandomness,
}

impl SigningKey {
    /// These bytes.
    pub fn new(bytes: [u8; KEY_LEN]) -> Self {
        Self { bytes }
    }

    /// A new one of the system's random bytes.
    ///
    /// # Errors
    /// [`KeyError::NoRandomness`].
    pub fn random() -> Result<Self, KeyError> {
        let mut key = Self { bytes: [0; KEY_LEN] };
        getrandom::fill(&mut key.bytes).map_err(|_| KeyError::NoRandomness)?;
        Ok(key)
    }

    /// What MAVProxy, QGroundControl and Mission Planner make of a passphrase: its SHA-256.
    pub fn from_passphrase(passphrase: &[u8]) -> Self {
        let mut key = Self { bytes: [0; KEY_LEN] };
        key.bytes.copy_from_slice(&Zeroizing::new(<[u8; KEY_LEN]>::from(Sha256::digest(passphrase)))[..]);
        key
    }

    /// The content of a key file: 64 hexadecimal digits, with white space around them, or 32 bytes.
    ///
    /// # Errors
    /// [`KeyError`].
    pub fn parse(content: &[u8]) -> Result<Self, KeyError> {
        if let Some(key) = Self::from_hex(content.trim_ascii()) {
            return Ok(key);
        }
        match <[u8; KEY_LEN]>::try_from(content) {
            Ok(bytes) if bytes.iter().all(|b| b.is_ascii_graphic() || *b == b' ') => {
                Err(KeyError::Passphrase)
            }
            Ok(bytes) => Ok(Self { bytes }),
            Err(_) if content.trim_ascii().is_empty() => Err(KeyError::Empty),
            Err(_) => Err(KeyError::NoKey),
        }
    }

    /// 64 hexadecimal digits.
    pub(super) fn from_hex(text: &[u8]) -> Option<Self> {
        let mut key = Self { bytes: [0; KEY_LEN] };
        if text.len() != 2 * KEY_LEN {
            return None;
        }
        for (byte, digits) in key.bytes.iter_mut().zip(text.chunks_exact(2)) {
            *byte = digits.iter().try_fold(0, |n, d| Some(n << 4 | char::from(*d).to_digit(16)? as u8))?;
        }
        Some(key)
    }

    /// 64 hexadecimal digits and a line's end, as a key file holds them.
    pub(super) fn to_hex(&self) -> Zeroizing<String> {
        let mut text = Zeroizing::new(String::with_capacity(2 * KEY_LEN + 1));
        for nibble in self.bytes.iter().flat_map(|b| [b >> 4, b & 15]) {
            text.push(char::from_digit(u32::from(nibble), 16).unwrap_or('0'));
        }
        text.push('\n');
        text
    }

    /// The bytes, for who signs with them.
    pub(super) fn bytes(&self) -> &[u8; KEY_LEN] {
        &self.bytes
    }

    /// Eight hexadecimal digits by which two keys can be told apart, and from which nothing follows about the key.
    pub fn id(&self) -> String {
        let digest =
            Sha256::new().chain_update(b"holdover signing key id\0").chain_update(self.bytes).finalize();
        digest.iter().take(4).map(|b| format!("{b:02x}")).collect()
    }
}

impl fmt::Debug for SigningKey {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "SigningKey({})", self.id())
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    #[test]
    fn a_passphrase_becomes_what_ground_stations_make_of_it() {
        // hashlib.sha256(b"abc").hexdigest()
        let key = SigningKey::from_passphrase(b"abc");
        assert_eq!(
            key.to_hex().as_str(),
            "ba7816bf8f01cfea414140de5dae2223b00361a396177a9cb410ff61f20015ad\n"
        );
    }

    #[test]
    fn a_key_is_never_printed() {
        let key = SigningKey::new([0x5A; KEY_LEN]);
        let shown = format!("{key:?} {}", key.id());
        assert!(!shown.contains("5a5a") && !shown.contains("90, 90") && key.id().len() == 8, "{shown}");
        assert_ne!(key.id(), SigningKey::new([0x5B; KEY_LEN]).id());
        assert_ne!(SigningKey::random().unwrap().id(), SigningKey::random().unwrap().id());
    }

    #[test]
    fn what_is_no_key_is_told_from_what_is() {
        let wrong = |content: &[u8]| SigningKey::parse(content).err();
        assert_eq!(wrong(b" \n"), Some(KeyError::Empty));
        assert_eq!(wrong(b"hunter2"), Some(KeyError::NoKey));
        assert_eq!(wrong(b"a passphrase of 32 characters it"), Some(KeyError::Passphrase));
        assert_eq!(wrong(&[b'g'; 64]), Some(KeyError::NoKey));
        assert!(SigningKey::parse(&[200; 32]).is_ok());
    }

    proptest! {
        #[test]
        fn hexadecimal_and_bytes_are_the_same_key(bytes: [u8; 32]) {
            let key = SigningKey::new(bytes);
            let parsed = SigningKey::parse(key.to_hex().as_bytes()).unwrap();
            prop_assert_eq!(parsed.bytes(), &bytes);
            let upper = SigningKey::parse(key.to_hex().to_uppercase().as_bytes()).unwrap();
            prop_assert_eq!(upper.bytes(), &bytes);
        }
    }
}
