//! Heading from motion: a bank of small filters at hypothesised headings, for a vehicle without magnetometer and without flow.
//!
//! Gravity shows the tilt; north shows as soon as the vehicle accelerates horizontally, since the acceleration that the accelerometers
//! feel in body axes has to be the one that GNSS sees in NED. Far from the true heading that is no linear problem, so a single filter cannot be
//! started anywhere; a Gaussian sum can: N hypotheses ψ_i = 2π i/N, each of them an error-state Kalman filter over tilt, heading, horizontal
//! velocity and gyro bias (see `hypothesis`), and weighed by how likely it made the GNSS velocities z_k,
//!
//! w_i ∝ w_i · N(z_k − v_i; 0, S_i),  heading = Σ w_i ψ_i,  variance = Σ w_i (P_i + (ψ_i − ψ)²).
//!
//! Sources: Alspach, Sorenson, "Nonlinear Bayesian estimation using Gaussian sum approximations", IEEE TAC 17(4), 1972, (15)-(19), for the
//! weights and the moments; the use for the heading of a vehicle without compass follows the idea of PX4's EKF-GSF yaw estimator, which has three states
//! a hypothesis and takes the tilt from a complementary filter. Here the tilt is estimated, too: a complementary filter takes the
//! specific force of a banked turn for the vertical, and a bank that starts in one would never learn better.
//!
//! A fix is old when it comes, so the bank stays behind: samples wait in a ring until a fix of their time has come, and the estimate
//! is extrapolated over the rest when it is asked for. Nothing is allocated after construction. Core code: no clock, no chance.

mod hypothesis;
mod mixture;
mod tuning;

use std::collections::VecDeque;
use std::f64::consts::TAU;

use nalgebra::{Matrix2, Matrix3, Vector2, Vector3};

use super::jitter::Jitter;
use crate::geo::{polar_rotation, so3};
use crate::time::{AutopilotTime, Span};
use hypothesis::{Hypothesis, HypothesisSigma};
use mixture::{Moments, mean_velocity, normalise};
use tuning::{
    AHEAD_S, CORRELATION_S, COVARIANCE_STEP_S, DOUBTFUL_NIS, GATE_NIS, HYPOTHESES, LEAST_FORCE,
    LEAST_LEVELLING_S, LEAST_TILT, LEVELLING_S, LONGEST_GAP_S, MEAN_S, OUTLIERS, OVERLAP, WAITING,
};

/// Noise and what is known beforehand.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct HeadingBankSettings {
    /// IMU samples are the means of two instants, one of them shared with the sample before. What of a sample is white shows less in them.
    pub shared_instants: bool,
    /// Gyro noise density, rad/s/√Hz; covers what an accelerometer bias does to the tilt, too.
    pub gyro_noise: f64,
    /// The same that comes with rotation: density over angular rate, √s.
    pub gyro_rate_noise: f64,
    /// Accelerometer noise density, m/s²/√Hz.
    pub accel_noise: f64,
    /// Standard deviation of the gyro bias at the start, rad/s.
    pub gyro_bias_sigma: f64,
    /// Random walk of the gyro bias, rad/s/√s.
    pub gyro_bias_walk: f64,
    /// The heading is found when its standard deviation stays below this, rad …
    pub found_sigma: f64,
    /// … for this long, s.
    pub found_s: f64,
}

/// What the bank makes of it, at the time of the newest IMU sample.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct HeadingEstimate {
    /// Body → NED.
    pub r_body_to_ned: Matrix3<f64>,
    /// Velocity, north and east, m/s.
    pub velocity_ne: Vector2<f64>,
    /// Gyro bias, body, rad/s.
    pub gyro_bias: Vector3<f64>,
    /// Standard deviation of the heading, rad: 104° when nothing is known.
    pub heading_sigma: f64,
    /// Standard deviation of the tilt, the worse of both axes, rad.
    pub tilt_sigma: f64,
    /// Standard deviation of the velocity, the worse of both axes, m/s.
    pub velocity_sigma: f64,
    /// Standard deviation of the gyro bias, the worst axis, rad/s.
    pub gyro_bias_sigma: f64,
}

/// What became of a velocity.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[non_exhaustive]
pub enum BankVerdict {
    /// It weighed the hypotheses.
    Used,
    /// The bank started with it.
    Started,
    /// There is no attitude of its time yet, or no specific force to take one from.
    TooEarly,
    /// Older than what the bank has seen, or newer than the IMU.
    Untimely,
    /// Not finite, or far from what any hypothesis expected.
    Outlier,
}

/// An IMU sample that waits for a fix.
#[derive(Clone, Copy, Debug)]
struct Waiting {
    time: AutopilotTime,
    dt: f64,
    rate_body: Vector3<f64>,
    force_body: Vector3<f64>,
    /// Variance of a component from sample to sample: vibration.
    rate_variance: f64,
    force_variance: f64,
}

/// See the module's documentation.
#[derive(Clone, Debug)]
pub struct HeadingBank {
    settings: HeadingBankSettings,
    gravity_mps2: f64,
    waiting: VecDeque<Waiting>,
    jitter: Jitter,
    bank: Vec<Hypothesis>,
    /// The time the hypotheses stand at.
    time: AutopilotTime,
    last_fix: Option<AutopilotTime>,
    outliers: u32,
    mean_nis: f64,
    /// Mean rate of turn about the vertical, rad/s.
    turn_rate: f64,
    latency_sigma_s: f64,
    settled: Option<Settled>,
}

/// Since when the heading has been known, and by how much fixes have turned it since.
#[derive(Clone, Copy, Debug)]
struct Settled {
    since: AutopilotTime,
    turned: f64,
}

impl HeadingBank {
    /// A bank that has heard nothing; gravity in m/s².
    pub fn new(settings: HeadingBankSettings, gravity_mps2: f64) -> Self {
        Self {
            settings,
            gravity_mps2,
            waiting: VecDeque::with_capacity(WAITING),
            jitter: Jitter::default(),
            bank: Vec::with_capacity(HYPOTHESES),
            time: AutopilotTime::from_micros(0),
            last_fix: None,
            outliers: 0,
            mean_nis: 2.0,
            turn_rate: 0.0,
            latency_sigma_s: 0.0,
            settled: None,
        }
    }

    fn give_up(&mut self) {
        self.bank.clear();
        self.last_fix = None;
        self.outliers = 0;
        self.mean_nis = 2.0;
        self.turn_rate = 0.0;
        self.settled = None;
    }

    /// An IMU sample: means over the `dt` s before `time`, body axes.
    pub fn imu(&mut self, time: AutopilotTime, dt: f64, rate_body: &Vector3<f64>, force_body: &Vector3<f64>) {
        let newest = self.waiting.back().map_or(self.time, |w| w.time);
        let late = time <= newest && (self.is_running() || !self.waiting.is_empty());
        let finite = (rate_body.sum() + force_body.sum()).is_finite();
        if !finite || dt.is_nan() || dt <= 0.0 || late {
            return;
        }
        if self.waiting.len() >= WAITING
            && let Some(first) = self.waiting.pop_front()
            && self.is_running()
        {
            self.propagate(&first);
        }
        let (rate_variance, force_variance) =
            self.jitter.add(dt, rate_body, force_body, self.settings.shared_instants);
        self.waiting.push_back(Waiting {
            time,
            dt,
            rate_body: *rate_body,
            force_body: *force_body,
            rate_variance,
            force_variance,
        });
    }

    /// Whether the bank has started.
    pub fn is_running(&self) -> bool {
        !self.bank.is_empty()
    }

    /// A GNSS velocity of the time `measured` with its standard deviation a component, m/s, and that of its time, s.
    pub fn velocity(
        &mut self,
        measured: AutopilotTime,
        velocity_ne: &Vector2<f64>,
        sigma_mps: f64,
        latency_sigma_s: f64,
    ) -> BankVerdict {
        if !(velocity_ne.sum() + sigma_mps + latency_sigma_s).is_finite() {
            return BankVerdict::Outlier;
        }
        let Some(newest) = self.waiting.back().map(|w| w.time) else { return BankVerdict::TooEarly };
        if measured.seconds_since(newest) > AHEAD_S {
            return BankVerdict::Untimely;
        }
        let measured = measured.min(newest);
        self.latency_sigma_s = latency_sigma_s.max(0.0);
        if self.last_fix.is_some_and(|t| measured.seconds_since(t) > LONGEST_GAP_S) {
            self.give_up();
        }
        if !self.is_running() {
            return self.start(measured, velocity_ne, sigma_mps);
        }
        let since_fix = self.last_fix.map_or(0.0, |t| measured.seconds_since(t));
        if measured < self.time || since_fix <= 0.0 {
            return BankVerdict::Untimely;
        }
        let before = mean_velocity(&self.bank);
        self.advance(measured);
        let change = mean_velocity(&self.bank) - before;
        self.last_fix = Some(measured);
        // A misjudged latency is an error along the acceleration.
        let late = change * (self.latency_sigma_s / since_fix);
        let white = sigma_mps.powi(2) * (CORRELATION_S / since_fix).max(1.0);
        let noise = Matrix2::identity() * white + late * late.transpose();
        let Some(nis) = self.least_surprise(velocity_ne, &noise) else {
            self.give_up();
            return BankVerdict::Outlier;
        };
        if nis > GATE_NIS {
            self.outliers += 1;
            self.settled = None;
            if self.outliers >= OUTLIERS {
                self.give_up();
            }
            return BankVerdict::Outlier;
        }
        self.outliers = 0;
        self.mean_nis += (since_fix / MEAN_S).min(1.0) * (nis - self.mean_nis);
        self.weigh(velocity_ne, &noise);
        BankVerdict::Used
    }

    /// The newest estimate; `None` before the bank has started.
    pub fn estimate(&self) -> Option<HeadingEstimate> {
        let mut m = Moments::of(&self.bank)?;
        let (heading_sigma, tilt_sigma) =
            (self.heading_sigma_of(&m), worst(m.attitude.diagonal().xy().as_slice()));
        for w in &self.waiting {
            let half = so3::exp(&((w.rate_body - m.gyro_bias) * (0.5 * w.dt)));
            let middle = m.r_body_to_ned * half;
            m.velocity_ne += (middle * w.force_body).xy() * w.dt;
            m.r_body_to_ned = middle * half;
        }
        Some(HeadingEstimate {
            r_body_to_ned: polar_rotation(&m.r_body_to_ned)?,
            velocity_ne: m.velocity_ne,
            gyro_bias: m.gyro_bias,
            heading_sigma,
            tilt_sigma,
            velocity_sigma: worst(m.velocity.diagonal().as_slice()),
            gyro_bias_sigma: worst(m.bias.diagonal().as_slice()),
        })
    }

    /// The estimate, if the heading is found: its standard deviation has been small for a while, the fixes of that while have not turned
    /// it, and they were as likely as they should be.
    pub fn found(&self) -> Option<HeadingEstimate> {
        let settled = self.settled?;
        let long = self.time.seconds_since(settled.since) >= self.settings.found_s;
        if long && self.mean_nis < DOUBTFUL_NIS { self.estimate() } else { None }
    }

    /// Starts at the attitude that the specific force shows as if it were gravity; a specific force of another size says by how much it
    /// may not be: a banked turn and a multirotor that accelerates without climbing lean by acos(g/|f|).
    fn start(&mut self, measured: AutopilotTime, velocity_ne: &Vector2<f64>, sigma_mps: f64) -> BankVerdict {
        let from = measured - Span::from_seconds(LEVELLING_S);
        let mut sum = Vector3::zeros();
        let mut covered = 0.0;
        for w in self.waiting.iter().filter(|w| w.time > from && w.time <= measured) {
            sum += w.force_body * w.dt;
            covered += w.dt;
        }
        if covered < LEAST_LEVELLING_S {
            return BankVerdict::TooEarly;
        }
        let force = sum / covered;
        let Some(level) = levelled(&force).filter(|_| force.norm() > LEAST_FORCE * self.gravity_mps2) else {
            return BankVerdict::TooEarly;
        };
        let lean = (self.gravity_mps2 / force.norm()).min(1.0).acos();
        let spacing = TAU / HYPOTHESES as f64;
        let sigma = HypothesisSigma {
            tilt: LEAST_TILT + lean,
            heading: OVERLAP * spacing,
            velocity: sigma_mps,
            gyro_bias: self.settings.gyro_bias_sigma,
        };
        self.bank.extend((0..HYPOTHESES).map(|i| {
            let turn = so3::exp(&Vector3::new(0.0, 0.0, spacing * i as f64));
            Hypothesis::new(turn * level, *velocity_ne, &sigma)
        }));
        while self.waiting.front().is_some_and(|w| w.time <= measured) {
            self.waiting.pop_front();
        }
        if let Some(first) = self.waiting.front_mut() {
            first.dt = first.dt.min(first.time.seconds_since(measured));
        }
        self.time = measured;
        self.last_fix = Some(measured);
        BankVerdict::Started
    }

    /// Moves the hypotheses to `to`, which the newest sample has reached.
    fn advance(&mut self, to: AutopilotTime) {
        while let Some(first) = self.waiting.front().copied() {
            if first.time <= to {
                self.waiting.pop_front();
                self.propagate(&first);
                continue;
            }
            let part = to.seconds_since(self.time).min(first.dt);
            if part > 0.0 {
                self.propagate(&Waiting { time: to, dt: part, ..first });
                if let Some(rest) = self.waiting.front_mut() {
                    rest.dt -= part;
                }
            }
            break;
        }
        for h in &mut self.bank {
            h.propagate_covariance(&self.settings);
        }
    }

    fn propagate(&mut self, w: &Waiting) {
        for h in &mut self.bank {
            h.propagate(w, &self.settings);
        }
        if let Some(h) = self.bank.first() {
            let turn_rate = h.r_body_to_ned.row(2).dot(&(w.rate_body - h.gyro_bias).transpose());
            self.turn_rate += (w.dt / MEAN_S).min(1.0) * (turn_rate - self.turn_rate);
        }
        self.time = w.time;
        if self.last_fix.is_some_and(|t| self.time.seconds_since(t) > COVARIANCE_STEP_S) {
            for h in &mut self.bank {
                h.propagate_covariance(&self.settings);
            }
        }
    }

    fn least_surprise(&self, velocity_ne: &Vector2<f64>, noise: &Matrix2<f64>) -> Option<f64> {
        self.bank.iter().filter_map(|h| h.surprise(velocity_ne, noise)).map(|(nis, _)| nis).reduce(f64::min)
    }

    fn weigh(&mut self, velocity_ne: &Vector2<f64>, noise: &Matrix2<f64>) {
        let before = Moments::of(&self.bank);
        for h in &mut self.bank {
            h.fuse(velocity_ne, noise);
        }
        if !self.bank.iter().all(Hypothesis::is_finite) {
            return self.give_up();
        }
        normalise(&mut self.bank);
        let (Some(before), Some(after)) = (before, Moments::of(&self.bank)) else { return };
        if self.heading_sigma_of(&after) > self.settings.found_sigma {
            self.settled = None;
            return;
        }
        let turned = twist(&(after.r_body_to_ned * before.r_body_to_ned.transpose()));
        let settled = self.settled.get_or_insert(Settled { since: self.time, turned: 0.0 });
        settled.turned += turned;
        if settled.turned.abs() > self.settings.found_sigma {
            self.settled = None;
        }
    }

    /// A velocity that is late by δ in a turn at Ω is the velocity of a vehicle whose heading is off by Ω δ: no likelihood tells these apart.
    fn heading_sigma_of(&self, m: &Moments) -> f64 {
        m.attitude[(2, 2)].max(0.0).sqrt().hypot(self.turn_rate * self.latency_sigma_s)
    }
}

/// The least rotation that turns the specific force upwards; `None` for none, or when the vehicle hangs on its back exactly.
fn levelled(force_body: &Vector3<f64>) -> Option<Matrix3<f64>> {
    let up = -Vector3::z();
    let direction = force_body.try_normalize(1e-6)?;
    let axis = direction.cross(&up);
    let angle = axis.norm().atan2(direction.dot(&up));
    match axis.try_normalize(1e-9) {
        Some(axis) => Some(so3::exp(&(axis * angle))),
        None => (direction.z < 0.0).then(Matrix3::identity),
    }
}

/// The rotation about the vertical in a small rotation, rad.
fn twist(r: &Matrix3<f64>) -> f64 {
    (r.m21 - r.m12).atan2(r.m11 + r.m22)
}

fn worst(variances: &[f64]) -> f64 {
    variances.iter().copied().fold(0.0, f64::max).sqrt()
}
