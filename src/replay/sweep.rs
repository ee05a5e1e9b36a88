//! Outages slid over a flight. The navigation with GNSS is run once; at every outage's start a copy of it goes on without.

use serde::{Deserialize, Serialize};

use crate::log::stretches::Stretches;
use crate::log::{Log, LogError};
use crate::pipeline::PipelineSettings;
use crate::replay::airborne::ToldFlights;
use crate::replay::forks::{self, Branch, starts_in};
use crate::replay::runner::Runner;
use crate::sample::{Input, Reference, Sample, SampleKind};
use crate::time::{AutopilotTime, ClockEvent};

/// One outage, scored.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
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
pub const SETTLE_S: f64 = 30.0;

/// What a log holds, as far as outages in it are concerned.
#[derive(Clone, Debug, Default)]
pub struct Survey {
    /// From when to when the vehicle flies, seconds since the first sample: by truth where there is one, else by its own word, else by GNSS.
    pub flights: Vec<(f64, f64)>,
    /// Samples by kind; of GNSS receivers, fixes.
    pub heard: [u64; SampleKind::ALL.len()],
    /// The IMU's rate and holes.
    pub imu: Stretches,
    /// The longest time between two fixes, s.
    pub longest_loss_s: f64,
    /// From the first sample to the last, s.
    pub duration_s: Option<f64>,
}

/// Height and speed of whoever tells them, on the way to a [`Survey`].
#[derive(Clone, Copy, Debug, Default)]
struct Flying {
    ground_m: [Option<f64>; 2],
    from_to: [Option<(f64, f64)>; 2],
}

impl Flying {
    /// `source` 0 is truth, 1 GNSS.
    fn note(&mut self, source: usize, t: f64, height_m: f64, speed_mps: f64) {
        let ground = self.ground_m[source].get_or_insert(height_m);
        if height_m - *ground > AIRBORNE_M[source] || speed_mps > AIRBORNE_MPS[source] {
            self.from_to[source] = Some(self.from_to[source].map_or((t, t), |(from, _)| (from, t)));
        }
    }
}

/// Reads a log through.
///
/// # Errors
/// What reading the log says.
pub fn survey(log: &Log) -> Result<Survey, LogError> {
    let (mut start, mut fixed): (Option<AutopilotTime>, Option<f64>) = (None, None);
    let (mut survey, mut flying, mut told) = (Survey::default(), Flying::default(), ToldFlights::default());
    log.play(
        |_, _| {},
        |_, item| {
            let time = match item {
                Input::Sample(s) => s.time(),
                Input::Reference(r) => r.time(),
                Input::Status(status) => return told.note(survey.duration_s.unwrap_or(0.0), status),
                Input::Clock(ClockEvent::Gap(gap)) => {
                    // Before the first sample no time has passed.
                    if let Some(t_s) = survey.duration_s {
                        told.fell_silent(t_s, gap.seconds());
                    }
                    return;
                }
                _ => return,
            };
            let t = time.seconds_since(*start.get_or_insert(time));
            survey.duration_s = Some(survey.duration_s.map_or(t, |s| s.max(t)));
            match item {
                Input::Sample(Sample::Gnss(g)) => {
                    let Some(p) = g.position else { return };
                    survey.heard[SampleKind::Gnss as usize] += 1;
                    let loss_s = fixed.replace(t).map_or(0.0, |before| t - before);
                    survey.longest_loss_s = survey.longest_loss_s.max(loss_s);
                    flying.note(1, t, p.height_m, g.ground_velocity.map_or(0.0, |v| v.speed_mps));
                }
                Input::Sample(s) => {
                    survey.heard[s.kind() as usize] += 1;
                    if matches!(s, Sample::Imu(_)) {
                        survey.imu.note(time);
                    }
                }
                Input::Reference(Reference::Truth(truth)) => {
                    if let (Some(p), Some(v)) = (truth.position, truth.velocity) {
                        flying.note(0, t, p.height_m, v.raw().xy().norm());
                    }
                }
                _ => {}
            }
        },
    )?;
    let [by_truth, by_gnss] = flying.from_to.map(|f| f.into_iter().collect::<Vec<_>>());
    let by_word = told.in_air(survey.duration_s.unwrap_or(0.0));
    survey.flights = [by_truth, by_word, by_gnss].into_iter().find(|f| !f.is_empty()).unwrap_or_default();
    Ok(survey)
}

impl Survey {
    /// From the beginning of the first flight to the end of the last, seconds since the first sample.
    pub fn airborne(&self) -> Option<(f64, f64)> {
        Some((self.flights.first()?.0, self.flights.last()?.1))
    }
}

/// Outages of all `lengths`, `starts` of each, spread evenly over the flights. A length that does not fit has no rows.
///
/// # Errors
/// What reading the log says.
pub fn sweep(
    log: &Log,
    settings: &PipelineSettings,
    flights: &[(f64, f64)],
    lengths: &[f64],
    starts: usize,
) -> Result<Vec<SweepRow>, LogError> {
    let branches = lengths.iter().flat_map(|&length| {
        let starts = starts_in(flights, SETTLE_S, length, starts);
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
