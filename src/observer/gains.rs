//! Gains of the translational part.

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

    /// The same without GNSS velocity (Grip, Theorem 2): the velocity columns are zero.
    pub const fn position_only(self) -> Self {
        Self { pv: 0.0, vv: 0.0, xv: 0.0, ..self }
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

    /// The KM gains in dead reckoning. The printed ones make v̂ follow every flow sample within 30 ms, and flow noise of 0.5 m/s then shakes
    /// f̂ⁿ by metres per second squared: harmless where f̂ⁿ hardly matters, fatal where it is half of a magnetic triad.
    pub const fn km() -> Self {
        let k = TranslationGains::km();
        Self { pp: k.pp, vp: k.vp, vv: k.vv, xp: k.xp, xv: k.xv }
    }
}
