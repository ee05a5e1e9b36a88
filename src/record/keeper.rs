//! The thread that writes: whatever the disk does, it waits here and nowhere else.

use std::fmt;
use std::fs::File;
use std::io::{self, Write};
use std::path::{Path, PathBuf};
use std::sync::Arc;
use std::sync::atomic::Ordering;
use std::sync::mpsc::{Receiver, RecvTimeoutError, SyncSender};
use std::time::Duration;

use crate::time::{Companion, Span, Stamp};
use crate::wire::companion_clock::CompanionClock;
use crate::wire::recording::{Mark, MarkWriter};

use super::shelf::Shelf;
use super::{RecordBlock, RecordSettings, Written};

/// What is written is brought to the disk so often: a loss of power takes no more.
const SYNC: Span = Span::from_millis(1000);
/// How long it is waited for something to write.
const WAIT: Duration = Duration::from_millis(250);
/// A disk that is full, or does not work, is tried again after so long.
const AGAIN: Span = Span::from_millis(5000);

/// What is to be told of a recording.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum RecordNews {
    /// It goes into this file.
    Begun(PathBuf),
    /// Nothing is recorded: all recordings but the one that is being made are gone, and it is not enough.
    NoRoom,
    /// Nothing is recorded: what the system says.
    Failed(String),
}

impl RecordNews {
    /// Whether it is bad.
    pub fn is_bad(&self) -> bool {
        !matches!(self, Self::Begun(_))
    }
}

impl fmt::Display for RecordNews {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Begun(path) => write!(f, "recording into {}", path.display()),
            Self::NoRoom => f.write_str("not recording: the disk has no room"),
            Self::Failed(why) => write!(f, "not recording: {why}"),
        }
    }
}

/// The file that is written.
#[derive(Debug)]
struct Open {
    file: File,
    path: PathBuf,
    bytes: u64,
    /// There is nothing in it that was heard or sent.
    empty: bool,
    since: Stamp<Companion>,
}

/// See the module's documentation.
#[derive(Debug)]
pub(super) struct Keeper {
    settings: RecordSettings,
    configuration: String,
    clock: CompanionClock,
    written: Arc<Written>,
    tell: SyncSender<RecordNews>,
    shelf: Shelf,
    marks: MarkWriter,
    open: Option<Open>,
    /// Since when something is written that may not be on the disk.
    unsynced: Option<Stamp<Companion>>,
    /// What went wrong, and when it is tried again.
    failed: Option<(RecordNews, Stamp<Companion>)>,
    /// Frames that were not written, to be told in the recording.
    lost: u64,
}

impl Keeper {
    pub(super) fn new(
        settings: RecordSettings,
        configuration: String,
        (clock, written): (CompanionClock, Arc<Written>),
        tell: SyncSender<RecordNews>,
    ) -> io::Result<Self> {
        let shelf = Shelf::open(settings.folder.clone())?;
        Ok(Self {
            settings,
            configuration,
            clock,
            written,
            tell,
            shelf,
            marks: MarkWriter::new(),
            open: None,
            unsynced: None,
            failed: None,
            lost: 0,
        })
    }

    /// Writes until nobody hands over any more; `ends` goes when everything is written.
    pub(super) fn run(
        mut self,
        blocks: &Receiver<RecordBlock>,
        give_back: &SyncSender<Vec<u8>>,
        ends: SyncSender<()>,
    ) {
        loop {
            match blocks.recv_timeout(WAIT) {
                Ok(block) => {
                    self.take(&block);
                    // Nobody need want it.
                    let _ = give_back.try_send(block.bytes);
                }
                Err(RecvTimeoutError::Timeout) => {}
                Err(RecvTimeoutError::Disconnected) => break,
            }
            let now = self.clock.now();
            if self.unsynced.is_some_and(|since| now - since >= SYNC) {
                self.sync();
            }
        }
        drop(ends);
        self.sync();
    }

    fn take(&mut self, block: &RecordBlock) {
        let now = self.clock.now();
        if self.failed.as_ref().is_some_and(|(_, again)| now < *again) {
            return self.lose(block);
        }
        match self.write(block, now) {
            Ok(()) => self.failed = None,
            Err(news) => {
                self.lose(block);
                self.end_file();
                let told = self.failed.replace((news.clone(), now + AGAIN));
                if told.is_none_or(|(before, _)| before != news) {
                    let _ = self.tell.try_send(news);
                }
            }
        }
    }

    fn lose(&mut self, block: &RecordBlock) {
        self.lost += u64::from(block.frames);
        self.written.lost.fetch_add(u64::from(block.frames), Ordering::Relaxed);
    }

    fn write(&mut self, block: &RecordBlock, now: Stamp<Companion>) -> Result<(), RecordNews> {
        let more = block.bytes.len() as u64;
        // Room for some files, so that there is always an older one to go.
        let most = self.settings.max_file_bytes.min(self.settings.max_bytes / 4);
        let ended = |o: &Open| o.bytes + more > most.max(more) || now - o.since >= self.settings.max_file_age;
        if self.open.as_ref().is_some_and(ended) {
            self.sync();
            self.end_file();
        }
        let written = self.open.as_ref().map_or(0, |o| o.bytes);
        let RecordSettings { max_bytes, min_free_bytes, .. } = self.settings;
        if !self.shelf.make_room((written, more), max_bytes, min_free_bytes) {
            return Err(RecordNews::NoRoom);
        }
        let failed =
            |path: &Path, e: &io::Error| RecordNews::Failed(crate::files::named(path, e).to_string());
        let mut open = match self.open.take() {
            Some(open) => open,
            None => self.begin(block, now).map_err(|e| RecordNews::Failed(e.to_string()))?,
        };
        let done = open.file.write_all(&block.bytes);
        open.bytes += more;
        open.empty &= done.is_err();
        let path = open.path.clone();
        self.open = Some(open);
        done.map_err(|e| failed(&path, &e))?;
        self.written.bytes.fetch_add(more, Ordering::Relaxed);
        self.unsynced.get_or_insert(now);
        Ok(())
    }

    /// Begins a file with what holds where `block` begins.
    fn begin(&mut self, block: &RecordBlock, now: Stamp<Companion>) -> io::Result<Open> {
        let (mut file, path) = self.shelf.next(&self.configuration)?;
        let stamp = block.bytes.get(..8).unwrap_or(&[0; 8]);
        let lost = std::mem::take(&mut self.lost);
        let lost = (lost > 0).then(|| Mark::Lost(u32::try_from(lost).unwrap_or(u32::MAX)));
        let part = Mark::Part { run: self.shelf.run(), part: self.shelf.part() };
        let mut bytes = Vec::with_capacity(256);
        for mark in [&part].into_iter().chain(block.head.iter()).chain(&lost) {
            if let Some(frame) = self.marks.write(mark) {
                bytes.extend(stamp);
                bytes.extend_from_slice(&frame);
            }
        }
        if let Err(e) = file.write_all(&bytes) {
            let _ = std::fs::remove_file(&path);
            return Err(crate::files::named(&path, &e));
        }
        self.written.files.fetch_add(1, Ordering::Relaxed);
        if self.shelf.part() == 1 || self.failed.is_some() {
            let _ = self.tell.try_send(RecordNews::Begun(path.clone()));
        }
        Ok(Open { file, path, bytes: bytes.len() as u64, empty: true, since: now })
    }

    fn end_file(&mut self) {
        match self.open.take() {
            // A disk that fails again and again is not filled with beginnings.
            Some(open) if open.empty => drop(std::fs::remove_file(&open.path)),
            Some(open) => self.shelf.put(open.bytes),
            None => {}
        }
        self.unsynced = None;
    }

    /// Brings what is written to the disk.
    fn sync(&mut self) {
        if self.unsynced.take().is_none() {
            return;
        }
        let Some(open) = &self.open else { return };
        if let Err(e) = open.file.sync_data() {
            let news = RecordNews::Failed(crate::files::named(&open.path, &e).to_string());
            let _ = self.tell.try_send(news.clone());
            self.end_file();
            self.failed = Some((news, self.clock.now() + AGAIN));
        }
    }
}
