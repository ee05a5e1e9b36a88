//! The mode machine: Aligning → Aided → Holdover → Rejoining → Aided, and Lost. A pure function of what is known.

use super::super::event::TransitionReason;
use super::super::settings::HoldoverSettings;
use super::super::solution::Mode;
use super::gnss_integrity::{GnssFault, GnssState};

/// What the mode depends on.
#[derive(Clone, Copy, Debug)]
pub(in super::super) struct ModeInputs {
    pub(in super::super) mode: Mode,
    pub(in super::super) gnss: GnssState,
    /// The observer has found the attitude; the altimeter has a height.
    pub(in super::super) attitude_found: bool,
    pub(in super::super) height_known: bool,
    /// Motion has shown the heading.
    pub(in super::super) heading_found: bool,
    /// The published position has arrived at the estimate.
    pub(in super::super) joined: bool,
    /// Horizontal uncertainty in holdover, 1 sigma, m, and for how long nothing has carried the velocity, s.
    pub(in super::super) sigma_m: f64,
    pub(in super::super) coasted_s: f64,
}

/// What is to happen.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(in super::super) enum Decision {
    /// The observer has found the attitude: navigate.
    Align,
    /// Motion has shown the heading: navigate.
    AlignByMotion,
    /// GNSS is lost: go on without.
    HoldOver(GnssFault),
    /// The published position has joined GNSS.
    Join,
    /// The uncertainty is beyond what the configuration allows.
    GiveUp(TransitionReason),
}

/// What follows. The way out of [`Mode::Lost`] is a fix that makes GNSS trusted, or landmarks, which is decided where they are heard.
pub(in super::super) fn decide(i: &ModeInputs, limits: &HoldoverSettings) -> Option<Decision> {
    match (i.mode, i.gnss) {
        (Mode::Aligning, GnssState::Trusted) if i.height_known => {
            if i.attitude_found {
                Some(Decision::Align)
            } else {
                i.heading_found.then_some(Decision::AlignByMotion)
            }
        }
        (Mode::Aided | Mode::Rejoining, GnssState::Untrusted(fault)) => Some(Decision::HoldOver(fault)),
        (Mode::Rejoining, GnssState::Trusted) => i.joined.then_some(Decision::Join),
        (Mode::Holdover, _) => {
            if i.sigma_m > limits.max_sigma_m || i.sigma_m.is_nan() {
                Some(Decision::GiveUp(TransitionReason::Uncertain(i.sigma_m)))
            } else {
                (i.coasted_s > limits.max_coast_s)
                    .then_some(Decision::GiveUp(TransitionReason::Coasted(i.coasted_s)))
            }
        }
        (Mode::Aligning | Mode::Aided | Mode::Lost, _) => None,
    }
}

#[cfg(test)]
mod tests {
    use super::super::budget::BudgetSettings;
    use super::*;

    const LIMITS: HoldoverSettings = HoldoverSettings {
        max_sigma_m: 100.0,
        max_coast_s: 30.0,
        max_speed_mps: None,
        budget: BudgetSettings {
            heading_sigma_rad: 0.0,
            heading_drift_radps: 0.0,
            scale_wander: 0.0,
            height_scale_sigma: 0.0,
            velocity_sigma_mps: 0.0,
            tilt_sigma_rad: 0.0,
            gyro_bias_sigma_radps: 0.0,
        },
    };

    fn inputs(mode: Mode, gnss: GnssState) -> ModeInputs {
        ModeInputs {
            mode,
            gnss,
            attitude_found: false,
            height_known: true,
            heading_found: false,
            joined: false,
            sigma_m: 1.0,
            coasted_s: 0.0,
        }
    }

    #[test]
    fn alignment_needs_gnss_a_height_and_an_attitude_or_a_heading() {
        let i = inputs(Mode::Aligning, GnssState::Trusted);
        assert_eq!(decide(&i, &LIMITS), None);
        let found = ModeInputs { attitude_found: true, heading_found: true, ..i };
        assert_eq!(decide(&found, &LIMITS), Some(Decision::Align));
        let moved = ModeInputs { heading_found: true, ..i };
        assert_eq!(decide(&moved, &LIMITS), Some(Decision::AlignByMotion));
        assert_eq!(decide(&ModeInputs { height_known: false, ..found }, &LIMITS), None);
        let lost = GnssState::Untrusted(GnssFault::NoFix);
        assert_eq!(decide(&ModeInputs { gnss: lost, ..found }, &LIMITS), None);
    }

    #[test]
    fn gnss_that_is_lost_is_held_over_and_holdover_ends_by_its_limits() {
        let lost = GnssState::Untrusted(GnssFault::Silence);
        for mode in [Mode::Aided, Mode::Rejoining] {
            assert_eq!(decide(&inputs(mode, lost), &LIMITS), Some(Decision::HoldOver(GnssFault::Silence)));
        }
        let i = inputs(Mode::Holdover, lost);
        assert_eq!(decide(&i, &LIMITS), None);
        for (sigma_m, coasted_s) in [(101.0, 0.0), (f64::NAN, 0.0), (1.0, 31.0)] {
            let beyond = ModeInputs { sigma_m, coasted_s, ..i };
            assert!(matches!(decide(&beyond, &LIMITS), Some(Decision::GiveUp(_))), "{beyond:?}");
        }
        assert_eq!(decide(&inputs(Mode::Lost, lost), &LIMITS), None);
    }

    #[test]
    fn the_way_back_ends_where_the_published_position_has_joined() {
        let i = inputs(Mode::Rejoining, GnssState::Trusted);
        assert_eq!(decide(&i, &LIMITS), None);
        assert_eq!(decide(&ModeInputs { joined: true, ..i }, &LIMITS), Some(Decision::Join));
    }
}
