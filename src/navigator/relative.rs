//! Where there was never any GNSS: navigation relative to where it began.
//!
//! The frame begins where the vehicle is: position (0, 0, 0), north where the magnetic field points, gravity nominal. Optical flow carries from
//! the start, with the errors of a sensor that nobody has compared with anything. The mode is Holdover from the beginning: everything is as in an
//! outage whose start was exact. When somebody tells the place (a fix, the autopilot's origin), the frame is put there such that
//! the position goes on, and is turned by the declination.

use nalgebra::Vector3;

use crate::geo::{Geodetic, LocalNed};
use crate::sample::ImuSample;
use crate::time::AutopilotTime;

use super::core::Core;
use super::estimator::{has_flow, has_magnetometer};
use super::event::EventKind;
use super::reset::Reset;
use super::solution::Mode;
use super::sources::SourceSet;
use super::sources::status::SourceKind;
use crate::navigator::tuning::relative::FLOW_HEARD_S;

/// Looks whether the vehicle has waited for GNSS for long enough, and has what it takes to go without.
pub(super) fn consider(core: &mut Core, sources: &mut SourceSet, s: &ImuSample) {
    let now = s.time;
    let waited = core.estimator.observer().alignment.seconds_since_first(now);
    let patience = core.settings.start.without_gnss_s.filter(|_| core.integrity.never_good());
    let flows =
        core.statuses.last_heard(SourceKind::Flow).is_some_and(|t| now.seconds_since(t) < FLOW_HEARD_S);
    if core.mode != Mode::Aligning || !flows || patience.is_none_or(|s| waited < s) {
        return;
    }
    if core.surroundings.environment().is_none() {
        return settle(core, sources, s);
    }
    let facts = sources.facts(core);
    let found = core.estimator.observer().alignment.attitude_found(now, &core.settings.observer);
    if found && has_magnetometer(&facts, now) && core.height.height_m().is_some() {
        begin(core, sources, now);
    }
}

/// The frame begins here.
fn settle(core: &mut Core, sources: &SourceSet, s: &ImuSample) {
    let down = (-s.specific_force.raw()).try_normalize(1.0);
    match (core.settings.start.place, down.and_then(|d| sources.magnetometer.field_by(&d))) {
        (Some(place), _) => core.surroundings.settle_about(place),
        (None, Some(field_ned)) => core.surroundings.settle_somewhere(field_ned),
        (None, None) => return,
    }
    if let Some(environment) = core.surroundings.environment() {
        core.estimator.observer_mut().settle(environment);
    }
    core.estimator.observer_mut().alignment.start(s.time);
}

/// Navigates from here.
fn begin(core: &mut Core, sources: &mut SourceSet, now: AutopilotTime) {
    if !core.surroundings.placed() {
        let up = Reset::OriginMoved(Vector3::new(0.0, 0.0, -core.height.height_m().unwrap_or(0.0)));
        core.reset(&up);
        sources.reset(&up);
    }
    let facts = sources.facts(core);
    let down = -core.height.height_m().unwrap_or(0.0);
    let at_rest = sources.standstill.quiet(now);
    let seen = facts.flow_velocity.filter(|_| has_flow(&facts, now) && !at_rest);
    let velocity_ned = seen.map_or(Vector3::zeros(), |(_, v)| core.attitude.r_body_to_ned * v);
    core.estimator.stand_at(now, &Vector3::new(0.0, 0.0, down), &velocity_ned);
    let calibration = sources.flow.calibration_covariance(&core.settings.flow);
    core.start_relative(now, &facts, at_rest, &calibration);
}

/// Somebody tells the place: `here` is where the vehicle is.
pub(super) fn place(core: &mut Core, now: AutopilotTime, here: &Geodetic) {
    let p = core.estimator.estimate().map_or(Vector3::zeros(), |(p, _)| p);
    let height_m = here.height_m - core.height.height_m().unwrap_or(-p.z);
    let origin = LocalNed::new(*here).to_geodetic(&Vector3::new(-p.x, -p.y, 0.0));
    put(core, now, Geodetic { height_m, ..origin });
}

/// The frame's origin lies there.
pub(super) fn put(core: &mut Core, now: AutopilotTime, origin: Geodetic) {
    let field = |core: &Core| core.surroundings.environment().and_then(|e| e.field_ned);
    let before = field(core);
    core.surroundings.settle(origin);
    let angle = |f: Vector3<f64>| f.y.atan2(f.x);
    let turned = before.zip(field(core)).map_or(0.0, |(before, now)| angle(now) - angle(before));
    core.estimator.turn(now, turned);
    if let Some(environment) = core.surroundings.environment() {
        core.estimator.observer_mut().settle(environment);
    }
    core.timeline.reset(&Reset::Relocated);
    core.witnesses.forget();
    core.events.tell(now, EventKind::Placed(turned));
}
