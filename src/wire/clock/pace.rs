//! How fast the autopilot's clock runs against the arrival of its frames, and so which stamps can be of the present.
//!
//! No frame comes before it was sent: of all frames those that came quickest bound what the autopilot's clock can show. A stamp beyond that
//! bound is of the future, whoever wrote it. The bound is the largest lead of the last window, for clocks drift and links change. A
//! simulation may run faster than time does, and not evenly: the rate is measured, and one above that of time may double.

use crate::time::{Companion, Span, Stamp};

/// A receiver may note two frames in the wrong order, µs; one whose clock goes back further was set.
const OUT_OF_ORDER_US: i64 = 5_000_000;
/// In the beginning a link may be working off what has waited, µs: so long, and by so much.
const YOUNG_US: i64 = 3_000_000;
const YOUNG_SLACK_US: i64 = 2_000_000;
/// A stamp may be ahead of the bound by this, µs.
const SLACK_US: i64 = 500_000;
/// Length of a window, µs.
const WINDOW_US: i64 = 30_000_000;
/// Least time that a rate is measured over, µs.
const MEASURED_US: i64 = 100_000;
/// Within a window the bound is raised by this part of the time that passes at most: clocks differ by less. And by this at once, µs.
const DRIFT: f64 = 0.01;
const RAISED_US: i64 = 50_000;
/// A rate that differs by more is another, and one that is more above 1 a simulation's.
const ANOTHER_RATE: f64 = 0.05;

/// A stamp, µs since boot, and when it came.
#[derive(Clone, Copy, Debug)]
struct StampReading {
    at: Stamp<Companion>,
    boot_us: i64,
}

/// The bound, once there was a frame whose arrival is known.
#[derive(Clone, Copy, Debug, Default)]
pub(super) struct ArrivalPace(Option<Bound>);

#[derive(Clone, Copy, Debug)]
struct Bound {
    origin: StampReading,
    /// Seconds of the autopilot's clock for one of ours; never below 1: what lags explains no lead.
    rate: f64,
    newest: StampReading,
    /// Largest lead on the line through the origin: what is in force, and that of this window.
    top_us: i64,
    window_top_us: i64,
    window: StampReading,
    raised: Stamp<Companion>,
}

impl Bound {
    fn new(origin: StampReading) -> Self {
        Self {
            origin,
            rate: 1.0,
            newest: origin,
            top_us: 0,
            window_top_us: 0,
            window: origin,
            raised: origin.at,
        }
    }

    fn is_young(&self, at: Stamp<Companion>) -> bool {
        (at - self.origin.at).micros() < YOUNG_US
    }

    /// When something came; `None` if the receiver's clock was set back since.
    fn ordered(&self, at: Stamp<Companion>) -> Option<Stamp<Companion>> {
        ((self.newest.at - at).micros() <= OUT_OF_ORDER_US).then(|| at.max(self.newest.at))
    }

    fn is_simulated(&self) -> bool {
        self.rate > 1.0 + ANOTHER_RATE
    }

    fn slack_us(&self, at: Stamp<Companion>) -> i64 {
        let slack_us = if self.is_young(at) { YOUNG_SLACK_US } else { SLACK_US };
        (slack_us as f64 * self.rate) as i64
    }

    fn lead_us(&self, r: StampReading) -> i64 {
        let most = if self.is_simulated() { 2.0 * self.rate } else { 1.0 };
        let elapsed = (r.at - self.origin.at).micros() as f64 * most;
        r.boot_us.saturating_sub(self.origin.boot_us).saturating_sub(elapsed as i64)
    }

    fn note(&mut self, r: StampReading) {
        if self.is_young(r.at) {
            self.rate = rate(&self.origin, &r).unwrap_or(self.rate).max(1.0);
            self.top_us = self.top_us.max(self.lead_us(r));
            (self.window, self.window_top_us, self.raised) = (r, self.top_us, r.at);
            return;
        }
        let lead = self.lead_us(r);
        self.window_top_us = self.window_top_us.max(lead);
        if lead > self.top_us {
            let most = ((r.at - self.raised).micros() as f64 * DRIFT) as i64;
            self.top_us += (lead - self.top_us).min(most).min(RAISED_US);
            self.raised = r.at;
        }
        if (r.at - self.window.at).micros() >= WINDOW_US {
            self.end_window(r);
        }
    }

    fn end_window(&mut self, r: StampReading) {
        let measured = rate(&self.window, &r).unwrap_or(self.rate).max(1.0);
        if (measured / self.rate - 1.0).abs() > ANOTHER_RATE {
            *self = Self { rate: measured, ..Self::new(r) };
            return;
        }
        self.top_us = self.window_top_us;
        self.window_top_us = self.lead_us(r);
        self.window = r;
    }
}

fn rate(from: &StampReading, to: &StampReading) -> Option<f64> {
    let elapsed = (to.at - from.at).micros();
    let passed = to.boot_us.saturating_sub(from.boot_us);
    (elapsed >= MEASURED_US).then(|| passed as f64 / elapsed as f64)
}

impl ArrivalPace {
    /// Whether a stamp of `boot_us` can be in a frame that comes `at`.
    pub(super) fn explains(&self, at: Option<Stamp<Companion>>, boot_us: i64) -> bool {
        let (Some(bound), Some(at)) = (&self.0, at) else { return true };
        let slack = bound.slack_us(at);
        // A receiver whose clock was set back knows nothing.
        let Some(at) = bound.ordered(at) else { return true };
        bound.lead_us(StampReading { at, boot_us }) <= bound.top_us.saturating_add(slack)
    }

    /// How long ago by the autopilot's clock the newest stamp came that was believed; `None` where that is not known.
    pub(super) fn since_newest(&self, at: Option<Stamp<Companion>>) -> Option<Span> {
        let (bound, at) = self.0.as_ref().zip(at)?;
        let passed = (at - bound.newest.at).micros();
        (passed >= 0).then(|| Span::from_micros((passed as f64 * bound.rate) as i64))
    }

    /// Whether it is a simulation's, whose rate changes.
    pub(super) fn is_simulated(&self) -> bool {
        self.0.as_ref().is_some_and(Bound::is_simulated)
    }

    /// Seconds of the autopilot's clock for one of the receiver's.
    pub(super) fn rate(&self) -> f64 {
        self.0.as_ref().map_or(1.0, |bound| bound.rate)
    }

    /// A stamp was believed.
    pub(super) fn note(&mut self, at: Option<Stamp<Companion>>, boot_us: i64) {
        let Some(at) = at else { return };
        let ordered = self.0.as_ref().and_then(|bound| bound.ordered(at));
        match (&mut self.0, ordered) {
            (Some(bound), Some(at)) => {
                let reading = StampReading { at, boot_us };
                bound.note(reading);
                bound.newest = reading;
            }
            _ => self.0 = Some(Bound::new(StampReading { at, boot_us })),
        }
    }

    /// The clock has jumped to this.
    pub(super) fn restart(&mut self, at: Option<Stamp<Companion>>, boot_us: i64) {
        let rate = self.rate();
        self.0 = at.map(|at| Bound { rate, ..Bound::new(StampReading { at, boot_us }) });
    }

    /// The clock is found to have been running for so much longer, µs.
    pub(super) fn shift(&mut self, by_us: i64) {
        if let Some(b) = &mut self.0 {
            for reading in [&mut b.origin, &mut b.newest, &mut b.window] {
                reading.boot_us = reading.boot_us.saturating_add(by_us);
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn at(ms: i64) -> Option<Stamp<Companion>> {
        Some(Stamp::from_micros(ms * 1000))
    }

    /// A clock of which a frame comes every 10 ms for `seconds`, at `rate` times real time and `late_ms(t)` late.
    fn running(seconds: i64, rate: i64, late_ms: impl Fn(i64) -> i64) -> ArrivalPace {
        let mut pace = ArrivalPace::default();
        for ms in (0..seconds * 1000).step_by(10) {
            let boot_us = (ms - late_ms(ms)) * rate * 1000;
            assert!(pace.explains(at(ms), boot_us), "{ms}");
            pace.note(at(ms), boot_us);
        }
        pace
    }

    #[test]
    fn a_stamp_of_the_future_is_not_explained() {
        let pace = running(100, 1, |_| 5);
        assert!(pace.explains(at(100_000), 100_000_000));
        assert!(!pace.explains(at(100_000), 100_600_000));
        assert!(pace.explains(at(105_000), 104_900_000), "a hole");
        assert!(pace.explains(None, i64::MAX));
    }

    #[test]
    fn many_small_steps_are_no_large_one() {
        let mut pace = running(100, 1, |_| 5);
        let ahead = (1..100).take_while(|n| {
            let boot_us = 100_000_000 + n * 400_000;
            let explained = pace.explains(at(100_000 + n), boot_us);
            pace.note(at(100_000 + n), boot_us);
            explained
        });
        assert_eq!(ahead.count(), 1);
    }

    #[test]
    fn a_link_that_stalls_and_delivers_late_is_explained() {
        // Every seventh second nothing comes, and then all of it at once.
        let late = |ms: i64| if ms / 1000 % 7 == 6 { ms % 1000 } else { 0 };
        running(120, 1, late);
        // Latency that grows and shrinks.
        running(120, 1, |ms| (ms / 100 - 600).abs() / 3);
    }

    #[test]
    fn a_simulation_may_run_faster_than_time_and_not_evenly() {
        for rate in [1, 4, 10] {
            let pace = running(100, rate, |_| 0);
            assert!(!pace.explains(at(100_000), 100_000_000 * rate + 70_000_000 * rate), "{rate}");
            // The computer is busy for a while, and then it catches up.
            running(100, rate, |ms| if (2000..6000).contains(&ms) { (ms - 2000) / 4 } else { 0 });
        }
    }
}
