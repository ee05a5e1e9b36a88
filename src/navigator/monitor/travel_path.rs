//! How far something that tells a velocity says that the vehicle has travelled, and by how much another calibration x of it would have said another way.

use nalgebra::{Matrix2x4, Vector2, Vector4};

use crate::navigator::tuning::travel_path::REMEMBERED;
use crate::time::AutopilotTime;

/// A velocity that it tells.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(in super::super) struct TravelTestimony {
    /// NE, m/s.
    pub(in super::super) velocity_ne: Vector2<f64>,
    /// Its derivative by the errors x of what it is calibrated by.
    pub(in super::super) sensitivity: Matrix2x4<f64>,
}

/// Where it had come to.
#[derive(Clone, Copy, Debug)]
pub(in super::super) struct TravelPlace {
    time: AutopilotTime,
    now: TravelTestimony,
    /// ∫v dt, NE, m, and the same of the sensitivity.
    pub(in super::super) travelled_ne: Vector2<f64>,
    pub(in super::super) sensitivity: Matrix2x4<f64>,
    /// Changes with every hole: what was before is not comparable.
    pub(in super::super) stretch: u32,
}

impl TravelPlace {
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
    /// Δx̂.
    pub(in super::super) change: Vector4<f64>,
    /// ∫J dt, where it took over: what was travelled to there stays.
    reached: Matrix2x4<f64>,
}

/// The places of the last seconds.
#[derive(Clone, Debug)]
pub(in super::super) struct TravelPath {
    /// Newest last.
    places: Vec<TravelPlace>,
    stretch: u32,
    hole_s: f64,
}

impl TravelPath {
    /// A silence of more than `hole_s` s is a hole.
    pub(in super::super) fn new(hole_s: f64) -> Self {
        Self { places: Vec::with_capacity(REMEMBERED), stretch: 0, hole_s }
    }

    /// Another calibration testifies, by `change` from the one before.
    pub(in super::super) fn recalibrate(&mut self, change: Vector4<f64>) -> Recalibration {
        let reached = self.places.last().map_or(Matrix2x4::zeros(), |p| p.sensitivity);
        let by = Recalibration { change, reached };
        self.places.iter_mut().for_each(|place| *place = place.recalibrated(&by));
        by
    }

    /// It tells a velocity.
    pub(in super::super) fn add(&mut self, time: AutopilotTime, told: TravelTestimony) {
        let place = match self.places.last() {
            Some(last) => {
                let dt = time.seconds_since(last.time);
                if dt <= 0.0 {
                    return;
                }
                if dt <= self.hole_s {
                    let mean = TravelTestimony {
                        velocity_ne: (last.now.velocity_ne + told.velocity_ne) * 0.5,
                        sensitivity: (last.now.sensitivity + told.sensitivity) * 0.5,
                    };
                    TravelPlace { time, now: told, ..TravelPlace { now: mean, ..*last }.later(dt) }
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

    fn beginning(&self, time: AutopilotTime, told: TravelTestimony) -> TravelPlace {
        let (travelled_ne, sensitivity) = (Vector2::zeros(), Matrix2x4::zeros());
        TravelPlace { time, now: told, travelled_ne, sensitivity, stretch: self.stretch }
    }

    /// What comes is not comparable with what was.
    pub(in super::super) fn interrupt(&mut self) {
        self.places.clear();
        self.stretch = self.stretch.wrapping_add(1);
    }

    /// Where it had come to at `time`.
    pub(in super::super) fn at(&self, time: AutopilotTime) -> Option<TravelPlace> {
        let last = self.places.last()?;
        let ahead = time.seconds_since(last.time);
        if ahead >= 0.0 {
            return (ahead < self.hole_s).then(|| last.later(ahead));
        }
        let after = self.places.iter().position(|p| p.time > time)?;
        let (a, b) = (self.places.get(after.checked_sub(1)?)?, self.places.get(after)?);
        let part = time.seconds_since(a.time) / b.time.seconds_since(a.time);
        Some(TravelPlace {
            travelled_ne: a.travelled_ne.lerp(&b.travelled_ne, part),
            sensitivity: a.sensitivity + (b.sensitivity - a.sensitivity) * part,
            ..*a
        })
    }
}
