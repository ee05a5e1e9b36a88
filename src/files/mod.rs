//! Files that are written, and files that are trusted: one way for all.
//!
//! An output is written beside its place and renamed into it, so that its name is never seen with half of it: what was there stays
//! until the new one is whole, whether the disk is full, the program killed or the computer switched off. Nothing is written through
//! a link, and nothing is overwritten unless that is asked for. Every error names the file.

mod output;
mod trusted;

pub use output::{OutputFile, Overwrite, keep, write_whole};
pub use trusted::read_plain;

use std::io;
use std::path::Path;

/// Permissions of an output that anybody may read whom the user lets.
pub const READABLE: u32 = 0o666;
/// Permissions of a secret.
pub const SECRET: u32 = 0o600;

/// The same error with the file's name in front.
pub fn named(path: &Path, error: &io::Error) -> io::Error {
    io::Error::new(error.kind(), format!("{}: {}", path.display(), words(error)))
}

/// What the system says, without its number.
pub fn words(error: &io::Error) -> String {
    without_numbers(&error.to_string())
}

/// A text without the numbers of the system's errors in it: whoever reads that a file does not exist has no use for "(os error 2)".
pub fn without_numbers(text: &str) -> String {
    const BEGINS: &str = " (os error ";
    let mut pieces = text.split(BEGINS);
    let mut plain = pieces.next().unwrap_or_default().to_owned();
    for piece in pieces {
        match piece.split_once(')') {
            Some((number, rest)) if number.bytes().all(|b| b.is_ascii_digit()) => plain.push_str(rest),
            _ => plain.extend([BEGINS, piece]),
        }
    }
    plain
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn numbers_of_the_system_are_left_out_and_nothing_else() {
        let error = io::Error::from_raw_os_error(2);
        assert!(error.to_string().contains("(os error 2)"));
        assert_eq!(words(&error), "No such file or directory");
        let two = "a: gone (os error 2); b: full (os error 28), and more";
        assert_eq!(without_numbers(two), "a: gone; b: full, and more");
        for text in ["", "a (os error", "a (os error x) b", "a (os error 3", "(os) error"] {
            assert_eq!(without_numbers(text), text);
        }
    }
}
