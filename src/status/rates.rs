//! How often a source speaks, when it spoke last, and what is refused of it of late: from one view to the next.

use std::collections::BTreeMap;

use super::view::{SourceView, StatusView};

/// Rates are those of some two seconds.
const SPAN_S: f64 = 2.0;

/// What was so at a moment.
#[derive(Clone, Debug, Default)]
struct SourceMark {
    at_s: f64,
    heard: u64,
    refused: u64,
}

#[derive(Clone, Debug, Default)]
struct SourcePast {
    marks: [SourceMark; 2],
    heard: u64,
    changed_s: f64,
}

/// Of every source, and of what is sent and received.
#[derive(Clone, Debug, Default)]
pub(super) struct SourceRates {
    sources: BTreeMap<(String, u8), SourcePast>,
    output: SourcePast,
    input: SourcePast,
}

impl SourcePast {
    /// Takes note of counts; what came since a mark of some seconds ago, 1/s, and how much of it was refused.
    fn hear(&mut self, now_s: f64, heard: u64, refused: u64) -> (f64, u64) {
        if heard != self.heard {
            (self.heard, self.changed_s) = (heard, now_s);
        }
        let [old, new] = &mut self.marks;
        if now_s - new.at_s >= SPAN_S {
            *old = std::mem::replace(new, SourceMark { at_s: now_s, heard, refused });
        }
        let since_s = now_s - old.at_s;
        let rate = if since_s > 0.0 { heard.saturating_sub(old.heard) as f64 / since_s } else { 0.0 };
        (rate, refused.saturating_sub(old.refused))
    }
}

impl SourceRates {
    /// Puts in what takes two views to know.
    pub(super) fn complete(&mut self, view: &mut StatusView) {
        let now_s = view.uptime_s;
        for source in &mut view.sources {
            let past = self.sources.entry((source.kind.clone(), source.id)).or_default();
            let heard = source.used + source.refused;
            let (rate_hz, lately) = past.hear(now_s, heard, source.refused);
            source.rate_hz = rate_hz;
            source.age_s = now_s - past.changed_s;
            forget_reason(source, lately);
        }
        view.output.rate_hz = self.output.hear(now_s, view.output.sent, 0).0;
        view.input.rate_hz = self.input.hear(now_s, view.input.frames, 0).0;
    }
}

/// A reason of long ago is none.
fn forget_reason(source: &mut SourceView, refused_lately: u64) {
    if refused_lately == 0 && source.health == "healthy" {
        source.reason = None;
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn view(at_s: f64, used: u64, refused: u64) -> StatusView {
        let reason = (refused > 0).then(|| "gated".to_owned());
        let source = SourceView {
            kind: "GNSS".into(),
            health: "healthy".into(),
            used,
            refused,
            reason,
            ..SourceView::default()
        };
        StatusView { uptime_s: at_s, sources: vec![source], ..StatusView::default() }
    }

    #[test]
    fn rate_age_and_reason_are_those_of_the_last_seconds() {
        let mut rates = SourceRates::default();
        let mut last = StatusView::default();
        // 5 Hz, of which one a second is refused until 10 s; silent from 20 s on.
        for k in 0..150 {
            let at_s = f64::from(k) * 0.2;
            let heard = u64::from(k.min(100) as u32);
            let refused = (heard / 5).min(10);
            last = view(at_s, heard - refused, refused);
            rates.complete(&mut last);
            let source = &last.sources[0];
            if (10.0..20.0).contains(&at_s) {
                assert!((source.rate_hz - 5.0).abs() < 0.6, "{at_s}: {}", source.rate_hz);
                assert!(source.age_s < 0.3);
                assert!(source.reason.is_some() || at_s > 11.5, "{at_s}");
                assert!(source.reason.is_none() || at_s < 14.5, "{at_s}");
            }
        }
        let source = &last.sources[0];
        assert!(source.rate_hz == 0.0 && (source.age_s - 9.8).abs() < 0.3, "{source:?}");
    }
}
