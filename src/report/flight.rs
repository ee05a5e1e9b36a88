//! The report of one flight.

use std::fmt::Write;

use super::html::escaped;
use super::page::page;
use super::recorder::FlightRecorder;
use super::views;
use crate::navigator::shadow::MeasuredDrift;
use crate::navigator::solution::Mode;
use crate::navigator::sources::status::SourceReport;
use crate::replay::runner::{Outcome, ReferenceKind};

/// A fault that was put in: its text, and from when to when, s since the first sample.
#[derive(Clone, Debug)]
pub struct FaultShown {
    /// As on the command line.
    pub text: String,
    /// See there.
    pub from_s: f64,
    /// See there.
    pub to_s: f64,
}

/// All that is known of a flight that was played: what its report is made of.
#[derive(Clone, Debug)]
pub struct FlightSheet {
    /// What the log is called.
    pub name: String,
    /// The vehicle, and what navigated.
    pub about: String,
    /// What was kept while it was played.
    pub recorder: FlightRecorder,
    /// Its scores.
    pub outcome: Outcome,
    /// What became of every source, at the end.
    pub sources: Vec<SourceReport>,
    /// What an outage would come to.
    pub drift: Vec<MeasuredDrift>,
    /// Faults that were put in.
    pub faults: Vec<FaultShown>,
    /// What is to be said of the log.
    pub remarks: Vec<String>,
    /// What the log lacks to be navigated with.
    pub lacking: Option<String>,
}

/// A time without GNSS, s since the first sample.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct WithoutGnss {
    pub(super) from_s: f64,
    /// It was withheld until then; the same as `from_s` where it was lost, or not trusted.
    pub(super) withheld_to_s: f64,
    /// When it was navigated on again.
    pub(super) back_s: f64,
}

impl WithoutGnss {
    /// Whether it was withheld.
    pub(super) fn is_withheld(&self) -> bool {
        self.withheld_to_s > self.from_s
    }
}

impl FlightSheet {
    /// From the first sample to the last, s; never empty.
    pub(super) fn time_s(&self) -> (f64, f64) {
        (0.0, self.outcome.duration_s.max(self.recorder.end_s).max(0.1))
    }

    /// What the errors are against, for people.
    pub(super) fn against(&self) -> &'static str {
        match self.outcome.reference {
            ReferenceKind::Truth => "the simulator's truth",
            ReferenceKind::Gnss => "GNSS (fixes that were withheld, too)",
        }
    }

    /// The times without GNSS: those that were asked for, and those that happened.
    pub(super) fn without_gnss(&self) -> Vec<WithoutGnss> {
        let mut happened: Vec<(f64, f64)> = Vec::new();
        let without = [Mode::Holdover.label(), Mode::Lost.label()];
        for stay in self.recorder.states.mode.stays.iter().filter(|s| without.contains(&s.what.as_str())) {
            match happened.last_mut().filter(|last| last.1 >= stay.from_s) {
                Some(last) => last.1 = stay.to_s,
                None => happened.push((stay.from_s, stay.to_s)),
            }
        }
        let outages = &self.outcome.outages;
        let mut all: Vec<WithoutGnss> = outages
            .iter()
            .map(|o| {
                let over = |h: &&(f64, f64)| h.0 <= o.end_s && o.end_s <= h.1;
                let back_s = happened.iter().find(over).map_or(o.end_s, |h| h.1);
                WithoutGnss { from_s: o.start_s, withheld_to_s: o.end_s, back_s }
            })
            .collect();
        happened.retain(|h| !outages.iter().any(|o| o.start_s < h.1 && h.0 < o.end_s));
        all.extend(happened.into_iter().map(|h| WithoutGnss {
            from_s: h.0,
            withheld_to_s: h.0,
            back_s: h.1,
        }));
        all.sort_by(|a, b| a.from_s.total_cmp(&b.from_s));
        all
    }

    /// The flight's part of a page.
    fn section(&self, number: usize) -> String {
        let mut out = format!("<section id=\"flight-{number}\"><h1>{}</h1>", escaped(&self.name));
        let _ = write!(out, "<p>{}</p>", escaped(&self.about));
        for remark in &self.remarks {
            let _ = write!(out, "<p>{}</p>", escaped(remark));
        }
        if let Some(lacking) = &self.lacking {
            out.push_str(&super::html::lacking("Not navigated with", lacking));
        }
        out.push_str(&views::overview::cards(self));
        type Part<'a> = (&'a str, &'a dyn Fn(&FlightSheet) -> String);
        let parts: [Part<'_>; 9] = [
            ("What happened", &views::timeline::view),
            ("Where it flew", &views::plan::view),
            ("How far it was off", &views::error::view),
            ("What an outage comes to", &views::drift::view),
            ("Height", &views::height::view),
            ("Heading", &views::heading::view),
            ("How well the sensors fit", &views::fit::view),
            ("Vibration", &views::vibration::view),
            ("Tables", &views::tables::view),
        ];
        out.push_str("<nav>");
        for (i, (title, _)) in parts.iter().enumerate() {
            let _ = write!(out, "<a href=\"#flight-{number}-{i}\">{title}</a>");
        }
        out.push_str("</nav>");
        for (i, (title, view)) in parts.iter().enumerate() {
            let _ = write!(out, "<h2 id=\"flight-{number}-{i}\">{title}</h2>\n{}", view(self));
        }
        out.push_str("</section>");
        out
    }
}

/// The page of these flights, one after the other.
pub fn flights_page(flights: &[FlightSheet]) -> String {
    let mut body = String::new();
    if flights.len() > 1 {
        body.push_str("<nav>");
        for (i, flight) in flights.iter().enumerate() {
            let _ = write!(body, "<a href=\"#flight-{i}\">{}</a>", escaped(&flight.name));
        }
        body.push_str("</nav>");
    }
    for (i, flight) in flights.iter().enumerate() {
        body.push_str(&flight.section(i));
    }
    let title = match flights {
        [only] => format!("{} – Holdover", only.name),
        _ => format!("{} flights – Holdover", flights.len()),
    };
    page(&title, &body)
}
