//! Object stores in a program that was built without what fetches from them.

use std::io;

use crate::log::LogFile;

/// Refuses an address.
///
/// # Errors
/// Always, with how to build a program that can.
pub fn logs_at(_address: &str, _recursive: bool) -> io::Result<Vec<LogFile>> {
    let why = "this program was built without object stores: cargo build --release --features object-store";
    Err(io::Error::new(io::ErrorKind::Unsupported, why))
}
