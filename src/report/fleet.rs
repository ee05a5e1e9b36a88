//! The report of many flights: what an evaluation says of them, a row a flight, how errors are distributed, and the worst.

use std::collections::BTreeMap;
use std::fmt::Write;

use super::chart::{Chart, Stroke};
use super::html::{duration, escaped, lacking, number, short, table};
use super::page::page;
use super::palette::{Role, Tone};
use super::scale::RangeFit;
use super::trace::Point;
use crate::fleet::LogOutcome;

/// Outages that are shown as the worst.
const WORST: usize = 10;
/// Flights that get a row; those with the largest errors first.
const MOST_ROWS: usize = 3000;
/// Points of a distribution's line.
const MOST_POINTS: usize = 300;

/// One outage of a flight, as far as it could be compared.
#[derive(Clone, Copy, Debug)]
struct ScoredOutage {
    /// Which estimator and which length, in the order in which they came.
    kind: usize,
    start_s: f64,
    length_s: f64,
    error_m: f64,
    sigma_m: Option<f64>,
    distance_m: Option<f64>,
}

impl ScoredOutage {
    fn sigmas(&self) -> Option<f64> {
        self.sigma_m.filter(|s| *s > 0.0).map(|s| self.error_m / s)
    }
}

/// One flight.
#[derive(Clone, Debug)]
struct FlightRow {
    log: String,
    autopilot: String,
    duration_s: Option<f64>,
    losses: usize,
    why: String,
    outages: Vec<ScoredOutage>,
}

impl FlightRow {
    /// The outage with the largest error.
    fn worst(&self) -> Option<&ScoredOutage> {
        self.outages.iter().max_by(|a, b| a.error_m.total_cmp(&b.error_m))
    }
}

/// What is shown of a fleet. Feed it every log's outcome, in the order of the list.
#[derive(Clone, Debug, Default)]
pub struct FleetSheet {
    /// Estimators and lengths, s.
    kinds: Vec<(String, f64)>,
    flights: Vec<FlightRow>,
}

impl FleetSheet {
    /// Adds what came of a log.
    pub fn add(&mut self, outcome: &LogOutcome) {
        let mut outages = Vec::with_capacity(outcome.rows.len());
        for row in &outcome.rows {
            let Some(error_m) = row.row.horizontal_error_end_m else { continue };
            let kind = (row.estimator.clone(), row.row.length_s);
            let at = self.kinds.iter().position(|k| *k == kind).unwrap_or_else(|| {
                self.kinds.push(kind);
                self.kinds.len() - 1
            });
            outages.push(ScoredOutage {
                kind: at,
                start_s: row.row.start_s,
                length_s: row.row.length_s,
                error_m,
                sigma_m: row.row.sigma_end_m,
                distance_m: row.row.distance_m,
            });
        }
        let format = outcome.format.as_deref().unwrap_or_default();
        self.flights.push(FlightRow {
            log: outcome.log.clone(),
            autopilot: format!("{format} {}", outcome.autopilot.as_deref().unwrap_or_default())
                .trim()
                .to_owned(),
            duration_s: outcome.duration_s,
            losses: outcome.losses.len(),
            why: outcome.failure.as_ref().map(|f| f.why.clone()).unwrap_or_default(),
            outages,
        });
    }

    fn of_kind(&self, kind: usize) -> Vec<&ScoredOutage> {
        self.flights.iter().flat_map(|f| &f.outages).filter(|o| o.kind == kind).collect()
    }

    /// The estimator that the list begins with: the one that is asked about.
    fn first(&self) -> &str {
        self.kinds.first().map_or("", |k| &k.0)
    }

    /// The page.
    pub fn page(&self) -> String {
        let mut body = format!("<section><h1>{} flights</h1>", self.flights.len());
        body.push_str(&self.cards());
        body.push_str("<h2>How large the errors are</h2>");
        body.push_str(&self.distributions());
        body.push_str("<h2>Whether sigma is honest</h2>");
        body.push_str(&self.honesty());
        body.push_str("<h2>The worst</h2>");
        body.push_str(&self.worst());
        body.push_str("<h2>Every flight</h2>");
        body.push_str(&self.rows());
        body.push_str("</section>");
        page(&format!("{} flights – Holdover", self.flights.len()), &body)
    }

    fn cards(&self) -> String {
        let with = self.flights.iter().filter(|f| !f.outages.is_empty()).count();
        let all: Vec<&ScoredOutage> = self.flights.iter().flat_map(|f| &f.outages).collect();
        let ours: Vec<f64> =
            all.iter().filter(|o| self.kinds[o.kind].0 == self.first()).filter_map(|o| o.sigmas()).collect();
        let mut cards = vec![
            (with.to_string(), "flights with outages to compare".to_owned(), Tone::Idle),
            (all.len().to_string(), "outages, of all estimators".to_owned(), Tone::Idle),
            (
                self.flights.iter().map(|f| f.losses).sum::<usize>().to_string(),
                "losses of GNSS that are in the logs".to_owned(),
                Tone::Idle,
            ),
        ];
        if !ours.is_empty() {
            let within = 100.0 * ours.iter().filter(|s| **s <= 2.0).count() as f64 / ours.len() as f64;
            let tone = if within >= 95.0 { Tone::Good } else { Tone::Caution };
            cards.push((
                format!("{within:.1} %"),
                format!("of errors within 2 sigma, {}", self.first()),
                tone,
            ));
        }
        let without = self.flights.len() - with;
        if without > 0 {
            cards.push((
                without.to_string(),
                "flights without any: why stands below".to_owned(),
                Tone::Caution,
            ));
        }
        let mut out = String::from("<ul class=\"cards\">");
        for (value, what, tone) in cards {
            let _ = write!(
                out,
                "<li class=\"k-{}\"><b>{value}</b><span>{}</span></li>",
                tone.class(),
                escaped(&what)
            );
        }
        out + "</ul>"
    }

    /// A table of every estimator and length, and of each length how many errors are below how much.
    fn distributions(&self) -> String {
        if self.kinds.is_empty() {
            return lacking("Errors", "No outage could be compared with anything.");
        }
        let rows: Vec<Vec<String>> = self
            .kinds
            .iter()
            .enumerate()
            .map(|(i, (estimator, length_s))| {
                let of = self.of_kind(i);
                let errors = sorted(of.iter().map(|o| o.error_m));
                let sigmas = sorted(of.iter().filter_map(|o| o.sigmas()));
                let part = |k: f64| 100.0 * sigmas.partition_point(|s| *s <= k) as f64 / sigmas.len() as f64;
                vec![
                    estimator.clone(),
                    format!("{length_s}"),
                    of.len().to_string(),
                    number(at_part(&errors, 0.5), 1),
                    number(at_part(&errors, 0.9), 1),
                    number(errors.last().copied(), 1),
                    number(at_part(&sigmas, 0.5), 2),
                    number(Some(part(2.0)), 1),
                    number(Some(part(4.0)), 1),
                ]
            })
            .collect();
        let head = [
            "estimator",
            "length s",
            "outages",
            "median m",
            "90 % below m",
            "worst m",
            "error/sigma, median",
            "within 2 sigma %",
            "within 4 sigma %",
        ];
        let mut lengths: BTreeMap<u64, (f64, Vec<usize>)> = BTreeMap::new();
        for (i, (_, length_s)) in self.kinds.iter().enumerate() {
            lengths.entry((length_s * 1e3) as u64).or_insert((*length_s, Vec::new())).1.push(i);
        }
        let figures: String =
            lengths.values().map(|(length_s, kinds)| self.distribution(*length_s, kinds)).collect();
        format!("{}<div class=\"group\">{figures}</div>", table(&head, &rows))
    }

    fn distribution(&self, length_s: f64, kinds: &[usize]) -> String {
        let title = format!("Outages of {length_s} s");
        let lines: Vec<(usize, Vec<Point>)> = kinds
            .iter()
            .map(|&i| (i, cumulative(&sorted(self.of_kind(i).iter().map(|o| o.error_m)))))
            .collect();
        // The largest of the first estimator: a worse one may leave the picture.
        let most = lines.first().and_then(|l| l.1.last()).map_or(1.0, |p| p.0).max(1.0);
        let mut chart = Chart::new(
            &title,
            (0.0, most * 1.05),
            ["error at the end, m", "% of them"],
            RangeFit::Fixed(0.0, 100.0),
        )
        .apart()
        .explained("How many of the errors are below how much.");
        for (i, points) in lines {
            let (name, role, stroke) = shown(&self.kinds[i].0);
            chart.line(&name, role, stroke, vec![points]);
        }
        chart.render().unwrap_or_else(|| lacking(&title, "None could be compared."))
    }

    /// How many errors lie within how many of their sigmas.
    fn honesty(&self) -> String {
        let title = "Errors over what was claimed";
        let mut chart = Chart::new(title, (0.0, 5.0), ["sigmas", "% of them"], RangeFit::Fixed(0.0, 100.0)).apart().explained(
            "How many of the errors at an outage's end lie within how many of the sigmas that were claimed then. A line above the dashed one is cautious, one below it over-confident.",
        );
        let honest = (0..=100).map(|i| f64::from(i) * 0.05).map(|k| (k, 100.0 * (1.0 - (-k * k).exp())));
        chart.line("a normal distribution's", Role::Reference, Stroke::Dashed, vec![honest.collect()]);
        let mut estimators: Vec<&str> = self.kinds.iter().map(|k| k.0.as_str()).collect();
        estimators.dedup();
        estimators.sort_unstable();
        estimators.dedup();
        let mut any = false;
        for estimator in estimators {
            let of =
                self.flights.iter().flat_map(|f| &f.outages).filter(|o| self.kinds[o.kind].0 == estimator);
            let sigmas = sorted(of.filter_map(ScoredOutage::sigmas));
            let line: Vec<Point> = cumulative(&sigmas).into_iter().filter(|p| p.0 <= 5.0).collect();
            any |= !line.is_empty();
            let (name, role, stroke) = shown(estimator);
            chart.line(&name, role, stroke, if line.is_empty() { Vec::new() } else { vec![line] });
        }
        let drawn = chart.render().filter(|_| any).map(|drawn| format!("<div class=\"group\">{drawn}</div>"));
        drawn.unwrap_or_else(|| lacking(title, "Nothing was claimed that could be compared."))
    }

    /// The outages of the first estimator with the largest errors, each with where it stands and how to look at it.
    fn worst(&self) -> String {
        let mut all: Vec<(usize, &ScoredOutage)> = self
            .flights
            .iter()
            .enumerate()
            .flat_map(|(i, f)| f.outages.iter().map(move |o| (i, o)))
            .filter(|(_, o)| self.kinds[o.kind].0 == self.first())
            .collect();
        all.sort_by(|a, b| b.1.error_m.total_cmp(&a.1.error_m));
        if all.is_empty() {
            return lacking("The worst outages", "No outage could be compared with anything.");
        }
        let mut out = String::from(
            "<div class=\"scroll\"><table><thead><tr><th>flight</th><th>from..to s</th><th>error m</th><th>claimed m (1 sigma)</th><th>distance m</th><th>look at it with</th></tr></thead><tbody>",
        );
        for (i, o) in all.into_iter().take(WORST) {
            let log = &self.flights[i].log;
            let interval = format!("{:.1}..{:.1}", o.start_s, o.start_s + o.length_s);
            let _ = write!(
                out,
                "<tr><td><a href=\"#log-{i}\">{}</a></td><td class=\"n\">{interval}</td><td class=\"n\">{}</td><td class=\"n\">{}</td><td class=\"n\">{}</td><td><code>holdover report {} --outage {interval}</code></td></tr>",
                escaped(base(log)),
                short(o.error_m),
                number(o.sigma_m, 1),
                number(o.distance_m, 0),
                escaped(&quoted(log))
            );
        }
        out + "</tbody></table></div>"
    }

    fn rows(&self) -> String {
        let mut order: Vec<usize> = (0..self.flights.len()).collect();
        let worst = |i: &usize| self.flights[*i].worst().map_or(-1.0, |o| o.error_m);
        order.sort_by(|a, b| worst(b).total_cmp(&worst(a)));
        let mut out = String::from(
            "<p>The largest errors first.</p><div class=\"scroll\"><table><thead><tr><th>flight</th><th>what it is</th><th>length</th><th>outages</th><th>median m</th><th>worst m</th><th>within 2 sigma</th><th>own losses</th><th>what it lacks</th></tr></thead><tbody>",
        );
        for &i in order.iter().take(MOST_ROWS) {
            let f = &self.flights[i];
            let ours: Vec<&ScoredOutage> =
                f.outages.iter().filter(|o| self.kinds[o.kind].0 == self.first()).collect();
            let errors = sorted(ours.iter().map(|o| o.error_m));
            let sigmas: Vec<f64> = ours.iter().filter_map(|o| o.sigmas()).collect();
            let within = sigmas.iter().filter(|s| **s <= 2.0).count();
            let cells = [
                ours.len().to_string(),
                number(at_part(&errors, 0.5), 1),
                number(errors.last().copied(), 1),
                if sigmas.is_empty() { "–".to_owned() } else { format!("{within} of {}", sigmas.len()) },
                f.losses.to_string(),
            ];
            let _ = write!(
                out,
                "<tr id=\"log-{i}\"><td>{}</td><td>{}</td><td class=\"n\">{}</td>",
                escaped(&f.log),
                escaped(&f.autopilot),
                f.duration_s.map_or_else(|| "–".to_owned(), duration)
            );
            for cell in cells {
                let _ = write!(out, "<td class=\"n\">{cell}</td>");
            }
            let _ = write!(out, "<td>{}</td></tr>", escaped(&f.why));
        }
        out.push_str("</tbody></table></div>");
        if let more @ 1.. = self.flights.len().saturating_sub(MOST_ROWS) {
            let _ = write!(out, "<p>{more} more are not listed.</p>");
        }
        out
    }
}

fn shown(estimator: &str) -> (String, Role, Stroke) {
    let (role, stroke) = match estimator {
        "shipped" => (Role::Estimate, Stroke::Strong),
        "inertial" => (Role::Inertia, Stroke::Plain),
        _ => (Role::Landmarks, Stroke::Dashed),
    };
    (estimator.to_owned(), role, stroke)
}

fn sorted(values: impl Iterator<Item = f64>) -> Vec<f64> {
    let mut values: Vec<f64> = values.filter(|v| v.is_finite()).collect();
    values.sort_by(f64::total_cmp);
    values
}

/// What that part of the sorted values is below.
fn at_part(sorted: &[f64], part: f64) -> Option<f64> {
    sorted.get((part * sorted.len().saturating_sub(1) as f64).round() as usize).copied()
}

/// How many percent of the sorted values are at most how much.
fn cumulative(sorted: &[f64]) -> Vec<Point> {
    let step = sorted.len().div_ceil(MOST_POINTS).max(1);
    let points = sorted.iter().enumerate().map(|(i, v)| (*v, 100.0 * (i + 1) as f64 / sorted.len() as f64));
    let last = sorted.len().saturating_sub(1);
    let kept: Vec<Point> =
        points.enumerate().filter(|(i, _)| i % step == 0 || *i == last).map(|(_, p)| p).collect();
    if kept.is_empty() { kept } else { std::iter::once((0.0, 0.0)).chain(kept).collect() }
}

fn base(log: &str) -> &str {
    log.rsplit('/').next().unwrap_or(log)
}

/// A name as a shell takes it.
fn quoted(name: &str) -> String {
    let plain = |c: char| c.is_ascii_alphanumeric() || "/._-+:".contains(c);
    if !name.is_empty() && name.chars().all(plain) {
        name.to_owned()
    } else {
        format!("'{}'", name.replace('\'', "'\\''"))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn distributions_are_of_all_and_end_at_all() {
        let values = sorted((0..1000).map(f64::from).chain([f64::NAN]));
        let line = cumulative(&values);
        assert!(line.len() <= MOST_POINTS + 2);
        assert_eq!((line[0], line.last().copied()), ((0.0, 0.0), Some((999.0, 100.0))));
        assert!(line.is_sorted_by(|a, b| a.0 <= b.0 && a.1 <= b.1));
        assert_eq!((at_part(&values, 0.5), at_part(&[], 0.5)), (Some(500.0), None));
        assert_eq!(cumulative(&[]), []);
        assert_eq!(quoted("a b'c.tlog"), "'a b'\\''c.tlog'");
        assert_eq!((quoted("/x/a-1.ulg"), base("/x/a-1.ulg")), ("/x/a-1.ulg".to_owned(), "a-1.ulg"));
    }
}
