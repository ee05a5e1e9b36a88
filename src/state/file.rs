//! The file: read with care, written by a thread of its own.

use std::fs::{self, File, OpenOptions};
use std::io::{self, Read, Write};
use std::os::unix::fs::{MetadataExt, OpenOptionsExt};
use std::path::{Path, PathBuf};
use std::sync::mpsc::{SyncSender, TrySendError, sync_channel};
use std::thread::JoinHandle;

use super::kept::{KeptState, StateError};
use crate::wire::frame::SystemId;

/// No state is larger.
pub const MOST_BYTES: u64 = 256 * 1024;

fn path_of(folder: &Path, system: SystemId) -> PathBuf {
    folder.join(format!("system-{}.json", system.0))
}

/// Reads what was kept of a system.
///
/// # Errors
/// [`StateError`]: whatever is in the file's place, it is told and not followed.
pub fn read(folder: &Path, system: SystemId) -> Result<KeptState, StateError> {
    let path = path_of(folder, system);
    let place = match fs::symlink_metadata(&path) {
        Err(e) if e.kind() == io::ErrorKind::NotFound => return Err(StateError::None),
        place => place?,
    };
    if !place.is_file() {
        return Err(StateError::NotAFile);
    }
    let file = File::open(&path)?;
    let opened = file.metadata()?;
    // What was looked at is what was opened, and no link that has taken its place since.
    if (opened.dev(), opened.ino()) != (place.dev(), place.ino()) {
        return Err(StateError::NotAFile);
    }
    let mut bytes = Vec::new();
    file.take(MOST_BYTES + 1).read_to_end(&mut bytes)?;
    if bytes.len() as u64 > MOST_BYTES {
        return Err(StateError::TooLarge);
    }
    KeptState::decode(&bytes)
}

/// Writes beside the file's place, and renames over it.
fn write(folder: &Path, system: SystemId, kept: &KeptState) -> io::Result<()> {
    let bytes = kept.encode()?;
    let path = path_of(folder, system);
    let beside = path.with_extension("json.new");
    // One that was killed in between has left it; a link there is removed and not followed.
    match fs::remove_file(&beside) {
        Err(e) if e.kind() != io::ErrorKind::NotFound => return Err(e),
        _ => {}
    }
    let mut file = OpenOptions::new().write(true).create_new(true).mode(0o600).open(&beside)?;
    file.write_all(&bytes)?;
    drop(file);
    fs::rename(&beside, &path)
}

/// Where the state of one system is written. A disk that is slow or full costs the state, and never the navigation.
#[derive(Debug)]
pub struct StateFile {
    states: Option<SyncSender<Box<KeptState>>>,
    thread: Option<JoinHandle<()>>,
}

impl StateFile {
    /// Begins a thread that writes into `folder`.
    ///
    /// # Errors
    /// The system has no thread to give.
    pub fn open(folder: PathBuf, system: SystemId) -> io::Result<Self> {
        // What waits while one is written is the newest but one at worst.
        let (states, waiting) = sync_channel::<Box<KeptState>>(1);
        let thread = std::thread::Builder::new().name("state".to_owned()).spawn(move || {
            let mut told = false;
            for kept in waiting {
                if let Err(e) = write(&folder, system, &kept)
                    && !std::mem::replace(&mut told, true)
                {
                    tracing::warn!("the state cannot be kept in {}: {e}", folder.display());
                }
            }
        })?;
        Ok(Self { states: Some(states), thread: Some(thread) })
    }

    /// Hands a state over to be written; one that comes while the disk is busy is left out.
    pub fn keep(&self, kept: KeptState) {
        let Some(states) = &self.states else { return };
        if let Err(TrySendError::Full(_)) = states.try_send(Box::new(kept)) {
            tracing::debug!("the disk is slow: a state was left out");
        }
    }
}

impl Drop for StateFile {
    /// What waits is written first.
    fn drop(&mut self) {
        self.states = None;
        if let Some(thread) = self.thread.take() {
            drop(thread.join());
        }
    }
}
