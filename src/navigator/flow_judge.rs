//! Who says that a flow is wrong, and what follows: it is charged, what it has taught the filter is taken back, and it does not carry until it is
//! acquitted. Where it and inertia have parted as inertia leads away, that is charged instead.
//!
//! A flow that repeats itself is believed again with the first sample that does not ([`judge::repeats`]). One that contradicts inertia is when it has
//! followed inertia for some seconds of motion and shows the velocity that the filter has, by GNSS or by coasting
//! ([`super::sources::flow::FlowSource::weigh`]).

use crate::sample::FlowSample;
use crate::time::AutopilotTime;

use super::context::Context;
use super::core::Core;
use super::inertia;
use super::judge::{self, Charge};
use super::reset::Reset;
use super::sources::SourceSet;
use super::sources::flow::{FlowFinding, MeasuredFlow};
use super::sources::status::{SourceId, SourceKind};
use super::verdict::Reason;

/// Whether a sensor repeats itself. When that begins, what it has told since is taken back.
pub(super) fn repeats(core: &mut Core, sources: &mut SourceSet, s: &FlowSample, index: usize) -> bool {
    let context = Context { core, facts: sources.facts(core) };
    let Some(since) = sources.flow.repeats(s, index, &context) else { return false };
    let source = SourceId { kind: SourceKind::Flow, id: s.sensor };
    if core.statuses.charge(source).is_none() {
        take_back(core, since);
    }
    true
}

/// Whether inertia lets a flow be used.
pub(super) fn weigh(
    core: &mut Core,
    sources: &mut SourceSet,
    m: &MeasuredFlow,
    index: usize,
) -> Result<(), Reason> {
    let context = Context { core, facts: sources.facts(core) };
    if let Some((scale, sigma)) = sources.flow.rescaled(m, index, &context) {
        core.estimator.set_flow_scale(scale, sigma);
    }
    let context = Context { core, facts: sources.facts(core) };
    let finding = sources.flow.weigh(m, index, &sources.drag, &context);
    let source = SourceId { kind: SourceKind::Flow, id: sources.flow.id(index) };
    match finding {
        Some(FlowFinding::Astray { since, or_led }) => {
            judge::accuse(core, m.time, source, Charge::ContradictsInertia);
            take_back(core, since);
            inertia::may_have_led_away(core, or_led.as_ref());
        }
        Some(FlowFinding::LedAway(led)) => inertia::led_away(core, m.time, &led),
        Some(FlowFinding::Back) => judge::acquit(core, m.time, source),
        None => {}
    }
    sources.flow.stands(index)
}

/// The filter goes back to `since` and comes forward on inertia; what is published stays where it is and follows.
pub(super) fn take_back(core: &mut Core, since: AutopilotTime) {
    let (Some(now), Some(environment)) = (core.stream.newest(), core.surroundings.environment()) else {
        return;
    };
    let Some(moved_ned) = core.estimator.go_back(now, since, environment) else { return };
    core.timeline.reset(&Reset::Relocated);
    core.published.stays(&moved_ned);
}
