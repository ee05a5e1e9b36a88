//! The mode, what carries the velocity, what GNSS is worth, and the health of every source, over time.

use super::super::lanes::Lane;
use super::super::palette::Tone;
use crate::navigator::Navigator;
use crate::navigator::monitor::GnssState;
use crate::navigator::solution::Solution;
use crate::navigator::sources::status::SourceId;

/// The health of the sources is asked this often, s.
const HEALTH_EVERY_S: f64 = 0.5;

/// See the module's documentation.
#[derive(Clone, Debug)]
pub(in super::super) struct StateRecord {
    pub(in super::super) mode: Lane,
    pub(in super::super) carrier: Lane,
    pub(in super::super) gnss: Lane,
    pub(in super::super) sources: Vec<(SourceId, Lane)>,
    due_s: f64,
}

fn of_gnss(state: GnssState) -> (Tone, &'static str) {
    match state {
        GnssState::Trusted => (Tone::Good, "trusted"),
        GnssState::Untrusted(fault) => (Tone::Bad, fault.reason()),
    }
}

impl StateRecord {
    pub(super) fn new() -> Self {
        Self {
            mode: Lane::new("mode"),
            carrier: Lane::new("carried by"),
            gnss: Lane::new("trust in GNSS"),
            sources: Vec::new(),
            due_s: f64::NEG_INFINITY,
        }
    }

    pub(super) fn note(&mut self, t_s: f64, solution: &Solution, navigator: &Navigator) {
        self.mode.note(t_s, Tone::of(solution.mode), solution.mode.label());
        let carrier = solution.velocity_source;
        self.carrier.note(t_s, Tone::of_carrier(carrier), carrier.label());
        let (tone, what) = of_gnss(navigator.gnss_state());
        self.gnss.note(t_s, tone, what);
        if t_s < self.due_s {
            return;
        }
        self.due_s = t_s + HEALTH_EVERY_S;
        for report in navigator.source_reports() {
            let source = SourceId { kind: report.kind, id: report.id };
            let at = self.sources.iter().position(|(s, _)| *s == source).unwrap_or_else(|| {
                self.sources.push((source, Lane::new(source.to_string())));
                self.sources.len() - 1
            });
            let what = report.charge.map_or(report.health.label(), |charge| charge.label());
            self.sources[at].1.note(t_s, Tone::of_health(report.health), what);
        }
    }
}
