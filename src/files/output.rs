//! An output: beside its place until it is whole.

use std::fs::{self, Permissions};
use std::io::{self, BufWriter, ErrorKind, Write};
use std::os::unix::fs::PermissionsExt;
use std::path::{Path, PathBuf};

use tempfile::{Builder, NamedTempFile};

use super::{SECRET, named};

/// Bytes that are written at once.
const BUFFER: usize = 1 << 16;

/// What becomes of a file that is in an output's place.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Overwrite {
    /// It stays, and the output is refused.
    Never,
    /// It stays until the output is whole, and is replaced then.
    Always,
    /// The same of what nobody but this program writes: a link that somebody has put there is replaced, too, and what it leads to left alone.
    Ours,
}

impl Overwrite {
    /// As `--force` says.
    pub fn forced(force: bool) -> Self {
        if force { Self::Always } else { Self::Never }
    }
}

/// A file that is being written. It has its name only after [`OutputFile::finish`]; what is dropped before is gone.
#[derive(Debug)]
pub struct OutputFile {
    beside: BufWriter<NamedTempFile>,
    path: PathBuf,
    overwrite: Overwrite,
}

impl OutputFile {
    /// Begins a file that will be at `path`, with these permissions ([`super::READABLE`], [`super::SECRET`]) less those that the user withholds.
    ///
    /// # Errors
    /// What is in the place (a link, a folder, a device, a file that is not to be overwritten), or the system's word; the file is named.
    pub fn create(path: &Path, overwrite: Overwrite, mode: u32) -> io::Result<Self> {
        may_take(path, overwrite).map_err(|e| named(path, &e))?;
        let folder = path.parent().filter(|p| !p.as_os_str().is_empty()).unwrap_or(Path::new("."));
        let name = path.file_name().unwrap_or_default().to_string_lossy();
        let prefix = format!(".{name}.");
        let made = Builder::new()
            .prefix(&prefix)
            .suffix(".part")
            .permissions(Permissions::from_mode(mode))
            .tempfile_in(folder);
        // The system's word without the trial's name.
        let beside = made.map_err(|e| named(path, &io::Error::from(e.kind())))?;
        Ok(Self { beside: BufWriter::with_capacity(BUFFER, beside), path: path.to_owned(), overwrite })
    }

    /// Puts the whole file in its place, on the disk.
    ///
    /// # Errors
    /// As [`OutputFile::create`], and a disk that is full: then nothing is in the place but what was there before.
    pub fn finish(mut self) -> io::Result<()> {
        self.flush()?;
        self.beside.get_ref().as_file().sync_all().map_err(|e| named(&self.path, &e))?;
        self.place()
    }

    /// The same of what is written again and again: the system brings it to the disk when it likes. A program that is killed loses nothing by
    /// that, and of a computer that loses its power the file before may be left.
    ///
    /// # Errors
    /// As [`OutputFile::finish`].
    pub fn place(self) -> io::Result<()> {
        let Self { mut beside, path, overwrite } = self;
        let placed = beside.flush().and_then(|()| {
            let (beside, _) = beside.into_parts();
            may_take(&path, overwrite)?;
            match overwrite {
                Overwrite::Always | Overwrite::Ours => beside.persist(&path),
                Overwrite::Never => beside.persist_noclobber(&path),
            }
            .map_err(|e| e.error)
        });
        placed.map(drop).map_err(|e| named(&path, &e))
    }
}

impl Write for OutputFile {
    fn write(&mut self, bytes: &[u8]) -> io::Result<usize> {
        self.beside.write(bytes).map_err(|e| named(&self.path, &e))
    }

    fn flush(&mut self) -> io::Result<()> {
        self.beside.flush().map_err(|e| named(&self.path, &e))
    }
}

/// Writes a file at once; see [`OutputFile`].
///
/// # Errors
/// As [`OutputFile::create`] and [`OutputFile::finish`].
pub fn write_whole(path: &Path, bytes: &[u8], overwrite: Overwrite, mode: u32) -> io::Result<()> {
    let mut file = OutputFile::create(path, overwrite, mode)?;
    file.write_all(bytes)?;
    file.finish()
}

/// Writes again what a program keeps for its next run, of mode 0600; see [`OutputFile::place`].
///
/// # Errors
/// As [`OutputFile::create`] and [`OutputFile::finish`].
pub fn keep(path: &Path, bytes: &[u8]) -> io::Result<()> {
    let mut file = OutputFile::create(path, Overwrite::Ours, SECRET)?;
    file.write_all(bytes)?;
    file.place()
}

/// Whether an output may be put here.
fn may_take(path: &Path, overwrite: Overwrite) -> io::Result<()> {
    let refused = |why: &str| Err(io::Error::new(ErrorKind::AlreadyExists, why.to_owned()));
    let there = match fs::symlink_metadata(path) {
        Err(e) if e.kind() == ErrorKind::NotFound => return Ok(()),
        there => there?.file_type(),
    };
    if there.is_symlink() && overwrite == Overwrite::Ours {
        Ok(())
    } else if there.is_symlink() {
        refused("is a link: nothing is written through links")
    } else if there.is_dir() {
        refused("is a directory")
    } else if !there.is_file() {
        refused("is no file")
    } else if overwrite == Overwrite::Never {
        refused("is there already (--force overwrites it)")
    } else {
        Ok(())
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn entries(folder: &Path) -> Vec<String> {
        let mut names: Vec<_> =
            fs::read_dir(folder).unwrap().map(|e| e.unwrap().file_name().into_string().unwrap()).collect();
        names.sort();
        names
    }

    #[test]
    fn a_file_has_its_name_only_when_it_is_whole() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("a.csv");
        let mut file = OutputFile::create(&path, Overwrite::Never, 0o600).unwrap();
        file.write_all(b"half").unwrap();
        file.flush().unwrap();
        assert!(!path.exists());
        drop(file);
        assert_eq!(entries(folder.path()), Vec::<String>::new());
        write_whole(&path, b"whole", Overwrite::Never, 0o600).unwrap();
        assert_eq!(fs::read(&path).unwrap(), b"whole");
        assert_eq!(fs::metadata(&path).unwrap().permissions().mode() & 0o777, 0o600);
        assert_eq!(entries(folder.path()), ["a.csv"]);
    }

    #[test]
    fn what_is_there_stays_unless_it_is_to_be_overwritten() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("a");
        fs::write(&path, "old").unwrap();
        let e = write_whole(&path, b"new", Overwrite::Never, 0o666).unwrap_err().to_string();
        assert!(e.contains(&path.display().to_string()) && e.contains("--force"), "{e}");
        assert_eq!(fs::read(&path).unwrap(), b"old");
        write_whole(&path, b"new", Overwrite::Always, 0o666).unwrap();
        assert_eq!(fs::read(&path).unwrap(), b"new");
        // One that has come while the other was written.
        let late = folder.path().join("late");
        let file = OutputFile::create(&late, Overwrite::Never, 0o666).unwrap();
        fs::write(&late, "other").unwrap();
        assert!(file.finish().is_err());
        assert_eq!(fs::read(&late).unwrap(), b"other");
        assert_eq!(entries(folder.path()), ["a", "late"]);
    }

    #[test]
    fn nothing_is_written_through_links_or_into_folders_and_devices() {
        let folder = tempfile::tempdir().unwrap();
        let (target, link) = (folder.path().join("target"), folder.path().join("link"));
        fs::write(&target, "mine").unwrap();
        std::os::unix::fs::symlink(&target, &link).unwrap();
        for overwrite in [Overwrite::Never, Overwrite::Always] {
            let e = write_whole(&link, b"x", overwrite, 0o666).unwrap_err().to_string();
            assert!(e.contains("link"), "{e}");
            assert!(write_whole(folder.path(), b"x", overwrite, 0o666).is_err());
            assert!(write_whole(Path::new("/dev/null"), b"x", overwrite, 0o666).is_err());
        }
        assert_eq!(fs::read(&target).unwrap(), b"mine");
        // A link that has come while the file was written.
        let path = folder.path().join("late");
        let file = OutputFile::create(&path, Overwrite::Always, 0o666).unwrap();
        std::os::unix::fs::symlink(&target, &path).unwrap();
        assert!(file.finish().is_err());
        assert_eq!(fs::read(&target).unwrap(), b"mine");
    }

    #[test]
    fn a_folder_that_is_not_there_is_told_with_the_file() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("no/such");
        let e = OutputFile::create(&path, Overwrite::Never, 0o666).unwrap_err().to_string();
        assert!(e.contains("no/such"), "{e}");
    }
}
