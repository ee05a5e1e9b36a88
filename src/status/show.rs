//! From the navigation to a view.

use super::feed::StatusFeed;
use super::view::{
    ClockView, EllipseView, InputView, ModeView, OutlookView, OutputView, PlanView, SourceView, StatusView,
    UncertaintyView, VehicleView,
};
use crate::geo::{Euler, Geodetic, LocalNed};
use crate::navigator::monitor::GnssState;
use crate::navigator::shadow::MeasuredDrift;
use crate::navigator::solution::Solution;
use crate::navigator::sources::status::SourceReport;
use crate::pipeline::Pipeline;
use crate::time::{Companion, Span, Stamp};

/// The outage that is told of, s.
const OUTLOOK_S: f64 = 60.0;
/// A place of GNSS or of the autopilot is of the present for so long.
const FRESH: Span = Span::from_millis(3000);

/// What the daemon knows beside the pipeline.
#[derive(Debug)]
pub struct Glance<'a> {
    /// Navigator and output.
    pub pipeline: &'a Pipeline,
    /// The newest solution.
    pub solution: Option<&'a Solution>,
    /// The autopilot that is followed.
    pub vehicle: Option<VehicleView>,
    /// What is sent.
    pub output: OutputView,
    /// What comes in.
    pub input: InputView,
    /// Clocks.
    pub clock: ClockView,
}

/// Makes a view of it.
pub fn show(glance: Glance<'_>, feed: &mut StatusFeed, now: Stamp<Companion>) -> StatusView {
    let navigator = &glance.pipeline.navigator;
    let (for_s, reason) = feed.mode(navigator.mode(), now);
    let faulty = navigator.height_health().into_iter().filter(|(_, health)| health.is_faulty());
    StatusView {
        version: env!("CARGO_PKG_VERSION").to_owned(),
        uptime_s: feed.uptime_s(now),
        vehicle: glance.vehicle,
        mode: ModeView {
            name: navigator.mode().label().to_owned(),
            for_s,
            reason,
            gnss: match navigator.gnss_state() {
                GnssState::Trusted => "trusted".to_owned(),
                GnssState::Untrusted(fault) => format!("not trusted: {}", fault.reason()),
            },
        },
        uncertainty: glance.solution.map(uncertainty),
        carried_by: glance.solution.map(|s| s.velocity_source.label().to_owned()),
        outlook: outlook(&navigator.measured_drift()),
        sources: navigator.source_reports().iter().map(source).collect(),
        faulty_heights: faulty.map(|(channel, health)| format!("{} {health}", channel.label())).collect(),
        plan: glance.solution.map(|s| plan(s, navigator.placed_frame(), feed, now)),
        output: OutputView {
            quality: glance.solution.map(|s| glance.pipeline.outbound.quality(s)),
            ..glance.output
        },
        input: glance.input,
        clock: glance.clock,
    }
}

fn uncertainty(s: &Solution) -> UncertaintyView {
    let (p, v) = (s.position_covariance.raw(), s.velocity_covariance.raw());
    UncertaintyView {
        horizontal_m: s.horizontal_sigma_m(),
        height_m: p[(2, 2)].max(0.0).sqrt(),
        velocity_mps: (v[(0, 0)] + v[(1, 1)]).max(0.0).sqrt(),
        heading_deg: s.attitude_variance.z.max(0.0).sqrt().to_degrees(),
    }
}

/// Of what would carry now: after a minute, or the longest that was measured.
fn outlook(all: &[MeasuredDrift]) -> Option<OutlookView> {
    let first = all.first()?;
    let minute = all.iter().find(|m| m.source == first.source && m.after_s == OUTLOOK_S && m.times > 0);
    let told = minute.copied().or_else(|| MeasuredDrift::to_tell(all))?;
    Some(OutlookView {
        after_s: told.after_s,
        off_m: told.error_m,
        carried_by: told.source.label().to_owned(),
        times: told.times,
    })
}

fn source(s: &SourceReport) -> SourceView {
    let refused = s.rejected.values().sum::<u64>();
    let most = s.rejected.iter().max_by_key(|(_, n)| **n).map(|(reason, _)| (*reason).to_owned());
    SourceView {
        kind: s.kind.label().to_owned(),
        id: s.id,
        health: s.health.label().to_owned(),
        charge: s.charge.map(|c| c.label().to_owned()),
        rate_hz: 0.0,
        age_s: 0.0,
        test_ratio: s.test_ratio,
        nis: s.nis_mean,
        // What has no samples of its own is counted by what the filter took: the height, standing still, rotor drag. A fix is four scalars.
        used: if s.used > 0 { s.used } else { s.fused },
        refused,
        reason: most,
    }
}

fn plan(s: &Solution, frame: Option<&LocalNed>, feed: &StatusFeed, now: Stamp<Companion>) -> PlanView {
    let here = |told: Option<(Geodetic, Stamp<Companion>)>| {
        let (place, _) = told.filter(|(_, at)| now - *at <= FRESH)?;
        let ned = frame?.to_ned(&place);
        Some([ned.x, ned.y])
    };
    let (position, velocity) = (s.position.raw(), s.velocity.raw());
    let heading_deg = Euler::from_rotation(s.attitude.matrix()).yaw_rad.to_degrees().rem_euclid(360.0);
    PlanView {
        position_ned_m: [position.x, position.y, position.z],
        velocity_ned_mps: [velocity.x, velocity.y, velocity.z],
        heading_deg,
        ellipse: ellipse(s),
        gnss_m: here(feed.gnss),
        autopilot_m: here(feed.autopilot),
    }
}

/// Of the horizontal covariance [[a, b], [b, c]].
fn ellipse(s: &Solution) -> EllipseView {
    let p = s.position_covariance.raw();
    let (a, b, c) = (p[(0, 0)], p[(0, 1)], p[(1, 1)]);
    let (mean, half) = (0.5 * (a + c), (0.5 * (a - c)).hypot(b));
    EllipseView {
        major_m: (mean + half).max(0.0).sqrt(),
        minor_m: (mean - half).max(0.0).sqrt(),
        azimuth_deg: (0.5 * (2.0 * b).atan2(a - c)).to_degrees(),
    }
}

#[cfg(test)]
mod tests {
    use std::collections::BTreeMap;

    use super::*;
    use crate::navigator::sources::status::{SourceHealth, SourceKind};

    #[test]
    fn samples_are_counted_and_not_what_the_filter_makes_of_them() {
        let report = |kind, used, fused| SourceReport {
            kind,
            id: 0,
            used,
            fused,
            gated: 0,
            rejected: BTreeMap::from([("no fix", 3), ("untimely", 4)]),
            nis_mean: None,
            test_ratio: None,
            health: SourceHealth::Healthy,
            charge: None,
        };
        let fixes = source(&report(SourceKind::Gnss, 100, 400));
        assert_eq!((fixes.used, fixes.refused, fixes.reason.as_deref()), (100, 7, Some("untimely")));
        assert_eq!(source(&report(SourceKind::Height, 0, 187)).used, 187);
    }
}
