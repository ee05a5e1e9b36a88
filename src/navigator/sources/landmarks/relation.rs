//! How the landmarks' own frame lies in NED: a heading and a translation, found while GNSS is trusted and kept when it is not.
//!
//! Both frames have z down. The heading is the mean difference of the two attitudes; the translation is that of the mean positions, so
//! that an error of the heading turns the field about where it was learned and not about a far origin.

use nalgebra::{Matrix3, Vector2, Vector3};

use crate::geo::so3;
use crate::navigator::tuning::landmark_relation::{LEARNED_S, MEMORY_S};

/// See the module's documentation.
#[derive(Clone, Debug, Default)]
pub(super) struct Relation {
    learned_s: f64,
    /// Mean cosine and sine of the heading.
    heading: Vector2<f64>,
    heading_variance: f64,
    ned: Vector3<f64>,
    local: Vector3<f64>,
}

/// A relation that is known.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct Known {
    /// Heading of the landmarks' x axis, rad.
    pub(super) heading: f64,
    pub(super) heading_sigma: f64,
    ned: Vector3<f64>,
    local: Vector3<f64>,
}

/// Rotation about the vertical.
fn about_down(heading: f64) -> Matrix3<f64> {
    so3::exp(&Vector3::new(0.0, 0.0, heading))
}

impl Relation {
    /// One pose in both frames, of `dt_s`; the variance of the heading in NED, rad².
    pub(super) fn learn(
        &mut self,
        dt_s: f64,
        ned: (&Vector3<f64>, &Matrix3<f64>),
        local: (&Vector3<f64>, &Matrix3<f64>),
        heading_variance: f64,
    ) {
        let turn = ned.1 * local.1.transpose();
        let Some(heading) = turn.column(0).xy().try_normalize(1e-3) else { return };
        self.learned_s = self.learned_s * (-dt_s / MEMORY_S).exp() + dt_s;
        let part = dt_s / self.learned_s;
        self.heading += (heading - self.heading) * part;
        self.heading_variance += (heading_variance - self.heading_variance) * part;
        self.ned += (ned.0 - self.ned) * part;
        self.local += (local.0 - self.local) * part;
    }

    /// NED's origin has moved.
    pub(super) fn origin_moved(&mut self, moved: &Vector3<f64>) {
        self.ned -= moved;
    }

    /// What was learned, once that was for long enough.
    pub(super) fn known(&self) -> Option<Known> {
        (self.learned_s >= LEARNED_S && self.heading.norm() > 0.5).then(|| Known {
            heading: self.heading.y.atan2(self.heading.x),
            heading_sigma: self.heading_variance.max(0.0).sqrt(),
            ned: self.ned,
            local: self.local,
        })
    }
}

impl Known {
    /// A pose of the landmarks' frame in NED.
    pub(super) fn to_ned(self, p: &Vector3<f64>, r: &Matrix3<f64>) -> (Vector3<f64>, Matrix3<f64>) {
        let turn = about_down(self.heading);
        (self.ned + turn * (p - self.local), turn * r)
    }

    /// The other way.
    pub(super) fn to_local(self, p: &Vector3<f64>, r: &Matrix3<f64>) -> (Vector3<f64>, Matrix3<f64>) {
        let back = about_down(-self.heading);
        (self.local + back * (p - self.ned), back * r)
    }

    /// From the landmarks' axes to NED's.
    pub(super) fn axes(&self) -> Matrix3<f64> {
        about_down(self.heading)
    }

    /// What the doubt about the heading does to a position: horizontal distance from where it was learned times its sigma, m.
    pub(super) fn sigma_m(&self, ned: &Vector3<f64>) -> f64 {
        (ned - self.ned).xy().norm() * self.heading_sigma
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_field_is_found_where_it_lies_and_poses_go_both_ways() {
        let truth = (Vector3::new(100.0, -40.0, 3.0), about_down(2.5));
        let mut relation = Relation::default();
        let pose = |k: usize| {
            let t = 0.2 * k as f64;
            (Vector3::new(20.0 * t.sin(), 10.0 * t.cos(), -20.0), so3::exp(&Vector3::new(0.05, -0.1, t)))
        };
        for k in 0..111 {
            assert!(k < 110 || relation.known().is_some());
            let (p, r) = pose(k);
            let (ned, attitude) = (truth.0 + truth.1 * p, truth.1 * r);
            relation.learn(0.2, (&ned, &attitude), (&p, &r), 1e-4);
        }
        let known = relation.known().unwrap();
        assert!((known.heading - 2.5).abs() < 1e-9 && (known.heading_sigma - 0.01).abs() < 1e-9);
        let (p, r) = pose(777);
        let (ned, attitude) = known.to_ned(&p, &r);
        assert!((ned - truth.0 - truth.1 * p).norm() < 1e-9 && (attitude - truth.1 * r).norm() < 1e-9);
        let (back, r_back) = known.to_local(&ned, &attitude);
        assert!((back - p).norm() < 1e-9 && (r_back - r).norm() < 1e-9);
    }
}
