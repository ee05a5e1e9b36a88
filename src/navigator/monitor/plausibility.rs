//! What a vehicle of its class does not do is somebody's fault, whoever's.
//!
//! **Faster than seen.** A velocity beyond what the vehicle has shown while GNSS was trusted, and beyond what its class does as a rule, is doubted by what exceeds that: the
//! position's sigma grows as fast as the position runs away by it.
//!
//! **Impossible.** Beyond the class's limit (`vehicle.max_speed_mps`), by more than three sigmas and for longer than a moment, nothing that is estimated is worth being
//! told: the mode is Lost. The way back is that of every Lost: GNSS, or landmarks.

use crate::sample::Airframe;
use crate::time::AutopilotTime;

use crate::navigator::tuning::plausibility::{
    FLIES_MPS, IMPOSSIBLE_S, MOST_MPS, SEEN_FACTOR, SIGMAS, SURFACE_MPS, USUAL_MPS, WING_MPS,
};

/// What a horizontal velocity is.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(in super::super) enum Plausible {
    /// Such vehicles do that.
    Usual,
    /// Faster than seen; by how much the position may be further off for that, as a standard deviation that is new, m.
    Fast(f64),
    /// Faster than any.
    Impossible,
}

/// See the module's documentation.
#[derive(Clone, Copy, Debug, Default)]
pub(in super::super) struct Plausibility {
    /// The fastest while GNSS was trusted, m/s.
    seen_mps: f64,
    /// ∫ of what exceeds what was seen, m, and until when.
    run_away_m: f64,
    judged: Option<AutopilotTime>,
    /// Since when the velocity has been impossible.
    impossible: Option<AutopilotTime>,
}

/// What vehicles of a class do as a rule, and what none does, m/s.
fn class(airframe: Option<Airframe>) -> (f64, f64) {
    match airframe {
        Some(Airframe::Multirotor) => (FLIES_MPS, USUAL_MPS),
        Some(Airframe::FixedWing) => (USUAL_MPS, WING_MPS),
        Some(Airframe::Surface) => (0.5 * SURFACE_MPS, SURFACE_MPS),
        None => (USUAL_MPS, MOST_MPS),
    }
}

impl Plausibility {
    /// With GNSS the vehicle flies so fast, m/s.
    pub(in super::super) fn see(&mut self, speed_mps: f64) {
        *self = Self { seen_mps: self.seen_mps.max(speed_mps), ..Self::default() };
    }

    /// Without, it seems to fly at `speed_mps`, known to `sigma_mps`. `limit_mps`: as configured.
    pub(in super::super) fn judge(
        &mut self,
        now: AutopilotTime,
        (speed_mps, sigma_mps): (f64, f64),
        airframe: Option<Airframe>,
        limit_mps: Option<f64>,
    ) -> Plausible {
        let (usual, most) = class(airframe);
        let most = limit_mps.unwrap_or(most.max(SEEN_FACTOR * self.seen_mps));
        if speed_mps - SIGMAS * sigma_mps > most {
            let since = *self.impossible.get_or_insert(now);
            if now.seconds_since(since) > IMPOSSIBLE_S {
                return Plausible::Impossible;
            }
        } else {
            self.impossible = None;
        }
        let dt = self.judged.replace(now).map_or(0.0, |t| now.seconds_since(t)).clamp(0.0, 1.0);
        let excess = speed_mps - usual.max(SEEN_FACTOR * self.seen_mps).min(most);
        if excess < sigma_mps {
            return Plausible::Usual;
        }
        // The deviations of an error that lasts add up, not their squares.
        let before = self.run_away_m;
        self.run_away_m += excess * dt;
        Plausible::Fast((self.run_away_m.powi(2) - before.powi(2)).sqrt())
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn at(s: f64) -> AutopilotTime {
        AutopilotTime::from_micros((s * 1e6) as i64)
    }

    #[test]
    fn what_was_seen_is_usual_what_exceeds_it_is_doubted_and_no_quadrotor_flies_at_60_mps() {
        let quad = Some(Airframe::Multirotor);
        let mut p = Plausibility::default();
        assert_eq!(p.judge(at(0.0), (10.0, 0.1), quad, None), Plausible::Usual);
        let Plausible::Fast(by) = p.judge(at(1.0), (25.0, 0.1), quad, None) else { panic!("too fast") };
        assert!((by - 7.0).abs() < 0.1, "{by}");
        assert_eq!(p.judge(at(1.0), (25.0, 12.0), quad, None), Plausible::Usual, "it is known to be unsure");
        p.see(22.0);
        assert_eq!(p.judge(at(2.0), (25.0, 0.1), quad, None), Plausible::Usual);
        assert!(matches!(p.judge(at(3.0), (60.0, 1.0), quad, None), Plausible::Fast(_)));
        assert_eq!(p.judge(at(6.0), (60.0, 1.0), quad, None), Plausible::Impossible);
        assert_ne!(p.judge(at(7.0), (60.0, 1.0), quad, Some(80.0)), Plausible::Impossible);
        assert_ne!(p.judge(at(9.0), (60.0, 1.0), Some(Airframe::FixedWing), None), Plausible::Impossible);
    }
}
