//! `holdover completions` and `holdover man`: what a package has besides the program.

use std::path::PathBuf;

use clap::{Args, CommandFactory};
use clap_complete::Shell;

use crate::files::named;

use super::{Cli, Failure};

/// Arguments of `completions`.
#[derive(Debug, Args)]
pub struct CompletionsArgs {
    /// For which shell
    pub shell: Shell,
}

/// Arguments of `man`.
#[derive(Debug, Args)]
pub struct ManArgs {
    /// The folder for the pages, which is made if it is not there
    pub folder: PathBuf,
}

/// Prints the completions of a shell.
pub fn completions(args: &CompletionsArgs) {
    let mut text = Vec::new();
    clap_complete::generate(args.shell, &mut Cli::command(), "holdover", &mut text);
    outln!("{}", String::from_utf8_lossy(&text).trim_end());
}

/// Writes the manual's pages: one of the program, one a command.
///
/// # Errors
/// The system's word.
pub fn man(args: &ManArgs) -> Result<(), Failure> {
    let wrong = |e: std::io::Error| Failure::from(named(&args.folder, &e));
    std::fs::create_dir_all(&args.folder).map_err(wrong)?;
    clap_mangen::generate_to(Cli::command(), &args.folder).map_err(wrong)
}
