//! Standing still: a disarmed vehicle whose IMU is quiet does not move. That ends the drift before take-off and after landing, and shows
//! the gyro bias.

use nalgebra::Vector3;

use crate::sample::{ImuSample, VehicleStatus};
use crate::time::AutopilotTime;

use super::Navigator;
use super::nis::Measured;
use super::solution::Mode;

/// A quiet IMU: no faster than this, rad/s …
const QUIET_RATE: f64 = 0.1;
/// … with a specific force this near to gravity, m/s² …
const QUIET_FORCE: f64 = 0.6;
/// … for this long, s.
const QUIET_S: f64 = 1.0;
/// A standstill is fused this often, s.
const PERIOD_S: f64 = 0.2;
/// How still a standstill is, m/s and rad/s.
const SIGMA_MPS: f64 = 0.1;
const SIGMA_RADPS: f64 = 0.003;

/// A vehicle that is this fast, m/s, or this high above where it began, m, is in the air, whatever it says of its motors.
const FLYING_MPS: f64 = 3.0;
const FLYING_M: f64 = 3.0;

/// Since when the IMU has been quiet, and when standing still is to be told the filter next.
#[derive(Clone, Copy, Debug, Default)]
pub(super) struct Rest {
    since: Option<AutopilotTime>,
    told: Option<AutopilotTime>,
    resting: bool,
}

impl Navigator {
    /// What the autopilot says of the vehicle.
    pub fn set_status(&mut self, status: VehicleStatus) {
        if status.armed == Some(true) {
            self.flew_disarmed = false;
        }
        self.status = status;
    }

    /// Whether the motors are off, as far as that can be believed: converted logs and some bridges never say anything else.
    pub(super) fn disarmed(&self) -> bool {
        self.status.armed == Some(false) && !self.flew_disarmed
    }

    fn doubt_disarmed(&mut self) {
        let height = self.height.height_m().filter(|_| self.height.height_sigma_m() < 0.5 * FLYING_M);
        let high = height.zip(self.ground_m).is_some_and(|(height, ground)| height - ground > FLYING_M);
        let fast = self.estimate().is_some_and(|(_, v)| v.xy().norm() > FLYING_MPS);
        self.flew_disarmed |= self.modes.mode() == Mode::Aided && (fast || high);
    }

    /// Whether the vehicle stands.
    pub(super) fn resting(&self) -> bool {
        self.rest.resting
    }

    /// Looks at an IMU sample; tells the filter if the vehicle stands.
    pub(super) fn look_for_rest(&mut self, s: &ImuSample) {
        let gravity = self.place.as_ref().map_or(9.81, |p| p.gravity_ned.z);
        let quiet = s.angular_rate.raw().norm() < QUIET_RATE
            && (s.specific_force.raw().norm() - gravity).abs() < QUIET_FORCE;
        if self.disarmed() {
            self.doubt_disarmed();
        }
        if !self.disarmed() || !quiet {
            self.rest = Rest::default();
            return;
        }
        let since = *self.rest.since.get_or_insert(s.time);
        if s.time.seconds_since(since) < QUIET_S {
            return;
        }
        if self.rest.told.is_some_and(|t| s.time.seconds_since(t) < PERIOD_S) {
            return;
        }
        self.rest.told = Some(s.time);
        let earth = self.place.as_ref().map_or(Vector3::zeros(), |p| p.earth_rate_ned);
        let Some(kalman) = &mut self.kalman else { return };
        // A filter that moves does not believe it, and is right: a float on a river is disarmed, too.
        match kalman.filter.fuse_standstill(&s.angular_rate.raw(), &earth, SIGMA_MPS, SIGMA_RADPS) {
            Ok(corrections) => {
                self.rest.resting = true;
                for c in &corrections {
                    self.nis.fused(Measured::Standstill, c.nis);
                }
                self.carry_back(s.time, corrections.iter());
            }
            Err(_) => {
                self.rest.resting = false;
                self.nis.gated(Measured::Standstill);
            }
        }
    }
}
