//! Zstandard, frame by frame, with what damage leaves of one.
//!
//! A frame may refer to all of its window, and a decoder gives out what it has unpacked only when it lies farther back than that: of a log whose
//! end is missing, up to 8 MiB in front of the damage (all of a small one) would never be seen. So a frame that cannot be unpacked any further is
//! closed where it is, and what is left of it is given out before the error is.
//!
//! Format: RFC 8878.

use std::io::{self, BufRead, ErrorKind, Read};

use ruzstd::decoding::{BlockDecodingStrategy, FrameDecoder, StreamingDecoder};

/// The most that unpacking may keep of the past, bytes: `zstd --ultra -22` wants 128 MiB of long files, `-19` 8 MiB.
const MOST_WINDOW: u64 = 32 << 20;
/// The longest header of a frame.
const HEADER: usize = 18;
/// An empty block of raw bytes that is the last of its frame, and a checksum that is not looked at.
const LAST_BLOCK: &[u8] = &[1, 0, 0, 0, 0, 0, 0];

/// A file: one frame after the other.
pub(super) struct Frames<R: BufRead> {
    state: FrameState<R>,
}

enum FrameState<R: BufRead> {
    Between(R),
    Within(Box<StreamingDecoder<R, FrameDecoder>>),
    /// What is left of a frame that cannot be unpacked any further, and why.
    Broken(Box<FrameDecoder>, io::Error),
    Ended,
}

impl<R: BufRead> Frames<R> {
    /// What is packed in `packed`, which begins with a frame.
    pub(super) fn new(packed: R) -> Self {
        Self { state: FrameState::Between(packed) }
    }
}

impl<R: BufRead> Read for Frames<R> {
    fn read(&mut self, to: &mut [u8]) -> io::Result<usize> {
        loop {
            match std::mem::replace(&mut self.state, FrameState::Ended) {
                FrameState::Ended => return Ok(0),
                FrameState::Between(packed) => match begun(packed)? {
                    Some(frame) => self.state = FrameState::Within(Box::new(frame)),
                    None => return Ok(0),
                },
                FrameState::Within(mut frame) => {
                    let n = match frame.read(to) {
                        Ok(n) => n,
                        Err(e) => {
                            self.state = broken(*frame, e);
                            continue;
                        }
                    };
                    self.state = if n == 0 && !to.is_empty() {
                        FrameState::Between(frame.into_inner())
                    } else {
                        FrameState::Within(frame)
                    };
                    if n > 0 || to.is_empty() {
                        return Ok(n);
                    }
                }
                FrameState::Broken(mut rest, why) => {
                    let n = rest.read(to)?;
                    if n == 0 && !to.is_empty() {
                        return Err(why);
                    }
                    self.state = FrameState::Broken(rest, why);
                    return Ok(n);
                }
            }
        }
    }
}

/// The next frame, if there is one.
fn begun<R: BufRead>(mut packed: R) -> io::Result<Option<StreamingDecoder<R, FrameDecoder>>> {
    let first = packed.fill_buf()?;
    if first.is_empty() {
        return Ok(None);
    }
    if window(first).is_some_and(|w| w > MOST_WINDOW) {
        return Err(io::Error::other(format!(
            "unpacking it takes a window of more than {} MiB",
            MOST_WINDOW >> 20
        )));
    }
    StreamingDecoder::new(packed).map(Some).map_err(io::Error::other)
}

/// Closes a frame behind the last block that could be unpacked.
fn broken<R: BufRead>(frame: StreamingDecoder<R, FrameDecoder>, error: io::Error) -> FrameState<R> {
    let (mut packed, mut decoder) = frame.into_parts();
    let cut_off = packed.fill_buf().is_ok_and(<[u8]>::is_empty);
    let why = if cut_off { ErrorKind::UnexpectedEof.into() } else { error };
    // What the decoder says of this block is no news: without it there is nothing left to give out.
    let _ = decoder.decode_blocks(LAST_BLOCK, BlockDecodingStrategy::UptoBlocks(1));
    FrameState::Broken(Box::new(decoder), why)
}

/// The past that a frame may refer to, bytes (3.1.1.1): of the window descriptor, or the whole content.
fn window(frame: &[u8]) -> Option<u64> {
    let header = frame.get(4..frame.len().min(HEADER))?;
    let (&descriptor, rest) = header.split_first()?;
    if descriptor & 0x20 == 0 {
        let w = *rest.first()?;
        let base = 1u64 << (10 + u64::from(w >> 3));
        return Some(base + base / 8 * u64::from(w & 7));
    }
    let dictionary = [0, 1, 2, 4][usize::from(descriptor & 3)];
    let (bytes, more) = [(1, 0), (2, 256), (4, 0), (8, 0)][usize::from(descriptor >> 6)];
    let size = rest.get(dictionary..dictionary + bytes)?;
    Some(size.iter().rev().fold(0u64, |n, &b| n << 8 | u64::from(b)).saturating_add(more))
}
