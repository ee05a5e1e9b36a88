//! A seeded mutator over a corpus: what fuzzing is on the stable toolchain.
#![allow(dead_code, reason = "not every user needs all of it")]

use std::path::{Path, PathBuf};

/// Inputs do not grow beyond this, bytes.
const LONGEST: usize = 4096;
/// Values that mean something in lengths, stamps and floating-point numbers.
const TELLING: [&[u8]; 12] = [
    &[0],
    &[0xFF],
    &[0xFE],
    &[0xFD],
    &[0x7F],
    &[0xFF, 0xFF, 0xFF, 0xFF],
    &[0, 0, 0, 0x80],
    &[0, 0, 0xC0, 0x7F],
    &[0, 0, 0x80, 0x7F],
    &[0, 0, 0, 0, 0, 0, 0, 0],
    &[0xFF, 0xFF, 0xFF, 0xFF, 0xFF, 0xFF, 0xFF, 0xFF],
    &[0xFD, 0xFF, 0, 0, 0, 1, 1, 105, 0, 0],
];

/// `SplitMix64` (Steele, Lea, Flood 2014): the same seed gives the same inputs everywhere.
pub struct Dice(pub u64);

impl Dice {
    pub fn roll(&mut self) -> u64 {
        self.0 = self.0.wrapping_add(0x9E37_79B9_7F4A_7C15);
        let z = (self.0 ^ (self.0 >> 30)).wrapping_mul(0xBF58_476D_1CE4_E5B9);
        let z = (z ^ (z >> 27)).wrapping_mul(0x94D0_49BB_1331_11EB);
        z ^ (z >> 31)
    }

    /// One of `n` numbers from 0.
    pub fn below(&mut self, n: usize) -> usize {
        (self.roll() % n.max(1) as u64) as usize
    }
}

/// The inputs that a target begins with, in the order of their names.
pub fn corpus(target: &str) -> Vec<(PathBuf, Vec<u8>)> {
    let folder = Path::new(env!("CARGO_MANIFEST_DIR")).join("tests/fuzz/corpus").join(target);
    let mut all: Vec<_> = std::fs::read_dir(&folder)
        .into_iter()
        .flatten()
        .filter_map(|entry| Some(entry.ok()?.path()))
        .filter_map(|path| Some((path.clone(), std::fs::read(path).ok()?)))
        .collect();
    all.sort();
    all
}

/// Another input, made of those of the corpus.
pub fn mutated(dice: &mut Dice, corpus: &[(PathBuf, Vec<u8>)]) -> Vec<u8> {
    let pick =
        |dice: &mut Dice| corpus.get(dice.below(corpus.len())).map(|(_, b)| b.clone()).unwrap_or_default();
    let mut bytes = pick(dice);
    for _ in 0..1 + dice.below(8) {
        let at = dice.below(bytes.len() + 1);
        match dice.below(9) {
            0 | 1 => replace(&mut bytes, at, &[dice.roll() as u8]),
            2 => {
                let flipped = bytes.get(at).map_or(0, |b| b ^ 1 << dice.below(8));
                replace(&mut bytes, at, &[flipped]);
            }
            3 => replace(&mut bytes, at, TELLING[dice.below(TELLING.len())]),
            4 => insert(&mut bytes, at, TELLING[dice.below(TELLING.len())]),
            5 => drop(bytes.drain(at..(at + dice.below(16)).min(bytes.len()))),
            6 => {
                let piece = bytes[at..(at + dice.below(64)).min(bytes.len())].to_vec();
                let to = dice.below(bytes.len() + 1);
                insert(&mut bytes, to, &piece);
            }
            7 => {
                let other = pick(dice);
                let from = dice.below(other.len());
                let piece = &other[from..(from + dice.below(256)).min(other.len())];
                insert(&mut bytes, at, piece);
            }
            _ => insert(&mut bytes, at, &dice.roll().to_le_bytes()),
        }
    }
    bytes.truncate(LONGEST);
    bytes
}

fn replace(bytes: &mut [u8], at: usize, with: &[u8]) {
    for (byte, new) in bytes.iter_mut().skip(at).zip(with) {
        *byte = *new;
    }
}

fn insert(bytes: &mut Vec<u8>, at: usize, piece: &[u8]) {
    drop(bytes.splice(at..at, piece.iter().copied()));
}

/// Runs a target over an input; what it did not stand.
///
/// # Errors
/// The words of the panic.
pub fn tried(run: fn(&[u8]) -> u64, bytes: &[u8]) -> Result<u64, String> {
    std::panic::catch_unwind(|| run(bytes)).map_err(|panic| {
        let text = panic.downcast_ref::<String>().cloned();
        text.or_else(|| panic.downcast_ref::<&str>().map(|t| (*t).to_owned())).unwrap_or_default()
    })
}
