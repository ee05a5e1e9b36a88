//! A pitot tube that contradicts GNSS and the wind of before may be right: the wind may be another.
//!
//! A tube that is wrong by a scale is so on every heading, a wind by its part along the heading. What the tube deviates by,
//! e = −Δw·û + Δk V (û the direction and V the speed through the air, Δw the change of the wind, Δk that of the scale), is solved for Δw
//! and Δk by least squares while GNSS tells the velocity: a flight on one heading tells neither, a turn tells both.

use nalgebra::{Matrix3, Vector2, Vector3};

use crate::navigator::tuning::airspeed::{SCALE_SIGMAS, WIND_KNOWN_MPS};

/// A deviation.
pub(super) struct Deviation {
    /// m/s, and its noise.
    pub(super) off: f64,
    pub(super) sigma: f64,
    /// Velocity through the air, north and east, and speed, m/s.
    pub(super) air_ne: Vector2<f64>,
    pub(super) speed: f64,
}

/// What is known before, 1 sigma: the wind, m/s, and the scale of a sound tube, and what the filter has the scale at.
pub(super) struct RefitPrior {
    pub(super) wind: f64,
    pub(super) scale: f64,
    pub(super) scale_now: f64,
}

/// The normal equations of [Δw_north, Δw_east, Δk].
#[derive(Clone, Copy, Debug, Default)]
pub(super) struct WindRefit {
    information: Matrix3<f64>,
    right: Vector3<f64>,
    squares: f64,
    n: f64,
}

impl WindRefit {
    /// The change of the wind, m/s, and its standard deviation, where another wind explains everything.
    pub(super) fn add(&mut self, d: &Deviation, prior: &RefitPrior) -> Option<(Vector2<f64>, f64)> {
        let weight = 1.0 / d.sigma.powi(2);
        let row = Vector3::new(-d.air_ne.x / d.speed, -d.air_ne.y / d.speed, d.speed);
        self.information += row * row.transpose() * weight;
        self.right += row * (d.off * weight);
        self.squares += d.off * d.off * weight;
        self.n += 1.0;
        // Whether the tube is sound is the question: its scale may be anything until a turn has shown it.
        let known = Vector3::new(prior.wind, prior.wind, 1.0).map(|s| 1.0 / s.powi(2));
        let covariance = (self.information + Matrix3::from_diagonal(&known)).try_inverse()?;
        let found = covariance * self.right;
        let sigma = covariance[(0, 0)].max(covariance[(1, 1)]).sqrt();
        let explained = self.squares - self.right.dot(&found) < self.n;
        let scaled = covariance[(2, 2)].sqrt() < prior.scale
            && (prior.scale_now + found.z).abs() < SCALE_SIGMAS * prior.scale;
        (sigma < WIND_KNOWN_MPS && explained && scaled).then_some((found.xy(), sigma))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Flies at 20 m/s, from 40 s on in a circle; what is found, and when.
    fn fly(turns: bool, off: impl Fn(Vector2<f64>) -> f64) -> Option<(f64, Vector2<f64>)> {
        let mut refit = WindRefit::default();
        (0..600).find_map(|k| {
            let t = f64::from(k) * 0.2;
            let course = if turns { (0.1 * (t - 40.0)).clamp(0.0, std::f64::consts::TAU) } else { 0.0 };
            let air_ne = Vector2::new(course.cos(), course.sin()) * 20.0;
            let d = Deviation { off: off(air_ne), sigma: 2.0, air_ne, speed: 20.0 };
            let prior = RefitPrior { wind: 6.0, scale: 0.05, scale_now: 0.0 };
            refit.add(&d, &prior).map(|(wind, _)| (t, wind))
        })
    }

    #[test]
    fn another_wind_shows_in_a_turn_and_a_wrong_tube_is_none() {
        let wind = Vector2::new(5.0, -3.0);
        let (t, found) = fly(true, |air_ne| -wind.dot(&air_ne) / 20.0).unwrap();
        assert!(t > 40.0 && (found - wind).norm() < 2.0, "{t} {found}");
        assert_eq!(fly(false, |air_ne| -wind.dot(&air_ne) / 20.0), None);
        assert_eq!(fly(true, |_| -6.0), None);
        assert_eq!(fly(true, |_| -20.0), None);
    }
}
