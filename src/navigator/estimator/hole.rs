//! Over a hole in the stream, whether the messages were missing or the process: what may have happened in it, and how the attitude is found
//! again.
//!
//! **Doubt.** Between two samples that are not far apart the motion goes on as they feel it, and what is not known of it is an acceleration
//! and a rate. Beyond that nothing is known of the motion but how vehicles fly: the velocity is a Gauss-Markov process of first order (as
//! the acceleration is in Singer, IEEE TAES 6, 1970) that begins at the last one, of standard deviation σ and correlation time τ,
//!
//! var δv = σ²(1 − e^(−2t/τ)),  var δp = σ²τ²(2t/τ − 3 + 4e^(−t/τ) − e^(−2t/τ)),  cov(δp, δv) = σ²τ(1 − e^(−t/τ))².
//!
//! **Attitude.** A vehicle in the air keeps its tilt within bounds and its heading not. After a long hole the mean specific force of some
//! tenths of a second, less the centripetal force of a wing, says where up is, and the magnetic field where north is.

use std::f64::consts::FRAC_1_SQRT_2;

use nalgebra::Vector3;

use crate::filter::error_state::{Doubt, EskfState};
use crate::geo::so3;
use crate::sample::ImuSample;

use crate::navigator::tuning::hole::{
    CORRELATED_S, LEAST_SPEED, LEVEL_SIGMA, MOST_TILT, MOST_YAW, SETTLED_S, UNKNOWN_ACCELERATION,
    UNKNOWN_RATE, WAIT_FOR_FIELD_S,
};

/// What may have happened in `gap_s` besides what was felt before and after.
pub(super) fn doubt_between(gap_s: f64) -> Doubt {
    let velocity = UNKNOWN_ACCELERATION * gap_s;
    Doubt {
        tilt: UNKNOWN_RATE * gap_s,
        yaw: UNKNOWN_RATE * gap_s,
        position: 0.5 * velocity * gap_s,
        velocity,
        // That of white noise: how the acceleration came and went is not known, either.
        correlation: 0.75f64.sqrt(),
        accel_bias: 0.0,
    }
}

/// What may have happened in `gap_s` to a vehicle that flew at `speed_mps`, when nothing of it was felt. In the long run a velocity of this
/// length has any direction, and v/√2 an axis.
pub(super) fn doubt_beyond(gap_s: f64, speed_mps: f64) -> Doubt {
    let (sigma, tau) = ((speed_mps * FRAC_1_SQRT_2).max(LEAST_SPEED), CORRELATED_S);
    let kept = (-gap_s / tau).exp();
    let velocity = sigma * (1.0 - kept * kept).max(0.0).sqrt();
    let way = 2.0 * gap_s / tau - 3.0 + 4.0 * kept - kept * kept;
    let position = sigma * tau * way.max(0.0).sqrt();
    let both = sigma * sigma * tau * (1.0 - kept).powi(2);
    let correlation = both / (position * velocity).max(f64::MIN_POSITIVE);
    Doubt {
        tilt: (UNKNOWN_RATE * gap_s).min(MOST_TILT),
        yaw: (UNKNOWN_RATE * gap_s).min(MOST_YAW),
        position,
        velocity,
        correlation: correlation.min(0.75f64.sqrt()),
        accel_bias: 0.0,
    }
}

/// What more may have happened from one time to another, `span_s`, since there is no inertia, to a vehicle at `speed_mps` whose velocity is known
/// with `variance`, (m/s)²: the Gauss-Markov process goes on from there, v̇ar = 2 (σ² − var)/τ. A measured velocity is used up by it and not kept.
pub(super) fn doubt_more(span_s: [f64; 2], speed_mps: f64, variance: f64) -> Doubt {
    let [from, to] = span_s.map(|t| doubt_beyond(t.max(f64::MIN_POSITIVE), speed_mps));
    let more = |a: f64, b: f64| (b * b - a * a).max(0.0).sqrt();
    let sigma = (speed_mps * FRAC_1_SQRT_2).max(LEAST_SPEED);
    let lost = 1.0 - (-2.0 * (span_s[1] - span_s[0]) / CORRELATED_S).exp();
    Doubt {
        tilt: more(from.tilt, to.tilt),
        yaw: more(from.yaw, to.yaw),
        velocity: ((sigma * sigma - variance).max(0.0) * lost).sqrt(),
        ..Doubt::NONE
    }
}

/// The attitude is being found again: what was felt since the hole, in the axes that the attitude so far makes of NED. They are turned
/// against NED's by the error of that attitude, which is constant while the gyros carry it.
#[derive(Clone, Copy, Debug, Default)]
pub(super) struct Settling {
    seconds: f64,
    /// ∫ of what points up, m/s.
    up: Vector3<f64>,
}

/// How an attitude that was found again lies to the one so far.
#[derive(Clone, Copy, Debug)]
pub(super) struct Levelled {
    /// About the axes of NED, rad.
    pub(super) turn_ned: Vector3<f64>,
    /// What is not known of roll and pitch, 1 sigma, rad.
    pub(super) tilt_sigma: f64,
}

impl Settling {
    /// One IMU sample over `dt` s; `wing` flies nose first. The level once it is known; with a magnetometer about its field is waited for.
    pub(super) fn feel(
        &mut self,
        s: &ImuSample,
        dt: f64,
        state: &EskfState,
        wing: bool,
        field_due: bool,
    ) -> Option<Levelled> {
        let mut up = s.specific_force.raw() - state.accel_bias;
        if wing {
            // In a coordinated turn the specific force has no side: what curves the path is no part of gravity's reaction.
            let nose = Vector3::x() * state.air_velocity_body().norm();
            up -= (s.angular_rate.raw() - state.gyro_bias).cross(&nose);
        }
        self.seconds += dt;
        self.up += state.r_body_to_ned * up * dt;
        let waits = field_due && self.seconds < WAIT_FOR_FIELD_S;
        (self.seconds >= SETTLED_S && !waits).then(|| self.level())
    }

    /// The shortest rotation that turns up where it belongs.
    fn level(&self) -> Levelled {
        let up = self.up.try_normalize(1e-6).unwrap_or(-Vector3::z());
        let axis = up.cross(&-Vector3::z());
        let angle = axis.norm().atan2(-up.z);
        let turn_ned = axis.try_normalize(1e-9).unwrap_or(Vector3::x()) * angle;
        Levelled { turn_ned, tilt_sigma: LEVEL_SIGMA }
    }
}

/// The heading by the magnetic field, whatever it was before: how far the attitude has to be turned about down, and how well that is known
/// with a field of `sigma_t` noise and this tilt, rad. `None` where the field has no horizontal part.
pub(super) fn heading_error(
    state: &EskfState,
    field_body: &Vector3<f64>,
    field_ned: &Vector3<f64>,
    sigma_t: f64,
    tilt_sigma: f64,
) -> Option<(f64, f64)> {
    let seen = state.r_body_to_ned * (field_body - state.magnetic_bias);
    let horizontal = field_ned.xy().norm();
    if horizontal < sigma_t || seen.xy().norm() < sigma_t {
        return None;
    }
    let turn = field_ned.y.atan2(field_ned.x) - seen.y.atan2(seen.x);
    // A tilt takes its part of the vertical field for a horizontal one.
    let sigma = (sigma_t / horizontal).hypot(field_ned.z / horizontal * tilt_sigma);
    Some((so3::wrap_pi(turn), sigma))
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::geo::Body;
    use crate::time::AutopilotTime;
    use nalgebra::Matrix3;

    #[test]
    fn doubt_grows_with_the_hole_and_not_beyond_what_a_vehicle_does() {
        let doubts = [0.5, 1.0, 2.0, 5.0, 10.0, 60.0, 600.0].map(|t| doubt_beyond(t, 3.0));
        for pair in doubts.windows(2) {
            assert!(pair[1].position > pair[0].position && pair[1].velocity >= pair[0].velocity);
            assert!(pair[1].tilt >= pair[0].tilt && pair[1].yaw >= pair[0].yaw);
        }
        assert!(doubts.iter().all(|d| (0.0..1.0).contains(&d.correlation)));
        assert!((doubts[6].velocity - LEAST_SPEED).abs() < 1e-9, "{:?}", doubts[6]);
        // Metres after a second, not kilometres after a minute.
        assert!(doubts[1].position < 2.0 && doubts[5].position < 150.0, "{doubts:?}");
        let fast = doubt_beyond(10.0, 20.0);
        assert!((fast.position / doubts[4].position - 20.0 * FRAC_1_SQRT_2 / LEAST_SPEED).abs() < 1e-9);
        assert!([0.0, 1e-9, 1e-4].map(|t| doubt_beyond(t, 3.0)).iter().all(|d| d.position.is_finite()));
    }

    /// The process itself, by Euler steps with white noise, against its closed form.
    #[test]
    fn the_doubt_of_a_long_hole_is_that_of_the_process() {
        let (dt, tau, sigma) = (1e-3, CORRELATED_S, LEAST_SPEED);
        // P of [p, v] under ṗ = v, v̇ = −v/τ + noise of density 2σ²/τ.
        let (mut pp, mut pv, mut vv) = (0.0, 0.0, 0.0);
        for k in 1..=10_000 {
            (pp, pv, vv) = (
                pp + 2.0 * dt * pv,
                pv + dt * (vv - pv / tau),
                vv + dt * (2.0 * sigma * sigma / tau - 2.0 * vv / tau),
            );
            if k % 2000 == 0 {
                let d = doubt_beyond(f64::from(k) * dt, 0.0);
                assert!((d.velocity * d.velocity / vv - 1.0).abs() < 2e-3);
                assert!((d.position * d.position / pp - 1.0).abs() < 5e-3, "{pp} {}", d.position);
                let both = d.correlation * d.position * d.velocity;
                assert!((both / pv - 1.0).abs() < 0.02, "{both} {pv}");
            }
        }
    }

    fn feel(r: &Matrix3<f64>, believed: &Matrix3<f64>, force: Vector3<f64>, rate: Vector3<f64>) -> Levelled {
        let zero = Vector3::zeros();
        let velocity = r * Vector3::new(15.0, 0.0, 0.0);
        let state = EskfState::moving(*believed, zero, velocity, zero);
        let s = ImuSample {
            time: AutopilotTime::from_micros(0),
            angular_rate: Body::new(rate),
            specific_force: Body::new(force),
        };
        let mut settling = Settling::default();
        (0..100).find_map(|_| settling.feel(&s, 0.01, &state, rate.norm() > 0.0, false)).unwrap()
    }

    #[test]
    fn a_level_vehicle_is_levelled_from_any_tilt() {
        let heading = so3::exp(&Vector3::new(0.0, 0.0, 0.7));
        for tilt in [Vector3::new(0.4, -0.3, 0.0), Vector3::new(0.0, 2.9, 0.0), Vector3::zeros()] {
            let believed = so3::exp(&tilt) * heading;
            let found = feel(&heading, &believed, Vector3::new(0.0, 0.0, -9.8), Vector3::zeros());
            let r = so3::exp(&found.turn_ned) * believed;
            assert!((r[(2, 2)] - 1.0).abs() < 1e-9, "{tilt}: {r}");
        }
    }

    #[test]
    fn a_wing_in_a_turn_keeps_its_bank() {
        // 15 m/s at 30° of bank to the right: the load lies in body z, and the turn tells the bank.
        let bank = 30f64.to_radians();
        let r = so3::exp(&Vector3::new(bank, 0.0, 0.0));
        let turning = r.transpose() * Vector3::new(0.0, 0.0, 9.8 * bank.tan() / 15.0);
        let found = feel(&r, &Matrix3::identity(), Vector3::new(0.0, 0.0, -9.8 / bank.cos()), turning);
        assert!((found.turn_ned.x - bank).abs() < 0.01, "{:?}", found.turn_ned);
    }

    #[test]
    fn the_field_tells_the_heading_from_any_other() {
        let field_ned = Vector3::new(20e-6, 2e-6, 45e-6);
        let r = so3::exp(&Vector3::new(0.0, 0.0, 3.0));
        let mut state = EskfState::moving(r, Vector3::zeros(), Vector3::zeros(), Vector3::zeros());
        state.magnetic_bias = Vector3::new(3e-6, 0.0, 0.0);
        let truth = so3::exp(&Vector3::new(0.0, 0.0, -1.5));
        let seen = truth.tr_mul(&field_ned) + state.magnetic_bias;
        let (turn, sigma) = heading_error(&state, &seen, &field_ned, 2.5e-6, 0.2).unwrap();
        assert!((turn - so3::wrap_pi(-4.5)).abs() < 1e-9);
        assert!((sigma - (2.5f64 / 20.1).hypot(45.0 / 20.1 * 0.2)).abs() < 0.01, "{sigma}");
        assert!(heading_error(&state, &seen, &Vector3::new(0.0, 0.0, 50e-6), 2.5e-6, 0.2).is_none());
    }
}
