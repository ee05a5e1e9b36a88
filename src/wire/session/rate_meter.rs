//! Rates as they are: events counted in a sliding window.

use crate::time::{Companion, Span, Stamp};

const BUCKETS: usize = 8;

/// Counts events in a sliding window of equal buckets.
#[derive(Clone, Debug)]
pub(super) struct RateMeter {
    bucket: Span,
    counts: [u32; BUCKETS],
    /// Number of the newest bucket since the clock's zero.
    newest: i64,
    /// Events from here on are counted.
    begun: Option<Stamp<Companion>>,
}

impl RateMeter {
    /// A meter whose window is at least 4 s, and holds 8 events of `rate_hz` at least.
    pub(super) fn for_rate(rate_hz: f64) -> Self {
        let bucket = Span::from_seconds((1.0 / rate_hz).clamp(0.5, 3600.0));
        Self { bucket, counts: [0; BUCKETS], newest: i64::MIN, begun: None }
    }

    /// Starts anew.
    pub(super) fn begin(&mut self, now: Stamp<Companion>) {
        self.counts = [0; BUCKETS];
        self.newest = self.number(now);
        self.begun = Some(now);
    }

    fn number(&self, now: Stamp<Companion>) -> i64 {
        now.micros().div_euclid(self.bucket.micros())
    }

    fn slot(number: i64) -> usize {
        usize::try_from(number.rem_euclid(BUCKETS as i64)).unwrap_or(0)
    }

    pub(super) fn count(&mut self, now: Stamp<Companion>) {
        if self.begun.is_none() {
            self.begin(now);
        }
        let number = self.number(now);
        let ahead = number.saturating_sub(self.newest);
        if ahead < 0 {
            return;
        }
        for step in 1..=ahead.min(BUCKETS as i64) {
            self.counts[Self::slot(number - ahead.min(BUCKETS as i64) + step)] = 0;
        }
        self.newest = number;
        let slot = &mut self.counts[Self::slot(number)];
        *slot = slot.saturating_add(1);
    }

    /// Time from [`RateMeter::begin`] until the rate is known.
    pub(super) fn settling(&self) -> Span {
        Span::from_micros(self.bucket.micros().saturating_mul(BUCKETS as i64))
    }

    /// Events a second over the complete buckets of the window; `None` before they all were.
    pub(super) fn rate(&self, now: Stamp<Companion>) -> Option<f64> {
        if now - self.begun? < self.settling() {
            return None;
        }
        // The newest bucket is not complete; of the others, those that `count` did not clear may be outdated.
        let current = self.number(now);
        let sum: u32 = (1..BUCKETS as i64)
            .map(|back| current.saturating_sub(back))
            .filter(|&n| n <= self.newest && n > self.newest.saturating_sub(BUCKETS as i64))
            .map(|n| self.counts[Self::slot(n)])
            .fold(0, u32::saturating_add);
        Some(f64::from(sum) / (self.bucket.seconds() * (BUCKETS - 1) as f64))
    }
}

#[cfg(test)]
mod tests {
    use proptest::prelude::*;

    use super::*;

    fn at(ms: i64) -> Stamp<Companion> {
        Stamp::from_micros(ms * 1000)
    }

    #[test]
    fn a_rate_falls_to_zero_when_a_stream_stops() {
        let mut meter = RateMeter::for_rate(10.0);
        meter.begin(at(0));
        for ms in (0..10_000).step_by(100) {
            meter.count(at(ms));
        }
        assert!((meter.rate(at(10_000)).unwrap() - 10.0).abs() < 1e-9);
        assert!(meter.rate(at(12_000)).unwrap() < 7.0);
        assert_eq!(meter.rate(at(14_500)), Some(0.0));
        assert_eq!(meter.rate(at(3_600_000)), Some(0.0));
    }

    #[test]
    fn slow_streams_are_measured_over_a_longer_window() {
        let mut meter = RateMeter::for_rate(0.2);
        meter.begin(at(0));
        for s in (0..200).step_by(5) {
            meter.count(at(s * 1000 + 40));
        }
        assert!((meter.rate(at(200_000)).unwrap() - 0.2).abs() < 1e-9);
    }

    proptest! {
        #[test]
        fn any_regular_rate_is_measured_to_a_tenth(hz in 2.0f64..400.0, phase_us in 0i64..1_000_000) {
            let mut meter = RateMeter::for_rate(hz);
            meter.begin(Stamp::from_micros(phase_us));
            let step = 1e6 / hz;
            for i in 0..=(hz * 10.0) as i64 {
                meter.count(Stamp::from_micros(phase_us + (i as f64 * step) as i64));
            }
            let rate = meter.rate(Stamp::from_micros(phase_us + 10_000_000)).unwrap();
            prop_assert!((rate - hz).abs() <= 0.15 * hz, "{rate} instead of {hz}");
        }
    }
}
