//! The service manager's watchdog, fed only while frames are handled: one that stands still is ended and begun anew.

use crate::time::{Companion, Span, Stamp};

/// It is fed this many times in the time that it waits.
const TIMES: i64 = 3;

/// See the module's documentation.
pub struct AliveSign {
    every: Span,
    fed: Option<Stamp<Companion>>,
    feed: Box<dyn FnMut() + Send>,
}

impl std::fmt::Debug for AliveSign {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.debug_struct("AliveSign").field("every", &self.every).finish_non_exhaustive()
    }
}

impl AliveSign {
    /// A watchdog that waits for `patience`, and what feeds it.
    pub fn new(patience: Span, feed: impl FnMut() + Send + 'static) -> Self {
        Self { every: Span::from_micros(patience.micros() / TIMES), fed: None, feed: Box::new(feed) }
    }

    /// Timers are looked at: so the task runs. `handled`: since the last time frames were handled, or none waits.
    pub(super) fn poll(&mut self, now: Stamp<Companion>, handled: bool) {
        if handled && self.fed.is_none_or(|fed| now - fed >= self.every) {
            self.fed = Some(now);
            (self.feed)();
        }
    }
}

#[cfg(test)]
mod tests {
    use std::sync::Arc;
    use std::sync::atomic::{AtomicU32, Ordering};

    use super::*;

    #[test]
    fn it_is_fed_in_time_and_not_while_frames_wait() {
        let fed = Arc::new(AtomicU32::new(0));
        let count = Arc::clone(&fed);
        let mut alive = AliveSign::new(Span::from_millis(3000), move || {
            let _ = count.fetch_add(1, Ordering::Relaxed);
        });
        let at = |ms: i64| Stamp::from_micros(ms * 1000);
        for ms in (0..10_000).step_by(50) {
            alive.poll(at(ms), true);
        }
        assert_eq!(fed.load(Ordering::Relaxed), 10);
        for ms in (10_000..20_000).step_by(50) {
            alive.poll(at(ms), false);
        }
        assert_eq!(fed.load(Ordering::Relaxed), 10);
        alive.poll(at(20_000), true);
        assert_eq!(fed.load(Ordering::Relaxed), 11);
    }
}
