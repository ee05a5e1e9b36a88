//! How much an event of the navigator matters to the pilot.

use crate::navigator::event::EventKind;
use crate::navigator::solution::{Mode, VelocitySource};
use crate::wire::session::status_text_sender::Severity;

/// How much it matters.
pub(super) fn severity_of(kind: &EventKind) -> Severity {
    match kind {
        EventKind::Mode { to: Mode::Lost, .. } => Severity::Critical,
        EventKind::Mode { to: Mode::Holdover, .. } => Severity::Warning,
        EventKind::Mode { from: Mode::Aided | Mode::Holdover, to: Mode::Aligning, .. } => Severity::Warning,
        EventKind::Mode { .. } => Severity::Notice,
        EventKind::Resumed(_)
        | EventKind::OriginContradicted(_)
        | EventKind::Reset(_)
        | EventKind::WalkedBack(_)
        | EventKind::FlowDistrusted(..)
        | EventKind::Accused(..)
        | EventKind::HeadingTurned(_)
        | EventKind::HeightFault { .. }
        | EventKind::InertialHeight(_)
        | EventKind::HeightReset(_)
        | EventKind::LandmarkContradicts(_)
        | EventKind::LandmarksContradict { .. }
        | EventKind::LandmarksApart(_) => Severity::Warning,
        EventKind::Carried(VelocitySource::Inertial) => Severity::Warning,
        _ => Severity::Info,
    }
}
