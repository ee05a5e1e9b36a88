//! A receiver that repeats itself: noise alone would move its last digits.
//!
//! While the vehicle moves, position and velocity that stay the same for a second are frozen. At rest a receiver may hold its position, if it is one that does: the longest
//! that this one has told the same is remembered, and several times as long is frozen, too, whatever the vehicle does.

use nalgebra::Vector2;

use crate::time::AutopilotTime;

use crate::navigator::tuning::frozen_fixes::{
    FIXES, FROZEN_S, HELD_FIXES, HELD_M, HELD_S, HELD_TIMES, KNOWN_S, LONGEST_GAP_S, MOVES_MPS,
};

/// A fix that is repeated.
#[derive(Clone, Copy, Debug)]
struct SameFix {
    since: AutopilotTime,
    last: AutopilotTime,
    position_ne: Vector2<f64>,
    velocity_ne: Option<Vector2<f64>>,
    repeated: u32,
    /// It was too often.
    frozen: bool,
}

/// See the module's documentation.
#[derive(Clone, Copy, Debug, Default)]
pub(in super::super) struct FrozenFixes {
    same: Option<SameFix>,
    /// For how long it has been heard, and the longest that it held a position, s.
    known_s: f64,
    longest_s: f64,
}

impl FrozenFixes {
    /// When the fix was told first that is no fix any more.
    pub(in super::super) fn since(&self) -> Option<AutopilotTime> {
        self.same.filter(|same| same.frozen).map(|same| same.since)
    }

    /// Whether position and velocity have stayed exactly the same for longer than a receiver that works lets them while the vehicle moves with
    /// `speed_mps`, by itself or by what it says, or than this one ever has. The way back: the first fix that differs, and nothing else.
    pub(in super::super) fn repeats(
        &mut self,
        time: AutopilotTime,
        position_ne: Vector2<f64>,
        velocity_ne: Option<Vector2<f64>>,
        speed_mps: f64,
    ) -> bool {
        let gap_s = self.same.map_or(0.0, |same| time.seconds_since(same.last).clamp(0.0, LONGEST_GAP_S));
        self.known_s += gap_s;
        let equal = |same: &&mut SameFix| (same.position_ne, same.velocity_ne) == (position_ne, velocity_ne);
        if let Some(same) = self.same.as_mut().filter(equal) {
            (same.last, same.repeated) = (time, same.repeated + 1);
            let told_s = time.seconds_since(same.since);
            let moves = speed_mps.max(velocity_ne.map_or(0.0, |v| v.norm())) > MOVES_MPS;
            let unusual = self.known_s > KNOWN_S
                && same.repeated >= HELD_FIXES
                && told_s > HELD_S.max(HELD_TIMES * self.longest_s);
            same.frozen |= unusual || moves && same.repeated >= FIXES && told_s > FROZEN_S;
            return same.frozen;
        }
        // Who goes on where it stopped has held it.
        let held = |same: &SameFix| !same.frozen || (same.position_ne - position_ne).norm() < HELD_M;
        if let Some(same) = self.same.filter(held) {
            self.longest_s = self.longest_s.max(same.last.seconds_since(same.since));
        }
        let (since, last, repeated, frozen) = (time, time, 0, false);
        self.same = Some(SameFix { since, last, position_ne, velocity_ne, repeated, frozen });
        false
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
    fn who_is_frozen_is_not_believed_for_hovering_where_it_froze() {
        let mut frozen = FrozenFixes::default();
        let mut tell = |t: f64, north: f64, speed_mps: f64| {
            let time = AutopilotTime::from_micros((t * 1e6) as i64);
            frozen.repeats(time, Vector2::new(north, 3.0), Some(Vector2::zeros()), speed_mps);
            frozen.since().map(|since| since.seconds_since(AutopilotTime::from_micros(0)))
        };
        let told = |k: i32| f64::from(k) * 0.2;
        let found = (0..20).map(|k| tell(told(k), 0.0, 3.0)).last().flatten();
        assert_eq!(found, Some(0.0));
        assert_eq!((20..60).filter(|k| tell(told(*k), 0.0, 0.1).is_none()).count(), 0);
        assert_eq!(tell(told(60), 0.01, 0.1), None);
    }

    /// Fixes at 5 Hz of a vehicle at rest: for so many each, the same or new ones; and after how many it was called frozen.
    fn rest(frozen: &mut FrozenFixes, from: i32, fixes: &[(i32, bool)]) -> Option<i32> {
        let mut k = from;
        for (n, same) in fixes {
            let held = k;
            for _ in 0..*n {
                let north = if *same { held } else { k };
                let time = AutopilotTime::from_micros(i64::from(k) * 200_000);
                let position = Vector2::new(f64::from(north) * 0.01, 3.0);
                if frozen.repeats(time, position, Some(Vector2::zeros()), 0.1) {
                    return Some(k - from);
                }
                k += 1;
            }
        }
        None
    }

    #[test]
    fn who_never_held_a_position_is_frozen_at_rest_and_who_does_is_given_time() {
        let mut never = FrozenFixes::default();
        let told = rest(&mut never, 0, &[(200, false), (100, true)]);
        assert!(told.is_some_and(|k| (205..215).contains(&k)), "{told:?}");
        assert_eq!(rest(&mut FrozenFixes::default(), 0, &[(100, true), (100, false), (200, true)]), None);
        // It was held: the fix that ends it lies beside it.
        let again = rest(&mut never, 300, &[(100, false), (20, true)]);
        assert_eq!(again, None);
        // Before it is known.
        assert_eq!(rest(&mut FrozenFixes::default(), 0, &[(50, false), (90, true)]), None);
    }

    #[test]
    fn a_receiver_that_repeats_itself_in_motion_is_found_within_two_seconds() {
        assert!(told(false, 3.0).unwrap() < 2.0);
        assert_eq!(told(false, 0.1), None);
        assert_eq!(told(true, 3.0), None);
    }
}
