//! Rotor drag: a multirotor's accelerometers show its velocity through the air.
//!
//! The thrust of rotors lies along body z; what the accelerometers show along x and y is drag, nearly proportional to the velocity through
//! the air (Leishman et al. 2014, "Quadrotors and accelerometers"). With GNSS the filter learns the proportion and the wind; without GNSS and
//! flow, that bounds the velocity which inertial coasting alone would lose within a minute.

use nalgebra::{Vector2, Vector3};

use crate::sample::{Airframe, ImuSample};
use crate::time::ApTime;

use super::Navigator;
use super::nis::Measured;
use super::settings::Estimator;
use super::solution::{Carrier, Mode};

/// The force is averaged over this long, s.
const PERIOD_S: f64 = 0.1;
/// Drag carries the velocity for this long, s, …
const AGE_S: f64 = 1.0;
/// … and when it is there at all, 1/s, and known this many times better than it is large.
const LEAST_DRAG: f64 = 0.05;
const KNOWN: f64 = 4.0;

/// Settings of the rotor drag.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct DragSettings {
    /// Use it.
    pub enabled: bool,
    /// Deceleration over velocity before it was seen, 1/s.
    pub coefficient: f64,
    /// Standard deviation of the mean force of 0.1 s, m/s²: vibration, gusts, and what is not proportional.
    pub sigma_mps2: f64,
}

/// The mean force and velocity through the air since the last use.
#[derive(Clone, Copy, Debug, Default)]
pub(super) struct DragMean {
    seconds: f64,
    force: Vector2<f64>,
    air: Vector3<f64>,
    used: Option<ApTime>,
}

impl Navigator {
    /// Takes an IMU sample over `dt` s.
    pub(super) fn feel_drag(&mut self, s: &ImuSample, dt: f64) {
        let coasting = self.settings.estimator == Estimator::Inertial && self.modes.dead_reckoning();
        if !self.settings.drag.enabled
            || coasting
            || self.settings.estimator == Estimator::Ekf15
            || self.status.airframe != Some(Airframe::Multirotor)
            || self.resting()
            || self.disarmed()
        {
            self.drag = DragMean::default();
            return;
        }
        let Some(kalman) = &mut self.kalman else { return };
        let mean = &mut self.drag;
        mean.seconds += dt;
        mean.force += s.specific_force_body.xy() * dt;
        mean.air += kalman.filter.state().air_velocity_body() * dt;
        if mean.seconds < PERIOD_S {
            return;
        }
        let (force, air) = (mean.force / mean.seconds, mean.air / mean.seconds);
        *mean = DragMean { used: mean.used, ..DragMean::default() };
        // A flow that carries knows the velocity better than gusts let the drag know it.
        if self.modes.dead_reckoning() && self.carrier == Carrier::Flow {
            return;
        }
        match kalman.filter.fuse_drag(&force, &air, self.settings.drag.sigma_mps2) {
            Ok(corrections) => {
                let known = kalman.filter.state().drag > LEAST_DRAG.max(KNOWN * kalman.filter.drag_sigma());
                self.drag.used = known.then_some(s.time);
                for c in &corrections {
                    self.nis.fused(Measured::Drag, c.nis);
                }
                let moved = self.carry_back(s.time, corrections.iter());
                if self.modes.mode() == Mode::Rejoining {
                    self.offset_ned -= Vector3::new(moved.x, moved.y, 0.0);
                }
            }
            Err(_) => self.nis.gated(Measured::Drag),
        }
    }

    /// Whether the drag carries the velocity at present.
    pub(super) fn carried_by_drag(&self, now: ApTime) -> bool {
        self.drag.used.is_some_and(|t| now.seconds_since(t) < AGE_S)
    }
}
