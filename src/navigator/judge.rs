//! The one way to say that a source is wrong, and to take it back.
//!
//! Every monitor, comparison and test that finds a source wrong charges it here. The charge stands in the source's status until whoever brought
//! it takes it back, everything that builds on the source can ask for it there, and the change is told once. A charge without a way back
//! is a latch, and a latch is a defect: every judge states its way back where it charges.

use serde::Serialize;

use crate::time::AutopilotTime;

use super::core::Core;
use super::event::EventKind;
use super::sources::status::{SourceHealth, SourceId};
use super::verdict::{Reason, Verdict};

/// What is held against a source.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, strum::IntoStaticStr, strum::VariantArray)]
#[serde(rename_all = "snake_case")]
pub enum Charge {
    /// It repeats itself where its noise alone would not let it.
    #[strum(serialize = "stuck")]
    Stuck,
    /// What inertia shows over a short time is otherwise.
    #[strum(serialize = "contradicts inertia")]
    ContradictsInertia,
    /// Flow shows otherwise.
    #[strum(serialize = "contradicts flow")]
    ContradictsFlow,
    /// Others of its kind, or all others together, show otherwise.
    #[strum(serialize = "contradicts the others")]
    ContradictsOthers,
    /// No vehicle of this class does that, or no sensor of this kind tells it.
    #[strum(serialize = "impossible")]
    Impossible,
    /// It says itself that it cannot be believed.
    #[strum(serialize = "says so itself")]
    SaysSo,
    /// It walks off slowly.
    #[strum(serialize = "walks off")]
    WalksOff,
    /// Motion shows another heading.
    #[strum(serialize = "contradicts motion")]
    ContradictsMotion,
    /// A bias or scale of it has changed: it is corrected, and used with caution until that has proven right.
    #[strum(serialize = "has jumped")]
    Jumped,
    /// It fits far worse than it is taken to be noisy, and is used with caution.
    #[strum(serialize = "fits badly")]
    FitsBadly,
}

impl Charge {
    /// A few words for events and tables.
    pub fn label(self) -> &'static str {
        self.into()
    }

    /// What it makes of the source: one that is only suspect is still used, with caution.
    pub fn health(self) -> SourceHealth {
        match self {
            Charge::FitsBadly | Charge::Jumped => SourceHealth::Suspect,
            _ => SourceHealth::Faulty,
        }
    }
}

/// A source is wrong. Told when that is new; a charge that replaces another is noted and not told again.
pub(super) fn accuse(core: &mut Core, now: AutopilotTime, source: SourceId, charge: Charge) {
    if core.statuses.charged(source, Some(charge)).is_none() {
        core.events.tell(now, EventKind::Accused(source, charge));
    }
}

/// Nothing is held against a source any more.
pub(super) fn acquit(core: &mut Core, now: AutopilotTime, source: SourceId) {
    if core.statuses.charged(source, None).is_some() {
        core.events.tell(now, EventKind::Acquitted(source));
    }
}

/// A source that repeats itself is charged with that, and believed again with the first sample that is used: it has moved.
pub(super) fn repeats(core: &mut Core, now: AutopilotTime, source: SourceId, verdict: Verdict) {
    match verdict {
        Verdict::Rejected(Reason::Stuck) => accuse(core, now, source, Charge::Stuck),
        Verdict::Used if core.statuses.charge(source) == Some(Charge::Stuck) => acquit(core, now, source),
        _ => {}
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::config::{Settings, Sources};
    use crate::navigator::sources::status::SourceKind;

    #[test]
    fn a_charge_is_told_once_stands_and_is_taken_back() {
        let mut core = Core::new(Settings::load(&Sources::default()).unwrap().pipeline.navigator);
        let flow = SourceId { kind: SourceKind::Flow, id: 3 };
        let at = |s: f64| AutopilotTime::from_micros((s * 1e6) as i64);
        acquit(&mut core, at(1.0), flow);
        assert!(core.events.is_empty());
        accuse(&mut core, at(2.0), flow, Charge::Stuck);
        accuse(&mut core, at(2.1), flow, Charge::Stuck);
        accuse(&mut core, at(2.2), flow, Charge::ContradictsInertia);
        assert_eq!(core.statuses.charge(flow), Some(Charge::ContradictsInertia));
        assert_eq!(core.statuses.charge(SourceId { id: 0, ..flow }), None);
        acquit(&mut core, at(9.0), flow);
        assert_eq!(core.statuses.charge(flow), None);
        let told: Vec<_> = core.events.drain().map(|e| e.kind).collect();
        assert_eq!(told, [EventKind::Accused(flow, Charge::Stuck), EventKind::Acquitted(flow)]);
    }
}
