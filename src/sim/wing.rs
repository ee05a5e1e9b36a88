//! A fixed wing that flies a plan: turns of a given rate, changes of speed and height, and the small weaving of every real flight.
//!
//! The plan gives course χ, horizontal airspeed V and height h as functions of time (smooth steps and waves, all derivatives exact).
//! The velocity is [V cos χ, V sin χ, −ḣ] plus wind, in closed form with its first two derivatives, from which attitude and body
//! rate follow. Height is closed-form as well; north and east are the integral of the velocity, by Gauss-Legendre quadrature between
//! knots that include every join of the plan, so that each panel is analytic: exact to rounding.

use super::profile::{Jet, MotionProfile, Wave, add, product, sum};
use super::trajectory::{Path, Trajectory, Truth, coordinated};
use nalgebra::{Vector2, Vector3};
use std::f64::consts::PI;

/// A panel of the quadrature is no longer than this, s.
const PANEL_S: f64 = 0.5;
/// Slower than this with a level path (on the runway), the flight path angle is zero, m/s.
const TAXI_MPS: f64 = 0.1;

/// Course, speed and height over time, in the order in which they are flown.
#[derive(Clone, Debug, PartialEq)]
pub(super) struct Plan {
    t_s: f64,
    start_course_rad: f64,
    turn_rate: MotionProfile,
    speed: MotionProfile,
    height: MotionProfile,
    /// How much of the weaving and of the wind is there, 0 to 1: none on the ground.
    liveliness: MotionProfile,
}

impl Plan {
    /// Level flight with a horizontal speed, a height over the origin and a course.
    pub(super) fn new(speed_mps: f64, height_m: f64, course_rad: f64) -> Self {
        Self {
            t_s: 0.0,
            start_course_rad: course_rad,
            turn_rate: MotionProfile::constant(0.0),
            speed: MotionProfile::constant(speed_mps),
            height: MotionProfile::constant(height_m),
            liveliness: MotionProfile::constant(1.0),
        }
    }

    /// How far the plan has come, s.
    pub(super) fn now_s(&self) -> f64 {
        self.t_s
    }

    /// Straight on until a time.
    pub(super) fn until(mut self, t_s: f64) -> Self {
        self.t_s = self.t_s.max(t_s);
        self
    }

    /// Straight on for a while.
    pub(super) fn straight(self, for_s: f64) -> Self {
        let until = self.t_s + for_s;
        self.until(until)
    }

    /// Turns by an angle (positive to the right) at a rate, rolling in and out in `roll_s` each.
    pub(super) fn turn(mut self, angle_rad: f64, rate_radps: f64, roll_s: f64) -> Self {
        // Each roll turns by half of what its time would give.
        let rate = rate_radps.abs().min(angle_rad.abs() / roll_s);
        let hold_s = angle_rad.abs() / rate - roll_s;
        self.turn_rate.step_to(self.t_s, roll_s, rate.copysign(angle_rad));
        self.turn_rate.step_to(self.t_s + roll_s + hold_s, roll_s, 0.0);
        self.t_s += hold_s + 2.0 * roll_s;
        self
    }

    /// Goes to another speed, beginning at a time.
    pub(super) fn speed(mut self, from_s: f64, over_s: f64, to_mps: f64) -> Self {
        self.speed = self.speed.then(from_s, over_s, to_mps);
        self
    }

    /// Goes to another height, beginning at a time.
    pub(super) fn height(mut self, from_s: f64, over_s: f64, to_m: f64) -> Self {
        self.height = self.height.then(from_s, over_s, to_m);
        self
    }

    /// Stands or rolls smoothly on the ground first; weaving and wind come in from `from_s` on.
    pub(super) fn airborne(mut self, from_s: f64, over_s: f64) -> Self {
        self.liveliness = MotionProfile::constant(0.0).then(from_s, over_s, 1.0);
        self
    }
}

/// See the module's documentation.
#[derive(Clone, Debug, PartialEq)]
pub struct PlannedFlight {
    plan: Plan,
    wind_ned: Vector3<f64>,
    course_waves: Vec<Wave>,
    speed_waves: Vec<Wave>,
    height_waves: Vec<Wave>,
    /// Times and the north and east position there.
    knots: Vec<(f64, Vector2<f64>)>,
}

impl PlannedFlight {
    /// The plan flown for `duration_s` in a wind, weaving by the given fraction of what a small aircraft usually does.
    pub(super) fn new(plan: Plan, duration_s: f64, wind_ned: Vector3<f64>, weaving: f64) -> Self {
        let wave = |amplitude: f64, period_s, phase_rad| Wave {
            amplitude: amplitude * weaving,
            period_s,
            phase_rad,
        };
        let mut flight = Self {
            plan,
            wind_ned,
            course_waves: vec![wave(2f64.to_radians(), 23.0, 0.7), wave(1.5f64.to_radians(), 61.0, 2.1)],
            speed_waves: vec![wave(0.5, 31.0, 1.3)],
            height_waves: vec![wave(1.0, 17.0, 0.2), wave(4.0, 97.0, 1.9)],
            knots: Vec::new(),
        };
        flight.integrate(duration_s);
        flight
    }

    /// The same plan in another wind.
    pub(super) fn in_wind(&self, wind_ned: Vector3<f64>) -> Self {
        let mut flight = Self { wind_ned, ..self.clone() };
        flight.integrate(self.knots.last().map_or(0.0, |k| k.0));
        flight
    }

    /// Can be flown at least until `end_s`.
    pub(super) fn reach(&mut self, end_s: f64) {
        if self.knots.last().is_none_or(|k| k.0 < end_s) {
            self.integrate(end_s);
        }
    }

    /// Lays the knots to `end_s`.
    fn integrate(&mut self, end_s: f64) {
        let p = &self.plan;
        let panels = (end_s / PANEL_S).ceil() as u32;
        let mut times: Vec<f64> = (0..=panels).map(|k| PANEL_S * f64::from(k)).collect();
        for profile in [&p.turn_rate, &p.speed, &p.liveliness] {
            times.extend(profile.joins().filter(|t| (0.0..end_s).contains(t)));
        }
        times.sort_by(f64::total_cmp);
        times.dedup();
        self.knots.clear();
        let mut at = Vector2::zeros();
        let mut before = 0.0;
        for t in times {
            at += self.way(before, t);
            self.knots.push((t, at));
            before = t;
        }
    }

    /// North and east way between two times in one panel: five-point Gauss-Legendre.
    fn way(&self, from_s: f64, to_s: f64) -> Vector2<f64> {
        super::world::mean(from_s, to_s, Vector2::zeros(), |t| self.horizontal_velocity(t)) * (to_s - from_s)
    }

    fn course(&self, t_s: f64, lively: &Jet) -> Jet {
        let [rate, d_rate, dd_rate, _] = self.plan.turn_rate.at(t_s);
        let planned = [self.plan.start_course_rad + self.plan.turn_rate.integral(t_s), rate, d_rate, dd_rate];
        add(&planned, &product(lively, &sum(&self.course_waves, t_s)))
    }

    fn horizontal_velocity(&self, t_s: f64) -> Vector2<f64> {
        let lively = self.plan.liveliness.at(t_s);
        let course = self.course(t_s, &lively)[0];
        let speed = self.plan.speed.at(t_s)[0] + lively[0] * sum(&self.speed_waves, t_s)[0];
        let (s, c) = course.sin_cos();
        Vector2::new(c, s) * speed + self.wind_ned.xy() * lively[0]
    }

    /// Every time at which a higher derivative may jump.
    #[cfg(test)]
    pub(super) fn joins(&self) -> Vec<f64> {
        let p = &self.plan;
        [&p.turn_rate, &p.speed, &p.height, &p.liveliness].into_iter().flat_map(|x| x.joins()).collect()
    }
}

impl Trajectory for PlannedFlight {
    fn at(&self, t_s: f64) -> Truth {
        let lively = self.plan.liveliness.at(t_s);
        let chi = self.course(t_s, &lively);
        let v = add(&self.plan.speed.at(t_s), &product(&lively, &sum(&self.speed_waves, t_s)));
        let h = add(&self.plan.height.at(t_s), &product(&lively, &sum(&self.height_waves, t_s)));
        let (s, c) = chi[0].sin_cos();
        let (ahead, right) = (Vector3::new(c, s, 0.0), Vector3::new(-s, c, 0.0));
        let wind = self.wind_ned;
        let (from, knot) = self
            .knots
            .get(self.knots.partition_point(|k| k.0 <= t_s).saturating_sub(1))
            .copied()
            .unwrap_or((0.0, Vector2::zeros()));
        let way = knot + self.way(from, t_s);
        let path = Path {
            p: Vector3::new(way.x, way.y, -h[0]),
            v: v[0] * ahead + Vector3::new(0.0, 0.0, -h[1]) + lively[0] * wind,
            a: v[1] * ahead + v[0] * chi[1] * right + Vector3::new(0.0, 0.0, -h[2]) + lively[1] * wind,
            j: (v[2] - v[0] * chi[1] * chi[1]) * ahead
                + (2.0 * v[1] * chi[1] + v[0] * chi[2]) * right
                + Vector3::new(0.0, 0.0, -h[3])
                + lively[2] * wind,
        };
        // The nose along the velocity through the air, by its angles: they stay defined when it stands.
        let (gamma, d_gamma) = if v[0].abs() < TAXI_MPS && h[1] == 0.0 && h[2] == 0.0 {
            (0.0, 0.0)
        } else {
            (h[1].atan2(v[0]), (h[2] * v[0] - h[1] * v[1]) / (v[0] * v[0] + h[1] * h[1]))
        };
        let (sg, cg) = gamma.sin_cos();
        let down = Vector3::z();
        let x = cg * ahead - sg * down;
        let dx = cg * chi[1] * right - d_gamma * (sg * ahead + cg * down);
        coordinated(t_s, &path, x, dx)
    }
}

/// A whole turn, rad.
pub(super) const FULL: f64 = 2.0 * PI;

#[cfg(test)]
mod tests {
    use super::*;
    use crate::geo::so3::Euler;
    use crate::sim::trajectory::testing::{assert_continuous, assert_derivatives};

    fn flight(wind: Vector3<f64>, weaving: f64) -> PlannedFlight {
        let plan = Plan::new(27.0, 130.0, 0.3).straight(10.0).turn(FULL, 27.0 / 350.0, 4.0).straight(5.0);
        let plan = plan.turn(-PI, 0.2, 3.0).height(20.0, 15.0, 160.0).speed(40.0, 10.0, 24.0);
        PlannedFlight::new(plan, 150.0, wind, weaving)
    }

    #[test]
    fn every_quantity_is_the_derivative_of_the_one_before() {
        let f = flight(Vector3::new(3.0, -4.0, 0.0), 1.0);
        assert_derivatives("plan", &f, (0..700).map(|k| 0.211 * f64::from(k) + 0.013));
        assert_continuous("plan", &f, f.joins());
    }

    #[test]
    fn a_full_turn_without_weaving_and_wind_comes_back_to_its_course() {
        let f = flight(Vector3::zeros(), 0.0);
        let yaw = |t| Euler::from_rotation(&f.at(t).r_body_to_ned).yaw_rad;
        let after = 10.0 + FULL / (27.0 / 350.0) + 4.0 + 2.0;
        assert!((yaw(after) - yaw(1.0)).abs() < 1e-12);
        // In the middle of the turn the bank is that of the rate.
        let roll = Euler::from_rotation(&f.at(16.0).r_body_to_ned).roll_rad;
        assert!((roll.tan() - 27.0 * 27.0 / 350.0 / 9.81).abs() < 1e-9, "{roll}");
    }

    #[test]
    fn wind_carries_the_flight_along_and_turns_nothing() {
        let wind = Vector3::new(5.0, 2.0, 0.0);
        let (still, windy) = (flight(Vector3::zeros(), 1.0), flight(Vector3::zeros(), 1.0).in_wind(wind));
        for t in [0.0, 33.0, 149.0] {
            let (a, b) = (still.at(t), windy.at(t));
            assert!((b.position_ned - a.position_ned - t * wind).norm() < 1e-9);
            assert_eq!(a.r_body_to_ned, b.r_body_to_ned);
        }
    }
}
