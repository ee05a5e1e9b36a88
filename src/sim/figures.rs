//! Figures in the air, for estimators that are to be seen at work at once: no take-off, no wind, GNSS throughout.

use super::profile::Wave;
use super::scenario::{Motion, Scenario};
use super::trajectory::{Path, Trajectory, Truth, coordinated, unit};
use super::waypoints::Waypoints;
use nalgebra::Vector3;
use std::f64::consts::{FRAC_PI_2, TAU};

/// How long a figure is flown, s.
const DURATION_S: f64 = 400.0;
/// Height of the circle and of the way northwards, m.
const HEIGHT_M: f64 = 120.0;
/// From one height to the other and back on the circle, s.
const CLIMB_PERIOD_S: f64 = 60.0;
/// Period of the weaving, s.
const WEAVE_PERIOD_S: f64 = 40.0;

/// A point that drifts, and a sinusoid an axis.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct Sinusoids {
    pub(super) centre_ned: Vector3<f64>,
    pub(super) drift_ned: Vector3<f64>,
    pub(super) waves: [Wave; 3],
}

impl Sinusoids {
    pub(super) fn path(&self, t_s: f64) -> Path {
        let jets = self.waves.map(|w| w.at(t_s));
        let of = |derivative: usize| Vector3::from_fn(|axis, _| jets[axis][derivative]);
        Path {
            p: self.centre_ned + t_s * self.drift_ned + of(0),
            v: self.drift_ned + of(1),
            a: of(2),
            j: of(3),
        }
    }
}

/// A fixed wing flies it in coordinated turns, without wind, angle of attack or sideslip.
impl Trajectory for Sinusoids {
    fn at(&self, t_s: f64) -> Truth {
        let path = self.path(t_s);
        let (x, dx) = unit(&path.v, &path.a);
        coordinated(t_s, &path, x, dx)
    }
}

fn wave(amplitude: f64, period_s: f64, phase_rad: f64) -> Wave {
    Wave { amplitude, period_s, phase_rad }
}

fn none() -> Wave {
    wave(0.0, 1.0, 0.0)
}

impl Scenario {
    /// A fixed wing in circles to the right, northwards at first, 120 m over the ground and up and down by half of `climb_m`.
    pub fn circle(radius_m: f64, speed_mps: f64, climb_m: f64) -> Self {
        let period_s = TAU * radius_m / speed_mps;
        let waves = [
            wave(radius_m, period_s, 0.0),
            wave(radius_m, period_s, -FRAC_PI_2),
            wave(-0.5 * climb_m, CLIMB_PERIOD_S, 0.0),
        ];
        let centre_ned = Vector3::new(0.0, radius_m, -HEIGHT_M);
        Self::figure("circle", Sinusoids { centre_ned, drift_ned: Vector3::zeros(), waves })
    }

    /// A fixed wing in figures of eight, 800 m northwards by 400 m in 80 s, at 135 to 165 m: turns to both sides, speed and climb changing.
    pub fn figure_eight() -> Self {
        let waves = [wave(400.0, 80.0, 0.0), wave(200.0, 40.0, 0.0), wave(-15.0, 50.0, 0.0)];
        let centre_ned = Vector3::new(0.0, 0.0, -150.0);
        Self::figure("figure eight", Sinusoids { centre_ned, drift_ned: Vector3::zeros(), waves })
    }

    /// A fixed wing northwards, 120 m over the ground, weaving by `weave_m` to both sides.
    pub fn northwards(speed_mps: f64, weave_m: f64) -> Self {
        let waves = [none(), wave(weave_m, WEAVE_PERIOD_S, 0.0), none()];
        let centre_ned = Vector3::new(0.0, 0.0, -HEIGHT_M);
        Self::figure(
            "northwards",
            Sinusoids { centre_ned, drift_ned: Vector3::new(speed_mps, 0.0, 0.0), waves },
        )
    }

    /// A quadrotor round a square of 60 m, nose ahead: hovers and turns of 10 s, legs of 15 s at up to 8.75 m/s, every other corner 5 m
    /// higher than the 30 m of the first.
    pub fn corners() -> Self {
        let corner = |k: usize| {
            let (north, east) = [(0.0, 0.0), (1.0, 0.0), (1.0, 1.0), (0.0, 1.0)][k % 4];
            Vector3::new(60.0 * north, 60.0 * east, if k.is_multiple_of(2) { -30.0 } else { -35.0 })
        };
        let (mut route, mut k) = (Waypoints::new(corner(0), 0.0).wait(10.0), 0);
        while route.end_s() < DURATION_S {
            k += 1;
            route = route.to(corner(k), 15.0).face(k as f64 * FRAC_PI_2, 10.0);
        }
        Self { name: "corners", motion: Motion::Rotor(route), ..Self::at_the_origin(0.0, DURATION_S, None) }
    }

    /// A quadrotor that hovers at 30 m.
    pub fn hover() -> Self {
        let route = Waypoints::new(Vector3::new(0.0, 0.0, -30.0), 0.0);
        Self { name: "hover", motion: Motion::Rotor(route), ..Self::at_the_origin(0.0, DURATION_S, None) }
    }

    fn figure(name: &'static str, sinusoids: Sinusoids) -> Self {
        Self { name, motion: Motion::Figure(sinusoids), ..Self::at_the_origin(0.0, DURATION_S, None) }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::geo::NOMINAL_GRAVITY_MPS2;
    use crate::geo::so3::Euler;
    use crate::sim::trajectory::testing::{assert_continuous, assert_derivatives};

    #[test]
    fn every_quantity_is_the_derivative_of_the_one_before() {
        let flights = [
            Scenario::circle(300.0, 25.0, 40.0),
            Scenario::figure_eight(),
            Scenario::northwards(27.0, 20.0),
            Scenario::corners(),
        ];
        for s in flights {
            assert_derivatives(s.name, &s, (0..400).map(|k| 0.37 * f64::from(k) + 0.011));
        }
        assert_continuous("corners", &Scenario::corners(), [10.0, 25.0, 35.0, 50.0]);
    }

    #[test]
    fn a_circle_banks_by_the_textbook_angle_and_turns_right() {
        let c = Scenario::circle(300.0, 25.0, 0.0);
        for t in [0.0, 3.3, 100.0] {
            let x = c.at(t);
            let e = Euler::from_rotation(&x.r_body_to_ned);
            assert!((e.roll_rad.tan() - 25.0 * 25.0 / (300.0 * NOMINAL_GRAVITY_MPS2)).abs() < 1e-12);
            assert!((x.velocity_ned.norm() - 25.0).abs() < 1e-9);
            assert!((x.velocity_body() - Vector3::new(25.0, 0.0, 0.0)).norm() < 1e-9);
        }
        let e = Euler::from_rotation(&c.at(1.0).r_body_to_ned);
        assert!(e.yaw_rad > 0.08, "started northwards, now turning east");
    }

    #[test]
    fn a_hover_is_level_and_at_rest_and_the_nose_follows_the_legs() {
        let m = Scenario::corners();
        let x = m.at(5.0);
        assert_eq!((x, x.velocity_ned.norm()), (Scenario::hover().at(5.0), 0.0));
        assert!((x.r_body_to_ned - nalgebra::Matrix3::identity()).norm() < 1e-12);
        let on_second_leg = m.at(25.0 + 10.0 + 7.5);
        assert!(on_second_leg.velocity_body().x > 8.0 && on_second_leg.velocity_body().y.abs() < 1e-9);
        assert!((m.at(50.0).position_ned - Vector3::new(60.0, 60.0, -30.0)).norm() < 1e-9);
    }
}
