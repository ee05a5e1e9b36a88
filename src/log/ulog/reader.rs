//! The messages of a ULog, one after the other, and around damage.
//!
//! The crates for ULog (yule_log 0.4, px4-ulog 0.6) lose everything behind the first damaged byte: of the same file with five kilobytes of
//! garbage in its middle both gave the first half, of one with thirty flipped bytes the same. ULog has no checksums, but every header
//! can be tested (a known type, a length that fits it, and the length of a data message is known exactly), so that this reader finds
//! its way again: a damaged message costs itself, and the search for the next good one is counted by the byte.
//!
//! Format: docs.px4.io, "ULog File Format": a header of 16 bytes, then messages of u16 length, u8 type, and so many bytes.

use std::io::{self, Read};

use crate::wire::read_ahead::ReadAhead;

use super::super::format::ULOG_MAGIC;

/// Magic, version, and when logging began, microseconds since boot.
const FILE_HEADER: usize = 16;
/// Length (u16) and type of a message.
const HEADER: usize = 3;
const BUFFER: usize = 1 << 18;
/// Enough for the longest message and the headers behind it.
const LOOK_AHEAD: usize = HEADER + u16::MAX as usize + (CHAIN + 1) * (HEADER + 512);
/// Headers in a row that have to fit before what stands there is believed after damage.
const CHAIN: usize = 3;
/// Everything that a ULog may hold, and the shortest and longest of each.
const TYPES: [(u8, usize, usize); 13] = [
    (b'B', 40, 64),
    (b'F', 5, 8192),
    (b'I', 4, 4096),
    (b'M', 5, 65535),
    (b'P', 6, 512),
    (b'Q', 7, 512),
    (b'A', 4, 512),
    (b'R', 2, 2),
    (b'D', 2, 65535),
    (b'L', 9, 1024),
    (b'C', 11, 1024),
    (b'S', 8, 8),
    (b'O', 2, 2),
];

/// One message: its type, and what follows its header.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) struct UlogMessage<'a> {
    pub(super) kind: u8,
    pub(super) payload: &'a [u8],
}

/// Reads the messages of a log from any byte source.
pub(super) struct UlogReader<R> {
    window: ReadAhead<R>,
    /// Shortest and longest data message by the number of its subscription.
    lengths: Vec<Option<(u16, u16)>>,
    /// Where appended data begins: no message reaches across.
    borders: Vec<u64>,
    lost: bool,
    pub(super) garbage: u64,
    pub(super) truncated: bool,
}

impl<R: Read> UlogReader<R> {
    /// A reader over `source`, which need not be buffered, and when logging began, microseconds since boot.
    pub(super) fn new(source: R) -> io::Result<(Self, u64)> {
        let mut reader = Self {
            window: ReadAhead::new(source, BUFFER, LOOK_AHEAD),
            lengths: Vec::new(),
            borders: Vec::new(),
            lost: false,
            garbage: 0,
            truncated: false,
        };
        reader.window.fill()?;
        let head = &reader.window.bytes()[..reader.window.bytes().len().min(FILE_HEADER)];
        let began = head.get(8..FILE_HEADER).and_then(|b| b.first_chunk()).map(|b| u64::from_le_bytes(*b));
        if head.starts_with(ULOG_MAGIC) && began.is_some() {
            reader.window.advance(FILE_HEADER);
        }
        Ok((reader, began.unwrap_or_default()))
    }

    /// Data messages of this subscription are so long from now on.
    pub(super) fn expect(&mut self, id: u16, shortest: u16, longest: u16) {
        let id = usize::from(id);
        if self.lengths.len() <= id {
            self.lengths.resize(id + 1, None);
        }
        self.lengths[id] = Some((shortest, longest));
    }

    /// Data was appended at this byte of the file, after what was being written broke off.
    pub(super) fn appended_at(&mut self, offset: u64) {
        if offset > self.window.position() {
            self.borders.push(offset);
        }
    }

    /// The next message, or `None` at the end of the log.
    ///
    /// # Errors
    /// Only what the source's `read` returns; damaged bytes are counted, not errors.
    pub(super) fn next_message(&mut self) -> io::Result<Option<UlogMessage<'_>>> {
        loop {
            self.window.fill()?;
            let bytes = self.window.bytes();
            if bytes.is_empty() {
                return Ok(None);
            }
            let fits = self.fits(bytes, self.lost);
            if let Some(len) = fits {
                if self.crosses_a_border(len) {
                    continue;
                }
                self.lost = false;
                self.truncated = false;
                self.window.advance(len);
                let message = self.window.passed(len);
                return Ok(Some(UlogMessage { kind: message[2], payload: &message[HEADER..] }));
            }
            self.skip();
        }
    }

    /// Bytes that are no message: on to the next that may begin one.
    fn skip(&mut self) {
        let bytes = self.window.bytes();
        // The end of the file may have cut a message off: then no other is found behind it.
        self.truncated |= self.window.at_end() && !self.lost && self.is_cut_off(bytes);
        let to_next = bytes[1..].windows(HEADER).position(|w| header(w).is_some());
        let rest =
            if self.window.at_end() { bytes.len() } else { bytes.len().saturating_sub(HEADER - 1).max(1) };
        let n = to_next.map_or(rest, |i| i + 1);
        self.lost = true;
        self.garbage += n as u64;
        self.window.advance(n);
    }

    /// Whether these last bytes may be the beginning of a message.
    fn is_cut_off(&self, bytes: &[u8]) -> bool {
        let longer = header(bytes).is_some_and(|len| len > bytes.len());
        bytes.len() < HEADER || (longer && self.fits_exactly(bytes).is_some())
    }

    /// A message that would reach across the border of appended data was cut off by it.
    fn crosses_a_border(&mut self, len: usize) -> bool {
        let (from, to) = (self.window.position(), self.window.position() + len as u64);
        let Some(&border) = self.borders.iter().find(|b| (from + 1..to).contains(b)) else { return false };
        let cut = (border - from) as usize;
        self.garbage += cut as u64;
        self.window.advance(cut);
        true
    }

    /// The length of the message at the start of `bytes`, if it is one: one that proves itself, or one that others follow. While
    /// `searching` behind damage others have to follow in any case, and a data message of a number that nobody registered is none.
    fn fits(&self, bytes: &[u8], searching: bool) -> Option<usize> {
        let len = header(bytes).filter(|len| *len <= bytes.len())?;
        let believed =
            |bytes: &[u8]| self.fits_exactly(bytes).filter(|exact| *exact || !searching || bytes[2] != b'D');
        let exact = believed(bytes)?;
        let mut at = len;
        // A message whose length or content is what it has to be needs no witness.
        let witnesses = if exact && !searching { 0 } else { CHAIN };
        for _ in 0..witnesses {
            let rest = &bytes[at..];
            // The end of the file cuts the next one off, or it is out of sight.
            if rest.len() < HEADER {
                break;
            }
            at += header(rest).filter(|_| believed(rest).is_some())?;
            if at > bytes.len() {
                if searching && self.window.at_end() {
                    return None;
                }
                break;
            }
        }
        Some(len)
    }

    /// Whether a message's length and the beginning of its content are what its kind has to have (`Some(true)`), or may be
    /// (`Some(false)`).
    fn fits_exactly(&self, bytes: &[u8]) -> Option<bool> {
        let size = u16::from_le_bytes([bytes[0], bytes[1]]);
        let content = &bytes[HEADER..bytes.len().min(HEADER + usize::from(size))];
        if bytes[2] != b'D' {
            return content_fits(bytes[2], content);
        }
        let id = content.first_chunk().map(|id| u16::from_le_bytes(*id));
        match id.and_then(|id| *self.lengths.get(usize::from(id))?) {
            Some((shortest, longest)) => (shortest..=longest).contains(&size).then_some(true),
            None => Some(false),
        }
    }
}

/// Whether the beginning of a message that is no data is what its kind has to hold; `Some(false)` where that may be anything.
fn content_fits(kind: u8, content: &[u8]) -> Option<bool> {
    let byte = |i: usize| content.get(i).copied();
    let is_text = |from: usize, to: usize| {
        let text = content.get(from..to.min(content.len()).min(from + TEXT)).unwrap_or_default();
        text.iter().all(|b| b.is_ascii_graphic() || *b == b' ')
    };
    // A key has its length before it.
    let is_key = |at: usize| {
        byte(at)
            .map(usize::from)
            .is_none_or(|n| n > 2 && at + n < content.len() && is_text(at + 1, at + 1 + n))
    };
    // A level, and a stamp whose highest byte is zero for the next 2000 years.
    let is_logged = |highest: usize| {
        byte(0).is_none_or(|l| l < 8 || (b'0'..b'8').contains(&l)) && byte(highest).is_none_or(|b| b == 0)
    };
    let fits = match kind {
        b'S' => content.starts_with(&SYNC) || content.len() < SYNC.len(),
        b'F' => is_text(0, content.len()),
        b'A' => is_text(3, content.len()),
        b'I' | b'P' => is_key(0),
        b'M' | b'Q' => is_key(1),
        b'L' => is_logged(8),
        b'C' => is_logged(10),
        _ => return Some(false),
    };
    fits.then_some(true)
}

/// So much of a text is looked at.
const TEXT: usize = 64;
/// What a synchronisation message holds.
const SYNC: [u8; 8] = [0x2F, 0x73, 0x13, 0x20, 0x25, 0x0C, 0xBB, 0x12];

/// The length of the whole message whose header this may be.
fn header(bytes: &[u8]) -> Option<usize> {
    let [a, b, kind, ..] = *bytes else { return None };
    let size = usize::from(u16::from_le_bytes([a, b]));
    let fits = TYPES.iter().any(|&(k, low, high)| k == kind && (low..=high).contains(&size));
    fits.then_some(HEADER + size)
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    /// A message as it stands in a file.
    fn message(kind: u8, payload: &[u8]) -> Vec<u8> {
        let size = u16::try_from(payload.len()).unwrap().to_le_bytes();
        [&size[..], &[kind], payload].concat()
    }

    /// Message `i` of subscription 7: 30 bytes.
    fn data(i: u8) -> Vec<u8> {
        message(b'D', &[&[7, 0][..], &[i; 25]].concat())
    }

    fn file(messages: &[Vec<u8>]) -> Vec<u8> {
        let head = [ULOG_MAGIC, &[1], &5_000_000u64.to_le_bytes()].concat();
        [head, messages.concat()].concat()
    }

    /// Which data messages were read, and the reader.
    fn read(bytes: &[u8]) -> (Vec<u8>, u64, bool) {
        let (mut reader, began) = UlogReader::new(bytes).unwrap();
        assert_eq!(began, 5_000_000);
        reader.expect(7, 27, 27);
        let mut seen = Vec::new();
        while let Some(m) = reader.next_message().unwrap() {
            if m.kind == b'D' && m.payload.len() == 27 {
                seen.push(m.payload[2]);
            }
        }
        (seen, reader.garbage, reader.truncated)
    }

    #[test]
    fn messages_are_read_in_their_order() {
        let messages: Vec<_> = (0..200).map(data).collect();
        assert_eq!(read(&file(&messages)), ((0..200).collect(), 0, false));
    }

    #[test]
    fn damage_costs_what_it_hits() {
        let messages: Vec<_> = (0..200).map(data).collect();
        let whole = file(&messages);
        let at = |i: usize| FILE_HEADER + 30 * i;
        // A length, a type and a number.
        for byte in [at(50), at(60) + 2, at(70) + 3] {
            let mut hit = whole.clone();
            hit[byte] ^= 0x21;
            let (seen, garbage, _) = read(&hit);
            let lost: Vec<u8> = (0..200).filter(|i| !seen.contains(i)).collect();
            assert!(lost.len() <= 1 && garbage <= 30, "{byte}: {lost:?} {garbage}");
        }
        let mut with_garbage = whole.clone();
        with_garbage
            .splice(at(100)..at(100), (0..5000u32).map(|i| (i.wrapping_mul(2_654_435_761) >> 13) as u8));
        assert_eq!(read(&with_garbage), ((0..200).collect(), 5000, false));
        let (seen, _, truncated) = read(&whole[..at(150) + 11]);
        assert_eq!((seen, truncated), ((0..150).collect(), true));
    }

    #[test]
    fn a_message_that_was_being_written_when_power_failed_hides_nothing_of_what_was_appended() {
        let mut bytes = file(&(0..10).map(data).collect::<Vec<_>>());
        bytes.extend_from_slice(&data(10)[..20]);
        let border = bytes.len() as u64;
        bytes.extend((20..40).flat_map(data));
        let (mut reader, _) = UlogReader::new(bytes.as_slice()).unwrap();
        reader.expect(7, 27, 27);
        reader.appended_at(border);
        let mut seen = Vec::new();
        while let Some(m) = reader.next_message().unwrap() {
            seen.push(m.payload[2]);
        }
        assert_eq!(seen, (0..10).chain(20..40).collect::<Vec<u8>>());
        assert_eq!(reader.garbage, 20);
    }

    proptest! {
        #[test]
        fn arbitrary_bytes_are_read_to_their_end(bytes in proptest::collection::vec(any::<u8>(), 0..6000), magic in any::<bool>()) {
            let bytes = if magic { file(&[bytes]) } else { bytes };
            let (mut reader, _) = UlogReader::new(bytes.as_slice()).unwrap();
            reader.expect(7, 27, 27);
            let mut n = 0;
            while let Some(m) = reader.next_message().unwrap() {
                n += m.payload.len() + HEADER;
            }
            let head = if magic { FILE_HEADER } else { 0 };
            prop_assert_eq!(n as u64 + reader.garbage + head as u64, bytes.len() as u64);
        }

        #[test]
        fn flipped_bits_cost_no_more_than_the_messages_they_hit(hits in proptest::collection::vec((0usize..6000, 0u8..8), 0..6)) {
            let messages: Vec<_> = (0..200).map(data).collect();
            let mut bytes = file(&messages);
            let mut hit = std::collections::BTreeSet::new();
            for (at, bit) in hits {
                let at = FILE_HEADER + at % (bytes.len() - FILE_HEADER);
                bytes[at] ^= 1 << bit;
                hit.insert((at - FILE_HEADER) / 30);
            }
            let (seen, _, _) = read(&bytes);
            // A message between two damaged ones has no good one behind it that would prove it.
            prop_assert!(seen.len() + 4 * hit.len() >= 200, "{} of 200, {hit:?}", seen.len());
        }
    }
}
