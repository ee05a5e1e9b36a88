//! The IMU is wrong, and what becomes of the estimate then.
//!
//! Without inertia the velocity is what it was, with the doubt that vehicles leave (see the estimator's hole). GNSS is followed all the same, if it is there; the
//! attitude is not known, nothing that is turned by it is used, and nobody is to rely on what is published. See
//! [`super::monitor::inertia_trust`] for the way back.

use std::f64::consts::FRAC_1_SQRT_2;

use nalgebra::{Matrix3, Vector3};

use crate::altimeter::Channel;
use crate::filter::error_state::{JumpOdds, JumpWindow};
use crate::geo::STANDARD_GRAVITY_MPS2;
use crate::time::AutopilotTime;

use super::Mode;
use super::context::{Context, SourceFacts};
use super::core::Core;
use super::event::TransitionReason;
use super::height::HeightReading;
use super::judge::{self, Charge};
use super::monitor::inertia_jumps::{JumpFinding, SuspectedJump, SuspectedJumps};
use super::monitor::inertia_witness::Testimony;
use super::monitor::plausibility::Plausible;
use super::monitor::velocity_step::VelocitySteps;
use super::reset::Reset;
use super::sources::gnss::FixReading;
use super::sources::parting::LedAway;
use super::sources::status::{SourceId, SourceKind};
use super::verdict::Reason;
use crate::navigator::tuning::inertia_witness::{LEAST_MPS2, TILT_SIGMAS, UNKNOWN_MPS2, WRONG_FOR_S};
use crate::navigator::tuning::shadow::{FLIES_M, FLIES_MPS};

const IMU: SourceId = SourceId::only(SourceKind::Imu);
/// Those that show inertia to be wrong that has jumped already.
const WITNESSES: [SourceKind; 4] =
    [SourceKind::Flow, SourceKind::Airspeed, SourceKind::Drag, SourceKind::Magnetometer];

/// Whether the newest sample is not to be navigated on, and why not.
pub(super) fn missing(core: &mut Core, now: AutopilotTime) -> Option<Reason> {
    if core.stream.has_stuck_axis() {
        if core.witnesses.inertia.sticks() {
            core.witnesses.forget();
        }
        return Some(Reason::Stuck);
    }
    let judged = core.integrity.trusted() || core.mode == Mode::Aligning;
    if core.witnesses.inertia.moves() {
        core.witnesses.forget();
        core.estimator.feel_again();
    }
    if core.witnesses.inertia.tries(now, judged) {
        core.witnesses.forget();
        core.estimator.try_inertia();
    }
    core.witnesses.inertia.is_out().then_some(Reason::ContradictsMotion)
}

/// What a fix that is sound in itself says, which may end a window in which the velocity changed by `change`, m/s: where inertia differs from GNSS all the time, inertia is wrong, and GNSS is not.
pub(super) fn hear_gnss(
    core: &mut Core,
    now: AutopilotTime,
    reading: &FixReading,
    said: Testimony,
    change: Option<f64>,
) {
    match said {
        Testimony::Contradicts if knows_tilt(core, core.witnesses.gnss.limit()) => {
            lose_to(core, now, reading)
        }
        Testimony::Agrees if change.is_some_and(|change| core.witnesses.inertia.agrees(now, change)) => {
            judge::acquit(core, now, IMU);
        }
        _ => {}
    }
}

/// The IMU is not navigated on, and the fix is.
pub(super) fn lose_to(core: &mut Core, now: AutopilotTime, reading: &FixReading) {
    lose(core, now);
    core.integrity.acquit(now);
    core.go_to(now, reading);
}

/// A height of the first barometer, and whether that is `sound`. What the altimeter makes of it does not matter: it stands on the inertia that is in question.
pub(super) fn hear_barometer(core: &mut Core, now: AutopilotTime, reading: &HeightReading, sound: bool) {
    if reading.channel != Channel::Baro {
        return;
    }
    let judged = sound && core.mode != Mode::Aligning && !core.estimator.is_settling();
    if !judged || core.witnesses.inertia.is_out() {
        return core.witnesses.barometer.forget();
    }
    core.witnesses.barometer.observe(now, reading.height_m);
    if let Some(found) = core.witnesses.barometer.finding(now)
        && knows_tilt(core, LEAST_MPS2)
    {
        lose(core, now);
        // What is missing of gravity upwards is there sidewards: sin² θ = 1 − (1 − a/g)², and nobody knows for how long it grew.
        let missing = (found.apart / STANDARD_GRAVITY_MPS2).min(1.0);
        let sideways = STANDARD_GRAVITY_MPS2 * (missing * (2.0 - missing)).sqrt();
        core.estimator.doubt_motion(0.5 * sideways * found.for_s.powi(2), sideways * found.for_s);
    }
}

/// A magnetic field, body, T, and when it was measured, of a magnetometer that nothing is held against: whether it turns in the body as the gyros say.
pub(super) fn hear_field(core: &mut Core, taken: AutopilotTime, field: &Vector3<f64>) {
    if core.witnesses.inertia.is_out() || core.mode == Mode::Aligning || core.estimator.is_settling() {
        return core.witnesses.field.forget();
    }
    let bias = core.magnetic_bias();
    let timeline = &core.timeline;
    let turned = |since| Some(timeline.mean_rate(since, taken)? * taken.seconds_since(since));
    if core.witnesses.field.observe(taken, &(field - bias), turned) {
        lose(core, taken);
    }
}

/// Whether an axis has jumped: then the filter is what it would be had it known, and what is published follows. Where one has, and something that nothing is
/// held against does not fit even so, no jump was what is wrong. While GNSS is good, and it is its velocity that parted from inertia, and at once, no axis is charged.
pub(super) fn judge_axes(core: &mut Core, now: AutopilotTime, facts: &SourceFacts, gnss: &VelocitySteps) {
    if core.witnesses.jumps.waits(now) {
        return;
    }
    let aided = core.mode == Mode::Aided && core.integrity.trusted();
    let jumped = core.statuses.charge(IMU) == Some(Charge::Jumped);
    if !aided && jumped && core.statuses.misfits(now, &WITNESSES) {
        return lose(core, now);
    }
    let flies = flies(core, facts);
    let windows = core.estimator.jump_windows();
    if aided && flies {
        core.witnesses.jumps.learn(now, windows, core.estimator.jump_windows_alone());
    }
    let blames = !(aided && gnss.parted_at_once());
    match core.witnesses.jumps.judge(now, windows, (aided, flies), blames) {
        JumpFinding::Suspected(jumps) => {
            let lasts = !aided && flies && facts.landmark_fix.is_none();
            suspect(core, now, &jumps, (aided, lasts));
            if jumped && core.witnesses.jumps.is_quiet(now) {
                judge::acquit(core, now, IMU);
            }
        }
        JumpFinding::Found { window, jump } => {
            judge::accuse(core, now, IMU, Charge::Jumped);
            let mut odds = JumpOdds::default();
            odds[window][jump] = 1.0;
            believe_jumps(core, &odds);
        }
        JumpFinding::Hopeless => lose(core, now),
    }
}

/// Jumps that may have happened are a part of what is claimed, those that are more likely than not also when their window has gone; if it `lasts`: nothing
/// corrects what they did.
fn suspect(core: &mut Core, now: AutopilotTime, jumps: &SuspectedJumps, (aided, lasts): (bool, bool)) {
    core.estimator.suspect_jumps(now, jumps);
    let watch = &core.witnesses.jumps;
    let likely = |jump: SuspectedJump| (jump.odds > 0.5).then_some(jump);
    let shown_by = |gone: &JumpWindow| watch.suspected(std::slice::from_ref(gone), aided);
    core.estimator.keep_suspicion(|gone| shown_by(gone).map(|jump| jump.and_then(likely)));
    if !lasts {
        core.estimator.forget_suspicion();
    }
}

/// The filter is what it would be had it known of a jump, with these odds which. What did not fit until now is explained.
fn believe_jumps(core: &mut Core, odds: &JumpOdds) {
    let Some(moved) = core.estimator.believe_jumps(odds) else { return };
    core.statuses.explained();
    core.timeline.reset(&Reset::Relocated);
    core.published.stays(&moved.position_ned);
    // Of the barometer's word nothing is lost by that.
    core.witnesses.heading.forget();
    core.witnesses.gnss.forget();
}

/// Whoever carries has been left by inertia as that leads away. If the filter's innovations show which axis may have jumped, it is what it would be had it known; what
/// inertia has done until now is doubted in any case, and what carries corrects it.
pub(super) fn led_away(core: &mut Core, now: AutopilotTime, led: &LedAway) {
    judge::accuse(core, now, IMU, Charge::Jumped);
    match core.witnesses.jumps.told(core.estimator.jump_windows()) {
        Some(odds) => believe_jumps(core, &odds),
        None => core.statuses.explained(),
    }
    may_have_led_away(core, Some(led));
}

/// Nobody is charged for that, but what inertia may have done is doubted.
pub(super) fn may_have_led_away(core: &mut Core, led: Option<&LedAway>) {
    if let Some(led) = led {
        core.estimator.doubt_inertia(led);
    }
}

/// Whether the vehicle is in the air, or as fast as if it were.
pub(super) fn flies(core: &Core, facts: &SourceFacts) -> bool {
    let fast = core.estimator.estimate().is_some_and(|(_, v)| v.xy().norm() > FLIES_MPS);
    let above_m = Context { core, facts: *facts }.above_ground_m();
    !facts.resting && (fast || above_m.is_some_and(|h| h > FLIES_M))
}

/// Whether the vehicle can do what is estimated.
pub(super) fn judge_speed(core: &mut Core, now: AutopilotTime) {
    let Some((_, v)) = core.estimator.estimate() else { return };
    let speed = v.xy().norm();
    if core.mode == Mode::Aided {
        return core.witnesses.plausibility.see(speed);
    }
    let Some(sigma) = core.estimator.speed_sigma().filter(|_| core.mode == Mode::Holdover) else { return };
    let (airframe, limit) = (core.vehicle.airframe(), core.settings.holdover.max_speed_mps);
    match core.witnesses.plausibility.judge(now, (speed, sigma), airframe, limit) {
        Plausible::Usual => {}
        // Both axes together.
        Plausible::Fast(more_m) => core.estimator.doubt_motion(more_m * FRAC_1_SQRT_2, 0.0),
        Plausible::Impossible => core.change_mode(now, Mode::Lost, TransitionReason::Implausible(speed)),
    }
}

/// Whether the filter is so sure of its tilt that what is apart by `mps2` is not explained by that.
fn knows_tilt(core: &Core, mps2: f64) -> bool {
    let tilt = |c: Matrix3<f64>| (0.5 * (c[(0, 0)] + c[(1, 1)])).sqrt();
    let known = |c| TILT_SIGMAS * STANDARD_GRAVITY_MPS2 * tilt(c) < mps2;
    core.estimator.has_error_state() && core.estimator.attitude_covariance().is_some_and(known)
}

/// The IMU is not navigated on. What it has done to the estimate until now is as uncertain as it was wrong.
fn lose(core: &mut Core, now: AutopilotTime) {
    core.witnesses.inertia.contradict(now);
    core.witnesses.forget();
    judge::accuse(core, now, IMU, Charge::ContradictsOthers);
    let velocity = UNKNOWN_MPS2 * WRONG_FOR_S;
    core.estimator.doubt_motion(0.5 * velocity * WRONG_FOR_S, velocity);
}
