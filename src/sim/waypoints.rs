//! A multirotor that goes from point to point, at rest in between: take-off, legs, hovers with turns, landing.

use super::trajectory::{Path, Trajectory, Truth, smooth_step, thrusting};
use nalgebra::Vector3;

/// See the module's documentation. Every move is a seventh-order polynomial with velocity, acceleration and jerk zero at both ends.
#[derive(Clone, Debug, PartialEq)]
pub struct Waypoints {
    start: (Vector3<f64>, f64),
    moves: Vec<Move>,
    end_s: f64,
    drag_per_s: f64,
}

#[derive(Clone, Copy, Debug, PartialEq)]
struct Move {
    from_s: f64,
    over_s: f64,
    from: (Vector3<f64>, f64),
    to: (Vector3<f64>, f64),
}

impl Waypoints {
    /// Stands at a place in NED, m, with a heading, rad.
    pub(super) fn new(position_ned: Vector3<f64>, heading_rad: f64) -> Self {
        Self { start: (position_ned, heading_rad), moves: Vec::new(), end_s: 0.0, drag_per_s: 0.0 }
    }

    /// With this drag of its rotors, 1/s.
    pub(super) fn with_drag(mut self, drag_per_s: f64) -> Self {
        self.drag_per_s = drag_per_s;
        self
    }

    /// Stays.
    pub(super) fn wait(mut self, for_s: f64) -> Self {
        self.end_s += for_s;
        self
    }

    /// Goes somewhere.
    pub(super) fn to(self, position_ned: Vector3<f64>, over_s: f64) -> Self {
        let (_, heading) = self.last();
        self.push((position_ned, heading), over_s)
    }

    /// Turns in place.
    pub(super) fn face(self, heading_rad: f64, over_s: f64) -> Self {
        let (position, _) = self.last();
        self.push((position, heading_rad), over_s)
    }

    /// When the last move or wait has ended, s.
    pub(super) fn end_s(&self) -> f64 {
        self.end_s
    }

    fn last(&self) -> (Vector3<f64>, f64) {
        self.moves.last().map_or(self.start, |m| m.to)
    }

    fn push(mut self, to: (Vector3<f64>, f64), over_s: f64) -> Self {
        let from = self.last();
        self.moves.push(Move { from_s: self.end_s, over_s, from, to });
        self.end_s += over_s;
        self
    }

    /// Every time at which a higher derivative may jump.
    #[cfg(test)]
    pub(super) fn joins(&self) -> Vec<f64> {
        self.moves.iter().flat_map(|m| [m.from_s, m.from_s + m.over_s]).collect()
    }
}

impl Trajectory for Waypoints {
    fn at(&self, t_s: f64) -> Truth {
        let zero = Vector3::zeros();
        match self.moves[..self.moves.partition_point(|m| m.from_s <= t_s)].last() {
            None => {
                let path = Path { p: self.start.0, v: zero, a: zero, j: zero };
                thrusting(t_s, &path, self.drag_per_s, (self.start.1, 0.0))
            }
            Some(m) => {
                let [s, ds, ..] = smooth_step((t_s - m.from_s) / m.over_s);
                let by = m.to.1 - m.from.1;
                let path = Path::leg(m.from.0, m.to.0, t_s - m.from_s, m.over_s);
                thrusting(t_s, &path, self.drag_per_s, (m.from.1 + s * by, ds * by / m.over_s))
            }
        }
    }
}
