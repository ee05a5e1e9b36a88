//! What dead reckonings beside GNSS have drifted by, and what was claimed of them before.

use super::super::chart::{Chart, Stroke};
use super::super::flight::FlightSheet;
use super::super::html::lacking;
use super::super::palette::Role;
use super::super::recorder::SeenDrift;
use super::super::scale::RangeFit;
use super::super::trace::Point;
use super::{drawn, group, over_time};
use crate::navigator::shadow::DriftComparison;
use crate::navigator::solution::VelocitySource;

/// Ages of dead reckonings that are within this part of each other are one.
const SAME_AGE: f64 = 0.15;

/// By what carried.
fn by_carrier(all: &[SeenDrift]) -> Vec<(VelocitySource, Vec<&SeenDrift>)> {
    let mut out: Vec<(VelocitySource, Vec<&SeenDrift>)> = Vec::new();
    for seen in all {
        match out.iter_mut().find(|(source, _)| *source == seen.1.source) {
            Some((_, of)) => of.push(seen),
            None => out.push((seen.1.source, vec![seen])),
        }
    }
    out
}

/// Root mean squares at each age: of the errors and of what was claimed.
fn by_age(all: &[&SeenDrift]) -> [Vec<Point>; 2] {
    let mut ages: Vec<f64> = all.iter().map(|(_, c)| c.age_s).collect();
    ages.sort_by(f64::total_cmp);
    ages.dedup_by(|later, first| *later < *first * (1.0 + SAME_AGE));
    let rms = |of: &dyn Fn(&SeenDrift) -> f64| -> Vec<Point> {
        let points = ages.iter().map(|&age| {
            let at: Vec<&&SeenDrift> =
                all.iter().filter(|(_, c)| c.age_s >= age && c.age_s < age * (1.0 + SAME_AGE)).collect();
            let n = at.len().max(1) as f64;
            (age, (at.iter().map(|s| of(s).powi(2)).sum::<f64>() / n).sqrt())
        });
        std::iter::once((0.0, 0.0)).chain(points).collect()
    };
    [rms(&|s| s.1.error_m), rms(&|s| s.1.sigma_m)]
}

/// One plot a carrier over the age, and one over the flight.
pub(in super::super) fn view(sheet: &FlightSheet) -> String {
    let all = &sheet.recorder.drift;
    if all.is_empty() {
        return lacking(
            "Drift without GNSS",
            "Nothing was measured: it takes a flight with trusted GNSS of more than ten seconds, and the shipped estimator.",
        );
    }
    let figures: Vec<String> = by_carrier(all).iter().map(|(source, of)| over_age(*source, of)).collect();
    let explained = "While GNSS is trusted, copies of the filter go on without it and are compared with fixes 10, 30, 60 and 120 s later. Here each error is over the sigma that was claimed for it before: most should lie below 2, and not all of them near 0.";
    let title = "Measured drift over what was claimed";
    let chart =
        Chart::new(title, sheet.time_s(), ["s", "sigmas"], RangeFit::FromZero(2.4)).explained(explained);
    let mut chart = over_time(sheet, chart);
    for (source, of) in by_carrier(all) {
        let part = |c: &DriftComparison| c.error_m / c.sigma_m.max(1e-3);
        let name = format!("on {}", source.label());
        chart.dots(&name, Role::of_carrier(source), of.iter().map(|(t, c)| (*t, part(c))).collect());
    }
    chart.guide(1.0, "1 sigma");
    chart.guide(2.0, "2 sigma");
    group(&figures) + &drawn(&chart, title, "Nothing was measured.")
}

fn over_age(source: VelocitySource, of: &[&SeenDrift]) -> String {
    let [error, sigma] = by_age(of);
    let longest = of.iter().map(|(_, c)| c.age_s).fold(10.0, f64::max);
    let title = format!("Carried by {}", source.label());
    let mut chart =
        Chart::new(&title, (0.0, longest * 1.08), ["s without GNSS", "m"], RangeFit::FromZero(1.0))
            .apart()
            .explained(format!("{} comparisons on this flight.", of.len()));
    let band = |k: f64| vec![sigma.iter().map(|(age, s)| (*age, 0.0, k * s)).collect::<Vec<_>>()];
    chart.band("2 sigma", Role::Estimate, band(2.0));
    chart.band("1 sigma, as fitted", Role::Estimate, band(1.0));
    chart.dots("error", Role::of_carrier(source), of.iter().map(|(_, c)| (c.age_s, c.error_m)).collect());
    chart.line("error, RMS", Role::Reference, Stroke::Plain, vec![error]);
    drawn(&chart, &title, "Nothing was measured.")
}
