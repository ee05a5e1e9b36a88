//! What is kept of a flight while it is played, for its report: in memory that does not grow with the flight.

mod fit;
mod heading;
mod height;
mod states;
mod vibration;

use nalgebra::Vector3;

use super::trace::{Trace, Track};
use crate::metrics::{ErrorSample, ReferenceState};
use crate::navigator::shadow::DriftComparison;
use crate::navigator::solution::{Mode, Solution};
use crate::replay::runner::Runner;
use crate::sample::{GnssSample, Input, Reference, Sample};
use crate::time::{AutopilotTime, Span};

pub(super) use fit::{FitRecord, FlowRecord};
pub(super) use heading::{HeadingRecord, WitnessKind};
pub(super) use height::HeightRecord;
pub(super) use states::StateRecord;
pub(super) use vibration::VibrationRecord;

/// The solution is looked at this often.
const SOLUTION_PERIOD: Span = Span::from_millis(50);
/// A solution that is missing for this long leaves a hole, s.
const SOLUTION_HOLE_S: f64 = 0.5;
/// Fixes further apart than this leave a hole, s.
const FIX_HOLE_S: f64 = 2.5;
/// Comparisons of shadows that are kept; later ones take the place of every second one.
const MOST_COMPARISONS: usize = 2000;

/// Where it went.
#[derive(Clone, Debug)]
pub(super) struct PlanRecord {
    pub(super) estimate: Track,
    pub(super) gnss: Track,
    pub(super) truth: Track,
    pub(super) autopilot: Track,
    /// At the end of every stretch without GNSS.
    pub(super) unsure: Vec<UnsurePlace>,
    pending: Option<UnsurePlace>,
}

/// A position with how well it is known.
#[derive(Clone, Copy, Debug)]
pub(super) struct UnsurePlace {
    /// NE, m.
    pub(super) ne_m: [f64; 2],
    /// Variances of north and east, and their covariance, m².
    pub(super) covariance: [f64; 3],
}

/// How far it was off, against one reference, m.
#[derive(Clone, Debug)]
pub(super) struct ErrorRecord {
    pub(super) horizontal: Trace,
    pub(super) altitude: Trace,
}

impl ErrorRecord {
    fn new() -> Self {
        Self { horizontal: Trace::new(FIX_HOLE_S), altitude: Trace::new(FIX_HOLE_S) }
    }

    fn add(&mut self, t_s: f64, solution: &Solution, reference: &ReferenceState) {
        // As it is scored: see the runner.
        if solution.mode == Mode::Aligning || reference.time.seconds_since(solution.time).abs() > 1.0 {
            return;
        }
        let error = ErrorSample::between(solution, reference);
        self.horizontal.add(t_s, error.horizontal_m);
        self.altitude.add(t_s, error.altitude_m);
    }
}

/// A shadow compared with a fix: the flight's time, s, and the comparison.
pub(super) type SeenDrift = (f64, DriftComparison);

/// Follows a replay. Feed it after every item.
#[derive(Clone, Debug)]
pub struct FlightRecorder {
    pub(super) end_s: f64,
    pub(super) plan: PlanRecord,
    pub(super) against_truth: ErrorRecord,
    pub(super) against_gnss: ErrorRecord,
    /// Claimed standard deviation of the horizontal position, m.
    pub(super) sigma: Trace,
    pub(super) height: HeightRecord,
    pub(super) fits: Vec<FitRecord>,
    pub(super) flows: Vec<FlowRecord>,
    pub(super) heading: HeadingRecord,
    pub(super) vibration: VibrationRecord,
    pub(super) states: StateRecord,
    pub(super) drift: Vec<SeenDrift>,
    compared: [Option<DriftComparison>; 2],
    due: Option<AutopilotTime>,
}

impl Default for FlightRecorder {
    fn default() -> Self {
        Self::new()
    }
}

impl FlightRecorder {
    /// Nothing was heard yet.
    pub fn new() -> Self {
        Self {
            end_s: 0.0,
            plan: PlanRecord {
                estimate: Track::new(SOLUTION_HOLE_S),
                gnss: Track::new(FIX_HOLE_S),
                truth: Track::new(FIX_HOLE_S),
                autopilot: Track::new(FIX_HOLE_S),
                unsure: Vec::new(),
                pending: None,
            },
            against_truth: ErrorRecord::new(),
            against_gnss: ErrorRecord::new(),
            sigma: Trace::new(SOLUTION_HOLE_S),
            height: HeightRecord::new(),
            fits: Vec::new(),
            flows: Vec::new(),
            heading: HeadingRecord::new(),
            vibration: VibrationRecord::new(),
            states: StateRecord::new(),
            drift: Vec::new(),
            compared: [None; 2],
            due: None,
        }
    }

    /// Takes note of what an item of the log, which the runner has taken, has led to.
    pub fn note(&mut self, runner: &Runner, item: &Input) {
        let time = match item {
            Input::Sample(sample) => sample.time(),
            Input::Reference(reference) => reference.time(),
            Input::Status(status) => return self.heading.status(*status),
            Input::Origin(_) | Input::Clock(_) => return,
        };
        let t_s = runner.seconds(time);
        self.end_s = self.end_s.max(t_s);
        self.compare(runner, t_s, item);
        if let Some(Input::Sample(sample)) = runner.given() {
            match sample {
                Sample::Imu(imu) => self.vibration.add(t_s, imu),
                Sample::Gnss(fix) => self.fixed(runner, t_s, fix),
                _ => {}
            }
            self.heading.witness(runner, t_s, sample);
        }
        if let Input::Reference(reference) = item {
            self.referred(runner, t_s, reference);
        }
        fit::note(&mut self.fits, &runner.pipeline.navigator, t_s);
        self.drifted(runner);
        if let (Input::Sample(Sample::Imu(_)), Some(solution)) = (item, runner.solution()) {
            self.solved(runner, solution);
        }
    }

    /// What the solution is compared with: the log's fixes, used or withheld, and the truth.
    fn compare(&mut self, runner: &Runner, t_s: f64, item: &Input) {
        let navigator = &runner.pipeline.navigator;
        let (Some(frame), Some(solution)) = (navigator.frame(), runner.solution()) else { return };
        match item {
            Input::Sample(Sample::Gnss(fix)) => {
                let Some(position) = fix.position else { return };
                let state = ReferenceState {
                    time: fix.time - Span::from_seconds(navigator.gnss_latency_s().0),
                    position_ned: frame.to_ned(&position),
                    velocity_ned: None,
                    r_body_to_ned: None,
                };
                self.against_gnss.add(t_s, solution, &state);
            }
            Input::Reference(Reference::Truth(truth)) => {
                if let Some(state) = ReferenceState::from_truth(truth, frame) {
                    self.against_truth.add(t_s, solution, &state);
                }
            }
            _ => {}
        }
    }

    fn fixed(&mut self, runner: &Runner, t_s: f64, fix: &GnssSample) {
        let (Some(position), Some(frame)) = (fix.position, runner.pipeline.navigator.frame()) else { return };
        let ned = frame.to_ned(&position);
        self.plan.gnss.add(t_s, [ned.x, ned.y]);
    }

    fn referred(&mut self, runner: &Runner, t_s: f64, reference: &Reference) {
        self.heading.reference(t_s, reference);
        let Some(frame) = runner.pipeline.navigator.frame() else { return };
        let (track, position) = match reference {
            Reference::Truth(truth) => (&mut self.plan.truth, truth.position),
            Reference::Global { position, .. } => (&mut self.plan.autopilot, Some(*position)),
            Reference::Attitude { .. } | Reference::Local { .. } => return,
        };
        let Some(position) = position else { return };
        let ned: Vector3<f64> = frame.to_ned(&position);
        track.add(t_s, [ned.x, ned.y]);
        self.height.reference(t_s, -ned.z, matches!(reference, Reference::Truth(_)));
    }

    fn drifted(&mut self, runner: &Runner) {
        let newest = runner.pipeline.navigator.drift_comparisons();
        let before = std::mem::replace(&mut self.compared, newest);
        for comparison in newest.into_iter().zip(before).filter(|(now, before)| now != before) {
            self.drift.extend(comparison.0.map(|c| (runner.seconds(c.time), c)));
        }
        if self.drift.len() > MOST_COMPARISONS {
            let mut keep = false;
            self.drift.retain(|_| {
                keep = !keep;
                keep
            });
        }
    }

    fn solved(&mut self, runner: &Runner, solution: &Solution) {
        if self.due.is_some_and(|due| solution.time < due) {
            return;
        }
        self.due = Some(solution.time + SOLUTION_PERIOD);
        let t_s = runner.seconds(solution.time);
        let navigator = &runner.pipeline.navigator;
        self.states.note(t_s, solution, navigator);
        self.height.solved(t_s, solution, navigator);
        fit::learned(&mut self.flows, navigator, t_s);
        if solution.mode == Mode::Aligning {
            return;
        }
        self.heading.solved(t_s, solution);
        self.sigma.add(t_s, solution.horizontal_sigma_m());
        let position = solution.position.raw();
        let ne_m = [position.x, position.y];
        self.plan.estimate.add(t_s, ne_m);
        if matches!(solution.mode, Mode::Holdover | Mode::Lost) {
            let p = solution.position_covariance.raw();
            let covariance = [p[(0, 0)], p[(1, 1)], p[(0, 1)]];
            self.plan.pending = Some(UnsurePlace { ne_m, covariance });
        } else {
            self.plan.unsure.extend(self.plan.pending.take());
        }
    }

    /// The log is over.
    pub fn finish(&mut self) {
        self.plan.unsure.extend(self.plan.pending.take());
    }
}
