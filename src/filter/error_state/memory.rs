//! What the filter knows, as numbers that can be kept, and back.

use nalgebra::{Matrix3, SVector, Vector2, Vector3};
use serde::{Deserialize, Serialize};

use super::covariance::{Covariance, ErrorTransition};
use super::jumps::JumpBank;
use super::tuning::COVARIANCE_STEP_S;
use super::{Eskf, EskfSettings, EskfState, STATES};
use crate::geo::{polar_rotation, symmetric};

/// Nominal state and covariance. Units and frames are those of [`EskfState`].
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct EskfMemory {
    /// Body → NED, column by column.
    pub r_body_to_ned: [[f64; 3]; 3],
    /// Position and velocity, NED.
    pub motion: [[f64; 3]; 2],
    /// Biases of gyros, accelerometers and magnetometer, and the gyros' scale errors.
    pub inertial: [[f64; 3]; 4],
    /// Flow [b_x, b_y, s, μ].
    pub flow: [f64; 4],
    /// Wind north and east, airspeed scale error, drag.
    pub air: [f64; 4],
    /// The covariance's upper triangle, row by row.
    pub covariance: Vec<f64>,
}

/// What no vehicle's or sensor's state is beyond: |v| m/s, |p| m, |b_g| rad/s, |b_a| m/s², |b_m| T, |s_g|, |wind| m/s, |k|, |D| 1/s.
const SPEED: f64 = 500.0;
const DISTANCE: f64 = 1e6;
const GYRO: f64 = 1.0;
const ACCEL: f64 = 10.0;
const MAGNETIC: f64 = 1e-4;
const SCALE: f64 = 0.5;
const WIND: f64 = 100.0;
const DRAG: f64 = 10.0;
/// Flow bias m/s, scale and misalignment.
const FLOW: [f64; 4] = [20.0, 20.0, 1.0, 1.0];

impl EskfMemory {
    fn state(&self) -> Option<EskfState> {
        let within = |values: &[f64], most: f64| values.iter().all(|v| v.abs() <= most);
        let [p, v] = &self.motion;
        let [gyro, accel, magnetic, scale] = &self.inertial;
        let [north, east, airspeed, drag] = self.air;
        let sound = within(p, DISTANCE)
            && within(v, SPEED)
            && within(gyro, GYRO)
            && within(accel, ACCEL)
            && within(magnetic, MAGNETIC)
            && within(scale, SCALE)
            && within(&[north, east], WIND)
            && within(&[airspeed], SCALE)
            && within(&[drag], DRAG)
            && self.flow.iter().zip(FLOW).all(|(f, most)| f.abs() <= most);
        let r = Matrix3::from(self.r_body_to_ned);
        let turned = r * r.transpose() - Matrix3::identity();
        let is_rotation = turned.iter().all(|e| e.abs() < 1e-3) && r.determinant() > 0.0;
        (sound && is_rotation).then_some(())?;
        Some(EskfState {
            r_body_to_ned: polar_rotation(&r)?,
            position_ned: Vector3::from(*p),
            velocity_ned: Vector3::from(*v),
            gyro_bias: Vector3::from(*gyro),
            accel_bias: Vector3::from(*accel),
            flow: SVector::from(self.flow),
            magnetic_bias: Vector3::from(*magnetic),
            gyro_scale: Vector3::from(*scale),
            wind_ne: Vector2::new(north, east),
            airspeed_scale: airspeed,
            drag,
        })
    }

    /// What a filter knows at present.
    pub fn of(filter: &Eskf) -> Self {
        let mut present = filter.clone();
        present.propagate_covariance();
        let s = &present.state;
        Self {
            r_body_to_ned: s.r_body_to_ned.into(),
            motion: [s.position_ned.into(), s.velocity_ned.into()],
            inertial: [s.gyro_bias, s.accel_bias, s.magnetic_bias, s.gyro_scale].map(Into::into),
            flow: s.flow.into(),
            air: [s.wind_ne.x, s.wind_ne.y, s.airspeed_scale, s.drag],
            covariance: symmetric::upper(&present.p),
        }
    }

    /// A filter that knows this. `None` where it is no state of a vehicle, or no covariance.
    pub fn filter(&self, settings: EskfSettings) -> Option<Eskf> {
        let state = self.state()?;
        let p: Covariance = symmetric::covariance::<STATES>(&self.covariance)?;
        let pending = ErrorTransition::new(state.r_body_to_ned);
        let covariance_step_s = COVARIANCE_STEP_S;
        Some(Eskf {
            settings,
            state,
            p,
            pending,
            covariance_step_s,
            steps: 0,
            sound: true,
            jumps: JumpBank::new(false),
        })
    }
}
