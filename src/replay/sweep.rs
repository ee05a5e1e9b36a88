//! Outages slid over a flight. The navigation with GNSS is run once; at every outage's start a copy of it goes on without.

use serde::Serialize;

use crate::log::{Log, LogError};
use crate::pipeline::PipelineSettings;
use crate::replay::forks::{self, Branch, starts_between};
use crate::replay::runner::Runner;
use crate::sample::{Input, Reference, Sample};
use crate::time::AutopilotTime;

/// One outage, scored.
#[derive(Clone, Debug, Serialize)]
pub struct SweepRow {
    /// Length, s.
    pub length_s: f64,
    /// Start, s since the first sample.
    pub start_s: f64,
    /// Distance travelled, m.
    pub distance_m: Option<f64>,
    /// Horizontal error when it began, m.
    pub start_error_m: Option<f64>,
    /// Horizontal error at its end, m.
    pub horizontal_error_end_m: Option<f64>,
    /// Largest horizontal error, m.
    pub horizontal_error_max_m: Option<f64>,
    /// Error at the end over distance, %.
    pub drift_percent: Option<f64>,
    /// Altitude error, root mean square, m.
    pub altitude_rmse_m: Option<f64>,
    /// Standard deviation claimed at the end, m.
    pub sigma_end_m: Option<f64>,
}

/// A vehicle this high above where it stood, m, or this fast, m/s, flies: by truth, and by GNSS, whose height wanders on the ground.
const AIRBORNE_M: [f64; 2] = [2.0, 10.0];
const AIRBORNE_MPS: [f64; 2] = [5.0, 3.0];
/// Time that the navigation has to settle with GNSS in the air before the first outage, s.
pub(super) const SETTLE_S: f64 = 30.0;

/// From when to when a log's vehicle flies, seconds since the first sample: truth where there is one, else GNSS.
///
/// # Errors
/// What reading the log says.
pub fn airborne(log: &Log) -> Result<Option<(f64, f64)>, LogError> {
    let mut start: Option<AutopilotTime> = None;
    let mut ground: [Option<f64>; 2] = [None; 2];
    let mut flying: [Option<(f64, f64)>; 2] = [None; 2];
    log.play(
        |_, _| {},
        |_, item| {
            let (time, source, height, speed) = match item {
                Input::Sample(s) => {
                    start.get_or_insert(s.time());
                    match s {
                        Sample::Gnss(g) => match g.position {
                            Some(p) => {
                                (g.time, 1, p.height_m, g.ground_velocity.map_or(0.0, |v| v.speed_mps))
                            }
                            None => return,
                        },
                        _ => return,
                    }
                }
                Input::Reference(r) => {
                    start.get_or_insert(r.time());
                    match r {
                        Reference::Truth(t) => match (t.position, t.velocity) {
                            (Some(p), Some(v)) => (t.time, 0, p.height_m, v.raw().xy().norm()),
                            _ => return,
                        },
                        _ => return,
                    }
                }
                _ => return,
            };
            let t = start.map_or(0.0, |s| time.seconds_since(s));
            let ground = ground[source].get_or_insert(height);
            if height - *ground > AIRBORNE_M[source] || speed > AIRBORNE_MPS[source] {
                flying[source] = Some(flying[source].map_or((t, t), |(from, _)| (from, t)));
            }
        },
    )?;
    Ok(flying[0].or(flying[1]))
}

/// Outages of all `lengths`, `starts` of each, spread evenly over the flight. A length that does not fit has no rows.
///
/// # Errors
/// What reading the log says.
pub fn sweep(
    log: &Log,
    settings: &PipelineSettings,
    flight: Option<(f64, f64)>,
    lengths: &[f64],
    starts: usize,
) -> Result<Vec<SweepRow>, LogError> {
    let Some((from, to)) = flight else { return Ok(Vec::new()) };
    let branches = lengths.iter().flat_map(|&length| {
        let starts = starts_between(from + SETTLE_S, to, length, starts);
        starts.into_iter().map(move |start| Branch {
            from_s: start,
            to_s: start + length,
            what: (start, length),
        })
    });
    let mut rows = Vec::new();
    forks::play(
        log,
        settings,
        branches.collect(),
        |&(start, length), fork| fork.add_outage(start, start + length),
        |_, _, _| {},
        |(start, length), fork| rows.push(row(start, length, fork)),
    )?;
    rows.sort_by(|a, b| a.length_s.total_cmp(&b.length_s).then(a.start_s.total_cmp(&b.start_s)));
    Ok(rows)
}

fn row(start_s: f64, length_s: f64, fork: &Runner) -> SweepRow {
    let outcome = fork.outcome();
    let report = outcome.outages.last().copied();
    SweepRow {
        length_s,
        start_s,
        distance_m: report.and_then(|r| r.distance_m),
        start_error_m: outcome.start_errors_m.last().copied().flatten(),
        horizontal_error_end_m: report.and_then(|r| r.horizontal_error_end_m),
        horizontal_error_max_m: report.and_then(|r| r.horizontal_error_max_m),
        drift_percent: report.and_then(|r| r.drift_percent),
        altitude_rmse_m: report.and_then(|r| r.altitude_rmse_m),
        sigma_end_m: report.and_then(|r| r.sigma_end_m),
    }
}
