//! Quantities over time in memory that does not grow with the flight, which keep their extremes.

/// A time, s, and a value.
pub(super) type Point = (f64, f64);

/// An interval of a trace.
#[derive(Clone, Copy, Debug)]
struct Interval {
    number: u64,
    /// First and last time, s.
    from_s: f64,
    to_s: f64,
    least: Point,
    most: Point,
}

impl Interval {
    fn new(number: u64, point: Point) -> Self {
        Self { number, from_s: point.0, to_s: point.0, least: point, most: point }
    }

    fn join(&mut self, later: &Self) {
        self.to_s = later.to_s;
        if later.least.1 < self.least.1 {
            self.least = later.least;
        }
        if later.most.1 > self.most.1 {
            self.most = later.most;
        }
    }
}

/// One quantity over time. It holds the least and the greatest value of each of many intervals, with their times; when there are too many, two
/// become one. Values that are not finite are left out.
#[derive(Clone, Debug)]
pub(super) struct Trace {
    /// More than this between two samples is a hole, s: no line is drawn over it.
    hole_s: f64,
    interval_s: f64,
    start_s: Option<f64>,
    ends: Option<(Point, Point)>,
    intervals: Vec<Interval>,
}

/// The shortest interval, s.
const SHORTEST_S: f64 = 0.02;
/// Intervals of a trace: two of them are about a pixel.
const MOST_INTERVALS: usize = 1000;

impl Trace {
    /// Nothing yet; samples further apart than `hole_s` are not joined by a line.
    pub(super) fn new(hole_s: f64) -> Self {
        Self { hole_s, interval_s: SHORTEST_S, start_s: None, ends: None, intervals: Vec::new() }
    }

    /// Adds a value. What comes out of order counts as of the newest time.
    pub(super) fn add(&mut self, t_s: f64, value: f64) {
        if !(t_s.is_finite() && value.is_finite()) {
            return;
        }
        let start = *self.start_s.get_or_insert(t_s);
        let t_s = self.intervals.last().map_or(t_s, |last| t_s.max(last.to_s));
        let point = (t_s, value);
        self.ends = Some((self.ends.map_or(point, |ends| ends.0), point));
        let new = Interval::new(((t_s - start) / self.interval_s) as u64, point);
        match self.intervals.last_mut().filter(|last| last.number == new.number) {
            Some(last) => last.join(&new),
            None => self.intervals.push(new),
        }
        while self.intervals.len() > MOST_INTERVALS {
            self.coarsen();
        }
    }

    fn coarsen(&mut self) {
        self.interval_s *= 2.0;
        self.intervals.iter_mut().for_each(|i| i.number /= 2);
        self.intervals.dedup_by(|later, first| {
            let same = later.number == first.number;
            if same {
                first.join(later);
            }
            same
        });
    }

    /// Whether nothing was added.
    pub(super) fn is_empty(&self) -> bool {
        self.intervals.is_empty()
    }

    /// The newest value.
    pub(super) fn last(&self) -> Option<Point> {
        self.ends.map(|ends| ends.1)
    }

    /// What is drawn: stretches without a hole, the extremes of each interval in the order of time.
    pub(super) fn stretches(&self) -> Vec<Vec<Point>> {
        self.stretches_between(f64::NEG_INFINITY, f64::INFINITY)
    }

    /// The same of the time from `from_s` to `to_s`.
    pub(super) fn stretches_between(&self, from_s: f64, to_s: f64) -> Vec<Vec<Point>> {
        let mut out: Vec<Vec<Point>> = Vec::new();
        let mut before: Option<f64> = None;
        for interval in &self.intervals {
            if before.is_none_or(|b| interval.from_s - b > self.hole_s) {
                out.push(Vec::new());
            }
            before = Some(interval.to_s);
            let (mut a, mut b) = (interval.least, interval.most);
            if b.0 < a.0 {
                (a, b) = (b, a);
            }
            let (first, last) = self.ends.unwrap_or((a, b));
            let points = [(first.0 == interval.from_s).then_some(first), Some(a), Some(b)];
            let points = points.into_iter().chain([(last.0 == interval.to_s).then_some(last)]).flatten();
            if let Some(stretch) = out.last_mut() {
                for point in points.filter(|p| from_s <= p.0 && p.0 <= to_s) {
                    if stretch.last() != Some(&point) {
                        stretch.push(point);
                    }
                }
            }
        }
        out.retain(|stretch| !stretch.is_empty());
        out
    }

    /// All points of it, without regard to holes.
    pub(super) fn points(&self) -> Vec<Point> {
        self.stretches().concat()
    }
}

/// A place on the way: time, s, and north and east, m.
pub(super) type Place = (f64, [f64; 2]);

/// A way over the ground in bounded memory: what is left out lies within a distance that grows with the way.
#[derive(Clone, Debug)]
pub(super) struct Track {
    hole_s: f64,
    step_m: f64,
    places: Vec<Place>,
    /// The newest, kept or not.
    last: Option<Place>,
    /// Places before which there is a hole.
    holes: Vec<f64>,
}

/// Places further than this from the last one are kept, m, while there are few.
const FIRST_STEP_M: f64 = 0.05;
/// Places of a track.
const MOST_PLACES: usize = 3000;

impl Track {
    /// Nothing yet; as of [`Trace::new`].
    pub(super) fn new(hole_s: f64) -> Self {
        Self { hole_s, step_m: FIRST_STEP_M, places: Vec::new(), last: None, holes: Vec::new() }
    }

    /// Adds a place.
    pub(super) fn add(&mut self, t_s: f64, ne_m: [f64; 2]) {
        if !ne_m.iter().all(|v| v.is_finite()) {
            return;
        }
        let hole = self.last.is_some_and(|last| t_s - last.0 > self.hole_s);
        let before = self.last.replace((t_s, ne_m));
        let far = self.places.last().is_none_or(|(_, kept)| distance_m(kept, &ne_m) > self.step_m);
        if hole {
            // Where it ended and where it goes on.
            self.places.extend(before.filter(|b| self.places.last() != Some(b)));
            self.holes.push(t_s);
        }
        if hole || far {
            self.places.push((t_s, ne_m));
        }
        while self.places.len() > MOST_PLACES {
            self.thin();
        }
    }

    fn thin(&mut self) {
        self.step_m *= 2.0;
        let (step_m, holes) = (self.step_m, &self.holes);
        let mut kept: Option<[f64; 2]> = None;
        let before = self.places.len();
        self.places.retain(|(t, place)| {
            let keep = kept.is_none_or(|k| distance_m(&k, place) > step_m)
                || holes.binary_search_by(|h| h.total_cmp(t)).is_ok();
            if keep {
                kept = Some(*place);
            }
            keep
        });
        if self.places.len() == before && before > MOST_PLACES {
            // Holes alone are too many: they are drawn over.
            self.holes.clear();
        }
    }

    /// Whether nothing was added.
    pub(super) fn is_empty(&self) -> bool {
        self.places.is_empty()
    }

    /// Stretches without a hole.
    pub(super) fn stretches(&self) -> Vec<Vec<Place>> {
        let mut out: Vec<Vec<Place>> = vec![Vec::new()];
        for place in self.places.iter().chain(&self.last) {
            if self.holes.binary_search_by(|h| h.total_cmp(&place.0)).is_ok() {
                out.push(Vec::new());
            }
            if let Some(stretch) = out.last_mut().filter(|s| s.last() != Some(place)) {
                stretch.push(*place);
            }
        }
        out.retain(|stretch| !stretch.is_empty());
        out
    }
}

fn distance_m(a: &[f64; 2], b: &[f64; 2]) -> f64 {
    (a[0] - b[0]).hypot(a[1] - b[1])
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn ten_hours_keep_their_extremes_in_bounded_memory() {
        let mut trace = Trace::new(1.0);
        for i in 0..720_000 {
            let value = match i {
                123_456 => 1e4,
                654_321 => -1e4,
                _ => f64::from(i % 100),
            };
            trace.add(f64::from(i) * 0.05, value);
        }
        let points = trace.points();
        assert!(
            points.len() <= 2 * MOST_INTERVALS + 2 && points.len() > MOST_INTERVALS / 2,
            "{}",
            points.len()
        );
        assert!(points.contains(&(6172.8, 1e4)) && points.contains(&(f64::from(654_321) * 0.05, -1e4)));
        assert_eq!((points[0], trace.last()), ((0.0, 0.0), points.last().copied()));
        assert!(points.is_sorted_by(|a, b| a.0 <= b.0));
        assert_eq!(trace.stretches().len(), 1);
    }

    #[test]
    fn a_hole_is_not_drawn_over_and_nonsense_is_left_out() {
        let mut trace = Trace::new(1.0);
        for t in [0.0, 0.5, 1.0, 5.0, 5.5] {
            trace.add(t, t);
        }
        trace.add(5.6, f64::NAN);
        trace.add(f64::INFINITY, 1.0);
        // Out of order: of the newest time.
        trace.add(2.0, 7.0);
        let stretches = trace.stretches();
        assert_eq!(
            stretches,
            [vec![(0.0, 0.0), (0.5, 0.5), (1.0, 1.0)], vec![(5.0, 5.0), (5.5, 5.5), (5.5, 7.0)]]
        );
        assert_eq!(trace.stretches_between(0.4, 1.0), [[(0.5, 0.5), (1.0, 1.0)]]);
    }

    #[test]
    fn a_long_way_is_within_its_step_and_ends_where_it_ended() {
        let mut track = Track::new(2.0);
        for i in 0..200_000 {
            let t = f64::from(i) * 0.1;
            let gap = if i < 100_000 { 0.0 } else { 60.0 };
            track.add(t + gap, [t, (0.001 * t).sin()]);
        }
        let stretches = track.stretches();
        assert_eq!(stretches.len(), 2);
        assert!(track.places.len() <= MOST_PLACES && track.places.len() > MOST_PLACES / 3);
        let last = stretches[1].last().unwrap();
        assert!((last.1[0] - 19_999.9).abs() < 1e-6);
        assert!(
            stretches.iter().all(|s| s.windows(2).all(|w| distance_m(&w[0].1, &w[1].1) < 2.5 * track.step_m))
        );
    }
}
