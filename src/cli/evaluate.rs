//! `holdover evaluate`: outages slid over logs, in one table.

use std::path::PathBuf;

use clap::Args;

use super::{ConfigArgs, Failure};

/// Arguments of `evaluate`.
#[derive(Debug, Args)]
pub struct EvaluateArgs {
    /// Telemetry logs
    #[arg(required = true)]
    pub logs: Vec<PathBuf>,
    /// Settings
    #[command(flatten)]
    pub settings: ConfigArgs,
}

/// Runs the command.
///
/// # Errors
/// [`Failure`].
pub fn run(_args: &EvaluateArgs) -> Result<(), Failure> {
    Ok(())
}
