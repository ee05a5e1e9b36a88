//! How uncertain what is published is.

use nalgebra::{Matrix2, Matrix3, Vector3};

use super::context::SourceFacts;
use super::core::Core;
use super::estimator::has_magnetometer;
use super::solution::Mode;
use crate::navigator::tuning::gnss::VERTICAL_RATIO;
use crate::navigator::tuning::uncertainty::{AIDED_VELOCITY_SIGMA, UNKNOWN_ATTITUDE, UNKNOWN_M, UNKNOWN_MPS};

/// The covariance of a horizontal position or velocity that is nowhere known.
fn unknown() -> (Matrix2<f64>, Matrix2<f64>) {
    (Matrix2::identity() * UNKNOWN_M.powi(2), Matrix2::identity() * UNKNOWN_MPS.powi(2))
}

impl Core {
    /// What the position is wrong by for longer than any filter averages, m: the receiver's error of before the outage, or the survey's.
    fn anchor_sigma_m(&self, facts: &SourceFacts) -> f64 {
        match facts.landmark_fix {
            Some((_, survey_sigma_m)) if self.dead_reckoning() => survey_sigma_m,
            // Where it began is where it is zero.
            _ if self.integrity.never_good() => 0.0,
            _ => facts.gnss_sigma_m,
        }
    }

    /// What a receiver may have led the position off by, an axis, m²: nothing, where landmarks tell it now.
    fn unexplained_variance(&self, facts: &SourceFacts) -> f64 {
        let on_landmarks = facts.landmark_fix.is_some() && self.dead_reckoning();
        if on_landmarks { 0.0 } else { self.witnesses.unexplained.variance(self.stream.newest()) }
    }

    /// What is in dispute between a receiver and inertia, an axis, m² and (m/s)².
    pub(super) fn disputed(&self, facts: &SourceFacts) -> [f64; 2] {
        let on_landmarks = facts.landmark_fix.is_some() && self.dead_reckoning();
        if on_landmarks { [0.0; 2] } else { self.witnesses.unexplained.disputed(self.stream.newest()) }
    }

    /// Covariances of the published horizontal position and velocity, NE, m² and (m/s)².
    fn horizontal_covariances(&self, facts: &SourceFacts) -> (Matrix2<f64>, Matrix2<f64>) {
        // A receiver's error changes over minutes: no averaging takes it out, and it stays when the receiver goes.
        let anchor = Matrix2::identity()
            * (self.anchor_sigma_m(facts).powi(2) + self.unexplained_variance(facts))
            + self.published.offset_covariance();
        let budget = self.outage.budget().zip(self.stream.newest());
        let by_budget = budget.map(|(b, now)| (b.position(has_magnetometer(facts, now)), b.velocity()));
        match (self.mode, self.estimator.covariance(), by_budget) {
            (Mode::Aligning, ..) => unknown(),
            (_, Some((p, v, whole)), by_budget) => {
                let (position, velocity) = if self.dead_reckoning() {
                    self.estimator.proven(self.outage.source())
                } else {
                    (1.0, 1.0)
                };
                let (mut p, mut v) = (
                    p.fixed_view::<2, 2>(0, 0).into_owned() * position,
                    v.fixed_view::<2, 2>(0, 0).into_owned() * velocity,
                );
                if let Some((p_budget, v_budget)) = by_budget.filter(|_| !whole) {
                    p += p_budget;
                    v += v_budget;
                }
                let [apart, parting] = self.disputed(facts);
                let one = Matrix2::identity();
                (p + anchor + self.estimator.suspected() + one * apart, v + one * parting)
            }
            (Mode::Holdover | Mode::Lost, None, Some((p, v))) => (p + self.published.offset_covariance(), v),
            (Mode::Aided | Mode::Rejoining, ..) => {
                (anchor, Matrix2::identity() * AIDED_VELOCITY_SIGMA.powi(2))
            }
            _ => unknown(),
        }
    }

    /// Covariances of the published position and velocity, NED, m² and (m/s)².
    pub(super) fn covariances(&self, facts: &SourceFacts) -> (Matrix3<f64>, Matrix3<f64>) {
        let (p_ne, v_ne) = self.horizontal_covariances(facts);
        let mut p = Matrix3::identity();
        let mut v = Matrix3::identity();
        p.fixed_view_mut::<2, 2>(0, 0).copy_from(&p_ne);
        v.fixed_view_mut::<2, 2>(0, 0).copy_from(&v_ne);
        let receiver_m = if self.integrity.never_good() { 0.0 } else { facts.gnss_sigma_m };
        // The height filter averages what a receiver's height is wrong by over minutes, and takes it for the barometer's offset.
        p[(2, 2)] = self.height.height_sigma_m().powi(2)
            + (VERTICAL_RATIO * receiver_m).powi(2)
            + self.published.height_offset_m().powi(2);
        v[(2, 2)] = self.height.climb_sigma_mps().powi(2);
        (p, v)
    }

    /// Horizontal uncertainty of what is published, 1 sigma, m; `None` while nothing is.
    pub(super) fn horizontal_sigma_m(&self, facts: &SourceFacts) -> Option<f64> {
        self.estimator.estimate()?;
        let (p, _) = self.horizontal_covariances(facts);
        Some((p[(0, 0)] + p[(1, 1)]).max(0.0).sqrt())
    }

    /// Variance of roll, pitch and yaw, rad².
    pub(super) fn attitude_variance(&self, facts: &SourceFacts) -> Vector3<f64> {
        if self.mode == Mode::Aligning || self.witnesses.inertia.is_doubted() {
            return Vector3::repeat(UNKNOWN_ATTITUDE.powi(2));
        }
        if let Some(c) = self.estimator.attitude_covariance() {
            // Near level flight the rotations about north, east and down are roll, pitch and yaw turned by the heading.
            let tilt = 0.5 * (c[(0, 0)] + c[(1, 1)]);
            return Vector3::new(tilt, tilt, c[(2, 2)]);
        }
        let b = &self.settings.holdover.budget;
        let tilt = b.tilt_sigma_rad.powi(2);
        let heading =
            b.heading_sigma_rad.powi(2) + self.settings.flow.calibration.misalignment_sigma_rad.powi(2) * 0.1;
        let drifted = self.outage.budget().map_or(0.0, |budget| match self.stream.newest() {
            Some(now) if !has_magnetometer(facts, now) => {
                (b.heading_drift_radps * budget.elapsed_s()).powi(2)
            }
            _ => 0.0,
        });
        Vector3::new(tilt, tilt, heading + drifted)
    }
}
