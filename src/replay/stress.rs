//! Faults put into a flight at several places of it, each beside the same flight without the fault and without the sensor.
//!
//! What is asked of every case: how far off it was, how far off it said it was, when it told of the fault, and whom it blamed.

use serde::Serialize;

use crate::fault::FaultKind;
use crate::fault::{InjectedFault, Sensor, Target};
use crate::metrics::outage::OutageReport;
use crate::navigator::Navigator;
use crate::navigator::solution::Mode;
use crate::navigator::sources::status::{SourceHealth, SourceKind, SourceReport};
use crate::pipeline::PipelineSettings;

use super::forks::{self, Branch, starts_in};
use super::matrix::{LEAD_S, StressCase};
use super::runner::Runner;
use super::sweep::SETTLE_S;
use crate::log::{Log, LogError};

/// A case at one start.
#[derive(Clone, Debug, Serialize)]
pub struct StressRow {
    /// The fault, without its times.
    pub fault: String,
    /// Start of the scored interval, s since the first sample.
    pub start_s: f64,
    /// GNSS was withheld in the interval.
    pub outage: bool,
    /// Distance travelled, m.
    pub distance_m: Option<f64>,
    /// Horizontal error at its end, m.
    pub error_m: Option<f64>,
    /// Standard deviation claimed at its end, m.
    pub sigma_m: Option<f64>,
    /// Largest horizontal error over the standard deviation claimed for it then, until Lost.
    pub worst_sigmas: Option<f64>,
    /// Error of altitude, root mean square, m.
    pub altitude_rmse_m: Option<f64>,
    /// From the interval's start until it was called lost, s.
    pub lost_after_s: Option<f64>,
    /// From the fault's onset until the faulty sensor was no longer called healthy, s.
    pub told_after_s: Option<f64>,
    /// The sensor was not called healthy before the fault either.
    pub doubted_before: bool,
    /// Other sources that were called faulty after the fault's onset.
    pub blamed: Vec<String>,
    /// Horizontal error at the interval's end without the fault, m.
    pub error_without_fault_m: Option<f64>,
    /// … and without the sensor, m.
    pub error_without_sensor_m: Option<f64>,
}

/// What a log's stress gave.
#[derive(Clone, Debug)]
pub struct StressReport {
    /// Cases, each at every start.
    pub rows: Vec<StressRow>,
    /// Sources that were called faulty while nothing was put in, by start and kind of interval: label and s since the first sample.
    pub false_alarms: Vec<(String, f64)>,
    /// Cases whose sensor is not in the log.
    pub not_heard: Vec<String>,
}

/// What a branch is for.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
enum TrialKind {
    /// The flight as it was.
    Unaltered,
    /// With the faults of a case, by its number.
    Faulty(usize),
    /// Without the sensors that fail; cases of one sensor and time share it.
    Silent,
}

/// A branch.
#[derive(Clone, Debug)]
struct Trial {
    kind: TrialKind,
    start_s: f64,
    outage: bool,
    faults: Vec<InjectedFault>,
    seen: WhatWasTold,
}

/// What was seen on the way.
#[derive(Clone, Debug, Default)]
struct WhatWasTold {
    looked_s: f64,
    begun: bool,
    doubted_before: bool,
    told_s: Option<f64>,
    faulty_before: Vec<(SourceKind, u8)>,
    blamed: Vec<(SourceKind, u8, f64)>,
}

/// A branch that is over, with its score.
type Ended = (Trial, Option<OutageReport>);

/// Between two looks at what is told, s.
const LOOK_S: f64 = 0.1;
/// What the faults draw their noise from.
const SEED: u64 = 1;

/// Puts every case into a flight at `starts` places of it.
///
/// # Errors
/// What reading the log says.
pub fn stress(
    log: &Log,
    settings: &PipelineSettings,
    flights: &[(f64, f64)],
    cases: &[StressCase],
    length_s: f64,
    starts: usize,
) -> Result<StressReport, LogError> {
    let starts = starts_in(flights, SETTLE_S + LEAD_S, length_s, starts);
    let trials = starts.iter().flat_map(|&start_s| trials(cases, start_s));
    let branches =
        trials.map(|what| Branch { from_s: what.start_s - LEAD_S, to_s: what.start_s + length_s, what });
    let mut ended: Vec<Ended> = Vec::new();
    let common = forks::play(
        log,
        settings,
        branches.collect(),
        |trial, fork| {
            fork.set_faults(trial.faults.clone(), SEED);
            if trial.outage {
                fork.add_outage(trial.start_s, trial.start_s + length_s);
            } else {
                fork.add_score(trial.start_s, trial.start_s + length_s);
            }
        },
        |trial, fork, t_s| trial.look(&fork.pipeline.navigator, t_s),
        |trial, fork| ended.push((trial, fork.outcome().outages.last().copied())),
    )?;
    ended.sort_by(|(a, _), (b, _)| a.kind.cmp(&b.kind).then(a.start_s.total_cmp(&b.start_s)));
    Ok(report(&ended, cases, &common))
}

/// The flight without a fault, with and without GNSS, and every case, with its fault and without its sensors.
fn trials(cases: &[StressCase], start_s: f64) -> Vec<Trial> {
    let trial = |kind, outage, faults| Trial { kind, start_s, outage, faults, seen: WhatWasTold::default() };
    let mut all =
        vec![trial(TrialKind::Unaltered, true, Vec::new()), trial(TrialKind::Unaltered, false, Vec::new())];
    for (i, case) in cases.iter().enumerate() {
        let shifted = |f: &InjectedFault| InjectedFault {
            from_s: (f.from_s + start_s).max(0.0),
            to_s: f.to_s + start_s,
            ..*f
        };
        let faults: Vec<_> = case.faults.iter().map(shifted).collect();
        // Without its IMU a vehicle has nothing at all to compare with.
        let felt = |f: &InjectedFault| of_kind(f.target.sensor).is_none_or(|kind| kind == SourceKind::Imu);
        let silent = trial(TrialKind::Silent, case.outage, silenced(&faults));
        if !faults.iter().any(felt) && !all.iter().any(|t| t.is_as(&silent)) {
            all.push(silent);
        }
        all.push(trial(TrialKind::Faulty(i), case.outage, faults));
    }
    all
}

/// The sensors of faults silent instead.
fn silenced(faults: &[InjectedFault]) -> Vec<InjectedFault> {
    let silent = |f: &InjectedFault| InjectedFault {
        target: Target { axis: None, ..f.target },
        kind: FaultKind::Drop(1.0),
        ..*f
    };
    faults.iter().map(silent).collect()
}

/// The kind of source that a sensor is.
fn of_kind(sensor: Sensor) -> Option<SourceKind> {
    match sensor {
        Sensor::All => None,
        Sensor::Imu | Sensor::Gyro | Sensor::Accel => Some(SourceKind::Imu),
        Sensor::Mag => Some(SourceKind::Magnetometer),
        Sensor::Gnss => Some(SourceKind::Gnss),
        Sensor::Baro => Some(SourceKind::Barometer),
        Sensor::Flow => Some(SourceKind::Flow),
        Sensor::Range => Some(SourceKind::Rangefinder),
        Sensor::Airspeed => Some(SourceKind::Airspeed),
        Sensor::Landmark => Some(SourceKind::Landmarks),
    }
}

/// Whether a source is one of a target's.
fn is_of(target: &Target, source: &SourceReport) -> bool {
    of_kind(target.sensor).is_none_or(|kind| kind == source.kind)
        && target.id.is_none_or(|id| id == source.id)
}

impl Trial {
    /// Whether the same is flown.
    fn is_as(&self, other: &Self) -> bool {
        let what = |t: &Self| (t.kind, t.start_s, t.outage);
        what(self) == what(other) && self.faults == other.faults
    }

    fn onset_s(&self) -> f64 {
        self.faults.iter().map(|f| f.from_s).fold(f64::INFINITY, f64::min)
    }

    /// Looks at what the navigator tells of its sources.
    fn look(&mut self, navigator: &Navigator, t_s: f64) {
        if t_s - self.seen.looked_s < LOOK_S {
            return;
        }
        self.seen.looked_s = t_s;
        let sources = navigator.source_reports();
        let doubted = self.doubts(navigator, &sources);
        let onset_s = if self.faults.is_empty() { f64::NEG_INFINITY } else { self.onset_s() };
        if t_s < onset_s || !std::mem::replace(&mut self.seen.begun, true) {
            self.seen.doubted_before = doubted;
            let faulty = sources.iter().filter(|s| s.health == SourceHealth::Faulty);
            self.seen.faulty_before = faulty.map(|s| (s.kind, s.id)).collect();
            self.seen.begun = t_s >= onset_s;
            return;
        }
        if doubted && !self.seen.doubted_before {
            self.seen.told_s.get_or_insert(t_s - onset_s);
        }
        let others = sources.iter().filter(|s| s.health == SourceHealth::Faulty && !self.accuses(s));
        let others: Vec<_> = others.map(|s| (s.kind, s.id)).collect();
        for known in others {
            let seen = &mut self.seen;
            if !seen.faulty_before.contains(&known) && !seen.blamed.iter().any(|b| (b.0, b.1) == known) {
                seen.blamed.push((known.0, known.1, t_s));
            }
        }
    }

    /// Whether a source is one that the faults are of.
    fn accuses(&self, source: &SourceReport) -> bool {
        self.faults.iter().any(|f| is_of(&f.target, source))
    }

    /// Whether one of the faulty sensors is no longer called healthy, or nothing is claimed any more.
    fn doubts(&self, navigator: &Navigator, sources: &[SourceReport]) -> bool {
        let unhealthy = sources.iter().any(|s| self.accuses(s) && s.health != SourceHealth::Healthy);
        unhealthy || navigator.mode() == Mode::Lost
    }
}

fn report(ended: &[Ended], cases: &[StressCase], common: &Runner) -> StressReport {
    let sources = common.pipeline.navigator.source_reports();
    let heard = |case: &StressCase| case.faults.iter().all(|f| sources.iter().any(|s| is_of(&f.target, s)));
    let not_heard = cases.iter().filter(|c| !heard(c)).map(|c| c.name.clone()).collect();
    let beside = |kind: TrialKind, trial: &Trial, faults: Vec<InjectedFault>| {
        let wanted = Trial { kind, faults, ..trial.clone() };
        ended.iter().find(|(t, _)| t.is_as(&wanted))
    };
    let mut rows: Vec<StressRow> = Vec::new();
    for (trial, score) in ended {
        let TrialKind::Faulty(number) = trial.kind else { continue };
        let case = &cases[number];
        // Where GNSS was bad already, a lie of it shows nothing.
        let of_gnss = case.faults.iter().any(|f| f.target.sensor == Sensor::Gnss);
        if !heard(case) || (of_gnss && trial.seen.doubted_before) {
            continue;
        }
        let unaltered = beside(TrialKind::Unaltered, trial, Vec::new());
        let silent = beside(TrialKind::Silent, trial, silenced(&trial.faults));
        // What is called faulty without the fault as well is not blamed for it.
        let also = |b: &(SourceKind, u8, f64)| {
            unaltered.is_some_and(|(t, _)| t.seen.blamed.iter().any(|other| (other.0, other.1) == (b.0, b.1)))
        };
        let blamed = trial.seen.blamed.iter().filter(|b| !also(b));
        rows.push(StressRow {
            fault: case.name.clone(),
            start_s: trial.start_s,
            outage: trial.outage,
            distance_m: score.and_then(|s| s.distance_m),
            error_m: score.and_then(|s| s.horizontal_error_end_m),
            sigma_m: score.and_then(|s| s.sigma_end_m),
            worst_sigmas: score.and_then(|s| s.worst_sigmas),
            altitude_rmse_m: score.and_then(|s| s.altitude_rmse_m),
            lost_after_s: score.and_then(|s| s.lost_at_s).map(|t| t - trial.start_s),
            told_after_s: trial.seen.told_s,
            doubted_before: trial.seen.doubted_before,
            blamed: blamed.map(|b| format!("{} {}", b.0.label(), b.1)).collect(),
            error_without_fault_m: unaltered.and_then(error_m),
            error_without_sensor_m: silent.and_then(error_m),
        });
    }
    let unaltered = ended.iter().filter(|(t, _)| t.kind == TrialKind::Unaltered);
    let false_alarms = unaltered
        .flat_map(|(t, _)| t.seen.blamed.iter().map(|b| (format!("{} {}", b.0.label(), b.1), b.2)))
        .collect();
    StressReport { rows, false_alarms, not_heard }
}

fn error_m((_, score): &Ended) -> Option<f64> {
    score.and_then(|s| s.horizontal_error_end_m)
}
