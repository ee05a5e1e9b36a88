//! How far the optical flow says that the vehicle has travelled, by the calibration of a while ago: a witness that GNSS cannot bend.
//!
//! The flow is calibrated against GNSS. A receiver that walks off would teach it to agree, so what testifies is the calibration that was in
//! force half a minute to a minute before, and none newer while GNSS is doubted.

use nalgebra::{Matrix2x4, Matrix4, Vector2, Vector4};

use crate::camera::FlowCalibration;
use crate::time::AutopilotTime;

use crate::navigator::tuning::flow_travel::{FREEZE_S, HOLE_S, REMEMBERED};

/// A velocity that the flow tells.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(in super::super) struct FlowTestimony {
    /// NE, m/s.
    pub(in super::super) velocity_ne: Vector2<f64>,
    /// Its derivative by the calibration's errors [b_x, b_y, s, μ].
    pub(in super::super) sensitivity: Matrix2x4<f64>,
}

/// Where the flow had come to.
#[derive(Clone, Copy, Debug)]
pub(in super::super) struct FlowPlace {
    time: AutopilotTime,
    now: FlowTestimony,
    /// ∫v dt, NE, m, and the same of the sensitivity.
    pub(in super::super) travelled_ne: Vector2<f64>,
    pub(in super::super) sensitivity: Matrix2x4<f64>,
    /// Changes with every hole: what was before is not comparable.
    pub(in super::super) stretch: u32,
}

impl FlowPlace {
    /// The same by another calibration, where `reached` is what the sensitivity has added up to when it took over.
    pub(in super::super) fn recalibrated(&self, by: &Recalibration) -> Self {
        Self { travelled_ne: self.travelled_ne + (by.reached - self.sensitivity) * by.change, ..*self }
    }

    /// `seconds` later, at the same velocity.
    fn later(&self, seconds: f64) -> Self {
        Self {
            travelled_ne: self.travelled_ne + self.now.velocity_ne * seconds,
            sensitivity: self.sensitivity + self.now.sensitivity * seconds,
            ..*self
        }
    }
}

/// Another calibration testifies: v̂ − v = J (x − x̂), so that what was travelled by the old x̂ would have been by J Δx̂ less by the new one.
#[derive(Clone, Copy, Debug)]
pub(in super::super) struct Recalibration {
    /// Δx̂, of [b_x, b_y, s, μ].
    pub(in super::super) change: Vector4<f64>,
    /// ∫J dt, where it took over: what was travelled to there stays.
    reached: Matrix2x4<f64>,
}

/// See the module's documentation.
#[derive(Clone, Debug)]
pub(in super::super) struct FlowTravel {
    /// The calibration that testifies, and the one that will.
    old: Option<FlowCalibration>,
    young: Option<(AutopilotTime, FlowCalibration)>,
    /// Newest last.
    places: Vec<FlowPlace>,
    stretch: u32,
    /// Another testifies since this was asked for.
    recalibrated: Option<Recalibration>,
}

impl FlowTravel {
    pub(in super::super) fn new() -> Self {
        Self {
            old: None,
            young: None,
            places: Vec::with_capacity(REMEMBERED),
            stretch: 0,
            recalibrated: None,
        }
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
                let reached = self.places.last().map_or(Matrix2x4::zeros(), |p| p.sensitivity);
                let by = Recalibration { change, reached };
                self.places.iter_mut().for_each(|place| *place = place.recalibrated(&by));
                self.recalibrated = Some(by);
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

    /// The flow tells a velocity.
    pub(in super::super) fn add(&mut self, time: AutopilotTime, told: FlowTestimony) {
        let place = match self.places.last() {
            Some(last) => {
                let dt = time.seconds_since(last.time);
                if dt <= 0.0 {
                    return;
                }
                if dt <= HOLE_S {
                    let mean = FlowTestimony {
                        velocity_ne: (last.now.velocity_ne + told.velocity_ne) * 0.5,
                        sensitivity: (last.now.sensitivity + told.sensitivity) * 0.5,
                    };
                    FlowPlace { time, now: told, ..FlowPlace { now: mean, ..*last }.later(dt) }
                } else {
                    self.interrupt();
                    self.beginning(time, told)
                }
            }
            None => self.beginning(time, told),
        };
        if self.places.len() >= REMEMBERED {
            self.places.remove(0);
        }
        self.places.push(place);
    }

    fn beginning(&self, time: AutopilotTime, told: FlowTestimony) -> FlowPlace {
        let (travelled_ne, sensitivity) = (Vector2::zeros(), Matrix2x4::zeros());
        FlowPlace { time, now: told, travelled_ne, sensitivity, stretch: self.stretch }
    }

    /// What comes is not comparable with what was.
    pub(in super::super) fn interrupt(&mut self) {
        self.places.clear();
        self.stretch = self.stretch.wrapping_add(1);
    }

    /// Where the flow had come to at `time`.
    pub(in super::super) fn at(&self, time: AutopilotTime) -> Option<FlowPlace> {
        let last = self.places.last()?;
        let ahead = time.seconds_since(last.time);
        if ahead >= 0.0 {
            return (ahead < HOLE_S).then(|| last.later(ahead));
        }
        let after = self.places.iter().position(|p| p.time > time)?;
        let (a, b) = (self.places.get(after.checked_sub(1)?)?, self.places.get(after)?);
        let part = time.seconds_since(a.time) / b.time.seconds_since(a.time);
        Some(FlowPlace {
            travelled_ne: a.travelled_ne.lerp(&b.travelled_ne, part),
            sensitivity: a.sensitivity + (b.sensitivity - a.sensitivity) * part,
            ..*a
        })
    }
}
