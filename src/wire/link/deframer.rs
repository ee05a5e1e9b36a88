//! Finds the frames in a stream of bytes, or in a datagram.

use crate::wire::counters::Cause;
use crate::wire::frame::{Frame, MAX_FRAME_LEN, Scan, scan_by};
use crate::wire::running_crc::RunningCrc;

/// What was found.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Found<'a> {
    /// A frame with a valid checksum.
    Frame(Frame<'a>),
    /// A frame of a message that the dialect does not know.
    Unknown(Frame<'a>),
    /// `n` bytes of garbage, or one damaged frame.
    Reject {
        /// Which of the two.
        cause: Cause,
        /// Bytes, or 1 frame.
        n: u64,
    },
    /// So many bytes were not searched.
    Unsearched(u64),
}

/// Calls `each` for everything in a datagram: the frames that stand one after the other from its start, as all do that well-behaved senders
/// make, and then, if `may_search` allows it for so many bytes, whatever is found behind them.
///
/// `crc` is kept by the caller for its memory.
pub(super) fn deframe(
    datagram: &[u8],
    crc: &mut RunningCrc,
    may_search: impl FnOnce(usize) -> bool,
    mut each: impl FnMut(Found<'_>),
) {
    crc.restart();
    let mut done = 0;
    let rest = loop {
        let Some(rest) = datagram.get(done..).filter(|rest| !rest.is_empty()) else { return };
        let Some((found, n)) = whole(&judge(rest, done as u64, true, crc)) else { break rest };
        each(found);
        done += n;
    };
    if may_search(rest.len()) {
        search(rest, done as u64, true, crc, each);
    } else {
        each(Found::Unsearched(rest.len() as u64));
    }
}

/// What stands at the start of `bytes`, which begin at `at` in a run of bytes.
fn judge<'a>(bytes: &'a [u8], at: u64, at_end: bool, crc: &mut RunningCrc) -> Scan<'a> {
    scan_by(bytes, at_end, |frame, extra| frame.agrees_with(crc, extra, bytes, at, 0))
}

/// The frame that was found there, and its length.
fn whole<'a>(scan: &Scan<'a>) -> Option<(Found<'a>, usize)> {
    match *scan {
        Scan::Frame(frame) => Some((Found::Frame(frame), frame.len())),
        Scan::Unknown(frame) => Some((Found::Unknown(frame), frame.len())),
        Scan::Skip { .. } | Scan::Incomplete => None,
    }
}

/// Calls `each` for everything in `bytes`, which begin at `at` in a run of bytes; returns how many are done with. With `at_end` that is
/// all of them.
///
/// Every byte is judged once as the start of a frame, and a judgement costs the same whatever length is declared.
fn search(
    bytes: &[u8],
    at: u64,
    at_end: bool,
    crc: &mut RunningCrc,
    mut each: impl FnMut(Found<'_>),
) -> usize {
    let mut done = 0;
    while let Some(rest) = bytes.get(done..).filter(|rest| !rest.is_empty()) {
        let scan = judge(rest, at + done as u64, at_end, crc);
        if let Some((found, n)) = whole(&scan) {
            each(found);
            done += n;
            continue;
        }
        done += match scan {
            Scan::Skip { skip, cause } => {
                let n = if cause == Cause::Garbage { skip as u64 } else { 1 };
                each(Found::Reject { cause, n });
                skip
            }
            // What looks like the head of a frame that was cut off may as well be garbage with a frame behind it.
            Scan::Incomplete if at_end => {
                each(Found::Reject { cause: Cause::Garbage, n: 1 });
                1
            }
            _ => break,
        };
    }
    done
}

/// Room for several frames, so that a burst takes few reads.
const CAPACITY: usize = 16 * MAX_FRAME_LEN;

/// A bounded buffer between a stream and the search for frames.
#[derive(Debug)]
pub struct Deframer {
    buffer: Box<[u8]>,
    filled: usize,
    /// How many bytes of the stream are done with.
    done: u64,
    crc: RunningCrc,
}

impl Deframer {
    /// One that has read nothing.
    pub fn new() -> Self {
        let buffer = vec![0; CAPACITY].into_boxed_slice();
        Self { buffer, filled: 0, done: 0, crc: RunningCrc::new() }
    }

    /// Where to read to. Never empty: less than one frame and its successor's first byte stay in the buffer.
    pub fn space(&mut self) -> &mut [u8] {
        &mut self.buffer[self.filled..]
    }

    /// Takes note that `n` bytes were read, and calls `each` for everything that is complete.
    pub fn advance(&mut self, n: usize, each: impl FnMut(Found<'_>)) {
        self.filled = (self.filled + n).min(self.buffer.len());
        let done = search(&self.buffer[..self.filled], self.done, false, &mut self.crc, each);
        self.buffer.copy_within(done..self.filled, 0);
        self.filled -= done;
        self.done += done as u64;
    }
}

impl Default for Deframer {
    fn default() -> Self {
        Self::new()
    }
}

#[cfg(test)]
mod tests {
    use proptest::prelude::*;

    use super::*;
    use crate::wire::frame::{ComponentId, SystemId, scan};
    use crate::wire::session::Address;
    use crate::wire::session::heartbeat::{SystemStatus, heartbeat};
    use crate::wire::session::outgoing::FrameWriter;

    #[derive(Debug, PartialEq, Eq, Clone)]
    enum Owned {
        Frame(Vec<u8>),
        Unknown(Vec<u8>),
        Damaged,
    }

    /// What was found, and the bytes of garbage.
    fn collect(list: &mut Vec<Owned>, garbage: &mut u64, found: Found<'_>) {
        match found {
            Found::Frame(f) => list.push(Owned::Frame(f.bytes().to_vec())),
            Found::Unknown(f) => list.push(Owned::Unknown(f.bytes().to_vec())),
            Found::Reject { cause: Cause::Garbage, n } | Found::Unsearched(n) => *garbage += n,
            Found::Reject { .. } => list.push(Owned::Damaged),
        }
    }

    fn in_chunks(bytes: &[u8], sizes: &[usize]) -> (Vec<Owned>, u64) {
        let (mut list, mut garbage) = (Vec::new(), 0);
        let mut deframer = Deframer::new();
        let mut rest = bytes;
        let mut sizes = sizes.iter().cycle();
        while !rest.is_empty() {
            let space = deframer.space();
            assert!(!space.is_empty());
            let n = sizes.next().copied().unwrap_or(1).clamp(1, rest.len().min(space.len()));
            space[..n].copy_from_slice(&rest[..n]);
            rest = &rest[n..];
            deframer.advance(n, |found| collect(&mut list, &mut garbage, found));
        }
        (list, garbage)
    }

    fn frames(n: u32) -> Vec<Vec<u8>> {
        let from = Address { system: SystemId(1), component: ComponentId(1) };
        let mut writer = FrameWriter::new(from);
        (0..n).map(|i| writer.write(&heartbeat(SystemStatus::Active, i)).unwrap().to_vec()).collect()
    }

    proptest! {
        #[test]
        fn any_chunking_gives_the_frames_between_the_garbage(
            garbage in prop::collection::vec(prop::collection::vec(
                any::<u8>().prop_filter("no start byte", |b| *b != 0xFD && *b != 0xFE), 0..40), 1..30),
            sizes in prop::collection::vec(1usize..700, 1..20),
        ) {
            let valid = frames(garbage.len() as u32);
            let stream: Vec<u8> = garbage.iter().zip(&valid).flat_map(|(g, f)| [g.clone(), f.clone()]).flatten().collect();
            let (list, count) = in_chunks(&stream, &sizes);
            prop_assert_eq!(list, valid.into_iter().map(Owned::Frame).collect::<Vec<_>>());
            prop_assert_eq!(count, garbage.iter().map(|g| g.len() as u64).sum::<u64>());
        }

        #[test]
        fn arbitrary_bytes_give_the_same_in_any_chunking(
            pieces in prop::collection::vec(prop_oneof![
                prop::collection::vec(any::<u8>(), 0..60),
                prop::collection::vec(prop::sample::select(vec![0xFDu8, 0xFE, 0, 1, 9, 255]), 0..60),
                (0usize..8).prop_map(|i| frames(8).swap_remove(i)),
            ], 0..40),
            sizes in prop::collection::vec(1usize..5000, 1..20),
        ) {
            let stream: Vec<u8> = pieces.into_iter().flatten().collect();
            prop_assert_eq!(in_chunks(&stream, &sizes), in_chunks(&stream, &[1]));
        }

        #[test]
        fn a_datagram_is_used_to_its_end(bytes in prop::collection::vec(any::<u8>(), 0..600)) {
            let mut covered = 0;
            deframe(&bytes, &mut RunningCrc::new(), |_| true, |found| covered += match found {
                Found::Frame(f) | Found::Unknown(f) => f.len(),
                // The search goes on at the damaged frame's second byte.
                Found::Reject { cause: Cause::BadChecksum, .. } => 1,
                Found::Reject { n, .. } | Found::Unsearched(n) => n as usize,
            });
            prop_assert_eq!(covered, bytes.len());
        }
    }

    /// What [`scan`] finds, which computes a checksum for every frame that is declared.
    fn plainly(bytes: &[u8]) -> (Vec<Owned>, u64) {
        let (mut list, mut garbage) = (Vec::new(), 0);
        let mut rest = bytes;
        while !rest.is_empty() {
            let n = match scan(rest, true) {
                Scan::Frame(f) => {
                    list.push(Owned::Frame(f.bytes().to_vec()));
                    f.len()
                }
                Scan::Unknown(f) => {
                    list.push(Owned::Unknown(f.bytes().to_vec()));
                    f.len()
                }
                Scan::Skip { cause: Cause::BadChecksum, skip } => {
                    list.push(Owned::Damaged);
                    skip
                }
                Scan::Skip { skip, .. } => {
                    garbage += skip as u64;
                    skip
                }
                Scan::Incomplete => {
                    garbage += 1;
                    1
                }
            };
            rest = &rest[n..];
        }
        (list, garbage)
    }

    proptest! {
        #[test]
        fn the_same_is_found_as_with_a_checksum_for_every_start(
            pieces in prop::collection::vec(prop_oneof![
                prop::collection::vec(any::<u8>(), 0..60),
                prop::collection::vec(prop::sample::select(vec![0xFDu8, 0xFE, 0, 1, 9, 255]), 0..60),
                (0usize..8).prop_map(|i| frames(8).swap_remove(i)),
            ], 0..40),
        ) {
            let datagram: Vec<u8> = pieces.into_iter().flatten().collect();
            let (mut list, mut garbage) = (Vec::new(), 0);
            deframe(&datagram, &mut RunningCrc::new(), |_| true, |found| collect(&mut list, &mut garbage, found));
            prop_assert_eq!((list, garbage), plainly(&datagram));
        }
    }

    /// Bytes that declare as much as they can, as often as they can.
    fn hostile() -> Vec<Vec<u8>> {
        // MAVLink 1 and 2, length 255, HEARTBEAT; every other byte starts a frame.
        let nested = [0xFE, 0xFD, 255, 0, 0, 0, 0, 0, 0, 0].repeat(6500);
        let random: Vec<u8> =
            (0u32..65_000).map(|i| (i.wrapping_mul(0x9E37_79B9) >> 23) as u8 | 0xFC).collect();
        vec![vec![0xFE; 65_000], vec![0xFD; 65_000], [0xFE, 255].repeat(32_500), nested, random]
    }

    #[test]
    fn hostile_bytes_cost_a_constant_each() {
        for bytes in hostile() {
            let mut crc = RunningCrc::new();
            deframe(&bytes, &mut crc, |_| true, |_| {});
            assert!(crc.cost <= 6 * bytes.len(), "{} for {:02x?}", crc.cost, &bytes[..10]);
            let mut deframer = Deframer::new();
            for chunk in bytes.chunks(997) {
                deframer.space()[..chunk.len()].copy_from_slice(chunk);
                deframer.advance(chunk.len(), |_| {});
            }
            assert!(deframer.crc.cost <= 6 * bytes.len(), "{} for {:02x?}", deframer.crc.cost, &bytes[..10]);
        }
    }

    #[test]
    fn frames_in_front_are_found_where_the_rest_is_not_searched() {
        let mut datagram = frames(3).concat();
        datagram.extend([0xFE; 5000]);
        datagram.extend(&frames(1)[0]);
        let (mut list, mut garbage) = (Vec::new(), 0);
        let mut crc = RunningCrc::new();
        deframe(&datagram, &mut crc, |_| false, |found| collect(&mut list, &mut garbage, found));
        assert_eq!(list, frames(3).into_iter().map(Owned::Frame).collect::<Vec<_>>());
        assert_eq!(garbage as usize, 5000 + frames(1)[0].len());
        assert!(crc.cost < 500, "{}", crc.cost);
    }

    #[test]
    fn a_false_start_at_the_end_of_a_datagram_hides_no_frame() {
        let mut datagram = vec![0xFD, 200, 0];
        datagram.extend(&frames(1)[0]);
        let (mut list, mut garbage) = (Vec::new(), 0);
        deframe(&datagram, &mut RunningCrc::new(), |_| true, |found| collect(&mut list, &mut garbage, found));
        assert_eq!((list, garbage), (vec![Owned::Frame(frames(1).remove(0))], 3));
    }
}
