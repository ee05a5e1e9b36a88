//! How much an event of the navigator matters to the pilot.

use crate::navigator::event::What;
use crate::navigator::solution::{Carrier, Mode};
use crate::wire::session::status_text_sender::Severity;

/// How much it matters.
pub(super) fn severity_of(what: &What) -> Severity {
    match what {
        What::Mode { to: Mode::Lost, .. } => Severity::Critical,
        What::Mode { to: Mode::Holdover, .. } => Severity::Warning,
        What::Mode { from: Mode::Aided | Mode::Holdover, to: Mode::Aligning, .. } => Severity::Warning,
        What::Mode { .. } => Severity::Notice,
        What::Reset(_)
        | What::WalkedBack(_)
        | What::FlowDistrusted(..)
        | What::HeightFault { .. }
        | What::InertialHeight(_)
        | What::HeightReset(_)
        | What::LandmarkContradicts(_)
        | What::LandmarksContradict { .. }
        | What::LandmarksApart(_) => Severity::Warning,
        What::Carried(Carrier::Inertial) => Severity::Warning,
        _ => Severity::Info,
    }
}
