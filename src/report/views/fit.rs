//! Innovations over their sigmas, source by source, and what was learned of the flow sensors.

use super::super::chart::{Chart, Stroke};
use super::super::flight::FlightSheet;
use super::super::html::{lacking, number};
use super::super::palette::Role;
use super::super::recorder::{FitRecord, FlowRecord};
use super::super::scale::RangeFit;
use super::{around, drawn, group, over_time};

/// A plot reaches at least so far.
const LEAST_SIGMAS: f64 = 1.5;

/// The plots.
pub(in super::super) fn view(sheet: &FlightSheet) -> String {
    let record = &sheet.recorder;
    let mut fits: Vec<&FitRecord> = record.fits.iter().collect();
    fits.sort_by_key(|r| (r.source, r.measured.label()));
    let mut out = String::from(
        "<p>How far each measurement lay from what was expected, in its sigmas, and the mean of the squares (NIS) of five seconds: an honest filter's is 1. Well above it is too sure of itself, well below too cautious.</p>",
    );
    if fits.is_empty() {
        out.push_str(&lacking(
            "Innovations",
            "Nothing was fused: the filter was never started, or another estimator navigates.",
        ));
    } else {
        out.push_str(&group(&fits.iter().map(|r| fit(sheet, r)).collect::<Vec<_>>()));
    }
    out.push_str("<h3>Optical flow: what was learned</h3>");
    if record.flows.is_empty() {
        out.push_str(&lacking("Optical flow", "No optical flow was heard."));
    }
    for flow in &record.flows {
        out.push_str(&learned(sheet, flow));
    }
    out
}

fn fit(sheet: &FlightSheet, record: &FitRecord) -> String {
    let source = record.source.to_string();
    let title = if source.starts_with(record.measured.label()) {
        source
    } else {
        format!("{}, {source}", record.measured.label())
    };
    if record.count.fused == 0 {
        return lacking(&title, &format!("{} were gated out, none was fused.", record.count.gated));
    }
    let role = Role::of(record.source.kind);
    let mean = number(record.count.mean(), 2);
    let explained =
        format!("{} fused, {} gated out, mean NIS {mean}.", record.count.fused, record.count.gated);
    let chart = Chart::new(&title, sheet.time_s(), ["s", "sigmas"], RangeFit::MostFromZero(LEAST_SIGMAS))
        .small()
        .explained(explained);
    let mut chart = over_time(sheet, chart);
    chart.trace("innovation over sigma", role, Stroke::Faint, &record.normalised);
    chart.trace("NIS, mean", Role::Reference, Stroke::Plain, &record.nis);
    // What was gated out has no place of its own: it is marked at the foot.
    chart.dots("gated out", Role::Fault, record.gated.clone());
    chart.guide(1.0, "honest");
    drawn(&chart, &title, "All that came was gated out.")
}

fn learned(sheet: &FlightSheet, record: &FlowRecord) -> String {
    let n = record.sensor;
    let what = [
        (format!("Flow {n}: scale error"), "%", 2.0),
        (format!("Flow {n}: bias about x"), "mrad/s", 4.0),
        (format!("Flow {n}: bias about y"), "mrad/s", 4.0),
        (format!("Flow {n}: latency"), "ms", 20.0),
    ];
    let figures = record.learned.iter().zip(what).map(|([value, sigma], (title, unit, least))| {
        let chart = Chart::new(&title, sheet.time_s(), ["s", unit], RangeFit::Around(least)).small();
        let mut chart = over_time(sheet, chart);
        chart.band("1 sigma", Role::Flow, around(value, sigma, 1.0));
        chart.trace("learned", Role::Flow, Stroke::Plain, value);
        drawn(&chart, &title, "It was never heard.")
    });
    group(&figures.collect::<Vec<_>>())
}
