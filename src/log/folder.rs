//! The logs of a folder.

use std::fs;
use std::io;
use std::path::{Path, PathBuf};

use super::{LogError, LogFile, recognised};

/// Folders below each other that are looked into: links may lead round in circles.
const MOST_DEPTH: usize = 32;

/// The logs that `paths` name: files as they are, standard input for `-`, of folders every file that is a log by its content, in the order of their names, with
/// `recursive` in folders below as well.
///
/// # Errors
/// A folder that cannot be read, or without a log; standard input or a pipe without one.
pub fn logs_in(paths: &[PathBuf], recursive: bool) -> Result<Vec<LogFile>, LogError> {
    let mut logs = Vec::new();
    for path in paths {
        if !path.is_dir() {
            logs.push(LogFile::at(path)?);
            continue;
        }
        let before = logs.len();
        let depth = if recursive { MOST_DEPTH } else { 0 };
        look_into(path, depth, &mut logs).map_err(|source| LogError::Io { path: path.clone(), source })?;
        if logs.len() == before {
            let more = if recursive { "" } else { " (--recursive looks into the folders below as well)" };
            return Err(LogError::Directory { path: path.clone(), more });
        }
    }
    Ok(logs)
}

fn look_into(folder: &Path, depth: usize, logs: &mut Vec<LogFile>) -> io::Result<()> {
    let mut entries: Vec<PathBuf> =
        fs::read_dir(folder)?.map(|e| e.map(|e| e.path())).collect::<io::Result<_>>()?;
    entries.sort();
    for path in entries {
        if path.is_dir() {
            if depth > 0 {
                look_into(&path, depth - 1, logs)?;
            }
        } else if let Some(log) = log_at(&path) {
            logs.push(log);
        }
    }
    Ok(())
}

/// A file among others, if it is a log; one that cannot be read is none.
fn log_at(path: &Path) -> Option<LogFile> {
    let log = LogFile::at(path).ok().filter(|_| path.is_file())?;
    let is_log = recognised(&log).is_ok_and(|(format, _)| format.is_ok());
    is_log.then_some(log)
}
