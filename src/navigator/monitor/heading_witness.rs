//! Motion as a witness of the heading: what GNSS sees the vehicle accelerate by, against what its accelerometers feel.
//!
//! Over a window from one fix to another GNSS tells Δv_G, and the accelerometers, turned to NED by the attitude, Δv_I = ∫(R f + g) dt. Where the
//! heading is off by −ψ, Δv_G = e^{iψ} Δv_I (as complex numbers, north + i east). With C = Σ conj(Δv_I) Δv_G over windows whose weight
//! fades, the least squares solution is
//!
//! ψ = arg C,  σ_ψ² = (Σ|Δv_G|² + Σ|Δv_I|² − 2|C|) / (2 n − 1) / Σ|Δv_I|²,
//!
//! the residual that is left after the turn over what there was to see. It needs no magnetometer and no filter, only GNSS that agrees with
//! itself, and is blind for a vehicle that does not accelerate.

use nalgebra::{Matrix2, Vector2};

use crate::navigator::tuning::heading_witness::{
    FORGET_S, LEAST_CHANGE, LEAST_SUM, LEAST_TURN, LEAST_WINDOWS, LONGEST_S, SHORTEST_S, SIGNIFICANT,
    UNEXPLAINED,
};
use crate::time::AutopilotTime;

/// How motion says that the attitude has to be turned about the vertical, rad, and how well it knows.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(in super::super) struct Turn {
    pub(in super::super) angle: f64,
    pub(in super::super) sigma: f64,
}

/// See the module's documentation.
#[derive(Clone, Copy, Debug, Default)]
pub(in super::super) struct HeadingWitness {
    /// The last window's end: time, velocity by GNSS, ∫ acceleration dt, m/s.
    last: Option<(AutopilotTime, Vector2<f64>, Vector2<f64>)>,
    /// C.
    real: f64,
    imaginary: f64,
    /// Σ|Δv_I|², Σ|Δv_G|² and the number of windows.
    inertial: f64,
    gnss: f64,
    windows: f64,
}

impl HeadingWitness {
    /// A fix's velocity, NE, m/s, and the integral of the inertial acceleration at its time.
    pub(in super::super) fn observe(
        &mut self,
        time: AutopilotTime,
        velocity_ne: &Vector2<f64>,
        impulse_ne: &Vector2<f64>,
    ) {
        let newest = (time, *velocity_ne, *impulse_ne);
        let (since, velocity, impulse) = *self.last.get_or_insert(newest);
        let dt = time.seconds_since(since);
        if (0.0..SHORTEST_S).contains(&dt) {
            return;
        }
        self.last = Some(newest);
        if !(SHORTEST_S..=LONGEST_S).contains(&dt) {
            return;
        }
        let (g, i) = (velocity_ne - velocity, impulse_ne - impulse);
        let keep = (-dt / FORGET_S).exp();
        self.real = self.real * keep + i.dot(&g);
        self.imaginary = self.imaginary * keep + Matrix2::from_columns(&[i, g]).determinant();
        self.inertial = self.inertial * keep + i.norm_squared();
        self.gnss = self.gnss * keep + g.norm_squared();
        self.windows = self.windows * keep + 1.0;
    }

    /// The angle that fits best, if there was anything to see.
    pub(in super::super) fn turn(&self) -> Option<Turn> {
        if self.windows < LEAST_WINDOWS || self.inertial <= 0.0 {
            return None;
        }
        let left = (self.gnss + self.inertial - 2.0 * self.real.hypot(self.imaginary)).max(0.0);
        let sigma = (left / (2.0 * self.windows - 1.0) / self.inertial).sqrt();
        Some(Turn { angle: self.imaginary.atan2(self.real), sigma })
    }

    /// The turn, if the heading has to be wrong: it is far more than its own error, and explains most of what did not fit.
    pub(in super::super) fn contradiction(&self) -> Option<Turn> {
        let turn = self.turn()?;
        let sum = self.gnss + self.inertial;
        let left = sum - 2.0 * self.real.hypot(self.imaginary);
        let before = sum - 2.0 * self.real;
        // What a receiver at rest tells is noise, and what accelerometers feel then is their bias.
        let moves = self.gnss > LEAST_CHANGE.powi(2) * self.windows && self.gnss > LEAST_SUM;
        let wrong = moves && turn.angle.abs() > LEAST_TURN.max(SIGNIFICANT * turn.sigma);
        (wrong && left < UNEXPLAINED * before).then_some(turn)
    }

    /// The attitude was turned, or what is remembered is another's: what was seen says nothing of the new one.
    pub(in super::super) fn forget(&mut self) {
        *self = Self::default();
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Flies figures of eight whose accelerations are felt at a heading that is off by `angle`, with noise.
    fn fly(angle: f64, speed: f64) -> HeadingWitness {
        let mut w = HeadingWitness::default();
        for k in 0..200 {
            let t = f64::from(k) * 0.2;
            let v = Vector2::new((0.5 * t).sin(), (0.9 * t).cos()) * speed;
            let noise = Vector2::new((7.0 * t).sin(), (11.0 * t).cos()) * 0.05;
            let felt = nalgebra::Rotation2::new(-angle) * v;
            w.observe(AutopilotTime::from_micros((t * 1e6) as i64), &(v + noise), &felt);
        }
        w
    }

    #[test]
    fn a_wrong_heading_is_found_with_its_sign_and_a_right_one_is_left_alone() {
        for angle in [-2.5, -0.8, 0.6, 3.0] {
            let turn = fly(angle, 4.0).contradiction().unwrap();
            assert!((turn.angle - angle).abs() < 0.05 && turn.sigma < 0.05, "{angle}: {turn:?}");
        }
        assert_eq!(fly(0.0, 4.0).contradiction(), None);
        assert_eq!(fly(0.1, 4.0).contradiction(), None);
    }

    #[test]
    fn a_hover_tells_nothing() {
        assert_eq!(fly(2.0, 0.02).contradiction(), None);
    }
}
