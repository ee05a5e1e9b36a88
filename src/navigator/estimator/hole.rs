//! Over a hole in the stream, whether the messages were missing or the process: what may have happened in it, and how the attitude is found
//! again.
//!
//! **Doubt.** Between two samples that are not far apart the motion goes on as they feel it, and what is not known of it is an acceleration
//! and a rate. Beyond that nothing is known of the motion but how vehicles fly: the velocity is a Gauss-Markov process of first order (as
//! the acceleration is in Singer, IEEE TAES 6, 1970) that begins at the last one, of standard deviation σ and correlation time τ,
//!
//! var δv = σ²(1 − e^(−2t/τ)),  var δp = σ²τ²(2t/τ − 3 + 4e^(−t/τ) − e^(−2t/τ)),  cov(δp, δv) = σ²τ(1 − e^(−t/τ))².
//!
//! How long a leg lasts nobody knows: τ is that of manoeuvres in a short hole, and in a longer one what leaves the most doubt of the position,
//! t/1.9, which makes σ_p = 0.62 σ t. The velocity after it still has to do with the way of the last manoeuvre alone. Its mean goes over
//! in a time T of its own, v̂ = v e^(−t/T), p̂ = p + v T (1 − e^(−t/T)): a vehicle that flew on for minutes as it did last would be in another
//! country, and one that climbed on in space. The height goes the same way.
//!
//! **Attitude.** A vehicle in the air keeps its tilt within bounds and its heading not. After a long hole the mean specific force of some
//! tenths of a second, less the centripetal force of a wing, says where up is, and the magnetic field where north is.

use std::f64::consts::FRAC_1_SQRT_2;

use nalgebra::Vector3;

use crate::altimeter::UnseenClimb;
use crate::filter::error_state::{Doubt, EskfState, Fade};
use crate::geo::so3;
use crate::sample::ImuSample;

use crate::navigator::tuning::hole::{
    CORRELATED_S, FADES_S, LEAST_CLIMB, LEAST_SPEED, LEVEL_SIGMA, MOST_DOUBTFUL, MOST_TILT, MOST_YAW,
    SETTLED_S, UNKNOWN_ACCELERATION, UNKNOWN_RATE, WAIT_FOR_FIELD_S,
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

/// What is left of a velocity after `gap_s`, as far as anybody can tell, and how far it has led, s of it.
fn faded(gap_s: f64) -> (f64, f64) {
    let gone = -(-gap_s / FADES_S).exp_m1();
    (1.0 - gone, FADES_S * gone)
}

/// Where the velocity of a vehicle goes in `gap_s`. A wing has turned by then as well, but it has not stopped: that it still flies is what its
/// airspeed is held against, and its course is doubted by all of its speed.
pub(super) fn fade_over(gap_s: f64, wing: bool) -> Fade {
    let (kept, way_s) = faded(gap_s);
    let level = if wing { 1.0 } else { kept };
    Fade { kept: [level, level, kept], way_s }
}

/// What an axis may be off by after `gap_s`, where its velocity is of standard deviation `sigma`, m/s, in the long run: the standard deviations of
/// position and velocity, m and m/s, and their covariance, m²/s.
fn process(gap_s: f64, sigma: f64) -> [f64; 3] {
    let tau = CORRELATED_S.max(gap_s / MOST_DOUBTFUL);
    let kept = (-gap_s / tau).exp();
    let velocity = sigma * (1.0 - kept * kept).max(0.0).sqrt();
    let way = 2.0 * gap_s / tau - 3.0 + 4.0 * kept - kept * kept;
    let manoeuvre = (-gap_s / CORRELATED_S).exp_m1();
    [sigma * tau * way.max(0.0).sqrt(), velocity, sigma * sigma * CORRELATED_S * manoeuvre * manoeuvre]
}

/// What may have happened in `gap_s` to a vehicle that flew at `speed_mps`, when nothing of it was felt. In the long run a velocity of this
/// length has any direction, and v/√2 an axis.
pub(super) fn doubt_beyond(gap_s: f64, speed_mps: f64) -> Doubt {
    let [position, velocity, both] = process(gap_s, (speed_mps * FRAC_1_SQRT_2).max(LEAST_SPEED));
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

/// The same of a height that was climbing at `climb_mps`.
pub(in super::super) fn climb_beyond(gap_s: f64, climb_mps: f64) -> UnseenClimb {
    let [height_m, climb_mps, both] = process(gap_s, climb_mps.abs().max(LEAST_CLIMB));
    let (kept, way_s) = faded(gap_s);
    // What is not known of either has to be a covariance.
    let both = both.min(0.75f64.sqrt() * height_m * climb_mps);
    UnseenClimb { kept, way_s, height_m, climb_mps, both }
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
    /// How fast a wing went through the air when it was last known, m/s.
    nose_mps: f64,
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
    /// Begins, of a vehicle that flew like this before: a wing keeps its speed, whatever becomes of its course.
    pub(super) fn after(state: &EskfState) -> Self {
        Self { nose_mps: state.air_velocity_body().norm(), ..Self::default() }
    }

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
            let nose = Vector3::x() * self.nose_mps;
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
            assert!(pair[1].position > pair[0].position && pair[1].velocity >= pair[0].velocity - 1e-9);
            assert!(pair[1].tilt >= pair[0].tilt && pair[1].yaw >= pair[0].yaw);
        }
        assert!(doubts.iter().all(|d| (0.0..1.0).contains(&d.correlation)));
        assert!((0.98..=1.0).contains(&(doubts[6].velocity / LEAST_SPEED)), "{:?}", doubts[6]);
        // Metres after a second, not kilometres after a minute, and after ten minutes wherever such a vehicle gets to.
        assert!(doubts[1].position < 2.0 && doubts[5].position < 150.0, "{doubts:?}");
        assert!((0.5..0.7).contains(&(doubts[6].position / (600.0 * LEAST_SPEED))), "{doubts:?}");
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
            // Longer holes have a correlation time of their own.
            if k % 2000 == 0 && f64::from(k) * dt <= MOST_DOUBTFUL * tau {
                let d = doubt_beyond(f64::from(k) * dt, 0.0);
                assert!((d.velocity * d.velocity / vv - 1.0).abs() < 2e-3);
                assert!((d.position * d.position / pp - 1.0).abs() < 5e-3, "{pp} {}", d.position);
                let both = d.correlation * d.position * d.velocity;
                assert!((both / pv - 1.0).abs() < 0.02, "{both} {pv}");
            }
        }
    }

    /// No correlation time leaves more doubt of the position than that of a long hole.
    #[test]
    fn the_doubt_of_a_long_hole_is_the_most_that_a_process_leaves() {
        let of = |x: f64| (2.0 * x - 3.0 + 4.0 * (-x).exp() - (-2.0 * x).exp()).sqrt() / x;
        let most = (1..1000).map(|k| of(f64::from(k) * 0.01)).fold(0.0, f64::max);
        for gap_s in [8.0, 60.0, 600.0, 6000.0] {
            let [position, _, _] = process(gap_s, 5.0);
            assert!((position / (5.0 * gap_s) / most - 1.0).abs() < 1e-3, "{gap_s}: {position}");
        }
    }

    #[test]
    fn neither_way_nor_climb_runs_away_over_any_hole() {
        for gap_s in [0.6, 5.0, 60.0, 600.0, 1e5, 1e9] {
            let fade = fade_over(gap_s, false);
            let kept = fade.kept[2];
            assert!(fade.way_s <= FADES_S && fade.way_s <= gap_s && (0.0..1.0).contains(&kept), "{fade:?}");
            assert_eq!((fade.kept, fade_over(gap_s, true).kept), ([kept; 3], [1.0, 1.0, kept]));
            let climb = climb_beyond(gap_s, -2.0);
            assert!(climb.height_m > 0.35 * gap_s.min(5.0) && climb.climb_mps <= LEAST_CLIMB, "{climb:?}");
            assert!(climb.both < climb.height_m * climb.climb_mps, "{climb:?}");
        }
        // Over a short one it goes on as it went.
        assert!((faded(1.0).1 - 1.0).abs() < 0.03 && faded(1.0).0 > 0.95);
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
        let mut settling = Settling::after(&state);
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
