//! The messages of a DataFlash log, one after the other, and around damage.
//!
//! Two bytes and a type begin every message; the messages of type 128 (FMT) say how long the others are and what is in them. There is no
//! checksum: a message is believed if another one, or the end, follows it. The crate ardupilot-binlog finds its way through damage as
//! well, but tells nothing of what it left out, and copies every field of every message.
//!
//! Format: ArduPilot, `libraries/AP_Logger/LogStructure.h`.

use std::io::{self, Read};

use crate::wire::read_ahead::ReadAhead;

use super::super::format::{DATAFLASH_FMT, DATAFLASH_HEAD};
use super::super::row::{FieldSlot, SHORTS, Storage};

/// The two bytes, and the type.
const HEADER: usize = 3;
/// A FMT message: type, length, name, format and labels of what it describes.
const FMT: usize = HEADER + 2 + NAME + FORMAT + LABELS;
const NAME: usize = 4;
const FORMAT: usize = 16;
const LABELS: usize = 64;
const BUFFER: usize = 1 << 16;
/// The longest message (a length is a byte) and the head of the next.
const LOOK_AHEAD: usize = 512;

/// What the log says of one type of message.
#[derive(Clone, Debug, PartialEq)]
pub(super) struct Described {
    pub(super) name: String,
    len: usize,
    /// Labels and what they stand for; text has no number.
    fields: Vec<(String, Option<FieldSlot>)>,
}

impl Described {
    /// Where a number stands in what follows the header.
    pub(super) fn slot(&self, label: &str) -> Option<FieldSlot> {
        self.fields.iter().find(|(l, _)| l == label)?.1
    }
}

/// Reads the messages of a log from any byte source.
pub(super) struct DataFlashReader<R> {
    window: ReadAhead<R>,
    lengths: [Option<u8>; 256],
    pub(super) garbage: u64,
    pub(super) truncated: bool,
}

impl<R: Read> DataFlashReader<R> {
    /// A reader over `source`, which need not be buffered.
    pub(super) fn new(source: R) -> Self {
        let mut lengths = [None; 256];
        lengths[usize::from(DATAFLASH_FMT)] = Some(FMT as u8);
        Self { window: ReadAhead::new(source, BUFFER, LOOK_AHEAD), lengths, garbage: 0, truncated: false }
    }

    /// The next message's type and what follows its header, or `None` at the end of the log.
    ///
    /// # Errors
    /// Only what the source's `read` returns; damaged bytes are counted, not errors.
    pub(super) fn next_message(&mut self) -> io::Result<Option<(u8, &[u8])>> {
        loop {
            self.window.fill()?;
            let bytes = self.window.bytes();
            if bytes.is_empty() {
                return Ok(None);
            }
            match self.message(bytes) {
                Some(len) if len <= bytes.len() => {
                    self.window.advance(len);
                    let message = self.window.passed(len);
                    return Ok(Some((message[2], &message[HEADER..])));
                }
                found => {
                    // Only the end of the file leaves a message without its end.
                    self.truncated = found.is_some() || bytes.len() < HEADER;
                    let next = bytes.windows(2).skip(1).position(|w| w == DATAFLASH_HEAD).map(|i| i + 1);
                    let n = next
                        .unwrap_or_else(|| if self.window.at_end() { bytes.len() } else { bytes.len() - 1 });
                    self.truncated &= n == bytes.len();
                    self.garbage += n as u64;
                    self.window.advance(n);
                }
            }
        }
    }

    /// The length of the message that begins here, if one does.
    fn message(&self, bytes: &[u8]) -> Option<usize> {
        let kind = bytes.starts_with(&DATAFLASH_HEAD).then(|| bytes.get(2))??;
        let len = usize::from(self.lengths[usize::from(*kind)]?);
        match bytes.get(len..) {
            Some([]) | None => self.window.at_end().then_some(len),
            Some([a]) => (*a == DATAFLASH_HEAD[0] || self.window.at_end()).then_some(len),
            Some([a, b, ..]) if [*a, *b] == DATAFLASH_HEAD => Some(len),
            // A description proves itself; without it all messages of its type are lost.
            Some(_) => (*kind == DATAFLASH_FMT && described(&bytes[HEADER..len]).is_some()).then_some(len),
        }
    }

    /// Messages of this type are so long from now on.
    pub(super) fn expect(&mut self, kind: u8, described: &Described) {
        self.lengths[usize::from(kind)] = u8::try_from(described.len).ok();
    }
}

/// The type that a FMT message describes, and how; `None` for one that contradicts itself.
pub(super) fn described(payload: &[u8]) -> Option<(u8, Described)> {
    let (&[kind, len], rest) = payload.split_first_chunk::<2>()?;
    let (name, rest) = rest.split_at_checked(NAME)?;
    let (format, labels) = rest.split_at_checked(FORMAT)?;
    let mut labels = text(labels).split(',');
    let mut fields = Vec::with_capacity(FORMAT);
    let mut at = 0;
    for letter in text(format).chars() {
        let (size, slot) = field(letter, at)?;
        at += size;
        if let Some(label) = labels.next() {
            fields.push((label.trim().to_owned(), slot));
        }
    }
    let whole = usize::from(len) == HEADER + at && (kind == DATAFLASH_FMT) == (text(name) == "FMT");
    whole.then(|| (kind, Described { name: text(name).to_owned(), len: usize::from(len), fields }))
}

/// Text up to its zero.
pub(super) fn text(bytes: &[u8]) -> &str {
    let end = bytes.iter().position(|&b| b == 0).unwrap_or(bytes.len());
    std::str::from_utf8(&bytes[..end]).unwrap_or_default()
}

/// The size of what a letter of a format stands for, and the number that it is.
fn field(letter: char, at: usize) -> Option<(usize, Option<FieldSlot>)> {
    let number = |storage: Storage, factor| (storage.len(), Some(FieldSlot { at, storage, factor }));
    Some(match letter {
        'b' => number(Storage::I8, 1.0),
        'B' | 'M' => number(Storage::U8, 1.0),
        'h' => number(Storage::I16, 1.0),
        'H' => number(Storage::U16, 1.0),
        'i' => number(Storage::I32, 1.0),
        'I' => number(Storage::U32, 1.0),
        'f' => number(Storage::F32, 1.0),
        'd' => number(Storage::F64, 1.0),
        'q' => number(Storage::I64, 1.0),
        'Q' => number(Storage::U64, 1.0),
        'c' => number(Storage::I16, 0.01),
        'C' => number(Storage::U16, 0.01),
        'e' => number(Storage::I32, 0.01),
        'E' => number(Storage::U32, 0.01),
        'L' => number(Storage::I32, 1e-7),
        'n' => (4, None),
        'N' => (16, None),
        'Z' => (64, None),
        // An array: its first.
        'a' => (2 * SHORTS, Some(FieldSlot { at, storage: Storage::I16, factor: 1.0 })),
        'g' => (2, None),
        _ => return None,
    })
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    fn padded(text: &str, n: usize) -> Vec<u8> {
        let mut bytes = text.as_bytes().to_vec();
        bytes.resize(n, 0);
        bytes
    }

    fn fmt(kind: u8, len: u8, name: &str, format: &str, labels: &str) -> Vec<u8> {
        [
            &[0xA3, 0x95, DATAFLASH_FMT, kind, len][..],
            &padded(name, NAME),
            &padded(format, FORMAT),
            &padded(labels, LABELS),
        ]
        .concat()
    }

    /// Message `i` of type 9: 16 bytes.
    fn message(i: u8) -> Vec<u8> {
        [&[0xA3, 0x95, 9][..], &u64::from(i).to_le_bytes(), &[i; 5]].concat()
    }

    fn file(n: u8) -> Vec<u8> {
        let head = fmt(9, 16, "TEST", "QcHB", "TimeUS,A,B,C");
        [head, (0..n).flat_map(message).collect()].concat()
    }

    fn read(bytes: &[u8]) -> (Vec<u8>, u64, bool) {
        let mut reader = DataFlashReader::new(bytes);
        let mut seen = Vec::new();
        while let Some((kind, payload)) = reader.next_message().unwrap() {
            let fmt = if kind == DATAFLASH_FMT { described(payload) } else { None };
            if let Some((kind, described)) = fmt {
                reader.expect(kind, &described);
            } else if kind == 9 {
                seen.push(payload[8]);
            }
        }
        (seen, reader.garbage, reader.truncated)
    }

    #[test]
    fn messages_are_read_as_they_are_described() {
        assert_eq!(read(&file(200)), ((0..200).collect(), 0, false));
        let (kind, d) = described(&fmt(9, 16, "TEST", "QcHB", "TimeUS,A,B,C")[3..]).unwrap();
        assert_eq!((kind, d.name.as_str()), (9, "TEST"));
        assert_eq!(d.slot("A"), Some(FieldSlot { at: 8, storage: Storage::I16, factor: 0.01 }));
        assert_eq!((d.slot("C").map(|s| s.at), d.slot("D")), (Some(12), None));
        assert_eq!(described(&fmt(9, 17, "TEST", "QcHB", "TimeUS,A,B,C")[3..]), None);
    }

    #[test]
    fn damage_costs_what_it_hits() {
        let whole = file(200);
        let at = |i: usize| FMT + 16 * i;
        for byte in [at(50), at(60) + 1, at(70) + 2, at(80) + 3] {
            let mut hit = whole.clone();
            hit[byte] ^= 0x21;
            let (seen, garbage, _) = read(&hit);
            // A head that is gone also takes away what proved the message before it.
            assert!(seen.len() >= 198 && garbage <= 32, "{byte}: {} {garbage}", seen.len());
        }
        let mut with_garbage = whole.clone();
        with_garbage
            .splice(at(100)..at(100), (0..5000u32).map(|i| (i.wrapping_mul(2_654_435_761) >> 13) as u8));
        let (seen, garbage, truncated) = read(&with_garbage);
        assert!(
            seen.len() >= 198 && (5000..5040).contains(&garbage) && !truncated,
            "{} {garbage}",
            seen.len()
        );
        let (seen, _, truncated) = read(&whole[..at(150) + 7]);
        assert_eq!((seen.len(), truncated), (150, true));
    }

    proptest! {
        #[test]
        fn arbitrary_bytes_are_read_to_their_end(bytes in proptest::collection::vec(any::<u8>(), 0..6000), fmt in any::<bool>()) {
            let bytes = if fmt { [file(3), bytes].concat() } else { bytes };
            let mut reader = DataFlashReader::new(bytes.as_slice());
            let mut n = 0;
            while let Some((kind, payload)) = reader.next_message().unwrap() {
                n += payload.len() + HEADER;
                let fmt = if kind == DATAFLASH_FMT { described(payload) } else { None };
                if let Some((kind, described)) = fmt {
                    reader.expect(kind, &described);
                }
            }
            prop_assert_eq!(n as u64 + reader.garbage, bytes.len() as u64);
        }

        #[test]
        fn any_description_is_one_or_none(payload in proptest::collection::vec(any::<u8>(), 0..100)) {
            if let Some((_, d)) = described(&payload) {
                prop_assert!(d.fields.iter().flat_map(|f| f.1).all(|s| s.at + s.storage.len() + HEADER <= d.len));
            }
        }

        #[test]
        fn flipped_bits_cost_no_more_than_the_messages_they_hit(hits in proptest::collection::vec((0usize..6000, 0u8..8), 0..6)) {
            let mut bytes = file(200);
            let mut hit = std::collections::BTreeSet::new();
            for (at, bit) in hits {
                let at = FMT + at % (bytes.len() - FMT);
                bytes[at] ^= 1 << bit;
                hit.insert((at - FMT) / 16);
            }
            let (seen, _, _) = read(&bytes);
            prop_assert!(seen.len() + 2 * hit.len() >= 200, "{} of 200, {hit:?}", seen.len());
        }
    }
}
