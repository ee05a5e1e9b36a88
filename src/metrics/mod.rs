//! How far the solution is from the reference: errors with GNSS, and drift in outages. Nothing here reaches a filter.

pub mod nees;
pub mod outage;

use nalgebra::{Matrix3, Vector3};
use serde::Serialize;

use crate::geo::so3::{Euler, wrap_pi};
use crate::geo::{LocalNed, Ned};
use crate::navigator::solution::Solution;
use crate::sample::TruthState;
use crate::time::AutopilotTime;

/// A reference state in the navigator's NED frame.
#[derive(Clone, Copy, Debug)]
pub struct ReferenceState {
    /// When it holds.
    pub time: AutopilotTime,
    /// Position, m.
    pub position_ned: Vector3<f64>,
    /// Velocity, m/s: all three components of a simulator, two of GNSS.
    pub velocity_ned: Option<Vector3<f64>>,
    /// Rotation from body to NED.
    pub r_body_to_ned: Option<Matrix3<f64>>,
}

impl ReferenceState {
    /// Truth in a local frame; `None` if it has no position.
    pub fn from_truth(truth: &TruthState, frame: &LocalNed) -> Option<Self> {
        Some(Self {
            time: truth.time,
            position_ned: frame.to_ned(&truth.position?),
            velocity_ned: truth.velocity.map(Ned::raw),
            r_body_to_ned: truth.attitude.map(|a| *a.matrix()),
        })
    }
}

/// The solution's errors against one reference state.
#[derive(Clone, Copy, Debug)]
pub struct ErrorSample {
    /// Horizontal distance, m.
    pub horizontal_m: f64,
    /// Solution less reference, up, m.
    pub altitude_m: f64,
    /// Length of the velocity error, m/s (horizontal where the reference has no vertical one).
    pub velocity_mps: Option<f64>,
    /// Roll, pitch and yaw errors, rad.
    pub attitude_rad: Option<Vector3<f64>>,
}

impl ErrorSample {
    /// Compares; the solution is carried to the reference's time by its own velocity.
    pub fn between(solution: &Solution, reference: &ReferenceState) -> Self {
        let dt = reference.time.seconds_since(solution.time);
        let e = (solution.position + solution.velocity * dt).raw() - reference.position_ned;
        let velocity_mps = reference.velocity_ned.map(|v| {
            let d = solution.velocity.raw() - v;
            if v.z.is_nan() { d.xy().norm() } else { d.norm() }
        });
        let attitude_rad = reference.r_body_to_ned.map(|r| {
            let (ours, theirs) = (Euler::from_rotation(solution.attitude.matrix()), Euler::from_rotation(&r));
            Vector3::new(
                wrap_pi(ours.roll_rad - theirs.roll_rad),
                wrap_pi(ours.pitch_rad - theirs.pitch_rad),
                wrap_pi(ours.yaw_rad - theirs.yaw_rad),
            )
        });
        Self { horizontal_m: e.xy().norm(), altitude_m: -e.z, velocity_mps, attitude_rad }
    }
}

/// A root mean square that is `None` while nothing was added.
#[derive(Clone, Copy, Debug, Default)]
pub struct Rms {
    sum: f64,
    n: u64,
}

impl Rms {
    /// Adds a value.
    pub fn add(&mut self, v: f64) {
        self.sum += v * v;
        self.n += 1;
    }

    /// The root mean square.
    pub fn value(&self) -> Option<f64> {
        (self.n > 0).then(|| (self.sum / self.n as f64).sqrt())
    }
}

/// Root mean squares of the errors with GNSS.
#[derive(Clone, Copy, Debug, Default)]
pub struct AidedErrors {
    horizontal: Rms,
    velocity: Rms,
    roll: Rms,
    pitch: Rms,
    yaw: Rms,
    altitude: Rms,
}

/// The same, as numbers to print; `None` where there was nothing to compare with.
#[derive(Clone, Copy, Debug, Serialize)]
pub struct AidedReport {
    /// Horizontal position, m.
    pub position_rmse_m: Option<f64>,
    /// Velocity, m/s.
    pub velocity_rmse_mps: Option<f64>,
    /// Roll, degrees.
    pub roll_rmse_deg: Option<f64>,
    /// Pitch, degrees.
    pub pitch_rmse_deg: Option<f64>,
    /// Yaw, degrees.
    pub yaw_rmse_deg: Option<f64>,
    /// Altitude, m.
    pub altitude_rmse_m: Option<f64>,
}

impl AidedErrors {
    /// Adds one comparison.
    pub fn add(&mut self, e: &ErrorSample) {
        self.horizontal.add(e.horizontal_m);
        self.altitude.add(e.altitude_m);
        if let Some(v) = e.velocity_mps {
            self.velocity.add(v);
        }
        if let Some(a) = e.attitude_rad {
            self.roll.add(a.x.to_degrees());
            self.pitch.add(a.y.to_degrees());
            self.yaw.add(a.z.to_degrees());
        }
    }

    /// As numbers.
    pub fn report(&self) -> AidedReport {
        AidedReport {
            position_rmse_m: self.horizontal.value(),
            velocity_rmse_mps: self.velocity.value(),
            roll_rmse_deg: self.roll.value(),
            pitch_rmse_deg: self.pitch.value(),
            yaw_rmse_deg: self.yaw.value(),
            altitude_rmse_m: self.altitude.value(),
        }
    }
}
