//! The error-state filter against numeric derivatives, and what it learns of what.

use super::covariance::Covariance;
use super::measure::{flow_model, flow_rows, magnetic_row};
use super::*;
use crate::geo::so3::log;
use nalgebra::{Matrix2, Matrix4};

/// An IMU without noise, and nothing else to be estimated.
pub(super) fn silent() -> EskfSettings {
    EskfSettings {
        gyro_noise: 0.0,
        accel_noise: 0.0,
        gyro_rate_noise: 0.0,
        accel_load_noise: 0.0,
        gyro_bias_walk: 0.0,
        accel_bias_walk: 0.0,
        gyro_scale_sigma: 0.0,
        magnetic_bias_walk: 0.0,
        magnetic_bias_sigma: 0.0,
        flow_bias_walk: 0.0,
        flow_scale_walk: 0.0,
        air: AirModel::default(),
        gate_sigma: 5.0,
    }
}

fn state() -> EskfState {
    EskfState {
        r_body_to_ned: exp(&Vector3::new(0.4, -0.3, 2.0)),
        position_ned: Vector3::new(100.0, -50.0, -120.0),
        velocity_ned: Vector3::new(12.0, -7.0, 1.5),
        gyro_bias: Vector3::new(0.01, -0.02, 0.005),
        accel_bias: Vector3::new(0.05, -0.1, 0.02),
        flow: SVector::from([0.2, -0.1, 0.05, -0.03]),
        magnetic_bias: Vector3::new(1e-6, -2e-6, 5e-7),
        gyro_scale: Vector3::new(0.002, -0.001, 0.003),
        wind_ne: Vector2::new(3.0, -2.0),
        airspeed_scale: 0.02,
        drag: 0.3,
    }
}

fn certain(sigma: [f64; 5], flow: Matrix4<f64>) -> StartSigma {
    let [attitude_body, position_ned, velocity_ned, gyro_bias, accel_bias] = sigma.map(Vector3::repeat);
    StartSigma { attitude_body, position_ned, velocity_ned, gyro_bias, accel_bias, flow }
}

fn filter(state: EskfState) -> Eskf {
    Eskf::new(silent(), state, &certain([0.0; 5], Matrix4::zeros()))
}

fn perturbed(from: &EskfState, index: usize, by: f64) -> EskfState {
    let mut f = filter(*from);
    let mut dx = SVector::<f64, STATES>::zeros();
    dx[index] = by;
    f.inject(&dx);
    *f.state()
}

/// b less a, as an error state.
fn difference(a: &EskfState, b: &EskfState) -> SVector<f64, STATES> {
    let mut d = SVector::<f64, STATES>::zeros();
    d.fixed_rows_mut::<3>(THETA).copy_from(&log(&(a.r_body_to_ned.transpose() * b.r_body_to_ned)));
    d.fixed_rows_mut::<3>(P).copy_from(&(b.position_ned - a.position_ned));
    d.fixed_rows_mut::<3>(V).copy_from(&(b.velocity_ned - a.velocity_ned));
    d.fixed_rows_mut::<3>(BG).copy_from(&(b.gyro_bias - a.gyro_bias));
    d.fixed_rows_mut::<3>(BA).copy_from(&(b.accel_bias - a.accel_bias));
    d.fixed_rows_mut::<4>(FLOW).copy_from(&(b.flow - a.flow));
    d.fixed_rows_mut::<3>(BM).copy_from(&((b.magnetic_bias - a.magnetic_bias) * MICRO));
    d.fixed_rows_mut::<3>(SG).copy_from(&(b.gyro_scale - a.gyro_scale));
    d.fixed_rows_mut::<2>(WIND).copy_from(&(b.wind_ne - a.wind_ne));
    d[AIRSPEED] = b.airspeed_scale - a.airspeed_scale;
    d[DRAG] = b.drag - a.drag;
    d
}

const RATE: Vector3<f64> = Vector3::new(0.3, -0.2, 0.5);
const FORCE: Vector3<f64> = Vector3::new(1.0, 0.5, -11.0);
const GRAVITY: Vector3<f64> = Vector3::new(0.0, 0.0, 9.81);

fn step(f: &mut Eskf, dt: f64) {
    f.predict(dt, &RATE, &FORCE, &GRAVITY, &Vector3::zeros());
}

#[test]
fn the_covariance_moves_as_the_error_does() {
    // Steps of 4 ms, five of which are propagated at once.
    let eps = 1e-5;
    for index in 0..STATES {
        let (mut a, mut b) = (filter(state()), filter(perturbed(&state(), index, eps)));
        a.p[(index, index)] = 1.0;
        for _ in 0..5 {
            step(&mut a, 0.004);
            step(&mut b, 0.004);
        }
        a.propagate_covariance();
        let moved = difference(a.state(), b.state()) / eps;
        let expected = moved * moved.transpose();
        // Of second order in the 20 ms that are propagated at once.
        assert!((a.p - expected).amax() < 5e-3, "{index}: {}", (a.p - expected).amax());
        assert_eq!(a.p, a.p.transpose());
    }
}

/// Of the ground, in tests.
const DISTANCE_M: f64 = 3.0;

fn rows_match(row: &covariance::SparseRow, expected: impl Fn(&EskfState) -> f64, tolerance: f64) {
    let eps = 1e-6;
    let base = expected(&state());
    let mut dense = SVector::<f64, STATES>::zeros();
    row.entries().for_each(|(i, h)| dense[i] += h);
    for index in 0..STATES {
        let moved = (expected(&perturbed(&state(), index, eps)) - base) / eps;
        assert!((moved - dense[index]).abs() < tolerance, "by {index}: {moved} and {}", dense[index]);
    }
}

#[test]
fn measurement_rows_are_the_derivatives() {
    let field = Vector3::new(2e-5, 1e-6, 4.5e-5);
    let s = state();
    let seen = |s: &EskfState| s.r_body_to_ned.tr_mul(&s.velocity_ned);
    let rows = flow_rows(&s, &seen(&s), DISTANCE_M, &s.r_body_to_ned, &Lag::NONE);
    for (i, row) in rows.iter().enumerate() {
        rows_match(row, |s| flow_model(&s.flow, &seen(s), DISTANCE_M)[i], 1e-4);
    }
    for axis in 0..3 {
        let row = magnetic_row(&s.r_body_to_ned.tr_mul(&field), axis);
        rows_match(&row, |s| s.expected_magnetic(&field)[axis] * MICRO, 1e-3);
    }
    for axis in 0..2 {
        let row = s.drag_row(&s.air_velocity_body(), axis);
        rows_match(&row, |s| s.expected_drag(&s.air_velocity_body())[axis], 1e-4);
    }
    rows_match(&s.airspeed_row().unwrap().1, |s| s.airspeed_row().unwrap().0, 1e-4);
    rows_match(&s.sideslip_row().unwrap().2, |s| s.sideslip_row().unwrap().0, 1e-4);
}

/// A late measurement's row, applied to the error of now, is the derivative of the state of then.
#[test]
fn late_rows_relate_the_past_to_the_present() {
    let (dt, n, eps) = (0.004, 50, 1e-5);
    let run = |from: &EskfState| {
        let mut f = filter(*from);
        (0..n).for_each(|_| step(&mut f, dt));
        *f.state()
    };
    let now = run(&state());
    let lag_s = dt * f64::from(n);
    let lag = Lag { seconds: lag_s, impulse_ned: now.velocity_ned - state().velocity_ned - GRAVITY * lag_s };
    let seen = |s: &EskfState| s.r_body_to_ned.tr_mul(&s.velocity_ned);
    let rows = flow_rows(&now, &seen(&state()), DISTANCE_M, &state().r_body_to_ned, &lag);
    // Attitude, position, velocity and flow errors of then; the biases' part is of second order.
    for index in (THETA..BG).chain(FLOW..FLOW + 4) {
        let then = perturbed(&state(), index, eps);
        let error_now = difference(&now, &run(&then)) / eps;
        let shown = |s: &EskfState| flow_model(&s.flow, &seen(s), DISTANCE_M);
        let flow = (shown(&then) - shown(&state())) / eps;
        for i in 0..2 {
            assert!((rows[i].dot(&error_now) - flow[i]).abs() < 0.02, "flow {i} by {index}");
        }
        let mut f = filter(now);
        for axis in 0..3 {
            let moved = difference(&state(), &then) / eps;
            for (block, row) in [
                (P, measure::position_row(f.state(), axis, &lag)),
                (V, measure::velocity_row(f.state(), axis, &lag)),
            ] {
                let got = row.dot(&error_now);
                assert!((got - moved[block + axis]).abs() < 0.06, "{block} {axis} by {index}: {got}");
            }
        }
        f.propagate_covariance();
    }
}

#[test]
fn the_covariance_stays_symmetric_and_positive() {
    let settings = EskfSettings {
        gyro_noise: 1e-3,
        accel_noise: 0.05,
        gyro_bias_walk: 1e-5,
        gyro_scale_sigma: 0.01,
        magnetic_bias_sigma: 2e-6,
        air: AirModel { wind_sigma: 5.0, wind_walk: 0.1, airspeed_scale_sigma: 0.1, drag_sigma: 0.2 },
        ..silent()
    };
    let sigma = certain([0.1, 3.0, 0.5, 0.01, 0.1], Matrix4::identity() * 0.01);
    let mut f = Eskf::new(settings, state(), &sigma);
    let field = Vector3::new(2e-5, 1e-6, 4.5e-5);
    for k in 0..5000 {
        step(&mut f, 0.01);
        if k % 20 == 0 {
            let lag = Lag { seconds: 0.2, impulse_ned: Vector3::new(0.1, 0.2, -2.0) };
            let _ = f.fuse_position(k % 3, 0.5, 1.0, &lag);
            let _ = f.fuse_fix(&Vector2::new(0.3, -0.2), Some(&Vector2::new(0.1, 0.05)), [1.0, 0.04], &lag);
            let body = f.state().expected_magnetic(&field);
            let _ = f.fuse_magnetic(&body, &field, &Vector3::repeat(1e-6));
            let (v, r) = (f.state().velocity_ned, f.state().r_body_to_ned);
            let v_xy = flow_model(&f.state().flow, &r.tr_mul(&v), DISTANCE_M);
            let seen = SeenFlow { v_xy, distance_m: DISTANCE_M, covariance: Matrix2::identity() * 0.25 };
            let _ = f.fuse_flow(&seen, &v, &r, &Lag::NONE);
            let expected = f.state().airspeed_row().map_or(0.0, |a| a.0);
            let _ = f.fuse_airspeed(expected + 0.1, 1.0);
            let _ = f.fuse_sideslip(0.1);
            let air = f.state().air_velocity_body();
            let _ = f.fuse_drag(&f.state().expected_drag(&air), &air, 0.3);
        }
    }
    assert!(f.is_finite());
    assert_eq!(f.p, f.p.transpose());
    // Units differ by orders of magnitude: correlations are what can be compared.
    let correlation =
        Covariance::from_fn(|i, j| f.p[(i, j)] / (f.p[(i, i)] * f.p[(j, j)]).sqrt().max(1e-300));
    let least = correlation.symmetric_eigenvalues().min();
    assert!(least > -1e-9, "{least}");
    let r = f.state().r_body_to_ned;
    assert!((r.transpose() * r - Matrix3::identity()).amax() < 1e-9);
}

#[test]
fn an_outlier_is_gated_and_changes_nothing() {
    let mut f = Eskf::new(silent(), state(), &certain([0.5; 5], Matrix4::identity()));
    let (before, p) = (*f.state(), f.p);
    let now = Lag::NONE;
    assert!(f.fuse_position(0, 50.0, 1.0, &now).is_err());
    assert!(f.fuse_position(0, f64::NAN, 1.0, &now).is_err());
    let flow = Vector2::new(500.0, 0.0);
    let (v, r) = (before.velocity_ned, before.r_body_to_ned);
    let seen = SeenFlow { v_xy: flow, distance_m: DISTANCE_M, covariance: Matrix2::identity() };
    assert!(f.fuse_flow(&seen, &v, &r, &now).is_err());
    assert!(f.fuse_airspeed(200.0, 1.0).is_err());
    assert!(f.fuse_airspeed(f64::NAN, 1.0).is_err());
    let mut far = before.r_body_to_ned.tr_mul(&Vector3::new(2e-5, 1e-6, 4.5e-5));
    far.z += 1e-4;
    assert!(f.fuse_magnetic(&far, &Vector3::new(2e-5, 1e-6, 4.5e-5), &Vector3::repeat(1e-6)).is_err());
    assert_eq!((*f.state(), f.p), (before, p));
}

#[test]
fn wind_and_airspeed_scale_are_found_in_turns() {
    let settings = EskfSettings {
        air: AirModel { wind_sigma: 8.0, airspeed_scale_sigma: 0.1, ..AirModel::default() },
        accel_noise: 0.01,
        ..silent()
    };
    let start = EskfState::moving(
        Matrix3::identity(),
        Vector3::zeros(),
        Vector3::new(20.0, 0.0, 0.0),
        Vector3::zeros(),
    );
    let mut f = Eskf::new(settings, start, &certain([0.0, 0.1, 0.1, 0.0, 0.0], Matrix4::zeros()));
    let (wind, scale, airspeed, rate) = (Vector2::new(4.0, -3.0), 0.04, 18.0, 0.1);
    for k in 0..6000 {
        // Flat turns through the air, at 100 Hz.
        let heading = rate * 0.01 * f64::from(k);
        let air = Vector3::new(heading.cos(), heading.sin(), 0.0) * airspeed;
        f.state.r_body_to_ned = exp(&Vector3::new(0.0, 0.0, heading));
        f.state.velocity_ned = air + Vector3::new(wind.x, wind.y, 0.0);
        let force = Vector3::new(0.0, airspeed * rate, -9.81);
        f.predict(0.01, &Vector3::new(0.0, 0.0, rate), &force, &GRAVITY, &Vector3::zeros());
        if k % 10 == 0 {
            let _ = f.fuse_airspeed(airspeed * (1.0 + scale), 0.5);
            let _ = f.fuse_sideslip(0.05);
        }
    }
    assert!((f.state().wind_ne - wind).norm() < 0.3, "{}", f.state().wind_ne);
    assert!((f.state().airspeed_scale - scale).abs() < 0.02, "{}", f.state().airspeed_scale);
}

#[test]
fn standing_still_shows_the_gyro_bias() {
    let at_rest = EskfState::moving(
        Matrix3::identity(),
        Vector3::zeros(),
        Vector3::new(0.3, -0.2, 0.1),
        Vector3::zeros(),
    );
    let mut f = Eskf::new(silent(), at_rest, &certain([0.01, 1.0, 0.5, 0.02, 0.0], Matrix4::zeros()));
    let bias = Vector3::new(0.01, -0.005, 0.002);
    for _ in 0..300 {
        f.predict(0.01, &bias, &Vector3::new(0.0, 0.0, -9.81), &GRAVITY, &Vector3::zeros());
        f.fuse_standstill(&bias, &Vector3::zeros(), 0.05, 0.005).unwrap();
    }
    assert!((f.state().gyro_bias - bias).amax() < 1e-3, "{}", f.state().gyro_bias);
    assert!(f.state().velocity_ned.norm() < 0.02);
}

#[test]
fn vectors_side_by_side_move_as_each_by_itself() {
    let r = exp(&Vector3::new(0.3, -0.2, 1.1));
    let mut transition = super::covariance::ErrorTransition::new(r);
    let (turn, rate) = (exp(&Vector3::new(0.002, -0.001, 0.004)), Vector3::new(0.2, -0.1, 0.4));
    for _ in 0..10 {
        transition.add(0.01, &turn, &r, &Vector3::new(0.4, -0.3, -9.7), &rate, 0.6);
    }
    let phi = transition.phi();
    let x: [[f32; 3]; STATES] =
        std::array::from_fn(|i| std::array::from_fn(|n| ((7 * i + 3 * n) % 11) as f32 - 5.0));
    let together = phi.times_side_by_side(&x);
    for n in 0..3 {
        let alone = phi.times(|i| f64::from(x[i][n]));
        for (i, alone) in alone.into_iter().enumerate() {
            assert!((f64::from(together[i][n]) - alone).abs() < 1e-4, "{n} {i}: {} {alone}", together[i][n]);
        }
    }
}
