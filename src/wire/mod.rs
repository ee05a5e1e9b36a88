//! The only room that knows MAVLink: links, tlogs, decoding to [`crate::sample`], encoding of [`crate::outbound`], time
//! synchronisation and stream requests.

pub mod clock;
pub mod counters;
pub mod decode;
pub mod frame;
pub mod tlog;
