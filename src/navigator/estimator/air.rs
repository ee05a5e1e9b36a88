//! The air that the error-state filter knows of.

use nalgebra::Vector2;

use super::EstimatorStack;

/// What an airspeed should be by the error-state filter, m/s, and the variance of that, (m/s)².
pub(in super::super) fn expected_airspeed(estimator: &EstimatorStack) -> Option<(f64, f64)> {
    estimator.error_state()?.filter().expected_airspeed()
}

/// The wind is another: see [`Eskf::change_wind`](crate::filter::error_state::Eskf::change_wind).
pub(in super::super) fn change_wind(estimator: &mut EstimatorStack, change: &Vector2<f64>, sigma: f64) {
    if let Some(stage) = estimator.error_state_mut() {
        stage.filter_mut().change_wind(change, sigma);
    }
}
