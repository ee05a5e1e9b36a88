//! What the double believes of itself: position and velocity of a Kalman filter an axis, the attitude as truth with small errors. The
//! controllers act on this and never on the truth, so that an estimate that drifts moves the vehicle.

use std::collections::VecDeque;

use nalgebra::{Matrix3, Vector3};

use super::axis::{AxisFilter, AxisQuantity};
use crate::geo::so3;
use crate::sim::noise::{GaussMarkov, SensorRng, Stream};

/// How far back a measurement may lie, s.
const REMEMBERED_S: f64 = 1.0;
/// Tilt error of the attitude: some tenths of a degree that come and go.
const TILT_ERROR: GaussMarkov = GaussMarkov { sigma: 0.002, correlation: 60.0 };
/// Error of the compass's heading.
const COMPASS_ERROR: GaussMarkov = GaussMarkov { sigma: 0.006, correlation: 120.0 };
/// How fast the heading follows its source, 1/s.
const HEADING_GAIN: f64 = 0.5;
/// Variances after a reset to a measurement are no smaller than this, m² and m²/s².
const LEAST_RESET_VARIANCE: f64 = 0.01;

/// A measurement of some axes: where, how sure, how old.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct AxisMeasurement {
    /// Position or velocity.
    pub what: AxisQuantity,
    /// The value in NED of the double's origin, m or m/s.
    pub value_ned: Vector3<f64>,
    /// Variances, m² or m²/s².
    pub variance: Vector3<f64>,
    /// When it holds, s of the simulation.
    pub time_s: f64,
}

/// The double's own filter.
#[derive(Clone, Debug)]
pub struct OwnFilter {
    axes: [AxisFilter; 3],
    now_s: f64,
    past: VecDeque<(f64, [Vector3<f64>; 2])>,
    tilt_error: Vector3<f64>,
    compass_error: f64,
    heading_error: f64,
    r_body_to_ned: Matrix3<f64>,
    rng: SensorRng,
}

impl OwnFilter {
    /// At rest at its own origin.
    pub fn at_rest(r_body_to_ned: Matrix3<f64>, seed: u64) -> Self {
        let mut rng = SensorRng::new(seed, Stream::OwnFilter);
        let tilt_error = rng.normals() * TILT_ERROR.sigma;
        let compass_error = rng.normal() * COMPASS_ERROR.sigma;
        Self {
            axes: [AxisFilter::at_rest(0.0); 3],
            now_s: 0.0,
            past: VecDeque::new(),
            tilt_error,
            compass_error,
            heading_error: compass_error,
            r_body_to_ned,
            rng,
        }
    }

    /// Position in NED of the double's origin, m.
    pub fn position(&self) -> Vector3<f64> {
        Vector3::from_fn(|i, _| self.axes[i].position())
    }

    /// Velocity in NED, m/s.
    pub fn velocity(&self) -> Vector3<f64> {
        Vector3::from_fn(|i, _| self.axes[i].velocity())
    }

    /// Horizontal uncertainty, 1 sigma, m.
    pub fn horizontal_sigma_m(&self) -> f64 {
        (self.axes[0].position_variance() + self.axes[1].position_variance()).sqrt()
    }

    /// The attitude that it believes.
    pub fn r_body_to_ned(&self) -> &Matrix3<f64> {
        &self.r_body_to_ned
    }

    /// Goes on by `dt_s` to `now_s` with the accelerometers' specific force; `r_true` is what the attitude is made from.
    pub fn predict(
        &mut self,
        now_s: f64,
        dt_s: f64,
        force_body: &Vector3<f64>,
        r_true: &Matrix3<f64>,
        gravity: f64,
    ) {
        self.now_s = now_s;
        self.tilt_error = TILT_ERROR.next3(&self.tilt_error, dt_s, &self.rng.normals());
        self.compass_error = COMPASS_ERROR.next(self.compass_error, dt_s, self.rng.normal());
        let error = Vector3::new(self.tilt_error.x, self.tilt_error.y, self.heading_error);
        self.r_body_to_ned = so3::exp(&error) * r_true;
        let acceleration = self.r_body_to_ned * force_body + Vector3::new(0.0, 0.0, gravity);
        for (axis, a) in self.axes.iter_mut().zip(acceleration.iter()) {
            axis.predict(dt_s, *a);
        }
        self.past.push_back((now_s, [self.position(), self.velocity()]));
        while self.past.front().is_some_and(|(t, _)| now_s - t > REMEMBERED_S) {
            self.past.pop_front();
        }
    }

    /// The heading follows the compass.
    pub fn heading_by_compass(&mut self, dt_s: f64) {
        self.heading_error += (self.compass_error - self.heading_error) * (HEADING_GAIN * dt_s).min(1.0);
    }

    /// The heading follows one that somebody else tells, by this much of the difference.
    pub fn heading_by(&mut self, r_body_to_ned: &Matrix3<f64>, part: f64) {
        let yaw = |r: &Matrix3<f64>| so3::Euler::from_rotation(r).yaw_rad;
        self.heading_error += so3::wrap_pi(yaw(r_body_to_ned) - yaw(&self.r_body_to_ned)) * part;
    }

    /// What it believed then: position and velocity; the oldest it remembers for what is older.
    fn believed(&self, time_s: f64) -> [Vector3<f64>; 2] {
        let i = self.past.partition_point(|(t, _)| *t < time_s);
        let (_, state) = self
            .past
            .get(i)
            .or(self.past.back())
            .copied()
            .unwrap_or((0.0, [self.position(), self.velocity()]));
        state
    }

    /// Measured less believed, at the time of the measurement.
    pub fn innovation(&self, m: &AxisMeasurement) -> Vector3<f64> {
        m.value_ned - self.believed(m.time_s)[m.what as usize]
    }

    /// The largest test ratio of these axes: above 1 the gate says no.
    pub fn test_ratio(&self, m: &AxisMeasurement, axes: &[usize], gate_sigma: f64) -> f64 {
        let innovation = self.innovation(m);
        axes.iter()
            .map(|&i| self.axes[i].test_ratio(m.what, innovation[i], m.variance[i], gate_sigma))
            .fold(0.0, f64::max)
    }

    /// Fuses these axes of a measurement.
    pub fn fuse(&mut self, m: &AxisMeasurement, axes: &[usize]) {
        let innovation = self.innovation(m);
        for &i in axes {
            self.axes[i].fuse(m.what, innovation[i], m.variance[i]);
        }
        self.rewrite_past();
    }

    /// Jumps to a measurement, on these axes.
    pub fn reset(&mut self, m: &AxisMeasurement, axes: &[usize]) {
        let to = self.innovation(m);
        for &i in axes {
            let variance = m.variance[i].max(LEAST_RESET_VARIANCE);
            let axis = &mut self.axes[i];
            match m.what {
                AxisQuantity::Position => axis.reset_position(axis.position() + to[i], variance),
                AxisQuantity::Velocity => axis.reset_velocity(axis.velocity() + to[i], variance),
            }
        }
        self.rewrite_past();
    }

    /// The past as it would have been with what is believed now, so that the next delayed measurement is not held against an estimate
    /// that was put right since.
    fn rewrite_past(&mut self) {
        let now = [self.position(), self.velocity()];
        let Some((_, before)) = self.past.back().copied() else { return };
        let [dp, dv] = [now[0] - before[0], now[1] - before[1]];
        for (t, [p, v]) in &mut self.past {
            *p += dp - dv * (self.now_s - *t);
            *v += dv;
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const HORIZONTAL: &[usize] = &[0, 1];

    fn measured(what: AxisQuantity, north: f64, time_s: f64) -> AxisMeasurement {
        let value_ned = Vector3::new(north, 0.0, 0.0);
        AxisMeasurement { what, value_ned, variance: Vector3::repeat(0.04), time_s }
    }

    /// Moves north at 10 m/s, and is told so 0.2 s late.
    #[test]
    fn what_is_late_is_held_against_what_was_believed_then() {
        let level = Matrix3::identity();
        let mut filter = OwnFilter::at_rest(level, 1);
        filter.reset(&measured(AxisQuantity::Velocity, 10.0, 0.0), HORIZONTAL);
        for k in 1..=5000 {
            let now = 0.004 * f64::from(k);
            filter.predict(now, 0.004, &Vector3::new(0.0, 0.0, -9.81), &level, 9.81);
            filter.heading_by_compass(0.004);
            if k % 25 == 0 && now > 0.3 {
                let then = now - 0.2;
                filter.fuse(&measured(AxisQuantity::Position, 10.0 * then, then), HORIZONTAL);
            }
        }
        assert!((filter.position().x - 200.0).abs() < 0.3, "{}", filter.position());
        assert!(so3::angle_between(filter.r_body_to_ned(), &level) < 0.03);
    }

    #[test]
    fn a_heading_that_is_told_is_followed() {
        let level = Matrix3::identity();
        let mut filter = OwnFilter::at_rest(level, 1);
        let told = so3::exp(&Vector3::new(0.0, 0.0, 0.2));
        for k in 1..=500 {
            filter.predict(0.004 * f64::from(k), 0.004, &Vector3::new(0.0, 0.0, -9.81), &level, 9.81);
            filter.heading_by(&told, 0.1);
        }
        assert!((so3::Euler::from_rotation(filter.r_body_to_ned()).yaw_rad - 0.2).abs() < 0.01);
    }
}
