//! How well the estimate is known: by the filter's own covariances, and by what the shadows have proven.

use nalgebra::Matrix3;

use super::super::memory::DriftMemory;
use super::super::shadow::{DriftComparison, Growth, MeasuredDrift, TimeBeside};
use super::super::solution::VelocitySource;
use super::{EstimatorStack, Stage};

impl EstimatorStack {
    /// Covariances of position and velocity, NED, m² and (m/s)², of the filter that is published, if one is; and whether they say all: those
    /// of a filter whose biases are frozen in dead reckoning do not.
    pub(in super::super) fn covariance(&self) -> Option<(Matrix3<f64>, Matrix3<f64>, bool)> {
        if let Some(stage) = self.error_state() {
            let filter = stage.filter();
            return Some((filter.position_covariance(), filter.velocity_covariance(), true));
        }
        let filter = self.exogenous()?.filter();
        Some((filter.position_covariance(), filter.velocity_covariance(), false))
    }

    /// Covariance of the attitude of the filter that is published, about the NED axes, rad².
    pub(in super::super) fn attitude_covariance(&self) -> Option<Matrix3<f64>> {
        match (self.error_state(), self.exogenous()) {
            (Some(stage), _) => Some(stage.filter().attitude_covariance_ned()),
            (None, Some(stage)) => Some(stage.filter().attitude_covariance_ned()),
            (None, None) => None,
        }
    }

    /// How well the error-state filter knows the rotor drag, 1/s.
    pub(in super::super) fn drag_sigma(&self) -> Option<f64> {
        self.error_state().map(|s| s.filter().drag_sigma())
    }

    /// How noisy the gyros are, rad/s/√Hz, as their samples show.
    pub(in super::super) fn gyro_density(&self) -> f64 {
        self.jitter.gyro_density()
    }

    /// GNSS has shown the accelerometers to be so noisy, m/s²/√Hz.
    pub(in super::super) fn believe_inertia(&mut self, accel_density: f64) {
        self.accel_density = accel_density;
    }

    /// GNSS is lost: what the covariance grows by from now on is counted by what carries.
    pub(in super::super) fn hold_over(&mut self) {
        if let Stage::ErrorState(Some(stage)) = &self.stage {
            self.growth = Growth::from(&stage.filter().position_covariance());
        }
    }

    /// The covariance has grown for `dt` s while `source` carried.
    pub(in super::super) fn grow(&mut self, dt: f64, source: VelocitySource) {
        if let Stage::ErrorState(Some(stage)) = &self.stage {
            self.growth.go_on(dt, &stage.filter().position_covariance(), source);
        }
    }

    /// The filter was made to doubt by what is no drift: nothing is proven by that.
    pub(super) fn doubted(&mut self) {
        self.shadows.abort();
        if let Stage::ErrorState(Some(stage)) = &self.stage {
            self.growth.doubt(&stage.filter().position_covariance());
        }
    }

    /// What the time beside trusted GNSS was spent with.
    pub(in super::super) fn time_beside(&self) -> TimeBeside {
        self.shadows.beside()
    }

    /// What the shadows have measured, whatever would carry now first.
    pub(in super::super) fn measured_drift(&self) -> Vec<MeasuredDrift> {
        self.shadows.measured()
    }

    /// The newest comparison of each of the shadows.
    pub(in super::super) fn drift_comparisons(&self) -> [Option<DriftComparison>; 2] {
        self.shadows.comparisons()
    }

    /// By what the claimed covariances of position and velocity are to be multiplied without GNSS, while `source` carries: as the shadows have
    /// proven.
    pub(in super::super) fn proven(&self, source: VelocitySource) -> (f64, f64) {
        if self.error_state().is_some() {
            self.growth.factors(self.shadows.drift(), source)
        } else {
            (1.0, 1.0)
        }
    }

    /// What was learned of the drift, and what the covariance has grown by.
    pub(in super::super) fn drift_memory(&self) -> (DriftMemory, [f64; 5]) {
        (self.shadows.drift().memory(), self.growth.memory())
    }

    /// The drift was learned before.
    pub(in super::super) fn recall_drift(&mut self, memory: &DriftMemory) {
        self.shadows.recall(memory);
    }

    /// The covariance had grown before. False where it cannot have done so.
    pub(in super::super) fn recall_growth(&mut self, memory: [f64; 5]) -> bool {
        let growth = Growth::recalled(memory);
        self.growth = growth.unwrap_or(self.growth);
        growth.is_some()
    }
}
