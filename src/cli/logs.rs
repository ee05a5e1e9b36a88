//! Which logs a command is to work on.

use std::path::PathBuf;

use clap::Args;

use crate::log::{LogFile, logs_in};

use super::Failure;

/// Logs as arguments.
#[derive(Clone, Debug, Args)]
pub struct LogArgs {
    /// Logs, folders of logs, or - for standard input: MAVLink (.tlog, .tlog.raw), PX4 ULog (.ulg), ArduPilot DataFlash (.bin), each also gzip or zstd
    #[arg(required = true, value_name = "LOG")]
    pub logs: Vec<PathBuf>,
    /// Look for logs in the folders below as well
    #[arg(long)]
    pub recursive: bool,
}

impl LogArgs {
    /// The files.
    ///
    /// # Errors
    /// [`Failure::Log`] for a folder without a log.
    pub(super) fn find(&self) -> Result<Vec<LogFile>, Failure> {
        Ok(logs_in(&self.logs, self.recursive)?)
    }

    /// Does `work` on each of them. One that fails is told, and the others are worked on all the same.
    ///
    /// # Errors
    /// The last failure.
    pub(super) fn each(
        &self,
        json: bool,
        work: impl Fn(&LogFile, bool) -> Result<(), Failure>,
    ) -> Result<(), Failure> {
        let logs = self.find()?;
        let mut failed: Option<Failure> = None;
        for (i, log) in logs.iter().enumerate() {
            if i > 0 && !json {
                outln!("");
            }
            if let Err(failure) = work(log, logs.len() > 1)
                && let Some(before) = failed.replace(failure)
            {
                errln!("holdover: {before}");
            }
        }
        failed.map_or(Ok(()), Err)
    }
}
