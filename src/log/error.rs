//! Why a log cannot be used.

use std::io;
use std::path::PathBuf;

use crate::files::words;

/// Why a log cannot be used.
#[derive(Debug, thiserror::Error)]
pub enum LogError {
    /// It cannot be opened or read.
    #[error("{path}: {}", words(source))]
    Io {
        /// The file.
        path: PathBuf,
        /// What the system said.
        source: io::Error,
    },
    /// It is a directory.
    #[error("{path}: this is a directory without a log in it{more}")]
    Directory {
        /// The folder.
        path: PathBuf,
        /// What may help.
        more: &'static str,
    },
    /// There is nothing in it.
    #[error("{path}: the file is empty")]
    Empty {
        /// The file.
        path: PathBuf,
    },
    /// It is something else.
    #[error("{path}: no log: {hint}")]
    NotALog {
        /// The file.
        path: PathBuf,
        /// What it seems to be.
        hint: String,
    },
    /// No autopilot speaks in it.
    #[error("{path}: {frames} frames, but no heartbeat of {wanted}; systems heard: {heard}")]
    NoVehicle {
        /// The file.
        path: PathBuf,
        /// Frames read.
        frames: u64,
        /// Which autopilot was wanted.
        wanted: String,
        /// Which systems there are.
        heard: String,
    },
}
