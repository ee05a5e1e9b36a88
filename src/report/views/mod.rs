//! The plots and tables of a flight: one file each.

pub(super) mod drift;
pub(super) mod error;
pub(super) mod fit;
pub(super) mod heading;
pub(super) mod height;
pub(super) mod overview;
pub(super) mod plan;
pub(super) mod tables;
pub(super) mod timeline;
pub(super) mod vibration;

use super::chart::Chart;
use super::flight::{FlightSheet, WithoutGnss};
use super::html::lacking;
use super::trace::{Point, Trace};

/// A plot over the flight's time, with the times without GNSS and the faults that were put in marked.
fn over_time(sheet: &FlightSheet, chart: Chart) -> Chart {
    let mut chart = chart;
    for loss in sheet.without_gnss() {
        mark(&mut chart, &loss, 0.0);
    }
    chart
}

/// Marks a time without GNSS on a plot that begins at `begin_s`.
fn mark(chart: &mut Chart, loss: &WithoutGnss, begin_s: f64) {
    let WithoutGnss { from_s, withheld_to_s, back_s } = *loss;
    if loss.is_withheld() {
        let what = format!("GNSS withheld: {from_s:.1} to {withheld_to_s:.1} s");
        chart.mark(from_s - begin_s, withheld_to_s - begin_s, "m-withheld", &what);
    }
    if back_s > withheld_to_s {
        let what = format!("without GNSS: {withheld_to_s:.1} to {back_s:.1} s");
        chart.mark(withheld_to_s - begin_s, back_s - begin_s, "m-lost", &what);
    }
}

/// The plot, or what is lacking.
fn drawn(chart: &Chart, title: &str, why: &str) -> String {
    chart.render().unwrap_or_else(|| lacking(title, why))
}

/// Plots beside each other.
fn group(figures: &[String]) -> String {
    format!("<div class=\"group\">{}</div>", figures.concat())
}

/// The area within `k` sigmas of zero.
fn from_zero(sigma: &Trace, k: f64, (from_s, to_s): (f64, f64), shift_s: f64) -> Vec<Vec<(f64, f64, f64)>> {
    let stretches = sigma.stretches_between(from_s, to_s);
    stretches.iter().map(|s| s.iter().map(|(t, v)| (t - shift_s, 0.0, k * v)).collect()).collect()
}

/// The area within `k` sigmas of a value.
fn around(value: &Trace, sigma: &Trace, k: f64) -> Vec<Vec<(f64, f64, f64)>> {
    let sigmas = sigma.points();
    let at = |t: f64| sigmas.get(sigmas.partition_point(|p| p.0 <= t).saturating_sub(1)).map_or(0.0, |p| p.1);
    let stretches = value.stretches();
    stretches.iter().map(|s| s.iter().map(|(t, v)| (*t, v - k * at(*t), v + k * at(*t))).collect()).collect()
}

/// The same points, earlier by `shift_s`.
fn shifted(stretches: Vec<Vec<Point>>, shift_s: f64) -> Vec<Vec<Point>> {
    stretches.into_iter().map(|s| s.into_iter().map(|(t, v)| (t - shift_s, v)).collect()).collect()
}
