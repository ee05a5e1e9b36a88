//! How far the optical flow says that the vehicle has travelled, by the calibration of a while ago: a witness that GNSS cannot bend.
//!
//! The flow is calibrated against GNSS. A receiver that walks off would teach it to agree, so what testifies is the calibration that was in
//! force half a minute to a minute before, and none newer while GNSS is doubted.

use nalgebra::Matrix4;

use crate::camera::FlowCalibration;
use crate::time::AutopilotTime;

use super::travel_path::{Recalibration, TravelPath, TravelPlace};
use crate::navigator::tuning::flow_travel::{FREEZE_S, HOLE_S};

/// See the module's documentation.
#[derive(Clone, Debug)]
pub(in super::super) struct FlowTravel {
    /// The calibration that testifies, and the one that will.
    old: Option<FlowCalibration>,
    young: Option<(AutopilotTime, FlowCalibration)>,
    path: TravelPath,
    /// Another testifies since this was asked for.
    recalibrated: Option<Recalibration>,
}

impl FlowTravel {
    pub(in super::super) fn new() -> Self {
        Self { old: None, young: None, path: TravelPath::new(HOLE_S), recalibrated: None }
    }

    /// The calibration that testifies at `now`, given the one in force. It moves on with time, unless GNSS is `doubted`. `None` until it is
    /// old enough.
    pub(in super::super) fn calibration(
        &mut self,
        now: AutopilotTime,
        in_force: &FlowCalibration,
        doubted: bool,
    ) -> Option<&FlowCalibration> {
        let (since, _) = self.young.get_or_insert_with(|| (now, in_force.clone()));
        if doubted {
            // What was learned since may be the lie.
            *since = now;
        } else if now.seconds_since(*since) > FREEZE_S {
            let next = self.young.replace((now, in_force.clone())).map(|(_, calibration)| calibration);
            let before = std::mem::replace(&mut self.old, next);
            if let Some((before, old)) = before.as_ref().zip(self.old.as_ref()) {
                let change = old.estimate() - before.estimate();
                self.recalibrated = Some(self.path.recalibrate(change));
            }
        }
        self.old.as_ref()
    }

    /// Whether another calibration testifies since this was asked.
    pub(in super::super) fn take_recalibration(&mut self) -> Option<Recalibration> {
        self.recalibrated.take()
    }

    /// The calibration that testifies: what the flow is worth if GNSS has lied since.
    pub(in super::super) fn testifying(&self) -> Option<&FlowCalibration> {
        self.old.as_ref()
    }

    /// Its covariance.
    pub(in super::super) fn covariance(&self) -> Option<&Matrix4<f64>> {
        self.old.as_ref().map(FlowCalibration::covariance)
    }

    /// What has been learned since the calibration that testifies was learned from a lie.
    pub(in super::super) fn forget_the_young(&mut self) {
        self.young = None;
    }

    /// Where it has come to.
    pub(in super::super) fn path(&mut self) -> &mut TravelPath {
        &mut self.path
    }

    /// Where it had come to at `time`.
    pub(in super::super) fn at(&self, time: AutopilotTime) -> Option<TravelPlace> {
        self.path.at(time)
    }

    /// What comes is not comparable with what was.
    pub(in super::super) fn interrupt(&mut self) {
        self.path.interrupt();
    }
}
