//! What is systematically wrong with a flow velocity, learned while GNSS is there and used when it is gone.
//!
//! Fusini's b̂_v is the low-passed difference of the flow velocity and R̂ᵀvⁿ in body axes ((8) and the repaired (7)). A real sensor is
//! also scaled (0.8 to 1.0) and turned; a wrong heading looks the same as a turned sensor, and cancels with it. And what an optical sensor
//! is wrong by at rest is a rate of the image, b in rad/s, which is a velocity d·b at the distance d of the ground. So the model is
//!
//! v_m = (1 + s)·(I + μ [0 −1; 1 0])·v + d·b + noise,  x = [b_x, b_y, s, μ] constant,
//!
//! and a Kalman filter for constants estimates x, with its covariance: what is not known well in the end (a vehicle that only
//! hovered knows nothing of s) stays in the uncertainty of the dead reckoning. The noise is taken from the residuals themselves.
//!
//! The velocity v that it is compared with is noisy as well, and a regressor's noise passes for motion that the sensor does not see: in a hover s would go to −1
//! (attenuation, Fuller 1987, *Measurement Error Models*, section 1.1: by 1 − σ²/v̄² of the slope). So s and μ learn by the part 1 − (c σ/|v|)² of
//! Kalman's gain, |v| the velocity or its root mean square of late, whichever is less: nothing from a velocity that is none, and the covariance is that of the gain that was used (Joseph's form).

mod memory;

use nalgebra::{Matrix2, Matrix2x4, Matrix4, Vector2, Vector4};

pub use memory::CalibrationMemory;

/// What is known of a sensor before it is flown.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct CalibrationSettings {
    /// Standard deviation of the bias, rad/s.
    pub bias_sigma_radps: f64,
    /// Standard deviation of the scale error.
    pub scale_sigma: f64,
    /// Standard deviation of misalignment and heading error together, rad.
    pub misalignment_sigma_rad: f64,
    /// Random walk of the bias, rad/s/√s; keeps the filter awake.
    pub bias_walk: f64,
    /// Random walk of scale and misalignment, 1/√s.
    pub scale_walk: f64,
    /// Largest scale error that a working sensor can have.
    pub max_scale_error: f64,
    /// Largest bias that a working sensor can have, rad/s.
    pub max_bias_radps: f64,
}

/// The velocity that a sensor is compared with.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct ReferenceVelocity {
    /// Body x and y, m/s.
    pub v_xy: Vector2<f64>,
    /// Variance of its noise on an axis, m²/s².
    pub variance: f64,
    /// It is measured anew after this, s: until then its noise is the same.
    pub renewed_s: f64,
    /// Covariance of what is wrong with the comparison for some time (a heading that is not yet known turns the velocity), m²/s².
    pub lasting: Matrix2<f64>,
}

/// Why a flow sensor must not carry the vehicle.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Distrust {
    /// Not yet compared with GNSS for long enough.
    NotCompared,
    /// Its velocity is turned round, or scaled beyond belief.
    Scale,
    /// Its velocity is off by a constant beyond belief.
    Bias,
    /// It does not follow the motion: the residuals are as large as the velocity itself.
    Unrelated,
}

impl Distrust {
    /// A sentence for the log.
    pub const fn reason(self) -> &'static str {
        match self {
            Distrust::NotCompared => "flow was not compared with GNSS for long enough",
            Distrust::Scale => "flow contradicts GNSS: wrong sign or scale",
            Distrust::Bias => "flow contradicts GNSS: constant error",
            Distrust::Unrelated => "flow does not follow the motion",
        }
    }
}

/// Estimates [b_x, b_y, s, μ] of one sensor.
#[derive(Clone, Debug)]
pub struct FlowCalibration {
    settings: CalibrationSettings,
    x: Vector4<f64>,
    p: Matrix4<f64>,
    /// Mean square residual of an axis, relative to what the measurement's own noise explains.
    excess: f64,
    /// Mean square velocity and mean square residual, m²/s², both over the last minute.
    signal: f64,
    residual: f64,
    /// Mean velocity of late, body x and y, m/s, and mean distance, m.
    mean: Vector2<f64>,
    mean_distance: f64,
    compared_s: f64,
}

/// Time over which residual statistics are averaged, s.
const STATISTICS_S: f64 = 20.0;
/// What lasts, lasts this long, s.
const LASTING_S: f64 = 20.0;
/// Comparison needed before a sensor is believed, s.
const ENOUGH_S: f64 = 5.0;
/// A velocity of this many sigmas of its noise on an axis is none, c: noise is beyond once in 3000 times, and what is learned from twice of it is wrong by 3 %.
const NO_MOTION: f64 = 4.0;
/// Residuals beyond this many sigmas teach nothing.
const GATE: f64 = 5.0;

impl FlowCalibration {
    /// A sensor of which only the settings are known.
    pub fn new(settings: CalibrationSettings) -> Self {
        let s = &settings;
        let var =
            [s.bias_sigma_radps, s.bias_sigma_radps, s.scale_sigma, s.misalignment_sigma_rad].map(|v| v * v);
        Self {
            settings,
            x: Vector4::zeros(),
            p: Matrix4::from_diagonal(&Vector4::from(var)),
            excess: 1.0,
            signal: 0.0,
            residual: 0.0,
            mean: Vector2::zeros(),
            mean_distance: 0.0,
            compared_s: 0.0,
        }
    }

    /// The model's derivative by x at the velocity `v_xy` (body x and y, m/s) and the distance `distance_m` of the ground.
    pub fn jacobian(v_xy: &Vector2<f64>, distance_m: f64) -> Matrix2x4<f64> {
        Matrix2x4::new(distance_m, 0.0, v_xy.x, -v_xy.y, 0.0, distance_m, v_xy.y, v_xy.x)
    }

    /// Compares a flow velocity, body x and y, m/s, with a `reference`. `noise` is the covariance of the flow velocity as the solve states it at `distance_m` from
    /// the ground, `interval_s` the time since the last one. Returns the residual over its sigma.
    pub fn compare(
        &mut self,
        flow_xy: &Vector2<f64>,
        reference: &ReferenceVelocity,
        distance_m: f64,
        noise: &Matrix2<f64>,
        interval_s: f64,
    ) -> f64 {
        let s = self.settings;
        let dt = interval_s.clamp(0.0, 1.0);
        for (i, walk) in [s.bias_walk, s.bias_walk, s.scale_walk, s.scale_walk].into_iter().enumerate() {
            self.p[(i, i)] += walk * walk * dt;
        }
        let ReferenceVelocity { v_xy, variance, renewed_s, lasting } = reference;
        let h = Self::jacobian(v_xy, distance_m);
        let residual = flow_xy - v_xy - h * self.x;
        let own = Matrix2::identity() * *variance;
        let explained = noise + own + lasting + h * self.p * h.transpose();
        // An error that lasts is in many samples the same: together they tell no more than one.
        let same = |seconds: f64| (seconds / dt.max(1e-3)).max(1.0);
        let r = noise * self.excess.max(1.0) + own * same(*renewed_s) + lasting * same(LASTING_S);
        let innovation_cov = r + h * self.p * h.transpose();
        let Some(factor) = innovation_cov.cholesky() else { return f64::INFINITY };
        let normalised = residual.dot(&factor.solve(&residual)).max(0.0).sqrt();
        if !normalised.is_finite() {
            return f64::INFINITY;
        }
        self.compared_s += dt;
        let forget = (dt / STATISTICS_S).min(0.5);
        // Limited, so that one outlier does not open the gate for the next.
        let relative = (residual.norm_squared() / explained.trace().max(1e-12)).min(50.0);
        self.excess += forget * (relative - self.excess);
        self.mean += (v_xy - self.mean) * forget;
        self.mean_distance += (distance_m - self.mean_distance) * forget;
        self.signal += forget * (v_xy.norm_squared() - self.signal);
        self.residual += forget * (residual.norm_squared() - (noise + own).trace() - self.residual);
        if normalised > GATE {
            return normalised;
        }
        let mut k = factor.solve(&(h * self.p)).transpose();
        // Of late as well as now: who only looks at the single velocity picks those that noise has made large.
        let moves = 1.0 - NO_MOTION * NO_MOTION * variance / v_xy.norm_squared().min(self.signal).max(1e-12);
        k.fixed_rows_mut::<2>(2).scale_mut(moves.clamp(0.0, 1.0));
        let i_kh = Matrix4::identity() - k * h;
        self.x += k * residual;
        self.p = i_kh * self.p * i_kh.transpose() + k * r * k.transpose();
        normalised
    }

    /// The vehicle's velocity from a flow velocity at `distance_m` from the ground, body x and y, m/s: the model solved for v.
    pub fn correct(&self, flow_xy: &Vector2<f64>, distance_m: f64) -> Vector2<f64> {
        Self::undo(&self.x, flow_xy, distance_m)
    }

    /// The same with the errors x = [b_x, b_y, s, μ].
    pub fn undo(x: &Vector4<f64>, flow_xy: &Vector2<f64>, distance_m: f64) -> Vector2<f64> {
        let (s, mu) = (x[2].max(-0.9), x[3]);
        let v = (flow_xy - x.fixed_rows::<2>(0) * distance_m) / (1.0 + s);
        let norm = 1.0 + mu * mu;
        Vector2::new(v.x + mu * v.y, v.y - mu * v.x) / norm
    }

    /// The velocity's noise variance factor: residuals seen over noise stated, at least 1.
    pub fn noise_factor(&self) -> f64 {
        self.excess.max(1.0)
    }

    /// The estimate [b_x rad/s, b_y rad/s, s, μ rad].
    pub fn estimate(&self) -> &Vector4<f64> {
        &self.x
    }

    /// Its covariance.
    pub fn covariance(&self) -> &Matrix4<f64> {
        &self.p
    }

    /// Whether the sensor may carry the vehicle.
    ///
    /// # Errors
    /// The reason why not.
    pub fn trust(&self) -> Result<(), Distrust> {
        let s = &self.settings;
        if self.compared_s < ENOUGH_S {
            return Err(Distrust::NotCompared);
        }
        let sigma = self.p[(2, 2)].max(0.0).sqrt();
        if self.x[2].abs() > s.max_scale_error + sigma {
            return Err(Distrust::Scale);
        }
        // At one speed all the time, bias and scale are two names of one error: what counts is what is wrong with the velocity flown. At
        // speed, less than that of a scale error which would be borne is no bias.
        let h = Self::jacobian(&self.mean, self.mean_distance);
        let wrong = (h * self.x).norm();
        let sigma = (h * self.p * h.transpose()).trace().max(0.0).sqrt();
        let bearable = (s.max_bias_radps * self.mean_distance).max(s.max_scale_error * self.mean.norm());
        if wrong > bearable + sigma {
            return Err(Distrust::Bias);
        }
        // Sensible only when there was motion to follow.
        if self.signal > 1.0 && self.residual > 0.5 * self.signal {
            return Err(Distrust::Unrelated);
        }
        Ok(())
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use rand::{RngExt, SeedableRng};

    fn settings() -> CalibrationSettings {
        CalibrationSettings {
            bias_sigma_radps: 0.03,
            scale_sigma: 0.1,
            misalignment_sigma_rad: 0.1,
            bias_walk: 0.0001,
            scale_walk: 0.0002,
            max_scale_error: 0.4,
            max_bias_radps: 0.15,
        }
    }

    const DISTANCE_M: f64 = 10.0;

    fn exact(v_xy: Vector2<f64>) -> ReferenceVelocity {
        ReferenceVelocity { v_xy, variance: 0.0, renewed_s: 0.0, lasting: Matrix2::zeros() }
    }

    fn fly(seed: u64, truth: Vector4<f64>, speed: f64, sign: f64) -> FlowCalibration {
        let mut rng = rand_chacha::ChaCha8Rng::seed_from_u64(seed);
        let mut c = FlowCalibration::new(settings());
        for k in 0..2400 {
            let a = f64::from(k) * 0.01;
            let v = Vector2::new(a.cos(), (0.7 * a).sin()) * speed;
            let noise = Vector2::new(rng.random_range(-0.5..0.5), rng.random_range(-0.5..0.5));
            let flow = (v + FlowCalibration::jacobian(&v, DISTANCE_M) * truth) * sign + noise;
            c.compare(&flow, &exact(v), DISTANCE_M, &(Matrix2::identity() / 12.0), 0.05);
        }
        c
    }

    #[test]
    fn bias_scale_and_misalignment_are_found_within_their_sigmas() {
        let truth = Vector4::new(0.03, -0.02, -0.07, 0.05);
        for seed in 0..10 {
            let c = fly(seed, truth, 5.0, 1.0);
            for i in 0..4 {
                let sigma = c.covariance()[(i, i)].sqrt();
                assert!((c.estimate()[i] - truth[i]).abs() < 4.0 * sigma, "{i}: {} {sigma}", c.estimate()[i]);
            }
            assert_eq!(c.trust(), Ok(()));
            let v = Vector2::new(4.0, -2.0);
            let back = c.correct(&(v + FlowCalibration::jacobian(&v, DISTANCE_M) * truth), DISTANCE_M);
            assert!((back - v).norm() < 0.15, "{back}");
        }
    }

    #[test]
    fn a_heading_that_is_not_known_is_not_learned_as_misalignment() {
        let mut c = FlowCalibration::new(settings());
        let v = Vector2::new(27.0, 0.0);
        let turned = Vector2::new(27.0 * 0.1f64.cos(), 27.0 * 0.1f64.sin());
        let lasting = Matrix2::new(0.0, 0.0, 0.0, (27.0f64 * 0.1).powi(2));
        for _ in 0..100 {
            let reference = ReferenceVelocity { lasting, ..exact(turned) };
            c.compare(&v, &reference, DISTANCE_M, &(Matrix2::identity() * 0.25), 0.1);
        }
        assert!(
            (DISTANCE_M * c.estimate()[1]).hypot(27.0 * c.estimate()[3]) < 27.0 * 0.1,
            "{}",
            c.estimate()
        );
        let sigma = Vector2::new(0.0, 1.0).dot(
            &(FlowCalibration::jacobian(&v, DISTANCE_M)
                * c.covariance()
                * FlowCalibration::jacobian(&v, DISTANCE_M).transpose()
                * Vector2::new(0.0, 1.0)),
        );
        assert!(sigma.sqrt() > 1.0, "what is not known stays unknown: {sigma}");
    }

    #[test]
    fn a_hover_teaches_nothing_of_the_scale() {
        let c = fly(1, Vector4::zeros(), 0.0, 1.0);
        assert!(c.covariance()[(2, 2)].sqrt() > 0.09);
    }

    /// Noise of GNSS is no motion: near the ground the flow knows better than GNSS that the vehicle stands, and slowly as it flies its scale is not bent.
    #[test]
    fn noise_of_the_reference_is_not_learned_as_scale() {
        for (speed, distance_m) in [(0.0, 0.5), (0.0, 10.0), (0.3, 2.0), (1.0, 2.0), (4.0, 10.0)] {
            let mut rng = rand_chacha::ChaCha8Rng::seed_from_u64(7);
            let mut noise = |sigma: f64| {
                let mut sum = || (0..12).map(|_| rng.random_range(-0.5..0.5)).sum::<f64>() * sigma;
                Vector2::new(sum(), sum())
            };
            let (mut c, flow_sigma) = (FlowCalibration::new(settings()), 0.04 * distance_m);
            let mut wrong = Vector2::zeros();
            for k in 0..2400 {
                let a = f64::from(k) * 0.01;
                let v = Vector2::new(a.cos(), (0.7 * a).sin()) * speed;
                if k % 4 == 0 {
                    wrong = noise(0.1);
                }
                let reference =
                    ReferenceVelocity { v_xy: v + wrong, variance: 0.01, renewed_s: 0.2, ..exact(v) };
                let of_flow = Matrix2::identity() * flow_sigma * flow_sigma;
                c.compare(&(v * 0.9 + noise(flow_sigma)), &reference, distance_m, &of_flow, 0.05);
            }
            let (scale, sigma) = (c.estimate()[2], c.covariance()[(2, 2)].sqrt());
            // Nothing is known of what is not seen.
            assert!((scale + 0.1).abs() < 2.5 * sigma + 0.02, "{speed}: {scale} {sigma}");
            assert!(if speed < 0.5 { sigma > 0.08 } else { sigma < 0.08 }, "{speed}: {sigma}");
        }
    }

    #[test]
    fn a_flow_of_the_wrong_sign_is_found_out() {
        let c = fly(2, Vector4::zeros(), 12.0, -1.0);
        assert!(c.trust().is_err());
    }

    #[test]
    fn no_comparison_no_trust() {
        assert_eq!(FlowCalibration::new(settings()).trust(), Err(Distrust::NotCompared));
    }
}
