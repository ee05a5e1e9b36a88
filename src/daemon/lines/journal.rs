//! systemd's journal, by its native protocol (systemd.io/JOURNAL_NATIVE_PROTOCOL): one datagram a line, fields as `NAME=value`.

use std::fs::File;
use std::io;
use std::os::unix::fs::MetadataExt;
use std::os::unix::net::UnixDatagram;
use std::path::{Path, PathBuf};

use tracing::Level;

/// Where the journal listens.
pub(super) const SOCKET: &str = "/run/systemd/journal/socket";

/// A way to the journal. One that is restarted listens at the same place again.
#[derive(Debug)]
pub(super) struct Journal {
    socket: UnixDatagram,
    at: PathBuf,
}

impl Journal {
    /// Errors when there is no journal at this place.
    pub(super) fn open(at: &Path) -> io::Result<Self> {
        UnixDatagram::unbound()?.connect(at)?;
        Ok(Self { socket: UnixDatagram::unbound()?, at: at.to_owned() })
    }

    /// Writes one line.
    pub(super) fn write(&self, level: Level, text: &str) -> io::Result<()> {
        self.socket.send_to(datagram(level, text).as_bytes(), &self.at).map(drop)
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
    fn a_journal_is_written_to_that_is_restarted_meanwhile() {
        let folder = tempfile::tempdir().unwrap();
        let at = folder.path().join("socket");
        assert!(Journal::open(&at).is_err(), "there is none");
        let listener = UnixDatagram::bind(&at).unwrap();
        let journal = Journal::open(&at).unwrap();
        let heard = |listener: &UnixDatagram| {
            let mut buffer = [0; 65_536];
            let n = listener.recv(&mut buffer).unwrap();
            String::from_utf8(buffer[..n].to_vec()).unwrap()
        };
        journal.write(Level::ERROR, "autopilot silent for 3.0 s").unwrap();
        let first = heard(&listener);
        assert_eq!(first, "PRIORITY=3\nSYSLOG_IDENTIFIER=holdover\nMESSAGE=autopilot silent for 3.0 s\n");
        // The longest line there is, of the longest characters.
        let long = "\u{1F681}".repeat(super::super::layer::LONGEST);
        journal.write(Level::INFO, &long).unwrap();
        assert!(heard(&listener).ends_with(&format!("MESSAGE={long}\n")));
        drop(listener);
        assert!(journal.write(Level::INFO, "nobody listens").is_err());
        std::fs::remove_file(&at).unwrap();
        let listener = UnixDatagram::bind(&at).unwrap();
        journal.write(Level::INFO, "again").unwrap();
        assert!(heard(&listener).contains("MESSAGE=again\n"));
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
