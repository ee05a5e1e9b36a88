//! The published altimeters over a recorded Monte Carlo run, and their parameters.

use holdover::altimeter::{
    AltimeterMethod, AltimeterScheme, ErrorModel, Estimate, PublishedAltimeter, PublishedFilter, fuse,
    normal_operation, stationary_sigma,
};
use nalgebra::Matrix5;
use serde_json::Value;

use super::outcome::Outcome;
use super::values::{Result, at, choice, list, number, number_or, numbers, rows};

/// The bound of the integral in (32).
const LIMIT: f64 = 3.0;

/// The model of a file's `params`, or the table's.
fn model(file: &Value) -> Result<ErrorModel> {
    let Some(p) = file.get("params") else { return Ok(ErrorModel::table_1()) };
    let step_s = number(p, "Td")?;
    let (alpha, beta_g, beta) = (number(p, "alpha")?, number(p, "beta_g")?, number(p, "beta")?);
    let offset = number(p, "s_B")?;
    let literal = choice(p, "ub", &[("stationary", 0.0, false), ("literal", 1.0, true)])?;
    Ok(ErrorModel {
        alpha_per_s: alpha,
        beta_g_per_s: beta_g,
        beta_per_s: beta,
        accel_sigma_mps2: stationary_sigma(number(p, "s_az")?, alpha, step_s),
        gravity_sigma_mps2: stationary_sigma(number(p, "s_g")?, beta_g, step_s),
        baro_offset_sigma_m: if literal { stationary_sigma(offset, beta, step_s) } else { offset },
        inertial_noise_m: number(p, "s_INS")?,
        baro_noise_m: offset,
        gps_noise_m: number(p, "s_GPS")?,
        earth_radius_m: number(p, "R0")?,
        altitude_m: number(p, "H")?,
        gravity_mps2: number(p, "g")?,
        start_height_sigma_m: number(p, "p0_h")?,
        start_speed_sigma_mps: number(p, "p0_w")?,
        longest_step_s: step_s,
    })
}

/// Row by row.
fn row_major(m: &Matrix5<f64>, n: usize) -> Vec<f64> {
    (0..n * n).map(|i| m[(i / n, i % n)]).collect()
}

fn compare_model(o: &mut Outcome, want: &Value, model: &ErrorModel, step_s: f64, n: usize) -> Result<()> {
    o.compare("F", n, &row_major(&model.transition(step_s), n), &numbers(want, "F")?);
    let noise = Matrix5::from_diagonal(&model.process_noise(step_s));
    o.compare("GQG", n, &row_major(&noise, n), &numbers(want, "GQG")?);
    let start = Matrix5::from_diagonal(&model.start_sigmas().map(|s| s * s));
    o.compare("P0", n, &row_major(&start, n), &numbers(want, "P0")?);
    let r = if n == 5 { model.baro_variance() } else { model.gps_variance() };
    o.compare("R", n, &[r], &[number(want, "R")?]);
    Ok(())
}

/// The parameters, the matrices that follow from them, the table of (32), and the fusion.
pub fn run_params(file: &Value) -> Result<Outcome> {
    let mut o = Outcome::new("altimeter parameters", file);
    let mut model = model(file)?;
    let p = at(file, "params")?;
    let (step_s, table) = (number(p, "Td")?, ErrorModel::table_1());
    compare_model(&mut o, at(file, "ibi")?, &model, step_s, 5)?;
    compare_model(&mut o, at(file, "iig")?, &model, step_s, 4)?;
    // The preset is the same model.
    compare_model(&mut o, at(file, "ibi")?, &table, step_s, 5)?;
    compare_model(&mut o, at(file, "iig")?, &table, step_s, 4)?;
    o.compare("p0", 0, model.start_sigmas().as_slice(), &numbers(file, "p0")?);
    if let Some(want) = file.get("ibi_ub_literal") {
        model.baro_offset_sigma_m = stationary_sigma(number(p, "s_B")?, model.beta_per_s, step_s);
        compare_model(&mut o, want, &model, step_s, 5)?;
    }
    for (k, case) in list(file, "prob_table")?.iter().enumerate() {
        let got = normal_operation(number(case, "mean")?, number(case, "sigma")?, LIMIT);
        o.compare("prob_table", k, &[got], &[number(case, "prob")?]);
    }
    for (k, case) in list(file, "fuse")?.iter().enumerate() {
        let e =
            |x, v| Ok::<_, String>(Estimate { delta_h_m: number(case, x)?, variance_m2: number(case, v)? });
        let got = fuse(e("x1", "v1")?, e("x2", "v2")?);
        o.compare("fuse", k, &[got.delta_h_m, got.variance_m2], &[number(case, "x")?, number(case, "v")?]);
    }
    Ok(o)
}

/// What a file expects of one channel.
struct Channel<'a, const N: usize> {
    x: Vec<[f64; N]>,
    p_diag: Vec<[f64; N]>,
    prob: Vec<f64>,
    /// Normalised innovation and its variance, where given.
    innovations: Option<[Vec<f64>; 2]>,
    /// Whole covariances, by step, where given.
    p_full: Option<&'a serde_json::Map<String, Value>>,
}

impl<'a, const N: usize> Channel<'a, N> {
    fn read(file: &'a Value, name: &str, steps: usize) -> Result<Self> {
        let v = at(file, name)?;
        let innovations = match v.get("nu") {
            Some(_) => Some([numbers(v, "nu")?, numbers(v, "S")?]),
            None => None,
        };
        let p_full = match v.get("P_full") {
            Some(p) => Some(p.as_object().ok_or("\"P_full\" is no object")?),
            None => None,
        };
        let out = Self {
            x: rows(v, "x")?,
            p_diag: rows(v, "P_diag")?,
            prob: numbers(v, "prob")?,
            innovations,
            p_full,
        };
        let mut lengths = vec![out.x.len(), out.p_diag.len(), out.prob.len()];
        lengths.extend(out.innovations.iter().flatten().map(Vec::len));
        if lengths.iter().any(|&n| n != steps) {
            return Err(format!("the columns of \"{name}\" are not of the length of the inputs"));
        }
        Ok(out)
    }

    fn compare(
        &self,
        o: &mut Outcome,
        k: usize,
        got: &PublishedFilter<N>,
        step: Option<holdover::altimeter::WeightedInnovation>,
    ) -> Result<()> {
        let step = step.ok_or_else(|| format!("step {k}: a measurement was not used"))?;
        o.compare("x", k, got.state().as_slice(), &self.x[k]);
        let p: [f64; N] = std::array::from_fn(|i| got.covariance()[(i, i)]);
        o.compare("P_diag", k, &p, &self.p_diag[k]);
        o.compare("prob", k, &[step.prob], &[self.prob[k]]);
        if let Some([nu, s]) = &self.innovations {
            o.compare("nu", k, &[step.normalised], &[nu[k]]);
            o.compare("S", k, &[step.variance], &[s[k]]);
        }
        let key = k.to_string();
        if let Some(full) = self.p_full.filter(|p| p.contains_key(&key)) {
            let whole: Vec<f64> = (0..N * N).map(|i| got.covariance()[(i / N, i % N)]).collect();
            let map = Value::Object(full.clone());
            o.compare("P_full", k, &whole, &numbers(&map, &key)?);
        }
        Ok(())
    }
}

/// A filter over measurements.
pub fn run(file: &Value) -> Result<Outcome> {
    let model = model(file)?;
    let step_s = model.longest_step_s;
    let mut method =
        choice(file, "mode", &[("okf", 0.0, AltimeterMethod::Okf), ("rkf", 1.0, AltimeterMethod::Rkf)])?;
    if file.get("variant").is_some() {
        choice(file, "variant", &[("joseph", 0.0, ())])?;
        if method == AltimeterMethod::Okf {
            return Err("\"variant\" is for the robust filter".into());
        }
        method = AltimeterMethod::RkfJoseph;
    }
    let (z_ibi, z_iig) = (numbers(file, "z_ibi")?, numbers(file, "z_iig")?);
    let steps = number_or(file, "N", z_ibi.len() as f64)? as usize;
    let fused = at(file, "ibig")?;
    let (x, var) = (numbers(fused, "x")?, numbers(fused, "var")?);
    if [z_ibi.len(), z_iig.len(), x.len(), var.len()].iter().any(|&n| n != steps) || steps == 0 {
        return Err("inputs and expected values differ in length".into());
    }
    let ibi = Channel::<5>::read(file, "ibi", steps)?;
    let iig = Channel::<4>::read(file, "iig", steps)?;
    let mut altimeter = PublishedAltimeter::new(model, method);
    let mut o = Outcome::new("altimeter", file);
    for k in 0..steps {
        let report = altimeter.step(step_s, Some(z_ibi[k]), Some(z_iig[k]));
        let (got_ibi, got_iig) = altimeter.channels();
        ibi.compare(&mut o, k, got_ibi, report.ibi)?;
        iig.compare(&mut o, k, got_iig, report.iig)?;
        let e = altimeter.estimate(AltimeterScheme::Ibig);
        o.compare("fused x", k, &[e.delta_h_m], &[x[k]]);
        o.compare("fused var", k, &[e.variance_m2], &[var[k]]);
    }
    Ok(o)
}
