//! The exogenous Kalman filter over a recorded flight and the trajectory that an observer had on it.

use std::path::Path;

use holdover::geo::so3::{Euler, wrap_pi};
use holdover::observer::{
    BiasMode, EulerState, FusiniBiases, ObserverState, SpecificForceForm, Xkf, XkfInput, XkfSettings,
};
use nalgebra::{Matrix3, Vector3};
use serde_json::Value;

use super::flight::Flight;
use super::fusini;
use super::outcome::Outcome;
use super::values::{Result, array, at, number, number_or, rows};

/// A point of the observer's trajectory and its flow velocity bias.
type Point = (EulerState, Vector3<f64>);

/// The observer's trajectory: the `expected` of the file that is named, which stands next to this one; or, where that is of another flight,
/// what its observer has on this one from `start` on.
fn trajectory(file: &Value, folder: &Path, flight: &Flight, start: &[f64; 18]) -> Result<Vec<Point>> {
    let name = at(file, "nlo_trajectory_file")?.as_str().ok_or("\"nlo_trajectory_file\" is no text")?;
    let path = folder.join(name);
    let other = super::read(&path).map_err(|e| format!("its trajectory, {}: {e}", path.display()))?;
    let part = |x: &[f64; 18], i: usize| Vector3::new(x[i], x[i + 1], x[i + 2]);
    let flown = if at(&other, "inputs")? == at(file, "inputs")? {
        let expected = at(&other, "expected")?;
        let (r, x) = (rows::<9>(expected, "R")?, rows::<18>(expected, "p_v_xi_bw_bf_bv")?);
        let points = r.iter().zip(&x).map(|(r, x)| {
            let state = ObserverState {
                r_hat: Matrix3::from_row_slice(r),
                gyro_bias: part(x, 9),
                position_ned: part(x, 0),
                velocity_ned: part(x, 3),
                xi_ned: part(x, 6),
            };
            (state, part(x, 12), part(x, 15))
        });
        points.collect()
    } else {
        let [roll, pitch, yaw] = [start[0], start[1], start[2]];
        let r = Euler::new(roll, pitch, yaw).to_rotation();
        let state = ObserverState {
            gyro_bias: part(start, 9),
            ..ObserverState::new(r, part(start, 3), part(start, 6))
        };
        let biases = FusiniBiases {
            accelerometer: part(start, 12),
            flow_velocity: part(start, 15),
            flow_velocity_printed_ned: None,
        };
        let flown = fusini::fly(at(&other, "params")?, flight, (state, biases))?;
        flown.into_iter().map(|(s, b)| (s, b.accelerometer, b.flow_velocity)).collect::<Vec<_>>()
    };
    let point = |(state, accel_bias, flow_bias): (ObserverState, Vector3<f64>, Vector3<f64>)| {
        let about =
            EulerState::of_observer(&state, accel_bias).ok_or("the trajectory has no Euler angles")?;
        Ok((about, flow_bias))
    };
    flown.into_iter().map(point).collect()
}

pub fn run(file: &Value, folder: &Path) -> Result<Outcome> {
    let (p, inputs, expected) = (at(file, "params")?, at(file, "inputs")?, at(file, "expected")?);
    let flight = Flight::read(inputs)?;
    let want = rows::<18>(expected, "Theta_p_v_bw_bf_bv")?;
    let start = want.first().ok_or("no expected values")?;
    let trajectory = trajectory(file, folder, &flight, start)?;
    let want_p = rows::<3>(expected, "P_diag_Theta")?;
    let n = flight.t.len();
    if [trajectory.len(), want.len(), want_p.len()].iter().any(|&m| m != n) || n == 0 {
        return Err("inputs, trajectory and expected values differ in length".into());
    }
    let [gyro, accel, gyro_bias, accel_bias] = array::<4>(p, "q_gyro_acc_bw_bf")?.map(f64::sqrt);
    let force = match number_or(p, "use_y3", 0.0)? {
        0.0 => None,
        1.0 => Some(SpecificForceForm::Approximate),
        2.0 => Some(SpecificForceForm::WithBias),
        3.0 => Some(SpecificForceForm::AsPrinted),
        other => return Err(format!("\"use_y3\" is {other}, not 0, 1, 2 or 3")),
    };
    let settings = XkfSettings {
        gyro_noise: gyro,
        accel_noise: accel,
        gyro_bias_walk: gyro_bias,
        accel_bias_walk: accel_bias,
        flow_bias_time_constant_s: number(p, "tau_bv")?,
        gate_sigma: f64::INFINITY,
        specific_force: force.unwrap_or(SpecificForceForm::WithBias),
    };
    let p0 = array::<15>(p, "P0")?.map(f64::sqrt);
    let sigma = std::array::from_fn(|b| Vector3::from_fn(|i, _| p0[3 * b + i]));
    let (r_position, r_velocity) = (array::<3>(p, "r_gnss_pos")?, array::<3>(p, "r_gnss_vel")?);
    let (r_alt, r_flow, r_y3) = (number(p, "r_alt")?, array::<3>(p, "r_flow")?, number_or(p, "r_y3", 1.0)?);
    let freezes = number_or(p, "freeze_biases", 1.0)? != 0.0;
    let k_dr = number(p, "k_dr")?;

    let mut filter = Xkf::new(settings, &trajectory[0].0, &sigma, trajectory[0].1);
    let mut outcome = Outcome::new("xkf", file);
    for k in 0..n {
        let gnss = (k as f64) < k_dr;
        let input = |dt_s| XkfInput {
            dt_s,
            angular_rate_body: flight.gyro[k],
            specific_force_body: flight.acc[k],
            gravity_ned: flight.gravity_ned,
            earth_rate_ned: flight.earth_rate_ned,
        };
        if k > 0 {
            let frozen = freezes && k as f64 > k_dr;
            let biases = if frozen { BiasMode::Frozen } else { BiasMode::Estimated };
            filter
                .predict(&trajectory[k - 1].0, &input(flight.dt(k)), biases)
                .map_err(|e| format!("step {k}: {e}"))?;
        }
        let about = &trajectory[k].0;
        let gated = |axis: usize| {
            move |g: holdover::filter::error_state::Gated| format!("step {k}, axis {axis}: {g:?}")
        };
        if let Some((zp, zv)) = flight.fix(k).filter(|_| gnss) {
            for axis in 0..3 {
                let e_p = zp[axis] - filter.state().position_ned[axis];
                filter.fuse_position(axis, e_p, r_position[axis]).map_err(gated(axis))?;
                let e_v = zv[axis] - filter.state().velocity_ned[axis];
                filter.fuse_velocity(axis, e_v, r_velocity[axis]).map_err(gated(axis))?;
            }
        }
        let frame = flight.frame(k);
        if let Some((v_m, down, _)) = frame {
            filter.fuse_position(2, down - filter.state().position_ned.z, r_alt).map_err(gated(2))?;
            for axis in 0..3 {
                filter.fuse_flow(about, axis, v_m[axis], r_flow[axis]).map_err(gated(axis))?;
            }
        }
        if force.is_some() && frame.is_some() && k > 0 {
            for axis in 0..3 {
                filter.fuse_specific_force(about, &input(flight.dt(k)), axis, r_y3).map_err(gated(axis))?;
            }
        }
        if let Some((v_m, _, Some(interval))) = frame.filter(|_| gnss) {
            filter.update_flow_bias(&v_m, interval);
        }
        compare(&mut outcome, k, &filter, &want[k], &want_p[k]);
    }
    Ok(outcome)
}

fn compare(outcome: &mut Outcome, k: usize, filter: &Xkf, want: &[f64; 18], want_p: &[f64; 3]) {
    let s = filter.state();
    let angles = [s.angles.roll_rad, s.angles.pitch_rad, s.angles.yaw_rad];
    // An angle is the same a turn further.
    let angles: [f64; 3] = std::array::from_fn(|i| want[i] + wrap_pi(angles[i] - want[i]));
    outcome.compare("Theta", k, &angles, &want[..3]);
    let rest = [s.position_ned, s.velocity_ned, s.gyro_bias, s.accel_bias, filter.flow_bias()];
    let rest: Vec<f64> = rest.iter().flat_map(|v| v.iter().copied()).collect();
    outcome.compare("p v bw bf bv", k, &rest, &want[3..]);
    let variances: [f64; 3] = std::array::from_fn(|i| filter.covariance()[(i, i)]);
    outcome.compare("P_diag_Theta", k, &variances, want_p);
}
