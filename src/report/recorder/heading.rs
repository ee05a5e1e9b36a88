//! The heading, and what every witness says of it.

use std::f64::consts::PI;

use super::super::trace::Trace;
use crate::geo::so3::{Euler, wrap_pi};
use crate::navigator::solution::Solution;
use crate::replay::runner::Runner;
use crate::sample::{Airframe, Reference, Sample, VehicleStatus};

/// What is silent for longer leaves a hole, s.
const HOLE_S: f64 = 3.0;
/// A wing slower than this has no course that its nose follows, m/s.
const LEAST_SPEED_MPS: f64 = 6.0;
/// No heading can be told of a vehicle that stands on its nose, rad.
const LARGEST_PITCH: f64 = 70.0 * PI / 180.0;

/// Which witness.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(in super::super) enum WitnessKind {
    Magnetometer(u8),
    Autopilot,
    Truth,
    Course,
}

/// One witness: its heading less the estimate's, degrees.
#[derive(Clone, Debug)]
pub(in super::super) struct WitnessRecord {
    pub(in super::super) kind: WitnessKind,
    pub(in super::super) apart_deg: Trace,
}

/// See the module's documentation.
#[derive(Clone, Debug)]
pub(in super::super) struct HeadingRecord {
    /// Degrees from true north, −180 to 180.
    pub(in super::super) heading_deg: Trace,
    pub(in super::super) sigma_deg: Trace,
    pub(in super::super) witnesses: Vec<WitnessRecord>,
    newest: Option<Solution>,
    flies_nose_first: bool,
}

impl HeadingRecord {
    pub(super) fn new() -> Self {
        Self {
            heading_deg: Trace::new(HOLE_S),
            sigma_deg: Trace::new(HOLE_S),
            witnesses: Vec::new(),
            newest: None,
            flies_nose_first: false,
        }
    }

    pub(super) fn status(&mut self, status: VehicleStatus) {
        self.flies_nose_first = status.airframe == Some(Airframe::FixedWing);
    }

    pub(super) fn solved(&mut self, t_s: f64, solution: &Solution) {
        let yaw = Euler::from_rotation(solution.attitude.matrix()).yaw_rad;
        self.heading_deg.add(t_s, yaw.to_degrees());
        self.sigma_deg.add(t_s, solution.attitude_variance.z.max(0.0).sqrt().to_degrees());
        self.newest = Some(*solution);
    }

    fn says(&mut self, kind: WitnessKind, t_s: f64, apart_rad: f64) {
        let at = self.witnesses.iter().position(|w| w.kind == kind).unwrap_or_else(|| {
            self.witnesses.push(WitnessRecord { kind, apart_deg: Trace::new(HOLE_S) });
            self.witnesses.len() - 1
        });
        self.witnesses[at].apart_deg.add(t_s, wrap_pi(apart_rad).to_degrees());
    }

    /// What a sample, as the navigation was given it, says.
    pub(super) fn witness(&mut self, runner: &Runner, t_s: f64, sample: &Sample) {
        let Some(solution) = self.newest.filter(|s| sample.time().seconds_since(s.time).abs() < 1.0) else {
            return;
        };
        let euler = Euler::from_rotation(solution.attitude.matrix());
        match sample {
            Sample::Mag(mag) if euler.pitch_rad.abs() < LARGEST_PITCH => {
                let Some(field) = runner.pipeline.navigator.magnetic_field() else { return };
                // An attitude that is turned by some angle turns the measured field by as much.
                let (seen, wanted) = (solution.attitude.to_ned(mag.field).raw(), field.raw());
                let apart = wanted.y.atan2(wanted.x) - seen.y.atan2(seen.x);
                self.says(WitnessKind::Magnetometer(mag.sensor), t_s, apart);
            }
            Sample::Gnss(fix) if self.flies_nose_first => {
                if let Some(ground) = fix.ground_velocity.filter(|g| g.speed_mps > LEAST_SPEED_MPS) {
                    self.says(WitnessKind::Course, t_s, ground.course_rad - euler.yaw_rad);
                }
            }
            _ => {}
        }
    }

    /// What the truth or the autopilot says.
    pub(super) fn reference(&mut self, t_s: f64, reference: &Reference) {
        let (kind, attitude) = match reference {
            Reference::Truth(truth) => (WitnessKind::Truth, truth.attitude),
            Reference::Attitude { attitude, .. } => (WitnessKind::Autopilot, Some(*attitude)),
            Reference::Local { .. } | Reference::Global { .. } => return,
        };
        let newest = self.newest.filter(|s| reference.time().seconds_since(s.time).abs() < 0.2);
        let (Some(attitude), Some(solution)) = (attitude, newest) else { return };
        let (theirs, ours) =
            (Euler::from_rotation(attitude.matrix()), Euler::from_rotation(solution.attitude.matrix()));
        // Between two solutions it turns on.
        let since_s = reference.time().seconds_since(solution.time);
        let turned = (solution.attitude.to_ned(solution.angular_rate).raw() * since_s).z;
        if theirs.pitch_rad.abs() < LARGEST_PITCH {
            self.says(kind, t_s, theirs.yaw_rad - ours.yaw_rad - turned);
        }
    }
}
