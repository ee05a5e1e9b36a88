//! The daemon's log: lines that never hold up who tells them.
//!
//! A line is judged by the limit of its kind, put into a bounded queue, and written by a thread of its own to standard error or to the
//! journal. A sink that blocks, fails or is gone costs lines, which are counted, and nothing else.

mod journal;
mod layer;
mod limit;
mod queue;

pub use layer::{LinesError, LogHandle, start};
