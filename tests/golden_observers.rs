//! The observers and the projection against independently computed trajectories: every field of every step to 1e-9.

#![allow(clippy::unwrap_used, clippy::panic)] // a test may fail

use holdover::observer::attitude::{Discretisation, MagneticPair};
use holdover::observer::bias::BiasBounds;
use holdover::observer::fusini::FlowBiasForm;
use holdover::observer::*;
use holdover::time::{ApTime, Span};
use nalgebra::{Matrix3, Vector3};
use serde_json::Value;

const TOLERANCE: f64 = 1e-9;

fn load(name: &str) -> Value {
    let path = format!("{}/tests/golden/observers/{name}.json", env!("CARGO_MANIFEST_DIR"));
    serde_json::from_str(&std::fs::read_to_string(path).unwrap()).unwrap()
}

fn number(v: &Value) -> f64 {
    v.as_f64().unwrap()
}

fn numbers(v: &Value) -> Vec<f64> {
    match v {
        Value::Array(a) => a.iter().flat_map(numbers).collect(),
        other => vec![number(other)],
    }
}

fn vector(v: &Value) -> Vector3<f64> {
    Vector3::from_column_slice(&numbers(v))
}

fn matrix(v: &Value) -> Matrix3<f64> {
    Matrix3::from_row_slice(&numbers(v))
}

fn gains(v: &Value) -> TranslationGains {
    let k = numbers(v);
    TranslationGains { pp: k[0], pv: k[1], vp: k[2], vv: k[3], xp: k[4], xv: k[5] }
}

fn discretisation(params: &Value) -> Discretisation {
    match params["disc"].as_str().unwrap() {
        "EXP" => Discretisation::Exponential,
        "EULER" => Discretisation::Euler,
        other => panic!("{other}"),
    }
}

fn scheme(params: &Value) -> Scheme {
    match params["scheme"].as_str().unwrap() {
        "ISP" => Scheme::InterSample,
        "ZOH" => Scheme::Hold,
        other => panic!("{other}"),
    }
}

/// Samples by index of the IMU sample they are stamped with.
fn at_index(inputs: &Value, index: &str, k: usize) -> Option<usize> {
    inputs[index].as_array().unwrap().iter().position(|i| number(i) as usize == k)
}

fn stamp(k: usize) -> ApTime {
    ApTime::from_micros(10_000 * k as i64)
}

fn predictor(params: &Value, earth_rate_ned: Vector3<f64>) -> Predictor {
    Predictor::new(scheme(params), Span::from_millis(1000), Span::from_millis(1000), earth_rate_ned)
}

/// A fix as the golden files mean it: it is stamped with the sample just processed.
fn take_fix(w: &mut Predictor, fix: &FixSample, start: (Vector3<f64>, Vector3<f64>)) {
    if !w.is_running() {
        w.reset(fix.stamp, &start.0, &start.1);
    }
    let e = w.innovation(fix).unwrap();
    w.apply(&e);
}

#[track_caller]
fn close(name: &str, k: usize, field: &str, got: &[f64], want: &Value) {
    let want = numbers(want);
    assert_eq!(got.len(), want.len());
    for (g, w) in got.iter().zip(&want) {
        let d = (g - w).abs();
        assert!(d <= TOLERANCE * w.abs().max(1.0), "{name}: step {k}, {field}: {got:?} instead of {want:?}");
    }
}

fn row_major(m: &Matrix3<f64>) -> Vec<f64> {
    m.transpose().as_slice().to_vec()
}

fn grip(name: &str) {
    let file = load(name);
    let (p, inputs, init, expected) = (&file["params"], &file["inputs"], &file["init"], &file["expected"]);
    assert_eq!(p["triad"], "NORM");
    let params = GripParams {
        k_p: vector(&p["KP"]),
        sigma: number(&p["sigma"]),
        k_i: number(&p["kI"]),
        bias_bounds: BiasBounds { bound_radps: number(&p["Mb"]), limit_radps: number(&p["Mbh"]) },
        gains: gains(&p["K"]),
        discretisation: discretisation(p),
        min_magnetic_sine: 0.0,
        gate: None,
    };
    let use_velocity = p["use_vel"].as_bool().unwrap();
    let mut state = ObserverState {
        r_hat: matrix(&init["R"]),
        gyro_bias: vector(&init["b"]),
        position_ned: vector(&init["p"]),
        velocity_ned: vector(&init["v"]),
        xi_ned: vector(&init["xi"]),
    };
    let mut w = predictor(p, Vector3::zeros());
    let n = inputs["t"].as_array().unwrap().len();
    for k in 0..n {
        if k > 0 {
            let signal = w.signal();
            let (position_error_ned, velocity_error_ned) = signal
                .map_or((Vector3::zeros(), Vector3::zeros()), |s| {
                    s.errors(&state.position_ned, &state.velocity_ned)
                });
            let input = GripInput {
                dt_s: number(&inputs["t"][k]) - number(&inputs["t"][k - 1]),
                angular_rate_body: vector(&inputs["gyro"][k]),
                specific_force_body: vector(&inputs["acc"][k]),
                gravity_ned: Vector3::new(0.0, 0.0, number(&inputs["g"])),
                earth_rate_ned: Vector3::zeros(),
                magnetic: Some(MagneticPair {
                    field_body: vector(&inputs["mag"][k]),
                    field_ned: vector(&inputs["mag_ned"]),
                }),
                position_error_ned,
                velocity_error_ned,
            };
            let report = holdover::observer::grip::step(&params, &mut state, &input).unwrap();
            w.propagate(stamp(k), &report.acceleration_ned, &state.velocity_ned);
        }
        if let Some(i) = at_index(inputs, "gnss_idx", k) {
            let (zp, zv) = (vector(&inputs["gnss_pos"][i]), vector(&inputs["gnss_vel"][i]));
            let mut fix = FixSample::position(stamp(k), &zp);
            if use_velocity {
                fix = fix.with_velocity(&zv);
            }
            take_fix(&mut w, &fix, (zp, zv));
        }
        close(name, k, "R", &row_major(&state.r_hat), &expected["R"][k]);
        close(name, k, "b", state.gyro_bias.as_slice(), &expected["b"][k]);
        close(name, k, "p", state.position_ned.as_slice(), &expected["p"][k]);
        close(name, k, "v", state.velocity_ned.as_slice(), &expected["v"][k]);
        close(name, k, "xi", state.xi_ned.as_slice(), &expected["xi"][k]);
    }
}

fn fusini(name: &str) {
    let file = load(name);
    let (p, inputs, init, expected) = (&file["params"], &file["inputs"], &file["init"], &file["expected"]);
    let kd = numbers(&p["Kd_pp_vp_vv_xp_xv"]);
    let params = FusiniParams {
        k_p: vector(&p["KP"]),
        sigma: 1.0,
        k_i: number(&p["kI"]),
        bias_bounds: BiasBounds { bound_radps: number(&p["Lb"]), limit_radps: number(&p["Lbh"]) },
        gains: gains(&p["K"]),
        dead_reckoning: DeadReckoningGains { pp: kd[0], vp: kd[1], vv: kd[2], xp: kd[3], xv: kd[4] },
        k_f: number(&p["Kf"]),
        discretisation: discretisation(p),
        sub_steps: number(&p["nsub"]) as u32,
        flow_bias: if number(&p["bvmode"]) == 1.0 { FlowBiasForm::Body } else { FlowBiasForm::AsPrinted },
        flow_bias_time_constant_s: number(&p["tau_bv"]),
        predict_flow_z: number(&p["zmode"]) == 1.0,
        guard: 5.0,
        min_magnetic_sine: 0.0,
        gate: None,
    };
    let k_dr = number(&p["k_dr"]) as usize;
    let mut state = ObserverState {
        r_hat: matrix(&init["R"]),
        gyro_bias: vector(&init["bw"]),
        position_ned: vector(&init["p"]),
        velocity_ned: vector(&init["v"]),
        xi_ned: vector(&init["xi"]),
    };
    let mut biases = FusiniBiases {
        accelerometer: vector(&init["bf"]),
        flow_velocity: vector(&init["bv"]),
        flow_velocity_printed_ned: None,
    };
    let mut w = predictor(p, vector(&inputs["omega_e_ned"]));
    let mut flow = None;
    let mut altitude = None;
    let n = inputs["t"].as_array().unwrap().len();
    for k in 0..n {
        if params.flow_bias == FlowBiasForm::AsPrinted && number(&inputs["t"][k]) >= number(&p["t_bv"]) {
            // The reference starts its low-pass from zero then.
            biases.flow_velocity_printed_ned.get_or_insert_with(Vector3::zeros);
        }
        if k > 0 {
            let input = FusiniInput {
                dt_s: number(&inputs["t"][k]) - number(&inputs["t"][k - 1]),
                angular_rate_body: vector(&inputs["gyro"][k]),
                specific_force_body: vector(&inputs["acc"][k]),
                gravity_ned: Vector3::new(0.0, 0.0, number(&inputs["g"])),
                earth_rate_ned: vector(&inputs["omega_e_ned"]),
                flow_velocity_body: flow,
                aiding: if k > k_dr {
                    Aiding::DeadReckoning { altitude_down_m: altitude }
                } else {
                    Aiding::Gnss(w.signal())
                },
                reference: AttitudeReference::FlowVelocity,
                k_p_override: None,
            };
            let report = holdover::observer::fusini::step(&params, &mut state, &mut biases, &input).unwrap();
            w.propagate(stamp(k), &report.acceleration_ned, &state.velocity_ned);
        }
        if let Some(i) = at_index(inputs, "gnss_idx", k).filter(|_| k < k_dr) {
            let (zp, zv) = (vector(&inputs["gnss_pos"][i]), vector(&inputs["gnss_vel"][i]));
            let fix = FixSample::position(stamp(k), &zp).with_velocity(&zv);
            take_fix(&mut w, &fix, (zp, zv));
        }
        if let Some(i) = at_index(inputs, "flow_idx", k) {
            let v_m = vector(&inputs["flow_vb"][i]);
            flow = Some(v_m);
            altitude = Some(number(&inputs["alt_D"][i]));
            let runs = k < k_dr && number(&inputs["t"][k]) >= number(&p["t_bv"]);
            if let Some(now) = w.latest().filter(|_| runs) {
                let v = now.velocity_ned;
                holdover::observer::fusini::update_flow_bias(&params, &state, &mut biases, &v_m, &v, 0.1);
            }
        }
        close(name, k, "R", &row_major(&state.r_hat), &expected["R"][k]);
        let got: Vec<f64> = [
            state.position_ned,
            state.velocity_ned,
            state.xi_ned,
            state.gyro_bias,
            biases.accelerometer,
            biases.flow_velocity,
        ]
        .iter()
        .flat_map(|v| v.iter().copied())
        .collect();
        close(name, k, "p v xi bw bf bv", &got, &expected["p_v_xi_bw_bf_bv"][k]);
    }
}

#[test]
fn projection_matches() {
    let file = load("projection");
    let p = &file["params"];
    let bounds = BiasBounds { bound_radps: number(&p["Mb"]), limit_radps: number(&p["Mbh"]) };
    for (k, case) in file["cases"].as_array().unwrap().iter().enumerate() {
        let out = bounds.project(&vector(&case["b"]), &vector(&case["tau"]));
        for i in 0..3 {
            assert!((out[i] - number(&case["out"][i])).abs() < 1e-15, "case {k}: {out}");
        }
    }
}

#[test]
fn grip_with_predictor_matches() {
    grip("grip_A_exp_isp_norm");
}

#[test]
fn grip_as_printed_matches() {
    grip("grip_B_euler_zoh_norm_printed");
}

#[test]
fn grip_with_position_only_matches() {
    grip("grip_D_exp_isp_norm_posonly");
}

#[test]
fn grip_with_projection_and_reset_matches() {
    grip("grip_E_projection_reset");
}

#[test]
fn fusini_with_gnss_as_printed_matches() {
    fusini("fusini_gnss_A_printed_euler_zoh_nsub3");
}

#[test]
fn fusini_with_gnss_and_predictor_matches() {
    fusini("fusini_gnss_B_exp_isp");
}

#[test]
fn fusini_in_dead_reckoning_as_printed_matches() {
    fusini("fusini_dr_A_printed_euler_zoh_nsub3");
}

#[test]
fn fusini_in_dead_reckoning_with_predictor_matches() {
    fusini("fusini_dr_B_exp_isp_zpred");
}

#[test]
fn a_single_patch_of_flow_matches() {
    let file = load("flow");
    for case in file["optical_flow_rad"].as_array().unwrap() {
        let pair = |x: &str, y: &str| nalgebra::Vector2::new(number(&case[x]), number(&case[y]));
        let v = holdover::camera::single_patch::patch_velocity(
            &pair("ix", "iy"),
            &pair("gx", "gy"),
            number(&case["dt"]),
            number(&case["dist"]),
        );
        let want = numbers(&case["vxy"]);
        assert!((v.x - want[0]).abs() < 1e-9 && (v.y - want[1]).abs() < 1e-9, "{v} {want:?}");
    }
}
