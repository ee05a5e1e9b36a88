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

/// Bytes of the stamp in front of every frame.
const STAMP_LEN: usize = 8;
/// Room to decide on one record: its stamp, its frame, and the beginning of the next record.
const LOOK_AHEAD: usize = STAMP_LEN + MAX_FRAME_LEN + STAMP_LEN + 1;
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
            match step(self.window.bytes(), self.stamp_len, self.window.at_end()) {
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

/// Decides what the first bytes are. `bytes` holds at least [`LOOK_AHEAD`] bytes unless the log ends before.
fn step(bytes: &[u8], stamp_len: usize, at_end: bool) -> RecordStep {
    debug_assert!(at_end || bytes.len() >= LOOK_AHEAD);
    let Some(rest) = bytes.get(stamp_len..) else {
        return RecordStep::Skip { skip: bytes.len(), count: None };
    };
    let frame = match candidate(rest) {
        Candidate::Frame(frame) => frame,
        // Nothing after it can be a whole record either if even the shortest one does not fit.
        Candidate::Short if bytes.len() < stamp_len + 8 => {
            return RecordStep::Skip { skip: bytes.len(), count: None };
        }
        Candidate::Short | Candidate::NoFrame => {
            return RecordStep::Skip { skip: to_next_start(bytes, stamp_len), count: None };
        }
    };
    let len = stamp_len + frame.len();
    if frame.checksum_fits() {
        return RecordStep::Record { len, known: true };
    }
    // A whole record inside it says that it was none.
    if let Some(inside) = next_whole(bytes, stamp_len, len) {
        return RecordStep::Skip { skip: inside, count: None };
    }
    // A start byte where the next record has to have it (or the end of the log) says that this really was a record.
    let next_fits = match bytes.get(len + stamp_len) {
        Some(&b) => b == 0xFE || b == 0xFD,
        None => len == bytes.len(),
    };
    match (next_fits, frame.known()) {
        (true, true) => RecordStep::Skip { skip: len, count: Some(Cause::BadChecksum) },
        (true, false) => RecordStep::Record { len, known: false },
        (false, true) => RecordStep::Skip { skip: 1, count: Some(Cause::BadChecksum) },
        (false, false) => RecordStep::Skip { skip: to_next_start(bytes, stamp_len), count: None },
    }
}

/// Bytes to leave behind until a start byte stands behind a stamp again; at least one.
fn to_next_start(bytes: &[u8], stamp_len: usize) -> usize {
    let from = stamp_len + 1;
    let found = bytes.get(from..).and_then(|rest| rest.iter().position(|&b| b == 0xFE || b == 0xFD));
    match found {
        Some(i) => i + 1,
        None => bytes.len().saturating_sub(stamp_len).max(1),
    }
}

/// Where within the first `len` bytes another record begins whose checksum fits.
fn next_whole(bytes: &[u8], stamp_len: usize, len: usize) -> Option<usize> {
    (1..len).find(|&from| match bytes.get(from + stamp_len..) {
        Some(rest) if matches!(rest.first(), Some(0xFE | 0xFD)) => {
            matches!(candidate(rest), Candidate::Frame(frame) if frame.checksum_fits())
        }
        _ => false,
    })
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

    proptest! {
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
