//! What is published beside what is estimated: the only owner of the position's and the height's offset, of glides, jumps and the reset
//! counter.
//!
//! A decision (a return of GNSS, a landmark, a convicted sensor) moves the estimate at once; the published position stays and glides after
//! it. Where the way is too long it jumps, and the reset counter says so.

use nalgebra::{Matrix2, Vector3};

use super::reset::Reset;
use super::settings::{HeightSettings, RejoinSettings};
use crate::navigator::tuning::published::{HEIGHT_JOINED_M, JOINED_M, ORIGIN_MOVED_M, SMOOTHED_S};

/// See the module's documentation.
#[derive(Clone, Copy, Debug, Default)]
pub(super) struct Published {
    /// Published less estimated position, NED, m.
    offset_ned: Vector3<f64>,
    /// Published less estimated height, m, after a decision: glides to zero.
    gliding_m: f64,
    /// And what tracking has moved the height by just now, m: goes at once.
    smoothed_m: f64,
    /// What the glides move the published position by at present, NED, m/s.
    glide_ned: Vector3<f64>,
    reset_counter: u8,
}

impl Published {
    /// Published less estimated position, NED, m.
    pub(super) fn offset_ned(&self) -> Vector3<f64> {
        self.offset_ned
    }

    /// Published less estimated height, m.
    pub(super) fn height_offset_m(&self) -> f64 {
        self.gliding_m + self.smoothed_m
    }

    /// What the glides move the published position by, beyond the estimate's own velocity, NED, m/s.
    pub(super) fn glide_velocity_ned(&self) -> Vector3<f64> {
        self.glide_ned
    }

    /// Changes whenever the published position or height jumps.
    pub(super) fn reset_counter(&self) -> u8 {
        self.reset_counter
    }

    /// A position that is still gliding is off by what is missing, NE, m².
    pub(super) fn offset_covariance(&self) -> Matrix2<f64> {
        let o = self.offset_ned.xy();
        o * o.transpose()
    }

    /// The estimate was moved horizontally by `shift_ned`; the published position stays where it is.
    pub(super) fn stays(&mut self, shift_ned: &Vector3<f64>) {
        self.offset_ned -= Vector3::new(shift_ned.x, shift_ned.y, 0.0);
    }

    /// Position's offset, NED, gliding and smoothed height, m, and reset counter.
    pub(super) fn memory(&self) -> ([f64; 3], [f64; 2], u8) {
        (self.offset_ned.into(), [self.gliding_m, self.smoothed_m], self.reset_counter)
    }

    /// Goes on from there.
    pub(super) fn recall(
        &mut self,
        (offset_ned, [gliding_m, smoothed_m], reset_counter): ([f64; 3], [f64; 2], u8),
    ) {
        let offset_ned = Vector3::from(offset_ned);
        *self = Self { offset_ned, gliding_m, smoothed_m, glide_ned: Vector3::zeros(), reset_counter };
    }

    /// There is nothing to be continuous with: the estimate is published as it is.
    pub(super) fn begin(&mut self) {
        self.offset_ned = Vector3::zeros();
        self.rest();
    }

    /// The published position jumps to the estimate; by how much, m.
    pub(super) fn jump(&mut self) -> f64 {
        let away = std::mem::take(&mut self.offset_ned).norm();
        self.rest();
        self.count_reset();
        away
    }

    /// The estimate jumped and the published position with it.
    pub(super) fn count_reset(&mut self) {
        self.reset_counter = self.reset_counter.wrapping_add(1);
    }

    /// The position glides for `dt` s.
    pub(super) fn glide(&mut self, dt: f64, settings: &RejoinSettings) {
        let away = self.offset_ned.norm();
        if away <= 0.0 {
            return self.rest();
        }
        let before = self.offset_ned;
        let step = (settings.glide_mps * dt).min(away);
        self.offset_ned *= 1.0 - step / away;
        if dt > 0.0 {
            let moved = (self.offset_ned - before) / dt;
            (self.glide_ned.x, self.glide_ned.y) = (moved.x, moved.y);
        }
    }

    /// The position does not glide at present.
    pub(super) fn rest(&mut self) {
        (self.glide_ned.x, self.glide_ned.y) = (0.0, 0.0);
    }

    /// Whether the position has arrived at the estimate.
    pub(super) fn has_joined(&self) -> bool {
        self.offset_ned.norm() < JOINED_M
    }

    /// The estimated height was moved by `moved_m`: by a decision it glides there, in tracking it is smoothed.
    pub(super) fn height_moved(&mut self, moved_m: f64, decision: bool) {
        if decision {
            self.gliding_m -= moved_m;
        } else {
            self.smoothed_m -= moved_m;
        }
    }

    /// The height glides for `dt` s.
    pub(super) fn glide_height(&mut self, dt: f64, settings: &HeightSettings) {
        self.smoothed_m *= (1.0 - dt / SMOOTHED_S).max(0.0);
        let away = self.gliding_m;
        self.glide_ned.z = 0.0;
        if away != 0.0 {
            let left = (away.abs() - settings.glide_mps * dt).max(0.0);
            self.gliding_m = if left < HEIGHT_JOINED_M { 0.0 } else { left.copysign(away) };
            if dt > 0.0 {
                self.glide_ned.z = (away - self.gliding_m) / dt;
            }
        }
    }

    /// There is no height to be continuous with.
    pub(super) fn begin_height(&mut self) {
        (self.gliding_m, self.smoothed_m, self.glide_ned.z) = (0.0, 0.0, 0.0);
    }

    /// The published height jumps to the estimate; by how much, m, if it had to.
    pub(super) fn jump_height(&mut self) -> Option<f64> {
        let jump = self.height_offset_m();
        self.begin_height();
        (jump != 0.0).then(|| {
            self.count_reset();
            -jump
        })
    }

    pub(super) fn reset(&mut self, reset: &Reset) {
        match reset {
            Reset::OriginMoved(moved) if moved.norm() > ORIGIN_MOVED_M => self.count_reset(),
            Reset::Reboot | Reset::ClockSetBack => {
                self.begin();
                self.begin_height();
                self.count_reset();
            }
            _ => {}
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::config::{Settings, Sources};

    const REJOIN: RejoinSettings = RejoinSettings { glide_mps: 3.0, jump_m: 50.0 };

    #[test]
    fn the_published_position_stays_when_the_estimate_moves_and_glides_after_it() {
        let mut published = Published::default();
        published.stays(&Vector3::new(3.0, 4.0, 7.0));
        assert_eq!(published.offset_ned(), Vector3::new(-3.0, -4.0, 0.0));
        published.glide(1.0, &REJOIN);
        assert!((published.offset_ned().norm() - 2.0).abs() < 1e-12);
        published.glide(1.0, &REJOIN);
        assert!(published.has_joined());
        assert_eq!(published.reset_counter(), 0);
    }

    #[test]
    fn who_integrates_the_glides_velocity_gets_the_glide() {
        let settings = Settings::load(&Sources::default()).unwrap();
        let height = HeightSettings { glide_mps: 0.5, ..settings.pipeline.navigator.height };
        let mut published = Published::default();
        published.stays(&Vector3::new(3.0, 4.0, 0.0));
        published.height_moved(2.0, true);
        let mut integrated = Vector3::zeros();
        for _ in 0..1000 {
            published.glide(0.01, &REJOIN);
            published.glide_height(0.01, &height);
            integrated += published.glide_velocity_ned() * 0.01;
        }
        // From 5 m behind to the estimate, and up (down is positive) by the 2 m that the height was moved.
        assert!((integrated - Vector3::new(3.0, 4.0, -2.0)).norm() < 1e-9, "{integrated}");
        assert_eq!(published.glide_velocity_ned(), Vector3::zeros(), "it has arrived");
        published.stays(&Vector3::new(3.0, 0.0, 0.0));
        published.glide(0.01, &REJOIN);
        assert!((published.glide_velocity_ned().x - 3.0).abs() < 1e-9);
        published.rest();
        assert_eq!(published.glide_velocity_ned(), Vector3::zeros(), "it waits");
    }

    #[test]
    fn only_jumps_are_counted() {
        let mut published = Published::default();
        published.stays(&Vector3::new(60.0, 0.0, 0.0));
        assert!((published.jump() - 60.0).abs() < 1e-12);
        assert_eq!((published.reset_counter(), published.offset_ned().norm()), (1, 0.0));
        published.height_moved(-2.0, true);
        assert_eq!(published.jump_height(), Some(-2.0));
        assert_eq!(published.jump_height(), None);
        published.reset(&Reset::OriginMoved(Vector3::new(0.001, 0.0, 0.0)));
        assert_eq!(published.reset_counter(), 2);
        published.reset(&Reset::OriginMoved(Vector3::new(1.0, 0.0, 0.0)));
        published.reset(&Reset::Reboot);
        assert_eq!(published.reset_counter(), 4);
    }
}
