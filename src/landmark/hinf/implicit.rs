//! What a state-affine system with implicit outputs is (Aguiar (1)-(3)).
//!
//! ẋ = A(u)x + a(u) + G(u)w, and for each output E_j(x, v) y_j = C_j(x, u) + v_j with E_j(x, ·) = E0_j(x) + Σ_ℓ α_ℓ E_ℓj, everything affine in x.
//! An output in this form needs no division by a depth: a camera's picture of a point is one with E0 = 0 and α the unknown depth.

use nalgebra::{DMatrix, DVector};

use super::riccati::{self, Discount};

/// The affine vector field of a system under an input that is held.
#[derive(Clone, Debug, PartialEq)]
pub struct AffineDynamics {
    /// A(u).
    pub matrix: DMatrix<f64>,
    /// a(u).
    pub constant: DVector<f64>,
    /// G(u)G(u)ᵀ.
    pub disturbance: DMatrix<f64>,
}

/// What an interval with a held input does to the state: x(t + h) = Φ x(t) + φ.
#[derive(Clone, Debug, PartialEq)]
pub struct AffineTransition {
    /// Φ(t + h, t).
    pub matrix: DMatrix<f64>,
    /// φ = ∫ Φ(t + h, σ) a dσ.
    pub constant: DVector<f64>,
}

/// An output as measured at a time: what of (16) does not depend on the delay.
#[derive(Clone, Debug, PartialEq)]
pub struct ImplicitOutput {
    /// M = J E0(ȳ) − ∇C(u): the gradient of E0(x)ȳ − C(x, u) with respect to x.
    pub gradient: DMatrix<f64>,
    /// E0(0)ȳ − C(0, u).
    pub constant: DVector<f64>,
    /// Y = [E_1 ȳ | E_2 ȳ | …], the directions in which the output says nothing; `None` where there are none.
    pub free: Option<DMatrix<f64>>,
    /// Variance R of the noise of each row; 1 in the paper.
    pub variance: f64,
}

/// A system whose states [`super::filter::HinfFilter`] can estimate.
pub trait ImplicitSystem {
    /// u, held between changes.
    type Input: Clone;
    /// One measured output or several.
    type Sample;

    /// Number of states.
    fn dimension(&self) -> usize;

    /// A(u), a(u) and G(u)G(u)ᵀ.
    fn dynamics(&self, input: &Self::Input) -> AffineDynamics;

    /// Adds the outputs that a sample holds; `input` is that of the time at which it was taken.
    fn outputs(&self, sample: &Self::Sample, input: &Self::Input, outputs: &mut Vec<ImplicitOutput>);

    /// Qe, how much the error of each state counts in the cost; the identity in the paper.
    fn error_weight(&self) -> DVector<f64> {
        DVector::from_element(self.dimension(), 1.0)
    }

    /// The exact transition over `dt_s`. By default from the exponential of [[A, a], [0, 0]] h.
    fn transition(&self, input: &Self::Input, dt_s: f64) -> AffineTransition {
        riccati::affine_transition(&self.dynamics(input), dt_s)
    }

    /// The exact step of (12) over `dt_s`: `None` when P ceases to be positive definite within it. By default from the exponential of the
    /// Hamiltonian matrix; systems whose A is skew should do with [`riccati::skew_step`].
    fn riccati_step(
        &self,
        input: &Self::Input,
        discount: Discount,
        dt_s: f64,
        p: &DMatrix<f64>,
    ) -> Option<DMatrix<f64>> {
        riccati::hamiltonian_step(&self.dynamics(input), &self.error_weight(), discount, dt_s, p)
    }
}
