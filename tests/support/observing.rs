//! An observer flown on closed-form truth. Shared by the tests of convergence and the `paper_observers` example.
#![allow(dead_code, reason = "the tests and the example each use their part")]
#![allow(
    clippy::unwrap_used,
    reason = "simulated sensors are finite and timely: anything else is a fault of the simulation"
)]

use super::flight::white;
use holdover::geo::so3;
use holdover::observer::attitude::MagneticPair;
use holdover::observer::*;
use holdover::sim::models::ImuModel;
use holdover::sim::{Scenario, SensorSuite, Simulation, Trajectory};
use holdover::time::Span;
use nalgebra::{Matrix3, Vector3};
use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;

/// What the first fix is off by: one standard deviation an axis, m and m/s.
const FIRST_FIX_M: Vector3<f64> = Vector3::new(1.5, -1.5, 2.5);
const FIRST_FIX_MPS: Vector3<f64> = Vector3::new(-0.1, 0.1, 0.15);

/// How a run goes.
#[derive(Clone, Copy)]
pub struct Run<'a> {
    /// How fixes are injected between them.
    pub scheme: Scheme,
    pub scenario: &'a Scenario,
    pub suite: SensorSuite,
    pub seed: u64,
    pub seconds: f64,
    /// No GNSS from this time on.
    pub outage_s: f64,
    pub with_gnss_velocity: bool,
    /// The flow bias is estimated from this time on: before, it would swallow the attitude error.
    pub flow_bias_from_s: f64,
    /// The parameters change from the first to the second here.
    pub staged_s: f64,
}

impl<'a> Run<'a> {
    pub fn new(scenario: &'a Scenario, suite: SensorSuite, seed: u64, seconds: f64) -> Self {
        Self {
            scheme: Scheme::InterSample,
            scenario,
            suite,
            seed,
            seconds,
            outage_s: f64::INFINITY,
            with_gnss_velocity: true,
            flow_bias_from_s: f64::INFINITY,
            staged_s: 0.0,
        }
    }
}

/// Errors at one IMU sample.
#[derive(Clone, Copy)]
pub struct Point {
    pub t: f64,
    /// Angle between estimate and truth, rad; π while the estimate is degenerate.
    pub angle: f64,
    /// Roll, pitch and yaw less the true ones, rad.
    pub euler: Vector3<f64>,
    pub position: Vector3<f64>,
    pub velocity: Vector3<f64>,
    /// |b̂ − b|, rad/s.
    pub bias: f64,
}

/// The first time after which the attitude error stays below a bound.
pub fn settled(points: &[Point], bound_deg: f64) -> f64 {
    points.iter().rev().find(|p| p.angle > bound_deg.to_radians()).map_or(0.0, |p| p.t)
}

pub fn rms(points: &[Point], from_s: f64, of: impl Fn(&Point) -> f64) -> f64 {
    let values: Vec<f64> = points.iter().filter(|p| p.t >= from_s).map(|p| of(p).powi(2)).collect();
    (values.iter().sum::<f64>() / values.len() as f64).sqrt()
}

#[derive(Clone, Copy)]
pub enum Observer {
    Grip(GripParams),
    /// Parameters, whether the magnetometer replaces the flow velocity in dead reckoning, and the factor on K_P there.
    Fusini(FusiniParams, bool, f64),
}

pub fn run(what: &Run, start: &Observer, then: &Observer, r_start: Matrix3<f64>) -> Vec<Point> {
    let simulation = Simulation::new(what.scenario.clone().lasting(what.seconds), what.suite, what.seed);
    let env = what.scenario.environment;
    let truth = what.scenario.at(0.0);
    let (p0, v0) = (truth.position_ned + FIRST_FIX_M, truth.velocity_ned + FIRST_FIX_MPS);
    let mut state = ObserverState::new(r_start, p0, v0);
    let mut biases = FusiniBiases::default();
    let mut w =
        Predictor::new(what.scheme, Span::from_millis(800), Span::from_millis(1000), env.earth_rate_ned);
    w.reset(Simulation::ap_time(0.0), &p0, &v0);
    let mut flow = None;
    let mut altitude = None;
    let mut points = Vec::new();
    for reading in simulation {
        let (t, dt, imu, truth) = (reading.t_s, reading.dt_s, reading.imu.measured, reading.truth);
        let field_body = reading.field_body.unwrap();
        let magnetic = MagneticPair { field_body, field_ned: env.magnetic_ned };
        let gnss = t < what.outage_s;
        let observer = if t < what.staged_s { start } else { then };
        let report = match observer {
            Observer::Grip(params) => {
                let (e_p, e_v) = w
                    .signal()
                    .map_or_else(Default::default, |s| s.errors(&state.position_ned, &state.velocity_ned));
                let input = GripInput {
                    dt_s: dt,
                    angular_rate_body: imu.angular_rate,
                    specific_force_body: imu.specific_force,
                    gravity_ned: env.gravity_ned(),
                    earth_rate_ned: env.earth_rate_ned,
                    magnetic: Some(magnetic),
                    position_error_ned: e_p,
                    velocity_error_ned: e_v,
                };
                grip::step(params, &mut state, &input).unwrap()
            }
            Observer::Fusini(params, use_magnetic, k_p_factor) => {
                let input = FusiniInput {
                    dt_s: dt,
                    angular_rate_body: imu.angular_rate,
                    specific_force_body: imu.specific_force,
                    gravity_ned: env.gravity_ned(),
                    earth_rate_ned: env.earth_rate_ned,
                    flow_velocity_body: flow,
                    aiding: if gnss {
                        Aiding::Gnss(w.signal())
                    } else {
                        Aiding::DeadReckoning { altitude_down_m: altitude }
                    },
                    reference: if *use_magnetic {
                        AttitudeReference::Magnetic(magnetic)
                    } else {
                        AttitudeReference::FlowVelocity
                    },
                    k_p_override: (!gnss).then_some(params.k_p * *k_p_factor),
                };
                fusini::step(params, &mut state, &mut biases, &input).unwrap()
            }
        };
        w.propagate(reading.time, &report.acceleration_ned, &state.velocity_ned);
        if let Some(fix) = reading.gnss.filter(|_| gnss) {
            let position = FixSample::position(Simulation::ap_time(fix.measured_s), &fix.position_ned);
            let fix =
                if what.with_gnss_velocity { position.with_velocity(&fix.velocity_ned) } else { position };
            let e = w.innovation(&fix).unwrap();
            w.apply(&e);
        }
        altitude = reading.barometer.map(|b| -b.altitude_m).or(altitude);
        if let Some(seen) = reading.flow {
            let v_m = seen.velocity_body;
            flow = Some(v_m);
            if let (Observer::Fusini(params, ..), true, false, Some(now)) =
                (observer, gnss && t >= what.flow_bias_from_s, report.gated, w.latest())
            {
                fusini::update_flow_bias(params, &state, &mut biases, &v_m, &now.velocity_ned, 0.1);
            }
        }
        let r = state.r_body_to_ned();
        points.push(Point {
            t,
            angle: r.map_or(std::f64::consts::PI, |r| so3::angle_between(&r, &truth.r_body_to_ned)),
            euler: r.map_or(Vector3::repeat(3.0), |r| euler_error(&r, &truth.r_body_to_ned)),
            position: state.position_ned - truth.position_ned,
            velocity: state.velocity_ned - truth.velocity_ned,
            bias: (state.gyro_bias - reading.imu.gyro_bias).norm(),
        });
    }
    points
}

fn euler_error(r: &Matrix3<f64>, truth: &Matrix3<f64>) -> Vector3<f64> {
    let [a, b] = [r, truth].map(so3::Euler::from_rotation);
    Vector3::new(a.roll_rad - b.roll_rad, a.pitch_rad - b.pitch_rad, a.yaw_rad - b.yaw_rad).map(so3::wrap_pi)
}

/// A start that is wrong by `angle` about a random axis.
pub fn wrong_by(truth: &Matrix3<f64>, angle_deg: f64, seed: u64) -> Matrix3<f64> {
    let mut rng = ChaCha8Rng::seed_from_u64(seed);
    let axis = loop {
        let v = Vector3::new(
            rng.random_range(-1.0..1.0),
            rng.random_range(-1.0..1.0),
            rng.random_range(-1.0..1.0f64),
        );
        if (0.1..1.0).contains(&v.norm()) {
            break v.normalize();
        }
    };
    truth * so3::exp(&(axis * angle_deg.to_radians()))
}

/// Steady state is from here on, s.
pub const STEADY_S: f64 = 120.0;
/// The yaw of the start is wrong by this, rad.
pub const YAW_ERROR: f64 = 160.0 * std::f64::consts::PI / 180.0;
/// The bias has converged when its error stays below this, °/s.
pub const BIAS_BOUND_DPS: f64 = 0.1;
/// Fast start-up parameters are in force for this long, s.
pub const FAST_S: f64 = 30.0;

/// The flight of Grip, Section V.
pub fn cessna(scenario: &Scenario, seed: u64) -> Run<'_> {
    Run::new(scenario, paper_suite(), seed, scenario.duration_s)
}

/// Its start: the true attitude turned about the vertical.
pub fn wrong_yaw(scenario: &Scenario) -> Matrix3<f64> {
    so3::exp(&Vector3::new(0.0, 0.0, YAW_ERROR)) * scenario.at(0.0).r_body_to_ned
}

/// The paper's noise: no accelerometer bias, no hard iron.
pub fn paper_suite() -> SensorSuite {
    // 1.41 °/s long.
    let gyro_bias = Vector3::new(1.0, 0.6, 0.8).map(f64::to_radians);
    white(ImuModel { gyro_bias, accel_bias: Vector3::zeros(), ..ImuModel::tactical() })
}

/// Roll, pitch, yaw (°), position (m), velocity (m/s), and when the bias has converged (s; infinite when it has not).
pub fn measure(points: &[Point]) -> [f64; 6] {
    let euler = |i: usize| rms(points, STEADY_S, |p| p.euler[i]).to_degrees();
    let bound = BIAS_BOUND_DPS.to_radians();
    let last_out = points.iter().rposition(|p| p.bias > bound);
    let converged = match last_out {
        None => 0.0,
        Some(i) => points.get(i + 1).map_or(f64::INFINITY, |p| p.t),
    };
    [
        euler(0),
        euler(1),
        euler(2),
        rms(points, STEADY_S, |p| p.position.norm()),
        rms(points, STEADY_S, |p| p.velocity.norm()),
        converged,
    ]
}
