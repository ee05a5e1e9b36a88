//! A step in what a receiver's velocity differs by from inertia, by least squares: the best of all moments, beside the best kink.
//!
//! d = v_GNSS − I = c + a t + ψ J I + ε I + τ İ + s·1(t ≥ θ): c and a, what tilt and biases make; ψ, ε and τ, a heading that is off, a scale and a delay of what was felt, which turn every
//! change of velocity into something like a step. They are taken out by an orthonormal basis once, and s is fitted to what is left for every θ.

use nalgebra::{Matrix2, Vector2};

use crate::navigator::tuning::velocity_step::{
    LEAST_NOISE_MPS, OLDEST_S, SAMPLES, WINDOW_S, YOUNG_FIXES, YOUNGEST_S,
};
use crate::time::AutopilotTime;

/// A fix with its d.
#[derive(Clone, Copy, Debug)]
pub(super) struct FixWithImpulse {
    pub(super) time: AutopilotTime,
    pub(super) difference: Vector2<f64>,
    pub(super) velocity: Vector2<f64>,
}

impl FixWithImpulse {
    /// I, which a lie is no part of.
    pub(super) fn impulse(&self) -> Vector2<f64> {
        self.velocity - self.difference
    }
}

/// A step at a time.
#[derive(Clone, Copy, Debug)]
pub(super) struct VelocityStep {
    pub(super) since: AutopilotTime,
    pub(super) size: Vector2<f64>,
    /// What it explains of Σ|d − c − a t|², (m/s)², what the best kink does, and what the step leaves.
    pub(super) gain: f64,
    pub(super) kink: f64,
    pub(super) left: f64,
}

/// The best steps: of those that are old enough to be told from a manoeuvre, and of younger ones; and what there is to explain, (m/s)².
#[derive(Clone, Copy, Debug)]
pub(super) struct FittedSteps {
    pub(super) steps: [Option<VelocityStep>; 2],
    pub(super) plain: f64,
    /// Mean square of the acceleration that was felt, m²/s⁴.
    pub(super) manoeuvre: f64,
}

/// Numbers that are fitted whatever happened: c and a on both axes, and a turn, a scale and a delay of what was felt.
pub(super) const NUISANCES: usize = 7;

/// The best step of those that are old enough, and of those that are younger.
pub(super) fn best_steps(felt: &[FixWithImpulse], now: AutopilotTime) -> Option<FittedSteps> {
    let first = felt.first()?;
    if now.seconds_since(first.time) < 0.6 * WINDOW_S {
        return None;
    }
    let rest = Residuals::of(felt)?;
    let plain = rest.of_differences.iter().map(Vector2::norm_squared).sum::<f64>();
    let (mut steps, mut kinks) = ([None::<VelocityStep>; 2], [0.0f64; 2]);
    let mut later = LaterFixes::default();
    for (k, onset) in felt.windows(2).enumerate().rev() {
        let (before, since) = (onset[0].time, onset[1].time);
        later.add(&rest, k + 1, since.seconds_since(first.time));
        let age = now.seconds_since(since);
        let several = felt.len() - 1 - k >= YOUNG_FIXES;
        let which = match age {
            age if (YOUNGEST_S..OLDEST_S).contains(&age) => 0,
            age if several && age < YOUNGEST_S => 1,
            _ => continue,
        };
        kinks[which] = kinks[which].max(later.explained(-before.seconds_since(first.time), 1.0).1);
        let (size, gain) = later.explained(1.0, 0.0);
        if steps[which].is_none_or(|b| gain >= b.gain) {
            let left = (plain - gain).max(0.0);
            steps[which] = Some(VelocityStep { since: before, size, gain, kink: 0.0, left });
        }
    }
    for (step, kink) in steps.iter_mut().zip(kinks) {
        if let Some(step) = step {
            step.kink = kink;
        }
    }
    Some(FittedSteps { steps, plain, manoeuvre: manoeuvre(felt) })
}

fn manoeuvre(felt: &[FixWithImpulse]) -> f64 {
    let squares = (0..felt.len()).map(|at| acceleration(felt, at).norm_squared()).sum::<f64>();
    squares / felt.len().max(1) as f64
}

/// İ at a fix, from its neighbours, m/s².
fn acceleration(felt: &[FixWithImpulse], at: usize) -> Vector2<f64> {
    let (before, after) = (at.saturating_sub(1), (at + 1).min(felt.len().saturating_sub(1)));
    let (before, after) = (&felt[before], &felt[after]);
    (after.impulse() - before.impulse()) / after.time.seconds_since(before.time).max(1e-3)
}

/// What is left of the differences when c, a, a turn ψ and a scale ε of the change of velocity are taken out, d = c + a t + ψ J I + ε I + τ İ, and an orthonormal
/// basis of those, by fixes.
struct Residuals {
    basis: [[Vector2<f64>; SAMPLES]; NUISANCES],
    /// So many of them.
    used: usize,
    of_differences: [Vector2<f64>; SAMPLES],
}

impl Residuals {
    fn of(felt: &[FixWithImpulse]) -> Option<Self> {
        let n = felt.len() as f64;
        let from = felt.first()?.time;
        let mean = felt.iter().map(FixWithImpulse::impulse).sum::<Vector2<f64>>() / n;
        let zero = Vector2::zeros();
        let (basis, of_differences) = ([[zero; SAMPLES]; NUISANCES], [zero; SAMPLES]);
        let mut rest = Self { basis, used: 0, of_differences };
        for k in 0..NUISANCES {
            let mut column = [zero; SAMPLES];
            for (at, (value, f)) in column.iter_mut().zip(felt).enumerate() {
                let (t, v) = (f.time.seconds_since(from), f.impulse() - mean);
                *value = match k {
                    0 => Vector2::x(),
                    1 => Vector2::y(),
                    2 => Vector2::x() * t,
                    3 => Vector2::y() * t,
                    4 => Vector2::new(-v.y, v.x),
                    5 => v,
                    _ => acceleration(felt, at),
                };
            }
            let before = column.iter().map(Vector2::norm_squared).sum::<f64>();
            rest.take_out(&mut column);
            let left = column.iter().map(Vector2::norm_squared).sum::<f64>();
            // Who flies straight on says nothing of turn and scale.
            if left > 1e-3 * before && left > LEAST_NOISE_MPS {
                rest.basis[rest.used] = column.map(|value| value / left.sqrt());
                rest.used += 1;
            }
        }
        for (value, f) in rest.of_differences.iter_mut().zip(felt) {
            *value = f.difference - felt[0].difference;
        }
        let mut differences = rest.of_differences;
        rest.take_out(&mut differences);
        rest.of_differences = differences;
        Some(rest)
    }

    /// What is orthogonal to all that are taken so far.
    fn take_out(&self, column: &mut [Vector2<f64>; SAMPLES]) {
        for basis in &self.basis[..self.used] {
            let along: f64 = basis.iter().zip(column.iter()).map(|(b, c)| b.dot(c)).sum();
            for (value, b) in column.iter_mut().zip(basis) {
                *value -= b * along;
            }
        }
    }
}

/// Sums over the fixes of an onset and later, of which every u = α + β t that begins there is made: no onset needs a pass of its own.
#[derive(Default)]
struct LaterFixes {
    /// Σ 1, Σ t and Σ t².
    powers: [f64; 3],
    /// Σ b and Σ b t of every vector of the basis, and the same of the residuals.
    basis: [[Vector2<f64>; 2]; NUISANCES],
    residuals: [Vector2<f64>; 2],
}

impl LaterFixes {
    /// One more, the one before those that are in.
    fn add(&mut self, rest: &Residuals, at: usize, t: f64) {
        for (sum, power) in self.powers.iter_mut().zip([1.0, t, t * t]) {
            *sum += power;
        }
        for (sums, basis) in self.basis.iter_mut().zip(&rest.basis) {
            sums[0] += basis[at];
            sums[1] += basis[at] * t;
        }
        self.residuals[0] += rest.of_differences[at];
        self.residuals[1] += rest.of_differences[at] * t;
    }

    /// s, NE, of d = … + s u with u = α + β t, and what that explains: with p = Σ b u of every vector b of the basis, (I Σ u² − Σ p pᵀ) s = Σ r u.
    fn explained(&self, alpha: f64, beta: f64) -> (Vector2<f64>, f64) {
        let [ones, times, squares] = self.powers;
        let square = alpha * alpha * ones + 2.0 * alpha * beta * times + beta * beta * squares;
        let by_u = |sums: &[Vector2<f64>; 2]| sums[0] * alpha + sums[1] * beta;
        let normal =
            self.basis.iter().map(by_u).fold(Matrix2::identity() * square, |n, p| n - p * p.transpose());
        let right = by_u(&self.residuals);
        let size = normal.try_inverse().map_or(Vector2::zeros(), |inverse| inverse * right);
        (size, size.dot(&right).max(0.0))
    }
}
