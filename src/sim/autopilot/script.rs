//! The pilot of the double: a list of legs, flown one after the other.

use std::collections::VecDeque;
use std::f64::consts::FRAC_PI_2;

use nalgebra::Vector3;

use crate::sim::models::OutageKind;

/// One thing to do.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum ScriptLeg {
    /// Wait where it is, s.
    Wait(f64),
    /// Arm, and try again every second until the autopilot lets it.
    Arm,
    /// Climb to a height over the place of take-off, m.
    TakeOff(f64),
    /// Fly to north and east of the place of take-off, m, at a heading, rad.
    FlyTo {
        /// North, m.
        north_m: f64,
        /// East, m.
        east_m: f64,
        /// Heading, rad.
        heading_rad: f64,
    },
    /// The receiver loses its fix in this way, or has it back.
    Gnss(Option<OutageKind>),
    /// The pilot's switch of the source sets (ArduPilot).
    SelectSet(u8),
    /// Land.
    Land,
}

/// What the vehicle is like when the pilot looks.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct ScriptView {
    /// Seconds of the simulation.
    pub now_s: f64,
    /// Whether it is armed.
    pub armed: bool,
    /// Where it believes to be from the place of take-off, NED, m.
    pub way_ned: Vector3<f64>,
    /// How fast it believes to move, m/s.
    pub speed_mps: f64,
}

/// What the pilot wants now.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum ScriptOrder {
    /// Nothing new.
    Nothing,
    /// Arm.
    Arm,
    /// Be at a place, NED from the place of take-off, with a heading.
    Be(Vector3<f64>, f64),
    /// As [`ScriptLeg::Gnss`].
    Gnss(Option<OutageKind>),
    /// As [`ScriptLeg::SelectSet`].
    SelectSet(u8),
    /// Land.
    Land,
}

/// A place is reached within this, m and m/s, …
const REACHED: [f64; 2] = [0.5, 0.4];
/// … or given up after this, s.
const PATIENCE_S: f64 = 40.0;
/// Between two attempts to arm, s.
const ARM_EVERY_S: f64 = 1.0;

/// A script in flight.
#[derive(Clone, Debug, PartialEq)]
pub struct FlightScript {
    legs: VecDeque<ScriptLeg>,
    since_s: f64,
    begun: bool,
    place: (Vector3<f64>, f64),
}

impl FlightScript {
    /// A script that begins with the first step.
    pub fn new(legs: impl IntoIterator<Item = ScriptLeg>) -> Self {
        let place = (Vector3::zeros(), 0.0);
        Self { legs: legs.into_iter().collect(), since_s: 0.0, begun: false, place }
    }

    /// The flight that the documentation describes: wait on the ground, a square with GNSS, GNSS lost in a hover (never without
    /// `loss`), `hold_s` of hover and a square without it, GNSS again, and a landing. With `switches` the pilot selects source set 2
    /// three seconds after the loss and set 1 when GNSS has been back for twelve.
    pub fn outage(ground_s: f64, hold_s: f64, loss: Option<OutageKind>, switches: bool) -> Self {
        let side_m = 15.0;
        let select = |set| (switches && loss.is_some()).then_some(ScriptLeg::SelectSet(set));
        let mut legs = vec![ScriptLeg::Wait(ground_s), ScriptLeg::Arm, ScriptLeg::TakeOff(12.0)];
        legs.extend(square(side_m));
        legs.extend([ScriptLeg::Wait(5.0), ScriptLeg::Gnss(loss), ScriptLeg::Wait(3.0)]);
        legs.extend(select(2));
        legs.push(ScriptLeg::Wait(hold_s));
        legs.extend(square(side_m));
        legs.extend([ScriptLeg::Wait(5.0), ScriptLeg::Gnss(None), ScriptLeg::Wait(12.0)]);
        legs.extend(select(1));
        legs.extend([ScriptLeg::Wait(8.0), ScriptLeg::Land]);
        Self::new(legs)
    }

    /// Whether there is nothing left to do.
    pub fn is_over(&self) -> bool {
        self.legs.is_empty()
    }

    /// What the pilot wants in this step.
    pub fn step(&mut self, view: &ScriptView) -> ScriptOrder {
        let Some(&leg) = self.legs.front() else { return ScriptOrder::Nothing };
        let begins = !std::mem::replace(&mut self.begun, true);
        if begins {
            self.since_s = view.now_s;
        }
        let (order, done) = self.leg(leg, begins, view);
        if done {
            self.legs.pop_front();
            self.begun = false;
        }
        order
    }

    fn leg(&mut self, leg: ScriptLeg, begins: bool, view: &ScriptView) -> (ScriptOrder, bool) {
        let for_s = view.now_s - self.since_s;
        match leg {
            ScriptLeg::Wait(wait_s) => (self.be(view), for_s >= wait_s),
            ScriptLeg::Arm if view.armed => (ScriptOrder::Nothing, true),
            ScriptLeg::Arm if begins || for_s >= ARM_EVERY_S => {
                self.since_s = view.now_s;
                (ScriptOrder::Arm, false)
            }
            ScriptLeg::Arm => (ScriptOrder::Nothing, false),
            ScriptLeg::TakeOff(height_m) => {
                self.place.0.z = -height_m;
                (self.be(view), self.reached(view, for_s))
            }
            ScriptLeg::FlyTo { north_m, east_m, heading_rad } => {
                self.place = (Vector3::new(north_m, east_m, self.place.0.z), heading_rad);
                (self.be(view), self.reached(view, for_s))
            }
            ScriptLeg::Gnss(kind) => (ScriptOrder::Gnss(kind), true),
            ScriptLeg::SelectSet(number) => (ScriptOrder::SelectSet(number), true),
            ScriptLeg::Land => (ScriptOrder::Land, true),
        }
    }

    fn be(&self, view: &ScriptView) -> ScriptOrder {
        let (place, heading_rad) = self.place;
        if view.armed { ScriptOrder::Be(place, heading_rad) } else { ScriptOrder::Nothing }
    }

    fn reached(&self, view: &ScriptView, for_s: f64) -> bool {
        let there = (view.way_ned - self.place.0).norm() < REACHED[0] && view.speed_mps < REACHED[1];
        there || for_s > PATIENCE_S
    }
}

/// A square, clockwise from its south-west corner and back, the nose ahead.
fn square(side_m: f64) -> impl Iterator<Item = ScriptLeg> {
    let corners = [(side_m, 0.0), (side_m, side_m), (0.0, side_m), (0.0, 0.0)];
    corners.into_iter().enumerate().map(|(k, (north_m, east_m))| ScriptLeg::FlyTo {
        north_m,
        east_m,
        heading_rad: k as f64 * FRAC_PI_2,
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn legs_are_flown_in_order_and_arming_is_tried_again() {
        let mut script = FlightScript::new([
            ScriptLeg::Wait(2.0),
            ScriptLeg::Arm,
            ScriptLeg::TakeOff(5.0),
            ScriptLeg::Land,
        ]);
        let mut orders = Vec::new();
        for k in 0..100 {
            let now_s = 0.1 * f64::from(k);
            let armed = now_s > 4.5;
            let way_ned = Vector3::new(0.0, 0.0, if now_s > 7.0 { -5.0 } else { 0.0 });
            let order = script.step(&ScriptView { now_s, armed, way_ned, speed_mps: 0.0 });
            if order != ScriptOrder::Nothing && orders.last() != Some(&order) || order == ScriptOrder::Arm {
                orders.push(order);
            }
        }
        let up = ScriptOrder::Be(Vector3::new(0.0, 0.0, -5.0), 0.0);
        assert_eq!(orders, [ScriptOrder::Arm, ScriptOrder::Arm, ScriptOrder::Arm, up, ScriptOrder::Land]);
        assert!(script.is_over());
    }
}
