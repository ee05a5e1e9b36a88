//! Evaluations of many logs: which share of a list is worked on, what was done before, results in Parquet, and what all shards
//! say together.
//!
//! A shard keeps a journal while it works, a line a log, so that a kill costs the logs under way and nothing else. When all of its logs are
//! done, its results become one Parquet file, which is there whole or not at all. The columns stand in `docs/src/fleet.md`.

mod address;
mod columns;
mod exact;
mod folder;
mod journal;
mod list;
mod outcome;
mod recipe;
mod shard;
#[cfg(feature = "object-store")]
mod store;
#[cfg(not(feature = "object-store"))]
#[path = "no_store.rs"]
mod store;

pub use address::is_address;
use columns::{ResultsReader, ResultsWriter};
pub use folder::{ShardWork, merged};
use journal::OutcomeJournal;
pub use list::listed;
pub use outcome::{LogFailure, LogOutcome, NaturalLoss, OutageRow, Unusable};
pub use recipe::{Provenance, Recipe};
pub use shard::Shard;
pub use store::logs_at;

use std::io;
use std::path::PathBuf;

/// Why results cannot be kept or read.
#[derive(Debug, thiserror::Error)]
pub enum FleetError {
    /// The system's word; the file is named.
    #[error("{0}")]
    Io(#[from] io::Error),
    /// A file of results cannot be understood.
    #[error("{path}: no results of holdover evaluate: {why}")]
    NotResults {
        /// The file.
        path: PathBuf,
        /// What is wrong with it.
        why: String,
    },
    /// Results that do not belong together.
    #[error("{0}")]
    Mixed(String),
    /// Another process works on the same shard.
    #[error("{path}: another run works on this shard")]
    Busy {
        /// Its journal.
        path: PathBuf,
    },
}
