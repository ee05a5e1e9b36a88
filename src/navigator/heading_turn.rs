//! Motion contradicts the heading: what becomes of the estimate, the magnetometer that had told it, and the GNSS that was blamed.

use nalgebra::Vector3;

use crate::filter::HeadingEstimate;
use crate::geo::so3;
use crate::time::AutopilotTime;

use super::core::Core;
use super::event::EventKind;
use super::inertia;
use super::judge::{self, Charge};
use super::monitor::GnssFault;
use super::monitor::heading_witness::Turn;
use super::monitor::inertia_witness::{SeenMotion, Testimony};
use super::reset::Reset;
use super::solution::Mode;
use super::sources::SourceSet;
use super::sources::gnss::FixReading;
use super::sources::status::SourceId;
use crate::navigator::tuning::heading_witness::{GYRO_BIAS_SIGMA, SPEED_SIGMA, TILT_SIGMA};

/// A fix, whatever the monitor made of it: `verdict`. Where GNSS agrees with itself, and a turn of the heading makes the accelerometers
/// agree with it, the heading is wrong, and GNSS is not.
pub(super) fn witness(
    core: &mut Core,
    sources: &mut SourceSet,
    now: AutopilotTime,
    reading: &FixReading,
    fault: Option<GnssFault>,
) {
    let seen = reading.velocity_ne.zip(core.timeline.impulse(reading.measured));
    let sound = fault != Some(GnssFault::Inconsistent) && core.mode != Mode::Aligning;
    let Some((velocity_ne, impulse)) = seen.filter(|_| sound) else {
        return core.witnesses.heading.forget();
    };
    if core.witnesses.inertia.is_out() {
        return;
    }
    core.witnesses.heading.observe(reading.measured, &velocity_ne, &impulse.xy());
    let change = core.witnesses.gnss.observe(SeenMotion {
        time: reading.measured,
        position: reading.position_ned.xy(),
        velocity: velocity_ne,
        impulse: impulse.xy(),
    });
    if !core.estimator.has_error_state() {
        return;
    }
    let said = core.witnesses.gnss.testimony(now);
    let turn = match (core.witnesses.heading.contradiction(), said) {
        (Some(turn), _) => Some(turn),
        (None, Testimony::Turned(turn)) => Some(turn),
        _ => None,
    };
    match turn {
        Some(turn) if core.witnesses.turns(now) => turn_heading(core, sources, now, reading, &turn),
        Some(_) => inertia::lose_to(core, now, reading),
        None => inertia::hear_gnss(core, now, reading, said, change),
    }
}

/// The filter starts anew at the fix with the heading turned, as after a search for it; the magnetometer is not believed until it agrees.
fn turn_heading(
    core: &mut Core,
    sources: &mut SourceSet,
    now: AutopilotTime,
    reading: &FixReading,
    turn: &Turn,
) {
    let facts = sources.facts(core);
    let Some(state) = core.estimator.filter_state() else { return };
    let (before, gyro_bias) = (state.position_ned, state.gyro_bias);
    let velocity_ne = reading.velocity_ne.unwrap_or_else(|| state.velocity_ned.xy());
    let estimate = HeadingEstimate {
        r_body_to_ned: so3::exp(&Vector3::new(0.0, 0.0, turn.angle)) * state.r_body_to_ned,
        velocity_ne,
        gyro_bias,
        heading_sigma: turn.sigma,
        tilt_sigma: TILT_SIGMA,
        velocity_sigma: SPEED_SIGMA,
        gyro_bias_sigma: GYRO_BIAS_SIGMA,
    };
    let late = now.seconds_since(reading.measured);
    let position_ne = reading.position_ned.xy() + velocity_ne * late;
    let position_ned = Vector3::new(position_ne.x, position_ne.y, before.z);
    let velocity_ned = Vector3::new(velocity_ne.x, velocity_ne.y, -core.height.climb_mps());
    core.estimator.observer_mut().predictor.reset(now, &position_ned, &velocity_ned);
    let start = Core::start_point(&core.settings, &core.height, &facts);
    core.estimator.align_by_motion(now, &estimate, &start);
    core.timeline.reset(&Reset::Relocated);
    core.witnesses.forget();
    core.events.tell(now, EventKind::HeadingTurned(turn.angle));
    sources.magnetometer.contradict(Charge::ContradictsMotion);
    let shift = position_ned - before;
    core.published.stays(&Vector3::new(shift.x, shift.y, 0.0));
    core.integrity.acquit(now);
    core.came_back(now);
}

/// What a magnetometer's sample has shown: it is charged with what has contradicted it, and acquitted when it is believed again.
pub(super) fn weigh_compass(core: &mut Core, sources: &mut SourceSet, now: AutopilotTime, source: SourceId) {
    match sources.magnetometer.contradicted() {
        Some(_) if sources.magnetometer.takes_back() => judge::acquit(core, now, source),
        Some(charge) => judge::accuse(core, now, source, charge),
        None => {}
    }
}
