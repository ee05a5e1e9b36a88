//! The autopilot's clock against the companion's as a straight line: an offset, and a rate where it shows.
//!
//! Crystals agree to 1e-4, simulated clocks only to some percent: SITL runs as fast as its machine allows.

use crate::time::{Companion, Span, Stamp};

/// What one answer tells: its offset is right within half its round trip.
#[derive(Clone, Copy, Debug)]
pub(super) struct ClockReading {
    /// Autopilot clock less companion clock.
    pub(super) offset: Span,
    pub(super) round_trip: Span,
    pub(super) at: Stamp<Companion>,
}

/// The estimate: `offset` at `at`, growing by `rate`.
#[derive(Clone, Copy, Debug)]
pub(super) struct ClockLine {
    pub(super) offset: Span,
    /// Seconds a second; `None` while the readings do not tell it from zero.
    pub(super) rate: Option<f64>,
    /// The shortest round trip of the readings it stands on.
    pub(super) round_trip: Span,
    pub(super) at: Stamp<Companion>,
}

/// Slack between two bounds, for clocks that are read late.
const SLACK: Span = Span::from_millis(10);
/// A rate is believed beyond so many of its standard deviations …
const SIGNIFICANT: f64 = 5.0;
/// … up to here (SITL on a busy machine), from readings over so long, s, of which there are so many.
const FASTEST: f64 = 0.05;
const SHORTEST_S: f64 = 0.6;
const FEWEST: usize = 8;
/// What two clocks may drift apart by while no rate is known, and by how much a known rate may change, s/s.
const UNKNOWN_RATE: f64 = 0.02;
const RATE_CHANGE: f64 = 2e-3;

impl ClockLine {
    /// The line through readings near the shortest round trip, as it stands at the newest reading, and how many these are. `before` keeps
    /// its rate until the readings show one.
    pub(super) fn fit<'a>(
        readings: impl DoubleEndedIterator<Item = &'a ClockReading> + Clone,
        before: Option<f64>,
    ) -> Option<(Self, usize)> {
        let newest = *readings.clone().next_back()?;
        let best = readings.clone().map(|r| r.round_trip).min()?;
        // Differences to the newest are small, so nothing overflows whatever the offsets are.
        let near = readings.filter(|r| r.is_near(best)).map(|r| {
            let apart = i128::from(r.offset.micros()) - i128::from(newest.offset.micros());
            ((r.at - newest.at).seconds(), apart as f64 * 1e-6)
        });
        let n = near.clone().count();
        let rate = if can_tell(near.clone(), n) { slope(near.clone(), n) } else { before };
        let mean = near.map(|(t, y)| y - rate.unwrap_or(0.0) * t).sum::<f64>() / n.max(1) as f64;
        let offset = newest.offset.micros().saturating_add(Span::from_seconds(mean).micros());
        let line = Self { offset: Span::from_micros(offset), rate, round_trip: best, at: newest.at };
        Some((line, n))
    }

    /// The offset at another time.
    pub(super) fn offset_at(&self, now: Stamp<Companion>) -> Span {
        let grown = Span::from_seconds(self.rate.unwrap_or(0.0) * now.seconds_since(self.at));
        Span::from_micros(self.offset.micros().saturating_add(grown.micros()))
    }

    /// Whether the bounds of a reading and of the line have no offset in common.
    pub(super) fn contradicts(&self, reading: &ClockReading) -> bool {
        let drift = if self.rate.is_some() { RATE_CHANGE } else { UNKNOWN_RATE };
        let elapsed_s = reading.at.seconds_since(self.at).abs();
        apart(
            self.offset_at(reading.at),
            reading.offset,
            [self.round_trip, reading.round_trip],
            drift * elapsed_s,
        )
    }
}

impl ClockReading {
    /// Whether its round trip is about as short as the shortest.
    pub(super) fn is_near(&self, best: Span) -> bool {
        self.round_trip.micros() <= best.micros().saturating_add(best.micros() / 2).saturating_add(500)
    }

    /// Whether the bounds of two readings have no offset in common, at any rate that is possible.
    pub(super) fn contradicts(&self, other: &Self) -> bool {
        let drift_s = UNKNOWN_RATE * other.at.seconds_since(self.at).abs();
        apart(self.offset, other.offset, [self.round_trip, other.round_trip], drift_s)
    }
}

fn apart(a: Span, b: Span, round_trips: [Span; 2], drift_s: f64) -> bool {
    let [x, y] = round_trips.map(Span::micros);
    let bound = (x.saturating_add(y) / 2)
        .saturating_add(SLACK.micros())
        .saturating_add(Span::from_seconds(drift_s).micros());
    a.micros().abs_diff(b.micros()) > u64::try_from(bound).unwrap_or(0)
}

/// Mean of the times of points.
fn middle(points: impl Iterator<Item = (f64, f64)>, n: usize) -> f64 {
    points.map(|p| p.0).sum::<f64>() / n as f64
}

/// Whether points are many enough and over long enough to show a rate.
fn can_tell(points: impl Iterator<Item = (f64, f64)> + Clone, n: usize) -> bool {
    if n < FEWEST {
        return false;
    }
    let t = middle(points.clone(), n);
    // Evenly spread points over a span T have a variance of T²/12.
    let variance = points.map(|p| (p.0 - t).powi(2)).sum::<f64>() / n as f64;
    (12.0 * variance).sqrt() >= SHORTEST_S
}

/// Least-squares slope of `n` points (s, s), where it is one beyond doubt.
fn slope(points: impl Iterator<Item = (f64, f64)> + Clone, n: usize) -> Option<f64> {
    let t = middle(points.clone(), n);
    let y = points.clone().map(|p| p.1).sum::<f64>() / n as f64;
    let (tt, ty) =
        points.clone().fold((0.0, 0.0), |(tt, ty), p| (tt + (p.0 - t).powi(2), ty + (p.0 - t) * (p.1 - y)));
    let rate = ty / tt;
    let residual: f64 = points.map(|p| (p.1 - y - rate * (p.0 - t)).powi(2)).sum();
    let sigma = (residual / (n as f64 - 2.0) / tt).sqrt();
    (rate.abs() > SIGNIFICANT * sigma && rate.abs() <= FASTEST).then_some(rate)
}
