//! Gyro bias: parameter projection, the resetting rule, saturation.

use crate::geo::so3;
use nalgebra::{Matrix3, Vector3};

/// The two radii of the gyro bias estimate, rad/s.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct BiasBounds {
    /// M_b (Grip) or L_b (Fusini): the true bias is within this ball.
    pub bound_radps: f64,
    /// M_b̂ > M_b (Grip) or L_b̂ (Fusini): the estimate never leaves this ball.
    pub limit_radps: f64,
}

impl BiasBounds {
    /// The bounds of both papers: 2°/s for the bias, 2.1°/s for the estimate (Grip, Section V).
    pub fn printed() -> Self {
        Self { bound_radps: 2f64.to_radians(), limit_radps: 2.1f64.to_radians() }
    }

    /// Parameter projection Proj(b̂, τ) (Grip and Fusini, Appendix): (I − c(b̂) b̂b̂ᵀ/|b̂|²) τ when |b̂| ≥ M_b and b̂ᵀτ > 0, else τ,
    /// with c = min{1, (|b̂|² − M_b²)/(M_b̂² − M_b²)}. The outward part of τ fades out between the two radii.
    pub fn project(&self, bias: &Vector3<f64>, tau: &Vector3<f64>) -> Vector3<f64> {
        let n2 = bias.norm_squared();
        let b2 = self.bound_radps * self.bound_radps;
        let outward = bias.dot(tau);
        if n2 < b2 || n2 == 0.0 || outward <= 0.0 {
            return *tau;
        }
        let span = self.limit_radps * self.limit_radps - b2;
        let c = if span > 0.0 { ((n2 - b2) / span).min(1.0) } else { 1.0 };
        tau - bias * (c * outward / n2)
    }

    /// The resetting rule (Grip (12)): an estimate outside the ball of radius M_b̂ is put back on its surface.
    pub fn reset(&self, bias: &Vector3<f64>) -> Vector3<f64> {
        let n = bias.norm();
        if n > self.limit_radps { bias * (self.limit_radps / n) } else { *bias }
    }
}

/// Component-wise saturation to [−1, 1] (Grip, Section I-B).
pub fn sat(m: &Matrix3<f64>) -> Matrix3<f64> {
    m.map(|c| c.clamp(-1.0, 1.0))
}

/// The direction −vex(P_a(sat(R̂)ᵀ K_P J)) in which the gyro bias is driven (Grip (2b), (7b); Fusini (6b)), for diagonal K_P.
pub fn bias_drive(r_hat: &Matrix3<f64>, k_p: &Vector3<f64>, j: &Matrix3<f64>) -> Vector3<f64> {
    let kj = Matrix3::from_fn(|row, col| k_p[row] * j[(row, col)]);
    -so3::vex(&(sat(r_hat).transpose() * kj))
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    fn vector(bound: f64) -> impl Strategy<Value = Vector3<f64>> {
        [-bound..bound, -bound..bound, -bound..bound].prop_map(|[x, y, z]| Vector3::new(x, y, z))
    }

    proptest! {
        /// Lemma 3 of Grip: the properties the stability proof rests on.
        #[test]
        fn the_projection_has_the_properties_of_lemma_3(b in vector(0.04), tau in vector(0.02)) {
            let bounds = BiasBounds::printed();
            let out = bounds.project(&b, &tau);
            prop_assert!(out.norm() <= tau.norm() + 1e-15);
            if b.norm() >= bounds.limit_radps {
                prop_assert!(b.dot(&out) <= 1e-15);
            }
            // −b̃ᵀProj ≤ −b̃ᵀτ for every true bias within M_b; the one in the direction of τ is the worst.
            let truth = tau.normalize() * bounds.bound_radps;
            prop_assert!((b - truth).dot(&out) <= (b - truth).dot(&tau) + 1e-15);
            prop_assert!(bounds.reset(&b).norm() <= bounds.limit_radps * (1.0 + 1e-12));
        }
    }

    #[test]
    fn the_bias_is_driven_against_the_attitude_error_it_causes() {
        // A bias estimate that is too low about z lets R̂ run ahead by +z; then J turns back and the estimate must rise.
        let r_hat = so3::exp(&Vector3::new(0.0, 0.0, 0.1));
        let j = Matrix3::identity() - r_hat;
        assert!(bias_drive(&r_hat, &Vector3::repeat(1.0), &j).z > 0.0);
    }
}
