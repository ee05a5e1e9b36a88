//! The paper's scenario (Aguiar, Section V): a vehicle on a circle, four points above it, an inertial system and a camera.
#![allow(dead_code, reason = "each uses its part")]

use holdover::geo::so3::{Euler, angle_between, exp, left_jacobian};
use holdover::landmark::Discount;
use holdover::landmark::{
    BodyMotion, CameraModel, Definiteness, HinfFilter, HinfSettings, ImplicitSystem, VisionInertial,
    VisionSample,
};
use nalgebra::{DMatrix, Matrix3, Vector3};
use rand::SeedableRng;
use rand_chacha::ChaCha8Rng;
use rand_distr::{Distribution, StandardNormal};

/// A run of the scenario.
#[derive(Clone, Copy)]
pub struct PaperRun {
    pub discount: Discount,
    /// Part of every measured number that is its noise's σ.
    pub noise: f64,
    /// Drops the inertial system's pose and the twelve states that only it sees.
    pub camera_only: bool,
    pub duration_s: f64,
    pub seed: u64,
}

/// An error at a time: s, m, rad.
pub type Point = (f64, [f64; 2]);

const IMU_S: f64 = 0.1;
const DELAY_S: f64 = 0.05;
/// Pictures every so many inertial samples.
const PICTURE: usize = 4;

fn points() -> Vec<Vector3<f64>> {
    [[-1.0, 0.5, 2.5], [1.5, 0.5, 3.5], [1.0, 3.0, 2.8], [-1.0, 2.5, 4.0]].map(Vector3::from).to_vec()
}

fn camera() -> CameraModel {
    let eye = Matrix3::identity();
    CameraModel { intrinsic: eye, r_body_to_camera: eye, body_in_camera: Vector3::new(0.1, 0.0, 0.05) }
}

const MOTION: BodyMotion =
    BodyMotion { velocity_body: Vector3::new(0.3, 0.0, 0.0), angular_rate_body: Vector3::new(0.0, 0.0, 0.2) };

/// Position and attitude in the landmarks' frame.
fn truth(t_s: f64) -> (Vector3<f64>, Matrix3<f64>) {
    let turn = MOTION.angular_rate_body * t_s;
    (left_jacobian(&turn) * MOTION.velocity_body * t_s, exp(&turn))
}

/// Runs the filter; the errors after every event, until P is no longer definite.
pub fn run(run: &PaperRun) -> (Vec<Point>, Definiteness) {
    let mut rng = ChaCha8Rng::seed_from_u64(run.seed);
    let mut noisy = |v: f64| v * (1.0 + run.noise * Distribution::<f64>::sample(&StandardNormal, &mut rng));
    let g = |sigma: f64| sigma * sigma;
    let system = VisionInertial::new(camera(), points(), [g(0.05), 0.0, g(0.05), g(0.02)]).expect("points");
    let system = if run.camera_only { system.camera_only() } else { system };
    // I is anywhere in V.
    let (p_i, r_i) = (Vector3::new(0.4, -0.6, 0.2), Euler::new(0.2, -0.1, 0.7).to_rotation());
    let printed = Matrix3::new(0.9814, -0.0179, 0.1913, -0.1246, 0.6983, 0.7049, -0.1462, -0.7156, 0.6831);
    let start = system.state(&Vector3::from_element(1.0), &printed, &Vector3::zeros(), &Matrix3::identity());
    let n = system.dimension();
    let settings = HinfSettings { discount: run.discount, history_s: 1.0 };
    let mut filter =
        HinfFilter::new(system, settings, start, &DMatrix::identity(n, n), MOTION).expect("a filter");
    let mut out = Vec::new();
    let mut record = |t_s: f64, filter: &HinfFilter<VisionInertial>| {
        let (p, r) = truth(t_s);
        let error = filter.system().pose(filter.estimate());
        let error = error.map_or([f64::INFINITY; 2], |(q, s)| [(q - p).norm(), angle_between(&s, &r)]);
        out.push((t_s, error));
    };
    record(0.0, &filter);
    let steps = (run.duration_s / IMU_S).round() as usize;
    for k in 0..steps {
        let t = k as f64 * IMU_S;
        let (p, r) = truth(t);
        filter.set_input(BodyMotion {
            velocity_body: MOTION.velocity_body.map(&mut noisy),
            angular_rate_body: MOTION.angular_rate_body.map(&mut noisy),
        });
        if !run.camera_only {
            let (position, rotation) = (r_i.tr_mul(&(p - p_i)), r_i.tr_mul(&r));
            let sample = VisionSample::InertialPose {
                position: position.map(&mut noisy),
                r_body_to_inertial: rotation.map(&mut noisy),
            };
            // Refused only when the filter has lost its definiteness, which is asked below.
            let _ = filter.update(0.0, &[sample]);
        }
        if k % PICTURE == 0 {
            filter.propagate(DELAY_S);
            let seen: Vec<VisionSample> = points()
                .iter()
                .enumerate()
                .map(|(landmark, q)| {
                    let c = r.tr_mul(&(q - p)) + camera().body_in_camera;
                    let image = Vector3::new(noisy(c.x / c.z), noisy(c.y / c.z), 1.0);
                    VisionSample::Point { landmark, image }
                })
                .collect();
            let _ = filter.update(DELAY_S, &seen);
            record(t + DELAY_S, &filter);
            filter.propagate(IMU_S - DELAY_S);
        } else {
            filter.propagate(IMU_S);
        }
        if filter.definiteness() != Definiteness::Definite {
            return (out, filter.definiteness());
        }
        record(t + IMU_S, &filter);
    }
    (out, Definiteness::Definite)
}

/// The smallest γ, to 1 %, with which P stays definite over the scenario.
pub fn least_gamma(lambda: f64, camera_only: bool) -> f64 {
    let exists = |gamma: f64| {
        let discount = Discount { gamma, lambda };
        let what = PaperRun { discount, noise: 0.0, camera_only, duration_s: 40.0, seed: 0 };
        run(&what).1 == Definiteness::Definite
    };
    let (mut low, mut high) = (0.1, 1e3);
    while high / low > 1.01 {
        let middle = f64::sqrt(low * high);
        if exists(middle) { high = middle } else { low = middle }
    }
    high
}
