//! Runs golden files through the library: `cargo run --release --example golden -- FILE…`.
//!
//! One line a file with the largest deviation and its tolerance. Exits with 1 when a deviation is above its tolerance, with 2 when a file
//! cannot be read or is in no known format. The formats are described in `tests/golden/README.md`.

#[path = "../tests/support/golden/mod.rs"]
mod golden;

use std::io::Write;
use std::path::PathBuf;
use std::process::ExitCode;

fn main() -> ExitCode {
    let files: Vec<PathBuf> = std::env::args_os().skip(1).map(PathBuf::from).collect();
    if files.is_empty() {
        eprintln!("usage: golden FILE…");
        return ExitCode::from(2);
    }
    let mut code = 0;
    let mut out = std::io::stdout().lock();
    for path in &files {
        let line = match golden::run(path) {
            Ok(outcome) => {
                code = code.max(u8::from(!outcome.is_ok()));
                format!("{}: {outcome}", path.display())
            }
            Err(why) => {
                code = 2;
                eprintln!("{}: {why}", path.display());
                continue;
            }
        };
        // A reader that has gone away has seen what it wanted.
        if writeln!(out, "{line}").is_err() {
            break;
        }
    }
    ExitCode::from(code)
}
