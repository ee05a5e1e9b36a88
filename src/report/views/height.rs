//! The height, and what each of its sources says, with the times in which one was convicted.

use super::super::chart::{Chart, Stroke};
use super::super::flight::FlightSheet;
use super::super::lanes::{Lane, lanes};
use super::super::palette::{Role, Tone};
use super::super::scale::RangeFit;
use super::{around, drawn, over_time};
use crate::altimeter::Channel;
use crate::navigator::event::EventKind;

/// A plot of heights is at least so high, m.
const LEAST_M: f64 = 4.0;

/// When a channel was called faulty, from the fault's estimated beginning on, and what was said of it.
fn convicted(sheet: &FlightSheet, channel: Channel) -> Lane {
    let mut lane = Lane::new(channel.label());
    let (mut since, end_s): (Option<(f64, String)>, f64) = (None, sheet.time_s().1);
    for (t_s, event) in &sheet.outcome.events {
        match event.kind {
            EventKind::HeightFault { channel: of, fault, for_s } if of == channel => {
                let (begun, _) = since.take().unwrap_or((t_s - for_s, String::new()));
                since = Some((begun.max(0.0), fault.to_string()));
            }
            EventKind::HeightHealed(of) if of == channel => {
                if let Some((from_s, what)) = since.take() {
                    lane.add(from_s, *t_s, Tone::Bad, what);
                }
            }
            _ => {}
        }
    }
    if let Some((from_s, what)) = since {
        lane.add(from_s, end_s, Tone::Bad, what);
    }
    lane
}

/// The plot, and the convictions below it.
pub(in super::super) fn view(sheet: &FlightSheet) -> String {
    let record = &sheet.recorder.height;
    let title = "Height above the origin";
    let explained = "Every source less what it is off by as a rule: one that leaves the others is wrong, or its offset is.";
    let chart = Chart::new(title, sheet.time_s(), ["s", "m"], RangeFit::Around(LEAST_M)).explained(explained);
    let mut chart = over_time(sheet, chart);
    chart.band("1 sigma", Role::Estimate, around(&record.estimate_m, &record.sigma_m, 1.0));
    chart.trace("autopilot's own estimate", Role::Autopilot, Stroke::Faint, &record.autopilot_m);
    for channel in &record.channels {
        chart.trace(
            channel.channel.label(),
            Role::of_height(channel.channel),
            Stroke::Faint,
            &channel.height_m,
        );
    }
    chart.trace("truth", Role::Reference, Stroke::Dashed, &record.truth_m);
    chart.trace("estimate", Role::Estimate, Stroke::Plain, &record.estimate_m);
    let mut out = drawn(&chart, title, "No height came about: neither a barometer nor a fix was heard.");
    out.push_str(&apart(sheet));
    let all: Vec<Lane> = Channel::ALL.into_iter().map(|channel| convicted(sheet, channel)).collect();
    match lanes(
        "Sources of heights that were convicted",
        "From when each fault is taken to have begun.",
        sheet.time_s(),
        &all,
    ) {
        Some(lanes) => out.push_str(&lanes),
        None => out.push_str("<p>No source of heights was convicted.</p>"),
    }
    out
}

/// Every source less the estimate, where a fault is seen that is small beside the flight's heights.
fn apart(sheet: &FlightSheet) -> String {
    let record = &sheet.recorder.height;
    let title = "Every source of the height, less the estimate";
    let mut chart =
        over_time(sheet, Chart::new(title, sheet.time_s(), ["s", "m"], RangeFit::Around(LEAST_M)));
    for channel in &record.channels {
        chart.trace(
            channel.channel.label(),
            Role::of_height(channel.channel),
            Stroke::Faint,
            &channel.apart_m,
        );
    }
    let sigma = record.sigma_m.stretches();
    let band = |k: f64| sigma.iter().map(|s| s.iter().map(|(t, v)| (*t, -k * v, k * v)).collect()).collect();
    chart.band("2 sigma", Role::Estimate, band(2.0));
    chart.band("1 sigma", Role::Estimate, band(1.0));
    let truth = sheet.recorder.against_truth.altitude.stretches();
    let less = truth.into_iter().map(|s| s.into_iter().map(|(t, v)| (t, -v)).collect());
    chart.line("truth", Role::Reference, Stroke::Plain, less.collect());
    drawn(&chart, title, "No source of the height was heard.")
}
