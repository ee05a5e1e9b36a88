//! Whether what has been seen of the landmarks can tell a pose at all.

use super::tuning::{MAJORITY, MEMORY_S, SUSPECT, THIN};
use nalgebra::{Matrix3, Vector3};

/// What the landmarks that were used say of the pose.
#[derive(Clone, Copy, Debug, PartialEq)]
#[non_exhaustive]
pub enum Observability {
    /// Three landmarks or more that are not on a line.
    Observable,
    /// As many different landmarks have been used ever: fewer than three.
    TooFew(u32),
    /// All that were used of late are on a line: the turn about it is not seen.
    OnALine,
    /// Landmarks contradict each other, and those that agree are too few to tell which of them are wrong.
    Contradicted {
        /// Landmarks most of whose sightings are rejected.
        suspect: u32,
        /// The others that were used.
        trusted: u32,
    },
}

/// Which landmarks were used, and how those of late are spread.
#[derive(Clone, Debug, PartialEq)]
pub(super) struct Geometry {
    ever: [u64; 4],
    /// Smoothed part of each landmark's sightings that were rejected, of 255.
    rejected: [u8; 256],
    weight: f64,
    mean: Vector3<f64>,
    /// Σ w (Q − mean)(Q − mean)ᵀ / Σ w
    spread: Matrix3<f64>,
}

impl Geometry {
    pub(super) fn new() -> Self {
        Self {
            ever: [0; 4],
            rejected: [0; 256],
            weight: 0.0,
            mean: Vector3::zeros(),
            spread: Matrix3::zeros(),
        }
    }

    pub(super) fn forget(&mut self, dt_s: f64) {
        self.weight *= (-dt_s / MEMORY_S).exp();
    }

    /// A landmark was seen, and used or not.
    pub(super) fn judged(&mut self, id: u8, used: bool) {
        if let Some(part) = self.rejected.get_mut(usize::from(id)) {
            // Rounded away from where it stands, so that it arrives.
            *part = if used { *part - part.div_ceil(8) } else { *part + (255 - *part).div_ceil(8) };
        }
    }

    /// Landmarks that are mostly rejected.
    pub(super) fn suspects(&self) -> impl Iterator<Item = u8> + '_ {
        (0..=u8::MAX).filter(|id| self.rejected.get(usize::from(*id)).is_some_and(|part| *part > SUSPECT))
    }

    /// Landmarks that are mostly rejected, and those that were used and are not.
    fn suspect_and_trusted(&self) -> (u32, u32) {
        let (mut suspect, mut trusted) = (0, 0);
        for (i, part) in self.rejected.iter().enumerate() {
            let was_used = self.ever.get(i / 64).is_some_and(|w| w >> (i % 64) & 1 == 1);
            suspect += u32::from(*part > SUSPECT);
            trusted += u32::from(*part <= SUSPECT && was_used);
        }
        (suspect, trusted)
    }

    /// A landmark was used.
    pub(super) fn used(&mut self, id: u8, landmark: &Vector3<f64>) {
        if let Some(word) = self.ever.get_mut(usize::from(id / 64)) {
            *word |= 1 << (id % 64);
        }
        // A window that never becomes shorter than one sighting.
        let total = self.weight + 1.0;
        let (part, from_mean) = (1.0 / total, landmark - self.mean);
        self.spread = (self.spread + from_mean * from_mean.transpose() * part) * (1.0 - part);
        self.mean += from_mean * part;
        self.weight = total;
    }

    pub(super) fn observability(&self) -> Observability {
        let count = self.ever.iter().map(|w| w.count_ones()).sum();
        if count < 3 {
            return Observability::TooFew(count);
        }
        let (suspect, trusted) = self.suspect_and_trusted();
        if suspect > 0 && trusted < MAJORITY * suspect + 2 {
            return Observability::Contradicted { suspect, trusted };
        }
        let mut sizes: [f64; 3] = self.spread.symmetric_eigenvalues().into();
        sizes.sort_by(|a, b| b.total_cmp(a));
        if sizes[1] < THIN * THIN * sizes[0] || sizes[0] <= 0.0 {
            Observability::OnALine
        } else {
            Observability::Observable
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn seen(points: &[(u8, Vector3<f64>)]) -> Observability {
        let mut g = Geometry::new();
        for _ in 0..20 {
            points.iter().for_each(|(id, q)| g.used(*id, q));
            g.forget(0.1);
        }
        g.observability()
    }

    #[test]
    fn lines_and_pairs_are_told() {
        let on_line = |i: u8| (i, Vector3::new(40.0, 7.0, 1.0) + f64::from(i) * Vector3::new(1.0, -2.0, 0.3));
        let pair = [on_line(0), on_line(200)];
        assert_eq!(seen(&pair), Observability::TooFew(2));
        assert_eq!(seen(&[]), Observability::TooFew(0));
        let line: Vec<_> = (0..6).map(on_line).collect();
        assert_eq!(seen(&line), Observability::OnALine);
        let mut field = line;
        field.push((9, Vector3::new(35.0, 0.0, 0.0)));
        assert_eq!(seen(&field), Observability::Observable);
    }

    #[test]
    fn a_landmark_that_contradicts_needs_a_majority_against_it() {
        let at = |i: u8| Vector3::new(f64::from(i), f64::from(i * i % 5), 0.0);
        for (count, tells) in [(3, false), (4, false), (5, true), (8, true)] {
            let mut g = Geometry::new();
            for _ in 0..10 {
                (0..count).for_each(|id| g.judged(id, id != 0));
                (1..count).for_each(|id| g.used(id, &at(id)));
            }
            g.used(0, &at(0));
            let contradicted = matches!(g.observability(), Observability::Contradicted { suspect: 1, .. });
            assert_eq!(contradicted, !tells, "{count}: {:?}", g.observability());
            (0..30).for_each(|_| g.judged(0, true));
            assert_eq!(g.observability(), Observability::Observable);
        }
    }

    #[test]
    fn the_spread_is_that_of_the_points() {
        let mut g = Geometry::new();
        let points =
            [Vector3::new(1.0, 2.0, 3.0), Vector3::new(-4.0, 0.5, 2.0), Vector3::new(6.0, -1.0, 0.0)];
        points.iter().for_each(|q| g.used(0, q));
        let mean = points.iter().sum::<Vector3<f64>>() / 3.0;
        let spread: Matrix3<f64> = points.iter().map(|q| (q - mean) * (q - mean).transpose() / 3.0).sum();
        assert!((g.spread - spread).norm() < 1e-12);
    }
}
