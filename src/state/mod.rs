//! What survives the process: the navigation's state in a file, written every second, and whether it may be gone on from.
//!
//! The file is JSON with a version, of bounded size. It is written beside its place and renamed over it, so it is whole or the one before;
//! a link in its place is replaced, never followed. It is not forced to the disk: a process that is killed loses nothing by that, and a
//! computer that loses its power takes longer to start than a state is good for; what a crash may leave is refused as what it is.

mod directory;
mod file;
mod going_on;
mod kept;

pub use directory::StateDirectory;
pub use file::{MOST_BYTES, StateFile, read, served_lately};
pub use going_on::{Moment, go_on};
pub use kept::{Boot, KeptState, StateError};
