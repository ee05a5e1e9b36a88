//! How well the motion of image features gives the velocity: six parameters against three, and what outliers do.
//!
//! `cargo run --release --example flow_solve -- [--trials 400] [--seed 1]`

#![allow(clippy::print_stdout, reason = "the table is what it is for")]

use clap::Parser;
use holdover::camera::{
    Feature, FlowRefusal, Method, SixSolution, SolveLimits, SolveNoise, VelocitySolution, View, ground_point,
    solve_six, solve_velocity,
};
use holdover::geo::CameraMount;
use holdover::geo::so3::{self, Euler};
use nalgebra::{Matrix3, Vector2, Vector3};
use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;
use rand_distr::{Distribution, StandardNormal};

/// A camera that flies over flat ground and tracks features from one image to the next.
#[derive(Clone, Copy, Debug)]
pub struct Scene {
    /// Focal length, pixels.
    pub focal_px: f64,
    /// Horizontal field of view, degrees; vertically three quarters of the image's width.
    pub field_deg: f64,
    /// Features.
    pub features: usize,
    /// Height, m.
    pub height_m: f64,
    /// Between the two images, s.
    pub dt_s: f64,
    /// Noise of a displacement, pixels.
    pub noise_px: f64,
    /// Part of the features that are tracked wrongly, by `wrong_px` (1 sigma).
    pub wrong: f64,
    /// Displacement of those, pixels.
    pub wrong_px: f64,
    /// Velocity and angular rate, body axes.
    pub velocity: Vector3<f64>,
    /// Angular rate, rad/s.
    pub rate: Vector3<f64>,
}

/// The camera, height, rate and noise of the specification's numbers.
pub const SCENE: Scene = Scene {
    focal_px: 740.0,
    field_deg: 60.0,
    features: 40,
    height_m: 125.0,
    dt_s: 0.1,
    noise_px: 0.3,
    wrong: 0.0,
    wrong_px: 10.0,
    velocity: Vector3::new(25.0, 0.0, 0.0),
    rate: Vector3::new(0.05, 0.05, 0.1),
};

/// What the camera saw.
#[derive(Clone, Debug)]
pub struct Seen {
    /// The view in the middle of the interval.
    pub view: View,
    /// Positions in the two images.
    pub tracks: Vec<(Vector2<f64>, Vector2<f64>)>,
}

impl Scene {
    /// Two images of the ground, exactly projected, then with the tracker's noise.
    pub fn look(&self, rng: &mut ChaCha8Rng) -> Seen {
        let mut normal = || -> f64 { StandardNormal.sample(rng) };
        let middle = Euler::new(0.07 * normal(), 0.07 * normal(), 0.0).to_rotation();
        let half = self.focal_px * (0.5 * self.field_deg.to_radians()).tan();
        let down = CameraMount::downward();
        let view_of = |r: &Matrix3<f64>, height| View::mounted(self.focal_px, &down, r, height);
        let view = view_of(&middle, self.height_m);
        let mut tracks = Vec::with_capacity(self.features);
        let turn = so3::exp(&(self.rate * (0.5 * self.dt_s)));
        let move_ned = middle * self.velocity * (0.5 * self.dt_s);
        while tracks.len() < self.features {
            let image = Vector2::new(rng.random_range(-half..half), 0.75 * rng.random_range(-half..half));
            let Ok(point) = ground_point(&view, &image) else { continue };
            let ground = middle * point;
            let (r0, r1) = (middle * turn.transpose(), middle * turn);
            let first = view_of(&r0, 0.0).project(&r0.tr_mul(&(ground + move_ned)));
            let mut second = view_of(&r1, 0.0).project(&r1.tr_mul(&(ground - move_ned)));
            let sigma = if rng.random_bool(self.wrong) { self.wrong_px } else { self.noise_px };
            let noise = Vector2::from_fn(|_, _| StandardNormal.sample(rng));
            second += noise * sigma;
            tracks.push((first, second));
        }
        Seen { view, tracks }
    }

    /// The noise of the flow, pixels a second.
    pub fn noise(&self) -> SolveNoise {
        SolveNoise { flow: self.noise_px / self.dt_s, height_m: 0.0, rate_radps: 0.0 }
    }

    /// Three parameters, M in the middle of the interval.
    ///
    /// # Errors
    /// As [`solve_velocity`].
    pub fn three(&self, seen: &Seen, method: Method) -> Result<VelocitySolution, FlowRefusal> {
        let features: Vec<Feature> =
            seen.tracks.iter().map(|(a, b)| Feature::between(a, b, self.dt_s)).collect();
        let limits = SolveLimits { max_residual: f64::INFINITY, ..SolveLimits::default() };
        solve_velocity(&seen.view, &features, &self.rate, None, method, &self.noise(), &limits)
    }

    /// Six parameters.
    ///
    /// # Errors
    /// As [`solve_six`].
    pub fn six(&self, seen: &Seen) -> Result<SixSolution, FlowRefusal> {
        let features: Vec<Feature> =
            seen.tracks.iter().map(|(a, b)| Feature::between(a, b, self.dt_s)).collect();
        let limits = SolveLimits { max_condition: 1e4, ..SolveLimits::default() };
        solve_six(&seen.view, &features, &self.noise(), &limits)
    }

    /// Three parameters, M where the features were in the first image.
    ///
    /// # Errors
    /// As [`solve_velocity`].
    pub fn three_at_first(&self, seen: &Seen) -> Result<VelocitySolution, FlowRefusal> {
        let first = |(a, b): &(Vector2<f64>, Vector2<f64>)| Feature { image: *a, flow: (b - a) / self.dt_s };
        let features: Vec<Feature> = seen.tracks.iter().map(first).collect();
        let limits = SolveLimits::default();
        solve_velocity(&seen.view, &features, &self.rate, None, Method::LeastSquares, &self.noise(), &limits)
    }
}

/// Errors of many trials.
#[derive(Clone, Copy, Debug, Default)]
pub struct Score {
    squares: Vector3<f64>,
    sum: Vector3<f64>,
    condition: f64,
    nees: f64,
    trials: f64,
}

impl Score {
    /// Adds a trial.
    pub fn add(&mut self, error: &Vector3<f64>, covariance: &Matrix3<f64>, condition: f64) {
        self.squares += error.component_mul(error);
        self.sum += error;
        self.condition += condition;
        self.nees += covariance.cholesky().map_or(f64::INFINITY, |c| error.dot(&c.solve(error)));
        self.trials += 1.0;
    }

    /// Root mean square errors along x, y and z, m/s.
    pub fn rms(&self) -> Vector3<f64> {
        (self.squares / self.trials).map(f64::sqrt)
    }

    /// Mean errors, m/s.
    pub fn mean(&self) -> Vector3<f64> {
        self.sum / self.trials
    }

    /// Mean condition number.
    pub fn condition(&self) -> f64 {
        self.condition / self.trials
    }

    /// Mean squared error over the covariance that was claimed; 1 is honest, more is over-confident.
    pub fn nees(&self) -> f64 {
        self.nees / (3.0 * self.trials)
    }
}

/// Scores a three-parameter solve over many trials.
pub fn score_three(scene: &Scene, method: Method, trials: u32, seed: u64) -> Score {
    let mut rng = ChaCha8Rng::seed_from_u64(seed);
    let mut score = Score::default();
    for _ in 0..trials {
        let seen = scene.look(&mut rng);
        if let Ok(out) = scene.three(&seen, method) {
            score.add(&(out.velocity_camera - scene.velocity), &out.covariance, out.condition);
        }
    }
    score
}

/// Scores the six-parameter solve over many trials.
pub fn score_six(scene: &Scene, trials: u32, seed: u64) -> Score {
    let mut rng = ChaCha8Rng::seed_from_u64(seed);
    let mut score = Score::default();
    for _ in 0..trials {
        let seen = scene.look(&mut rng);
        if let Ok(out) = scene.six(&seen) {
            let covariance = out.covariance.fixed_view::<3, 3>(0, 0).into_owned();
            score.add(&(out.velocity_camera - scene.velocity), &covariance, out.condition);
        }
    }
    score
}

/// Mean lateral error with M in the middle of the interval and at its beginning, in a turn, m/s.
pub fn score_middle(trials: u32, seed: u64) -> [f64; 2] {
    let scene = Scene { rate: Vector3::new(0.0, 0.0, 0.27), ..SCENE };
    let mut rng = ChaCha8Rng::seed_from_u64(seed);
    let mut out = [Score::default(), Score::default()];
    for _ in 0..trials {
        let seen = scene.look(&mut rng);
        for (score, solved) in
            out.iter_mut().zip([scene.three(&seen, Method::LeastSquares), scene.three_at_first(&seen)])
        {
            if let Ok(s) = solved {
                score.add(&(s.velocity_camera - scene.velocity), &s.covariance, s.condition);
            }
        }
    }
    out.map(|s| s.mean().y.abs())
}

#[derive(Parser)]
struct Arguments {
    /// Images a row.
    #[arg(long, default_value_t = 400, value_parser = clap::value_parser!(u32).range(1..))]
    trials: u32,
    /// Seed of the noise.
    #[arg(long, default_value_t = 1)]
    seed: u64,
}

fn row(name: &str, score: &Score) {
    let rms = score.rms();
    let numbers = format!("{:7.2} {:7.2} {:7.2}", rms.x, rms.y, rms.z);
    println!("  {name:<38}{numbers} {:10.1} {:13.2}", score.condition(), score.nees());
}

fn main() {
    let Arguments { trials, seed } = Arguments::parse();
    println!("Root mean square error of the velocity, m/s: 40 features, 0.3 px, 10 Hz, 125 m, 25 m/s");
    println!("  {:<38}{:>7} {:>7} {:>7} {:>10} {:>13}", "", "x", "y", "z", "condition", "error²/claim²");
    let narrow = Scene { field_deg: 25.0, ..SCENE };
    row("six parameters, field of view 60°", &score_six(&SCENE, trials, seed));
    row("six parameters, 25°", &score_six(&narrow, trials, seed));
    let least = Method::LeastSquares;
    row("three parameters (gyros), 60°", &score_three(&SCENE, least, trials, seed));
    row("three parameters (gyros), 25°", &score_three(&narrow, least, trials, seed));
    let wrong = Scene { wrong: 0.3, ..SCENE };
    row("30 % outliers, least squares", &score_three(&wrong, least, trials, seed));
    row("30 % outliers, Huber", &score_three(&wrong, Method::HUBER, trials, seed));
    row("30 % outliers, RANSAC and Huber", &score_three(&wrong, Method::RANSAC, trials, seed));
    let [middle, first] = score_middle(trials, seed);
    println!(
        "  In a turn of 15°/s the mean lateral error is {middle:.2} m/s with M in the middle of the interval,"
    );
    println!("  {first:.2} m/s with M where the features were in the first image.");
}
