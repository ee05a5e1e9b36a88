//! The heading, and what everybody who can tell says of it.

use super::super::chart::{Chart, Stroke};
use super::super::flight::FlightSheet;
use super::super::palette::Role;
use super::super::recorder::WitnessKind;
use super::super::scale::RangeFit;
use super::{drawn, over_time};

/// A plot of headings is at least so high, degrees.
const LEAST_DEG: f64 = 10.0;

fn shown(kind: WitnessKind) -> (String, Role, Stroke) {
    match kind {
        WitnessKind::Magnetometer(0) => ("magnetometer 0".to_owned(), Role::Magnetometer, Stroke::Faint),
        WitnessKind::Magnetometer(n) => (format!("magnetometer {n}"), Role::Magnetometer, Stroke::Dashed),
        WitnessKind::Autopilot => ("autopilot's own estimate".to_owned(), Role::Autopilot, Stroke::Plain),
        WitnessKind::Truth => ("truth".to_owned(), Role::Reference, Stroke::Plain),
        WitnessKind::Course => ("course over ground".to_owned(), Role::Gnss, Stroke::Faint),
    }
}

/// The witnesses against the estimate, and the heading itself.
pub(in super::super) fn view(sheet: &FlightSheet) -> String {
    let record = &sheet.recorder.heading;
    let title = "Every witness of the heading, less the estimate";
    let explained = "Magnetometers as they tell it, without what was learned of their errors; the course of a wing is off by the wind.";
    let chart =
        Chart::new(title, sheet.time_s(), ["s", "deg"], RangeFit::Around(LEAST_DEG)).explained(explained);
    let mut chart = over_time(sheet, chart);
    let none = record.witnesses.is_empty();
    let band = |k: f64| -> Vec<Vec<(f64, f64, f64)>> {
        let stretches = record.sigma_deg.stretches();
        stretches.iter().map(|s| s.iter().map(|(t, v)| (*t, -k * v, k * v)).collect()).collect()
    };
    let bands = |chart: &mut Chart| {
        chart.band("2 sigma", Role::Estimate, band(2.0));
        chart.band("1 sigma", Role::Estimate, band(1.0));
    };
    let mut witnesses: Vec<_> = record.witnesses.iter().collect();
    // What is most certain lies on top.
    witnesses.sort_by_key(|w| match w.kind {
        WitnessKind::Course => 0,
        WitnessKind::Magnetometer(_) => 1,
        WitnessKind::Autopilot => 2,
        WitnessKind::Truth => 3,
    });
    let noisy =
        witnesses.partition_point(|w| matches!(w.kind, WitnessKind::Course | WitnessKind::Magnetometer(_)));
    for (i, witness) in witnesses.iter().enumerate() {
        if i == noisy {
            bands(&mut chart);
        }
        let (name, role, stroke) = shown(witness.kind);
        chart.trace(&name, role, stroke, &witness.apart_deg);
    }
    if noisy == witnesses.len() {
        bands(&mut chart);
    }
    let mut out = if none {
        super::lacking(
            title,
            "The log holds no other witness of the heading: no magnetometer, and no attitude of the autopilot.",
        )
    } else {
        drawn(&chart, title, "No heading came about.")
    };
    out.push_str(&itself(sheet));
    out
}

/// The heading itself.
fn itself(sheet: &FlightSheet) -> String {
    let title = "Heading";
    let chart = Chart::new(title, sheet.time_s(), ["s", "deg"], RangeFit::Fixed(-180.0, 180.0));
    let mut chart = over_time(sheet, chart);
    // Where it passes south it is not drawn across.
    let mut turns = Vec::new();
    for stretch in sheet.recorder.heading.heading_deg.stretches() {
        let mut rest = &stretch[..];
        while let Some(at) = rest.windows(2).position(|w| (w[1].1 - w[0].1).abs() > 180.0) {
            turns.push(rest[..=at].to_vec());
            rest = &rest[at + 1..];
        }
        turns.push(rest.to_vec());
    }
    chart.line("estimate", Role::Estimate, Stroke::Plain, turns);
    drawn(&chart, title, "No heading came about.")
}
