//! What a source may know of everything else.

use nalgebra::Vector3;

use crate::time::AutopilotTime;

use super::core::Core;
use super::sources::takeoff::Ground;
use crate::navigator::tuning::vehicle::IN_AIR_M;

/// What the sources know, for each other and for the estimator.
#[derive(Clone, Copy, Debug)]
pub(super) struct SourceFacts {
    /// The newest magnetic field, body, T.
    pub(super) magnetic: Option<(AutopilotTime, Vector3<f64>)>,
    /// The newest flow velocity with its systematic errors taken out, body, m/s.
    pub(super) flow_velocity: Option<(AutopilotTime, Vector3<f64>)>,
    /// Whether some flow sensor is trusted.
    pub(super) flow_trusted: bool,
    /// The newest distance to the ground along body z that can be believed, m.
    pub(super) range: Option<(AutopilotTime, f64)>,
    /// There is a rangefinder, whatever it is worth.
    pub(super) rangefinder_heard: bool,
    /// While it is disputed where the ground is: the distance that is measured over the one that it should be.
    pub(super) disputed_ratio: Option<f64>,
    /// Where the ground is: as the rangefinder has seen it, or the place of take-off.
    pub(super) ground: Option<Ground>,
    /// The vehicle stands.
    pub(super) resting: bool,
    /// When airspeed, and rotor drag, last corrected the velocity.
    pub(super) airspeed_used: Option<AutopilotTime>,
    pub(super) drag_used: Option<AutopilotTime>,
    /// The receiver that is listened to.
    pub(super) gnss_receiver: u8,
    /// What the receiver's position is wrong by for minutes, 1 sigma, m.
    pub(super) gnss_sigma_m: f64,
    /// Since when its velocity has been a lie.
    pub(super) lying_since: Option<AutopilotTime>,
    /// Standard deviation of its latency, s.
    pub(super) gnss_latency_sigma_s: f64,
    /// The newest fix by landmarks in this outage, and what they were surveyed wrong by, 1 sigma, m.
    pub(super) landmark_fix: Option<(AutopilotTime, f64)>,
}

/// What a source reads when it observes. It changes nothing.
#[derive(Clone, Copy, Debug)]
pub(super) struct Context<'a> {
    pub(super) core: &'a Core,
    pub(super) facts: SourceFacts,
}

impl Context<'_> {
    /// The newest IMU stamp.
    pub(super) fn now(&self) -> Option<AutopilotTime> {
        self.core.stream.newest()
    }

    /// Whether the vehicle is off the ground, beyond doubt.
    pub(super) fn in_air(&self) -> bool {
        !self.on_ground() && self.above_ground_m().is_some()
    }

    /// Whether it stands on the ground, or may.
    pub(super) fn on_ground(&self) -> bool {
        let low = self.above_ground_m().is_some_and(|m| m < IN_AIR_M);
        low || self.facts.resting || self.core.vehicle.disarmed()
    }

    /// How high it is above the ground, where that is known, m.
    pub(super) fn above_ground_m(&self) -> Option<f64> {
        self.core.height.height_m().zip(self.facts.ground).map(|(height, ground)| height - ground.height_m)
    }

    /// Whether a sample of this time comes too late for the present.
    pub(super) fn is_late(&self, time: AutopilotTime, most_s: f64) -> bool {
        self.now().is_some_and(|now| now.seconds_since(time) > most_s)
    }
}
