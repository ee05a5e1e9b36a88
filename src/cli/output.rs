//! Printing. A reader of standard output that has seen enough (`holdover inspect LOG | head`) ends the command, quietly; a disk that is full
//! ends it with 1. What cannot be written to standard error is lost. `println!` and `eprintln!` would panic.

use std::fmt;
use std::io::{self, ErrorKind, Write};
use std::sync::mpsc::sync_channel;
use std::thread;
use std::time::Duration;

use crate::files::{without_numbers, words};

/// How long the last words may take.
const PATIENCE: Duration = Duration::from_millis(500);

/// Prints one line. Ends the process when it cannot.
pub(super) fn line(text: fmt::Arguments<'_>) {
    piece(format_args!("{text}\n"));
}

/// The same of what is not yet a line.
pub(super) fn piece(text: fmt::Arguments<'_>) {
    let mut out = io::stdout().lock();
    match out.write_fmt(text) {
        Ok(()) => {}
        Err(e) if e.kind() == ErrorKind::BrokenPipe => std::process::exit(0),
        Err(e) => {
            let _ = writeln!(io::stderr(), "holdover: standard output: {}", words(&e));
            std::process::exit(1);
        }
    }
}

/// Tells one line on standard error, where that can be written; what the system says of a file in words alone.
pub(super) fn tell(text: fmt::Arguments<'_>) {
    let line = without_numbers(&format!("{text}\n"));
    let _ = io::stderr().lock().write_all(line.as_bytes());
}

/// Tells why the command ends, and waits for that only briefly: a daemon that is told to end must not be held up by who reads nothing.
/// Where it cannot be written, the exit code tells.
pub(super) fn last_words(text: &str) {
    let text = without_numbers(text);
    let (done, written) = sync_channel(1);
    let telling = move || {
        let _ = io::stderr().write_all(text.as_bytes());
        let _ = done.send(());
    };
    if thread::Builder::new().name("last words".to_owned()).spawn(telling).is_ok() {
        let _ = written.recv_timeout(PATIENCE);
    }
}

/// `eprintln!` without its panic.
macro_rules! errln {
    ($($text:tt)*) => { $crate::cli::output::tell(format_args!($($text)*)) };
}

/// `println!` without its panic.
macro_rules! outln {
    ($($text:tt)*) => { $crate::cli::output::line(format_args!($($text)*)) };
}

/// `print!` without its panic.
macro_rules! out {
    ($($text:tt)*) => { $crate::cli::output::piece(format_args!($($text)*)) };
}
