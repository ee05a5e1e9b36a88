//! Optical flow: the stacked solves, and single patches.

use holdover::camera::single_patch::patch_velocity;
use holdover::camera::{
    Feature, Method, SolveLimits, SolveNoise, VelocitySolution, View, ground_point, interaction_matrix,
    solve_six, solve_velocity,
};
use nalgebra::{Vector2, Vector3};
use serde_json::Value;

use super::outcome::Outcome;
use super::values::{Result, array, list, number, numbers, rows, vector};

pub fn run(file: &Value) -> Result<Outcome> {
    let mut outcome = Outcome::new("flow", file);
    if file.get("cases").is_some() {
        for (k, case) in list(file, "cases")?.iter().enumerate() {
            stacked(&mut outcome, k, case).map_err(|e| format!("case {k}: {e}"))?;
        }
    }
    if file.get("optical_flow_rad").is_some() {
        for (k, case) in list(file, "optical_flow_rad")?.iter().enumerate() {
            let pair = |x: &str, y: &str| Ok::<_, String>(Vector2::new(number(case, x)?, number(case, y)?));
            let (flow, gyro) = (pair("ix", "iy")?, pair("gx", "gy")?);
            let v = patch_velocity(&flow, &gyro, number(case, "dt")?, number(case, "dist")?);
            outcome.compare("vxy", k, v.as_slice(), &array::<2>(case, "vxy")?);
        }
    }
    Ok(outcome)
}

/// Nothing is refused that has a solution at all, and no covariance is asked for.
fn open() -> (SolveNoise, SolveLimits) {
    let limits = SolveLimits {
        max_tilt_rad: 1.5,
        min_height_m: 0.0,
        max_height_m: f64::INFINITY,
        max_condition: 1e9,
        max_dilution: f64::INFINITY,
        max_residual: f64::INFINITY,
        min_consensus: 0.0,
        ..SolveLimits::default()
    };
    (SolveNoise { flow: 1.0, height_m: 0.0, rate_radps: 0.0 }, limits)
}

fn stacked(outcome: &mut Outcome, k: usize, case: &Value) -> Result<()> {
    let [r, s, rdot, sdot] = ["r", "s", "rdot", "sdot"].map(|key| numbers(case, key));
    let (r, s, rdot, sdot) = (r?, s?, rdot?, sdot?);
    if [s.len(), rdot.len(), sdot.len()].iter().any(|&n| n != r.len()) {
        return Err("\"r\", \"s\", \"rdot\" and \"sdot\" differ in length".into());
    }
    let features: Vec<Feature> = (0..r.len())
        .map(|i| Feature { image: Vector2::new(r[i], s[i]), flow: Vector2::new(rdot[i], sdot[i]) })
        .collect();
    let view = View::from_roll_pitch(
        number(case, "l")?,
        number(case, "roll")?,
        number(case, "pitch")?,
        number(case, "height")?,
    );
    let Some(all) = case.as_object() else { return Err("no object".into()) };
    let (noise, limits) = open();
    for (key, want) in all {
        match key.as_str() {
            "points" => {
                for (i, want) in rows::<3>(case, key)?.iter().enumerate() {
                    let image = features.get(i).ok_or("more points than features")?.image;
                    let point = ground_point(&view, &image).map_err(|e| format!("{e:?}"))?;
                    outcome.compare("points", k, point.as_slice(), want);
                }
            }
            "M" => {
                for (i, want) in rows::<6>(case, key)?.chunks_exact(2).enumerate() {
                    let image = features.get(i).ok_or("more rows than features")?.image;
                    let point = ground_point(&view, &image).map_err(|e| format!("{e:?}"))?;
                    let m = interaction_matrix(view.focal_length, &point);
                    for (row, want) in want.iter().enumerate() {
                        let got: Vec<f64> = m.row(row).iter().copied().collect();
                        outcome.compare("M", k, &got, want);
                    }
                }
            }
            "solve6" => {
                let six = solve_six(&view, &features, &noise, &limits).map_err(|e| format!("{e:?}"))?;
                outcome.compare("solve6", k, six.velocity_camera.as_slice(), vector(want, "v")?.as_slice());
                outcome.compare("solve6", k, six.rate_camera.as_slice(), vector(want, "w")?.as_slice());
                outcome.compare("solve6", k, &[six.condition], &[number(want, "cond")?]);
            }
            other => {
                if let Some(method) = method(other) {
                    let rate = vector(case, "omega")?;
                    let three = three(&view, &features, &rate, method)?;
                    compare_three(outcome, other, k, &three, want)?;
                }
            }
        }
    }
    Ok(())
}

/// "solve3", "huber6_10it" (threshold, iterations) or "ransac_thr20_n64_seed1" (threshold, samples; samples are drawn otherwise here).
fn method(key: &str) -> Option<Method> {
    if key == "solve3" {
        return Some(Method::LeastSquares);
    }
    if let Some((threshold, iterations)) = key.strip_prefix("huber").and_then(|rest| rest.split_once('_')) {
        let iterations = iterations.strip_suffix("it")?.parse().ok()?;
        return Some(Method::Huber { threshold: threshold.parse().ok()?, iterations });
    }
    let (threshold, rest) = key.strip_prefix("ransac_thr")?.split_once("_n")?;
    let samples = rest.split('_').next()?.parse().ok()?;
    Some(Method::Ransac { threshold: threshold.parse().ok()?, samples, huber: 0.0 })
}

fn three(view: &View, features: &[Feature], rate: &Vector3<f64>, method: Method) -> Result<VelocitySolution> {
    let (noise, limits) = open();
    solve_velocity(view, features, rate, None, method, &noise, &limits).map_err(|e| format!("{e:?}"))
}

fn compare_three(
    outcome: &mut Outcome,
    field: &str,
    k: usize,
    got: &VelocitySolution,
    want: &Value,
) -> Result<()> {
    outcome.compare(field, k, got.velocity_camera.as_slice(), vector(want, "v")?.as_slice());
    if want.get("cond").is_some() {
        outcome.compare(field, k, &[got.condition], &[number(want, "cond")?]);
    }
    if want.get("inliers").is_some() {
        outcome.compare(field, k, &got.weights, &numbers(want, "inliers")?);
    }
    Ok(())
}
