//! Metrics, as Prometheus reads them (OpenMetrics): base units in the names, `_total` on what only grows. Labels are words of Holdover's own, never text
//! from a link.

use std::collections::BTreeMap;
use std::fmt;
use std::sync::Arc;
use std::sync::atomic::Ordering;

use prometheus_client::collector::Collector;
use prometheus_client::encoding::text::encode;
use prometheus_client::encoding::{DescriptorEncoder, MetricEncoder};
use prometheus_client::metrics::MetricType;
use prometheus_client::registry::{Registry, Unit};

use super::board::{Board, Shown};
use super::view::{RecordingView, SourceView, StatusView};

/// Of the text.
pub(super) const CONTENT_TYPE: &str = "application/openmetrics-text; version=1.0.0; charset=utf-8";

/// What is known at a scrape.
#[derive(Debug)]
struct MetricsReading {
    shown: Arc<Shown>,
    events: BTreeMap<String, u64>,
    /// Requests by what became of them.
    requests: [(&'static str, u64); 4],
}

/// A value with its labels.
type Sampled = (Vec<(&'static str, String)>, f64);

/// Metrics of one name.
struct Family {
    name: &'static str,
    help: &'static str,
    unit: Option<&'static str>,
    grows: bool,
    samples: fn(&MetricsReading) -> Vec<Sampled>,
}

const MODES: [&str; 5] = ["Aligning", "Aided", "Holdover", "Rejoining", "Lost"];
const HEALTHS: [&str; 4] = ["healthy", "suspect", "faulty", "silent"];

const fn gauge(
    name: &'static str,
    unit: Option<&'static str>,
    help: &'static str,
    samples: fn(&MetricsReading) -> Vec<Sampled>,
) -> Family {
    Family { name, help, unit, grows: false, samples }
}

const fn counter(
    name: &'static str,
    help: &'static str,
    samples: fn(&MetricsReading) -> Vec<Sampled>,
) -> Family {
    Family { name, help, unit: None, grows: true, samples }
}

const FAMILIES: &[Family] = &[
    gauge("holdover_uptime", Some("seconds"), "Since the daemon began", |r| one(v(r).uptime_s)),
    gauge("holdover_vehicle_heard", None, "1 while the autopilot is heard", |r| {
        one(f64::from(u8::from(v(r).vehicle.as_ref().is_some_and(|vehicle| vehicle.heard))))
    }),
    gauge("holdover_vehicle_armed", None, "1 while the vehicle is armed", |r| {
        v(r).vehicle.iter().flat_map(|vehicle| one(f64::from(u8::from(vehicle.armed)))).collect()
    }),
    gauge("holdover_mode", None, "1 for the mode that the navigator is in", |r| {
        states("mode", &MODES, &v(r).mode.name, Vec::new())
    }),
    gauge("holdover_mode_duration", Some("seconds"), "For how long it has been in it", |r| {
        one(v(r).mode.for_s)
    }),
    gauge(
        "holdover_horizontal_sigma",
        Some("meters"),
        "Standard deviation of the horizontal position",
        |r| v(r).uncertainty.iter().flat_map(|u| one(u.horizontal_m)).collect(),
    ),
    gauge("holdover_height_sigma", Some("meters"), "Standard deviation of the height", |r| {
        v(r).uncertainty.iter().flat_map(|u| one(u.height_m)).collect()
    }),
    gauge(
        "holdover_outlook_error",
        Some("meters"),
        "Error after a minute without GNSS, measured on this flight",
        |r| v(r).outlook.iter().flat_map(|o| o.off_m).flat_map(one).collect(),
    ),
    gauge("holdover_source_rate", Some("hertz"), "Samples of a source", |r| sources(r, |s| Some(s.rate_hz))),
    gauge("holdover_source_age", Some("seconds"), "Since the newest sample of a source", |r| {
        sources(r, |s| Some(s.age_s))
    }),
    gauge("holdover_source_test", Some("ratio"), "Innovations against their gate, above 1 outside", |r| {
        sources(r, |s| s.test_ratio)
    }),
    gauge("holdover_source_health", None, "1 for the health that a source has", |r| {
        let states = |s: &SourceView| {
            states("health", &HEALTHS, &s.health, vec![("source", s.kind.clone()), ("id", s.id.to_string())])
        };
        v(r).sources.iter().flat_map(states).collect()
    }),
    counter("holdover_source_used", "Samples of a source that were used", |r| {
        sources(r, |s| Some(s.used as f64))
    }),
    counter("holdover_source_refused", "Samples of a source that were refused", |r| {
        sources(r, |s| Some(s.refused as f64))
    }),
    counter("holdover_positions_sent", "Positions sent to the autopilot", |r| one(v(r).output.sent as f64)),
    counter("holdover_positions_withheld", "Positions withheld, too old or no number", |r| {
        one(v(r).output.withheld as f64)
    }),
    gauge("holdover_position_rate", Some("hertz"), "Positions sent", |r| one(v(r).output.rate_hz)),
    gauge(
        "holdover_position_latency",
        Some("seconds"),
        "Age of a position when it comes to the autopilot",
        |r| v(r).clock.latency_ms.iter().flat_map(|ms| one(ms * 1e-3)).collect(),
    ),
    gauge("holdover_round_trip", Some("seconds"), "Shortest round trip to the autopilot", |r| {
        v(r).clock.round_trip_ms.iter().flat_map(|ms| one(ms * 1e-3)).collect()
    }),
    counter("holdover_recorded_bytes", "Bytes recorded", |r| recorded(v(r), |r| r.bytes)),
    counter("holdover_frames_not_recorded", "Frames missing in the recording", |r| {
        recorded(v(r), |r| r.lost)
    }),
    counter("holdover_frames", "Frames taken", |r| one(v(r).input.frames as f64)),
    counter("holdover_frames_rejected", "Frames and values refused, by cause", |r| {
        v(r).input.rejected.iter().map(|c| (vec![("cause", c.cause.clone())], c.count as f64)).collect()
    }),
    counter("holdover_frames_dropped", "Frames and datagrams dropped as they were not read in time", |r| {
        one(v(r).input.dropped as f64)
    }),
    counter("holdover_strangers", "Datagrams and connections of strangers", |r| {
        one(v(r).input.strangers as f64)
    }),
    counter("holdover_autopilot_reboots", "Reboots of the autopilot", |r| one(f64::from(v(r).clock.reboots))),
    counter("holdover_events", "Events, by severity", |r| {
        r.events.iter().map(|(severity, n)| (vec![("severity", severity.clone())], *n as f64)).collect()
    }),
    counter("holdover_requests", "Requests to this server, by what became of them", |r| {
        r.requests.iter().map(|(what, n)| (vec![("outcome", (*what).to_owned())], *n as f64)).collect()
    }),
];

fn v(r: &MetricsReading) -> &StatusView {
    &r.shown.view
}

fn recorded(v: &StatusView, value: fn(&RecordingView) -> u64) -> Vec<Sampled> {
    v.output.recording.iter().flat_map(|r| one(value(r) as f64)).collect()
}

fn one(value: f64) -> Vec<Sampled> {
    vec![(Vec::new(), value)]
}

fn sources(r: &MetricsReading, value: fn(&SourceView) -> Option<f64>) -> Vec<Sampled> {
    let labels = |s: &SourceView| vec![("source", s.kind.clone()), ("id", s.id.to_string())];
    v(r).sources.iter().filter_map(|s| Some((labels(s), value(s)?))).collect()
}

/// 1 for the state that is, 0 for the others.
fn states(label: &'static str, all: &[&str], is: &str, others: Vec<(&'static str, String)>) -> Vec<Sampled> {
    let sample = |state: &&str| {
        let mut labels = others.clone();
        labels.push((label, state.to_lowercase()));
        (labels, f64::from(u8::from(*state == is)))
    };
    all.iter().map(sample).collect()
}

impl Collector for MetricsReading {
    fn encode(&self, mut encoder: DescriptorEncoder<'_>) -> Result<(), fmt::Error> {
        for family in FAMILIES {
            let unit = family.unit.map(|u| Unit::Other(u.to_owned()));
            let kind = if family.grows { MetricType::Counter } else { MetricType::Gauge };
            let mut metric = encoder.encode_descriptor(family.name, family.help, unit.as_ref(), kind)?;
            for (labels, value) in (family.samples)(self).into_iter().filter(|(_, value)| value.is_finite()) {
                if labels.is_empty() {
                    write(&mut metric, family.grows, value)?;
                } else {
                    write(&mut metric.encode_family(&labels)?, family.grows, value)?;
                }
            }
        }
        Ok(())
    }
}

fn write(sample: &mut MetricEncoder<'_>, grows: bool, value: f64) -> Result<(), fmt::Error> {
    if grows {
        sample.encode_counter::<Vec<(String, String)>, _, f64>(&value, None)
    } else {
        sample.encode_gauge(&value)
    }
}

/// All metrics as they are now.
pub(super) fn text(board: &Board) -> String {
    let r = &board.requests;
    let count = |n: &std::sync::atomic::AtomicU64| n.load(Ordering::Relaxed);
    let requests = [
        ("served", count(&r.served)),
        ("foreign", count(&r.foreign)),
        ("unknown", count(&r.unknown)),
        ("dropped", count(&r.dropped)),
    ];
    let shown = Arc::clone(&board.newest.borrow());
    let mut registry = Registry::default();
    registry.register_collector(Box::new(MetricsReading { shown, events: board.event_counts(), requests }));
    let mut text = String::new();
    // Writing to a string does not fail.
    let _ = encode(&mut text, &registry);
    text
}
