//! Grip's observer over a recorded flight.

use holdover::observer::attitude::MagneticPair;
use holdover::observer::bias::BiasBounds;
use holdover::observer::{FixSample, GripInput, GripParams, ObserverState, Scheme, grip};
use nalgebra::Vector3;
use serde_json::Value;

use super::flight::{Flight, discretisation, gains, predictor, take_fix};
use super::outcome::Outcome;
use super::values::{Result, at, choice, matrix, number, number_or, row_major, rows, vector, vectors};

fn params(p: &Value) -> Result<GripParams> {
    choice(p, "triad", &[("NORM", 1.0, ())])?;
    Ok(GripParams {
        k_p: vector(p, "KP")?,
        sigma: number_or(p, "sigma", 1.0)?,
        k_i: number(p, "kI")?,
        bias_bounds: BiasBounds { bound_radps: number(p, "Mb")?, limit_radps: number(p, "Mbh")? },
        gains: gains(p)?,
        discretisation: discretisation(p)?,
        min_magnetic_sine: 0.0,
        gate: None,
    })
}

pub fn run(file: &Value) -> Result<Outcome> {
    let (p, inputs, init, expected) =
        (at(file, "params")?, at(file, "inputs")?, at(file, "init")?, at(file, "expected")?);
    let scheme = choice(p, "scheme", &[("ZOH", 0.0, Scheme::Hold), ("ISP", 1.0, Scheme::InterSample)])?;
    let params = params(p)?;
    let use_velocity = choice(p, "use_vel", &[("false", 0.0, false), ("true", 1.0, true)])?;
    let flight = Flight::read(inputs)?;
    let (mag, field_ned) = (vectors(inputs, "mag")?, vector(inputs, "mag_ned")?);
    let want_r = rows::<9>(expected, "R")?;
    let fields = ["b", "p", "v", "xi"];
    let wanted: Vec<_> = fields.iter().map(|f| vectors(expected, f)).collect::<Result<_>>()?;
    let n = flight.t.len();
    if mag.len() != n || want_r.len() != n || wanted.iter().any(|w| w.len() != n) {
        return Err("inputs and expected values differ in length".into());
    }
    let mut state = ObserverState {
        r_hat: matrix(init, "R")?,
        gyro_bias: vector(init, "b")?,
        position_ned: vector(init, "p")?,
        velocity_ned: vector(init, "v")?,
        xi_ned: vector(init, "xi")?,
    };
    let mut w = predictor(scheme, Vector3::zeros());
    let mut outcome = Outcome::new("grip", file);
    for k in 0..n {
        if k > 0 {
            let signal = w.signal();
            let (position_error_ned, velocity_error_ned) =
                signal.map_or_else(Default::default, |s| s.errors(&state.position_ned, &state.velocity_ned));
            let input = GripInput {
                dt_s: flight.dt(k),
                angular_rate_body: flight.gyro[k],
                specific_force_body: flight.acc[k],
                gravity_ned: flight.gravity_ned,
                earth_rate_ned: Vector3::zeros(),
                magnetic: Some(MagneticPair { field_body: mag[k], field_ned }),
                position_error_ned,
                velocity_error_ned,
            };
            let report = grip::step(&params, &mut state, &input).map_err(|e| format!("step {k}: {e}"))?;
            if let Some(mut signal) = signal {
                signal.advance(input.dt_s, &report.acceleration_ned, &Vector3::zeros());
                w.follow(flight.stamp(k), &signal, &state.velocity_ned);
            }
        }
        if let Some((zp, zv)) = flight.fix(k) {
            let fix = FixSample::position(flight.stamp(k), &zp);
            let fix = if use_velocity { fix.with_velocity(&zv) } else { fix };
            take_fix(&mut w, &fix, (zp, zv))?;
        }
        outcome.compare("R", k, &row_major(&state.r_hat), &want_r[k]);
        let got = [state.gyro_bias, state.position_ned, state.velocity_ned, state.xi_ned];
        for ((field, got), want) in fields.iter().zip(&got).zip(&wanted) {
            outcome.compare(field, k, got.as_slice(), want[k].as_slice());
        }
    }
    Ok(outcome)
}
