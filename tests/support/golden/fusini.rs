//! Fusini's observer over a recorded flight, with GNSS and in dead reckoning.

use holdover::observer::bias::BiasBounds;
use holdover::observer::fusini::{FlowBiasForm, step, update_flow_bias};
use holdover::observer::{
    Aiding, AttitudeReference, DeadReckoningGains, FixSample, FusiniBiases, FusiniInput, FusiniParams,
    ObserverState, Scheme,
};
use serde_json::Value;

use super::flight::{Flight, discretisation, gains, predictor, take_fix};
use super::outcome::Outcome;
use super::values::{Result, array, at, choice, matrix, number, number_or, row_major, rows, vector};

fn params(p: &Value) -> Result<FusiniParams> {
    let [pp, vp, vv, xp, xv] = array(p, "Kd_pp_vp_vv_xp_xv")?;
    Ok(FusiniParams {
        k_p: vector(p, "KP")?,
        sigma: number_or(p, "sigma", 1.0)?,
        k_i: number(p, "kI")?,
        bias_bounds: BiasBounds { bound_radps: number(p, "Lb")?, limit_radps: number(p, "Lbh")? },
        gains: gains(p)?,
        dead_reckoning: DeadReckoningGains { pp, vp, vv, xp, xv },
        k_f: number(p, "Kf")?,
        discretisation: discretisation(p)?,
        sub_steps: number_or(p, "nsub", 1.0)? as u32,
        flow_bias: if number(p, "bvmode")? == 2.0 { FlowBiasForm::AsPrinted } else { FlowBiasForm::Body },
        flow_bias_time_constant_s: number(p, "tau_bv")?,
        predict_flow_z: number_or(p, "zmode", 0.0)? == 1.0,
        guard: number_or(p, "guard", 5.0)?,
        min_magnetic_sine: 0.0,
        gate: None,
    })
}

/// Where an observer starts.
pub fn start(init: &Value) -> Result<(ObserverState, FusiniBiases)> {
    let state = ObserverState {
        r_hat: matrix(init, "R")?,
        gyro_bias: vector(init, "bw")?,
        position_ned: vector(init, "p")?,
        velocity_ned: vector(init, "v")?,
        xi_ned: vector(init, "xi")?,
    };
    let biases = FusiniBiases {
        accelerometer: vector(init, "bf")?,
        flow_velocity: vector(init, "bv")?,
        flow_velocity_printed_ned: None,
    };
    Ok((state, biases))
}

/// The observer with the parameters `p` of a file over a flight: its state at every sample.
pub fn fly(
    p: &Value,
    flight: &Flight,
    (mut state, mut biases): (ObserverState, FusiniBiases),
) -> Result<Vec<(ObserverState, FusiniBiases)>> {
    let params = params(p)?;
    let scheme = choice(p, "scheme", &[("ZOH", 0.0, Scheme::Hold), ("ISP", 1.0, Scheme::InterSample)])?;
    let finds_flow_bias = number(p, "bvmode")? != 0.0;
    let (k_dr, t_bv) = (number(p, "k_dr")?, number_or(p, "t_bv", 0.0)?);
    let mut w = predictor(scheme, flight.earth_rate_ned);
    let (mut flow, mut altitude) = (None, None);
    let mut flown = Vec::with_capacity(flight.t.len());
    for k in 0..flight.t.len() {
        let gnss = (k as f64) < k_dr;
        let calibrates = finds_flow_bias && flight.t[k] >= t_bv;
        if calibrates && params.flow_bias == FlowBiasForm::AsPrinted {
            // The printed low-pass starts from zero, and b_v with it.
            biases.flow_velocity_printed_ned.get_or_insert_default();
        }
        if k > 0 {
            let input = FusiniInput {
                dt_s: flight.dt(k),
                angular_rate_body: flight.gyro[k],
                specific_force_body: flight.acc[k],
                gravity_ned: flight.gravity_ned,
                earth_rate_ned: flight.earth_rate_ned,
                flow_velocity_body: flow,
                aiding: if k as f64 > k_dr {
                    Aiding::DeadReckoning { altitude_down_m: altitude }
                } else {
                    Aiding::Gnss(w.signal())
                },
                reference: AttitudeReference::FlowVelocity,
                k_p_override: None,
            };
            let report =
                step(&params, &mut state, &mut biases, &input).map_err(|e| format!("step {k}: {e}"))?;
            if let Some(signal) = &report.signal {
                w.follow(flight.stamp(k), signal, &state.velocity_ned);
            } else {
                w.propagate(flight.stamp(k), &report.acceleration_ned, &state.velocity_ned);
            }
        }
        if let Some((zp, zv)) = flight.fix(k).filter(|_| gnss) {
            let fix = FixSample::position(flight.stamp(k), &zp).with_velocity(&zv);
            take_fix(&mut w, &fix, (zp, zv))?;
        }
        if let Some((v_m, down, interval)) = flight.frame(k) {
            (flow, altitude) = (Some(v_m), Some(down));
            if let (true, Some(now), Some(dt)) = (calibrates && gnss, w.latest(), interval) {
                update_flow_bias(&params, &state, &mut biases, &v_m, &now.velocity_ned, dt);
            }
        }
        flown.push((state, biases));
    }
    Ok(flown)
}

pub fn run(file: &Value) -> Result<Outcome> {
    let (p, inputs, expected) = (at(file, "params")?, at(file, "inputs")?, at(file, "expected")?);
    let flight = Flight::read(inputs)?;
    let (want_r, want) = (rows::<9>(expected, "R")?, rows::<18>(expected, "p_v_xi_bw_bf_bv")?);
    let n = flight.t.len();
    if want_r.len() != n || want.len() != n {
        return Err("inputs and expected values differ in length".into());
    }
    let mut outcome = Outcome::new("fusini", file);
    for (k, (state, biases)) in fly(p, &flight, start(at(file, "init")?)?)?.iter().enumerate() {
        outcome.compare("R", k, &row_major(&state.r_hat), &want_r[k]);
        let got = [
            state.position_ned,
            state.velocity_ned,
            state.xi_ned,
            state.gyro_bias,
            biases.accelerometer,
            biases.flow_velocity,
        ];
        let got: Vec<f64> = got.iter().flat_map(|v| v.iter().copied()).collect();
        outcome.compare("p v xi bw bf bv", k, &got, &want[k]);
    }
    Ok(outcome)
}
