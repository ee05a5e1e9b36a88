//! A multirotor that wanders over a place: sums of sinusoids, never repeating within a flight, its heading swinging.

use std::f64::consts::TAU;

use nalgebra::Vector3;

use super::figures::Sinusoids;
use super::profile::Wave;
use super::trajectory::{Trajectory, Truth, thrusting};

/// The wandering; see the module.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Wander {
    /// The middle of it, NED, m.
    pub centre_ned: Vector3<f64>,
    /// Amplitude of each axis, m. Zero is a hover.
    pub amplitude_m: Vector3<f64>,
    /// Period of each axis, s.
    pub period_s: Vector3<f64>,
    /// The heading's mean and the amplitude of its swing, rad.
    pub heading_rad: [f64; 2],
    /// Period of the swing, s.
    pub heading_period_s: f64,
    /// Where in all its periods it starts, in [0, 1).
    pub phase: f64,
}

impl Wander {
    /// Over a field some metres wide, at about 1 m/s.
    pub fn over_field(phase: f64) -> Self {
        Self {
            centre_ned: Vector3::new(0.0, 0.0, -4.0),
            amplitude_m: Vector3::new(3.0, 3.0, 1.0),
            period_s: Vector3::new(17.0, 23.0, 13.0),
            heading_rad: [0.0, 1.0],
            heading_period_s: 29.0,
            phase,
        }
    }

    /// In one place over the same field, level.
    pub fn hover(phase: f64) -> Self {
        let w = Self::over_field(phase);
        Self { amplitude_m: Vector3::zeros(), heading_rad: [TAU * phase, 0.0], ..w }
    }
}

impl Trajectory for Wander {
    fn at(&self, t_s: f64) -> Truth {
        // Axes out of step with each other.
        let wave = |i: usize| Wave {
            amplitude: self.amplitude_m[i],
            period_s: self.period_s[i],
            phase_rad: TAU * (self.phase * (1.0 + i as f64) + 0.3 * i as f64),
        };
        let waves = [wave(0), wave(1), wave(2)];
        let path = Sinusoids { centre_ned: self.centre_ned, drift_ned: Vector3::zeros(), waves }.path(t_s);
        let w = TAU / self.heading_period_s;
        let (s, c) = (w * t_s + TAU * self.phase).sin_cos();
        let [mean, swing] = self.heading_rad;
        thrusting(t_s, &path, 0.0, (mean + swing * s, swing * w * c))
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::sim::trajectory::testing::assert_derivatives;

    #[test]
    fn every_quantity_is_the_derivative_of_the_one_before() {
        let times = || (0..200).map(|k| 0.31 * f64::from(k) + 0.011);
        assert_derivatives("wander", &Wander::over_field(0.37), times());
        assert_derivatives("hover", &Wander::hover(0.37), times());
    }
}
