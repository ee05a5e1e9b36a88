//! Checksums of any part of a run of bytes, each for the same price.
//!
//! Whoever looks for frames in hostile bytes has to judge a frame at every byte that may start one. MAVLink's checksum (CRC-16/MCRF4XX:
//! reflected polynomial 0x8408, start value 0xFFFF) is linear over GF(2), so what was digested before a window can be taken out of the
//! checksum behind it: with `P(i)` the checksum of the first `i` bytes of the run, `S` the start value and `Lⁿ` the digestion of `n`
//! zeros,
//!
//! ```text
//! crc(from..to) = P(to) ⊕ Lⁿ(P(from) ⊕ S),   n = to − from
//! ```
//!
//! `P` costs one look-up a byte, once; `Lⁿ` four look-ups, whatever `n` is. (The same identity combines checksums of parts in zlib's
//! `crc32_combine`.)

use super::frame::MAX_FRAME_LEN;

const POLYNOMIAL: u16 = 0x8408;
const START: u16 = 0xFFFF;

/// What a byte does to the checksum.
static BYTE: [u16; 256] = byte_table();
/// `Lⁿ` of each nibble of a checksum, for windows of `n` bytes.
static ZEROS: [[[u16; 16]; 4]; MAX_FRAME_LEN] = zeros_table();

const fn byte_table() -> [u16; 256] {
    let mut table = [0; 256];
    let mut byte = 0;
    while byte < 256 {
        let mut crc = byte as u16;
        let mut bit = 0;
        while bit < 8 {
            crc = if crc & 1 == 1 { crc >> 1 ^ POLYNOMIAL } else { crc >> 1 };
            bit += 1;
        }
        table[byte] = crc;
        byte += 1;
    }
    table
}

const fn zeros_table() -> [[[u16; 16]; 4]; MAX_FRAME_LEN] {
    let bytes = byte_table();
    let mut table = [[[0; 16]; 4]; MAX_FRAME_LEN];
    let mut n = 0;
    while n < MAX_FRAME_LEN {
        let mut entry = 0;
        while entry < 64 {
            let (nibble, value) = (entry / 16, entry % 16);
            table[n][nibble][value] = if n == 0 {
                (value as u16) << (4 * nibble)
            } else {
                let before: u16 = table[n - 1][nibble][value];
                before >> 8 ^ bytes[(before & 0xFF) as usize]
            };
            entry += 1;
        }
        n += 1;
    }
    table
}

/// The checksum behind one more byte.
pub(super) fn digest(crc: u16, byte: u8) -> u16 {
    crc >> 8 ^ BYTE[usize::from((crc ^ u16::from(byte)) as u8)]
}

/// The checksum of all of `bytes`.
pub(super) fn checksum(bytes: &[u8]) -> u16 {
    bytes.iter().fold(START, |crc, &byte| digest(crc, byte))
}

fn digest_zeros(crc: u16, n: usize) -> u16 {
    let [a, b, c, d] = &ZEROS[n];
    let nibble = |shift: u32| usize::from(crc >> shift & 0xF);
    a[nibble(0)] ^ b[nibble(4)] ^ c[nibble(8)] ^ d[nibble(12)]
}

/// What was digested of one run of bytes, of which a window is in sight. Positions count from the start of the run.
#[derive(Debug)]
pub(super) struct RunningCrc {
    /// Position of the first value.
    first: u64,
    /// `P` at `first` and behind it; never empty.
    values: Vec<u16>,
    /// Look-ups so far.
    #[cfg(test)]
    pub(super) cost: usize,
}

impl RunningCrc {
    /// Nothing is digested.
    pub(super) fn new() -> Self {
        Self {
            first: 0,
            values: vec![START],
            #[cfg(test)]
            cost: 0,
        }
    }

    /// Another run begins.
    pub(super) fn restart(&mut self) {
        self.first = 0;
        self.values.clear();
        self.values.push(START);
    }

    /// Checksum of `n` bytes, less than [`MAX_FRAME_LEN`], that begin `ahead` bytes behind the start of `window`. The window begins at
    /// position `at`; none before began behind it. `None` where the window ends before.
    pub(super) fn of(&mut self, window: &[u8], at: u64, ahead: usize, n: usize) -> Option<u16> {
        if n >= MAX_FRAME_LEN {
            return None;
        }
        self.forget(at);
        // Values in front of the window.
        let passed = usize::try_from(at.checked_sub(self.first)?).ok()?;
        self.digest_to(window, passed, ahead + n)?;
        #[cfg(test)]
        {
            self.cost += 4;
        }
        let before = self.values.get(passed + ahead)?;
        let behind = self.values.get(passed + ahead + n)?;
        Some(behind ^ digest_zeros(before ^ START, n))
    }

    fn digest_to(&mut self, window: &[u8], passed: usize, end: usize) -> Option<()> {
        let digested = (self.values.len() - 1).checked_sub(passed)?;
        if digested >= end {
            return Some(());
        }
        let bytes = window.get(digested..end)?;
        #[cfg(test)]
        {
            self.cost += bytes.len();
        }
        let mut crc = self.values.last().copied()?;
        self.values.extend(bytes.iter().map(|&byte| {
            crc = digest(crc, byte);
            crc
        }));
        Some(())
    }

    /// Lets go of what is not asked for again: now and then, so that what is kept is not moved for every byte.
    fn forget(&mut self, before: u64) {
        let passed = usize::try_from(before.saturating_sub(self.first)).unwrap_or(usize::MAX);
        if passed >= self.values.len() {
            // A stretch without a question was not digested. Any value will do to go on from.
            self.values.clear();
            self.values.push(START);
            self.first = before;
        } else if passed > self.values.len() / 2 + MAX_FRAME_LEN {
            self.values.drain(..passed);
            self.first = before;
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    #[test]
    fn the_check_value_of_the_catalogue() {
        assert_eq!(checksum(b"123456789"), 0x6F91);
    }

    proptest! {
        #[test]
        fn every_window_has_the_checksum_of_its_bytes(
            bytes in prop::collection::vec(any::<u8>(), 1..1500),
            questions in prop::collection::vec((0usize..400, 0usize..600, 0usize..280), 1..60),
        ) {
            let mut crc = RunningCrc::new();
            let mut at = 0;
            for (step, ahead, n) in questions {
                at = (at + step).min(bytes.len());
                let from = at + ahead;
                let expected = bytes.get(from..from + n).map(checksum);
                prop_assert_eq!(crc.of(&bytes[at..], at as u64, ahead, n), expected);
            }
            prop_assert!(crc.cost <= bytes.len() + 4 * 60);
        }

        #[test]
        fn the_mavlink_crate_agrees(bytes in prop::collection::vec(any::<u8>(), 0..280), extra in any::<u8>()) {
            prop_assert_eq!(digest(checksum(&bytes), extra), mavlink::calculate_crc(&bytes, extra));
        }
    }
}
