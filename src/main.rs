//! The `holdover` command. See `holdover --help`.

use std::process::ExitCode;

use clap::Parser;
use holdover::cli::{self, Cli};

fn main() -> ExitCode {
    match cli::run(Cli::parse()) {
        Ok(()) => ExitCode::SUCCESS,
        Err(failure) => {
            eprintln!("holdover: {failure}");
            ExitCode::from(failure.exit_code())
        }
    }
}
