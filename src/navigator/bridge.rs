//! A short hole in the IMU stream: the filter goes on with what it felt before and after, and knows that it does not know.

use nalgebra::Vector3;

use crate::sample::ImuSample;

use super::Navigator;
use super::event::What;
use super::history::Moment;
use super::inertial::UNKNOWN_VERTICAL;
use super::kalman::Kalman;

/// How far rotation and acceleration in a hole may be from those at its ends, rad/s and m/s², 1 sigma.
const UNKNOWN_RATE: f64 = 0.3;
const UNKNOWN_ACCELERATION: f64 = 2.0;
/// The motion in a hole is integrated in steps of this, s.
const STEP_S: f64 = 0.02;

impl Kalman {
    /// `gap_s` without samples: what may have happened in it.
    pub(super) fn doubt(&mut self, gap_s: f64) {
        let velocity = UNKNOWN_ACCELERATION * gap_s;
        self.filter.inflate(UNKNOWN_RATE * gap_s, 0.5 * velocity * gap_s, velocity);
    }
}

impl Navigator {
    /// Carries the filter over a hole of `gap_s` that ends with `s`. False when there is no filter or the hole is too long.
    pub(super) fn bridge(&mut self, s: &ImuSample, gap_s: f64) -> bool {
        if gap_s > self.settings.imu_bridge_s {
            return false;
        }
        let (Some(kalman), Some(place), Some(last)) = (&mut self.kalman, &self.place, self.last_sample)
        else {
            return false;
        };
        let rate = 0.5 * (last.angular_rate.raw() + s.angular_rate.raw());
        let force = 0.5 * (last.specific_force.raw() + s.specific_force.raw());
        let steps = (gap_s / STEP_S).ceil().max(1.0);
        let dt = gap_s / steps;
        for _ in 0..steps as usize {
            kalman.filter.predict(dt, &rate, &force, &place.gravity_ned, &place.earth_rate_ned);
        }
        kalman.doubt(gap_s);
        if !kalman.filter.is_finite() {
            return false;
        }
        let filter = *kalman.filter.state();
        self.last_sample = Some(*s);
        self.r_body_to_ned = filter.r_body_to_ned;
        self.angular_rate_body = s.angular_rate.raw() - filter.gyro_bias;
        let acceleration_ned = filter.r_body_to_ned * force + place.gravity_ned;
        // The observer has no such memory: it goes on from where the filter is.
        if let Some(state) = &mut self.state {
            state.r_hat = filter.r_body_to_ned;
            state.position_ned = filter.position_ned;
            state.velocity_ned = filter.velocity_ned;
            state.xi_ned = Vector3::zeros();
        }
        self.height.blind(gap_s, UNKNOWN_VERTICAL);
        self.predictor.clear();
        self.history.clear();
        self.history.push(
            s.time,
            &Moment {
                r_body_to_ned: filter.r_body_to_ned,
                turned: Vector3::zeros(),
                acceleration_ned,
                position_ned: filter.position_ned,
                velocity_ned: filter.velocity_ned,
            },
        );
        self.latency.interrupt();
        self.tell(s.time, What::Bridged(gap_s));
        self.advance_mode(s.time, gap_s);
        true
    }
}
