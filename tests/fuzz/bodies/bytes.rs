//! Bytes of a link and of telemetry logs, signed or not.

use holdover::wire::frame::Frame;
use holdover::wire::frame_bytes::FrameBytes;
use holdover::wire::link::{Deframer, Found};
use holdover::wire::signing::{SigningGate, SigningKey, SigningSettings};
use holdover::wire::tlog::TlogReader;

/// Frames of a stream that comes in pieces of the size that the first byte says: they are those of the stream in large pieces, each with a
/// checksum that fits.
pub fn deframer(input: &[u8]) -> u64 {
    let Some((&size, bytes)) = input.split_first() else { return 1 };
    let (mut small, mut large) = (Vec::new(), Vec::new());
    read(bytes, 1 + usize::from(size), |found| small.extend(known(found)));
    read(bytes, usize::MAX, |found| large.extend(known(found)));
    assert!(small == large, "a stream holds other frames in pieces");
    1 + large.len() as u64
}

/// Reads a stream in pieces.
fn read(bytes: &[u8], size: usize, mut each: impl FnMut(Found<'_>)) {
    let mut deframer = Deframer::new();
    let mut rest = bytes;
    while !rest.is_empty() {
        let space = deframer.space();
        let n = size.min(rest.len()).min(space.len());
        space[..n].copy_from_slice(&rest[..n]);
        rest = &rest[n..];
        deframer.advance(n, &mut each);
    }
}

fn known(found: Found<'_>) -> Option<FrameBytes> {
    let Found::Frame(frame) = found else { return None };
    assert!(frame.checksum_fits());
    FrameBytes::new(frame.bytes())
}

/// A telemetry log is read to its end, whatever is in it.
pub fn tlog(bytes: &[u8]) -> u64 {
    let mut read = 1;
    for mut reader in [TlogReader::new(bytes), TlogReader::without_stamps(bytes)] {
        while let Ok(Some(record)) = reader.next_record() {
            assert!(!record.frame.known() || record.frame.checksum_fits());
            read += 1;
        }
        assert_eq!(reader.position(), bytes.len() as u64);
    }
    read
}

/// Some time in 2026, µs since 1970.
const NOW_US: i64 = 1_790_000_000_000_000;

/// Nothing passes a gate that its key has not signed, and what it has signed passes once. The bytes are frames as they are, and frames signed with
/// the right key that the bytes alter.
pub fn signing(input: &[u8]) -> u64 {
    let key = || SigningKey::new([0x42; 32]);
    let gate = SigningGate::new(Some(key()), &SigningSettings::default());
    let mut passed = 1;
    each_frame(input, |frame| {
        assert!(gate.admit(frame, false, NOW_US).is_err(), "a frame that nobody signed");
        passed += 1;
    });
    let theirs = SigningGate::new(Some(key()), &SigningSettings::default());
    let beat = [0xFD, 9, 0, 0, 1, 1, 1, 0, 0, 0, 0, 0, 0, 0, 2, 3, 81, 3, 3, 0, 0];
    for change in input.chunks_exact(2).take(64) {
        let Some(signed) = FrameBytes::new(&beat).and_then(|b| theirs.sign(b, 0, NOW_US)) else { continue };
        let mut altered = signed.to_vec();
        let at = usize::from(change[0]) % altered.len();
        altered[at] ^= change[1];
        let altered = FrameBytes::new(&altered);
        if let Some(frame) = altered.as_ref().and_then(FrameBytes::frame) {
            assert_eq!(gate.admit(&frame, false, NOW_US).is_ok(), change[1] == 0, "{at} {}", change[1]);
            passed += 1;
        }
        if let Some(frame) = signed.frame() {
            assert_eq!(gate.admit(&frame, false, NOW_US).is_ok(), change[1] != 0, "once, and once only");
        }
    }
    let _ = SigningKey::parse(input).map(|key| assert_eq!(key.id().len(), 8));
    passed
}

/// Calls `take` with whatever looks like a frame.
fn each_frame(bytes: &[u8], mut take: impl FnMut(&Frame<'_>)) {
    read(bytes, usize::MAX, |found| match found {
        Found::Frame(frame) | Found::Unknown(frame) => take(&frame),
        Found::Reject { .. } | Found::Unsearched(_) => {}
    });
}
