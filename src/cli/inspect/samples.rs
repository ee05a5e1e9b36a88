//! The streams of samples in a log: how many of each kind and sensor, at which rate, with which holes.

use std::collections::BTreeMap;

use serde::Serialize;

use crate::cli::table::{Table, number};
use crate::log::stretches::Stretches;
use crate::sample::{Sample, SampleKind};

/// What is said of one stream.
#[derive(Debug, Serialize)]
pub(super) struct KindReport {
    kind: &'static str,
    /// Which of several sensors of the kind, as the log numbers them.
    sensor: u8,
    count: u64,
    rate_hz: Option<f64>,
    longest_gap_s: f64,
    /// Gaps of more than 2.5 s, which are not in the rate.
    holes: u32,
    missing_s: f64,
}

/// The streams, by kind and sensor. Of GNSS receivers fixes are counted, whatever else they tell.
#[derive(Debug, Default)]
pub(super) struct Streams {
    kinds: [Stretches; SampleKind::ALL.len()],
    sensors: BTreeMap<(usize, u8), Stretches>,
}

impl Streams {
    /// Notes a sample.
    pub(super) fn note(&mut self, sample: &Sample) {
        if matches!(sample, Sample::Gnss(g) if g.position.is_none()) {
            return;
        }
        let kind = sample.kind() as usize;
        self.kinds[kind].note(sample.time());
        self.sensors.entry((kind, sensor(sample))).or_default().note(sample.time());
    }

    /// All of a kind in one, whichever sensor they are of.
    pub(super) fn of(&self, kind: SampleKind) -> &Stretches {
        &self.kinds[kind as usize]
    }

    /// How many there are of each kind.
    pub(super) fn heard(&self) -> [u64; SampleKind::ALL.len()] {
        self.kinds.map(|stream| stream.count())
    }

    /// What is said of them: of each kind, and where several sensors of a kind were heard, of each.
    pub(super) fn reports(&self) -> Vec<KindReport> {
        let of_kind = |kind: &SampleKind| {
            let kind = *kind as usize;
            let mut sensors: Vec<_> =
                self.sensors.range((kind, 0)..=(kind, u8::MAX)).map(|(&(_, n), s)| (n, s)).collect();
            if sensors.is_empty() {
                sensors.push((0, &self.kinds[kind]));
            }
            sensors.into_iter().map(move |(sensor, s)| report(SampleKind::ALL[kind], sensor, s))
        };
        SampleKind::ALL.iter().flat_map(of_kind).collect()
    }
}

/// Which of several sensors of its kind a sample is of.
fn sensor(sample: &Sample) -> u8 {
    match sample {
        Sample::Mag(s) => s.sensor,
        Sample::Gnss(s) => s.receiver,
        Sample::Pressure(s) => s.sensor,
        Sample::Flow(s) => s.sensor,
        Sample::Range(s) => s.sensor,
        Sample::Landmark(s) => s.camera,
        Sample::Imu(_) | Sample::Airspeed(_) => 0,
    }
}

fn report(kind: SampleKind, sensor: u8, s: &Stretches) -> KindReport {
    let (holes, missing_s) = s.holes();
    KindReport {
        kind: kind.label(),
        sensor,
        count: s.count(),
        rate_hz: s.rate_hz(),
        longest_gap_s: s.longest_gap_s(),
        holes,
        missing_s,
    }
}

/// Prints them as a table; the sensors of a kind are counted from 1.
pub(super) fn print(samples: &[KindReport]) {
    outln!("\nSamples");
    let mut table = Table::new(&["", "count", "Hz", "longest gap s", "holes", "missing s"]);
    let mut before: Option<(&str, u32)> = None;
    for s in samples.iter().filter(|s| s.count > 0) {
        let nth = before.filter(|(kind, _)| *kind == s.kind).map_or(1, |(_, n)| n + 1);
        before = Some((s.kind, nth));
        table.row(vec![
            if nth == 1 { s.kind.to_owned() } else { format!("{} {nth}", s.kind) },
            s.count.to_string(),
            number(s.rate_hz, 1),
            format!("{:.2}", s.longest_gap_s),
            s.holes.to_string(),
            format!("{:.1}", s.missing_s),
        ]);
    }
    table.print();
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::sample::PressureSample;
    use crate::time::AutopilotTime;

    #[test]
    fn sensors_of_a_kind_are_told_apart_and_one_alone_is_the_kind() {
        let mut streams = Streams::default();
        for i in 0..100 {
            let time = AutopilotTime::from_micros(i * 100_000);
            let sensor = if i % 5 == 0 { 2 } else { 0 };
            streams.note(&Sample::Pressure(PressureSample { time, sensor, pressure_pa: 1e5 }));
        }
        assert_eq!(streams.heard()[SampleKind::Pressure as usize], 100);
        let told: Vec<_> = streams.reports().iter().map(|r| (r.kind, r.sensor, r.count)).collect();
        let barometers: Vec<_> = told.iter().filter(|r| r.2 > 0).copied().collect();
        let label = SampleKind::Pressure.label();
        assert_eq!(barometers, [(label, 0, 80), (label, 2, 20)]);
        assert_eq!(told.len(), SampleKind::ALL.len() + 1, "{told:?}");
    }
}
