//! Whether a distance to the ground follows the height: what a sound rangefinder does, and an echo of the airframe, of the air or of a pulse
//! before does not, however plausible each of its values is.
//!
//! Running moments of height h and distance r, each forgotten in [`MEMORY_S`]: over flat ground r − h is constant and var(r − h) small against
//! var(h); where the distance has nothing to do with the height, var(r − h) = var(h) + var(r). Terrain that rises with the vehicle looks like a
//! distance that does not follow: there, too, it is better not to rely on it.

use crate::navigator::tuning::every_source::LATE_S;
use crate::navigator::tuning::following::{ASTRAY, FOLLOWS, MEMORY_S, TELLS_M2};
use crate::time::AutopilotTime;

/// See the module's documentation.
#[derive(Clone, Copy, Debug, Default)]
pub(super) struct Following {
    newest: Option<AutopilotTime>,
    weight_s: f64,
    mean_h: f64,
    mean_d: f64,
    var_h: f64,
    /// Of d = r − h.
    var_d: f64,
    astray: bool,
}

impl Following {
    /// Takes a distance and the height at its time, m.
    pub(super) fn note(&mut self, now: AutopilotTime, distance_m: f64, height_m: f64) {
        let dt = self.newest.replace(now).map_or(0.0, |t| now.seconds_since(t)).clamp(0.0, MEMORY_S);
        let kept = self.weight_s * (-dt / MEMORY_S).exp();
        self.weight_s = kept + dt;
        if self.weight_s <= 0.0 {
            (self.mean_h, self.mean_d) = (height_m, distance_m - height_m);
            return;
        }
        let part = dt / self.weight_s;
        let (dh, dd) = (height_m - self.mean_h, distance_m - height_m - self.mean_d);
        self.mean_h += part * dh;
        self.mean_d += part * dd;
        self.var_h = (1.0 - part) * (self.var_h + part * dh * dh);
        self.var_d = (1.0 - part) * (self.var_d + part * dd * dd);
        if self.var_h > TELLS_M2 {
            let limit = if self.astray { FOLLOWS } else { ASTRAY };
            self.astray = self.var_d > limit * self.var_h;
        }
    }

    /// Whether the distance follows this height, heard as lately, as it would have to follow another that has moved more than it: then that other height moves by itself.
    pub(super) fn excuses(&self, other: &Self) -> bool {
        let late =
            self.newest.zip(other.newest).is_none_or(|(own, others)| others.seconds_since(own) > LATE_S);
        !late && self.var_d < FOLLOWS * other.var_h
    }

    /// Whether the distance was seen not to follow.
    pub(super) fn is_astray(&self) -> bool {
        self.astray
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn follow(distance: impl Fn(f64, f64) -> f64, height: impl Fn(f64) -> f64) -> Following {
        let mut following = Following::default();
        for k in 0..2400 {
            let t = f64::from(k) * 0.05;
            let h = height(t);
            following.note(AutopilotTime::from_micros((t * 1e6) as i64), distance(t, h), h);
        }
        following
    }

    #[test]
    fn a_sound_rangefinder_follows_and_a_stuck_or_wandering_one_does_not() {
        let climbs = |t: f64| 5.0 + 3.0 * (0.2 * t).sin();
        assert!(!follow(|t, h| h + 0.2 * (3.0 * t).sin(), climbs).is_astray());
        assert!(follow(|_, _| 1.3, climbs).is_astray());
        assert!(follow(|t, _| 1.5 + (0.5 * t).sin(), climbs).is_astray());
    }

    #[test]
    fn a_height_that_stands_still_with_the_distance_excuses_it_from_another_that_moves() {
        let sinks = follow(|_, _| 0.45, |t| -0.25 * t);
        assert!(sinks.is_astray());
        assert!(follow(|_, _| 0.45, |t| 0.2 * t.sin()).excuses(&sinks));
        // One that is stuck on a vehicle that moves has no excuse.
        assert!(!follow(|_, _| 0.45, |t| -0.2 * t).excuses(&sinks));
    }

    #[test]
    fn in_a_hover_nothing_is_known() {
        assert!(!follow(|_, _| 1.3, |t| 10.0 + 0.3 * t.sin()).is_astray());
    }

    #[test]
    fn one_that_follows_again_is_believed_again_within_minutes() {
        let heals = |t: f64, h: f64| if t < 20.0 { 1.3 } else { h };
        assert!(!follow(heals, |t| 8.0 + 4.0 * (0.3 * t).sin()).is_astray());
    }
}
