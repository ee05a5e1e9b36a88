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
    for (k, onset) in felt.windows(2).enumerate() {
        let (before, since) = (onset[0].time, onset[1].time);
        let age = now.seconds_since(since);
        let several = felt.len() - 1 - k >= YOUNG_FIXES;
        let which = match age {
            age if (YOUNGEST_S..OLDEST_S).contains(&age) => 0,
            age if several && age < YOUNGEST_S => 1,
            _ => continue,
        };
        let bend = |f: &FixWithImpulse| f.time.seconds_since(before).max(0.0);
        kinks[which] = kinks[which].max(rest.explained(felt, bend).1);
        let (size, gain) = rest.explained(felt, |f| f64::from(u8::from(f.time >= since)));
        if steps[which].is_none_or(|b| gain > b.gain) {
            let left = (plain - gain).max(0.0);
            steps[which] = Some(VelocityStep { since: before, size, gain, kink: 0.0, left });
        }
    }
    for (step, kink) in steps.iter_mut().zip(kinks) {
        if let Some(step) = step {
            step.kink = kink;
        }
    }
    Some(FittedSteps { steps, plain })
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
    of_differences: [Vector2<f64>; SAMPLES],
}

impl Residuals {
    fn of(felt: &[FixWithImpulse]) -> Option<Self> {
        let n = felt.len() as f64;
        let from = felt.first()?.time;
        let mean = felt.iter().map(FixWithImpulse::impulse).sum::<Vector2<f64>>() / n;
        let zero = Vector2::zeros();
        let mut rest = Self { basis: [[zero; SAMPLES]; NUISANCES], of_differences: [zero; SAMPLES] };
        let mut used = 0;
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
                rest.basis[used] = column.map(|value| value / left.sqrt());
                used += 1;
            }
        }
        let mut differences = [zero; SAMPLES];
        for (value, f) in differences.iter_mut().zip(felt) {
            *value = f.difference - felt[0].difference;
        }
        rest.take_out(&mut differences);
        rest.of_differences = differences;
        Some(rest)
    }

    /// What is orthogonal to all that are taken so far.
    fn take_out(&self, column: &mut [Vector2<f64>; SAMPLES]) {
        for basis in &self.basis {
            let along: f64 = basis.iter().zip(column.iter()).map(|(b, c)| b.dot(c)).sum();
            for (value, b) in column.iter_mut().zip(basis) {
                *value -= b * along;
            }
        }
    }

    /// s, NE, of d = … + s u, and what that explains.
    fn explained(&self, felt: &[FixWithImpulse], u: impl Fn(&FixWithImpulse) -> f64) -> (Vector2<f64>, f64) {
        let column = |axis: Vector2<f64>| {
            let mut column = [Vector2::zeros(); SAMPLES];
            for (value, f) in column.iter_mut().zip(felt) {
                *value = axis * u(f);
            }
            self.take_out(&mut column);
            column
        };
        let dot = |a: &[Vector2<f64>; SAMPLES], b: &[Vector2<f64>; SAMPLES]| -> f64 {
            a.iter().zip(b).map(|(a, b)| a.dot(b)).sum()
        };
        let (north, east) = (column(Vector2::x()), column(Vector2::y()));
        let normal =
            Matrix2::new(dot(&north, &north), dot(&north, &east), dot(&north, &east), dot(&east, &east));
        let right = Vector2::new(dot(&north, &self.of_differences), dot(&east, &self.of_differences));
        let size = normal.try_inverse().map_or(Vector2::zeros(), |inverse| inverse * right);
        (size, size.dot(&right).max(0.0))
    }
}
