//! The refining filter: a Kalman filter over the six parameters of a rigid transformation, linearised about the H∞ filter's estimate.
//!
//! The H∞ filter finds the pose from any start and pays with twelve free numbers: its noise is about twice what six would give. A Kalman filter
//! that is linearised about an estimate that converges by itself inherits the convergence (the exogenous Kalman filter of Johansen and Fossen)
//! and has the accuracy. States: the landmarks' centroid in D, q_c, and N in SO(3), with N = Exp(δθ)N̂. A landmark is at q_c + N(Q − c), thus
//! ∂/∂δθ = −S(N(Q − c)), ∂/∂δq = I.
//!
//! D drifts against the ground: in position by a random walk, in attitude by one about the body, not about the origin.

use nalgebra::{Cholesky, Matrix3, Matrix6, Matrix6x3, SMatrix, Vector3, Vector6};

use super::dead_reckoning::DeadReckoned;
use super::information::{Judged, SeenInD};
use super::settings::LandmarkSettings;
use crate::geo::so3::{exp, hat, log};

/// A rigid transformation from the landmarks' frame to D.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Rigid {
    /// Where the landmarks' centroid is in D, m.
    pub centroid_d: Vector3<f64>,
    /// N.
    pub r_to_d: Matrix3<f64>,
}

/// The filter. The order of the errors is [δθ; δq_c], in D.
#[derive(Clone, Debug, PartialEq)]
pub struct Refined {
    state: Rigid,
    p: Matrix6<f64>,
}

impl Refined {
    /// Starts at a transformation with sigmas of the attitude (rad) and the centroid (m).
    pub fn new(state: Rigid, attitude_sigma_rad: f64, position_sigma_m: f64) -> Self {
        let variance = |i: usize| if i < 3 { attitude_sigma_rad.powi(2) } else { position_sigma_m.powi(2) };
        Self { state, p: Matrix6::from_diagonal(&Vector6::from_fn(|i, _| variance(i))) }
    }

    /// The transformation.
    pub fn state(&self) -> &Rigid {
        &self.state
    }

    /// The covariance of [δθ; δq_c].
    pub fn covariance(&self) -> &Matrix6<f64> {
        &self.p
    }

    /// Lets D drift for `dt_s` with the body at `position_d`.
    pub fn drift(&mut self, dt_s: f64, position_d: &Vector3<f64>, settings: &LandmarkSettings) {
        let arm = hat(&(self.state.centroid_d - position_d));
        // A turn w about the body moves the centroid by w × arm = −S(arm) w.
        let turn = settings.attitude_drift.powi(2) * dt_s;
        let way = settings.position_drift.powi(2) * dt_s;
        let mut g = Matrix6x3::zeros();
        g.fixed_view_mut::<3, 3>(0, 0).copy_from(&Matrix3::identity());
        g.fixed_view_mut::<3, 3>(3, 0).copy_from(&-arm);
        self.p += g * g.transpose() * turn;
        for i in 3..6 {
            self.p[(i, i)] += way;
        }
    }

    /// Judges a sighting and uses it if it passes. `about` is what it is linearised about, `offset` = Q − c.
    pub fn sighting(
        &mut self,
        seen: &SeenInD,
        offset: &Vector3<f64>,
        about: &Rigid,
        settings: &LandmarkSettings,
    ) -> Option<Judged> {
        let arm = about.r_to_d * offset;
        let predicted = about.centroid_d + arm - seen.camera_d;
        let mut h = SMatrix::<f64, 3, 6>::zeros();
        h.fixed_view_mut::<3, 3>(0, 0).copy_from(&-hat(&arm));
        h.fixed_view_mut::<3, 3>(0, 3).copy_from(&Matrix3::identity());
        let predicted = predicted + h * self.from(about);
        let [near, far] = settings.distance_clip_m;
        let sigma = settings.bearing_sigma_rad * predicted.norm().clamp(near, far);
        let b = seen.direction_d;
        let along = b * b.transpose();
        let across = Matrix3::identity() - along;
        let (residual, h, noise) = match seen.distance {
            None => (-across * predicted, across * h, Matrix3::from_diagonal_element(sigma * sigma)),
            Some([d, s]) => (b * d - predicted, h, across * sigma.powi(2) + along * s.powi(2)),
        };
        self.update(&residual, &h, &noise, settings.belief.refined_gate)
    }

    /// The direction of gravity in D.
    pub fn gravity(&mut self, down_d: &Vector3<f64>, sigma: f64) -> Option<Judged> {
        let down = self.state.r_to_d.column(2).into_owned();
        let mut h = SMatrix::<f64, 3, 6>::zeros();
        h.fixed_view_mut::<3, 3>(0, 0).copy_from(&-hat(&down));
        let noise = Matrix3::from_diagonal_element(sigma * sigma);
        self.update(&(down_d - down), &h, &noise, f64::INFINITY)
    }

    /// The error from another transformation to this one.
    pub fn from(&self, other: &Rigid) -> Vector6<f64> {
        let turn = log(&(self.state.r_to_d * other.r_to_d.transpose()));
        let way = self.state.centroid_d - other.centroid_d;
        Vector6::new(turn.x, turn.y, turn.z, way.x, way.y, way.z)
    }

    fn update(
        &mut self,
        residual: &Vector3<f64>,
        h: &SMatrix<f64, 3, 6>,
        noise: &Matrix3<f64>,
        gate: f64,
    ) -> Option<Judged> {
        let ph = self.p * h.transpose();
        let s = Cholesky::new(h * ph + noise)?;
        let ratio = residual.dot(&s.solve(residual));
        if !ratio.is_finite() {
            return None;
        }
        if ratio > gate {
            return Some(Judged { ratio, used: false });
        }
        let gain = s.solve(&ph.transpose()).transpose();
        let step = gain * residual;
        let keep = Matrix6::identity() - gain * h;
        // Joseph's form: stays positive definite whatever the rounding.
        let p = keep * self.p * keep.transpose() + gain * noise * gain.transpose();
        self.p = 0.5 * (p + p.transpose());
        self.state.r_to_d = exp(&step.fixed_rows::<3>(0).into_owned()) * self.state.r_to_d;
        self.state.centroid_d += step.fixed_rows::<3>(3);
        Some(Judged { ratio, used: true })
    }

    /// Whether everything is a number.
    pub fn is_finite(&self) -> bool {
        self.p
            .iter()
            .chain(self.state.r_to_d.iter())
            .chain(self.state.centroid_d.iter())
            .all(|v| v.is_finite())
    }

    /// Pose of the body that is at `at` in D, with `centroid` the landmarks' in their frame, and the covariance of [position; attitude], NED:
    /// δp = Nᵀ(S(d − q_c)δθ − δq), δφ = −Nᵀδθ.
    pub fn pose(
        &self,
        at: &DeadReckoned,
        centroid: &Vector3<f64>,
    ) -> (Vector3<f64>, Matrix3<f64>, Matrix6<f64>) {
        let n_t = self.state.r_to_d.transpose();
        let arm = at.position_d - self.state.centroid_d;
        let mut j = Matrix6::zeros();
        j.fixed_view_mut::<3, 3>(0, 0).copy_from(&(n_t * hat(&arm)));
        j.fixed_view_mut::<3, 3>(0, 3).copy_from(&-n_t);
        j.fixed_view_mut::<3, 3>(3, 0).copy_from(&-n_t);
        (n_t * arm + centroid, n_t * at.r_body_to_d, j * self.p * j.transpose())
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn rigid() -> Rigid {
        Rigid { centroid_d: Vector3::new(3.0, -2.0, 1.5), r_to_d: exp(&Vector3::new(0.4, -1.1, 2.0)) }
    }

    fn perturbed(rigid: &Rigid, i: usize, by: f64) -> Rigid {
        let mut e = Vector6::zeros();
        e[i] = by;
        let turn = exp(&e.fixed_rows::<3>(0).into_owned());
        Rigid { centroid_d: rigid.centroid_d + e.fixed_rows::<3>(3), r_to_d: turn * rigid.r_to_d }
    }

    /// The covariance of the pose with P = e_i e_iᵀ is the outer product of the pose's derivative along e_i.
    #[test]
    fn the_pose_moves_with_the_transformation_as_its_covariance_says() {
        let at = DeadReckoned {
            r_body_to_d: exp(&Vector3::new(-0.3, 0.2, 0.9)),
            position_d: Vector3::new(7.0, 1.0, -4.0),
        };
        let centroid = Vector3::new(100.0, -50.0, 3.0);
        let filter = Refined::new(rigid(), 1.0, 1.0);
        let (p0, r0, _) = filter.pose(&at, &centroid);
        for i in 0..6 {
            let h = 1e-6;
            let moved = Refined::new(perturbed(&rigid(), i, h), 1.0, 1.0);
            let (p, r, _) = moved.pose(&at, &centroid);
            let (dp, dr) = ((p - p0) / h, log(&(r * r0.transpose())) / h);
            let mut unit = Matrix6::zeros();
            unit[(i, i)] = 1.0;
            let (.., covariance) = Refined { p: unit, ..filter.clone() }.pose(&at, &centroid);
            let d = Vector6::new(dp.x, dp.y, dp.z, dr.x, dr.y, dr.z);
            assert!((covariance - d * d.transpose()).norm() < 1e-4, "{i}");
        }
    }

    /// One exact position of a landmark, however the filter is linearised about the truth, moves the estimate onto it.
    #[test]
    fn the_rows_are_the_derivatives_of_what_is_seen() {
        let mut settings = LandmarkSettings::default();
        settings.belief.refined_gate = f64::INFINITY;
        let offset = Vector3::new(1.0, 4.0, -2.0);
        let truth = rigid();
        for i in 0..6 {
            let mut filter = Refined::new(perturbed(&truth, i, 1e-4), 0.1, 0.1);
            let from = filter.from(&truth).norm();
            let camera_d = Vector3::new(0.0, 0.0, -3.0);
            for turn in 0..3 {
                let offset = exp(&Vector3::new(0.0, 0.0, 2.1 * f64::from(turn))) * offset;
                let to = truth.centroid_d + truth.r_to_d * offset - camera_d;
                let distance = Some([to.norm(), 1e-6]);
                let seen = SeenInD { landmark: offset, direction_d: to.normalize(), camera_d, distance };
                let exact = LandmarkSettings { bearing_sigma_rad: 1e-7, ..settings };
                assert!(filter.sighting(&seen, &offset, &truth, &exact).is_some_and(|j| j.used));
            }
            let left = filter.from(&truth).norm();
            assert!(left < 1e-2 * from, "{i}: {left} of {from}");
        }
    }

    #[test]
    fn a_drift_of_attitude_leaves_the_body_where_it_is() {
        let settings =
            LandmarkSettings { position_drift: 0.0, attitude_drift: 0.1, ..LandmarkSettings::default() };
        let mut filter = Refined::new(rigid(), 1e-9, 1e-9);
        let body = Vector3::new(20.0, 0.0, -5.0);
        filter.drift(1.0, &body, &settings);
        let at = DeadReckoned { r_body_to_d: Matrix3::identity(), position_d: body };
        let (.., covariance) = filter.pose(&at, &Vector3::zeros());
        for i in 0..3 {
            assert!(covariance[(i, i)] < 1e-12);
            assert!((covariance[(3 + i, 3 + i)] - 0.01).abs() < 1e-9);
        }
    }
}
