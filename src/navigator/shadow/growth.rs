//! What the claimed covariance of the position grows by in an outage, by what carried while it grew: each part has its own factor.

use nalgebra::Matrix3;

use super::super::solution::VelocitySource;
use super::drift::{ProvenDrift, SOURCES};

/// Traces of the horizontal position's covariance, m².
#[derive(Clone, Copy, Debug, Default)]
pub(in super::super) struct Growth {
    /// Time without GNSS, s.
    age_s: f64,
    /// Where it stood at the last step.
    now: f64,
    /// Grown while each of [`SOURCES`] carried.
    by: [f64; 3],
    /// A hole in the stream has left its own doubt, which is all that there is until something carries again.
    doubted: bool,
}

fn trace(position: &Matrix3<f64>) -> f64 {
    position[(0, 0)] + position[(1, 1)]
}

impl Growth {
    /// An outage begins with this covariance.
    pub(in super::super) fn from(position: &Matrix3<f64>) -> Self {
        Self { now: trace(position), ..Self::default() }
    }

    /// `dt` s later the covariance has become this, and `source` carried. What corrects the position takes its part of all that has grown.
    pub(in super::super) fn go_on(&mut self, dt: f64, position: &Matrix3<f64>, source: VelocitySource) {
        let now = trace(position);
        self.doubted &= source == VelocitySource::Inertial;
        let part = match source {
            _ if self.doubted => None,
            VelocitySource::Flow => Some(0),
            VelocitySource::Airspeed | VelocitySource::Drag => Some(1),
            VelocitySource::Inertial => Some(2),
            VelocitySource::Gnss | VelocitySource::Landmarks | VelocitySource::Standstill => None,
        };
        if now < self.now {
            self.by.iter_mut().for_each(|by| *by *= now / self.now);
        } else if let Some(part) = part {
            self.by[part] += now - self.now;
        }
        self.age_s += dt;
        self.now = now;
    }

    /// Something else than drift has made the covariance this, a hole in the stream or an inertia that was wrong: what that left is counted for no source.
    pub(in super::super) fn doubt(&mut self, position: &Matrix3<f64>) {
        self.now = self.now.max(trace(position));
        self.doubted = true;
    }

    /// By what the claimed covariances of the position, and of the velocity while `source` carries, are to be multiplied.
    pub(in super::super) fn factors(&self, drift: &ProvenDrift, source: VelocitySource) -> (f64, f64) {
        let square = |source| drift.factor(source, self.age_s).powi(2);
        let more: f64 = self.by.iter().zip(SOURCES).map(|(by, source)| by * (square(source) - 1.0)).sum();
        (1.0 + more / self.now.max(1e-9), if self.doubted { 1.0 } else { square(source) })
    }

    /// What it is, to be kept.
    pub(in super::super) fn memory(&self) -> [f64; 5] {
        let [flow, air, inertial] = self.by;
        [self.age_s, self.now, flow, air, inertial]
    }

    /// As it was. `None` where it cannot have been so.
    pub(in super::super) fn recalled([age_s, now, flow, air, inertial]: [f64; 5]) -> Option<Self> {
        let all = [age_s, now, flow, air, inertial];
        let possible = all.iter().all(|v| (0.0..1e15).contains(v)) && flow + air + inertial <= now * 1.001;
        // What is gone on from begins with a hole.
        possible.then_some(Self { age_s, now, by: [flow, air, inertial], doubted: true })
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn what_was_known_at_the_start_is_not_multiplied_and_each_part_has_its_own_factor() {
        let drift = ProvenDrift::new();
        let at = |trace: f64| Matrix3::from_diagonal_element(0.5 * trace);
        let mut growth = Growth::from(&at(4.0));
        assert_eq!(growth.factors(&drift, VelocitySource::Standstill), (1.0, 1.0));
        growth.go_on(1.0, &at(10.0), VelocitySource::Flow);
        growth.go_on(1.0, &at(11.0), VelocitySource::Standstill);
        growth.go_on(1.0, &at(20.0), VelocitySource::Inertial);
        let [flow, inertial] =
            [VelocitySource::Flow, VelocitySource::Inertial].map(|s| drift.factor(s, 10.0).powi(2));
        let claimed = 5.0 + 6.0 * flow + 9.0 * inertial;
        let (position, velocity) = growth.factors(&drift, VelocitySource::Flow);
        assert!((position * 20.0 - claimed).abs() < 1e-9);
        assert!((velocity - flow).abs() < 1e-12);
        let kept = Growth::recalled(growth.memory()).unwrap();
        assert_eq!(kept.factors(&drift, VelocitySource::Flow), (position, 1.0), "a restart is a hole");
        let mut kept = kept;
        kept.go_on(1.0, &at(90.0), VelocitySource::Inertial);
        let (position, _) = kept.factors(&drift, VelocitySource::Inertial);
        assert!((position * 90.0 - (claimed + 70.0)).abs() < 1e-9, "what a hole leaves is no drift");
        kept.go_on(1.0, &at(91.0), VelocitySource::Flow);
        assert!((kept.factors(&drift, VelocitySource::Flow).1 - flow).abs() < 0.1, "it carries again");
        // A landmark halves it: half of each part is left.
        growth.go_on(1.0, &at(10.0), VelocitySource::Landmarks);
        let (position, _) = growth.factors(&drift, VelocitySource::Landmarks);
        assert!((position * 10.0 - 0.5 * claimed).abs() < 1e-9);
        assert!(Growth::recalled([1.0, 1.0, 5.0, 0.0, 0.0]).is_none());
        assert!(Growth::recalled([1.0, f64::NAN, 0.0, 0.0, 0.0]).is_none());
    }
}
