//! The motion of the camera from any number of image features or patches: Fusini (3), stacked.
//!
//! [`solve_six`] is (3) as published, [v; ω] = −M⁺·flow. It is ill-conditioned: over flat ground a sideways motion and a roll look almost
//! alike, and with the noise of a real tracker the velocity has ten times the error of [`solve_velocity`], which takes ω from the gyros
//! (their bias removed) and solves A·v = −(flow + B·ω) for v alone, M = [A B].
//!
//! **Covariance.** The residuals' variance (never less than the noise that is stated, and more when there are few features to tell it
//! from) times (AᵀWA)⁻¹, plus two errors that all features share and no residual shows: height, along the velocity (v is proportional to
//! h), and gyro bias, through ∂v/∂ω = −A⁺B.

use nalgebra::{Matrix2x3, Matrix3, Matrix6, SMatrix, Vector3, Vector6};

use super::features::{Feature, View, ground_point, interaction_matrix};
use super::refusal::FlowRefusal;
use super::robust::{self, FlowRow, Huber, Prior, Ransac};
use crate::geo::CameraMount;

/// How outliers are treated; thresholds are lengths of a feature's residual over [`SolveNoise::flow`].
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Method {
    /// Least squares: one wrong feature moves the result.
    LeastSquares,
    /// Huber's reweighting, w = min(1, threshold/|e|).
    Huber {
        /// Residuals up to here count in full.
        threshold: f64,
        /// Most iterations.
        iterations: u32,
    },
    /// The largest set of features that agree, then Huber's reweighting within it (none with `huber` of 0).
    Ransac {
        /// Features that agree lie within this.
        threshold: f64,
        /// Pairs of features that are tried; all where there are fewer.
        samples: u32,
        /// Threshold of Huber's reweighting among those that agree.
        huber: f64,
    },
}

impl Method {
    /// Huber's reweighting with the threshold that costs 5 % of efficiency where there are no outliers.
    pub const HUBER: Self = Method::Huber { threshold: 2.0, iterations: 20 };
    /// RANSAC and Huber: 64 pairs find a good one with 1 − 10⁻¹⁸ where 30 % are wrong, with 1 − 10⁻⁸ where half are.
    pub const RANSAC: Self = Method::Ransac { threshold: 4.0, samples: 64, huber: 2.0 };
}

/// Bounds outside which a solve is refused.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct SolveLimits {
    /// Largest angle of the optical axis from straight down, rad.
    pub max_tilt_rad: f64,
    /// Least height, m.
    pub min_height_m: f64,
    /// Greatest height, m.
    pub max_height_m: f64,
    /// Fewest features that must see the ground.
    pub min_features: usize,
    /// Largest condition number of M, its columns scaled to unit length (six parameters).
    pub max_condition: f64,
    /// Largest ratio of the largest to the smallest singular value of A (three parameters, all in m/s): how much worse than the best
    /// direction the worst one may be known.
    pub max_dilution: f64,
    /// Largest root mean square residual, over the noise.
    pub max_residual: f64,
    /// Least part of the features that must agree (RANSAC).
    pub min_consensus: f64,
}

impl Default for SolveLimits {
    fn default() -> Self {
        Self {
            max_tilt_rad: 50f64.to_radians(),
            min_height_m: 0.3,
            max_height_m: 300.0,
            min_features: 1,
            max_condition: 200.0,
            max_dilution: 20.0,
            max_residual: 5.0,
            min_consensus: 0.4,
        }
    }
}

/// Standard deviations behind the covariance.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct SolveNoise {
    /// Of ṙ and of ṡ, in the unit of the flow.
    pub flow: f64,
    /// Of the height, m.
    pub height_m: f64,
    /// Of the angular rate on each axis: gyro bias and noise, rad/s.
    pub rate_radps: f64,
}

/// A velocity component that is known from elsewhere, as a climb rate is: one more row of the equations.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct KnownComponent {
    /// Unit vector, camera axes.
    pub direction_camera: Vector3<f64>,
    /// The camera's velocity along it, m/s.
    pub speed_mps: f64,
    /// Its standard deviation, m/s.
    pub sigma_mps: f64,
}

/// Velocity and angular rate of the camera from [`solve_six`], camera axes.
#[derive(Clone, Debug, PartialEq)]
pub struct SixSolution {
    /// v, m/s.
    pub velocity_camera: Vector3<f64>,
    /// ω, rad/s.
    pub rate_camera: Vector3<f64>,
    /// Covariance of [v; ω].
    pub covariance: Matrix6<f64>,
    /// Condition number of M with its columns scaled to unit length.
    pub condition: f64,
    /// Root mean square residual of a component, unit of the flow.
    pub residual_rms: f64,
    /// Features that saw the ground.
    pub used: usize,
}

/// Velocity of the camera from [`solve_velocity`], camera axes.
#[derive(Clone, Debug, PartialEq)]
pub struct VelocitySolution {
    /// v, m/s.
    pub velocity_camera: Vector3<f64>,
    /// Its covariance, m²/s².
    pub covariance: Matrix3<f64>,
    /// Condition number of A with its columns scaled to unit length.
    pub condition: f64,
    /// Ratio of the largest to the smallest singular value of A as it is.
    pub dilution: f64,
    /// Root mean square residual of a component among the features taken (weighted), unit of the flow.
    pub residual_rms: f64,
    /// Features that were taken in full (weight 1).
    pub inliers: usize,
    /// Features that saw the ground.
    pub used: usize,
    /// Weight of every feature given, 0 (left out) to 1.
    pub weights: Vec<f64>,
}

impl VelocitySolution {
    /// The velocity of the body's origin and its covariance, body axes: the camera moves with v + ω × l, l its lever arm.
    pub fn at_body_origin(
        &self,
        mount: &CameraMount,
        rate_body: &Vector3<f64>,
    ) -> (Vector3<f64>, Matrix3<f64>) {
        let r = mount.camera_to_body.matrix();
        (
            r * self.velocity_camera - rate_body.cross(&mount.lever_arm.raw()),
            r * self.covariance * r.transpose(),
        )
    }
}

/// Weight of the stated noise against the residuals, as so many degrees of freedom.
const PRIOR_FREEDOM: f64 = 4.0;
/// A smallest eigenvalue below this part of the largest is zero.
const SINGULAR: f64 = 1e-11;
/// Sweeps of Jacobi's method; six by six converges in five or six.
const SWEEPS: usize = 10;

/// [v; ω] = −M⁺·flow: Fusini (3), the camera's velocity and angular rate from the flow alone. Needs three features or more.
///
/// # Errors
/// [`FlowRefusal`] says why there is none.
pub fn solve_six(
    view: &View,
    features: &[Feature],
    noise: &SolveNoise,
    limits: &SolveLimits,
) -> Result<SixSolution, FlowRefusal> {
    check(view, features, noise, limits)?;
    let (mut normal, mut right, mut used) = (Matrix6::zeros(), Vector6::zeros(), 0);
    for feature in features {
        let Ok(point) = ground_point(view, &feature.image) else { continue };
        let m = interaction_matrix(view.focal_length, &point);
        normal += m.tr_mul(&m);
        right -= m.tr_mul(&feature.flow);
        used += 1;
    }
    if used < 3.max(limits.min_features) {
        return Err(FlowRefusal::TooFew(used));
    }
    let (condition, scale) = condition(&normal)?;
    if condition > limits.max_condition {
        return Err(FlowRefusal::Condition(condition));
    }
    let scaling = Matrix6::from_diagonal(&scale);
    let factor = (scaling * normal * scaling).cholesky().ok_or(FlowRefusal::Rank(5))?;
    let solve = |right: Vector6<f64>| scaling * factor.solve(&(scaling * right));
    // One step of refinement: the normal equations square the condition number.
    let mut x = solve(right);
    x += solve(right - normal * x);
    let sum: f64 = features
        .iter()
        .filter_map(|f| {
            let point = ground_point(view, &f.image).ok()?;
            Some((f.flow + interaction_matrix(view.focal_length, &point) * x).norm_squared())
        })
        .sum();
    let freedom = (2 * used - 6) as f64;
    let residual_rms = (sum / (2 * used) as f64).sqrt();
    check_residual(residual_rms, noise, limits)?;
    let mut covariance = scaling * factor.inverse() * scaling * variance(sum, freedom, noise.flow);
    let v = x.fixed_rows::<3>(0).into_owned();
    let along = v * (noise.height_m / view.height_m);
    let mut block = covariance.fixed_view_mut::<3, 3>(0, 0);
    block += along * along.transpose();
    if !(x.sum() + covariance.sum()).is_finite() {
        return Err(FlowRefusal::NotFinite);
    }
    Ok(SixSolution {
        velocity_camera: v,
        rate_camera: x.fixed_rows::<3>(3).into_owned(),
        covariance,
        condition,
        residual_rms,
        used,
    })
}

/// The camera's velocity, with ω = `rate_camera` (camera axes, rad/s, bias removed): A·v = −(flow + B·ω). One feature observes two
/// components, two the third as well, and so does one and a [`KnownComponent`].
///
/// # Errors
/// [`FlowRefusal`] says why there is none.
pub fn solve_velocity(
    view: &View,
    features: &[Feature],
    rate_camera: &Vector3<f64>,
    known: Option<&KnownComponent>,
    method: Method,
    noise: &SolveNoise,
    limits: &SolveLimits,
) -> Result<VelocitySolution, FlowRefusal> {
    check(view, features, noise, limits)?;
    let prior = prior(known, noise)?;
    if !rate_camera.sum().is_finite() {
        return Err(FlowRefusal::NotFinite);
    }
    let mut rows = Vec::with_capacity(features.len());
    let mut seen = Vec::with_capacity(features.len());
    for (i, feature) in features.iter().enumerate() {
        let Ok(point) = ground_point(view, &feature.image) else { continue };
        let m = interaction_matrix(view.focal_length, &point);
        let b: Matrix2x3<f64> = m.fixed_columns::<3>(3).into_owned();
        let y = -(feature.flow + b * rate_camera);
        rows.push(FlowRow { a: m.fixed_columns::<3>(0).into_owned(), b, y });
        seen.push(i);
    }
    if rows.len() < limits.min_features.max(1) {
        return Err(FlowRefusal::TooFew(rows.len()));
    }
    let mut weights = vec![1.0; rows.len()];
    // Refused before anything is solved: what no weighting can observe.
    dilution(&robust::normal_matrix(&rows, &weights, &prior), known, limits)?;
    let v = solve(&rows, &mut weights, &prior, method, noise, limits)?;
    let normal = robust::normal_matrix(&rows, &weights, &prior);
    let dilution = dilution(&normal, known, limits)?;
    let (condition, _) = condition(&normal)?;
    let sum: f64 = rows.iter().zip(&weights).map(|(r, w)| (w * robust::residual(r, &v)).powi(2)).sum();
    let taken = weights.iter().filter(|w| **w > 0.0).count();
    let residual_rms = (sum / (2 * taken) as f64).sqrt();
    check_residual(residual_rms, noise, limits)?;
    // Two equations a feature, and what is known besides, for three unknowns.
    let freedom = (2 * taken + usize::from(known.is_some())) as f64 - 3.0;
    let mut covariance = efficient(&rows, &weights, &prior)? * variance(sum, freedom, noise.flow);
    covariance += shared(&rows, &weights, &normal, &v, view, noise)?;
    let mut all = vec![0.0; features.len()];
    for (i, w) in seen.into_iter().zip(&weights) {
        all[i] = *w;
    }
    if !(v.sum() + covariance.sum()).is_finite() {
        return Err(FlowRefusal::NotFinite);
    }
    Ok(VelocitySolution {
        velocity_camera: v,
        covariance,
        condition,
        dilution,
        residual_rms,
        inliers: weights.iter().filter(|w| **w >= 1.0).count(),
        used: rows.len(),
        weights: all,
    })
}

fn solve(
    rows: &[FlowRow],
    weights: &mut [f64],
    prior: &Prior,
    method: Method,
    noise: &SolveNoise,
    limits: &SolveLimits,
) -> Result<Vector3<f64>, FlowRefusal> {
    let singular = FlowRefusal::Rank(2);
    let start = robust::least_squares(rows, weights, prior).ok_or(singular)?;
    match method {
        Method::Ransac { threshold, samples, huber } if rows.len() > 2 => {
            let ransac = Ransac { threshold: threshold * noise.flow, samples };
            let none = FlowRefusal::Consensus { inliers: 0, of: rows.len() };
            let v = robust::consensus(rows, weights, prior, ransac).ok_or(none)?;
            let inliers = weights.iter().filter(|w| **w > 0.0).count();
            if (inliers as f64) < limits.min_consensus * rows.len() as f64 || inliers < 2 {
                return Err(FlowRefusal::Consensus { inliers, of: rows.len() });
            }
            if huber <= 0.0 {
                return Ok(v);
            }
            let settings = Huber { threshold: huber * noise.flow, iterations: 20 };
            robust::huber(rows, weights, prior, v, settings).ok_or(singular)
        }
        Method::Huber { threshold, iterations } if rows.len() > 2 => {
            let settings = Huber { threshold: threshold * noise.flow, iterations };
            let v = robust::huber(rows, weights, prior, start, settings).ok_or(singular)?;
            let inliers = weights.iter().filter(|w| **w >= 1.0).count();
            if (inliers as f64) < limits.min_consensus * rows.len() as f64 {
                return Err(FlowRefusal::Consensus { inliers, of: rows.len() });
            }
            Ok(v)
        }
        // Two features have nothing to outvote each other with.
        Method::LeastSquares | Method::Huber { .. } | Method::Ransac { .. } => Ok(start),
    }
}

/// What is wrong before anything is computed.
fn check(
    view: &View,
    features: &[Feature],
    noise: &SolveNoise,
    limits: &SolveLimits,
) -> Result<(), FlowRefusal> {
    let flow_finite = features.iter().all(|f| (f.image.sum() + f.flow.sum()).is_finite());
    let stated = view.down_camera.sum() + noise.flow + noise.height_m + noise.rate_radps;
    // Nothing that is measured is so large, and squares of such numbers overflow.
    let sane = features.iter().all(|f| f.image.amax() < 1e9 && f.flow.amax() < 1e9);
    if !(flow_finite && sane && stated.is_finite() && noise.flow > 0.0) {
        return Err(FlowRefusal::NotFinite);
    }
    if !(1e-6..=1e9).contains(&view.focal_length) {
        return Err(FlowRefusal::FocalLength(view.focal_length));
    }
    if (view.down_camera.norm() - 1.0).abs() > 1e-3 {
        return Err(FlowRefusal::NotFinite);
    }
    if view.tilt_rad() > limits.max_tilt_rad {
        return Err(FlowRefusal::Tilt(view.tilt_rad()));
    }
    // A NaN is not contained, either.
    if !(limits.min_height_m..=limits.max_height_m).contains(&view.height_m) || view.height_m <= 0.0 {
        return Err(FlowRefusal::Height(view.height_m));
    }
    Ok(())
}

fn prior(known: Option<&KnownComponent>, noise: &SolveNoise) -> Result<Prior, FlowRefusal> {
    let Some(k) = known else { return Ok(Prior { normal: Matrix3::zeros(), right: Vector3::zeros() }) };
    let weight = (noise.flow / k.sigma_mps).powi(2);
    let normal = k.direction_camera * k.direction_camera.transpose() * weight;
    let right = k.direction_camera * (k.speed_mps * weight);
    if (normal.sum() + right.sum()).is_finite() {
        Ok(Prior { normal, right })
    } else {
        Err(FlowRefusal::NotFinite)
    }
}

fn check_residual(rms: f64, noise: &SolveNoise, limits: &SolveLimits) -> Result<(), FlowRefusal> {
    let relative = rms / noise.flow;
    if relative.is_nan() || relative > limits.max_residual {
        return Err(FlowRefusal::Residual(relative));
    }
    Ok(())
}

/// The variance of a flow component, from the sum of squared residuals with so many degrees of freedom and the noise that is stated;
/// never less than that, and more when few residuals tell (the variance of Student's distribution).
fn variance(sum: f64, freedom: f64, stated: f64) -> f64 {
    let known = PRIOR_FREEDOM + freedom.max(0.0);
    let seen = (PRIOR_FREEDOM * stated * stated + sum) / known;
    seen.max(stated * stated) * known / (known - 2.0)
}

/// The covariance of v for a unit variance of the flow. Of Huber's reweighting it is (Σψ'/n)⁻² (AᵀA)⁻¹ (Huber 1981, 7.6): a feature that is
/// held back still pulls across its residual, with half its weight in the mean, and not along it.
fn efficient(rows: &[FlowRow], weights: &[f64], prior: &Prior) -> Result<Matrix3<f64>, FlowRefusal> {
    let ones: Vec<f64> = weights.iter().map(|w| if *w > 0.0 { 1.0 } else { 0.0 }).collect();
    let slope = |w: &f64| if *w >= 1.0 { 1.0 } else { 0.5 * w };
    let mean = weights.iter().map(slope).sum::<f64>() / ones.iter().sum::<f64>();
    let normal = robust::normal_matrix(rows, &ones, prior);
    Ok(normal.cholesky().ok_or(FlowRefusal::Rank(2))?.inverse() / (mean * mean))
}

/// The covariance of the errors that all features share: height, v·σ_h/h, and angular rate, N⁻¹(ΣwAᵀB)·σ_ω.
fn shared(
    rows: &[FlowRow],
    weights: &[f64],
    normal: &Matrix3<f64>,
    v: &Vector3<f64>,
    view: &View,
    noise: &SolveNoise,
) -> Result<Matrix3<f64>, FlowRefusal> {
    let along = v * (noise.height_m / view.height_m);
    let sum = |m: Matrix3<f64>, (row, w): (&FlowRow, &f64)| m + row.a.tr_mul(&row.b) * *w;
    let turned = rows.iter().zip(weights).fold(Matrix3::zeros(), sum);
    let by_rate = normal.cholesky().ok_or(FlowRefusal::Rank(2))?.solve(&turned);
    Ok(along * along.transpose() + by_rate * by_rate.transpose() * noise.rate_radps.powi(2))
}

/// Ratio of the largest to the smallest singular value of the equations; with a component known from elsewhere it may be anything.
fn dilution(
    normal: &Matrix3<f64>,
    known: Option<&KnownComponent>,
    limits: &SolveLimits,
) -> Result<f64, FlowRefusal> {
    let ratio = singular_ratio(normal)?;
    if known.is_none() && ratio > limits.max_dilution {
        return Err(FlowRefusal::Condition(ratio));
    }
    Ok(ratio)
}

/// Condition number of the matrix whose normal matrix this is, with its columns scaled to unit length, and the scales.
fn condition<const N: usize>(
    normal: &SMatrix<f64, N, N>,
) -> Result<(f64, nalgebra::SVector<f64, N>), FlowRefusal> {
    let diagonal = normal.diagonal();
    if !(diagonal.min() > 0.0 && diagonal.max().is_finite()) {
        return Err(FlowRefusal::Rank(diagonal.iter().filter(|d| **d > 0.0).count()));
    }
    let scale = diagonal.map(|d| 1.0 / d.sqrt());
    let scaled = SMatrix::<f64, N, N>::from_fn(|i, j| normal[(i, j)] * scale[i] * scale[j]);
    Ok((singular_ratio(&scaled)?, scale))
}

/// √(λ_max/λ_min) of a normal matrix.
fn singular_ratio<const N: usize>(normal: &SMatrix<f64, N, N>) -> Result<f64, FlowRefusal> {
    let peak = normal.amax();
    if !peak.is_finite() {
        return Err(FlowRefusal::NotFinite);
    }
    let values = jacobi_eigenvalues(normal / peak.max(f64::MIN_POSITIVE));
    let largest = values.max();
    let rank = values.iter().filter(|v| **v > SINGULAR * largest).count();
    if rank < N {
        return Err(FlowRefusal::Rank(rank));
    }
    Ok((largest / values.min()).sqrt())
}

/// Eigenvalues of a symmetric matrix by Jacobi's rotations: a fixed number of them, so that it ends whatever it is given.
fn jacobi_eigenvalues<const N: usize>(m: SMatrix<f64, N, N>) -> nalgebra::SVector<f64, N> {
    let mut m = m;
    for _ in 0..SWEEPS {
        for p in 0..N {
            for q in (p + 1)..N {
                if m[(p, q)].abs() <= f64::MIN_POSITIVE {
                    continue;
                }
                let theta = (m[(q, q)] - m[(p, p)]) / (2.0 * m[(p, q)]);
                let t = theta.signum() / (theta.abs() + theta.hypot(1.0));
                let c = 1.0 / t.hypot(1.0);
                let s = t * c;
                for k in 0..N {
                    let (a, b) = (m[(k, p)], m[(k, q)]);
                    m[(k, p)] = c * a - s * b;
                    m[(k, q)] = s * a + c * b;
                }
                for k in 0..N {
                    let (a, b) = (m[(p, k)], m[(q, k)]);
                    m[(p, k)] = c * a - s * b;
                    m[(q, k)] = s * a + c * b;
                }
            }
        }
    }
    m.diagonal()
}
