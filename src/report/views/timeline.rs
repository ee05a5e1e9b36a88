//! What happened when: mode, what carries, GNSS, faults, every source's health, and the events.

use super::super::flight::FlightSheet;
use super::super::html::{lacking, table};
use super::super::lanes::{Lane, lanes};
use super::super::palette::Tone;
use crate::navigator::event::EventKind;

/// Events that are listed; a log of hours has more.
const MOST_LISTED: usize = 400;

/// Whether an event is good news.
fn tone(kind: &EventKind) -> Tone {
    match kind {
        EventKind::Mode { to, .. } => Tone::of(*to),
        EventKind::Accused(..)
        | EventKind::HeightFault { .. }
        | EventKind::FlowDistrusted(..)
        | EventKind::OriginContradicted(_)
        | EventKind::WalkedBack(_)
        | EventKind::HeadingTurned(_)
        | EventKind::LandmarkContradicts(_)
        | EventKind::LandmarksContradict { .. }
        | EventKind::LandmarksApart(_) => Tone::Bad,
        EventKind::Reset(_)
        | EventKind::HeightReset(_)
        | EventKind::InertialHeight(_)
        | EventKind::FilterRestarted(_)
        | EventKind::Bridged(_)
        | EventKind::Waits(_) => Tone::Caution,
        _ => Tone::Good,
    }
}

/// The lanes and the list of events.
pub(in super::super) fn view(sheet: &FlightSheet) -> String {
    let states = &sheet.recorder.states;
    let mut all = vec![states.mode.clone(), states.carrier.clone(), states.gnss.clone()];
    let mut withheld = Lane::new("GNSS withheld");
    for outage in &sheet.outcome.outages {
        withheld.add(outage.start_s, outage.end_s, Tone::Caution, "withheld");
    }
    all.push(withheld);
    for fault in &sheet.faults {
        let mut lane = Lane::new("fault put in");
        lane.add(fault.from_s, fault.to_s, Tone::Bad, fault.text.clone());
        all.push(lane);
    }
    let mut events = Lane::new("events");
    for (t_s, event) in &sheet.outcome.events {
        events.add(*t_s, *t_s, tone(&event.kind), event.to_string());
    }
    all.push(events);
    let mut sources = states.sources.clone();
    sources.sort_by_key(|(source, _)| *source);
    all.extend(sources.into_iter().map(|(_, lane)| lane));
    let explained =
        "Green is as it should be, blue nearly so, yellow with caution, red wrong, grey silent or not known.";
    let drawn = lanes("Modes, sources and events", explained, sheet.time_s(), &all);
    let drawn = drawn.unwrap_or_else(|| {
        lacking("Modes, sources and events", "No solution came about: there is nothing to tell over time.")
    });
    format!("{drawn}{}", listed(sheet))
}

fn listed(sheet: &FlightSheet) -> String {
    let events = &sheet.outcome.events;
    if events.is_empty() {
        return "<p>Nothing was told.</p>".to_owned();
    }
    let shown = events.iter().take(MOST_LISTED);
    let rows: Vec<Vec<String>> = shown
        .map(|(t, event)| vec![format!("{t:.1}"), event.kind.code().to_owned(), event.to_string()])
        .collect();
    let more = match events.len().saturating_sub(MOST_LISTED) {
        0 => String::new(),
        more => format!("<p>{more} more are not listed.</p>"),
    };
    let open = if events.len() <= 30 { " open=\"open\"" } else { "" };
    format!(
        "<details{open}><summary>{} events</summary>{}{more}</details>",
        events.len(),
        table(&["at s", "code", "what happened"], &rows)
    )
}
