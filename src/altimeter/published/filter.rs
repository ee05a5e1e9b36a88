//! The published altimeters' filters: one measurement channel each, with the optimal and the robust Kalman filter.
//!
//! Contreras and Hajiyev, "Robust Kalman filter-based fault-tolerant integrated baro-inertial-GPS altimeter", (22)-(32). What is known
//! about the robust one as printed: a bias of 3.5 to 6 σ is accepted in part, and once it clears, the truth is rejected and the filter
//! stays locked; see `examples/paper_altimeter.rs`. These filters are here for comparison.

use nalgebra::{RowSVector, SMatrix, SVector};

use super::error_model::{ErrorModel, H_IBI, H_IIG};
use super::tuning::{LARGEST_M, LOST_VARIANCE, NORMAL_SIGMAS};
use crate::altimeter::probability::normal_operation;

/// How a measurement is used.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Variant {
    /// Optimal: the standard Kalman filter, (22)-(27).
    Okf,
    /// Robust as printed: prob scales the correction (28)-(32), and the covariance does not know of it, (26).
    Rkf,
    /// Robust with the covariance that belongs to its gain: P = (I − prob K H) P⁻ (I − prob K H)ᵀ + prob² K R Kᵀ.
    RkfJoseph,
}

/// What became of a measurement.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct WeightedInnovation {
    /// The normalised innovation before the update, (29).
    pub normalised: f64,
    /// Variance of the innovation, H P⁻ Hᵀ + R, m².
    pub variance: f64,
    /// Weight that the correction had: (32), and 1 for the optimal filter.
    pub prob: f64,
}

/// A Kalman filter over the first `N` states of [`ErrorModel`] with one kind of measurement. Time goes on by [`Self::predict`], as far as
/// the data say, and a measurement is used by [`Self::update`] when there is one; one that is missing is just not there.
#[derive(Clone, Debug)]
pub struct PublishedFilter<const N: usize> {
    model: ErrorModel,
    variant: Variant,
    h: RowSVector<f64, N>,
    r: f64,
    x: SVector<f64, N>,
    p: SMatrix<f64, N, N>,
}

/// The baro-inertial altimeter's filter, scheme 1.
pub type Ibi = PublishedFilter<5>;
/// The inertial-GNSS altimeter's filter, scheme 2.
pub type Iig = PublishedFilter<4>;

impl Ibi {
    /// At x = 0 with the model's start covariance; z = H_I − H_B.
    pub fn new(model: ErrorModel, variant: Variant) -> Self {
        Self::start(model, variant, H_IBI, model.baro_variance())
    }
}

impl Iig {
    /// At x = 0 with the model's start covariance; z = H_I − H_G.
    pub fn new(model: ErrorModel, variant: Variant) -> Self {
        let h = H_IIG.fixed_columns::<4>(0).into_owned();
        Self::start(model, variant, h, model.gps_variance())
    }
}

impl<const N: usize> PublishedFilter<N> {
    fn start(model: ErrorModel, variant: Variant, h: RowSVector<f64, N>, r: f64) -> Self {
        let sigmas = model.start_sigmas();
        let variances = SVector::from_fn(|i, _| sigmas[i] * sigmas[i]);
        Self { model, variant, h, r, x: SVector::zeros(), p: SMatrix::from_diagonal(&variances) }
    }

    /// Goes on by `dt_s`, (23) and (27), in steps of the model's length at most. An interval that is not positive and finite is none.
    pub fn predict(&mut self, dt_s: f64) {
        let Some((n, step_s)) = self.model.steps(dt_s) else { return };
        let (phi, q) = (self.model.transition(step_s), self.model.process_noise(step_s));
        let phi: SMatrix<f64, N, N> = phi.fixed_view::<N, N>(0, 0).into_owned();
        for _ in 0..n {
            if self.variance() > LOST_VARIANCE {
                return;
            }
            self.x = phi * self.x;
            self.p = phi * self.p * phi.transpose();
            for i in 0..N {
                self.p[(i, i)] += q[i];
            }
        }
    }

    /// What a measurement `z` of now would meet, inertial less measured altitude, m: (24), (29), (32). `None` when it is no height.
    pub fn innovation(&self, z: f64) -> Option<WeightedInnovation> {
        if z.is_nan() || z.abs() > LARGEST_M {
            return None;
        }
        let variance = (self.h * self.p * self.h.transpose())[0] + self.r;
        let normalised = (z - (self.h * self.x)[0]) / variance.sqrt();
        let prob = match self.variant {
            Variant::Okf => 1.0,
            Variant::Rkf | Variant::RkfJoseph => normal_operation(normalised, 1.0, NORMAL_SIGMAS),
        };
        Some(WeightedInnovation { normalised, variance, prob })
    }

    /// Uses it: (25), (26), (28). `None`, and nothing changes, when it is no height.
    pub fn update(&mut self, z: f64) -> Option<WeightedInnovation> {
        let innovation = self.innovation(z)?;
        let WeightedInnovation { variance, prob, .. } = innovation;
        let k = self.p * self.h.transpose() / variance;
        self.x += k * (prob * (z - (self.h * self.x)[0]));
        self.p = match self.variant {
            Variant::Okf | Variant::Rkf => (SMatrix::identity() - k * self.h) * self.p,
            Variant::RkfJoseph => {
                let rest = SMatrix::<f64, N, N>::identity() - k * self.h * prob;
                rest * self.p * rest.transpose() + k * k.transpose() * (prob * prob * self.r)
            }
        };
        // (26) loses the symmetry to rounding.
        self.p = (self.p + self.p.transpose()) * 0.5;
        Some(innovation)
    }

    /// The error of the inertial altitude, ΔH_I, m.
    pub fn delta_h(&self) -> f64 {
        self.x[0]
    }

    /// Its variance, m².
    pub fn variance(&self) -> f64 {
        self.p[(0, 0)]
    }

    /// R of its measurements, m².
    pub fn noise_variance(&self) -> f64 {
        self.r
    }

    /// The state.
    pub fn state(&self) -> &SVector<f64, N> {
        &self.x
    }

    /// Its covariance.
    pub fn covariance(&self) -> &SMatrix<f64, N, N> {
        &self.p
    }
}
