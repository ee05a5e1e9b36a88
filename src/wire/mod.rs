//! The only room that knows MAVLink: links, tlogs, decoding to [`crate::sample`], encoding of [`crate::outbound`], and
//! the conversation with the autopilot. [`messages`] is the table of what is heard, asked for and sent.

pub mod clock;
pub mod companion_clock;
pub mod counters;
pub mod decode;
pub mod encode;
pub mod encode_vehicle;
pub mod endpoint;
pub mod frame;
pub mod frame_bytes;
pub mod gnss_integrity;
pub mod link;
pub mod messages;
pub mod read_ahead;
pub mod recording;
mod running_crc;
pub mod session;
pub mod signing;
pub mod tlog;
pub mod tlog_writer;
