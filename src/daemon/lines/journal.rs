//! systemd's journal, by its native protocol (systemd.io/JOURNAL_NATIVE_PROTOCOL): one datagram a line, fields as `NAME=value`.

use std::fs::File;
use std::io;
use std::os::unix::fs::MetadataExt;
use std::os::unix::net::UnixDatagram;

use tracing::Level;

/// Where the journal listens.
const SOCKET: &str = "/run/systemd/journal/socket";

/// A way to the journal. One that is restarted listens at the same place again.
#[derive(Debug)]
pub(super) struct Journal {
    socket: UnixDatagram,
}

impl Journal {
    /// Errors when there is no journal.
    pub(super) fn open() -> io::Result<Self> {
        let socket = UnixDatagram::unbound()?;
        socket.connect(SOCKET)?;
        Ok(Self { socket: UnixDatagram::unbound()? })
    }

    /// Writes one line.
    pub(super) fn write(&self, level: Level, text: &str) -> io::Result<()> {
        self.socket.send_to(datagram(level, text).as_bytes(), SOCKET).map(drop)
    }
}

/// Whether this is a stream that leads to the journal, as systemd has told in `JOURNAL_STREAM` (device:inode).
pub(super) fn leads_to_journal(stream: &File, journal_stream: Option<&str>) -> bool {
    let Ok(place) = stream.metadata() else { return false };
    journal_stream.is_some_and(|told| told == format!("{}:{}", place.dev(), place.ino()))
}

/// The text is of one line.
fn datagram(level: Level, text: &str) -> String {
    let priority = match level {
        Level::ERROR => 3,
        Level::WARN => 4,
        Level::INFO => 6,
        Level::DEBUG | Level::TRACE => 7,
    };
    format!("PRIORITY={priority}\nSYSLOG_IDENTIFIER=holdover\nMESSAGE={text}\n")
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_line_is_three_fields() {
        assert_eq!(
            datagram(Level::WARN, "no heartbeat"),
            "PRIORITY=4\nSYSLOG_IDENTIFIER=holdover\nMESSAGE=no heartbeat\n"
        );
    }

    #[test]
    fn the_stream_is_known_by_its_place() {
        let file = tempfile::tempfile().unwrap();
        let place = file.metadata().unwrap();
        let told = format!("{}:{}", place.dev(), place.ino());
        assert!(leads_to_journal(&file, Some(&told)));
        assert!(!leads_to_journal(&file, Some("8:1")) && !leads_to_journal(&file, None));
    }
}
