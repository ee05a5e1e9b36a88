//! A receiver that holds its course while it is slow: what it tells then is a speed, and no velocity.
//!
//! Older receivers keep the last course below some 1 m/s, for the direction of noise would jump about; the speed goes on. Taken for a velocity the two are off
//! by up to twice the speed, and the jump to the true course looks like a lie. A course that is measured never stays the same to the last digit while the
//! speed changes, not at that speed.

use crate::navigator::tuning::held_course::{FASTEST_MPS, FIXES, SLOWEST_MPS};
use crate::sample::{GnssSample, GroundVelocity};

/// Receivers that are told apart.
const RECEIVERS: usize = 2;

/// The last velocity that was told, and how often its course has been repeated with another speed.
#[derive(Clone, Copy, Debug, Default)]
struct ToldCourse {
    last: Option<GroundVelocity>,
    repeated: u32,
}

/// See the module's documentation.
#[derive(Clone, Copy, Debug, Default)]
pub(super) struct HeldCourse {
    told: [ToldCourse; RECEIVERS],
}

impl HeldCourse {
    /// The velocity of a fix: none while the course is held and the speed is not next to none. The way back: a course that differs.
    pub(super) fn velocity(&mut self, s: &GnssSample) -> Option<GroundVelocity> {
        let now = s.ground_velocity?;
        let told = &mut self.told[usize::from(s.receiver).min(RECEIVERS - 1)];
        match told.last.replace(now) {
            Some(last) if last.course_rad == now.course_rad => {
                told.repeated = told.repeated.saturating_add(u32::from(last.speed_mps != now.speed_mps));
            }
            _ => told.repeated = 0,
        }
        let held = told.repeated >= FIXES && (SLOWEST_MPS..FASTEST_MPS).contains(&now.speed_mps);
        (!held).then_some(now)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::sample::GnssFix;
    use crate::time::AutopilotTime;

    fn fix(receiver: u8, speed_mps: f64, course_rad: f64) -> GnssSample {
        GnssSample {
            time: AutopilotTime::from_micros(0),
            receiver,
            fix: GnssFix::ThreeD,
            position: None,
            ground_velocity: Some(GroundVelocity { speed_mps, course_rad }),
            horizontal_accuracy_m: None,
            vertical_accuracy_m: None,
            speed_accuracy_mps: None,
            satellites: None,
            warning: None,
        }
    }

    #[test]
    fn a_course_that_is_held_is_no_direction_until_it_changes() {
        let mut held = HeldCourse::default();
        let mut velocities = |receiver, course: f64, fixes: u32| {
            (0..fixes)
                .filter(|k| held.velocity(&fix(receiver, 0.5 + 0.1 * f64::from(*k), course)).is_some())
                .count()
        };
        assert_eq!(velocities(0, 6.2, 10), FIXES as usize, "held from here");
        assert_eq!(velocities(1, 6.2, 2), 2, "another receiver");
        assert_eq!(velocities(0, 3.4, 1), 1, "the true course");
    }

    #[test]
    fn a_straight_flight_a_hover_and_a_measured_course_have_velocities() {
        for (speed, turn) in [(15.0, 0.0), (0.1, 0.0), (1.0, 0.001)] {
            let mut held = HeldCourse::default();
            for k in 0..50 {
                let s = fix(0, speed + 0.01 * f64::from(k % 3), turn * f64::from(k));
                assert!(held.velocity(&s).is_some(), "{speed} {k}");
            }
        }
    }
}
