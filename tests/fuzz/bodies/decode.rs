//! Messages with any content: what comes out of the decoder is numbers.

use holdover::sample::Input;
use holdover::time::Stamp;
use holdover::wire::decode::Decoder;
use holdover::wire::frame::{Scan, scan};
use holdover::wire::frame_bytes::FrameBytes;
use holdover::wire::session::identity::{Identity, IdentityConfig};
use mavlink::Message;
use mavlink::dialects::ardupilotmega::MavMessage;

/// The decoder takes every frame of the bytes; checksums are put right, since guessing them is not what is tried.
pub fn decode(bytes: &[u8]) -> u64 {
    let mut identity = Identity::new(IdentityConfig::default());
    let mut decoder = Decoder::new();
    let (mut inputs, mut frames) = (Vec::new(), 1);
    each_with_checksum(bytes, |bytes| {
        let Some(frame) = bytes.frame() else { return };
        let known = identity.vehicle().is_some();
        identity.hear(Stamp::from_micros(frames as i64 * 10_000), &frame);
        if let (false, Some(vehicle)) = (known, identity.vehicle()) {
            decoder.follow(vehicle);
        }
        inputs.clear();
        decoder.decode(&frame, None, &mut inputs);
        decoder.decode_sensor(&frame, &mut inputs);
        inputs.iter().for_each(check);
        frames += 1;
    });
    frames
}

/// What is not a number would be read by a filter as one.
fn check(input: &Input) {
    let text = format!("{input:?}");
    let words = text.split(|c: char| !c.is_alphanumeric());
    assert!(words.into_iter().all(|w| w != "NaN" && w != "inf"), "{text}");
}

/// Calls `take` with what is long enough for a frame, with the checksum that it needs.
pub fn each_with_checksum(bytes: &[u8], mut take: impl FnMut(FrameBytes)) {
    let mut rest = bytes;
    while let Some(start) = rest.iter().position(|b| matches!(b, 0xFE | 0xFD)) {
        rest = &rest[start..];
        let Some((mut frame, len)) = candidate(rest) else {
            rest = &rest[1..];
            continue;
        };
        put_right(&mut frame);
        if let (Some(bytes), Scan::Frame(_)) = (FrameBytes::new(&frame), scan(&frame, true)) {
            take(bytes);
        }
        rest = &rest[len..];
    }
}

/// The bytes that the header at their start claims, without flags that mean nothing here.
fn candidate(bytes: &[u8]) -> Option<(Vec<u8>, usize)> {
    let payload = usize::from(*bytes.get(1)?);
    let len = payload + if bytes[0] == 0xFE { 8 } else { 12 };
    let mut frame = bytes.get(..len)?.to_vec();
    if frame[0] == 0xFD {
        frame[2] = 0;
    }
    Some((frame, len))
}

/// Gives a frame the checksum that its message needs.
pub fn put_right(frame: &mut [u8]) {
    let v1 = frame[0] == 0xFE;
    let id = if v1 { u32::from(frame[5]) } else { u32::from_le_bytes([frame[7], frame[8], frame[9], 0]) };
    let end = usize::from(frame[1]) + if v1 { 6 } else { 10 };
    let checksum = mavlink::calculate_crc(&frame[1..end], MavMessage::extra_crc(id));
    frame[end..end + 2].copy_from_slice(&checksum.to_le_bytes());
}
