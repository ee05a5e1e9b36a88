//! Who says that a pitot tube is wrong: see [`super::sources::airspeed::AirspeedSource::weigh`]. From the first sample that does not fit it is not used, so
//! that neither velocity nor wind learn of it, and it does not carry. Where it and inertia have parted as inertia leads away, that is charged instead.
//!
//! It is believed again when it fits for some seconds: what GNSS and the wind of before make of it, or, without GNSS, inertia carried on from where it
//! still fitted, for as long as that is known better than what was wrong. With GNSS it is, too, when a turn shows that it was the wind that changed
//! ([`super::sources::airspeed_refit`]).

use super::context::Context;
use super::core::Core;
use super::estimator::change_wind;
use super::flow_judge::take_back;
use super::inertia;
use super::judge::{self, Charge};
use super::sources::SourceSet;
use super::sources::airspeed::{AirFinding, MeasuredAirspeed};
use super::sources::status::{SourceId, SourceKind};
use super::verdict::Reason;

const TUBE: SourceId = SourceId::only(SourceKind::Airspeed);

/// Whether an airspeed can be used.
pub(super) fn weigh(core: &mut Core, sources: &mut SourceSet, m: &MeasuredAirspeed) -> Result<(), Reason> {
    let context = Context { core, facts: sources.facts(core) };
    let finding = sources.airspeed.weigh(m, &context);
    match finding {
        Some(AirFinding::Astray { since, or_led }) => {
            judge::accuse(core, m.time, TUBE, charge(core, m));
            if core.dead_reckoning() {
                // With GNSS, that has corrected what the velocity has learned of it.
                take_back(core, since);
            }
            inertia::may_have_led_away(core, or_led.as_ref());
        }
        Some(AirFinding::LedAway(led)) => inertia::led_away(core, m.time, &led),
        Some(AirFinding::Back) => judge::acquit(core, m.time, TUBE),
        Some(AirFinding::AnotherWind(change, sigma)) => {
            change_wind(&mut core.estimator, &change, sigma);
            judge::acquit(core, m.time, TUBE);
        }
        None => {}
    }
    sources.airspeed.stands(m, &core.settings.air)
}

fn charge(core: &Core, m: &MeasuredAirspeed) -> Charge {
    if m.speed_mps < core.settings.air.min_mps {
        // No wing that moves so flies so slowly.
        Charge::Impossible
    } else if core.dead_reckoning() {
        Charge::ContradictsInertia
    } else {
        Charge::ContradictsOthers
    }
}
