//! Where the bytes of a log are: in a file, or held here because they come only once.
//!
//! A log is read several times: what it is, whose it is, then what is in it, and that for every outage. Standard input and pipes give their bytes once, so
//! they are held: a small log in memory, a larger one in a file without a name, which is gone when the program is.

use std::fs::{self, File};
use std::io::{self, Cursor, Read, Write};
use std::os::unix::fs::{FileExt, FileTypeExt, MetadataExt};
use std::path::{Path, PathBuf};
use std::sync::Arc;

use sha2::{Digest, Sha256};

use super::error::LogError;
use super::format;
use super::remote::RemoteLog;
use super::source;

/// The name that stands for standard input.
const STDIN: &str = "-";
/// Looked at before the rest is held, bytes: what is packed has to give what shows the format.
const FIRST: u64 = 2 * format::LOOKED_AT as u64;
/// Held in memory up to this, bytes.
const MOST_IN_MEMORY: u64 = 4 << 20;
/// Held at all up to this, bytes: an hour at full rate is 2 GB.
const MOST_HELD: u64 = 8 << 30;

/// See the module's documentation. Clones share the bytes.
#[derive(Clone, Debug)]
pub struct LogFile {
    path: PathBuf,
    held: Option<Held>,
}

#[derive(Clone, Debug)]
enum Held {
    Memory(Arc<[u8]>),
    File(Arc<File>, u64),
    Elsewhere(Arc<dyn RemoteLog>),
}

impl LogFile {
    /// The log of this name, where `-` is standard input.
    ///
    /// # Errors
    /// Standard input or a pipe that cannot be read, is not a log, or is larger than any; a device. What is wrong with a file shows when it is opened.
    pub fn at(path: &Path) -> Result<Self, LogError> {
        if path.as_os_str() == STDIN {
            return Self::of("standard input", io::stdin().lock());
        }
        let is = fs::metadata(path).map(|meta| meta.file_type());
        if is.as_ref().is_ok_and(FileTypeExt::is_fifo) {
            let pipe = File::open(path).map_err(|source| LogError::Io { path: path.to_owned(), source })?;
            return Self::of(path, pipe);
        }
        if is.is_ok_and(|t| t.is_char_device() || t.is_block_device() || t.is_socket()) {
            return Err(LogError::NotALog { path: path.to_owned(), hint: "this is a device".into() });
        }
        Ok(Self { path: path.to_owned(), held: None })
    }

    /// A log of this name whose bytes come only once.
    ///
    /// # Errors
    /// [`LogError::Io`], [`LogError::NotALog`], and [`LogError::Empty`].
    pub fn of(name: impl AsRef<Path>, mut bytes: impl Read) -> Result<Self, LogError> {
        let path = name.as_ref().to_owned();
        let io_error = |source| LogError::Io { path: path.clone(), source };
        let mut first = Vec::new();
        bytes.by_ref().take(FIRST).read_to_end(&mut first).map_err(io_error)?;
        if first.is_empty() {
            return Err(LogError::Empty { path });
        }
        // What is no log is not held until its end, which may never come.
        let (mut unpacked, _) = source::unpacked(Cursor::new(first.clone()));
        let mut look = Vec::new();
        unpacked.by_ref().take(format::LOOKED_AT as u64).read_to_end(&mut look).map_err(io_error)?;
        if let Err(hint) = format::recognise(&look) {
            return Err(LogError::NotALog { path, hint });
        }
        let room = MOST_IN_MEMORY - first.len() as u64;
        bytes.by_ref().take(room + 1).read_to_end(&mut first).map_err(io_error)?;
        if first.len() as u64 <= MOST_IN_MEMORY {
            return Ok(Self { path, held: Some(Held::Memory(first.into())) });
        }
        let (file, len) = in_a_file(&first, bytes).map_err(io_error)?;
        Ok(Self { path, held: Some(Held::File(Arc::new(file), len)) })
    }

    /// A log that is brought here when it is opened.
    pub fn remote(name: &Path, log: Arc<dyn RemoteLog>) -> Self {
        Self { path: name.to_owned(), held: Some(Held::Elsewhere(log)) }
    }

    /// The same, here.
    ///
    /// # Errors
    /// As [`LogFile::of`].
    pub(super) fn brought(self) -> Result<Self, LogError> {
        let Some(Held::Elsewhere(log)) = &self.held else { return Ok(self) };
        let bytes = log.open().map_err(|source| LogError::Io { path: self.path.clone(), source })?;
        Self::of(&self.path, bytes)
    }

    /// What tells it from another log of this name: size and time of the last change, or what whoever has it says; of what came only once, its
    /// content.
    ///
    /// # Errors
    /// [`LogError::Io`].
    pub fn identity(&self) -> Result<String, LogError> {
        let identity = match &self.held {
            None => fs::metadata(&self.path)
                .map(|meta| format!("{} bytes, {}.{:09}", meta.len(), meta.mtime(), meta.mtime_nsec())),
            Some(Held::Elsewhere(log)) => log.identity(),
            Some(_) => self.open().and_then(|mut bytes| {
                let mut digest = Sha256::new();
                let mut piece = vec![0; 1 << 16];
                loop {
                    match bytes.read(&mut piece)? {
                        0 => return Ok(format!("{:?}", digest.finalize())),
                        n => digest.update(&piece[..n]),
                    }
                }
            }),
        };
        identity.map_err(|source| LogError::Io { path: self.path.clone(), source })
    }

    /// What it is called.
    pub fn path(&self) -> &Path {
        &self.path
    }

    /// Its length, bytes.
    ///
    /// # Errors
    /// [`LogError::Io`], [`LogError::Directory`].
    pub(super) fn len(&self) -> Result<u64, LogError> {
        match &self.held {
            Some(Held::Memory(bytes)) => Ok(bytes.len() as u64),
            Some(Held::File(_, len)) => Ok(*len),
            Some(Held::Elsewhere(_)) => self.clone().brought()?.len(),
            None => {
                let meta = fs::metadata(&self.path)
                    .map_err(|source| LogError::Io { path: self.path.clone(), source })?;
                if meta.is_dir() {
                    return Err(LogError::Directory { path: self.path.clone(), more: "" });
                }
                Ok(meta.len())
            }
        }
    }

    /// Its bytes from the beginning.
    ///
    /// # Errors
    /// What the system says.
    pub(super) fn open(&self) -> io::Result<Box<dyn Read>> {
        Ok(match &self.held {
            Some(Held::Memory(bytes)) => Box::new(Cursor::new(Arc::clone(bytes))),
            Some(Held::File(file, _)) => Box::new(FromStart { file: Arc::clone(file), at: 0 }),
            Some(Held::Elsewhere(log)) => log.open()?,
            None => Box::new(File::open(&self.path)?),
        })
    }
}

/// Puts everything into a file without a name.
fn in_a_file(first: &[u8], bytes: impl Read) -> io::Result<(File, u64)> {
    let mut file = tempfile::tempfile()?;
    file.write_all(first)?;
    let len = first.len() as u64 + io::copy(&mut bytes.take(MOST_HELD), &mut file)?;
    if len >= MOST_HELD {
        return Err(io::Error::other(format!(
            "more than {} GiB: give the file itself instead",
            MOST_HELD >> 30
        )));
    }
    Ok((file, len))
}

/// Reads a file from its start, whoever else reads it.
struct FromStart {
    file: Arc<File>,
    at: u64,
}

impl Read for FromStart {
    fn read(&mut self, to: &mut [u8]) -> io::Result<usize> {
        let n = self.file.read_at(to, self.at)?;
        self.at += n as u64;
        Ok(n)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::wire::frame::{ComponentId, SystemId};
    use crate::wire::session::Address;
    use crate::wire::session::heartbeat::{SystemStatus, heartbeat};
    use crate::wire::tlog_writer::TlogWriter;

    fn log(records: u64) -> Vec<u8> {
        let mut bytes = Vec::new();
        let from = Address { system: SystemId(1), component: ComponentId::AUTOPILOT };
        let mut writer = TlogWriter::new(&mut bytes, from);
        for i in 0..records {
            writer.write(1_767_225_600_000_000 + i, &heartbeat(SystemStatus::Active, i as u32)).unwrap();
        }
        bytes
    }

    fn read(file: &LogFile) -> Vec<u8> {
        let mut out = Vec::new();
        file.open().unwrap().read_to_end(&mut out).unwrap();
        out
    }

    #[test]
    fn what_comes_once_is_read_as_often_as_is_liked() {
        for records in [10, 200_000] {
            let bytes = log(records);
            let file = LogFile::of("x", bytes.as_slice()).unwrap();
            assert_eq!(matches!(file.held, Some(Held::Memory(_))), records == 10);
            assert_eq!(file.len().unwrap(), bytes.len() as u64);
            assert!(read(&file) == bytes && read(&file.clone()) == bytes);
        }
    }

    #[test]
    fn what_is_no_log_is_not_waited_for() {
        let error = LogFile::of("endless", io::repeat(0)).unwrap_err().to_string();
        assert!(error.contains("endless: no log"), "{error}");
        assert!(matches!(LogFile::of("x", io::empty()), Err(LogError::Empty { .. })));
        let error = LogFile::at(Path::new("/dev/zero")).unwrap_err().to_string();
        assert!(error.contains("/dev/zero") && error.contains("device"), "{error}");
    }
}
