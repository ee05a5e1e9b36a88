//! How far the estimate was off, and how far it said it might be.

use super::super::chart::{Chart, Stroke};
use super::super::flight::{FlightSheet, WithoutGnss};
use super::super::html::{lacking, number};
use super::super::palette::Role;
use super::super::recorder::ErrorRecord;
use super::super::scale::RangeFit;
use super::{drawn, from_zero, group, mark, over_time, shifted};
use crate::replay::runner::ReferenceKind;

/// Times without GNSS that get a plot of their own.
const MOST_SHOWN: usize = 12;
/// A plot of one begins before it and ends after it, s.
const BEFORE_S: f64 = 5.0;
const AFTER_S: f64 = 10.0;
/// One that is shorter is seen well enough on the whole flight's plot, s.
const LEAST_S: f64 = 3.0;
/// A plot of errors reaches at least so far, m.
const LEAST_M: f64 = 2.0;

fn errors(sheet: &FlightSheet) -> &ErrorRecord {
    match sheet.outcome.reference {
        ReferenceKind::Truth => &sheet.recorder.against_truth,
        ReferenceKind::Gnss => &sheet.recorder.against_gnss,
    }
}

/// The whole flight, and every time without GNSS.
pub(in super::super) fn view(sheet: &FlightSheet) -> String {
    let (record, errors) = (&sheet.recorder, errors(sheet));
    let title = "Horizontal error and what was claimed";
    let mut explained = format!(
        "Against {}. The areas are 1 and 2 times the claimed sigma: an honest one holds the line nearly always within the second.",
        sheet.against()
    );
    if errors.horizontal.is_empty() {
        explained =
            "The log holds nothing to compare with, neither truth nor a fix: only what was claimed is shown."
                .to_owned();
    }
    let chart =
        Chart::new(title, sheet.time_s(), ["s", "m"], RangeFit::Decades(LEAST_M)).explained(explained);
    let mut chart = over_time(sheet, chart);
    let all = (f64::NEG_INFINITY, f64::INFINITY);
    chart.band("2 sigma", Role::Estimate, from_zero(&record.sigma, 2.0, all, 0.0));
    chart.band("1 sigma", Role::Estimate, from_zero(&record.sigma, 1.0, all, 0.0));
    chart.trace("error", Role::Reference, Stroke::Plain, &errors.horizontal);
    let whole = drawn(&chart, title, "No solution came about that could be off.");

    let without: Vec<WithoutGnss> =
        sheet.without_gnss().into_iter().filter(|w| w.back_s - w.from_s >= LEAST_S).collect();
    if without.is_empty() {
        return whole
            + &lacking(
                "Without GNSS",
                "GNSS was there all the time: withhold it with --outage A..B to see what would come of it.",
            );
    }
    let shown: Vec<String> = without
        .iter()
        .enumerate()
        .take(MOST_SHOWN)
        .map(|(i, loss)| one(sheet, errors, i + 1, loss))
        .collect();
    let more = match without.len().saturating_sub(MOST_SHOWN) {
        0 => String::new(),
        more => format!("<p>{more} more are not shown one by one.</p>"),
    };
    whole + &group(&shown) + &more
}

/// One time without GNSS, from its beginning on.
fn one(sheet: &FlightSheet, errors: &ErrorRecord, i: usize, loss: &WithoutGnss) -> String {
    let length_s = loss.back_s - loss.from_s;
    let kind = if loss.is_withheld() { "GNSS withheld" } else { "Without GNSS" };
    let title = format!("{i}: {kind} from {:.0} s for {length_s:.0} s", loss.from_s);
    let scored = sheet.outcome.outages.iter().find(|o| loss.is_withheld() && o.start_s == loss.from_s);
    let span = (loss.from_s - BEFORE_S, loss.back_s + AFTER_S);
    let line = errors.horizontal.stretches_between(span.0, span.1);
    let explained = match scored {
        Some(o) => format!(
            "{} m off at its end, {} m claimed (1 sigma), {} % of the distance.",
            number(o.horizontal_error_end_m, 1),
            number(o.sigma_end_m, 1),
            number(o.drift_percent, 1)
        ),
        None if sheet.outcome.reference == ReferenceKind::Truth => String::new(),
        None => "What GNSS told meanwhile, if anything, is what it is compared with: it may be wrong itself."
            .to_owned(),
    };
    let mut chart = Chart::new(
        &title,
        (-BEFORE_S, length_s + AFTER_S),
        ["s since its beginning", "m"],
        RangeFit::FromZero(LEAST_M),
    )
    .apart()
    .explained(explained);
    mark(&mut chart, loss, loss.from_s);
    chart.band("2 sigma", Role::Estimate, from_zero(&sheet.recorder.sigma, 2.0, span, loss.from_s));
    chart.band("1 sigma", Role::Estimate, from_zero(&sheet.recorder.sigma, 1.0, span, loss.from_s));
    chart.line("error", Role::Reference, Stroke::Plain, shifted(line, loss.from_s));
    drawn(&chart, &title, "No solution was there to be off.")
}
