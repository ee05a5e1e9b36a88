//! The file: read with care, written by a thread of its own.

use std::io;
use std::path::{Path, PathBuf};
use std::sync::mpsc::{Receiver, SyncSender, TrySendError, sync_channel};
use std::time::Duration;

use super::kept::{KeptState, StateError};
use crate::files::{keep, read_plain};
use crate::wire::frame::SystemId;

/// No state is larger.
pub const MOST_BYTES: u64 = 256 * 1024;

/// Who was served so long ago, µs, is still looked for.
const LATELY_US: i64 = 60_000_000;

fn path_of(folder: &Path, system: SystemId) -> PathBuf {
    folder.join(format!("system-{}.json", system.0))
}

/// Reads what was kept of a system.
///
/// # Errors
/// [`StateError`]: whatever is in the file's place, it is told and not followed.
pub fn read(folder: &Path, system: SystemId) -> Result<KeptState, StateError> {
    let mut bytes = Vec::new();
    match read_plain(&path_of(folder, system), MOST_BYTES, &mut bytes) {
        Ok(_) => {}
        Err(e) => {
            return Err(match e.kind() {
                io::ErrorKind::NotFound => StateError::None,
                io::ErrorKind::InvalidInput => StateError::NotAFile,
                io::ErrorKind::FileTooLarge => StateError::TooLarge,
                _ => StateError::Read(e),
            });
        }
    }
    KeptState::decode(&bytes)
}

/// The system that was served last, if that was within a minute before `unix_us`: a process that is started anew in flight knows whom to
/// look for.
pub fn served_lately(folder: &Path, unix_us: i64) -> Option<SystemId> {
    let systems = (1..=u8::MAX).map(SystemId);
    let kept = systems.filter_map(|s| read(folder, s).ok().map(|kept| (unix_us - kept.kept_us(), s)));
    kept.filter(|(ago, _)| (0..=LATELY_US).contains(ago)).min().map(|(_, system)| system)
}

/// Where the state of one system is written. A disk that is slow or full costs the state, and never the navigation.
#[derive(Debug)]
pub struct StateFile {
    states: Option<SyncSender<Box<KeptState>>>,
    /// Says nothing, and ends with the thread.
    ended: Receiver<()>,
}

/// How long a disk may take for the last state when the process ends.
const LAST_STATE: Duration = Duration::from_millis(40);

impl StateFile {
    /// Begins a thread that writes into `folder`.
    ///
    /// # Errors
    /// The system has no thread to give.
    pub fn open(folder: PathBuf, system: SystemId) -> io::Result<Self> {
        // What waits while one is written is the newest but one at worst.
        let (states, waiting) = sync_channel::<Box<KeptState>>(1);
        let path = path_of(&folder, system);
        let (ends, ended) = sync_channel::<()>(0);
        std::thread::Builder::new().name("state".to_owned()).spawn(move || {
            let _ends = ends;
            let mut told = false;
            for kept in waiting {
                if let Err(e) = kept.encode().map_err(io::Error::from).and_then(|bytes| keep(&path, &bytes))
                    && !std::mem::replace(&mut told, true)
                {
                    tracing::warn!("the state cannot be kept: {e}");
                }
            }
        })?;
        Ok(Self { states: Some(states), ended })
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
    /// What waits is written first, where the disk is not slow.
    fn drop(&mut self) {
        self.states = None;
        let _ = self.ended.recv_timeout(LAST_STATE);
    }
}
