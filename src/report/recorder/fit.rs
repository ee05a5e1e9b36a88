//! How well what was fused did fit, and what was learned of the flow sensors.

use super::super::trace::{Point, Trace};
use crate::navigator::Navigator;
use crate::navigator::sources::status::{Measured, NisCount, SourceId};

/// Normalised innovations squared are averaged over this, s.
const MEAN_S: f64 = 5.0;
/// Measurements that are further apart leave a hole, s.
const HOLE_S: f64 = 12.0;
/// Gated measurements that are shown one by one.
const MOST_GATED: usize = 2000;

/// One quantity of one source.
#[derive(Clone, Debug)]
pub(in super::super) struct FitRecord {
    pub(in super::super) source: SourceId,
    pub(in super::super) measured: Measured,
    /// Length of the innovation over its sigma.
    pub(in super::super) normalised: Trace,
    /// Mean normalised innovation squared, of some seconds each.
    pub(in super::super) nis: Trace,
    /// When something was gated out, and the most that is shown of it.
    pub(in super::super) gated: Vec<Point>,
    pub(in super::super) count: NisCount,
    /// Since when the mean is taken, and what was counted then.
    mean_from: Option<(f64, NisCount)>,
}

impl FitRecord {
    fn new(source: SourceId, measured: Measured) -> Self {
        Self {
            source,
            measured,
            normalised: Trace::new(HOLE_S),
            nis: Trace::new(HOLE_S),
            gated: Vec::new(),
            count: NisCount::default(),
            mean_from: None,
        }
    }

    /// What has been fused by now.
    fn note(&mut self, t_s: f64, count: &NisCount) {
        let fused = count.fused.saturating_sub(self.count.fused);
        if fused > 0 {
            let squared = (count.sum() - self.count.sum()) / fused as f64;
            self.normalised.add(t_s, squared.max(0.0).sqrt());
        }
        if count.gated > self.count.gated && self.gated.len() < MOST_GATED {
            self.gated.push((t_s, 0.0));
        }
        let (from_s, before) = *self.mean_from.get_or_insert((t_s, self.count));
        let scalars = count.fused.saturating_sub(before.fused);
        if t_s - from_s >= MEAN_S && scalars > 0 {
            self.nis.add(0.5 * (from_s + t_s), (count.sum() - before.sum()) / scalars as f64);
            self.mean_from = Some((t_s, *count));
        }
        self.count = *count;
    }
}

/// Looks at all sources.
pub(super) fn note(records: &mut Vec<FitRecord>, navigator: &Navigator, t_s: f64) {
    for status in navigator.statuses().iter() {
        for (measured, count) in status.quantities() {
            if count.fused + count.gated == 0 {
                continue;
            }
            let found = records.iter().position(|r| r.source == status.source && r.measured == measured);
            let at = found.unwrap_or_else(|| {
                records.push(FitRecord::new(status.source, measured));
                records.len() - 1
            });
            if records[at].count != count {
                records[at].note(t_s, &count);
            }
        }
    }
}

/// What a flow sensor was found to be like.
#[derive(Clone, Debug)]
pub(in super::super) struct FlowRecord {
    pub(in super::super) sensor: u8,
    /// Values and their standard deviations: scale error, %; biases along x and y, mrad/s; latency, ms.
    pub(in super::super) learned: [[Trace; 2]; 4],
}

/// What is learned changes slowly: it is looked at this often, s.
const LEARNED_EVERY_S: f64 = 0.5;

/// Looks at the flow sensors.
pub(super) fn learned(records: &mut Vec<FlowRecord>, navigator: &Navigator, t_s: f64) {
    for ((sensor, calibration, _), (_, latency_s, latency_sigma_s)) in
        navigator.flow_sensors().zip(navigator.flow_latencies_s())
    {
        let at = records.iter().position(|r| r.sensor == sensor).unwrap_or_else(|| {
            let pair = || [Trace::new(HOLE_S), Trace::new(HOLE_S)];
            records.push(FlowRecord { sensor, learned: [pair(), pair(), pair(), pair()] });
            records.len() - 1
        });
        let learned = &mut records[at].learned;
        if learned[0][0].last().is_some_and(|(last, _)| t_s - last < LEARNED_EVERY_S) {
            continue;
        }
        let (x, p) = (calibration.estimate(), calibration.covariance());
        let sigma = |i: usize| p[(i, i)].max(0.0).sqrt();
        let now = [
            [100.0 * x[2], 100.0 * sigma(2)],
            [1e3 * x[0], 1e3 * sigma(0)],
            [1e3 * x[1], 1e3 * sigma(1)],
            [1e3 * latency_s, 1e3 * latency_sigma_s],
        ];
        for (traces, values) in learned.iter_mut().zip(now) {
            traces.iter_mut().zip(values).for_each(|(trace, value)| trace.add(t_s, value));
        }
    }
}
