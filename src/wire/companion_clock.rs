//! The companion computer's clocks: the one place where time enters Holdover.
//!
//! Everything else is handed a [`Stamp`]; a replayed log and a test hand it one of their own.

use std::sync::Arc;
use std::sync::atomic::{AtomicI64, Ordering};
use std::time::{SystemTime, UNIX_EPOCH};

use nix::time::{ClockId, clock_gettime};

use crate::time::{Companion, Span, Stamp};

/// A clock to read companion stamps from. Clones read the same clock.
#[derive(Clone, Debug)]
pub struct CompanionClock {
    source: Source,
}

#[derive(Clone, Debug)]
enum Source {
    SinceBoot { zero_us: i64 },
    Manual { micros: Arc<AtomicI64> },
}

impl CompanionClock {
    /// The operating system's clock since boot, which never runs back and goes on while the computer is suspended: what was read before is old
    /// after it. Its zero is now.
    pub fn new() -> Self {
        Self { source: Source::SinceBoot { zero_us: since_boot_us() } }
    }

    /// A clock that stands still until [`CompanionClock::advance`] moves it, for tests.
    pub fn manual(start: Stamp<Companion>) -> Self {
        Self { source: Source::Manual { micros: Arc::new(AtomicI64::new(start.micros())) } }
    }

    /// The time now.
    pub fn now(&self) -> Stamp<Companion> {
        match &self.source {
            Source::SinceBoot { zero_us } => Stamp::from_micros(since_boot_us() - zero_us),
            Source::Manual { micros } => Stamp::from_micros(micros.load(Ordering::Acquire)),
        }
    }

    /// The time of day, µs since 1970. It may be wrong and may be set: it tells one boot of an autopilot from another, and nothing else. A manual
    /// clock is taken to have begun in 1970.
    #[allow(clippy::disallowed_methods, reason = "the one place where the time of day is read")]
    pub fn unix_us(&self) -> i64 {
        match &self.source {
            Source::SinceBoot { .. } => {
                let since = SystemTime::now().duration_since(UNIX_EPOCH).unwrap_or_default();
                i64::try_from(since.as_micros()).unwrap_or(i64::MAX)
            }
            Source::Manual { micros } => micros.load(Ordering::Acquire),
        }
    }

    /// Moves a manual clock, and all its clones, by `span`. The clock since boot cannot be moved and ignores this.
    pub fn advance(&self, span: Span) {
        if let Source::Manual { micros } = &self.source {
            micros.fetch_add(span.micros(), Ordering::AcqRel);
        }
    }
}

/// Every Linux that Rust runs on has this clock.
fn since_boot_us() -> i64 {
    clock_gettime(ClockId::CLOCK_BOOTTIME).map_or(0, |t| t.tv_sec() * 1_000_000 + t.tv_nsec() / 1000)
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
    fn the_clock_since_boot_starts_near_zero_and_never_runs_back() {
        let clock = CompanionClock::new();
        let readings: Vec<_> = (0..1000).map(|_| clock.now()).collect();
        assert!(readings[0].micros() < 1_000_000);
        assert!(readings.is_sorted());
        clock.advance(Span::from_seconds(-100.0));
        assert!(clock.now() >= readings[999]);
    }

    #[test]
    fn it_goes_on_with_the_computers_time_since_boot() {
        let uptime = || {
            let text = std::fs::read_to_string("/proc/uptime").unwrap();
            (text.split(' ').next().unwrap().parse::<f64>().unwrap() * 1e6) as i64
        };
        // Both of them count what was suspended; the system's other clock does not.
        let (before, clock) = (uptime(), CompanionClock::new());
        let Source::SinceBoot { zero_us } = clock.source else { panic!("{clock:?}") };
        assert!((before - 20_000..=uptime() + 20_000).contains(&zero_us));
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
