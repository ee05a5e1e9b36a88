//! What a fix by landmarks does in an outage: it corrects position and heading, or sets them anew.
//!
//! What it moves is not shown at once: the published position glides, and where the way is longer than `tuning.rejoin.jump_m` it jumps and the
//! reset counter says so.

use nalgebra::{Matrix2, Matrix4, Vector2, Vector3};

use crate::time::AutopilotTime;

use super::context::Context;
use super::core::Core;
use super::event::{EventKind, TransitionReason};
use super::observation::Observation;
use super::solution::Mode;
use super::sources::SourceSet;
use super::sources::landmarks::{LandmarkFix, PoseNews};
use super::sources::status::{Measured, SourceId, SourceKind};
use crate::navigator::tuning::landmark_fix::{OBSERVED_SPEED_SIGMA, SHOWN_AT_ONCE_M};
use crate::navigator::tuning::landmark_pose::PERIOD_S;

/// The variance of one of many poses of one filter. It forgets in τ = P/drift², its errors are correlated for as long, and the mean of
/// them is as good as that of independent ones with the variance 2τ/T P. Without that the filter that is corrected is faster than the one
/// that corrects it, and as it carries that one, both oscillate.
fn repeated(variance: f64, drift: f64) -> f64 {
    let forgets_s = variance / (drift * drift);
    variance * (2.0 * forgets_s / PERIOD_S).max(1.0)
}

/// Looks at the landmarks' pose, and does what follows.
pub(super) fn judge(core: &mut Core, sources: &mut SourceSet, now: AutopilotTime) {
    let facts = sources.facts(core);
    let Some(landmarks) = &mut sources.landmarks else { return };
    let mut events = std::mem::take(&mut core.events);
    let context = Context { core, facts };
    let fix = landmarks.look(now, &context, &mut events);
    let news = match (fix, core.mode) {
        (Some(fix), Mode::Aided) => {
            landmarks.compare(now, &fix, &Context { core, facts }, &mut events);
            None
        }
        (Some(fix), Mode::Holdover | Mode::Lost) => {
            let news = landmarks.judge(now, &fix, &Context { core, facts });
            Some((fix, news))
        }
        _ => None,
    };
    core.events = events;
    if let Some((fix, news)) = news {
        apply(core, sources, now, &fix, news);
    }
}

/// An absolute fix without GNSS.
fn apply(core: &mut Core, sources: &mut SourceSet, now: AutopilotTime, fix: &LandmarkFix, news: PoseNews) {
    let Some((p, _)) = core.estimator.estimate() else { return };
    let error = fix.error_from(&p);
    let lost = core.mode == Mode::Lost;
    let filtered = core.estimator.has_error_state();
    match news {
        PoseNews::Ignore => return,
        PoseNews::First { elsewhere } => {
            // What GNSS was wrong by is the position's own error now, and to be corrected.
            core.estimator.doubt_position(sources.facts(core).gnss_sigma_m);
            if elsewhere {
                relocate(core, sources, now, &error, fix);
            }
            if lost && filtered {
                jump(core, now);
                core.change_mode(now, Mode::Holdover, TransitionReason::Landmarks);
                return;
            }
        }
        PoseNews::Again => {}
    }
    if filtered {
        fuse(core, sources, now, &error, fix);
    } else {
        relocate(core, sources, now, &error, fix);
        if let Some(landmarks) = &mut sources.landmarks {
            landmarks.fixed(now);
        }
    }
    if core.published.offset_ned().norm() > core.settings.rejoin.jump_m {
        jump(core, now);
    }
}

/// Position and heading to the filter.
fn fuse(
    core: &mut Core,
    sources: &mut SourceSet,
    now: AutopilotTime,
    error: &Vector2<f64>,
    fix: &LandmarkFix,
) {
    let Some(landmarks) = &mut sources.landmarks else { return };
    let Some(environment) = core.surroundings.environment() else { return };
    let filter = landmarks.setup().filter;
    let observation = Observation::Pose {
        error_ne: *error,
        variance: [0, 1].map(|axis| repeated(fix.covariance[(axis, axis)], filter.position_drift)),
        r_body_to_ned: fix.r_body_to_ned,
        heading_variance: repeated(fix.heading_variance, filter.attitude_drift),
    };
    let fused = core.estimator.fuse(now, &observation, &core.timeline, environment);
    let source = SourceId::only(SourceKind::Landmarks);
    if !fused.gated(Measured::LandmarkPosition) {
        landmarks.fixed(now);
    } else if landmarks.refused(now) {
        core.statuses.fused(source, now, &fused);
        return relocate(core, sources, now, error, fix);
    }
    core.absorb(now, source, &fused);
    show_later(core, &fused.position_ned.xy());
}

/// The position is where the landmarks say, whatever was believed of it.
fn relocate(
    core: &mut Core,
    sources: &SourceSet,
    now: AutopilotTime,
    error: &Vector2<f64>,
    fix: &LandmarkFix,
) {
    let shift = Vector3::new(error.x, error.y, 0.0);
    if !core.estimator.reset_position(error, fix.covariance.trace().max(0.0).sqrt()) {
        core.estimator.relocate(&shift);
        let drift = sources.landmarks.as_ref().map_or(f64::INFINITY, |s| s.setup().filter.position_drift);
        let forgets_s = fix.covariance.trace() * 0.5 / (drift * drift);
        let lag = OBSERVED_SPEED_SIGMA * (forgets_s + PERIOD_S);
        let anchor = Matrix2::identity() * (fix.anchor_sigma_m.powi(2) + lag.powi(2));
        let calibration: Matrix4<f64> = sources.flow.calibration_covariance(&core.settings.flow);
        core.outage.begin_budget(&core.settings.holdover, fix.covariance + anchor, &calibration);
    }
    core.timeline.correct(now, &shift, &Vector3::zeros());
    show_later(core, error);
}

/// A correction that is too large to be shown at once glides.
fn show_later(core: &mut Core, moved: &Vector2<f64>) {
    if moved.norm() > SHOWN_AT_ONCE_M {
        core.published.stays(&Vector3::new(moved.x, moved.y, 0.0));
    }
}

/// The published position jumps to the estimate.
fn jump(core: &mut Core, now: AutopilotTime) {
    let away = core.published.jump();
    core.events.tell(now, EventKind::Reset(away));
}
