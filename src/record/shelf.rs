//! The folder of recordings: what is in it, what it is called, and what has to go.

use std::fs::{self, File, OpenOptions};
use std::io;
use std::os::unix::fs::OpenOptionsExt;
use std::path::{Path, PathBuf};

use nix::sys::statvfs::statvfs;

use crate::files::{Overwrite, READABLE, named, write_whole};

/// A file of a recording.
#[derive(Clone, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub(super) struct Part {
    pub(super) run: u32,
    pub(super) part: u32,
    pub(super) bytes: u64,
}

/// The folder, and the recording that is being made.
#[derive(Debug)]
pub(super) struct Shelf {
    folder: PathBuf,
    run: u32,
    /// The number of the newest file; 0 before there was one.
    part: u32,
    /// The others' bytes, and those of its own files that are whole.
    parts: Vec<Part>,
}

impl Shelf {
    /// Looks at the folder, and makes it where it is missing.
    pub(super) fn open(folder: PathBuf) -> io::Result<Self> {
        fs::create_dir_all(&folder).map_err(|e| named(&folder, &e))?;
        let mut shelf = Self { folder, run: 0, part: 0, parts: Vec::new() };
        shelf.look()?;
        Ok(shelf)
    }

    /// What is in the folder now, the oldest first. Whatever is not called like a recording is somebody else's.
    fn look(&mut self) -> io::Result<()> {
        let entries = fs::read_dir(&self.folder).map_err(|e| named(&self.folder, &e))?;
        self.parts = entries
            .filter_map(|entry| {
                let entry = entry.ok()?;
                let (run, part) = numbers(entry.file_name().to_str()?)?;
                let about = entry.metadata().ok().filter(fs::Metadata::is_file)?;
                Some(Part { run, part, bytes: about.len() })
            })
            .collect();
        self.parts.sort();
        Ok(())
    }

    /// Number of the recording; 0 before it has a file.
    pub(super) fn run(&self) -> u32 {
        self.run
    }

    /// Number of the newest file.
    pub(super) fn part(&self) -> u32 {
        self.part
    }

    /// Where a file is.
    pub(super) fn path(&self, run: u32, part: u32) -> PathBuf {
        self.folder.join(format!("holdover-{run:05}-{part:03}.tlog"))
    }

    fn configuration(&self, run: u32) -> PathBuf {
        self.folder.join(format!("holdover-{run:05}.toml"))
    }

    /// Begins the next file. With the first the recording takes its number: another program may have taken the one before.
    pub(super) fn next(&mut self, configuration: &str) -> io::Result<(File, PathBuf)> {
        self.look()?;
        if self.part == 0 {
            self.run = self.parts.iter().map(|p| p.run).max().unwrap_or(0).saturating_add(1);
        }
        let part = self.part + 1;
        let path = self.path(self.run, part);
        let file = OpenOptions::new().write(true).create_new(true).mode(READABLE).open(&path);
        let file = file.map_err(|e| named(&path, &e))?;
        if part == 1 {
            let beside = self.configuration(self.run);
            let written = write_whole(&beside, configuration.as_bytes(), Overwrite::Ours, READABLE);
            written.inspect_err(|_| drop(fs::remove_file(&path)))?;
        }
        self.part = part;
        // Its name, too, has to outlive a loss of power.
        File::open(&self.folder).and_then(|folder| folder.sync_all()).map_err(|e| named(&self.folder, &e))?;
        Ok((file, path))
    }

    /// Removes the oldest files until the recordings and `more` bytes fit into `max_bytes` and `min_free_bytes` of the disk stay free.
    /// The one that is written, of `written` bytes, stays. Whether that is enough.
    pub(super) fn make_room(
        &mut self,
        (written, more): (u64, u64),
        max_bytes: u64,
        min_free_bytes: u64,
    ) -> bool {
        let current = (self.run, self.part);
        loop {
            let others = self.parts.iter().filter(|p| (p.run, p.part) != current);
            let all = others.map(|p| p.bytes).sum::<u64>().saturating_add(written);
            let fits = all.saturating_add(more) <= max_bytes;
            let free =
                free_bytes(&self.folder).is_none_or(|free| free >= min_free_bytes.saturating_add(more));
            if fits && free {
                return true;
            }
            let Some(at) = self.parts.iter().position(|p| (p.run, p.part) != current) else { return false };
            let old = self.parts.remove(at);
            if fs::remove_file(self.path(old.run, old.part)).is_ok() {
                tracing::info!("the oldest recording is removed: {}", self.path(old.run, old.part).display());
            }
            if old.run != self.run && self.parts.iter().all(|p| p.run != old.run) {
                let _ = fs::remove_file(self.configuration(old.run));
            }
        }
    }

    /// A file of its own is whole.
    pub(super) fn put(&mut self, bytes: u64) {
        self.parts.push(Part { run: self.run, part: self.part, bytes });
    }
}

/// Run and part of a file of that name.
fn numbers(name: &str) -> Option<(u32, u32)> {
    let (run, part) = name.strip_prefix("holdover-")?.strip_suffix(".tlog")?.split_once('-')?;
    let number = |text: &str| text.bytes().all(|b| b.is_ascii_digit()).then(|| text.parse().ok())?;
    Some((number(run)?, number(part)?))
}

/// What the disk has left for others than its administrator.
fn free_bytes(folder: &Path) -> Option<u64> {
    let disk = statvfs(folder).ok()?;
    disk.blocks_available().checked_mul(disk.fragment_size())
}

#[cfg(test)]
mod tests {
    use super::*;

    fn names(folder: &Path) -> Vec<String> {
        let mut names: Vec<_> =
            fs::read_dir(folder).unwrap().map(|e| e.unwrap().file_name().into_string().unwrap()).collect();
        names.sort();
        names
    }

    #[test]
    fn names_are_numbers_and_nothing_else_is_ours() {
        assert_eq!(numbers("holdover-00012-003.tlog"), Some((12, 3)));
        assert_eq!(numbers("holdover-123456-1234.tlog"), Some((123_456, 1234)));
        for other in [
            "holdover-1-.tlog",
            "holdover--1-1.tlog",
            "holdover-+1-1.tlog",
            "flight.tlog",
            "holdover-1-1.toml",
        ] {
            assert_eq!(numbers(other), None, "{other}");
        }
    }

    #[test]
    fn the_oldest_make_room_and_others_files_stay() {
        let folder = tempfile::tempdir().unwrap();
        for (run, part) in [(3, 1), (3, 2), (7, 1)] {
            fs::write(folder.path().join(format!("holdover-{run:05}-{part:03}.tlog")), [0; 100]).unwrap();
            fs::write(folder.path().join(format!("holdover-{run:05}.toml")), "").unwrap();
        }
        fs::write(folder.path().join("mine.tlog"), [0; 1000]).unwrap();
        let mut shelf = Shelf::open(folder.path().to_owned()).unwrap();
        let (_, path) = shelf.next("a = 1\n").unwrap();
        assert_eq!(path, folder.path().join("holdover-00008-001.tlog"));
        // 300 of others, 50 of its own and 20 to come.
        assert!(shelf.make_room((50, 20), 370, 0));
        assert_eq!(names(folder.path()).len(), 8);
        assert!(shelf.make_room((50, 21), 370, 0));
        assert!(!folder.path().join("holdover-00003-001.tlog").exists());
        assert!(folder.path().join("holdover-00003.toml").exists());
        assert!(shelf.make_room((150, 0), 250, 0));
        assert_eq!(
            names(folder.path()),
            [
                "holdover-00007-001.tlog",
                "holdover-00007.toml",
                "holdover-00008-001.tlog",
                "holdover-00008.toml",
                "mine.tlog"
            ]
        );
        // The disk has not so much, whatever goes.
        assert!(!shelf.make_room((150, 0), 1000, u64::MAX));
        assert_eq!(names(folder.path()), ["holdover-00008-001.tlog", "holdover-00008.toml", "mine.tlog"]);
    }

    #[test]
    fn two_that_begin_at_once_have_numbers_of_their_own() {
        let folder = tempfile::tempdir().unwrap();
        let mut shelves = [(); 2].map(|()| Shelf::open(folder.path().to_owned()).unwrap());
        let runs = shelves.each_mut().map(|shelf| {
            shelf.next("").unwrap();
            shelf.run()
        });
        assert_eq!(runs, [1, 2]);
    }

    #[test]
    fn a_file_or_a_link_in_the_place_is_not_written_through() {
        let folder = tempfile::tempdir().unwrap();
        let mut shelf = Shelf::open(folder.path().to_owned()).unwrap();
        let victim = folder.path().join("victim");
        fs::write(&victim, "mine").unwrap();
        std::os::unix::fs::symlink(&victim, folder.path().join("holdover-00001-001.tlog")).unwrap();
        let error = shelf.next("").unwrap_err().to_string();
        assert!(error.contains("holdover-00001-001.tlog"), "{error}");
        assert_eq!(fs::read(&victim).unwrap(), b"mine");
    }
}
