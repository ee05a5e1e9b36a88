//! The magnetometer: heard while its field has the strength of the place, and while it turns when the vehicle does.

use nalgebra::Vector3;

use crate::sample::MagSample;
use crate::time::{AutopilotTime, Span};

use super::super::context::Context;
use super::super::observation::Observation;
use super::super::reset::Reset;
use super::super::timeline::Timeline;
use super::super::verdict::Reason;
use super::status::SourceHealth;
use crate::navigator::tuning::every_source::LATE_S;
use crate::navigator::tuning::magnetometer::{STUCK_LOOK_S, STUCK_RATE, STUCK_S, STUCK_TURN};

/// The same field, told again and again.
#[derive(Clone, Copy, Debug)]
struct SameField {
    since: AutopilotTime,
    field: Vector3<f64>,
    /// While the vehicle turned: it is stuck.
    stuck: bool,
}

/// See the module's documentation.
#[derive(Clone, Copy, Debug, Default)]
pub(in super::super) struct MagnetometerSource {
    newest: Option<(AutopilotTime, Vector3<f64>)>,
    same: Option<SameField>,
}

impl MagnetometerSource {
    /// The newest field, body, T.
    pub(super) fn newest(&self) -> Option<(AutopilotTime, Vector3<f64>)> {
        self.newest
    }

    pub(in super::super) fn observe(
        &mut self,
        s: &MagSample,
        context: &Context<'_>,
    ) -> Result<Observation, Reason> {
        let settings = &context.core.settings.magnetometer;
        if !settings.enabled {
            return Err(Reason::SwitchedOff);
        }
        let norm = s.field.raw().norm();
        if !norm.is_finite() {
            return Err(Reason::NotFinite);
        }
        if self.newest.is_some_and(|(t, _)| s.time < t) {
            return Err(Reason::OutOfOrder);
        }
        let field_ned = context
            .core
            .surroundings
            .environment()
            .and_then(|e| e.field_ned)
            .ok_or(Reason::NoReferenceYet)?;
        if (norm / field_ned.norm() - 1.0).abs() > settings.norm_error {
            return Err(Reason::FieldStrength);
        }
        if context.is_late(s.time, LATE_S) {
            return Err(Reason::Late);
        }
        if self.is_stuck(s, context.now(), &context.core.timeline) {
            return Err(Reason::Stuck);
        }
        self.newest = Some((s.time, s.field.raw()));
        Ok(Observation::Magnetic { field_body: s.field.raw(), field_ned, sigma_t: settings.sigma_t })
    }

    /// Whether the field stands still in the body while the body turns. At rest a coarse magnetometer may tell the same for long.
    fn is_stuck(&mut self, s: &MagSample, now: Option<AutopilotTime>, timeline: &Timeline) -> bool {
        let Some(same) = self.same.filter(|same| same.field == s.field.raw()) else {
            self.same = Some(SameField { since: s.time, field: s.field.raw(), stuck: false });
            return false;
        };
        let now = now.map_or(s.time, |now| now.min(s.time));
        let from = same.since.max(now - Span::from_seconds(STUCK_LOOK_S));
        let elapsed = now.seconds_since(from);
        // What turns slower than this may be a gyro's bias.
        let turned = |w: Vector3<f64>| (w.norm() - STUCK_RATE) * elapsed > STUCK_TURN;
        let stuck = same.stuck || (elapsed > STUCK_S && timeline.mean_rate(from, now).is_some_and(turned));
        self.same = Some(SameField { stuck, ..same });
        stuck
    }

    /// What is known against it.
    pub(super) fn health(&self) -> SourceHealth {
        if self.same.is_some_and(|s| s.stuck) { SourceHealth::Faulty } else { SourceHealth::Healthy }
    }

    pub(super) fn reset(&mut self, reset: &Reset) {
        if reset.reboots() {
            self.newest = None;
        }
        if reset.sets_clock_back() {
            self.same = None;
        }
    }
}
