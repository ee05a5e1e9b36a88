//! The queue of lines, and the thread that writes them.

use std::io::{self, Write};
use std::sync::Arc;
use std::sync::atomic::{AtomicU64, Ordering};
use std::sync::mpsc::{Receiver, SyncSender, sync_channel};
use std::time::Duration;

use tracing::Level;

use super::journal::Journal;
use crate::time::Span;
use crate::wire::companion_clock::CompanionClock;

/// Lines that may wait.
const CAPACITY: usize = 512;
/// How often a drain looks whether everything is written.
const LOOK: Duration = Duration::from_millis(1);

/// One line. The text holds no line breaks.
#[derive(Debug)]
pub(super) struct Line {
    pub(super) level: Level,
    /// When, in words.
    pub(super) time: String,
    pub(super) text: String,
}

/// Where lines go.
pub(super) enum Sink {
    Stream { to: Box<dyn Write + Send>, colours: bool },
    Journal(Journal),
}

/// What became of the lines.
#[derive(Debug, Default)]
struct LineCounts {
    queued: AtomicU64,
    /// Written, or failed to be.
    done: AtomicU64,
    lost: AtomicU64,
}

/// Takes lines, and never waits. Clones lead to the same thread.
#[derive(Clone, Debug)]
pub(super) struct LineQueue {
    lines: SyncSender<Line>,
    counts: Arc<LineCounts>,
}

impl LineQueue {
    /// Starts the thread that writes into `sink`. It is not waited for: it may be held up for ever.
    pub(super) fn start(sink: Sink) -> io::Result<Self> {
        let (lines, waiting) = sync_channel(CAPACITY);
        let counts = Arc::new(LineCounts::default());
        let counted = Arc::clone(&counts);
        std::thread::Builder::new().name("log".to_owned()).spawn(move || write(sink, &waiting, &counted))?;
        Ok(Self { lines, counts })
    }

    pub(super) fn push(&self, line: Line) {
        // Before it is written it is counted as queued.
        self.counts.queued.fetch_add(1, Ordering::AcqRel);
        if self.lines.try_send(line).is_err() {
            self.counts.lost.fetch_add(1, Ordering::AcqRel);
            self.counts.done.fetch_add(1, Ordering::AcqRel);
        }
    }

    /// Lines that were not written.
    pub(super) fn lost(&self) -> u64 {
        self.counts.lost.load(Ordering::Acquire)
    }

    /// Waits until everything is written, `limit` at most.
    pub(super) fn drain(&self, clock: &CompanionClock, limit: Span) {
        let begun = clock.now();
        let left = || self.counts.queued.load(Ordering::Acquire) > self.counts.done.load(Ordering::Acquire);
        while left() && clock.now() - begun < limit {
            std::thread::sleep(LOOK);
        }
    }
}

fn write(mut sink: Sink, waiting: &Receiver<Line>, counts: &LineCounts) {
    let mut told = 0;
    for line in waiting {
        let lost = counts.lost.load(Ordering::Acquire);
        if lost > told {
            let text = format!("{} lines of the log were lost", lost - told);
            if sink.write(&Line { level: Level::WARN, time: line.time.clone(), text }).is_ok() {
                told = lost;
            }
        }
        if sink.write(&line).is_err() {
            counts.lost.fetch_add(1, Ordering::AcqRel);
        }
        counts.done.fetch_add(1, Ordering::AcqRel);
    }
}

impl Sink {
    fn write(&mut self, line: &Line) -> io::Result<()> {
        match self {
            Self::Stream { to, colours } => to.write_all(in_words(line, *colours).as_bytes()),
            Self::Journal(journal) => journal.write(line.level, &line.text),
        }
    }
}

fn in_words(line: &Line, colours: bool) -> String {
    let Line { level, time, text } = line;
    if !colours {
        return format!("{time} {level:>5} {text}\n");
    }
    let colour = match *level {
        Level::ERROR => 31,
        Level::WARN => 33,
        Level::INFO => 32,
        Level::DEBUG => 34,
        Level::TRACE => 35,
    };
    format!("\x1b[2m{time}\x1b[0m \x1b[{colour}m{level:>5}\x1b[0m {text}\n")
}

#[cfg(test)]
mod tests {
    use std::sync::Mutex;
    use std::sync::mpsc::channel;

    use super::*;

    fn line(text: impl Into<String>) -> Line {
        Line { level: Level::INFO, time: "12:00".to_owned(), text: text.into() }
    }

    /// Fails while `full`, and waits for a go before each write.
    struct Disk {
        go: Receiver<bool>,
        written: Arc<Mutex<String>>,
    }

    impl Write for Disk {
        fn write(&mut self, bytes: &[u8]) -> io::Result<usize> {
            if self.go.recv().unwrap_or(true) {
                self.written.lock().unwrap().push_str(std::str::from_utf8(bytes).unwrap());
                return Ok(bytes.len());
            }
            Err(io::ErrorKind::StorageFull.into())
        }

        fn flush(&mut self) -> io::Result<()> {
            Ok(())
        }
    }

    fn disk() -> (LineQueue, SyncSender<bool>, Arc<Mutex<String>>) {
        let (go, waits) = sync_channel(10_000);
        let written = Arc::new(Mutex::new(String::new()));
        let to = Box::new(Disk { go: waits, written: Arc::clone(&written) });
        (LineQueue::start(Sink::Stream { to, colours: false }).unwrap(), go, written)
    }

    /// The sum of what each notice among `written` says was lost: how many notices there are depends on when the
    /// writing thread first got to run.
    fn told_lost(written: &str) -> u64 {
        let notices = written.lines().filter_map(|line| line.strip_suffix(" lines of the log were lost"));
        notices.filter_map(|notice| notice.rsplit(' ').next()?.parse::<u64>().ok()).sum()
    }

    #[test]
    fn a_sink_that_is_held_up_costs_lines_and_nobody_waits() {
        let (queue, go, written) = disk();
        for i in 0..3 * CAPACITY {
            queue.push(line(format!("line {i}")));
        }
        let lost = queue.lost();
        // The thread holds at most one line in its hands, and none that it has written.
        assert!((2 * CAPACITY as u64 - 1..=2 * CAPACITY as u64).contains(&lost), "{lost}");
        let clock = CompanionClock::new();
        queue.drain(&clock, Span::from_millis(20));
        assert!(clock.now().micros() >= 20_000, "nothing is written yet");
        for _ in 0..2 * CAPACITY {
            go.send(true).unwrap();
        }
        queue.drain(&clock, Span::from_millis(10_000));
        queue.push(line("after"));
        queue.drain(&clock, Span::from_millis(10_000));
        let written = written.lock().unwrap();
        assert_eq!(told_lost(&written), lost, "{written}");
        assert!(written.ends_with("12:00  INFO after\n"), "{written}");
    }

    #[test]
    fn a_sink_that_fails_is_tried_again() {
        let (queue, go, written) = disk();
        let clock = CompanionClock::new();
        go.send(false).unwrap();
        queue.push(line("lost"));
        queue.drain(&clock, Span::from_millis(10_000));
        assert_eq!(queue.lost(), 1);
        go.send(true).unwrap();
        go.send(true).unwrap();
        queue.push(line("not lost"));
        queue.drain(&clock, Span::from_millis(10_000));
        assert_eq!(
            *written.lock().unwrap(),
            "12:00  WARN 1 lines of the log were lost\n12:00  INFO not lost\n"
        );
    }

    #[test]
    fn nobody_waits_for_a_thread_that_has_ended() {
        let (done, ended) = channel();
        let (queue, go, _) = disk();
        drop(go);
        std::thread::spawn(move || {
            queue.push(line("one"));
            queue.drain(&CompanionClock::new(), Span::from_millis(1000));
            done.send(queue.lost()).unwrap();
        });
        assert_eq!(ended.recv_timeout(Duration::from_secs(10)), Ok(0));
    }
}
