//! The dead-reckoned frame D: where the body was and how it was turned at any time of a bounded past, as its own motion has it.
//!
//! d ← d + ΨJ(ωh)vh, Ψ ← Ψ Exp(ωh), exact for a motion that is held. D is fixed to the ground but for the drift of the dead reckoning, so
//! whatever is known of the ground in D stays known: a sighting that comes late needs only the (Ψ, d) of when it was taken.

use nalgebra::{Matrix3, Vector3};

use super::motion::BodyMotion;
use super::tuning::{FASTEST, RENEWAL};
use crate::geo::polar_rotation;
use crate::time::{AutopilotTime, Past, Span, Stamped};

/// Pose of the body in D.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct DeadReckoned {
    /// Ψ, from body to D.
    pub r_body_to_d: Matrix3<f64>,
    /// d, the body's origin in D, m.
    pub position_d: Vector3<f64>,
}

/// What was made of a motion.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum MotionVerdict {
    /// Carried on.
    Used,
    /// It is not finite, or faster than anything that flies: not used.
    NotFinite,
    /// It ends at or before the present: not used.
    OutOfOrder,
    /// Carried on over a gap of as many seconds with the motion held, which is not to be trusted.
    Gap(f64),
}

/// Why a time has no pose.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum NotRemembered {
    /// As many seconds after the present.
    Future(f64),
    /// As many seconds before the oldest that is remembered.
    Past(f64),
}

#[derive(Clone, Copy, Debug)]
struct Point {
    time: AutopilotTime,
    pose: DeadReckoned,
    /// What leads to the next point.
    onward: BodyMotion,
}

impl Stamped for Point {
    fn stamp(&self) -> AutopilotTime {
        self.time
    }
}

/// Dead reckoning with a memory that is bounded in time and in points; it allocates at its construction only.
#[derive(Clone, Debug)]
pub struct DeadReckoning {
    points: Past<Point>,
    history: Span,
    gap: Span,
    steps: u32,
}

impl DeadReckoning {
    /// Starts at `time` in the origin of D, its axes those of the body. Remembers `history_s`, and no more than `capacity` points; between
    /// motions that are more than `gap_s` apart it tells so.
    pub fn new(time: AutopilotTime, history_s: f64, gap_s: f64, capacity: usize) -> Self {
        let mut points = Past::new(capacity.max(2));
        let pose = DeadReckoned { r_body_to_d: Matrix3::identity(), position_d: Vector3::zeros() };
        points.push(Point { time, pose, onward: BodyMotion::REST });
        let (history, gap) = (Span::from_seconds(history_s), Span::from_seconds(gap_s));
        Self { points, history, gap, steps: 0 }
    }

    /// Carries on to `time` by a motion that was held since the present.
    pub fn push(&mut self, time: AutopilotTime, motion: &BodyMotion) -> MotionVerdict {
        if !motion.is_finite() || motion.velocity_body.amax().max(motion.angular_rate_body.amax()) > FASTEST {
            return MotionVerdict::NotFinite;
        }
        let Some(last) = self.points.iter_mut().next() else { return MotionVerdict::OutOfOrder };
        if time <= last.time {
            return MotionVerdict::OutOfOrder;
        }
        let dt = time - last.time;
        last.onward = *motion;
        let mut pose = moved(&last.pose, motion, dt.seconds());
        self.steps += 1;
        if self.steps.is_multiple_of(RENEWAL) {
            pose.r_body_to_d = polar_rotation(&pose.r_body_to_d).unwrap_or(pose.r_body_to_d);
        }
        self.points.push(Point { time, pose, onward: BodyMotion::REST });
        if dt > self.gap { MotionVerdict::Gap(dt.seconds()) } else { MotionVerdict::Used }
    }

    /// The present.
    pub fn time(&self) -> AutopilotTime {
        self.points.newest().map_or(AutopilotTime::from_micros(0), |p| p.time)
    }

    /// Where the body is.
    pub fn present(&self) -> DeadReckoned {
        let start = DeadReckoned { r_body_to_d: Matrix3::identity(), position_d: Vector3::zeros() };
        self.points.newest().map_or(start, |p| p.pose)
    }

    /// Where it was.
    ///
    /// # Errors
    /// [`NotRemembered`].
    pub fn at(&self, time: AutopilotTime) -> Result<DeadReckoned, NotRemembered> {
        let now = self.time();
        if time > now {
            return Err(NotRemembered::Future(time.seconds_since(now)));
        }
        let oldest = self.points.iter().next_back().map_or(now, |p| p.time).max(now - self.history);
        match self.points.iter().find(|p| p.time <= time) {
            Some(p) if time >= oldest => Ok(moved(&p.pose, &p.onward, time.seconds_since(p.time))),
            _ => Err(NotRemembered::Past(oldest.seconds_since(time))),
        }
    }
}

fn moved(from: &DeadReckoned, motion: &BodyMotion, dt_s: f64) -> DeadReckoned {
    let (turn, way) = motion.over(dt_s);
    DeadReckoned {
        r_body_to_d: from.r_body_to_d * turn,
        position_d: from.position_d + from.r_body_to_d * way,
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn ms(ms: i64) -> AutopilotTime {
        AutopilotTime::from_micros(ms * 1000)
    }

    const TURNING: BodyMotion = BodyMotion {
        velocity_body: Vector3::new(2.0, 0.0, 0.0),
        angular_rate_body: Vector3::new(0.0, 0.0, 0.5),
    };

    #[test]
    fn a_held_motion_is_the_same_circle_in_any_number_of_steps() {
        let mut fine = DeadReckoning::new(ms(0), 10.0, 1.0, 4096);
        (1..=1000).for_each(|k| assert_eq!(fine.push(ms(2 * k), &TURNING), MotionVerdict::Used));
        for k in [0, 3, 777, 1999, 2000] {
            let t = k as f64 * 1e-3;
            let truth = Vector3::new((0.5 * t).sin(), 1.0 - (0.5 * t).cos(), 0.0) * 4.0;
            assert!((fine.at(ms(k)).unwrap().position_d - truth).norm() < 1e-12);
        }
        assert_eq!(fine.present(), fine.at(ms(2000)).unwrap());
    }

    #[test]
    fn the_past_is_bounded_and_the_future_unknown() {
        let mut reckoning = DeadReckoning::new(ms(0), 0.5, 0.1, 64);
        (1..=100).for_each(|k| assert_eq!(reckoning.push(ms(20 * k), &TURNING), MotionVerdict::Used));
        assert!(reckoning.at(ms(1500)).is_ok());
        assert_eq!(reckoning.at(ms(1499)), Err(NotRemembered::Past(0.001)));
        assert_eq!(reckoning.at(ms(2001)), Err(NotRemembered::Future(0.001)));
        // Faster than planned for: fewer seconds, not more memory.
        (1..=1000).for_each(|k| assert_eq!(reckoning.push(ms(2000 + k), &TURNING), MotionVerdict::Used));
        assert_eq!(reckoning.points.iter().count(), 64);
        assert!(matches!(reckoning.at(ms(2900)), Err(NotRemembered::Past(_))));
    }

    #[test]
    fn what_cannot_be_used_changes_nothing() {
        let mut reckoning = DeadReckoning::new(ms(0), 0.5, 0.1, 64);
        reckoning.push(ms(10), &TURNING);
        let before = reckoning.present();
        let nan = BodyMotion { velocity_body: Vector3::new(f64::NAN, 0.0, 0.0), ..TURNING };
        let fast = BodyMotion { velocity_body: Vector3::new(1e300, 0.0, 0.0), ..TURNING };
        assert_eq!(reckoning.push(ms(20), &nan), MotionVerdict::NotFinite);
        assert_eq!(reckoning.push(ms(20), &fast), MotionVerdict::NotFinite);
        assert_eq!(reckoning.push(ms(10), &TURNING), MotionVerdict::OutOfOrder);
        assert_eq!(reckoning.present(), before);
        assert_eq!(reckoning.push(ms(120), &TURNING), MotionVerdict::Gap(0.11));
    }
}
