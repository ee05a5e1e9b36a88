//! A fixed-size history of predicted positions and velocities, for samples that arrive late.

use crate::time::{AutopilotTime, Span};
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

/// A ring of [`PastMotion`], oldest overwritten first. Allocated once, at construction.
#[derive(Clone, Debug)]
pub struct MotionHistory {
    ring: Box<[PastMotion]>,
    next: usize,
    len: usize,
    spacing: Span,
}

impl MotionHistory {
    /// Room for at least `span` when entries are no denser than `spacing`: a faster IMU is thinned out, so the span covered does not
    /// depend on its rate. Between entries values are interpolated linearly, which at 20 m/s² and 10 ms errs by 0.25 mm.
    pub fn new(span: Span, spacing: Span) -> Self {
        let spacing = Span::from_micros(spacing.micros().max(100));
        let capacity = (span.micros().max(0) / spacing.micros()).clamp(1, 100_000) as usize + 2;
        let empty = PastMotion {
            stamp: AutopilotTime::from_micros(0),
            position_ned: Vector3::zeros(),
            velocity_ned: Vector3::zeros(),
        };
        Self { ring: vec![empty; capacity].into_boxed_slice(), next: 0, len: 0, spacing }
    }

    /// Forgets everything.
    pub fn clear(&mut self) {
        self.next = 0;
        self.len = 0;
    }

    /// Stores an entry unless it is closer than the spacing to the newest one (or earlier).
    pub fn record(&mut self, entry: PastMotion) {
        // One part in ten is let pass, so that the jitter of an IMU at the very spacing does not drop every other sample.
        let least = self.spacing.micros() - self.spacing.micros() / 10;
        if self.newest().is_some_and(|n| (entry.stamp - n.stamp).micros() < least) {
            return;
        }
        if let Some(slot) = self.ring.get_mut(self.next) {
            *slot = entry;
            self.next = (self.next + 1) % self.ring.len();
            self.len = (self.len + 1).min(self.ring.len());
        }
    }

    fn newest(&self) -> Option<&PastMotion> {
        self.back(0)
    }

    /// The i-th entry from the newest.
    fn back(&self, i: usize) -> Option<&PastMotion> {
        if i >= self.len {
            return None;
        }
        let n = self.ring.len();
        self.ring.get((self.next + n - 1 - i) % n)
    }

    /// Position and velocity at `stamp`, linearly between the entries around it; `now` is the newest value and need not be stored.
    /// After `now` the value is extrapolated at constant velocity. `None` before the oldest entry.
    pub fn at(&self, stamp: AutopilotTime, now: &PastMotion) -> Option<(Vector3<f64>, Vector3<f64>)> {
        let ahead = stamp.seconds_since(now.stamp);
        if ahead >= 0.0 {
            return Some((now.position_ned + ahead * now.velocity_ned, now.velocity_ned));
        }
        let mut after = now;
        for i in 0..self.len {
            let before = self.back(i)?;
            if before.stamp <= stamp {
                let gap = after.stamp.seconds_since(before.stamp);
                let s = if gap > 0.0 { stamp.seconds_since(before.stamp) / gap } else { 0.0 };
                return Some((
                    before.position_ned.lerp(&after.position_ned, s),
                    before.velocity_ned.lerp(&after.velocity_ned, s),
                ));
            }
            after = before;
        }
        None
    }

    /// Adds a velocity correction everywhere and the position correction it implies, `e_p` at `stamp`: the free motion
    /// e_p + e_v (t − stamp). So the next late sample is compared with what would have been predicted, had this one been in time.
    pub fn correct(&mut self, stamp: AutopilotTime, e_p: &Vector3<f64>, e_v: &Vector3<f64>) {
        // Slots never written are moved along, too: they are not read.
        for entry in &mut self.ring {
            entry.position_ned += e_p + e_v * entry.stamp.seconds_since(stamp);
            entry.velocity_ned += e_v;
        }
    }
}
