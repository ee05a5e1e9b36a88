//! The last 13 bytes of a signed frame: link id, stamp and 48 bits of a digest.

use sha2::{Digest, Sha256};
use subtle::ConstantTimeEq;

use super::key::SigningKey;
use crate::wire::frame::{Frame, extra_crc};
use crate::wire::frame_bytes::FrameBytes;

/// Bytes of a signature, and of the digest at its end.
const SIGNATURE_LEN: usize = 13;
const DIGEST_LEN: usize = 6;
/// Bytes of a MAVLink 2 header, and of the checksum behind the payload.
const HEADER_LEN: usize = 10;
const CHECKSUM_LEN: usize = 2;
/// The bit of the incompatibility flags (byte 2) that says that a signature follows.
const SIGNED: u8 = 0x01;

/// A signature's stamp: 10 µs since the first of January 2015, 48 bits.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, PartialOrd, Ord)]
pub struct SigningStamp(pub u64);

impl SigningStamp {
    /// The greatest that a frame can carry, in 2104.
    pub const LAST: Self = Self((1 << 48) - 1);
    /// So many a second.
    pub const PER_SECOND: u64 = 100_000;
    /// The first of January 2015, µs since 1970.
    const EPOCH_UNIX_US: i64 = 1_420_070_400_000_000;

    /// Of a time of day, µs since 1970; before 2015 it is 0.
    pub fn of_unix_us(unix_us: i64) -> Self {
        let since_us = unix_us.saturating_sub(Self::EPOCH_UNIX_US).max(0);
        Self(since_us.unsigned_abs() / 10).min(Self::LAST)
    }

    /// So much later.
    pub(super) fn after(self, units: u64) -> Self {
        Self(self.0.saturating_add(units)).min(Self::LAST)
    }
}

/// What a signed frame carries behind its checksum.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) struct Signature {
    pub(super) link_id: u8,
    pub(super) stamp: SigningStamp,
    digest: [u8; DIGEST_LEN],
}

impl Signature {
    /// That of a frame; `None` where it carries none.
    pub(super) fn of(frame: &Frame<'_>) -> Option<Self> {
        if !frame.is_signed() {
            return None;
        }
        let bytes = frame.bytes();
        let [link_id, t0, t1, t2, t3, t4, t5, digest @ ..] = bytes.last_chunk::<SIGNATURE_LEN>()?;
        let stamp = SigningStamp(u64::from_le_bytes([*t0, *t1, *t2, *t3, *t4, *t5, 0, 0]));
        Some(Self { link_id: *link_id, stamp, digest: *digest })
    }

    /// Whether it is that of `frame`, which carries it, by this key. Takes the same time whatever differs.
    pub(super) fn fits(&self, frame: &Frame<'_>, key: &SigningKey) -> bool {
        let signed = frame.bytes().len() - DIGEST_LEN;
        digest(key, &frame.bytes()[..signed]).ct_eq(&self.digest).into()
    }
}

/// The first 48 bits of SHA-256 over the key and what is signed.
fn digest(key: &SigningKey, signed: &[u8]) -> [u8; DIGEST_LEN] {
    let full: [u8; 32] = Sha256::new().chain_update(key.bytes()).chain_update(signed).finalize().into();
    let mut first = [0; DIGEST_LEN];
    first.copy_from_slice(&full[..DIGEST_LEN]);
    first
}

/// A frame with a signature. `None` of one that cannot carry it: of MAVLink 1, signed already, or with a message whose checksum is
/// not known here.
pub(super) fn signed(
    frame: &FrameBytes,
    key: &SigningKey,
    link_id: u8,
    stamp: SigningStamp,
) -> Option<FrameBytes> {
    let whole = frame.frame()?;
    let extra = extra_crc(whole.message_id())?;
    if whole.is_mavlink1() || whole.is_signed() {
        return None;
    }
    let mut bytes = [0; crate::wire::frame::MAX_FRAME_LEN];
    let end = frame.len();
    bytes.get_mut(..end)?.copy_from_slice(frame);
    bytes[2] |= SIGNED;
    // The flag is under the checksum.
    let payload_end = HEADER_LEN + usize::from(bytes[1]);
    let checksum = mavlink::calculate_crc(&bytes[1..payload_end], extra);
    bytes[payload_end..payload_end + CHECKSUM_LEN].copy_from_slice(&checksum.to_le_bytes());
    let digest_at = end + SIGNATURE_LEN - DIGEST_LEN;
    bytes.get_mut(end..digest_at)?.copy_from_slice(&stamp_bytes(link_id, stamp));
    let digest = digest(key, &bytes[..digest_at]);
    bytes.get_mut(digest_at..digest_at + DIGEST_LEN)?.copy_from_slice(&digest);
    FrameBytes::new(&bytes[..digest_at + DIGEST_LEN])
}

fn stamp_bytes(link_id: u8, stamp: SigningStamp) -> [u8; SIGNATURE_LEN - DIGEST_LEN] {
    let [t0, t1, t2, t3, t4, t5, ..] = stamp.0.to_le_bytes();
    [link_id, t0, t1, t2, t3, t4, t5]
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::wire::frame::{ComponentId, Scan, SystemId, scan};
    use crate::wire::session::Address;
    use crate::wire::session::heartbeat::{SystemStatus, heartbeat};
    use crate::wire::session::outgoing::FrameWriter;
    use proptest::prelude::*;

    fn beat() -> FrameBytes {
        let from = Address { system: SystemId(1), component: ComponentId::ODOMETRY_SOURCE };
        FrameWriter::new(from).write(&heartbeat(SystemStatus::Active, 3)).unwrap()
    }

    #[test]
    fn stamps_count_from_2015() {
        assert_eq!(SigningStamp::of_unix_us(1_420_070_401_000_000), SigningStamp(SigningStamp::PER_SECOND));
        assert_eq!(SigningStamp::of_unix_us(0), SigningStamp(0));
        assert_eq!(SigningStamp::of_unix_us(i64::MIN), SigningStamp(0));
        assert_eq!(SigningStamp::of_unix_us(i64::MAX), SigningStamp::LAST);
        assert_eq!(SigningStamp::LAST.after(9), SigningStamp::LAST);
    }

    #[test]
    fn a_signed_frame_is_a_frame_with_a_signature_that_fits() {
        let key = SigningKey::new([9; 32]);
        let bytes = signed(&beat(), &key, 7, SigningStamp(0x0102_0304_0506)).unwrap();
        let Scan::Frame(frame) = scan(&bytes, true) else { panic!("the checksum is wrong") };
        let signature = Signature::of(&frame).unwrap();
        assert_eq!((signature.link_id, signature.stamp.0), (7, 0x0102_0304_0506));
        assert!(signature.fits(&frame, &key));
        assert!(!signature.fits(&frame, &SigningKey::new([8; 32])));
        assert_eq!(signed(&bytes, &key, 7, SigningStamp(1)), None, "not twice");
        let unsigned = beat();
        assert_eq!(Signature::of(&unsigned.frame().unwrap()), None);
    }

    proptest! {
        /// Every byte is under the signature or is the signature.
        #[test]
        fn no_byte_can_be_altered(at in 0usize..1000, change in 1u8..) {
            let key = SigningKey::new([9; 32]);
            let mut bytes = signed(&beat(), &key, 7, SigningStamp(77)).unwrap().to_vec();
            let at = at % bytes.len();
            bytes[at] ^= change;
            let altered = FrameBytes::new(&bytes).unwrap();
            if let Some(frame) = altered.frame().filter(|f| f.bytes().len() == bytes.len())
                && let Some(signature) = Signature::of(&frame)
            {
                prop_assert!(!signature.fits(&frame, &key));
            }
        }
    }
}
