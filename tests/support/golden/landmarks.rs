//! The filters of the landmarks: the paper's example, its primitives, and the drone's filter.

use holdover::geo::kabsch_rotation;
use holdover::landmark::Discount;
use holdover::landmark::dead_reckoning::DeadReckoning;
use holdover::landmark::hinf::{impulse, projection};
use holdover::landmark::information::{Information, SeenInD, Weighing};
use holdover::landmark::{
    BodyMotion, CameraModel, HinfFilter, HinfSettings, ImplicitSystem, VisionInertial, VisionSample,
};
use holdover::time::AutopilotTime;
use nalgebra::{DMatrix, DVector, Matrix3, Vector3};
use serde_json::Value;

use super::outcome::Outcome;
use super::values::{Result, array, at, list, matrix, number, numbers, row_major, rows, vector, vectors};

/// What a word stands for in place of numbers.
fn is_word(v: &Value, key: &str, word: &str) -> bool {
    v.get(key).and_then(Value::as_str).is_some_and(|s| s == word)
}

fn matrix_or_identity(v: &Value, key: &str) -> Result<Matrix3<f64>> {
    if is_word(v, key, "identity") { Ok(Matrix3::identity()) } else { matrix(v, key) }
}

fn camera(file: &Value) -> Result<CameraModel> {
    Ok(CameraModel {
        intrinsic: matrix_or_identity(file, "F")?,
        r_body_to_camera: matrix_or_identity(file, "CBR")?,
        body_in_camera: if is_word(file, "CPB", "zero") { Vector3::zeros() } else { vector(file, "CPB")? },
    })
}

/// The paper's example with 24 states or 12; `g_diag` has the diagonal of G.
fn system(file: &Value) -> Result<VisionInertial> {
    let g = numbers(file, "g_diag")?;
    let of = |i: usize| g[i] * g[i];
    let (blocks, uniform) = match g.len() {
        24 => ([of(0), of(3), of(12), of(15)], g[..3].iter().all(|v| *v == g[0])),
        12 => ([0.0, 0.0, of(0), of(3)], true),
        n => return Err(format!("\"g_diag\" has {n} numbers")),
    };
    if !uniform {
        return Err("\"g_diag\" is not the same on each block".into());
    }
    let system = VisionInertial::new(camera(file)?, vectors(file, "landmarks_V")?, blocks);
    let system = system.ok_or("no landmarks")?;
    Ok(if g.len() == 12 { system.camera_only() } else { system })
}

/// A symmetric matrix from its upper triangle, row by row.
fn symmetric(v: &Value, key: &str, n: usize) -> Result<DMatrix<f64>> {
    let flat = numbers(v, key)?;
    if flat.len() != n * (n + 1) / 2 {
        return Err(format!("\"{key}\" has {} numbers, not {}", flat.len(), n * (n + 1) / 2));
    }
    let mut m = DMatrix::zeros(n, n);
    let mut next = flat.into_iter();
    for i in 0..n {
        for j in i..n {
            m[(i, j)] = next.next().unwrap_or(f64::NAN);
            m[(j, i)] = m[(i, j)];
        }
    }
    Ok(m)
}

fn upper(m: &DMatrix<f64>) -> Vec<f64> {
    (0..m.nrows()).flat_map(|i| (i..m.ncols()).map(move |j| (i, j))).map(|at| m[at]).collect()
}

fn by_row(m: &DMatrix<f64>) -> Vec<f64> {
    m.transpose().as_slice().to_vec()
}

fn motion(flat: &[f64]) -> BodyMotion {
    BodyMotion {
        velocity_body: Vector3::new(flat[0], flat[1], flat[2]),
        angular_rate_body: Vector3::new(flat[3], flat[4], flat[5]),
    }
}

fn discount(v: &Value) -> Result<Discount> {
    Ok(Discount { gamma: number(v, "gamma")?, lambda: number(v, "lam")? })
}

/// A run of the paper's example: motion held between inertial samples, pictures with their age.
pub fn paper(file: &Value) -> Result<Outcome> {
    let system = system(file)?;
    let n = system.dimension();
    let settings = HinfSettings { discount: discount(file)?, history_s: 2.0 };
    let p0 =
        if is_word(file, "P0", "identity") { DMatrix::identity(n, n) } else { symmetric(file, "P0", n)? };
    let x0 = DVector::from_vec(numbers(file, "x0")?);
    let mut filter = HinfFilter::new(system, settings, x0, &p0, BodyMotion::REST).ok_or("no such filter")?;
    let mut outcome = Outcome::new("landmarks, general", file);
    let mut now = list(file, "events")?.first().map_or(Ok(0.0), |e| number(e, "t"))?;
    for (k, event) in list(file, "events")?.iter().enumerate() {
        let t = number(event, "t")?;
        filter.propagate(t - now);
        now = t;
        let (age, samples) = if is_word(event, "type", "imu") {
            filter.set_input(motion(&array::<6>(event, "u_from_now")?));
            let pose = || -> Result<VisionSample> {
                let r_body_to_inertial = matrix(event, "R_rowmajor")?;
                Ok(VisionSample::InertialPose { position: vector(event, "p")?, r_body_to_inertial })
            };
            (0.0, if event.get("p").is_some() { vec![pose()?] } else { vec![] })
        } else {
            let ids = numbers(event, "ids")?;
            let points = ids.iter().zip(vectors(event, "y")?);
            let point = |(id, image): (&f64, _)| VisionSample::Point { landmark: *id as usize, image };
            (number(event, "tau")?, points.map(point).collect())
        };
        if !samples.is_empty() {
            filter.update(age, &samples).map_err(|e| format!("event {k}: {e:?}"))?;
        }
        outcome.compare("x", k, filter.estimate().as_slice(), &numbers(event, "x")?);
        outcome.compare("P_ut", k, &upper(filter.information()), &numbers(event, "P_ut")?);
    }
    Ok(outcome)
}

/// Single steps, updates and projections.
pub fn primitives(file: &Value) -> Result<Outcome> {
    let mut outcome = Outcome::new("landmarks, primitives", file);
    let system = system(file)?;
    let n = system.dimension();
    for (k, case) in list(file, "propagate")?.iter().enumerate() {
        let (input, h) = (motion(&array::<6>(case, "u")?), number(case, "h")?);
        let step = system.transition(&input, h);
        outcome.compare("Phi", k, &by_row(&step.matrix), &numbers(case, "Phi")?);
        outcome.compare("phi", k, step.constant.as_slice(), &numbers(case, "phi")?);
        let p = symmetric(case, "P_ut", n)?;
        let p = system.riccati_step(&input, discount(case)?, h, &p).ok_or("P is not definite")?;
        outcome.compare("P_next_ut", k, &upper(&p), &numbers(case, "P_next_ut")?);
    }
    for (k, case) in list(file, "update")?.iter().enumerate() {
        update(case, k, &system, &mut outcome)?;
    }
    for (k, case) in list(file, "projSO3")?.iter().enumerate() {
        let r = kabsch_rotation(&matrix(case, "M")?).ok_or("no rotation is nearest")?;
        outcome.compare("R", k, &row_major(&r), &row_major(&matrix(case, "R")?));
    }
    Ok(outcome)
}

fn update(case: &Value, k: usize, system: &VisionInertial, outcome: &mut Outcome) -> Result<()> {
    let (n, gamma) = (system.dimension(), number(case, "gamma")?);
    let settings = HinfSettings { discount: Discount { gamma, lambda: 0.0 }, history_s: 2.0 };
    // The filter lives the inputs through, and is set to the case's start then.
    let eye = DMatrix::identity(n, n) * 1e6;
    let start = DVector::zeros(n);
    let mut filter =
        HinfFilter::new(system.clone(), settings, start, &eye, BodyMotion::REST).ok_or("no such filter")?;
    for input in rows::<6>(case, "inputs_each_0p05s")? {
        filter.set_input(motion(&input));
        filter.propagate(0.05);
    }
    let p = symmetric(case, "P_minus_ut", n)?;
    if !filter.restart(DVector::from_vec(numbers(case, "x_minus")?), &(p / gamma.powi(2))) {
        return Err("P is not definite".into());
    }
    let age = number(case, "tau")?;
    let sample =
        VisionSample::Point { landmark: number(case, "landmark")? as usize, image: vector(case, "y")? };
    let (back, then) = filter.back(age).map_err(|e| format!("{e:?}"))?;
    let mut outputs = Vec::new();
    system.outputs(&sample, &then, &mut outputs);
    let output = outputs.first().ok_or("no such landmark")?;
    let (w, zeta) = impulse(output, &back, n).ok_or("no impulse")?;
    // x(s) = Φ(x − I_u): `back` holds −ΦI_u.
    let i_u = -(back.matrix.transpose() * &back.constant);
    let free = output.free.as_ref().ok_or("no free direction")?;
    outcome.compare("Phi_back", k, &by_row(&back.matrix), &numbers(case, "Phi_back")?);
    outcome.compare("I_u", k, i_u.as_slice(), &numbers(case, "I_u")?);
    outcome.compare("H", k, &by_row(&(&output.gradient * &back.matrix)), &numbers(case, "H")?);
    let b = &output.constant + &output.gradient * &back.constant;
    outcome.compare("b", k, b.as_slice(), &numbers(case, "b")?);
    let pi = projection(free).ok_or("no projection")?;
    outcome.compare("Pi", k, &by_row(&pi), &numbers(case, "Pi")?);
    outcome.compare("W", k, &by_row(&w), &numbers(case, "W")?);
    outcome.compare("zeta", k, zeta.as_slice(), &numbers(case, "zeta")?);
    filter.update(age, &[sample]).map_err(|e| format!("update {k}: {e:?}"))?;
    outcome.compare("x_plus", k, filter.estimate().as_slice(), &numbers(case, "x_plus")?);
    outcome.compare("P_plus_ut", k, &upper(filter.information()), &numbers(case, "P_plus_ut")?);
    Ok(())
}

/// The drone's H∞ filter in a dead-reckoned frame: sightings as they arrive, out of order, some of them wrong.
pub fn dead_reckoned(file: &Value) -> Result<Outcome> {
    let mut outcome = Outcome::new("landmarks, drone", file);
    let p = at(file, "params")?;
    let (h, lambda, sigma) = (number(file, "h")?, number(p, "lam")?, number(p, "sg")?);
    let how = Weighing {
        bearing_sigma_rad: number(p, "sb")?,
        distance_clip_m: [number(p, "rmin")?, number(p, "rmax")?],
        gate: number(p, "gate")?,
        weight: 1.0,
    };
    let (lever, landmarks) = (vector(file, "lever")?, vectors(file, "landmarks_V")?);
    let motions = rows::<6>(file, "inputs_vw")?;
    let time = |k: usize| AutopilotTime::from_micros((k as f64 * h * 1e6).round() as i64);
    let mut reckoning = DeadReckoning::new(time(0), 1e3, 1e3, motions.len() + 1);
    let mut filter = Information::new(
        &vector(file, "P0")?,
        &matrix(file, "R0")?,
        &reckoning.present(),
        number(file, "pos_s")?,
        number(file, "rot_s")?,
    );
    let mut k = 0;
    for (i, event) in list(file, "events")?.iter().enumerate() {
        while k < number(event, "k")? as usize {
            let input = motions.get(k).ok_or("events go on after the inputs")?;
            k += 1;
            reckoning.push(time(k), &motion(input));
            filter.forget(lambda, h);
        }
        if is_word(event, "type", "grav") {
            let down = reckoning.present().r_body_to_d * vector(event, "g")?;
            filter.gravity(&down, sigma).ok_or("not definite")?;
        } else {
            let taken = number(event, "k_sample")? as usize;
            let then = reckoning.at(time(taken)).map_err(|e| format!("event {i}: {e:?}"))?;
            let landmark = *landmarks.get(number(event, "id")? as usize).ok_or("no such landmark")?;
            let seen = SeenInD {
                landmark,
                direction_d: then.r_body_to_d * vector(event, "b_body")?,
                camera_d: then.position_d + then.r_body_to_d * lever,
                distance: None,
            };
            let weight = (-2.0 * lambda * (k - taken) as f64 * h).exp();
            let judged = filter.sighting(&seen, &Weighing { weight, ..how }).ok_or("not definite")?;
            outcome.compare("nis", i, &[judged.ratio], &[number(event, "nis")?]);
            outcome.compare("accepted", i, &[f64::from(judged.used)], &[number(event, "accepted")?]);
            let (position, r) = filter.pose(&reckoning.present()).ok_or("no pose")?;
            outcome.compare("P_V", i, position.as_slice(), vector(event, "P_V")?.as_slice());
            outcome.compare("R_V_B", i, &row_major(&r), &row_major(&matrix(event, "R_V_B")?));
        }
        outcome.compare("x", i, filter.state().as_slice(), &numbers(event, "x")?);
        let y = DMatrix::from_column_slice(12, 12, filter.information().as_slice());
        outcome.compare("Y_ut", i, &upper(&y), &numbers(event, "Y_ut")?);
    }
    Ok(outcome)
}
