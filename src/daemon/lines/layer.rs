//! From `tracing`'s events to lines.

use std::ffi::OsString;
use std::fmt::{self, Write as _};
use std::fs::File;
use std::io::{self, IsTerminal};
use std::os::fd::AsFd;
use std::path::Path;
use std::sync::{Arc, Mutex, PoisonError};

use tracing::field::{Field, Visit};
use tracing::{Event, Subscriber};
use tracing_subscriber::fmt::format::Writer;
use tracing_subscriber::fmt::time::{FormatTime, SystemTime};
use tracing_subscriber::layer::{Context, SubscriberExt};
use tracing_subscriber::util::SubscriberInitExt;
use tracing_subscriber::{EnvFilter, Layer, Registry, reload};

use super::journal::{Journal, SOCKET, leads_to_journal};
use super::limit::LineLimit;
use super::queue::{Line, LineQueue, Sink};
use crate::config::{LogSettings, LogTo};
use crate::time::Span;
use crate::wire::companion_clock::CompanionClock;

/// A line is cut after so many bytes.
pub(super) const LONGEST: usize = 2000;

/// Why there is no log.
#[derive(Debug, thiserror::Error)]
pub enum LinesError {
    /// What is to be told cannot be understood.
    #[error("{0}")]
    Directives(#[from] tracing_subscriber::filter::ParseError),
    /// There is no journal, and it was asked for.
    #[error("log.to = \"journal\": {0}")]
    NoJournal(io::Error),
    /// The system has no thread or file to give.
    #[error("the log cannot be started: {0}")]
    Io(#[from] io::Error),
    /// There is one already.
    #[error("the log cannot be started: {0}")]
    Twice(String),
}

/// The log that is running.
#[derive(Clone, Debug)]
pub struct LogHandle {
    queue: LineQueue,
    limit: Arc<Mutex<LineLimit>>,
    filter: reload::Handle<EnvFilter, Registry>,
    clock: CompanionClock,
}

/// Starts the log of this process. `directives` (as in `info,holdover::wire=debug`) override the configured level.
///
/// # Errors
/// [`LinesError`].
pub fn start(
    settings: &LogSettings,
    directives: Option<&str>,
    clock: &CompanionClock,
) -> Result<LogHandle, LinesError> {
    let (filter, reloaded) = reload::Layer::new(EnvFilter::try_new(directives.unwrap_or(&settings.level))?);
    let queue = LineQueue::start(sink(settings.to)?)?;
    let limit = Arc::new(Mutex::new(LineLimit::new(settings.lines_per_event_per_min)));
    let lines = Lines { queue: queue.clone(), limit: Arc::clone(&limit), clock: clock.clone() };
    let subscriber = Registry::default().with(filter).with(lines);
    subscriber.try_init().map_err(|e| LinesError::Twice(e.to_string()))?;
    Ok(LogHandle { queue, limit, filter: reloaded, clock: clock.clone() })
}

fn sink(to: LogTo) -> Result<Sink, LinesError> {
    // Not by the library's handle: who waits for its lock would wait for as long as the line of another.
    let stream = File::from(io::stderr().as_fd().try_clone_to_owned()?);
    let told = std::env::var("JOURNAL_STREAM").ok();
    let open = || Journal::open(Path::new(SOCKET));
    let journal = match to {
        LogTo::Stderr => None,
        LogTo::Journal => Some(open().map_err(LinesError::NoJournal)?),
        LogTo::Auto if leads_to_journal(&stream, told.as_deref()) => open().ok(),
        LogTo::Auto => None,
    };
    Ok(match journal {
        Some(journal) => Sink::Journal(journal),
        None => Sink::Stream {
            colours: stream.is_terminal() && !plain(std::env::var_os("NO_COLOR")),
            to: Box::new(stream),
        },
    })
}

/// Whether somebody wants no colours: <https://no-color.org>.
fn plain(no_color: Option<OsString>) -> bool {
    no_color.is_some_and(|value| !value.is_empty())
}

impl LogHandle {
    /// Lines that were told and not written.
    pub fn lost(&self) -> u64 {
        self.queue.lost()
    }

    /// Waits until everything is written, `limit` at most.
    pub fn drain(&self, limit: Span) {
        self.queue.drain(&self.clock, limit);
    }

    /// Another limit of lines from now on.
    pub fn set_limit(&self, lines_per_event_per_min: u32) {
        self.limit.lock().unwrap_or_else(PoisonError::into_inner).set(lines_per_event_per_min);
    }

    /// Another level from now on.
    ///
    /// # Errors
    /// [`LinesError::Directives`], [`LinesError::Io`].
    pub fn set_level(&self, level: &str) -> Result<(), LinesError> {
        let filter = EnvFilter::try_new(level)?;
        self.filter.reload(filter).map_err(|e| LinesError::Io(io::Error::other(e)))
    }
}

/// Makes lines of events.
struct Lines {
    queue: LineQueue,
    limit: Arc<Mutex<LineLimit>>,
    clock: CompanionClock,
}

impl<S: Subscriber> Layer<S> for Lines {
    fn on_event(&self, event: &Event<'_>, _: Context<'_, S>) {
        let mut words = LineWords(String::new());
        event.record(&mut words);
        let (level, text) = (*event.metadata().level(), words.0);
        let mut time = String::new();
        // A clock that cannot be told leaves the line without a time.
        let _ = SystemTime.format_time(&mut Writer::new(&mut time));
        let tells = self.limit.lock().unwrap_or_else(PoisonError::into_inner).judge(
            self.clock.now(),
            level,
            &text,
            |level, text| self.queue.push(Line { level, time: time.clone(), text }),
        );
        if tells {
            self.queue.push(Line { level, time, text });
        }
    }
}

/// The message of an event, and its other fields as `name=value`, in one line: what another has sent must not look like lines of ours.
struct LineWords(String);

impl LineWords {
    fn add(&mut self, field: &Field, value: fmt::Arguments<'_>) {
        let mut text = String::new();
        // Writing to a string does not fail.
        let _ = match field.name() {
            "message" => write!(text, "{value}"),
            name => write!(text, " {name}={value}"),
        };
        let room = LONGEST.saturating_sub(self.0.len());
        self.0.extend(text.chars().take(room).map(|c| if c.is_control() { ' ' } else { c }));
    }
}

impl Visit for LineWords {
    fn record_str(&mut self, field: &Field, value: &str) {
        self.add(field, format_args!("{value}"));
    }

    fn record_debug(&mut self, field: &Field, value: &dyn fmt::Debug) {
        self.add(field, format_args!("{value:?}"));
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn who_wants_no_colours_has_none() {
        let said = |text: &str| plain(Some(text.into()));
        assert_eq!((plain(None), said(""), said("1"), said("0")), (false, false, true, true));
    }
}
