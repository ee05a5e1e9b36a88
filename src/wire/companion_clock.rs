//! The companion computer's clocks: the one place where time enters Holdover.
//!
//! Everything else is handed a [`Stamp`]; a replayed log and a test hand it one of their own.

use std::sync::Arc;
use std::sync::atomic::{AtomicI64, Ordering};
use std::time::{Instant, SystemTime, UNIX_EPOCH};

use crate::time::{Companion, Span, Stamp};

/// A clock to read companion stamps from. Clones read the same clock.
#[derive(Clone, Debug)]
pub struct CompanionClock {
    source: Source,
}

#[derive(Clone, Debug)]
enum Source {
    Monotonic { zero: Instant },
    Manual { micros: Arc<AtomicI64> },
}

impl CompanionClock {
    /// The operating system's monotonic clock; its zero is now.
    #[allow(clippy::disallowed_methods, reason = "the one place where the monotonic clock is read")]
    pub fn new() -> Self {
        Self { source: Source::Monotonic { zero: Instant::now() } }
    }

    /// A clock that stands still until [`CompanionClock::advance`] moves it, for tests.
    pub fn manual(start: Stamp<Companion>) -> Self {
        Self { source: Source::Manual { micros: Arc::new(AtomicI64::new(start.micros())) } }
    }

    /// The time now.
    #[allow(clippy::disallowed_methods, reason = "the one place where the monotonic clock is read")]
    pub fn now(&self) -> Stamp<Companion> {
        match &self.source {
            Source::Monotonic { zero } => {
                let elapsed = Instant::now().saturating_duration_since(*zero);
                Stamp::from_micros(i64::try_from(elapsed.as_micros()).unwrap_or(i64::MAX))
            }
            Source::Manual { micros } => Stamp::from_micros(micros.load(Ordering::Acquire)),
        }
    }

    /// The time of day, µs since 1970. It may be wrong and may be set: it tells one boot of an autopilot from another, and nothing else. A manual
    /// clock is taken to have begun in 1970.
    #[allow(clippy::disallowed_methods, reason = "the one place where the time of day is read")]
    pub fn unix_us(&self) -> i64 {
        match &self.source {
            Source::Monotonic { .. } => {
                let since = SystemTime::now().duration_since(UNIX_EPOCH).unwrap_or_default();
                i64::try_from(since.as_micros()).unwrap_or(i64::MAX)
            }
            Source::Manual { micros } => micros.load(Ordering::Acquire),
        }
    }

    /// Moves a manual clock, and all its clones, by `span`. The monotonic clock cannot be moved and ignores this.
    pub fn advance(&self, span: Span) {
        if let Source::Manual { micros } = &self.source {
            micros.fetch_add(span.micros(), Ordering::AcqRel);
        }
    }
}

impl Default for CompanionClock {
    fn default() -> Self {
        Self::new()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_monotonic_clock_starts_near_zero_and_never_runs_back() {
        let clock = CompanionClock::new();
        let readings: Vec<_> = (0..1000).map(|_| clock.now()).collect();
        assert!(readings[0].micros() < 1_000_000);
        assert!(readings.is_sorted());
        clock.advance(Span::from_seconds(-100.0));
        assert!(clock.now() >= readings[999]);
    }

    #[test]
    fn a_manual_clock_moves_only_by_hand_and_with_its_clones() {
        let clock = CompanionClock::manual(Stamp::from_micros(5));
        let other = clock.clone();
        assert_eq!(other.now(), Stamp::from_micros(5));
        clock.advance(Span::from_millis(2));
        assert_eq!(other.now(), Stamp::from_micros(2005));
    }
}
