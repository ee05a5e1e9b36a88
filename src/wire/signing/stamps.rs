//! Stamps on disk: what was heard and sent is neither taken nor sent again by the next process.
//!
//! A thread keeps them every second, and at once when a stream opens. What may come until it does so again is kept as if it had come: a process
//! that is killed forgets nothing. Of a stream that is as much as came in the last second, twice, and no more than two seconds of time: an
//! autopilot without the time of day counts its frames instead, and must not be shut out for hours. At an orderly end the stamps are exact.

use std::io;
use std::path::{Path, PathBuf};
use std::sync::Arc;
use std::sync::mpsc::{RecvTimeoutError, Sender, channel};
use std::thread::JoinHandle;
use std::time::Duration;

use serde::{Deserialize, Serialize};

use super::gate::SigningGate;
use super::signature::SigningStamp;
use super::streams::{HeardStream, MOST_STREAMS, StampBook};
use crate::files::{keep, read_plain};

/// Version of the file.
const VERSION: u32 = 1;
/// Name in the folder of states.
const NAME: &str = "signing.json";
/// No such file is larger.
const MOST_BYTES: u64 = 64 * 1024;
/// Looking whether a stream has opened.
const LOOK: Duration = Duration::from_millis(50);
/// So many looks between two times of keeping: a second.
const LOOKS: u32 = 20;
/// The most that is kept beyond what came, 10 µs.
const MOST_MARGIN: u64 = 2 * SigningStamp::PER_SECOND;

/// The file's content.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub(super) struct KeptStamps {
    version: u32,
    /// Of which key: another's stamps are of no interest.
    key_id: String,
    /// No stamp of ours is greater.
    sent: u64,
    heard: Vec<HeardStream>,
}

impl KeptStamps {
    /// What the next process begins with.
    pub(super) fn book(&self) -> StampBook {
        let mut heard = self.heard.clone();
        heard.truncate(MOST_STREAMS);
        StampBook { heard, newest: SigningStamp(self.sent).min(SigningStamp::LAST) }
    }
}

/// What came between two times of keeping.
#[derive(Debug, Default)]
pub(super) struct Margins {
    pub(super) opened: bool,
    before: Vec<HeardStream>,
}

impl Margins {
    /// What is to be kept of a book.
    pub(super) fn kept(&mut self, book: &StampBook, key_id: String, at_the_end: bool) -> KeptStamps {
        let margin = |s: &HeardStream| {
            let before = self.before.iter().find(|b| b.name == s.name).map_or(s.last, |b| b.last);
            (2 * s.last.saturating_sub(before)).min(MOST_MARGIN)
        };
        let ahead =
            |s: &HeardStream| HeardStream { last: s.last + if at_the_end { 0 } else { margin(s) }, ..*s };
        let heard = book.heard.iter().map(ahead).collect();
        let sent = if at_the_end { book.newest } else { book.newest.after(MOST_MARGIN) }.0;
        self.before.clone_from(&book.heard);
        self.opened = false;
        KeptStamps { version: VERSION, key_id, sent, heard }
    }
}

/// Why stamps cannot be kept.
#[derive(Debug, thiserror::Error)]
pub enum StampsError {
    /// There is no place for them.
    #[error("the stamps of signatures cannot be kept, and old frames could be replayed: {0}")]
    NoPlace(io::Error),
}

/// Keeps the stamps of a gate until it is dropped.
#[derive(Debug)]
pub struct StampKeeper {
    end: Option<Sender<()>>,
    thread: Option<JoinHandle<()>>,
}

impl StampKeeper {
    /// Where stamps are kept: in the folder of states, or beside the key.
    pub fn place(states: Option<&Path>, key_file: &Path) -> PathBuf {
        match states {
            Some(folder) => folder.join(NAME),
            None => {
                let mut name = key_file.as_os_str().to_owned();
                name.push(".stamps.json");
                name.into()
            }
        }
    }

    /// Goes on from what is in the place, and begins to keep. The sentence is about what is there and cannot be used.
    ///
    /// # Errors
    /// [`StampsError`]: the place cannot be written.
    pub fn start(gate: Arc<SigningGate>, place: PathBuf) -> Result<(Self, Option<String>), StampsError> {
        let told = Self::recall(&gate, &place).err();
        write(&place, &gate.keepable(false)).map_err(StampsError::NoPlace)?;
        let (end, ended) = channel();
        let keeping = move || {
            let (mut troubled, mut looks) = (false, 0);
            loop {
                let at_the_end = !matches!(ended.recv_timeout(LOOK), Err(RecvTimeoutError::Timeout));
                looks += 1;
                if !at_the_end && looks < LOOKS && !gate.has_opened() {
                    continue;
                }
                looks = 0;
                if let Err(e) = write(&place, &gate.keepable(at_the_end))
                    && !std::mem::replace(&mut troubled, true)
                {
                    tracing::warn!("the stamps of signatures cannot be kept: {e}");
                }
                if at_the_end {
                    return;
                }
            }
        };
        let thread = std::thread::Builder::new().name("stamps".to_owned()).spawn(keeping);
        Ok((Self { end: Some(end), thread: Some(thread.map_err(StampsError::NoPlace)?) }, told))
    }

    /// Goes on from what is in the place, once, and keeps nothing.
    ///
    /// # Errors
    /// A sentence about what is there and cannot be used.
    pub fn recall(gate: &SigningGate, place: &Path) -> Result<(), String> {
        let mut bytes = Vec::new();
        match read_plain(place, MOST_BYTES, &mut bytes) {
            Err(e) if e.kind() == io::ErrorKind::NotFound => return Ok(()),
            Err(e) => return Err(unusable(place, &e.to_string())),
            Ok(_) => {}
        }
        let kept: KeptStamps = serde_json::from_slice(&bytes).map_err(|e| unusable(place, &e.to_string()))?;
        if kept.version != VERSION {
            return Err(unusable(place, "it is of another version"));
        }
        if gate.key().is_some_and(|key| key.id() == kept.key_id) {
            gate.recall(&kept);
        }
        Ok(())
    }
}

fn unusable(place: &Path, why: &str) -> String {
    format!("{}: {why}; frames of the last minute could be replayed", place.display())
}

fn write(place: &Path, kept: &KeptStamps) -> io::Result<()> {
    keep(place, &serde_json::to_vec(kept)?)
}

impl Drop for StampKeeper {
    /// The last are kept as they are.
    fn drop(&mut self) {
        self.end = None;
        if let Some(thread) = self.thread.take() {
            drop(thread.join());
        }
    }
}
