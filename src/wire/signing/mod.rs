//! MAVLink 2 message signing, in and out, after <https://mavlink.io/en/guide/message_signing.html>.
//!
//! A signed frame carries a link id, a stamp (10 µs since 2015) and the first 48 bits of SHA-256 over the key, the frame, the link id
//! and the stamp. [`SigningGate`] stands in every link: what comes in passes it before anything else sees it, what goes out is signed
//! there. The rules are the protocol's:
//!
//! - A signature that does not fit is refused, and what carries none as [`AcceptUnsigned`] says.
//! - Stamps of one stream (system, component, link id) increase strictly; what comes a second time is a replay.
//! - A stream that is new may not be more than a minute behind the newest stamp known here.
//! - Our own stamp follows the companion's time of day and the newest stamp heard, and never comes twice.
//!
//! What is known of stamps is kept on disk, so a replay is refused after a restart, too.
//!
//! The mavlink crate signs as well, but keeps its stamps in memory only, tells no reason, compares in variable time and leaves keys in
//! memory; hence this.

mod gate;
mod key;
mod key_file;
mod open;
mod setup;
mod signature;
mod stamps;
mod streams;
mod watch;

pub use gate::{AcceptUnsigned, SigningCounts, SigningGate, SigningSettings};
pub use key::{KeyError, SigningKey};
pub use key_file::{KeyFileError, read_key, write_key};
pub use open::{Signing, SigningError};
pub use setup::{is_signed_with, setup_signing};
pub use signature::SigningStamp;
pub use stamps::StampsError;
pub use watch::SigningWatch;
