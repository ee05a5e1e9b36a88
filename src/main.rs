//! The `holdover` command. See `holdover --help`.

use std::process::ExitCode;

fn main() -> ExitCode {
    holdover::cli::main()
}
