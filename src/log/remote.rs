//! Logs that are elsewhere, and are brought here when they are read.

use std::fmt;
use std::io::{self, Read};

/// A log that somebody can bring.
pub trait RemoteLog: fmt::Debug + Send + Sync {
    /// What tells it from another one in the same place: its tag, or its size and time of change.
    ///
    /// # Errors
    /// What whoever has it says.
    fn identity(&self) -> io::Result<String>;

    /// Its bytes, from the beginning, once.
    ///
    /// # Errors
    /// What whoever has it says.
    fn open(&self) -> io::Result<Box<dyn Read>>;
}
