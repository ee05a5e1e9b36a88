//! Recordings: all that was heard and sent, as telemetry logs that ground stations read, and that fly again as they were flown.
//!
//! The navigation hands over what comes and goes in blocks, and never waits: a thread of its own writes them (`keeper`), brings them to the
//! disk every second, begins a new file when one is large or old enough, and makes room by removing the oldest recordings (`shelf`). What a
//! disk does not take in time is missing, counted, and said in the recording itself. The times in it are those of the clock since boot, put
//! where the time of day was when the recording began: a clock that is set in flight does not tear it.

mod keeper;
mod shelf;

use std::path::PathBuf;
use std::sync::Arc;
use std::sync::atomic::{AtomicU64, Ordering};
use std::sync::mpsc::{Receiver, SyncSender, TrySendError, sync_channel};
use std::time::Duration;

use crate::time::{Companion, Span, Stamp};
use crate::wire::companion_clock::CompanionClock;
use crate::wire::frame::Frame;
use crate::wire::recording::{HeardAs, Mark, MarkWriter, is_of_ours, is_withheld};
use crate::wire::session::identity::Vehicle;

use keeper::Keeper;
pub use keeper::RecordNews;

/// Bytes that are handed over at once.
const BLOCK: usize = 1 << 14;
/// What is not handed over for so long is.
const HELD: Span = Span::from_millis(250);
/// Blocks that may wait for the disk: 4 MB, half a minute of a busy link.
const WAITING: usize = 256;
/// How long a disk may take for the last blocks when the process ends.
const LAST_BLOCKS: Duration = Duration::from_millis(25);
/// Sentences that may wait to be told.
const NEWS: usize = 8;

/// Where recordings go, and how much room they take.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct RecordSettings {
    /// The folder.
    pub folder: PathBuf,
    /// All recordings there take so much at most, bytes; the oldest are removed.
    pub max_bytes: u64,
    /// So much of the disk is left free, bytes; before it is not, the oldest are removed.
    pub min_free_bytes: u64,
    /// A file that has so much is followed by another, bytes …
    pub max_file_bytes: u64,
    /// … and one that is so old.
    pub max_file_age: Span,
}

/// How the recording fares.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct RecordCounts {
    /// Bytes on their way to the disk.
    pub bytes: u64,
    /// Files begun.
    pub files: u64,
    /// Frames that are missing.
    pub lost: u64,
    /// Frames that are not recorded, as they hold a key or could be taken for what only the recorder says.
    pub withheld: u64,
}

/// What the thread has counted.
#[derive(Debug, Default)]
struct Written {
    bytes: AtomicU64,
    files: AtomicU64,
    lost: AtomicU64,
}

/// What is handed over: whole records, and what holds at their beginning.
#[derive(Debug, Default)]
struct RecordBlock {
    bytes: Vec<u8>,
    frames: u32,
    /// Frames before it that it says are missing.
    missing: u64,
    head: Arc<[Mark]>,
}

/// What the thread that writes gives back.
#[derive(Debug)]
struct KeeperThread {
    /// The memory of blocks that are written.
    empty: Receiver<Vec<u8>>,
    news: Receiver<RecordNews>,
    written: Arc<Written>,
    /// Says nothing, and ends when everything is written.
    ended: Receiver<()>,
}

/// Takes what is to be recorded, and never waits. What has not been handed over when it is dropped is written then.
#[derive(Debug)]
pub struct LinkRecorder {
    blocks: Option<SyncSender<RecordBlock>>,
    keeper: KeeperThread,
    /// The time of day less the time since boot, µs, when the recording began.
    offset_us: i64,
    marks: MarkWriter,
    block: RecordBlock,
    /// What a file that begins now has to say first.
    head: Arc<[Mark]>,
    heard_as: HeardAs,
    due: Option<Stamp<Companion>>,
    /// Frames that were lost and not yet told in the recording, and all of them.
    lost: [u64; 2],
    withheld: u64,
}

impl LinkRecorder {
    /// Begins a recording. `configuration` is kept beside it, so that it can be flown again with the same.
    ///
    /// # Errors
    /// The folder cannot be made or read, or the system has no thread to give.
    pub fn start(
        settings: RecordSettings,
        configuration: String,
        clock: CompanionClock,
    ) -> std::io::Result<Self> {
        let (blocks, waiting) = sync_channel(WAITING);
        let (tell, news) = sync_channel(NEWS);
        let (give_back, empty) = sync_channel(WAITING);
        let written = Arc::new(Written::default());
        let offset_us = clock.unix_us() - clock.now().micros();
        let keeper = Keeper::new(settings, configuration, (clock, Arc::clone(&written)), tell)?;
        let (ends, ended) = sync_channel(0);
        std::thread::Builder::new()
            .name("recorder".to_owned())
            .spawn(move || keeper.run(&waiting, &give_back, ends))?;
        let keeper = KeeperThread { empty, news, written, ended };
        Ok(Self::with(blocks, keeper, offset_us))
    }

    fn with(blocks: SyncSender<RecordBlock>, keeper: KeeperThread, offset_us: i64) -> Self {
        let mut recorder = Self {
            blocks: Some(blocks),
            keeper,
            offset_us,
            marks: MarkWriter::new(),
            block: RecordBlock::default(),
            head: Arc::default(),
            heard_as: HeardAs::Listened,
            due: None,
            lost: [0; 2],
            withheld: 0,
        };
        recorder.begin_block();
        recorder
    }

    /// A frame that was heard is taken now.
    pub fn heard(&mut self, now: Stamp<Companion>, how: HeardAs, frame: &Frame<'_>) {
        if is_withheld(frame) {
            self.withheld += 1;
            return;
        }
        if self.heard_as != how {
            self.heard_as = how;
            self.say(now, &Mark::Heard(how));
        }
        if is_of_ours(frame) {
            self.say(now, &Mark::HeardOfOurs);
        }
        self.put(now, frame.bytes());
    }

    /// A frame was sent.
    pub fn sent(&mut self, now: Stamp<Companion>, bytes: &[u8]) {
        self.put(now, bytes);
    }

    /// A vehicle is followed from now on; `anew` instead of another.
    pub fn follows(&mut self, now: Stamp<Companion>, vehicle: &Vehicle, anew: bool) {
        self.say(now, &Mark::Follows { vehicle: *vehicle, anew });
        self.keep_in_head(Mark::Follows { vehicle: *vehicle, anew: false });
    }

    /// Something else that holds from now on, in files that begin later, too.
    pub fn holds(&mut self, now: Stamp<Companion>, mark: Mark) {
        self.say(now, &mark);
        self.keep_in_head(mark);
    }

    /// What a process before had kept, and this one may go on from.
    pub fn kept(&mut self, now: Stamp<Companion>, state: &[u8]) {
        for piece in Mark::kept(state) {
            self.say(now, &piece);
        }
    }

    /// Time passes: hands over what has waited long enough.
    pub fn poll(&mut self, now: Stamp<Companion>) {
        if self.due.is_some_and(|due| now >= due) {
            self.hand_over();
        }
    }

    /// What is to be told, once.
    pub fn news(&mut self) -> Option<RecordNews> {
        self.keeper.news.try_recv().ok()
    }

    /// How it fares.
    pub fn counts(&self) -> RecordCounts {
        let w = &self.keeper.written;
        RecordCounts {
            bytes: w.bytes.load(Ordering::Relaxed),
            files: w.files.load(Ordering::Relaxed),
            lost: self.lost[1] + w.lost.load(Ordering::Relaxed),
            withheld: self.withheld,
        }
    }

    /// One of each kind holds, but of drills all.
    fn keep_in_head(&mut self, mark: Mark) {
        let replaces = |old: &Mark| {
            std::mem::discriminant(old) == std::mem::discriminant(&mark)
                && !matches!(mark, Mark::Drill { .. })
        };
        let others = self.head.iter().filter(|old| !replaces(old)).cloned();
        self.head = others.chain([mark.clone()]).collect();
    }

    fn say(&mut self, now: Stamp<Companion>, mark: &Mark) {
        if let Some(frame) = self.marks.write(mark) {
            self.put(now, &frame);
        }
    }

    /// Appends a record.
    fn put(&mut self, now: Stamp<Companion>, bytes: &[u8]) {
        let at_us = u64::try_from(now.micros().saturating_add(self.offset_us)).unwrap_or(0);
        if self.block.bytes.is_empty() {
            self.due = Some(now + HELD);
            self.block.head = Arc::clone(&self.head);
            let lost = std::mem::take(&mut self.lost[0]);
            self.block.missing = lost;
            let told = (lost > 0).then(|| Mark::Lost(u32::try_from(lost).unwrap_or(u32::MAX)));
            for mark in told.iter().chain([&Mark::Heard(self.heard_as)]) {
                let frame = self.marks.write(mark);
                self.append(at_us, frame.as_deref().unwrap_or_default());
            }
        }
        self.append(at_us, bytes);
        self.block.frames += 1;
        if self.block.bytes.len() >= BLOCK {
            self.hand_over();
        }
    }

    fn append(&mut self, at_us: u64, frame: &[u8]) {
        self.block.bytes.extend(at_us.to_be_bytes());
        self.block.bytes.extend(frame);
    }

    fn begin_block(&mut self) {
        // The memory of those that are written is used again.
        self.block.bytes = self.keeper.empty.try_recv().unwrap_or_else(|_| Vec::with_capacity(BLOCK + 1024));
        self.block.bytes.clear();
        self.block.frames = 0;
        self.due = None;
    }

    fn hand_over(&mut self) {
        if self.block.bytes.is_empty() {
            return;
        }
        let Some(blocks) = &self.blocks else { return };
        match blocks.try_send(std::mem::take(&mut self.block)) {
            Ok(()) => self.begin_block(),
            Err(TrySendError::Full(block) | TrySendError::Disconnected(block)) => {
                for lost in &mut self.lost {
                    *lost += u64::from(block.frames);
                }
                self.lost[0] += block.missing;
                self.block = block;
                self.block.bytes.clear();
                self.block.frames = 0;
                self.due = None;
            }
        }
    }
}

impl Drop for LinkRecorder {
    /// What waits is written first, where the disk is not slow.
    fn drop(&mut self) {
        self.hand_over();
        self.blocks = None;
        let _ = self.keeper.ended.recv_timeout(LAST_BLOCKS);
    }
}

#[cfg(test)]
mod tests;
