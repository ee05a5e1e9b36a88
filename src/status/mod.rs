//! What a person or a monitoring system sees of a running daemon: a page, an API and metrics, to be read only.
//!
//! The navigation hands over copies ([`StatusFeed`]) and never waits. Everything else happens on a thread of its own ([`StatusServer`]), where whoever
//! asks is bounded in what he can ask for: connections, their time, the size of a request. Nothing that comes in changes anything, and every
//! text goes out as JSON, which the page shows as text.

mod board;
mod feed;
mod front;
mod guard;
mod metrics;
mod rates;
mod routes;
mod server;
mod show;
pub mod view;

pub use feed::{FeedItem, StatusFeed};
pub use front::StatusFront;
pub use server::{StatusError, StatusServer};
pub use show::{Glance, show};
