//! What the tests of the daemon share: a `holdover` process, a recorded flight to feed it with, and what it sent.
#![allow(dead_code, reason = "each test crate uses a part of this")]

pub mod flight;
pub mod process;
pub mod pymavlink;
pub mod terminal;
