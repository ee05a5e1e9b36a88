//! Markers along a route, and what a camera tells of them as the flight goes on.

use std::collections::VecDeque;

use super::landmarks::{MarkerCamera, MarkerField, SeenLandmark, picture};
use super::noise::{SensorRng, Stream};
use super::trajectory::{Trajectory, Truth};

/// A marker may stand this far from its place in the grid, of the spacing: a regular grid looks the same from everywhere.
const SCATTER: f64 = 0.3;
/// Markers stand up to this high over the ground, m.
const HIGHEST_M: f64 = 1.0;
/// The field reaches this far beyond the route, m.
const MARGIN_M: f64 = 12.0;
/// The route is looked at this often, s.
const LOOK_S: f64 = 0.5;

impl MarkerField {
    /// About one marker every `spacing_m` in both directions over the rectangle that the route fills, on ground at `ground_down_m`. `None`
    /// when there would be more of them than there are ids.
    pub fn along(
        route: &(impl Trajectory + ?Sized),
        duration_s: f64,
        ground_down_m: f64,
        spacing_m: f64,
        seed: u64,
    ) -> Option<Self> {
        let mut rng = SensorRng::new(seed, Stream::LandmarkStart);
        let (mut low, mut high) = (route.at(0.0).position_ned, route.at(0.0).position_ned);
        for k in 0..=(duration_s / LOOK_S) as u64 {
            let p = route.at(k as f64 * LOOK_S).position_ned;
            (low, high) = (low.inf(&p), high.sup(&p));
        }
        let count = |axis: usize| ((high[axis] - low[axis] + 2.0 * MARGIN_M) / spacing_m).ceil().max(1.0);
        let (rows, columns) = (count(0), count(1));
        if rows * columns > 256.0 {
            return None;
        }
        let mut markers = Vec::with_capacity(256);
        for row in 0..rows as u32 {
            for column in 0..columns as u32 {
                let mut place = |low: f64, n: u32| {
                    low - MARGIN_M + spacing_m * (f64::from(n) + 0.5 + rng.between(-SCATTER, SCATTER))
                };
                let (north, east) = (place(low.x, row), place(low.y, column));
                let down = ground_down_m - rng.between(0.0, HIGHEST_M);
                let id = u8::try_from(markers.len()).ok()?;
                markers.push((id, nalgebra::Vector3::new(north, east, down)));
            }
        }
        Some(Self { markers })
    }
}

/// A camera over a field, step by step: sightings come when they are heard of.
#[derive(Clone, Debug)]
pub struct MarkerWatch {
    field: MarkerField,
    camera: MarkerCamera,
    rng: SensorRng,
    steps: usize,
    on_the_way: VecDeque<SeenLandmark>,
}

impl MarkerWatch {
    /// A camera with a seed of its own stream.
    pub fn new(field: MarkerField, camera: MarkerCamera, seed: u64) -> Self {
        Self {
            field,
            camera,
            rng: SensorRng::new(seed, Stream::Landmarks),
            steps: 0,
            on_the_way: VecDeque::new(),
        }
    }

    /// The next step of the flight, which ends at `truth`: what is heard of by then, in that order.
    pub fn step(&mut self, truth: &Truth) -> impl Iterator<Item = SeenLandmark> + '_ {
        self.steps += 1;
        if self.steps.is_multiple_of(self.camera.every.max(1)) {
            let mut seen = Vec::new();
            picture(truth, &self.field, &self.camera, &mut self.rng, &mut seen);
            self.on_the_way.extend(seen);
        }
        let now_s = truth.t_s;
        std::iter::from_fn(move || {
            let at = self.on_the_way.iter().position(|s| s.heard_s <= now_s + 1e-9)?;
            self.on_the_way.remove(at)
        })
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::sim::Scenario;

    #[test]
    fn the_field_covers_the_route_and_ids_are_not_exceeded() {
        let route = Scenario::patrol();
        let field = MarkerField::along(&route, 300.0, 0.15, 8.0, 1).unwrap();
        let ids: std::collections::BTreeSet<u8> = field.markers.iter().map(|m| m.0).collect();
        assert_eq!(ids.len(), field.markers.len());
        for k in 0..300 {
            let p = route.at(f64::from(k)).position_ned;
            let near = field.markers.iter().filter(|(_, q)| (q - p).xy().norm() < 16.0).count();
            assert!(near >= 4, "{near} markers near {p}");
        }
        assert!(field.markers.iter().all(|(_, q)| (-0.85..=0.15).contains(&q.z)));
        assert_eq!(MarkerField::along(&route, 300.0, 0.15, 2.0, 1), None);
    }

    #[test]
    fn sightings_come_late_and_all_of_them() {
        let route = Scenario::patrol();
        let field = MarkerField::along(&route, 60.0, 0.15, 8.0, 1).unwrap();
        let prompt = MarkerCamera { every: 10, ..MarkerCamera::downward() };
        let late = MarkerCamera { delay_s: 0.05, jitter_s: 0.1, ..prompt };
        let watch = |camera| {
            let mut watch = MarkerWatch::new(field.clone(), camera, 3);
            let step = |k: i32| route.at(40.0 + 0.01 * f64::from(k));
            (1..=500)
                .map(|k| {
                    watch.step(&step(k)).map(|s| (s.taken_s, s.heard_s, step(k).t_s)).collect::<Vec<_>>()
                })
                .collect::<Vec<_>>()
                .concat()
        };
        let (now, then) = (watch(prompt), watch(late));
        assert!(now.len() > 500 && now.iter().all(|(taken, _, t)| taken == t));
        assert!(then.len() <= now.len() && then.len() > now.len() - 100);
        assert!(then.iter().all(|(taken, heard, t)| t - taken >= 0.05 - 1e-9 && t - heard < 0.0101));
    }
}
