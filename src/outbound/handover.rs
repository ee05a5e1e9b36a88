//! Whether to send, and why: decided anew for every solution, and shown to whoever flies.
//!
//! The autopilots ask for different things. ArduPilot with VISO_TYPE set does not arm unless messages come, takes no harm from them while its source set is
//! another, and loses its aiding 15 s after they end if it stands on them. PX4 fuses them beside GNSS; one that starts at the loss makes a step of up to
//! 2 m at the switch, one that was fused all along 0.04 m. So both are sent to from the alignment on, and to an autopilot that stands on our position
//! sending never ends because GNSS is good again: it ends when the autopilot has been seen off it.

use crate::navigator::solution::Mode;

use super::settings::{Profile, Publish};

/// What the autopilot's own horizontal position stands on, as far as it tells.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, strum::IntoStaticStr)]
pub enum StandsOn {
    /// It tells too little to know.
    #[default]
    #[strum(serialize = "not told")]
    Unknown,
    /// GNSS. What comes from us is not used, or (PX4) its offset is learned.
    #[strum(serialize = "GNSS")]
    Gnss,
    /// The external position that we send.
    #[strum(serialize = "our position")]
    Ours,
    /// Nothing: it holds a position fixed, or dead-reckons.
    #[strum(serialize = "nothing")]
    Nothing,
}

impl StandsOn {
    /// What it is, for people.
    pub fn label(self) -> &'static str {
        self.into()
    }
}

/// Whether something is sent, with the reason.
#[derive(Clone, Copy, Debug, PartialEq, Eq, strum::IntoStaticStr)]
pub enum Sending {
    /// Sent: GNSS is lost or not trusted.
    #[strum(serialize = "sent: GNSS is not trusted")]
    Outage,
    /// Sent: the published position is on its way back to GNSS.
    #[strum(serialize = "sent: on the way back to GNSS")]
    Rejoining,
    /// Sent: ArduPilot arms, and can be switched over, only while messages come.
    #[strum(serialize = "sent: ArduPilot arms only with it")]
    Arming,
    /// Sent: PX4 makes no step at the loss if it was fused before.
    #[strum(serialize = "sent: no step when PX4 loses GNSS")]
    NoStep,
    /// Sent: the autopilot stands on it, GNSS or not.
    #[strum(serialize = "sent: the autopilot flies on it")]
    FlownOn,
    /// Sent: the autopilot may have stood on it in the outage and was not seen off it.
    #[strum(serialize = "sent: not seen off it yet")]
    NotSeenOff,
    /// Sent: it is configured so.
    #[strum(serialize = "sent: always, as configured")]
    Always,
    /// Sent, with the quality of what has failed.
    #[strum(serialize = "sent: to say that it is lost")]
    Farewell,
    /// Not sent: it is configured so.
    #[strum(serialize = "not sent: publish is \"never\"")]
    Forbidden,
    /// Not sent: attitude, heading or place are not known.
    #[strum(serialize = "not sent: not aligned yet")]
    Aligning,
    /// Not sent: how our frame lies in the autopilot's is not known.
    #[strum(serialize = "not sent: autopilot's frame not known")]
    NoFrame,
    /// Not sent: GNSS is good, and nothing else was asked for.
    #[strum(serialize = "not sent: GNSS is good")]
    GnssGood,
    /// Not sent: nothing but inertia carries it.
    #[strum(serialize = "not sent: inertia alone carries it")]
    Coasting,
    /// Not sent: the position is not good enough for anybody.
    #[strum(serialize = "not sent: the position is lost")]
    Lost,
}

impl Sending {
    /// Whether something is sent.
    pub const fn sends(self) -> bool {
        use Sending::{Aligning, Coasting, Forbidden, GnssGood, Lost, NoFrame};
        !matches!(self, Forbidden | Aligning | NoFrame | GnssGood | Coasting | Lost)
    }

    /// Whether it is sent and why, for people; 40 characters at most.
    pub fn label(self) -> &'static str {
        self.into()
    }
}

/// What the decision stands on.
#[derive(Clone, Copy, Debug)]
pub(super) struct SendInputs {
    pub(super) publish: Publish,
    pub(super) profile: Profile,
    pub(super) mode: Mode,
    pub(super) standing: StandsOn,
    /// How our frame lies in the autopilot's is known.
    pub(super) aligned: bool,
    /// The autopilot was sent to in an outage, and was not seen on GNSS since.
    pub(super) relied_on: bool,
    /// Nothing but inertia carries, for too long for anybody to follow it.
    pub(super) coasts: bool,
    /// What is lost is still said to be.
    pub(super) farewell: bool,
}

/// Whether to send, and why.
pub(super) fn decide(i: &SendInputs) -> Sending {
    if i.publish == Publish::Never {
        return Sending::Forbidden;
    }
    match i.mode {
        Mode::Aligning => Sending::Aligning,
        Mode::Lost if i.farewell => Sending::Farewell,
        Mode::Lost => Sending::Lost,
        _ if !i.aligned => Sending::NoFrame,
        Mode::Holdover if i.coasts => Sending::Coasting,
        Mode::Holdover => Sending::Outage,
        Mode::Rejoining => Sending::Rejoining,
        Mode::Aided => decide_aided(i),
    }
}

/// The same while GNSS is good.
fn decide_aided(i: &SendInputs) -> Sending {
    match (i.publish, i.profile) {
        (Publish::Always, _) => Sending::Always,
        _ if i.standing == StandsOn::Ours => Sending::FlownOn,
        (Publish::Auto, Profile::Ardupilot) => Sending::Arming,
        (Publish::Auto, Profile::Px4) => Sending::NoStep,
        _ if i.relied_on => Sending::NotSeenOff,
        _ => Sending::GnssGood,
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const AIDED: SendInputs = SendInputs {
        publish: Publish::Auto,
        profile: Profile::Ardupilot,
        mode: Mode::Aided,
        standing: StandsOn::Unknown,
        aligned: true,
        relied_on: false,
        coasts: false,
        farewell: false,
    };

    #[test]
    fn both_autopilots_are_sent_to_once_aligned_each_for_its_reason() {
        assert_eq!(decide(&AIDED), Sending::Arming);
        assert_eq!(decide(&SendInputs { profile: Profile::Px4, ..AIDED }), Sending::NoStep);
        for mode in [Mode::Aided, Mode::Holdover, Mode::Rejoining] {
            assert!(decide(&SendInputs { mode, ..AIDED }).sends());
            assert_eq!(decide(&SendInputs { mode, aligned: false, ..AIDED }), Sending::NoFrame);
            let never = SendInputs { mode, publish: Publish::Never, standing: StandsOn::Ours, ..AIDED };
            assert_eq!(decide(&never), Sending::Forbidden);
        }
        assert_eq!(decide(&SendInputs { mode: Mode::Aligning, ..AIDED }), Sending::Aligning);
    }

    #[test]
    fn an_autopilot_that_flies_on_it_is_not_left_because_gnss_is_good() {
        let holdover = SendInputs { publish: Publish::Holdover, ..AIDED };
        assert_eq!(decide(&holdover), Sending::GnssGood);
        assert_eq!(decide(&SendInputs { standing: StandsOn::Ours, ..holdover }), Sending::FlownOn);
        assert_eq!(decide(&SendInputs { relied_on: true, ..holdover }), Sending::NotSeenOff);
        assert_eq!(decide(&SendInputs { standing: StandsOn::Ours, ..AIDED }), Sending::FlownOn);
    }

    #[test]
    fn what_is_lost_ends_also_for_an_autopilot_that_flies_on_it() {
        let lost = SendInputs { mode: Mode::Lost, standing: StandsOn::Ours, relied_on: true, ..AIDED };
        assert_eq!(decide(&SendInputs { farewell: true, ..lost }), Sending::Farewell);
        assert_eq!(decide(&lost), Sending::Lost);
        assert!(!decide(&lost).sends());
    }

    #[test]
    fn a_reason_fits_into_a_word_to_the_pilot() {
        use Sending::*;
        let sent = [Outage, Rejoining, Arming, NoStep, FlownOn, NotSeenOff, Always, Farewell];
        let not_sent = [Forbidden, Aligning, NoFrame, GnssGood, Coasting, Lost];
        assert!(sent.iter().all(|s| s.sends() && s.label().starts_with("sent: ")));
        assert!(not_sent.iter().all(|s| !s.sends() && s.label().starts_with("not sent: ")));
        assert!(sent.iter().chain(&not_sent).all(|s| s.label().len() <= 40));
    }
}
