//! What the autopilot says of the vehicle, as far as that can be believed.

use crate::sample::{Airframe, VehicleStatus};

use super::reset::Reset;
use crate::navigator::tuning::vehicle::{FLYING_M, FLYING_MPS};

/// The vehicle's own word, and what contradicts it.
#[derive(Clone, Copy, Debug, Default)]
pub(super) struct VehicleState {
    status: VehicleStatus,
    /// It was in the air while it said that it was disarmed.
    flew_disarmed: bool,
}

impl VehicleState {
    /// What the autopilot says.
    pub(super) fn says(&mut self, status: VehicleStatus) {
        if status.armed == Some(true) {
            self.flew_disarmed = false;
        }
        self.status = status;
    }

    /// Whether it has flown while it said that it was disarmed.
    pub(super) fn flew_disarmed(&self) -> bool {
        self.flew_disarmed
    }

    /// The same, of before.
    pub(super) fn recall(&mut self, flew_disarmed: bool) {
        self.flew_disarmed = flew_disarmed;
    }

    /// Whether it is of this kind.
    pub(super) fn is(&self, airframe: Airframe) -> bool {
        self.status.airframe == Some(airframe)
    }

    /// What kind it is, if it tells.
    pub(super) fn airframe(&self) -> Option<Airframe> {
        self.status.airframe
    }

    /// Whether the motors are off, as far as that can be believed: converted logs and some bridges never say anything else.
    pub(super) fn disarmed(&self) -> bool {
        self.status.armed == Some(false) && !self.flew_disarmed
    }

    /// It moves at `speed_mps` and is `above_m` above where it began, if that is known well enough.
    pub(super) fn seen_moving(&mut self, speed_mps: Option<f64>, above_m: Option<f64>) {
        let fast = speed_mps.is_some_and(|v| v > FLYING_MPS);
        let high = above_m.is_some_and(|h| h > FLYING_M);
        self.flew_disarmed |= fast || high;
    }

    /// Heights are good enough to tell flight from rest when their standard deviation is below this, m.
    pub(super) const TELLING_SIGMA_M: f64 = 0.5 * FLYING_M;

    pub(super) fn reset(&mut self, reset: &Reset) {
        // What it did before it rebooted says nothing about what it says now.
        if reset.reboots() {
            self.flew_disarmed = false;
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_vehicle_that_flies_is_not_disarmed_until_it_reboots() {
        let mut vehicle = VehicleState::default();
        vehicle.says(VehicleStatus { armed: Some(false), ..VehicleStatus::default() });
        assert!(vehicle.disarmed());
        vehicle.seen_moving(Some(1.0), Some(1.0));
        assert!(vehicle.disarmed());
        vehicle.seen_moving(None, Some(5.0));
        assert!(!vehicle.disarmed());
        vehicle.reset(&Reset::StreamBroken);
        assert!(!vehicle.disarmed());
        vehicle.reset(&Reset::Reboot);
        assert!(vehicle.disarmed());
    }
}
