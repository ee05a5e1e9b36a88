//! A token bucket: how much may be done for somebody a second, with a reserve for bursts.

use std::time::Duration;

use crate::time::{Companion, Stamp};

/// See the module's documentation. What a token stands for is its owner's matter: a byte, a frame, a datagram.
#[derive(Clone, Copy, Debug)]
pub(super) struct Bucket {
    per_s: f64,
    capacity: f64,
    tokens: f64,
    filled: Option<Stamp<Companion>>,
}

impl Bucket {
    /// A full one that gets `per_s` tokens a second and holds `capacity`.
    pub(super) fn new(per_s: f64, capacity: f64) -> Self {
        // A bucket that is never filled would starve its owner for ever.
        let (per_s, capacity) = (per_s.max(1.0), capacity.max(1.0));
        Self { per_s, capacity, tokens: capacity, filled: None }
    }

    /// Takes `n` tokens, if there are so many, or if it is full: what is larger than it has to pass at some time.
    pub(super) fn take(&mut self, n: usize, now: Stamp<Companion>) -> bool {
        let since = self.filled.unwrap_or(now);
        self.filled = Some(since.max(now));
        self.tokens = (self.tokens + self.per_s * now.seconds_since(since).max(0.0)).min(self.capacity);
        let enough = self.tokens >= (n as f64).min(self.capacity);
        if enough {
            self.tokens -= n as f64;
        }
        enough
    }

    /// How long it takes from the last [`Bucket::take`] on until `n` tokens can be taken.
    pub(super) fn wait(&self, n: usize) -> Duration {
        let missing = (n as f64).min(self.capacity) - self.tokens;
        Duration::try_from_secs_f64(missing / self.per_s).unwrap_or_default()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn at(ms: i64) -> Stamp<Companion> {
        Stamp::from_micros(ms * 1000)
    }

    #[test]
    fn a_burst_passes_and_then_the_rate() {
        let mut bucket = Bucket::new(100.0, 50.0);
        assert_eq!((0..80).filter(|_| bucket.take(1, at(0))).count(), 50);
        assert_eq!(bucket.wait(1), Duration::from_millis(10));
        assert_eq!((0..80).filter(|_| bucket.take(1, at(100))).count(), 10);
        let passed = (0..10_000).filter(|i| bucket.take(1, at(100 + i))).count();
        assert!((995..=1010).contains(&passed), "{passed}");
    }

    #[test]
    fn what_is_larger_than_the_bucket_passes_when_it_is_full() {
        let mut bucket = Bucket::new(10.0, 10.0);
        assert!(bucket.take(35, at(0)));
        assert!(!bucket.take(1, at(2500)));
        assert!(bucket.take(1, at(2700)));
        assert!(!bucket.take(35, at(2700)));
        assert!(bucket.take(35, at(10_000)));
    }
}
