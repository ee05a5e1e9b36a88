//! Whether a receiver's velocity steps where inertia feels nothing: so begins a lie that walks off with position and velocity together.
//!
//! With I the inertial acceleration that has added up, d = v_GNSS − I of an honest receiver is c + a t over some seconds: a is what tilt and biases are wrong
//! by. A vehicle cannot change its velocity without a force, so that a step s at a time θ, d = c + a t + s·1(t > θ), is the receiver's. What a tilt or an accelerometer
//! that goes wrong makes is a kink, d = c + a t + k·(t − θ)₊. Both are fitted by least squares for every θ of the last seconds; the step is a lie where it
//! explains more than is usual for this receiver ([`UsualSpread`]), more than any kink does, and more than a heading that is off makes of the change of velocity.
//!
//! A lie stands until the velocity steps back, or until whatever else carries knows the velocity well enough to see that GNSS agrees with it again, or
//! until nothing is known any more.

use nalgebra::{Matrix3, Vector2, Vector3};

use super::usual::UsualSpread;
use crate::navigator::tuning::velocity_step::{
    BACK, BACK_S, CLEAR_OF, DECADES, FIRM, HOLE_S, KNOWN, LEARN_S, LEARNED, LEAST_MPS, LEAST_NOISE_MPS,
    MEMORY, NOISE_GAIN, OLDEST_S, OTHERWISE_BENT, SAMPLES, SPACING_S, SPREAD, START_NOISE_MPS, WINDOW_S,
    YOUNGEST_S,
};
use crate::time::{AutopilotTime, Span};

/// What is compared at a fix, NE, m/s.
#[derive(Clone, Copy, Debug)]
pub(in super::super) struct FeltVelocity {
    pub(in super::super) time: AutopilotTime,
    pub(in super::super) velocity: Vector2<f64>,
    pub(in super::super) impulse: Vector2<f64>,
    /// Changes when the impulse begins anew.
    pub(in super::super) epoch: u32,
    /// How well the heading is known, rad.
    pub(in super::super) yaw_sigma: f64,
    /// GNSS is navigated on, and inertia is sound.
    pub(in super::super) judged: bool,
    /// Against the estimate, which other sources carry, and how well that is known, m/s.
    pub(in super::super) error: Option<Vector2<f64>>,
    pub(in super::super) sigma: f64,
}

/// A velocity that is a lie.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(in super::super) struct VelocityLie {
    /// When it began.
    pub(in super::super) since: AutopilotTime,
    /// NE, m/s.
    step: Vector2<f64>,
}

/// A fix with its d.
#[derive(Clone, Copy, Debug)]
struct Felt {
    time: AutopilotTime,
    difference: Vector2<f64>,
    velocity: Vector2<f64>,
}

/// A step at a time.
#[derive(Clone, Copy, Debug)]
struct Step {
    since: AutopilotTime,
    size: Vector2<f64>,
    /// What it explains of Σ|d − c − a t|², (m/s)², and what it leaves.
    gain: f64,
    left: f64,
    /// Change of the velocity meanwhile, m/s.
    moved: f64,
}

/// See the module's documentation.
#[derive(Clone, Debug)]
pub(in super::super) struct VelocitySteps {
    /// Oldest first.
    felt: Vec<Felt>,
    epoch: u32,
    /// Variance of d on an axis, (m/s)².
    noise: f64,
    usual: UsualSpread,
    learned: u32,
    learn_due: Option<AutopilotTime>,
    lie: Option<VelocityLie>,
    /// For how long GNSS has agreed with what carries, s.
    agrees_since: Option<AutopilotTime>,
}

impl VelocitySteps {
    pub(in super::super) fn new() -> Self {
        Self {
            felt: Vec::with_capacity(SAMPLES),
            epoch: 0,
            noise: START_NOISE_MPS * START_NOISE_MPS,
            usual: UsualSpread::expecting(SPREAD, FIRM),
            learned: 0,
            learn_due: None,
            lie: None,
            agrees_since: None,
        }
    }

    /// What is held against the receiver.
    pub(in super::super) fn lie(&self) -> Option<&VelocityLie> {
        self.lie.as_ref()
    }

    /// Nothing is known of this receiver any more, or nothing that could judge it.
    pub(in super::super) fn forget(&mut self) {
        self.felt.clear();
        self.lie = None;
        self.agrees_since = None;
    }

    /// A fix that is sound in itself.
    pub(in super::super) fn observe(&mut self, s: &FeltVelocity) {
        let hole = self.felt.last().is_some_and(|f| !(0.0..HOLE_S).contains(&s.time.seconds_since(f.time)));
        if s.epoch != self.epoch || hole {
            self.felt.clear();
            self.epoch = s.epoch;
        }
        if self.felt.last().is_some_and(|f| s.time.seconds_since(f.time) < SPACING_S) {
            return;
        }
        if self.felt.len() == SAMPLES {
            self.felt.remove(0);
        }
        self.felt.push(Felt {
            time: s.time,
            difference: s.velocity - s.impulse,
            velocity: s.velocity,
        });
        self.felt.retain(|f| s.time.seconds_since(f.time) < WINDOW_S);
        match self.lie {
            None if s.judged => self.judge(s),
            None => {}
            Some(lie) => self.come_back(s, &lie),
        }
    }

    fn judge(&mut self, s: &FeltVelocity) {
        let Some((step, kink, plain)) = self.fit(s.time) else { return };
        let noise = self.noise.max(LEAST_NOISE_MPS * LEAST_NOISE_MPS);
        let square = step.gain / noise;
        // A heading that is off turns what was felt against what was seen.
        let turned = (s.yaw_sigma.hypot(OTHERWISE_BENT) * step.moved).powi(2);
        let known = step.size.norm_squared() / (step.size.norm_squared() + turned * self.usual.limit(DECADES));
        let unit = self.usual.variance().max(1.0);
        if std::env::var("VD").is_ok() { eprintln!("V {:.1} sq {:.1} known {:.2} lim {:.1} noise {:.3} size {:.2} moved {:.1} kink {:.1} left {:.1} learned {}", s.time.seconds_since(AutopilotTime::from_micros(0)), square, known, self.usual.limit(DECADES), noise.sqrt(), step.size.norm(), step.moved, kink/noise, step.left/noise, self.learned); }
        let found = self.learned >= LEARNED
            && known * square > self.usual.limit(DECADES)
            && known > 0.5
            && step.size.norm() > LEAST_MPS
            && (step.gain - kink) / noise > CLEAR_OF * unit
            && step.left < step.gain;
        if found {
            self.lie = Some(VelocityLie { since: step.since, step: step.size });
            self.agrees_since = None;
            return;
        }
        let degrees = (2 * self.felt.len()).saturating_sub(4).max(1) as f64;
        self.noise += NOISE_GAIN * ((plain / degrees).min(9.0 * noise) - self.noise);
        if self.learn_due.is_none_or(|due| s.time >= due) {
            self.learn_due = Some(s.time + Span::from_seconds(LEARN_S));
            self.learned = self.learned.saturating_add(1);
            self.usual.learn((known * square).min(self.usual.limit(DECADES)), MEMORY);
        }
    }

    /// Whether the lie has ended.
    fn come_back(&mut self, s: &FeltVelocity, lie: &VelocityLie) {
        let stepped_back = self.fit(s.time).is_some_and(|(step, ..)| {
            (step.size + lie.step).norm() < BACK * lie.step.norm() && step.gain > step.left
        });
        // What carries knows better than half the step.
        let known = s.sigma < KNOWN * lie.step.norm();
        let agrees = s.error.is_some_and(|e| known && e.norm() < BACK * lie.step.norm());
        self.agrees_since = if agrees { self.agrees_since.or(Some(s.time)) } else { None };
        if stepped_back || self.agrees_since.is_some_and(|t| s.time.seconds_since(t) > BACK_S) {
            self.forget();
        }
    }

    /// The best step, what the best kink explains, and what neither leaves, (m/s)².
    fn fit(&self, now: AutopilotTime) -> Option<(Step, f64, f64)> {
        let first = self.felt.first()?;
        if now.seconds_since(first.time) < 0.6 * WINDOW_S {
            return None;
        }
        let plain = self.least_squares(|_| 0.0)?.1;
        let mut best: Option<Step> = None;
        let mut kink = 0.0f64;
        for onset in self.felt.windows(2) {
            let since = onset[1].time;
            let age = now.seconds_since(since);
            if !(YOUNGEST_S..OLDEST_S).contains(&age) {
                continue;
            }
            let after = |t: AutopilotTime| t.seconds_since(since) >= 0.0;
            let bent = |t: AutopilotTime| t.seconds_since(onset[0].time).max(0.0);
            kink = kink.max(plain - self.least_squares(bent)?.1);
            let (size, left) = self.least_squares(|t| f64::from(u8::from(after(t))))?;
            let gain = plain - left;
            if best.is_none_or(|b| gain > b.gain) {
                let moved = self.felt.iter().map(|f| (f.velocity - onset[0].velocity).norm());
                best = Some(Step { since: onset[0].time, size, gain, left, moved: moved.fold(0.0, f64::max) });
            }
        }
        Some((best?, kink, plain))
    }

    /// d = c + a t + s u(t): s, NE, and the sum of squares that is left.
    fn least_squares(&self, u: impl Fn(AutopilotTime) -> f64) -> Option<(Vector2<f64>, f64)> {
        let from = self.felt.first()?.time;
        let (mut normal, mut right) = (Matrix3::zeros(), nalgebra::Matrix3x2::zeros());
        let mut squares = 0.0;
        for f in &self.felt {
            let row = Vector3::new(1.0, f.time.seconds_since(from), u(f.time));
            normal += row * row.transpose();
            right += row * f.difference.transpose();
            squares += f.difference.norm_squared();
        }
        normal += Matrix3::identity() * 1e-6;
        let solved = normal.cholesky()?.solve(&right);
        Some((solved.row(2).transpose(), (squares - right.dot(&solved)).max(0.0)))
    }
}
