//! The H∞ filter for systems with implicit outputs whose measurements are late and incomplete (Aguiar (11)-(16)).
//!
//! Between measurements x̂ follows the model and P the Riccati equation (12), both exactly for inputs that are held. A sample taken at s and
//! heard at t is written in terms of x(t): x(s) = Φ(s, t)(x(t) − I_u), I_u = ∫ₛᵗ Φ(t, σ) a(u(σ)) dσ, for which the filter remembers its
//! inputs. With H = MΦ(s, t), b = E0(0)ȳ − C(0, u(s)) − H I_u and Π = I − YY⁺ the impulse is
//!
//! - W = HᵀΠᵀR⁻¹ΠH, ζ = HᵀΠᵀR⁻¹Πb,
//! - (14) P⁺ = P⁻ + γ²ΣW,
//! - (15) x̂⁺ = x̂⁻ − γ²(P⁺)⁻¹Σ(Wx̂⁻ + ζ).
//!
//! The start is P(0) = γ²P0: the cost (10) demands the factor, which the printed (11) lacks.
//!
//! The estimate exists as long as P is positive definite. Where it ceases to be, γ is too small for what is measured, and the filter says so:
//! [`Definiteness::Indefinite`], P kept at its last definite value, no measurement taken until [`HinfFilter::restart`].

use std::collections::VecDeque;

use nalgebra::{DMatrix, DVector};

use super::implicit::{AffineTransition, ImplicitOutput, ImplicitSystem};
use super::riccati::{Discount, definite};

/// What a filter is told at its start.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct HinfSettings {
    /// γ and λ of the cost.
    pub discount: Discount,
    /// Samples older than this are refused, s; as long are inputs remembered.
    pub history_s: f64,
}

/// Whether the cost still has a minimum.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Definiteness {
    /// P is positive definite: the estimate is the minimum of the cost.
    Definite,
    /// It is not: γ is too small, or too little was measured for too long. There is no estimate.
    Indefinite,
    /// The filter was given, or came to, something that is no number.
    NotFinite,
}

/// Why an update was not made. The filter is as before.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum UpdateRefusal {
    /// Taken before what the filter remembers.
    TooOld,
    /// Taken after the filter's present.
    FromTheFuture,
    /// Not finite, or of the wrong size.
    Unusable,
    /// The filter has no estimate to update.
    Indefinite,
}

/// Later than the present by less than this is now: the rounding of times, s.
const ROUNDING_S: f64 = 1e-9;

/// The filter; see the module.
#[derive(Clone, Debug)]
pub struct HinfFilter<S: ImplicitSystem> {
    system: S,
    settings: HinfSettings,
    x: DVector<f64>,
    p: DMatrix<f64>,
    state: Definiteness,
    input: S::Input,
    /// Intervals with their inputs, the newest last.
    history: VecDeque<(f64, S::Input)>,
    remembered_s: f64,
}

impl<S: ImplicitSystem> HinfFilter<S> {
    /// A filter that starts at `x0` with P(0) = γ²P0 and the given input. `None` when sizes differ, P0 is not positive definite, or γ, λ or
    /// the history are not sensible.
    pub fn new(
        system: S,
        settings: HinfSettings,
        x0: DVector<f64>,
        p0: &DMatrix<f64>,
        input: S::Input,
    ) -> Option<Self> {
        let n = system.dimension();
        let Discount { gamma, lambda } = settings.discount;
        let sensible = gamma > 0.0 && gamma.is_finite() && (0.0..1e6).contains(&lambda);
        if !sensible || !(0.0..1e6).contains(&settings.history_s) {
            return None;
        }
        let (x, p) = started(n, gamma, x0, p0)?;
        let state = Definiteness::Definite;
        Some(Self { system, settings, x, p, state, input, history: VecDeque::new(), remembered_s: 0.0 })
    }

    /// Starts again, with what it remembers of its inputs: the way out of [`Definiteness::Indefinite`]. `false`, and no change, where
    /// [`Self::new`] would give `None`.
    pub fn restart(&mut self, x0: DVector<f64>, p0: &DMatrix<f64>) -> bool {
        let Some((x, p)) = started(self.system.dimension(), self.settings.discount.gamma, x0, p0) else {
            return false;
        };
        (self.x, self.p, self.state) = (x, p, Definiteness::Definite);
        true
    }

    /// x̂.
    pub fn estimate(&self) -> &DVector<f64> {
        &self.x
    }

    /// P, information-like: large where the state is known.
    pub fn information(&self) -> &DMatrix<f64> {
        &self.p
    }

    /// Whether there is an estimate.
    pub fn definiteness(&self) -> Definiteness {
        self.state
    }

    /// The system.
    pub fn system(&self) -> &S {
        &self.system
    }

    /// The input from now on.
    pub fn set_input(&mut self, input: S::Input) {
        self.input = input;
    }

    /// Goes on by `dt_s` with the present input, (12) and (13). A span that is negative or not finite changes nothing.
    pub fn propagate(&mut self, dt_s: f64) -> Definiteness {
        if !dt_s.is_finite() || dt_s <= 0.0 || self.state == Definiteness::NotFinite {
            return self.state;
        }
        let AffineTransition { matrix, constant } = self.system.transition(&self.input, dt_s);
        let x = matrix * &self.x + constant;
        if !x.iter().all(|v| v.is_finite()) {
            self.state = Definiteness::NotFinite;
            return self.state;
        }
        self.x = x;
        self.remember(dt_s);
        if self.state == Definiteness::Definite {
            match self.system.riccati_step(&self.input, self.settings.discount, dt_s, &self.p) {
                Some(p) => self.p = p,
                None => self.state = Definiteness::Indefinite,
            }
        }
        self.state
    }

    /// Takes samples that were all taken `age_s` ago, some or all of the system's outputs, (14) and (15).
    ///
    /// # Errors
    /// [`UpdateRefusal`].
    pub fn update(&mut self, age_s: f64, samples: &[S::Sample]) -> Result<(), UpdateRefusal> {
        if self.state != Definiteness::Definite {
            return Err(UpdateRefusal::Indefinite);
        }
        let (back, input_then) = self.back(age_s)?;
        let mut outputs = Vec::new();
        for sample in samples {
            self.system.outputs(sample, &input_then, &mut outputs);
        }
        let n = self.x.len();
        let (mut w, mut zeta) = (DMatrix::zeros(n, n), DVector::zeros(n));
        for output in &outputs {
            let (w_j, zeta_j) = impulse(output, &back, n).ok_or(UpdateRefusal::Unusable)?;
            w += w_j;
            zeta += zeta_j;
        }
        let gain = self.settings.discount.gamma.powi(2);
        let p = definite(&self.p + &w * gain).ok_or(UpdateRefusal::Unusable)?;
        let step = p.clone().cholesky().ok_or(UpdateRefusal::Unusable)?.solve(&(&w * &self.x + zeta)) * gain;
        if !step.iter().all(|v| v.is_finite()) {
            return Err(UpdateRefusal::Unusable);
        }
        self.x -= step;
        self.p = p;
        Ok(())
    }

    /// x(t − age) = Φ x(t) + φ as the model has it, and the input then.
    ///
    /// # Errors
    /// [`UpdateRefusal`], when the filter does not know.
    pub fn back(&self, age_s: f64) -> Result<(AffineTransition, S::Input), UpdateRefusal> {
        if !age_s.is_finite() {
            return Err(UpdateRefusal::Unusable);
        }
        if age_s < -ROUNDING_S {
            return Err(UpdateRefusal::FromTheFuture);
        }
        if age_s > self.remembered_s + ROUNDING_S || age_s > self.settings.history_s + ROUNDING_S {
            return Err(UpdateRefusal::TooOld);
        }
        let n = self.x.len();
        let mut back = AffineTransition { matrix: DMatrix::identity(n, n), constant: DVector::zeros(n) };
        let (mut left, mut input) = (age_s, &self.input);
        for (span, held) in self.history.iter().rev() {
            if left <= ROUNDING_S {
                break;
            }
            let h = left.min(*span);
            // The inverse of an exact step is the step backwards, which exists for every linear system.
            let step = self.system.transition(held, -h);
            back.constant = &step.matrix * &back.constant + step.constant;
            back.matrix = step.matrix * back.matrix;
            (left, input) = (left - h, held);
        }
        Ok((back, input.clone()))
    }

    fn remember(&mut self, dt_s: f64) {
        self.history.push_back((dt_s, self.input.clone()));
        self.remembered_s += dt_s;
        while let Some((span, _)) = self.history.front()
            && self.remembered_s - span >= self.settings.history_s
        {
            self.remembered_s -= span;
            self.history.pop_front();
        }
    }
}

fn started(
    n: usize,
    gamma: f64,
    x0: DVector<f64>,
    p0: &DMatrix<f64>,
) -> Option<(DVector<f64>, DMatrix<f64>)> {
    let fits = x0.len() == n && p0.shape() == (n, n) && x0.iter().all(|v| v.is_finite());
    let p = fits.then(|| p0 * gamma.powi(2)).and_then(definite)?;
    Some((x0, p))
}

/// W and ζ of an output (16) that was taken where `back` leads to; `None` when it is not finite or sizes differ.
pub fn impulse(
    output: &ImplicitOutput,
    back: &AffineTransition,
    n: usize,
) -> Option<(DMatrix<f64>, DVector<f64>)> {
    let rows = output.gradient.nrows();
    let fits = output.gradient.ncols() == n && output.constant.len() == rows && output.variance > 0.0;
    if !fits || output.free.as_ref().is_some_and(|y| y.nrows() != rows) {
        return None;
    }
    let pi = match &output.free {
        Some(y) => projection(y)?,
        None => DMatrix::identity(rows, rows),
    };
    let h = &pi * &output.gradient * &back.matrix;
    // `back.constant` is −Φ(s, t) I_u, and H I_u = MΦ(s, t) I_u.
    let b = &pi * (&output.constant + &output.gradient * &back.constant);
    let w = h.tr_mul(&h) / output.variance;
    let zeta = h.tr_mul(&b) / output.variance;
    w.iter().chain(zeta.iter()).all(|v| v.is_finite()).then_some((w, zeta))
}

/// Π = I − YY⁺.
pub fn projection(y: &DMatrix<f64>) -> Option<DMatrix<f64>> {
    let n = y.nrows();
    if !y.iter().all(|v| v.is_finite()) {
        return None;
    }
    let scale = y.norm();
    if scale == 0.0 {
        return Some(DMatrix::identity(n, n));
    }
    let inverse = (y / scale).pseudo_inverse(1e-12).ok()?;
    Some(DMatrix::identity(n, n) - (y / scale) * inverse)
}
