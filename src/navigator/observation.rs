//! What a source gives the estimator, and what became of it.

use nalgebra::{Matrix2, Matrix3, Vector2, Vector3};

use crate::filter::error_state::{Correction, Gated};
use crate::observer::xkf::XkfCorrection;
use crate::time::AutopilotTime;

use super::sources::status::Measured;

/// A measurement with its model: which quantity of the state it shows, the innovation or the value, and its noise (1 sigma or covariance).
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) enum Observation {
    /// A magnetic field, body, and the one that the place should have, T, its noise on an axis and what its latency may make of it, body, T, and how its bias
    /// walks, T/√s.
    Magnetic {
        field_body: Vector3<f64>,
        field_ned: Vector3<f64>,
        sigma_t: f64,
        late_t: Vector3<f64>,
        walk_t: f64,
    },
    /// Horizontal errors of a fix against the estimate of its time, NE, m and m/s.
    Fix {
        measured: AutopilotTime,
        position_error: Vector2<f64>,
        velocity_error: Option<Vector2<f64>>,
        sigma: [f64; 2],
    },
    /// A flow velocity of `measured`, body x and y, m/s: as the sensor tells it at that distance of the ground, m, and with its systematic
    /// errors taken out.
    Flow {
        measured: AutopilotTime,
        v_xy: Vector2<f64>,
        corrected_xy: Vector2<f64>,
        distance_m: f64,
        r_body_to_ned: Matrix3<f64>,
        covariance: Matrix2<f64>,
    },
    /// A true airspeed, m/s; and where the nose points into the wind, how well, rad.
    Airspeed { speed_mps: f64, sigma_mps: f64, sideslip_sigma_rad: Option<f64> },
    /// The mean specific force along body x and y, m/s², at this velocity through the air, body, m/s.
    Drag { force_xy: Vector2<f64>, air_body: Vector3<f64>, sigma_mps2: f64 },
    /// Standing still; the angular rate is the gyros' bias and the Earth's, rad/s.
    Standstill {
        angular_rate_body: Vector3<f64>,
        earth_rate_ned: Vector3<f64>,
        sigma_mps: f64,
        sigma_radps: f64,
    },
    /// A pose from landmarks: horizontal error, NE, m, its variances, the attitude, and the heading's variance, rad².
    Pose { error_ne: Vector2<f64>, variance: [f64; 2], r_body_to_ned: Matrix3<f64>, heading_variance: f64 },
}

/// How a scalar fitted.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) enum FitScore {
    /// Fused, with its normalised innovation squared.
    Fused(f64),
    /// Outside the gate, with its innovation in sigmas.
    Gated(f64),
}

/// No observation has more scalars.
const SCALARS: usize = 4;

/// What became of an observation, scalar by scalar, and what it moved.
#[derive(Clone, Copy, Debug)]
pub(super) struct Fused {
    scores: [Option<(Measured, FitScore)>; SCALARS],
    /// Sum of the corrections of the position, NED, m …
    pub(super) position_ned: Vector3<f64>,
    /// … and of the velocity, m/s.
    pub(super) velocity_ned: Vector3<f64>,
}

/// What a correction moves.
pub(super) trait Shift {
    /// Position, m, velocity, m/s, and normalised innovation squared.
    fn shift(&self) -> (Vector3<f64>, Vector3<f64>, f64);
}

impl Shift for Correction {
    fn shift(&self) -> (Vector3<f64>, Vector3<f64>, f64) {
        (self.position_ned, self.velocity_ned, self.nis)
    }
}

impl Shift for XkfCorrection {
    fn shift(&self) -> (Vector3<f64>, Vector3<f64>, f64) {
        (self.position_ned, self.velocity_ned, self.nis)
    }
}

/// A vector whose correction nobody has to follow: only how well it fitted.
impl Shift for f64 {
    fn shift(&self) -> (Vector3<f64>, Vector3<f64>, f64) {
        (Vector3::zeros(), Vector3::zeros(), *self)
    }
}

impl Fused {
    /// Nothing yet.
    pub(super) fn nothing() -> Self {
        Self { scores: [None; SCALARS], position_ned: Vector3::zeros(), velocity_ned: Vector3::zeros() }
    }

    /// Takes note of a scalar; whether it was taken.
    pub(super) fn note<T: Shift>(&mut self, measured: Measured, result: Result<T, Gated>) -> bool {
        let score = match &result {
            Ok(correction) => {
                let (p, v, nis) = correction.shift();
                self.position_ned += p;
                self.velocity_ned += v;
                FitScore::Fused(nis)
            }
            Err(Gated(sigmas)) => FitScore::Gated(*sigmas),
        };
        if let Some(free) = self.scores.iter_mut().find(|s| s.is_none()) {
            *free = Some((measured, score));
        }
        result.is_ok()
    }

    /// The same for a vector that is taken as a whole or not at all.
    pub(super) fn note_all<T: Shift, const N: usize>(
        &mut self,
        measured: Measured,
        result: Result<[T; N], Gated>,
    ) -> bool {
        match result {
            Ok(corrections) => {
                let mut taken = true;
                for correction in corrections {
                    taken &= self.note(measured, Ok(correction));
                }
                taken
            }
            Err(gated) => self.note::<T>(measured, Err(gated)),
        }
    }

    /// Whether the estimate was moved by it.
    pub(super) fn moves(&self) -> bool {
        self.position_ned != Vector3::zeros() || self.velocity_ned != Vector3::zeros()
    }

    /// Scores, in the order in which they came.
    pub(super) fn scores(&self) -> impl Iterator<Item = (Measured, FitScore)> + '_ {
        self.scores.iter().flatten().copied()
    }

    /// Whether something was offered and none of it gated.
    pub(super) fn taken(&self) -> bool {
        self.scores[0].is_some() && self.scores().all(|(_, s)| matches!(s, FitScore::Fused(_)))
    }

    /// Whether some scalar of this kind was taken.
    pub(super) fn took(&self, measured: Measured) -> bool {
        self.scores().any(|(m, s)| m == measured && matches!(s, FitScore::Fused(_)))
    }

    /// Whether some scalar of this kind was gated.
    pub(super) fn gated(&self, measured: Measured) -> bool {
        self.scores().any(|(m, s)| m == measured && matches!(s, FitScore::Gated(_)))
    }
}
