//! Printing to standard output. A reader that has seen enough (`holdover inspect LOG | head`) ends the command, quietly: `println!`
//! would panic.

use std::fmt;
use std::io::{self, ErrorKind, Write};

/// Prints one line. Ends the process when it cannot.
pub(super) fn line(text: fmt::Arguments<'_>) {
    let mut out = io::stdout().lock();
    match out.write_fmt(text).and_then(|()| out.write_all(b"\n")) {
        Ok(()) => {}
        Err(e) if e.kind() == ErrorKind::BrokenPipe => std::process::exit(0),
        Err(e) => {
            let _ = writeln!(io::stderr(), "holdover: standard output: {e}");
            std::process::exit(1);
        }
    }
}

/// `println!` without its panic.
macro_rules! outln {
    ($($text:tt)*) => { $crate::cli::output::line(format_args!($($text)*)) };
}
