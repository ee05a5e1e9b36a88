//! What becomes of a log when it is flown again: whether the navigation aligns, and how far off it would be without GNSS.

use serde::Serialize;

use crate::navigator::event::EventKind;
use crate::navigator::shadow::TimeBeside;
use crate::navigator::solution::{Mode, VelocitySource};
use crate::replay::runner::Runner;

/// Time with good GNSS in which anything can be measured, s: the shortest dead reckoning, twice.
const LEAST_TRUSTED_S: f64 = 20.0;
/// Where it is not known for more than this part of the time whether it flew, that is the reason.
const UNSEEN_PART: f64 = 0.2;

/// How far off it would be after some time.
#[derive(Clone, Debug, Serialize)]
pub(super) struct ExpectedError {
    carried_by: &'static str,
    after_s: f64,
    error_m: f64,
    times: u32,
}

#[derive(Clone, Debug, Serialize)]
struct DistrustedFlow {
    flow: u8,
    why: &'static str,
}

/// See the module's documentation.
#[derive(Clone, Debug, Serialize)]
pub(super) struct OutlookReport {
    /// When the navigation was aligned, s since the first sample; `None` if it never was.
    aligned_at_s: Option<f64>,
    /// What it waited for last, where it never was.
    waiting_for: Option<String>,
    /// Measured on this flight beside GNSS.
    expected: Vec<ExpectedError>,
    /// Why none was, in words.
    unmeasured: Option<String>,
    /// Optical flow that never carried, and what is held against it at the end.
    distrusted: Vec<DistrustedFlow>,
    /// Latency of GNSS, s, as the navigation found it, with its standard deviation.
    gnss_latency_s: [f64; 2],
}

impl OutlookReport {
    /// Of a log that was played to its end.
    pub(super) fn of(runner: &Runner) -> Self {
        let events = runner.events();
        let aligned = events.iter().find(|(_, e)| {
            matches!(e.kind, EventKind::Mode { from: Mode::Aligning, to, .. } if to != Mode::Aligning)
        });
        let waiting = events.iter().rev().find(|(_, e)| matches!(e.kind, EventKind::Waits(_)));
        let waiting_for = waiting.map(|(_, e)| e.kind.to_string()).filter(|_| aligned.is_none());
        let navigator = &runner.pipeline.navigator;
        let expected = navigator.measured_drift().into_iter().filter_map(|m| {
            let error_m = m.error_m.filter(|_| m.times > 0)?;
            Some(ExpectedError { carried_by: m.source.label(), after_s: m.after_s, error_m, times: m.times })
        });
        let expected: Vec<ExpectedError> = expected.collect();
        let carried = on_flow(&expected);
        let distrusted = navigator
            .flow_sensors()
            .filter_map(|(flow, _, trust)| Some(DistrustedFlow { flow, why: trust.err()?.reason() }))
            .filter(|_| !carried);
        let distrusted = distrusted.collect();
        let unmeasured = expected.is_empty().then(|| unmeasured(&navigator.time_beside_gnss()));
        let (latency_s, sigma_s) = navigator.gnss_latency_s();
        Self {
            aligned_at_s: aligned.map(|(t, _)| *t),
            waiting_for,
            expected,
            unmeasured,
            distrusted,
            gnss_latency_s: [latency_s, sigma_s],
        }
    }

    /// Whether it was measured what optical flow is worth.
    pub(super) fn on_flow(&self) -> bool {
        on_flow(&self.expected)
    }

    pub(super) fn print(&self) {
        match self.aligned_at_s {
            Some(t) => outln!("  aligned after {t:.0} s"),
            None => {
                let why = self.waiting_for.as_deref().unwrap_or("nothing was heard that it could begin with");
                outln!("  it never aligns: {why}");
                return;
            }
        }
        for DistrustedFlow { flow, why } in &self.distrusted {
            outln!("  optical flow {flow} is not used: {why}");
        }
        if let Some(why) = &self.unmeasured {
            outln!("  how far off it would be without GNSS was not measured: {why}");
        }
        for e in &self.expected {
            let ExpectedError { carried_by, after_s, error_m, times } = e;
            outln!(
                "  without GNSS, carried by {carried_by}: {error_m:.1} m off after {after_s:.0} s (measured {times} times on this flight)"
            );
        }
    }
}

fn on_flow(expected: &[ExpectedError]) -> bool {
    expected.iter().any(|e| e.carried_by == VelocitySource::Flow.label())
}

/// Why no dead reckoning was compared with GNSS: that takes 10 s of flight in one piece.
fn unmeasured(beside: &TimeBeside) -> String {
    let TimeBeside { trusted_s, flown_s, unseen_s } = *beside;
    if trusted_s < LEAST_TRUSTED_S {
        format!("{trusted_s:.0} s with good GNSS are too few")
    } else if unseen_s > UNSEEN_PART * trusted_s {
        format!(
            "for {unseen_s:.0} of {trusted_s:.0} s with good GNSS it was slow, and nothing tells whether it hovered or stood \
             (no rangefinder, and it was never heard to stand disarmed)"
        )
    } else {
        format!(
            "of {trusted_s:.0} s with good GNSS it flew for {flown_s:.0} s, and never for ten in one piece"
        )
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn what_was_missing_for_a_measurement_is_said() {
        let why = |trusted_s, flown_s, unseen_s| unmeasured(&TimeBeside { trusted_s, flown_s, unseen_s });
        assert!(why(5.0, 5.0, 0.0).starts_with("5 s with good GNSS"));
        // A slow multirotor whose log begins with arming.
        let hover = why(146.0, 6.0, 140.0);
        assert!(hover.contains("for 140 of 146 s") && hover.contains("hovered or stood"), "{hover}");
        // It stood.
        assert_eq!(
            why(100.0, 8.0, 0.0),
            "of 100 s with good GNSS it flew for 8 s, and never for ten in one piece"
        );
    }
}
