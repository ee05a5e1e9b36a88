//! A receiver that repeats itself: noise alone would move its last digits.

use nalgebra::Vector2;

use crate::time::AutopilotTime;

use crate::navigator::tuning::frozen_fixes::{FIXES, FROZEN_S, MOVES_MPS};

/// The fix that is repeated, since when, and how often.
#[derive(Clone, Copy, Debug, Default)]
pub(in super::super) struct FrozenFixes {
    same: Option<(AutopilotTime, Vector2<f64>, Option<Vector2<f64>>)>,
    repeated: u32,
}

impl FrozenFixes {
    /// Whether position and velocity have stayed exactly the same for longer than a receiver that works lets them while the vehicle moves with
    /// `speed_mps`, by itself or by what it says. At rest a receiver may hold its position. The way back: the first fix that differs.
    pub(in super::super) fn repeats(
        &mut self,
        time: AutopilotTime,
        position_ne: Vector2<f64>,
        velocity_ne: Option<Vector2<f64>>,
        speed_mps: f64,
    ) -> bool {
        match self.same {
            Some((since, p, v)) if (p, v) == (position_ne, velocity_ne) => {
                self.repeated += 1;
                let moves = speed_mps.max(velocity_ne.map_or(0.0, |v| v.norm())) > MOVES_MPS;
                moves && self.repeated >= FIXES && time.seconds_since(since) > FROZEN_S
            }
            _ => {
                (self.same, self.repeated) = (Some((time, position_ne, velocity_ne)), 0);
                false
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn told(moves: bool, speed_mps: f64) -> Option<f64> {
        let mut frozen = FrozenFixes::default();
        (0..40).map(|k| f64::from(k) * 0.2).find(|&t| {
            let p = Vector2::new(if moves { t } else { 0.0 }, 3.0);
            let time = AutopilotTime::from_micros((t * 1e6) as i64);
            frozen.repeats(time, p, Some(Vector2::zeros()), speed_mps)
        })
    }

    #[test]
    fn a_receiver_that_repeats_itself_in_motion_is_found_within_two_seconds() {
        assert!(told(false, 3.0).unwrap() < 2.0);
        assert_eq!(told(false, 0.1), None);
        assert_eq!(told(true, 3.0), None);
    }
}
