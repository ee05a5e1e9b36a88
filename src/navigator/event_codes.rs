//! Every code of an event: what it means and what to do about it. The documentation's table is made of this.

/// A code of an event.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct EventCode {
    /// See [`super::event::EventKind::code`].
    pub code: &'static str,
    /// What has happened.
    pub meaning: &'static str,
    /// What whoever runs Holdover should do.
    pub advice: &'static str,
}

const fn event(code: &'static str, meaning: &'static str, advice: &'static str) -> EventCode {
    EventCode { code, meaning, advice }
}

/// All of them.
pub const EVENTS: &[EventCode] = &[
    event(
        "mode",
        "The mode changed, with the reason.",
        "Holdover: GNSS is lost or distrusted, fly home or land while the uncertainty allows it. Lost: do not rely on the position.",
    ),
    event(
        "placed",
        "Navigation that began without GNSS has learned where on Earth it is; north was magnetic until then.",
        "Nothing.",
    ),
    event(
        "origin",
        "The local frame's origin was set, or moved with the autopilot's.",
        "Nothing; in flight it should not happen.",
    ),
    event(
        "origin-contradicted",
        "The autopilot told an origin that its own positions contradict; the one before is used.",
        "Suspect somebody else on the link: sign it. If the origin was set in flight, see why the position did not move with it.",
    ),
    event(
        "position-reset",
        "The published position jumped to the estimate; the reset counter changed.",
        "Expect the autopilot to jump with it. After a long outage it is normal.",
    ),
    event(
        "gnss-walk-undone",
        "GNSS had walked away slowly from its own velocity; what it added was taken back.",
        "Suspect spoofing or multipath.",
    ),
    event("gnss-receiver", "Another GNSS receiver is used.", "Look at the first one."),
    event(
        "flow-trusted",
        "A flow sensor agrees with GNSS and will carry the velocity in an outage.",
        "Nothing.",
    ),
    event(
        "flow-distrusted",
        "A flow sensor contradicts GNSS and will not be used, with the reason.",
        "Check its mounting, orientation, focus and height over ground.",
    ),
    event(
        "flow-unit",
        "A flow sensor tells pixels only; what one is worth was found against GNSS, gyros and height.",
        "Nothing.",
    ),
    event(
        "source-accused",
        "A source was found to be wrong, with what is held against it; it is not used, or with caution.",
        "Look at the sensor after the flight. In an outage: what is left carries, and sigma says how well.",
    ),
    event("source-acquitted", "Nothing is held against a source any more.", "Nothing."),
    event(
        "height-fault",
        "A source of heights is off, drifting or noisy, by so much and for so long.",
        "Nothing in flight: it is not used, or corrected. Look at the sensor after the flight.",
    ),
    event("height-healed", "A source of heights is healthy again.", "Nothing."),
    event(
        "height-inertial",
        "The inertial height had gone astray and was corrected at once.",
        "Check for vibration or clipping of the accelerometers.",
    ),
    event(
        "height-reset",
        "The published height jumped to the estimate; the reset counter changed.",
        "As for position-reset.",
    ),
    event(
        "filter-restarted",
        "The filter's attitude stayed apart from the observer's, and was started anew from it.",
        "Check the magnetometer's calibration and mounting.",
    ),
    event(
        "carried-by",
        "What carries the velocity without GNSS.",
        "By inertia alone: the position is good for seconds, not minutes.",
    ),
    event(
        "imu-bridged",
        "The IMU was silent; the filter went on with the doubt that this leaves.",
        "Check the link's rate and load.",
    ),
    event(
        "resumed",
        "Holdover was started anew within a minute, and goes on from what it had kept, with the doubt that the time between leaves.",
        "See why it ended.",
    ),
    event(
        "aligning",
        "Still aligning, after ten seconds and every ten seconds more: what is waited for.",
        "What it says: a view of the sky, a barometer, a calibrated magnetometer, or motion.",
    ),
    event(
        "heading-sought",
        "There is no magnetometer: the heading is sought from how GNSS velocity and acceleration agree.",
        "Move: accelerate in two directions.",
    ),
    event("heading-found", "Motion has shown the heading.", "Nothing."),
    event(
        "heading-turned",
        "GNSS and accelerometers agree on another heading than the magnetometer's; it was turned, and the magnetometer is not used.",
        "Calibrate the compass; look for currents and iron near it.",
    ),
    event("landmarks-found", "Known landmarks are in view and give a pose.", "Nothing."),
    event("landmarks-lost", "They are not any more.", "Nothing."),
    event(
        "landmark-contradicts",
        "One landmark does not lie where the others say.",
        "Check its surveyed place and its id.",
    ),
    event(
        "landmarks-contradict",
        "Landmarks contradict each other without a majority; none is used.",
        "Check the survey.",
    ),
    event(
        "landmarks-apart",
        "Landmarks and a trusted GNSS contradict each other; landmarks will not be used in an outage.",
        "Check the survey's origin and heading.",
    ),
    event("landmarks-agree", "Landmarks and GNSS agree again.", "Nothing."),
    event("landmark-frame", "The landmarks' own frame was placed by GNSS, with its heading.", "Nothing."),
];

#[cfg(test)]
mod tests {
    use super::super::event::{EventKind, TransitionReason, Waits};
    use super::super::judge::Charge;
    use super::super::solution::{Mode, VelocitySource};
    use super::super::sources::status::{SourceId, SourceKind};
    use super::*;
    use crate::altimeter::{Channel, Fault};
    use crate::camera::Distrust;

    #[test]
    fn every_event_has_a_code_that_is_explained_once_and_a_sentence() {
        let mode = EventKind::Mode { from: Mode::Aided, to: Mode::Lost, reason: TransitionReason::Reboot };
        let fault = Fault::Noise { variance_factor: 4.0 };
        let kinds = [
            mode,
            EventKind::Placed(0.1),
            EventKind::Origin(1.0),
            EventKind::OriginContradicted(1.0),
            EventKind::Reset(1.0),
            EventKind::WalkedBack(1.0),
            EventKind::Receiver(1),
            EventKind::FlowTrusted(1),
            EventKind::FlowDistrusted(1, Distrust::Scale),
            EventKind::FlowUnit(1, 0.0015),
            EventKind::Accused(SourceId::only(SourceKind::Flow), Charge::Stuck),
            EventKind::Acquitted(SourceId::only(SourceKind::Flow)),
            EventKind::HeightFault { channel: Channel::Baro, fault, for_s: 1.0 },
            EventKind::HeightHealed(Channel::Baro),
            EventKind::InertialHeight(1.0),
            EventKind::HeightReset(1.0),
            EventKind::FilterRestarted(1.0),
            EventKind::Carried(VelocitySource::Flow),
            EventKind::Bridged(1.0),
            EventKind::Resumed(1.0),
            EventKind::Waits(Waits::Height),
            EventKind::HeadingSought,
            EventKind::HeadingFound(0.1),
            EventKind::HeadingTurned(1.0),
            EventKind::LandmarksFound,
            EventKind::LandmarksLost,
            EventKind::LandmarkContradicts(1),
            EventKind::LandmarksContradict { suspect: 1, trusted: 1 },
            EventKind::LandmarksApart(1.0),
            EventKind::LandmarksAgree,
            EventKind::LandmarkFrame(1.0, 0.1),
        ];
        let codes: Vec<_> = kinds.iter().map(EventKind::code).collect();
        let explained: Vec<_> = EVENTS.iter().map(|e| e.code).collect();
        assert_eq!(codes, explained);
        assert!(kinds.iter().all(|k| !k.to_string().is_empty()));
    }
}
