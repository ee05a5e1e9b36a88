//! The exogenous Kalman filter where its noise is as it was told: errors as large as it says, about a trajectory that is wrong.

use crate::flight;
use holdover::geo::so3::{self, Euler};
use holdover::observer::{BiasMode, EulerState, SpecificForceForm, Xkf, XkfInput, XkfSettings};
use holdover::sim::models::{FlowModel, ImuModel};
use holdover::sim::{Reading, Scenario, SensorSuite, Simulation, Trajectory};
use nalgebra::{SVector, Vector3};
use proptest::prelude::*;
use rand::SeedableRng;
use rand_chacha::ChaCha8Rng;
use rand_distr::{Distribution, StandardNormal};

/// What Euler's steps and the second order of the linearisation do is not white; more noise stands for it, as in the navigator.
const NOISE_FACTOR: f64 = 3.0;
/// Standard deviations of the start: angles, position, velocity, gyro bias, accelerometer bias.
const START: [f64; 5] = [0.02, 1.0, 0.3, 2e-3, 0.03];

fn settings() -> XkfSettings {
    let imu = ImuModel::tactical();
    XkfSettings {
        gyro_noise: NOISE_FACTOR * imu.gyro_density,
        accel_noise: NOISE_FACTOR * imu.accel_density,
        gyro_bias_walk: 0.0,
        accel_bias_walk: 0.0,
        flow_bias_time_constant_s: 30.0,
        gate_sigma: f64::INFINITY,
        specific_force: SpecificForceForm::WithBias,
    }
}

/// An eight with all sensors; the errors of the filter at the end and what it says of them: ε = eᵀP⁻¹e over its 15 states.
struct Flown {
    filter: Xkf,
    nees: f64,
    error: SVector<f64, 15>,
}

/// Flies for `seconds`, without GNSS from `outage_s`. The trajectory that is linearised about is off as an observer's is (up to 0.3°,
/// 0.6° in yaw, 3 m), and has no biases.
fn fly(seed: u64, seconds: f64, outage_s: f64) -> Flown {
    let white = flight::white(ImuModel::tactical());
    let flow = white.flow.map(|f| FlowModel { bias_mps: Vector3::zeros(), ..f });
    let simulation =
        Simulation::new(Scenario::figure_eight().lasting(seconds), SensorSuite { flow, ..white }, seed);
    let (scenario, env) = (simulation.scenario().clone(), simulation.scenario().environment);
    let readings: Vec<Reading> = simulation.collect();
    let (gyro_bias, accel_bias) = (readings[0].imu.gyro_bias, readings[0].imu.accel_bias);
    let mut rng = ChaCha8Rng::seed_from_u64(seed ^ 0xA5A5);
    let truth_at = |t: f64| {
        let truth = scenario.at(t);
        EulerState {
            angles: Euler::from_rotation(&truth.r_body_to_ned),
            position_ned: truth.position_ned,
            velocity_ned: truth.velocity_ned,
            gyro_bias,
            accel_bias,
        }
    };
    let about_at = |t: f64| {
        let truth = truth_at(t);
        let wave = Vector3::new((0.3 * t).sin(), (0.2 * t).cos(), (0.11 * t).sin());
        let a = truth.angles;
        EulerState {
            angles: Euler::new(
                a.roll_rad + 0.005 * wave.x,
                a.pitch_rad + 0.005 * wave.y,
                a.yaw_rad + 0.01 * wave.z,
            ),
            position_ned: truth.position_ned + 3.0 * wave,
            velocity_ned: truth.velocity_ned + 0.3 * wave,
            gyro_bias: Vector3::zeros(),
            accel_bias: Vector3::zeros(),
        }
    };
    let mut normals = |sigma: f64| -> Vector3<f64> {
        Vector3::from_fn(|_, _| sigma * Distribution::<f64>::sample(&StandardNormal, &mut rng))
    };
    let mut start = truth_at(0.0);
    let off = START.map(&mut normals);
    start.angles = Euler::new(
        start.angles.roll_rad + off[0].x,
        start.angles.pitch_rad + off[0].y,
        start.angles.yaw_rad + off[0].z,
    );
    start.position_ned += off[1];
    start.velocity_ned += off[2];
    start.gyro_bias += off[3];
    start.accel_bias += off[4];
    let mut filter = Xkf::new(settings(), &start, &START.map(Vector3::repeat), Vector3::zeros());
    for r in &readings {
        let (t, imu) = (r.t_s, r.imu.measured);
        let input = XkfInput {
            dt_s: r.dt_s,
            angular_rate_body: imu.angular_rate,
            specific_force_body: imu.specific_force,
            gravity_ned: env.gravity_ned(),
            earth_rate_ned: env.earth_rate_ned,
        };
        let gnss = t < outage_s;
        let biases = if gnss { BiasMode::Estimated } else { BiasMode::Frozen };
        filter.predict(&about_at(t - r.dt_s), &input, biases).unwrap();
        let about = about_at(t);
        if let Some(fix) = r.gnss.filter(|_| gnss) {
            let (sigma_p, sigma_v) = white.gnss.map(|g| (g.position_m, g.velocity_mps)).unwrap();
            for axis in 0..3 {
                let e_p = fix.position_ned[axis] - filter.state().position_ned[axis];
                filter.fuse_position(axis, e_p, sigma_p[axis].powi(2)).unwrap();
                let e_v = fix.velocity_ned[axis] - filter.state().velocity_ned[axis];
                filter.fuse_velocity(axis, e_v, sigma_v[axis].powi(2)).unwrap();
            }
        }
        if let Some(barometer) = r.barometer {
            let e = -barometer.altitude_m - filter.state().position_ned.z;
            filter.fuse_position(2, e, white.barometer.unwrap().noise_m.powi(2)).unwrap();
        }
        if let Some(flow) = r.flow {
            let sigma = white.flow.unwrap().noise_mps;
            for axis in 0..3 {
                filter.fuse_flow(&about, axis, flow.velocity_body[axis], sigma[axis].powi(2)).unwrap();
            }
        }
    }
    let (x, truth) = (filter.state(), truth_at(readings[readings.len() - 1].t_s));
    let (a, b) = (x.angles, truth.angles);
    let blocks = [
        Vector3::new(a.roll_rad - b.roll_rad, a.pitch_rad - b.pitch_rad, a.yaw_rad - b.yaw_rad)
            .map(so3::wrap_pi),
        x.position_ned - truth.position_ned,
        x.velocity_ned - truth.velocity_ned,
        x.gyro_bias - truth.gyro_bias,
        x.accel_bias - truth.accel_bias,
    ];
    let error = SVector::<f64, 15>::from_iterator(blocks.iter().flat_map(|b| b.iter().copied()));
    let nees = filter.covariance().cholesky().map_or(f64::NAN, |c| error.dot(&c.solve(&error)));
    Flown { filter, nees, error }
}

#[test]
fn errors_are_as_large_as_the_filter_says() {
    const SEEDS: u64 = 24;
    let nees: Vec<f64> = (0..SEEDS).map(|seed| fly(seed, 60.0, f64::INFINITY).nees).collect();
    let mean = nees.iter().sum::<f64>() / SEEDS as f64;
    println!("mean NEES of 15 states: {mean:.2}");
    // 15 where it is exactly honest; below, it is cautious.
    assert!((5.0..20.0).contains(&mean), "{mean}: {nees:.1?}");
}

#[test]
fn biases_stay_where_they_were_in_dead_reckoning_and_the_uncertainty_grows() {
    let (with, without) = (fly(3, 59.99, f64::INFINITY), fly(3, 120.0, 59.995));
    assert_eq!(with.filter.state().gyro_bias, without.filter.state().gyro_bias);
    assert_eq!(with.filter.state().accel_bias, without.filter.state().accel_bias);
    let sigma = |f: &Flown| f.filter.position_covariance().fixed_view::<2, 2>(0, 0).trace().sqrt();
    assert!(sigma(&without) > 1.2 * sigma(&with), "{} {}", sigma(&with), sigma(&without));
    let drift = without.error.fixed_rows::<2>(3).norm();
    assert!(drift < 4.0 * sigma(&without) + 2.0 && drift > 0.0, "{drift}");
    // The altimeter goes on.
    assert!(without.error[5].abs() < 0.5);
    assert!(without.filter.attitude_covariance_ned().trace().sqrt() < 0.02);
}

#[test]
fn a_late_flow_in_two_steps_is_the_same_as_in_time() {
    let Flown { mut filter, .. } = fly(1, 20.0, f64::INFINITY);
    let mut other = filter.clone();
    let about = filter.state();
    let expected = about.r_body_to_ned().tr_mul(&about.velocity_ned);
    let innovation = nalgebra::Vector2::new(0.4, -0.3);
    filter.fuse_late_flow(&about, &innovation, &nalgebra::Vector2::repeat(0.25)).unwrap();
    for axis in 0..2 {
        other.fuse_flow(&about, axis, expected[axis] + innovation[axis], 0.25).unwrap();
    }
    assert!((filter.state().velocity_ned - other.state().velocity_ned).norm() < 1e-12);
    assert!((filter.covariance() - other.covariance()).norm() < 1e-12);
}

/// What a sensor may say: up to what the navigator lets pass, or nonsense.
fn sensed() -> impl Strategy<Value = f64> {
    prop_oneof![6 => -1e4..1e4f64, 2 => -0.1..1.0f64, 1 => Just(f64::NAN), 1 => Just(f64::INFINITY)]
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(200))]
    #[test]
    fn nothing_that_is_measured_breaks_it(
        values in proptest::collection::vec(sensed(), 12), gate in 1.0..20.0f64, kinds in proptest::collection::vec(0..5u8, 1..20)) {
        let Flown { filter, .. } = fly(2, 1.0, f64::INFINITY);
        let about = filter.state();
        let mut filter = Xkf::new(XkfSettings { gate_sigma: gate, ..settings() }, &about, &START.map(Vector3::repeat), Vector3::zeros());
        let v = |i: usize| Vector3::new(values[i], values[i + 1], values[i + 2]);
        for (i, kind) in kinds.iter().enumerate() {
            let (x, axis) = (values[i % 12], i % 3);
            match kind {
                0 => drop(filter.fuse_position(axis, x, 1.0)),
                1 => drop(filter.fuse_flow(&about, axis, x, 1.0)),
                2 => drop(filter.fuse_direction(&about, axis, x, &v(0), 1.0)),
                3 => filter.update_flow_bias(&v(3), 0.1),
                _ => {
                    let input = XkfInput { dt_s: values[11], angular_rate_body: v(0), specific_force_body: v(3), gravity_ned: v(6),
                        earth_rate_ned: Vector3::zeros() };
                    let _refused = filter.predict(&about, &input, BiasMode::Estimated);
                }
            }
        }
        prop_assert!(filter.is_finite(), "{:?} {}", filter.state(), filter.covariance());
        prop_assert!(filter.covariance().diagonal().min() >= 0.0);
    }
}
