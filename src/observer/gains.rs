//! Gains of the translational part.

use super::state::ObserverState;
use nalgebra::{Matrix3, SMatrix, Vector3};

/// Gains of the position, velocity and ξ equations with GNSS (Grip (6), Fusini (7)), each times the identity: the rows of K for
/// p, v, ξ and its columns for the position error and the velocity error.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct TranslationGains {
    /// K_pp, 1/s.
    pub pp: f64,
    /// K_pv, dimensionless.
    pub pv: f64,
    /// K_vp, 1/s².
    pub vp: f64,
    /// K_vv, 1/s.
    pub vv: f64,
    /// K_ξp, 1/s³.
    pub xp: f64,
    /// K_ξv, 1/s².
    pub xv: f64,
}

impl TranslationGains {
    /// As printed by Grip (Section V). Hurwitz, but they follow the receiver's noise: kept for comparison.
    pub const fn grip_printed() -> Self {
        Self { pp: 128.9, pv: 17.5, vp: 15.7, vv: 2.4, xp: 1.3, xv: 0.2 }
    }

    /// As printed by Fusini (Section VI).
    pub const fn fusini_printed() -> Self {
        Self { pp: 30.0, pv: 2.0, vp: 0.01, vv: 20.0, xp: 1.0, xv: 50.0 }
    }

    /// The gains of a stationary Kalman filter for a GNSS receiver with position noise of some metres and velocity noise of some
    /// 0.1 m/s ("KM"). The ones to use.
    pub const fn km() -> Self {
        Self { pp: 1.2, pv: 0.2, vp: 0.3, vv: 1.5, xp: 0.05, xv: 0.5 }
    }

    /// KM with softer position gains: for a receiver whose position noise is white from fix to fix, as in simulation. There the position
    /// errs by 0.7 m where KM has 1.15 m, and the velocity by half. Real receivers wander, and KM follows what they say.
    pub const fn soft() -> Self {
        Self { pp: 0.4, vp: 0.05, xp: 0.01, ..Self::km() }
    }

    /// No injection: for fixes that reach the state otherwise, see [`JumpGains`].
    pub const fn none() -> Self {
        Self { pp: 0.0, pv: 0.0, vp: 0.0, vv: 0.0, xp: 0.0, xv: 0.0 }
    }

    /// The same without GNSS velocity (Grip, Theorem 2): the velocity columns are zero.
    pub const fn position_only(self) -> Self {
        Self { pv: 0.0, vv: 0.0, xv: 0.0, ..self }
    }
}

/// Gains of the jumps that the state makes at each fix when nothing is injected between fixes: [p, v, ξ] += L [e_p, e_v].
///
/// A way to bring fixes at 1-10 Hz into an observer at the IMU's rate, for comparison. With L = (I − e^{(A−KC)T} e^{−AT}) C⁺ a jump and a
/// free interval T do together what the continuous injection would have done; the plain T·K is unstable with the printed gains.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct JumpGains {
    /// Rows p, v, ξ; columns e_p, e_v.
    l: SMatrix<f64, 3, 2>,
}

impl JumpGains {
    /// L from its rows [pp, pv, vp, vv, ξp, ξv].
    pub fn from_rows(rows: [f64; 6]) -> Self {
        Self { l: SMatrix::from_row_slice(&rows) }
    }

    /// L = (I − e^{(A−KC)T} e^{−AT}), its first two columns, for fixes every `interval_s`; A is the double integrator with ξ as its input.
    pub fn equivalent(gains: &TranslationGains, interval_s: f64) -> Self {
        let k = gains;
        let a = Matrix3::new(0.0, 1.0, 0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0);
        let kc = Matrix3::new(k.pp, k.pv, 0.0, k.vp, k.vv, 0.0, k.xp, k.xv, 0.0);
        let l = Matrix3::identity() - ((a - kc) * interval_s).exp() * (a * -interval_s).exp();
        Self { l: l.fixed_columns::<2>(0).into_owned() }
    }

    /// One fix: the state jumps.
    pub fn apply(&self, state: &mut ObserverState, e_p: &Vector3<f64>, e_v: &Vector3<f64>) {
        let part = |row: usize| self.l[(row, 0)] * e_p + self.l[(row, 1)] * e_v;
        state.position_ned += part(0);
        state.velocity_ned += part(1);
        state.xi_ned += part(2);
    }
}

/// Gains K′ of Fusini's dead reckoning (9). The `*p` ones act on the scalar altitude error p_D − p̂_D, the `*v` ones on the
/// horizontal velocity error from optical flow.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct DeadReckoningGains {
    /// K′_pp, 1/s.
    pub pp: f64,
    /// K′_vp, 1/s².
    pub vp: f64,
    /// K′_vv, 1/s.
    pub vv: f64,
    /// K′_ξp, 1/s³.
    pub xp: f64,
    /// K′_ξv, 1/s².
    pub xv: f64,
}

impl DeadReckoningGains {
    /// As printed by Fusini (Section VI). Under Euler steps they need at least 200 Hz: at 100 Hz they diverge.
    pub const fn printed() -> Self {
        Self { pp: 300.0, vp: 200.0, vv: 30.0, xp: 200.0, xv: 100.0 }
    }

    /// Gains that are stable down to 100 Hz.
    pub const fn at_100_hz() -> Self {
        Self { pp: 20.0, vp: 20.0, vv: 30.0, xp: 5.0, xv: 100.0 }
    }

    /// The KM gains in dead reckoning. The printed ones make v̂ follow every flow sample within 30 ms, and flow noise of 0.5 m/s then shakes
    /// f̂ⁿ by metres per second squared: harmless where f̂ⁿ hardly matters, fatal where it is half of a magnetic triad.
    pub const fn km() -> Self {
        let k = TranslationGains::km();
        Self { pp: k.pp, vp: k.vp, vv: k.vv, xp: k.xp, xv: k.xv }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// The numbers that the golden files carry for these gains at 5 Hz.
    #[test]
    fn the_equivalent_jump_is_that_of_the_reference() {
        for (gains, want) in [
            (
                TranslationGains::km(),
                [
                    0.217_108_020_991_332_42,
                    0.035_048_555_777_340_87,
                    0.046_408_674_932_876_95,
                    0.261_749_825_251_201_5,
                    0.006_343_137_615_929_965_4,
                    0.085_375_329_515_799_78,
                ],
            ),
            (
                TranslationGains::grip_printed(),
                [
                    0.985_485_182_417_752_8,
                    0.119_856_716_149_225_13,
                    0.113_123_845_695_019_6,
                    0.066_498_142_279_526_88,
                    0.009_186_221_501_012_849,
                    0.005_710_917_640_891_891,
                ],
            ),
        ] {
            let l = JumpGains::equivalent(&gains, 0.2);
            assert!((l.l - JumpGains::from_rows(want).l).norm() < 1e-12, "{}", l.l);
        }
    }
}
