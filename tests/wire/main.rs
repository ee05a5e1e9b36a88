//! Links and the daemon over real sockets and pseudo-terminals.
#![allow(
    clippy::unwrap_used,
    clippy::expect_used,
    clippy::panic,
    reason = "helpers of tests may fail like tests"
)]

mod browser;
mod daemon;
mod day_in_the_air;
mod double;
mod forged;
mod hand_over;
mod init;
mod links;
mod live;
mod page;
mod paused;
mod peers;
mod recording;
mod restart;
mod sensor_link;
mod signals;
mod signing;
