//! Whether the IMU's samples come when they should: a position that stands on a sample of 1.5 s ago is where the vehicle was.
//!
//! The link's own latency cannot be told from one way of it, so what counts is what it does not explain. Where TIMESYNC knows the autopilot's
//! clock, a sample is late by its age at its arrival less the shortest round trip: no way is longer than there and back. Else by how much its
//! transit (arrival less stamp, on two clocks) exceeds the shortest of late, which may grow as fast as the slowest clock there is, a
//! simulation's. A link that is slow, and stays as slow as it is, is late by neither.

use crate::time::{AutopilotTime, Companion, Span, Stamp};
use crate::wire::clock::AutopilotClock;

/// A simulation runs this much slower than its time, s/s.
const SLOWEST: f64 = 0.2;
/// TIMESYNC and the stamps are one clock if they once agreed within this.
const ONE_CLOCK: Span = Span::from_millis(1000);
/// A transit that stayed so long is the link's new latency, for who has no TIMESYNC to ask.
const FOR_GOOD: Span = Span::from_millis(60_000);
/// Samples have to come in time for so long before it is told that they do.
const STEADY: Span = Span::from_millis(5000);

/// What is to be told.
#[derive(Clone, Copy, PartialEq, Debug)]
pub(super) enum LateNews {
    /// Samples come late, by this much.
    Late(Span),
    /// They come in time again.
    InTime,
    /// They have come late by so much for so long that it is taken for the link's latency.
    ForGood(Span),
}

/// Watches the transit of the IMU's samples.
#[derive(Clone, Copy, Debug)]
pub(super) struct LateWatch {
    limit: Span,
    /// The shortest transit of late, µs, as it stood at a sample of this time, µs.
    shortest: Option<(i64, i64)>,
    one_clock: bool,
    excess: Span,
    since: Option<Stamp<Companion>>,
    /// Lateness was told whose end was not; since when they come in time.
    told: Option<Stamp<Companion>>,
}

impl LateWatch {
    /// Samples are late that come later than `limit`.
    pub(super) fn new(limit: Span) -> Self {
        Self { limit, shortest: None, one_clock: false, excess: Span::ZERO, since: None, told: None }
    }

    /// How late the newest sample was, at least.
    pub(super) fn excess(&self) -> Span {
        self.excess
    }

    /// Another link, or another boot of the autopilot: nothing is known of its transit.
    pub(super) fn restart(&mut self) {
        *self = Self { told: self.told, ..Self::new(self.limit) };
    }

    /// A sample of `time` arrived at `at`. `sync` is the autopilot's clock less ours at that time, and the shortest round trip.
    pub(super) fn came(
        &mut self,
        at: Stamp<Companion>,
        time: AutopilotTime,
        clock: &AutopilotClock,
        sync: Option<(Span, Span)>,
    ) -> Option<LateNews> {
        let stamp = clock.boot_micros(time);
        let transit = at.micros().saturating_sub(stamp);
        let by_transit = self.over_the_shortest(stamp, transit);
        let by_sync = sync.and_then(|(offset, round_trip)| {
            let age = Span::from_micros(transit.saturating_add(offset.micros()));
            self.one_clock |= -ONE_CLOCK.micros() <= age.micros() && age <= ONE_CLOCK;
            let unexplained = age.micros().saturating_sub(round_trip.micros());
            self.one_clock.then(|| Span::from_micros(unexplained).max(Span::ZERO))
        });
        self.excess = by_sync.unwrap_or(by_transit);
        let late = self.excess > self.limit;
        let since = if late { Some(self.since.unwrap_or(at)) } else { None };
        self.since = since;
        if let Some(since) = since.filter(|_| by_sync.is_none())
            && at - since > FOR_GOOD
        {
            let excess = self.excess;
            (self.shortest, self.since, self.excess, self.told) =
                (Some((stamp, transit)), None, Span::ZERO, None);
            return Some(LateNews::ForGood(excess));
        }
        self.news(at, late)
    }

    /// By how much a transit exceeds the shortest of late, which it may be. While samples are late it does not grow.
    fn over_the_shortest(&mut self, stamp: i64, transit: i64) -> Span {
        let shortest = self.shortest.map_or(transit, |(then, shortest)| {
            let grows = if self.since.is_none() { SLOWEST } else { 0.0 };
            // By its own time: in a hole of arrivals nothing grows.
            let grown = grows * stamp.saturating_sub(then).max(0) as f64;
            transit.min(shortest.saturating_add(grown as i64))
        });
        self.shortest = Some((stamp, shortest));
        Span::from_micros(transit.saturating_sub(shortest))
    }

    fn news(&mut self, at: Stamp<Companion>, late: bool) -> Option<LateNews> {
        match self.told {
            None if late => {
                self.told = Some(at);
                Some(LateNews::Late(self.excess))
            }
            Some(_) if late => {
                self.told = Some(at);
                None
            }
            Some(then) if at - then >= STEADY => {
                self.told = None;
                Some(LateNews::InTime)
            }
            _ => None,
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const LIMIT: Span = Span::from_millis(200);

    /// Feeds 100 Hz of samples for `seconds` from `from_s`, which come `delay_ms` after their stamps; what was told, and the last excess.
    fn feed(
        watch: &mut LateWatch,
        (from_s, seconds): (f64, f64),
        delay_ms: impl Fn(f64) -> f64,
        sync: Option<(Span, Span)>,
    ) -> (Vec<LateNews>, f64) {
        let clock = AutopilotClock::new();
        let mut told = Vec::new();
        for i in 0..(seconds * 100.0) as i64 {
            let t = from_s + i as f64 * 0.01;
            let at = Stamp::from_micros(((t + delay_ms(t) * 1e-3) * 1e6) as i64);
            let time = AutopilotTime::from_micros(((t + 1000.0) * 1e6) as i64);
            told.extend(watch.came(at, time, &clock, sync));
        }
        (told, watch.excess().seconds())
    }

    #[test]
    fn a_link_that_is_slow_and_stays_so_is_not_late() {
        for delay_ms in [0.0, 300.0, 3000.0] {
            let mut watch = LateWatch::new(LIMIT);
            let (told, excess_s) =
                feed(&mut watch, (0.0, 100.0), |t| delay_ms + (t * 7.0).sin() * 30.0, None);
            assert_eq!(told, []);
            assert!(excess_s < 0.1, "{excess_s}");
        }
    }

    #[test]
    fn what_comes_later_than_it_did_is_late_and_told_once() {
        let mut watch = LateWatch::new(LIMIT);
        assert_eq!(feed(&mut watch, (0.0, 10.0), |_| 40.0, None).0, []);
        let (told, excess_s) = feed(&mut watch, (10.0, 30.0), |_| 1540.0, None);
        assert!(matches!(told[..], [LateNews::Late(_)]), "{told:?}");
        assert!((excess_s - 1.5).abs() < 0.05, "{excess_s}");
        let (told, excess_s) = feed(&mut watch, (40.0, 10.0), |_| 40.0, None);
        assert_eq!((told, excess_s), (vec![LateNews::InTime], 0.0));
    }

    #[test]
    fn a_route_that_became_slow_is_taken_as_it_is_after_a_minute() {
        let mut watch = LateWatch::new(LIMIT);
        feed(&mut watch, (0.0, 10.0), |_| 40.0, None);
        let (told, excess_s) = feed(&mut watch, (10.0, 70.0), |_| 540.0, None);
        assert!(matches!(told[..], [LateNews::Late(_), LateNews::ForGood(_)]), "{told:?}");
        assert!(excess_s < 0.01, "{excess_s}");
    }

    #[test]
    fn a_simulation_that_runs_slow_is_not_late() {
        let mut watch = LateWatch::new(LIMIT);
        let (told, _) = feed(&mut watch, (0.0, 300.0), |t| 150.0 * t, None);
        assert_eq!(told, []);
    }

    #[test]
    fn where_the_clock_is_known_a_link_explains_its_round_trip_and_no_more() {
        // Its clock is 1000 s ahead.
        let sync = |round_trip_ms| Some((Span::from_seconds(1000.0), Span::from_millis(round_trip_ms)));
        let mut watch = LateWatch::new(LIMIT);
        assert_eq!(feed(&mut watch, (0.0, 5.0), |_| 300.0, sync(600)).0, []);
        let (told, excess_s) = feed(&mut watch, (5.0, 200.0), |_| 1500.0, sync(600));
        assert!(matches!(told[..], [LateNews::Late(_)]), "never for good: {told:?}");
        assert!((excess_s - 0.9).abs() < 0.01, "{excess_s}");
        // Another clock tells nothing.
        let mut watch = LateWatch::new(LIMIT);
        let other = Some((Span::from_seconds(5000.0), Span::from_millis(1)));
        assert_eq!(feed(&mut watch, (0.0, 20.0), |_| 300.0, other).0, []);
    }
}
