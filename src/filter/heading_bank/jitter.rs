//! How much the IMU shakes: vibration is noise, and it differs between vehicles by a factor of ten.

use nalgebra::Vector3;

use super::tuning::MEAN_S;

/// What of the samples is white, from their second differences: motion is smoother than that.
#[derive(Clone, Copy, Debug, Default)]
pub(super) struct Jitter {
    last: Option<[(Vector3<f64>, Vector3<f64>); 2]>,
    /// Mean square of the noise densities of rate and force.
    pub(super) density: (f64, f64),
}

impl Jitter {
    /// The variances of a component of rate and force that the newest three samples show.
    pub(super) fn add(
        &mut self,
        dt: f64,
        rate: &Vector3<f64>,
        force: &Vector3<f64>,
        shared_instants: bool,
    ) -> (f64, f64) {
        let newest = (*rate, *force);
        let Some([a, b]) = self.last.replace(self.last.map_or([newest; 2], |[_, b]| [b, newest])) else {
            return (0.0, 0.0);
        };
        // (1 + 4 + 1) σ² of instants; of their means (1 + 1 + 1 + 1) σ²/4.
        let share = if shared_instants { 1.0 } else { 6.0 };
        let of = |a: Vector3<f64>, b: Vector3<f64>, c: Vector3<f64>| {
            (a - 2.0 * b + c).norm_squared() / (3.0 * share)
        };
        let variance = (of(a.0, b.0, newest.0), of(a.1, b.1, newest.1));
        let gain = (dt / MEAN_S).min(1.0);
        self.density.0 += gain * (variance.0 * dt - self.density.0);
        self.density.1 += gain * (variance.1 * dt - self.density.1);
        variance
    }
}
