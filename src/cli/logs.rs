//! Which logs a command is to work on.

use std::path::PathBuf;

use clap::Args;

use crate::fleet;
use crate::log::{LogError, LogFile, logs_in};

use super::Failure;

/// Logs as arguments.
#[derive(Clone, Debug, Args)]
pub struct LogArgs {
    /// Logs, folders of logs, addresses (s3://, gs://, az://, http(s)://), or - for standard input: MAVLink (.tlog, .tlog.raw), PX4 ULog (.ulg), ArduPilot DataFlash (.bin), each also gzip or zstd
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
        find(&self.logs, self.recursive)
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

/// The logs that paths and addresses name.
///
/// # Errors
/// [`Failure::Log`] for a folder without a log, and for what cannot be listed.
pub(super) fn find(names: &[PathBuf], recursive: bool) -> Result<Vec<LogFile>, Failure> {
    let mut logs = Vec::new();
    for name in names {
        match name.to_str().filter(|name| fleet::is_address(name)) {
            Some(address) => {
                let found = fleet::logs_at(address, recursive);
                logs.extend(found.map_err(|source| LogError::Io { path: name.clone(), source })?);
            }
            None => logs.extend(logs_in(std::slice::from_ref(name), recursive)?),
        }
    }
    Ok(logs)
}
