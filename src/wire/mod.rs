//! The only room that knows MAVLink: links, tlogs, decoding to [`crate::sample`], encoding of [`crate::outbound`], time
//! synchronisation and stream requests.

pub mod clock;
pub mod companion_clock;
pub mod counters;
pub mod decode;
pub mod encode;
pub mod encode_vehicle;
pub mod endpoint;
pub mod frame;
pub mod frame_bytes;
pub mod link;
pub mod protocol;
pub mod tlog;
pub mod tlog_writer;
