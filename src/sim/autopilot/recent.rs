//! The last second of a flight that is being made up as it goes: what sensors with a latency, an interval or a mean look back at.

use std::collections::VecDeque;

use nalgebra::Vector3;

use crate::geo::so3;
use crate::sim::trajectory::{Trajectory, Truth};

/// How far back sensors look, s.
const KEPT_S: f64 = 1.0;

/// The recent truth, a step of the simulation apart. Between two steps the acceleration and the body rate are linear; before the first the
/// vehicle stood as it did then, and after the last there is nothing.
#[derive(Clone, Debug)]
pub struct RecentTruth {
    steps: VecDeque<Truth>,
}

impl RecentTruth {
    /// A past that has only this.
    pub fn new(first: Truth) -> Self {
        Self { steps: VecDeque::from([first]) }
    }

    /// The state after one more step.
    pub fn push(&mut self, truth: Truth) {
        self.steps.push_back(truth);
        while self.steps.get(1).is_some_and(|second| truth.t_s - second.t_s > KEPT_S) {
            self.steps.pop_front();
        }
    }

    /// The newest two steps that enclose a time; the same twice beyond the ends.
    fn around(&self, t_s: f64) -> Option<(&Truth, &Truth)> {
        let newest = self.steps.back()?;
        let mut after = newest;
        for step in self.steps.iter().rev() {
            if step.t_s <= t_s {
                return Some((step, after));
            }
            after = step;
        }
        Some((after, after))
    }
}

impl Trajectory for RecentTruth {
    fn at(&self, t_s: f64) -> Truth {
        let Some((a, b)) = self.around(t_s) else { return standing(t_s) };
        let step_s = b.t_s - a.t_s;
        if step_s <= 0.0 {
            return Truth { t_s, ..*a };
        }
        let into_s = (t_s - a.t_s).min(step_s);
        let part = into_s / step_s;
        let change = b.acceleration_ned - a.acceleration_ned;
        let (acceleration, slope) = (a.acceleration_ned, change / step_s);
        Truth {
            t_s,
            position_ned: a.position_ned
                + a.velocity_ned * into_s
                + acceleration * (0.5 * into_s.powi(2))
                + slope * (into_s.powi(3) / 6.0),
            velocity_ned: a.velocity_ned + acceleration * into_s + slope * (0.5 * into_s.powi(2)),
            acceleration_ned: acceleration + change * part,
            r_body_to_ned: a.r_body_to_ned
                * so3::exp(&(so3::log(&(a.r_body_to_ned.transpose() * b.r_body_to_ned)) * part)),
            body_rate: a.body_rate + (b.body_rate - a.body_rate) * part,
        }
    }
}

/// A vehicle that stands at the origin.
fn standing(t_s: f64) -> Truth {
    let zero = Vector3::zeros();
    Truth {
        t_s,
        position_ned: zero,
        velocity_ned: zero,
        acceleration_ned: zero,
        r_body_to_ned: nalgebra::Matrix3::identity(),
        body_rate: zero,
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::sim::autopilot::quadrotor::{MotorCommand, Quadrotor, QuadrotorModel};
    use crate::sim::world::Environment;

    #[test]
    fn what_lies_between_steps_meets_them_and_its_derivatives() {
        let world = Environment::trondheim();
        let mut quad = Quadrotor::standing(QuadrotorModel::small(), 0.3);
        let mut recent = RecentTruth::new(*quad.truth());
        let mut kept = Vec::new();
        for k in 0..500 {
            let turn = Vector3::new((0.03 * f64::from(k)).sin(), 0.5, 0.2) * 0.1;
            let command = MotorCommand { turn_body: turn, thrust_mps2: 12.0 };
            let truth = quad.step(0.004, &command, &world, &Vector3::new(3.0, 0.0, 0.0));
            recent.push(truth);
            kept.push(truth);
        }
        for pair in kept[300..490].windows(2) {
            let (a, b) = (&pair[0], &pair[1]);
            assert!((recent.at(a.t_s).position_ned - a.position_ned).norm() < 1e-9);
            let almost = recent.at(b.t_s - 1e-9);
            assert!((almost.position_ned - b.position_ned).norm() < 1e-7);
            assert!((almost.velocity_ned - b.velocity_ned).norm() < 1e-7);
            assert!(so3::angle_between(&almost.r_body_to_ned, &b.r_body_to_ned) < 1e-7);
        }
        assert_eq!(
            recent.at(0.2).position_ned,
            recent.steps[0].position_ned,
            "what is forgotten is the oldest"
        );
    }
}
