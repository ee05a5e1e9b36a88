//! Seen from above: the estimate, the reference, GNSS and the autopilot's own estimate.

use super::super::chart::{Chart, Stroke};
use super::super::flight::FlightSheet;
use super::super::html::lacking;
use super::super::palette::Role;
use super::super::recorder::{PlanRecord, UnsurePlace};
use super::super::scale::RangeFit;
use super::super::trace::{Place, Point, Track};

/// A picture is at least so wide, m.
const LEAST_WIDTH_M: f64 = 10.0;
/// Room around the ways, as a part of their extent.
const ROOM: f64 = 0.06;
/// Width over height of a picture.
const ASPECTS: (f64, f64) = (1.35, 2.6);
/// An estimate that goes further than this many times the extent of what it is compared with does not fit the picture.
const FAR: f64 = 4.0;
/// Ends of outages that get their ellipse.
const MOST_ELLIPSES: usize = 12;
/// Points of an ellipse.
const CORNERS: usize = 48;

/// East to the right, north up.
fn seen(stretches: &[Vec<Place>]) -> Vec<Vec<Point>> {
    stretches.iter().map(|s| s.iter().map(|(_, [north, east])| (*east, *north)).collect()).collect()
}

/// Least and greatest east and north.
#[derive(Clone, Copy, Debug)]
struct Extent {
    east: (f64, f64),
    north: (f64, f64),
}

impl Extent {
    fn of(tracks: &[&Track]) -> Option<Self> {
        let mut places = tracks.iter().flat_map(|t| t.stretches()).flatten().map(|(_, place)| place);
        let [n, e] = places.next()?;
        let start = Self { east: (e, e), north: (n, n) };
        Some(places.fold(start, |x, [n, e]| Self {
            east: (x.east.0.min(e), x.east.1.max(e)),
            north: (x.north.0.min(n), x.north.1.max(n)),
        }))
    }

    fn size(&self) -> f64 {
        (self.east.1 - self.east.0).max(self.north.1 - self.north.0)
    }

    /// A picture's sides: the same metres in both directions, and its width over its height.
    fn picture(&self) -> (Self, f64) {
        let room = 1.0 + 2.0 * ROOM;
        let wide = ((self.east.1 - self.east.0) * room).max(LEAST_WIDTH_M);
        let high = ((self.north.1 - self.north.0) * room).max(LEAST_WIDTH_M);
        let aspect = (wide / high).clamp(ASPECTS.0, ASPECTS.1);
        let (wide, high) = (wide.max(high * aspect), high.max(wide / aspect));
        let around = |(a, b): (f64, f64), size: f64| (0.5 * (a + b - size), 0.5 * (a + b + size));
        (Self { east: around(self.east, wide), north: around(self.north, high) }, aspect)
    }
}

/// What the picture shows, and whether the estimate leaves it.
fn extent(plan: &PlanRecord) -> Option<(Extent, bool)> {
    let compared = Extent::of(&[&plan.gnss, &plan.truth]);
    let all = Extent::of(&[&plan.gnss, &plan.truth, &plan.estimate])?;
    match compared {
        Some(compared) if all.size() > FAR * compared.size().max(50.0) => {
            let more = compared.size().max(50.0);
            let wider = |(a, b): (f64, f64)| (a - 0.5 * more, b + 0.5 * more);
            Some((Extent { east: wider(compared.east), north: wider(compared.north) }, true))
        }
        _ => Some((all, false)),
    }
}

/// The line at `k` sigmas of the position.
fn ellipse(place: &UnsurePlace, k: f64) -> Vec<Point> {
    let [nn, ee, ne] = place.covariance;
    let a = nn.max(1e-9).sqrt();
    let b = ne / a;
    let c = (ee - b * b).max(0.0).sqrt();
    (0..=CORNERS)
        .map(|i| {
            let (sin, cos) = (std::f64::consts::TAU * i as f64 / CORNERS as f64).sin_cos();
            let [n, e] = place.ne_m;
            (e + k * (b * cos + c * sin), n + k * a * cos)
        })
        .collect()
}

/// The picture.
pub(in super::super) fn view(sheet: &FlightSheet) -> String {
    let plan = &sheet.recorder.plan;
    let Some((extent, leaves)) = extent(plan) else {
        return lacking("From above", "No position came about: neither a fix nor an estimate.");
    };
    let (sides, aspect) = extent.picture();
    let mut explained = String::from("North is up, distances in m from the origin of the local frame.");
    if plan.gnss.is_empty() {
        explained.push_str(" The log holds no fix of GNSS: the place is relative to where it began.");
    }
    if leaves {
        explained.push_str(" The estimate goes far beyond this picture.");
    }
    let fit = RangeFit::Fixed(sides.north.0, sides.north.1);
    let mut chart =
        Chart::new("From above", sides.east, ["east m", "north m"], fit).plan(aspect).explained(explained);
    chart.line("autopilot's own estimate", Role::Autopilot, Stroke::Faint, seen(&plan.autopilot.stretches()));
    chart.line("GNSS", Role::Gnss, Stroke::Plain, seen(&plan.gnss.stretches()));
    chart.line("truth", Role::Reference, Stroke::Dashed, seen(&plan.truth.stretches()));
    let estimate = plan.estimate.stretches();
    chart.line("estimate", Role::Estimate, Stroke::Plain, seen(&estimate));
    let without = sheet.without_gnss();
    for loss in &without {
        let part = estimate.iter().map(|s| {
            s.iter().filter(|(t, _)| loss.from_s <= *t && *t <= loss.back_s).copied().collect::<Vec<Place>>()
        });
        let part: Vec<Vec<Place>> = part.filter(|s| s.len() > 1).collect();
        chart.line("estimate without GNSS", Role::Estimate, Stroke::Strong, seen(&part));
    }
    for (i, place) in plan.unsure.iter().take(MOST_ELLIPSES).enumerate() {
        let [north, east] = place.ne_m;
        chart.line("2 sigma at its end", Role::Estimate, Stroke::Dashed, vec![ellipse(place, 2.0)]);
        chart.label(east, north, format!("{}", i + 1));
    }
    if let Some((_, [north, east])) = estimate.first().and_then(|s| s.first()) {
        chart.dots("begin", Role::Estimate, vec![(*east, *north)]);
        chart.label(*east, *north, "begin".to_owned());
    }
    chart.render().unwrap_or_else(|| lacking("From above", "No position came about."))
}
