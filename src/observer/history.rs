//! A fixed-size history of predicted positions and velocities, for samples that arrive late.

use crate::time::{AutopilotTime, Past, Span, Stamped};
use nalgebra::Vector3;

/// A position and velocity in NED at a time.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct PastMotion {
    /// When.
    pub stamp: AutopilotTime,
    /// Position in NED, m.
    pub position_ned: Vector3<f64>,
    /// Velocity in NED, m/s.
    pub velocity_ned: Vector3<f64>,
}

impl Stamped for PastMotion {
    fn stamp(&self) -> AutopilotTime {
        self.stamp
    }
}

/// The past of position and velocity, thinned out to a least spacing.
#[derive(Clone, Debug)]
pub struct MotionHistory {
    past: Past<PastMotion>,
    spacing: Span,
}

impl MotionHistory {
    /// Room for at least `span` when entries are no denser than `spacing`: a faster IMU is thinned out, so the span covered does not
    /// depend on its rate. Between entries values are interpolated linearly, which at 20 m/s² and 10 ms errs by 0.25 mm.
    pub fn new(span: Span, spacing: Span) -> Self {
        let spacing = Span::from_micros(spacing.micros().max(100));
        let capacity = (span.micros().max(0) / spacing.micros()).clamp(1, 100_000) as usize + 2;
        Self { past: Past::new(capacity), spacing }
    }

    /// Forgets everything.
    pub fn clear(&mut self) {
        self.past.clear();
    }

    /// Stores an entry unless it is closer than the spacing to the newest one (or earlier).
    pub fn record(&mut self, entry: PastMotion) {
        // One part in ten is let pass, so that the jitter of an IMU at the very spacing does not drop every other sample.
        let least = self.spacing.micros() - self.spacing.micros() / 10;
        if self.past.newest().is_none_or(|n| (entry.stamp - n.stamp).micros() >= least) {
            self.past.push(entry);
        }
    }

    /// Position and velocity at `stamp`, linearly between the entries around it; `now` is the newest value and need not be stored.
    /// After `now` the value is extrapolated at constant velocity. `None` before the oldest entry.
    pub fn at(&self, stamp: AutopilotTime, now: &PastMotion) -> Option<(Vector3<f64>, Vector3<f64>)> {
        let ahead = stamp.seconds_since(now.stamp);
        if ahead >= 0.0 {
            return Some((now.position_ned + ahead * now.velocity_ned, now.velocity_ned));
        }
        let newest = self.past.newest()?;
        let (before, after, s) = if newest.stamp <= stamp {
            (newest, now, stamp.seconds_since(newest.stamp) / now.stamp.seconds_since(newest.stamp))
        } else {
            self.past.around(stamp)?
        };
        Some((
            before.position_ned.lerp(&after.position_ned, s),
            before.velocity_ned.lerp(&after.velocity_ned, s),
        ))
    }

    /// Adds a velocity correction everywhere and the position correction it implies, `e_p` at `stamp`: the free motion
    /// e_p + e_v (t − stamp). So the next late sample is compared with what would have been predicted, had this one been in time.
    pub fn correct(&mut self, stamp: AutopilotTime, e_p: &Vector3<f64>, e_v: &Vector3<f64>) {
        for entry in self.past.iter_mut() {
            entry.position_ned += e_p + e_v * entry.stamp.seconds_since(stamp);
            entry.velocity_ned += e_v;
        }
    }
}
