//! Telemetry logs: 8 bytes of big-endian microseconds since 1970, then the raw frame, again and again; or the frames alone, as they came
//! over the link (MAVProxy's `.tlog.raw`).
//!
//! The reader streams (a log may be larger than memory) and survives damage: a record whose frame fails its checksum costs that
//! record, garbage costs its bytes, a truncated tail is counted, and all of it is in [`TlogReader::counters`]. The receive stamps
//! are the ground station's: they say when a record was *written*, never when a sample was taken.

use std::io::{self, Read};

use super::counters::{Cause, Counters};
use super::frame::{Candidate, Frame, MAX_FRAME_LEN, candidate};
use super::read_ahead::ReadAhead;
use super::running_crc::RunningCrc;

/// Bytes of the stamp in front of every frame.
const STAMP_LEN: usize = 8;
/// Room to decide on one record: its stamp and its frame, and whole records that may begin up to its end.
const LOOK_AHEAD: usize = 2 * (STAMP_LEN + MAX_FRAME_LEN) + STAMP_LEN + 1;
const BUFFER_LEN: usize = 1 << 18;

/// One record of a log.
#[derive(Clone, Copy, Debug)]
pub struct Record<'a> {
    /// The writer's clock, microseconds since 1970; 0 in a log without stamps. Not a sample time.
    pub written_us: u64,
    /// The frame; its checksum is right, or its message is unknown.
    pub frame: Frame<'a>,
}

/// Reads the records of a log from any byte source.
pub struct TlogReader<R> {
    window: ReadAhead<R>,
    stamp_len: usize,
    truncated: bool,
    counters: Counters,
    judge: Judge,
}

enum RecordStep {
    Record { len: usize, known: bool },
    Skip { skip: usize, count: Option<Cause> },
}

impl<R: Read> TlogReader<R> {
    /// A reader over `source`, which need not be buffered.
    pub fn new(source: R) -> Self {
        Self::with_stamps(source, STAMP_LEN)
    }

    /// The same for a log of frames alone.
    pub fn without_stamps(source: R) -> Self {
        Self::with_stamps(source, 0)
    }

    fn with_stamps(source: R, stamp_len: usize) -> Self {
        Self {
            window: ReadAhead::new(source, BUFFER_LEN, LOOK_AHEAD),
            stamp_len,
            truncated: false,
            counters: Counters::default(),
            judge: Judge::new(),
        }
    }

    /// The next record, or `None` at the end of the log.
    ///
    /// # Errors
    /// Only what the source's `read` returns; damaged bytes are counted, not errors.
    pub fn next_record(&mut self) -> io::Result<Option<Record<'_>>> {
        let Some(len) = self.find_record()? else { return Ok(None) };
        let (stamp, rest) = self.window.passed(len).split_at(self.stamp_len);
        let written_us = stamp.iter().fold(0, |us, &b| us << 8 | u64::from(b));
        match candidate(rest) {
            Candidate::Frame(frame) => Ok(Some(Record { written_us, frame })),
            Candidate::Short | Candidate::NoFrame => Ok(None),
        }
    }

    /// Passes the next record; its length.
    fn find_record(&mut self) -> io::Result<Option<usize>> {
        loop {
            self.window.fill()?;
            if self.window.bytes().is_empty() {
                return Ok(None);
            }
            let (bytes, at) = (self.window.bytes(), self.window.position());
            match self.judge.step(&Sight { bytes, at, stamp_len: self.stamp_len }) {
                RecordStep::Record { len, known } => {
                    self.window.advance(len);
                    self.counters.frames += 1;
                    if !known {
                        self.counters.count(Cause::UnknownId);
                    }
                    return Ok(Some(len));
                }
                RecordStep::Skip { skip, count } => {
                    match count {
                        Some(cause) => self.counters.count(cause),
                        None => self.counters.add(Cause::Garbage, skip as u64),
                    }
                    self.truncated = self.window.at_end() && skip == self.window.bytes().len();
                    self.window.advance(skip);
                }
            }
        }
    }

    /// What was rejected so far, and the frames that were read.
    pub fn counters(&self) -> &Counters {
        &self.counters
    }

    /// Bytes consumed so far, for a progress bar.
    pub fn position(&self) -> u64 {
        self.window.position()
    }

    /// Whether the log ended in the middle of a record.
    pub fn truncated(&self) -> bool {
        self.truncated
    }
}

/// The first bytes of what is not yet read. At least [`LOOK_AHEAD`] of them are in sight unless the log ends before.
struct Sight<'a> {
    bytes: &'a [u8],
    /// Position in the log.
    at: u64,
    stamp_len: usize,
}

impl<'a> Sight<'a> {
    /// What stands behind the stamp of a record that begins `ahead` bytes from here.
    fn behind_stamp(&self, ahead: usize) -> &'a [u8] {
        self.bytes.get(ahead + self.stamp_len..).unwrap_or_default()
    }

    /// Whether a record begins `ahead` bytes from here whose checksum fits.
    fn is_whole(&self, ahead: usize, crc: &mut RunningCrc) -> bool {
        matches!(candidate(self.behind_stamp(ahead)), Candidate::Frame(frame)
            if frame.fits_in(crc, self.bytes, self.at, ahead + self.stamp_len))
    }

    /// Bytes to leave behind until a start byte stands behind a stamp again; at least one.
    fn to_next_start(&self) -> usize {
        let found = self.behind_stamp(1).iter().position(|&b| b == 0xFE || b == 0xFD);
        match found {
            Some(i) => i + 1,
            None => self.bytes.len().saturating_sub(self.stamp_len).max(1),
        }
    }
}

/// Tells records with a checksum that fits from what only looks like one. Every position is judged once.
struct Judge {
    crc: RunningCrc,
    /// Nothing that fits begins behind the position that was asked about last and in front of this one.
    searched: u64,
    /// Something does here.
    found: Option<u64>,
}

impl Judge {
    fn new() -> Self {
        Self { crc: RunningCrc::new(), searched: 0, found: None }
    }

    /// Decides what the first bytes are.
    fn step(&mut self, sight: &Sight<'_>) -> RecordStep {
        let bytes = sight.bytes;
        if bytes.len() < sight.stamp_len {
            return RecordStep::Skip { skip: bytes.len(), count: None };
        }
        let frame = match candidate(sight.behind_stamp(0)) {
            Candidate::Frame(frame) => frame,
            // Nothing after it can be a whole record either if even the shortest one does not fit.
            Candidate::Short if bytes.len() < sight.stamp_len + 8 => {
                return RecordStep::Skip { skip: bytes.len(), count: None };
            }
            Candidate::Short | Candidate::NoFrame => {
                return RecordStep::Skip { skip: sight.to_next_start(), count: None };
            }
        };
        let len = sight.stamp_len + frame.len();
        if frame.fits_in(&mut self.crc, bytes, sight.at, sight.stamp_len) {
            return RecordStep::Record { len, known: true };
        }
        // A whole record inside it says that it was none.
        if let Some(inside) = self.next_whole(sight, len) {
            return RecordStep::Skip { skip: inside, count: None };
        }
        // A start byte where the next record has to have it (or the end of the log) says that this really was a record.
        let next_fits = match bytes.get(len + sight.stamp_len) {
            Some(&b) => b == 0xFE || b == 0xFD,
            None => len == bytes.len(),
        };
        match (next_fits, frame.known()) {
            (true, true) => RecordStep::Skip { skip: len, count: Some(Cause::BadChecksum) },
            (true, false) => RecordStep::Record { len, known: false },
            (false, true) => RecordStep::Skip { skip: 1, count: Some(Cause::BadChecksum) },
            (false, false) => RecordStep::Skip { skip: sight.to_next_start(), count: None },
        }
    }

    /// Where within the first `len` bytes another record begins whose checksum fits.
    fn next_whole(&mut self, sight: &Sight<'_>, len: usize) -> Option<usize> {
        let ahead = |position: u64| position.checked_sub(sight.at).and_then(|n| usize::try_from(n).ok());
        if self.found.and_then(ahead).is_none_or(|ahead| ahead == 0) {
            let from = ahead(self.searched).unwrap_or(0).max(1);
            let inside = (from..len).find(|&from| sight.is_whole(from, &mut self.crc));
            self.found = inside.map(|inside| sight.at + inside as u64);
            self.searched = self.searched.max(sight.at + inside.unwrap_or(len) as u64);
        }
        self.found.and_then(ahead).filter(|&inside| inside < len)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use mavlink::dialects::ardupilotmega::{MavMessage, SYSTEM_TIME_DATA};
    use mavlink::{MAVLinkV1MessageRaw, MAVLinkV2MessageRaw, MavHeader};
    use proptest::prelude::*;

    fn message(boot_ms: u32) -> MavMessage {
        MavMessage::SYSTEM_TIME(SYSTEM_TIME_DATA { time_unix_usec: 3, time_boot_ms: boot_ms })
    }

    fn record(boot_ms: u32, v1: bool) -> Vec<u8> {
        let header = MavHeader { system_id: 1, component_id: 1, sequence: 7 };
        let mut bytes = 1_790_000_000_000_000u64.to_be_bytes().to_vec();
        if v1 {
            let mut raw = MAVLinkV1MessageRaw::new();
            raw.serialize_message(header, &message(boot_ms));
            bytes.extend_from_slice(raw.raw_bytes());
        } else {
            let mut raw = MAVLinkV2MessageRaw::new();
            raw.serialize_message(header, &message(boot_ms));
            bytes.extend_from_slice(raw.raw_bytes());
        }
        bytes
    }

    fn read_all(bytes: &[u8]) -> (Vec<MavMessage>, Counters, bool) {
        let mut reader = TlogReader::new(bytes);
        let mut out = Vec::new();
        while let Some(r) = reader.next_record().unwrap() {
            out.push(r.frame.parse().unwrap());
        }
        assert_eq!(reader.position(), bytes.len() as u64);
        (out, reader.counters().clone(), reader.truncated())
    }

    #[test]
    fn both_versions_are_read() {
        let log = [record(1, true), record(2, false), record(3, true)].concat();
        let (messages, counters, truncated) = read_all(&log);
        assert_eq!(messages, vec![message(1), message(2), message(3)]);
        assert_eq!(counters.seen().count(), 0);
        assert!(!truncated);
    }

    #[test]
    fn frames_alone_are_read_and_damage_costs_what_it_hits() {
        let frames: Vec<Vec<u8>> = (1..=40).map(|i| record(i, i % 2 == 0)[STAMP_LEN..].to_vec()).collect();
        let mut log = frames.concat();
        log[frames[..9].concat().len() + 11] ^= 4;
        log.splice(frames[..20].concat().len()..frames[..20].concat().len(), [0xFD, 3, 0, 7, 9]);
        let mut reader = TlogReader::without_stamps(log.as_slice());
        let mut read = Vec::new();
        while let Some(r) = reader.next_record().unwrap() {
            read.push(r.frame.parse().unwrap());
        }
        let whole: Vec<_> = (1..=40).filter(|i| *i != 10).map(message).collect();
        assert_eq!(read, whole);
        assert_eq!(reader.counters().of(Cause::BadChecksum), 1);
        assert_eq!(reader.counters().of(Cause::Garbage), 5);
    }

    #[test]
    fn a_damaged_frame_costs_that_frame_only() {
        let mut log = [record(1, false), record(2, false), record(3, false)].concat();
        let len = record(1, false).len();
        log[len + 8 + 12] ^= 0x40;
        let (messages, counters, _) = read_all(&log);
        assert_eq!(messages, vec![message(1), message(3)]);
        assert_eq!(counters.of(Cause::BadChecksum), 1);
        assert_eq!(counters.of(Cause::Garbage), 0);
    }

    #[test]
    fn a_stamp_that_looks_like_a_frame_hides_no_records() {
        let mut log: Vec<u8> = (1..=60).flat_map(|i| record(i, false)).collect();
        // A lost start byte, and in the next stamp a start byte before what fits as a length.
        for (at, bit) in [(236, 5), (211, 0)] {
            log[at] ^= 1 << bit;
        }
        let mut reader = TlogReader::new(log.as_slice());
        let mut read = 0;
        while let Some(r) = reader.next_record().unwrap() {
            read += usize::from(r.frame.parse().is_ok());
        }
        assert!(read >= 58, "{read}");
    }

    #[test]
    fn garbage_between_records_is_counted_by_the_byte() {
        let log = [record(1, false), vec![0xFE, 9, 9, 0xFD, 1, 2, 3], record(2, true)].concat();
        let (messages, counters, _) = read_all(&log);
        assert_eq!(messages, vec![message(1), message(2)]);
        assert_eq!(counters.of(Cause::Garbage) + counters.of(Cause::BadChecksum), 7);
    }

    #[test]
    fn a_truncated_tail_is_an_event_not_an_error() {
        let mut log = [record(1, false), record(2, false)].concat();
        log.truncate(log.len() - 5);
        let (messages, counters, truncated) = read_all(&log);
        assert_eq!(messages, vec![message(1)]);
        assert!(truncated);
        assert!(counters.of(Cause::Garbage) > 0);
    }

    /// Frames and counts of the reader.
    fn found(bytes: &[u8], stamp_len: usize) -> (Vec<Vec<u8>>, Counters, usize) {
        let mut reader = TlogReader::with_stamps(bytes, stamp_len);
        let mut frames = Vec::new();
        while let Some(r) = reader.next_record().unwrap() {
            frames.push(r.frame.bytes().to_vec());
        }
        (frames, reader.counters.clone(), reader.judge.crc.cost)
    }

    /// The same by a checksum for every start, and a search for a whole record in every record that is none.
    fn found_plainly(bytes: &[u8], stamp_len: usize) -> (Vec<Vec<u8>>, Counters) {
        let (mut frames, mut counters) = (Vec::new(), Counters::default());
        let mut at = 0;
        while at < bytes.len() {
            // A judge that remembers nothing.
            let sight = Sight { bytes: &bytes[at..], at: 0, stamp_len };
            match Judge::new().step(&sight) {
                RecordStep::Record { len, known } => {
                    frames.push(bytes[at + stamp_len..at + len].to_vec());
                    counters.frames += 1;
                    counters.add(Cause::UnknownId, u64::from(!known));
                    at += len;
                }
                RecordStep::Skip { skip, count } => {
                    counters
                        .add(count.unwrap_or(Cause::Garbage), if count.is_some() { 1 } else { skip as u64 });
                    at += skip;
                }
            }
        }
        (frames, counters)
    }

    fn hostile() -> Vec<Vec<u8>> {
        let random = (0u32..200_000).map(|i| (i.wrapping_mul(0x9E37_79B9) >> 23) as u8 | 0xFC).collect();
        let nested = [0xFE, 0xFD, 255, 0, 0, 0, 0, 0, 0, 0].repeat(20_000);
        vec![vec![0xFE; 200_000], vec![0xFD; 200_000], [0xFE, 255].repeat(100_000), nested, random]
    }

    #[test]
    fn hostile_bytes_cost_a_constant_each() {
        for bytes in hostile() {
            for stamp_len in [0, STAMP_LEN] {
                let (.., cost) = found(&bytes, stamp_len);
                // Digested once, judged as a record and as what may be inside another.
                assert!(cost <= 10 * bytes.len(), "{cost} for {:02x?}", &bytes[..10]);
            }
        }
    }

    proptest! {
        #[test]
        fn a_judge_that_remembers_finds_the_same(
            pieces in proptest::collection::vec(prop_oneof![
                proptest::collection::vec(any::<u8>(), 0..60),
                proptest::collection::vec(prop::sample::select(vec![0xFDu8, 0xFE, 0, 1, 9, 255]), 0..300),
                (0u32..8, any::<bool>()).prop_map(|(i, v1)| record(i, v1)),
                (0u32..8, 0usize..21).prop_map(|(i, cut)| record(i, false).split_off(cut)),
            ], 0..40),
            stamped in any::<bool>(),
        ) {
            let bytes: Vec<u8> = pieces.into_iter().flatten().collect();
            let stamp_len = if stamped { STAMP_LEN } else { 0 };
            let (frames, counters, cost) = found(&bytes, stamp_len);
            prop_assert_eq!((frames, counters), found_plainly(&bytes, stamp_len));
            prop_assert!(cost <= 10 * bytes.len());
        }

        #[test]
        fn arbitrary_bytes_are_read_to_their_end(bytes in proptest::collection::vec(any::<u8>(), 0..4000)) {
            let mut reader = TlogReader::new(bytes.as_slice());
            while let Some(r) = reader.next_record().unwrap() {
                let _ = r.frame.parse();
            }
            prop_assert_eq!(reader.position(), bytes.len() as u64);
        }

        #[test]
        fn flipped_bits_never_lose_more_than_the_records_they_hit(hits in proptest::collection::vec((0usize..2000, 0u8..8), 0..6)) {
            let one = record(0, false).len();
            let mut log: Vec<u8> = (1..=60).flat_map(|i| record(i, false)).collect();
            let mut touched = std::collections::BTreeSet::new();
            for (at, bit) in hits {
                let at = at % log.len();
                log[at] ^= 1 << bit;
                touched.insert(at / one);
            }
            let mut reader = TlogReader::new(log.as_slice());
            let mut read = 0;
            while let Some(r) = reader.next_record().unwrap() {
                read += usize::from(r.frame.parse().is_ok());
            }
            // A hit in the length byte of one record can hide the next one when that is hit too, hence the factor.
            prop_assert!(read >= 60 - 2 * touched.len(), "{} of 60 with {:?}", read, touched);
        }
    }
}
