//! The bytes of a log, whatever they are packed in: plain, gzip or zstd, told apart by content.
//!
//! Packed bytes are unpacked as they are read: neither the log nor what is packed is ever held whole. A stream that is damaged or
//! breaks off ends there, with a word about it; one that unpacks to more than any log could is a bomb, and ends there too.

use std::cell::{Cell, RefCell};
use std::io::{self, BufRead, BufReader, ErrorKind, Read};
use std::rc::Rc;

use flate2::bufread::MultiGzDecoder;

use super::file::LogFile;
use super::zstd::Frames;

const GZIP: &[u8] = &[0x1F, 0x8B];
const ZSTD: &[u8] = &[0x28, 0xB5, 0x2F, 0xFD];

/// Logs pack 2 to 10 times, those of a vehicle that stands still 30 times; gzip could 1032 times.
const MOST_GROWTH: u64 = 200;
/// What is unpacked before growth is looked at, bytes.
const GROWTH_FREE: u64 = 64 << 20;
/// What is told of a file that ends before what is packed in it does.
const CUT_OFF: &str = "the file is cut off, and what was packed behind it is missing";

/// What reading has come to: the reader is given away, this stays.
#[derive(Clone, Debug, Default)]
pub(super) struct ReadProgress {
    read: Rc<Cell<u64>>,
    ended: Rc<RefCell<Option<String>>>,
}

impl ReadProgress {
    /// Bytes of the file read so far.
    pub(super) fn read(&self) -> u64 {
        self.read.get()
    }

    /// Why what is packed could not be read to its end.
    pub(super) fn ended(&self) -> Option<String> {
        self.ended.borrow().clone()
    }
}

/// Opens a log's bytes.
///
/// # Errors
/// What the system says.
pub(super) fn open(file: &LogFile) -> io::Result<(Box<dyn Read>, ReadProgress)> {
    Ok(unpacked(file.open()?))
}

/// The same of any bytes.
pub(super) fn unpacked<R: Read + 'static>(bytes: R) -> (Box<dyn Read>, ReadProgress) {
    let progress = ReadProgress::default();
    let mut packed = BufReader::with_capacity(1 << 16, Counted { from: bytes, read: progress.read.clone() });
    let first = packed.fill_buf().map(<[u8]>::to_vec).unwrap_or_default();
    let unpacked: Box<dyn Read> = if first.starts_with(GZIP) {
        Box::new(MultiGzDecoder::new(packed))
    } else if first.starts_with(ZSTD) {
        Box::new(Frames::new(packed))
    } else {
        return (Box::new(packed), progress);
    };
    (Box::new(Bounded { unpacked, bytes: 0, progress: progress.clone() }), progress)
}

/// Counts what is read of a file.
struct Counted<R> {
    from: R,
    read: Rc<Cell<u64>>,
}

impl<R: Read> Read for Counted<R> {
    fn read(&mut self, to: &mut [u8]) -> io::Result<usize> {
        let n = self.from.read(to)?;
        self.read.set(self.read.get() + n as u64);
        Ok(n)
    }
}

/// Unpacked bytes, to the first damage, and no more than a log can be.
struct Bounded {
    unpacked: Box<dyn Read>,
    bytes: u64,
    progress: ReadProgress,
}

impl Read for Bounded {
    fn read(&mut self, to: &mut [u8]) -> io::Result<usize> {
        if self.progress.ended().is_some() {
            return Ok(0);
        }
        let why = match self.unpacked.read(to) {
            Ok(n) => {
                self.bytes += n as u64;
                if self.bytes <= GROWTH_FREE || self.bytes / MOST_GROWTH <= self.progress.read() {
                    return Ok(n);
                }
                format!("it unpacks to more than {MOST_GROWTH} times its size, which no log does")
            }
            Err(e) if e.kind() == ErrorKind::Interrupted => return Err(e),
            Err(e) if e.kind() == ErrorKind::UnexpectedEof => CUT_OFF.to_owned(),
            Err(e) => e.to_string(),
        };
        *self.progress.ended.borrow_mut() = Some(why);
        Ok(0)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use flate2::Compression;
    use flate2::write::GzEncoder;
    use proptest::prelude::*;
    use ruzstd::encoding::{CompressionLevel, compress_to_vec};
    use std::io::{Cursor, Write};

    fn gzip(bytes: &[u8]) -> Vec<u8> {
        let mut encoder = GzEncoder::new(Vec::new(), Compression::fast());
        encoder.write_all(bytes).unwrap();
        encoder.finish().unwrap()
    }

    fn zstd(bytes: &[u8]) -> Vec<u8> {
        compress_to_vec(bytes, CompressionLevel::Fastest)
    }

    fn read(packed: Vec<u8>) -> (Vec<u8>, Option<String>) {
        let (mut reader, progress) = unpacked(Cursor::new(packed));
        let mut out = Vec::new();
        reader.read_to_end(&mut out).unwrap();
        (out, progress.ended())
    }

    fn log() -> Vec<u8> {
        (0..200_000u32).flat_map(|i| (i.wrapping_mul(2_654_435_761) >> 20).to_le_bytes()).collect()
    }

    #[test]
    fn what_was_packed_comes_out() {
        let log = log();
        for packed in [log.clone(), gzip(&log), zstd(&log)] {
            assert_eq!(read(packed), (log.clone(), None));
        }
        // Appended ones, as `cat a.gz b.gz` makes them.
        let twice = [log.clone(), log.clone()].concat();
        assert_eq!(read([gzip(&log), gzip(&log)].concat()), (twice.clone(), None));
        assert_eq!(read([zstd(&log), zstd(&log)].concat()), (twice, None));
    }

    #[test]
    fn what_breaks_off_is_read_to_there_and_told() {
        let log = log();
        for mut packed in [gzip(&log), zstd(&log)] {
            packed.truncate(packed.len() * 2 / 3);
            let (out, why) = read(packed);
            assert!(out.len() > log.len() / 4 && log.starts_with(&out), "{}", out.len());
            assert!(why.is_some());
        }
    }

    /// One frame that may refer to all of itself, as `zstd` makes it of a log below some MiB: blocks of raw bytes, and a checksum.
    fn one_window(bytes: &[u8]) -> Vec<u8> {
        let mut packed = [ZSTD, &[0xA4], &(bytes.len() as u32).to_le_bytes()].concat();
        let blocks = bytes.chunks(100_000);
        let last = blocks.len() - 1;
        for (i, block) in blocks.enumerate() {
            let head = (block.len() as u32) << 3 | u32::from(i == last);
            packed.extend_from_slice(&head.to_le_bytes()[..3]);
            packed.extend_from_slice(block);
        }
        packed.extend_from_slice(&[0; 4]);
        packed
    }

    #[test]
    fn of_a_frame_that_is_cut_off_every_whole_block_is_read() {
        let log = log();
        let whole = one_window(&log);
        assert_eq!(read(whole.clone()), (log.clone(), None));
        for (cut, blocks) in [(whole.len() - 2, 8), (whole.len() - 50_000, 7), (350_000, 3), (50_000, 0)] {
            let (out, why) = read(whole[..cut].to_vec());
            assert!(out == log[..100_000 * blocks], "{cut}: {}", out.len());
            assert_eq!(why.as_deref(), Some(CUT_OFF));
        }
        // A block of a kind that there is none of is damage, and what is in front of it is read as well.
        let mut damaged = whole;
        damaged[9 + 2 * 100_003] |= 6;
        let (out, why) = read(damaged);
        assert!(out == log[..200_000] && why.is_some_and(|why| why != CUT_OFF), "{}", out.len());
        let mut packed = gzip(&log);
        packed.truncate(packed.len() / 2);
        assert_eq!(read(packed).1.as_deref(), Some(CUT_OFF));
    }

    #[test]
    fn a_bomb_is_not_read_to_its_end() {
        let bomb = gzip(&vec![0; 300 << 20]);
        let (mut reader, progress) = unpacked(Cursor::new(bomb));
        let n = io::copy(&mut reader, &mut io::sink()).unwrap();
        assert!(n < 100 << 20, "{n}");
        assert!(progress.ended().unwrap().contains("200 times"));
        // A frame that asks for a window of 2 GiB.
        let (out, why) = read([ZSTD, &[0x00, 0xA8, 0, 0, 0, 0]].concat());
        assert!(out.is_empty() && why.unwrap().contains("window"));
        // One whose whole content of 16 GiB would be its window.
        let (_, why) = read([ZSTD, &[0xE0, 0, 0, 0, 0, 4, 0, 0, 0, 0]].concat());
        assert!(why.unwrap().contains("window"));
    }

    proptest! {
        #![proptest_config(ProptestConfig { cases: 64, ..ProptestConfig::default() })]
        #[test]
        fn arbitrary_bytes_behind_a_magic_end(bytes in proptest::collection::vec(any::<u8>(), 0..2000), zstd in any::<bool>()) {
            let magic = if zstd { ZSTD } else { GZIP };
            let (out, _) = read([magic, &bytes].concat());
            prop_assert!(out.len() <= 256 << 20);
        }
    }
}
