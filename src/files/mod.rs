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
fn words(error: &io::Error) -> String {
    let text = error.to_string();
    text.split(" (os error").next().unwrap_or(&text).to_owned()
}
