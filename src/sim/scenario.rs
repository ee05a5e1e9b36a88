//! Named flights: a motion known at any time, the place it happens at, and when GNSS goes away.
//!
//! The fixed wings weave a little in course, speed and height, as real ones do. The world is flat (see [`Environment::of`]): a
//! barometer measures the distance along NED's z, gravity never turns. Over the 16 km of `straight` the Earth would fall away by
//! 20 m, which neither the simulator nor a navigator in one local frame knows.

use super::figures::Sinusoids;
use super::trajectory::{Trajectory, Truth};
use super::waypoints::Waypoints;
use super::wing::{FULL, Plan, PlannedFlight};
use super::world::Environment;
use crate::geo::{Geodetic, NOMINAL_GRAVITY_MPS2};
use crate::sample::{Airframe, VehicleStatus};
use nalgebra::Vector3;
use std::f64::consts::{FRAC_PI_2, PI};

/// Speed of the small fixed wing, m/s.
const PENGUIN_MPS: f64 = 27.0;
/// GNSS goes away here in the fixed wing's flights, s …
const PENGUIN_GNSS_S: f64 = 720.0;
/// … and for this long, s.
const PENGUIN_OUTAGE_S: f64 = 600.0;
/// The patrol loses GNSS here, s …
const PATROL_GNSS_S: f64 = 120.0;
/// … for an hour, s.
const PATROL_OUTAGE_S: f64 = 3600.0;
/// Vehicles are armed for this long before they move, s.
const ARMED_BEFORE_S: f64 = 2.0;
/// A roll into a turn takes this long, s.
const ROLL_S: f64 = 3.0;

/// A flight to simulate.
#[derive(Clone, Debug, PartialEq)]
pub struct Scenario {
    /// Its name.
    pub name: &'static str,
    /// Where NED's origin lies: where the flight begins, at the reference height of the ground.
    pub origin: Geodetic,
    /// The world around it.
    pub environment: Environment,
    /// How long it takes, s.
    pub duration_s: f64,
    /// When GNSS is to be taken away, s; nothing happens by itself: see [`super::models::GnssModel::outage`] and `replay --outage`.
    pub outage_s: Option<(f64, f64)>,
    /// The air's motion, m/s in NED.
    pub wind_ned: Vector3<f64>,
    pub(super) motion: Motion,
}

#[derive(Clone, Debug, PartialEq)]
pub(super) enum Motion {
    Wing(PlannedFlight),
    Figure(Sinusoids),
    Rotor(Waypoints),
}

impl Trajectory for Scenario {
    fn at(&self, t_s: f64) -> Truth {
        match &self.motion {
            Motion::Wing(w) => w.at(t_s),
            Motion::Figure(f) => f.at(t_s),
            Motion::Rotor(r) => r.at(t_s),
        }
    }
}

impl Scenario {
    /// The names that [`Self::by_name`] knows.
    pub const NAMES: [&'static str; 6] = ["cessna", "circles", "legs", "straight", "square", "patrol"];

    /// One line that says what is flown.
    pub fn summary(&self) -> &'static str {
        match self.name {
            "cessna" => "take-off, climb and two steep turns of a Cessna 172, with GNSS",
            "circles" => "a fixed wing at 27 m/s: manoeuvres with GNSS, then circles",
            "legs" => "a fixed wing at 27 m/s: manoeuvres with GNSS, then survey legs",
            "straight" => "a fixed wing at 27 m/s: manoeuvres with GNSS, then straight on",
            "patrol" => "a quadrotor at 20 m: squares for an hour",
            _ => "a quadrotor: take-off, squares with hovers, landing",
        }
    }

    /// A scenario by its name.
    pub fn by_name(name: &str) -> Option<Self> {
        match name {
            "cessna" => Some(Self::cessna()),
            "circles" => Some(Self::circles()),
            "legs" => Some(Self::legs()),
            "straight" => Some(Self::straight()),
            "square" => Some(Self::square()),
            "patrol" => Some(Self::patrol()),
            _ => None,
        }
    }

    /// The flight of Grip's Section V on a Cessna 172: 5 s standing, the take-off run, climb to 450 m at up to 60 m/s, a whole turn
    /// to the left at −45° of bank and one to the right at +55°. 300 s, GNSS throughout.
    pub fn cessna() -> Self {
        let plan = Plan::new(0.0, 0.0, 0.4)
            .airborne(32.0, 6.0)
            .speed(5.0, 30.0, 38.0)
            .speed(40.0, 40.0, 60.0)
            .height(30.0, 95.0, 450.0)
            .until(130.0)
            .turn(-FULL, turn_rate(-45.0, 60.0), 4.0)
            .until(205.0)
            .turn(FULL, turn_rate(55.0, 60.0), 4.0)
            .until(300.0);
        Self::wing("cessna", plan, 1.2, None)
    }

    /// Twelve minutes of manoeuvres with GNSS, then ten of circles of 350 m radius.
    pub fn circles() -> Self {
        // As many as fill a day: a flight that is told to last for longer goes on in them.
        let plan = Self::manoeuvres().turn(1200.0 * FULL, PENGUIN_MPS / 350.0, ROLL_S);
        Self::penguin("circles", plan)
    }

    /// Twelve minutes of manoeuvres with GNSS, then ten of survey legs of 1.1 km with half turns to alternating sides.
    pub fn legs() -> Self {
        let mut plan = Self::manoeuvres();
        for leg in 0..12 {
            let side = if leg % 2 == 0 { PI } else { -PI };
            plan = plan.straight(40.0).turn(side, PENGUIN_MPS / 150.0, ROLL_S);
        }
        Self::penguin("legs", plan)
    }

    /// Twelve minutes of manoeuvres with GNSS, then ten straight on.
    pub fn straight() -> Self {
        Self::penguin("straight", Self::manoeuvres())
    }

    /// A quadrotor: 20 s on the ground, take-off to 30 m, three squares of 60 m with hovers and turns at the corners, landing.
    /// Its rotors' drag is 0.3 of the velocity a second. GNSS goes for two minutes in the middle.
    pub fn square() -> Self {
        let (side, up) = (60.0, -30.0);
        let mut route = Waypoints::new(Vector3::zeros(), 0.0)
            .with_drag(0.3)
            .wait(20.0)
            .to(Vector3::new(0.0, 0.0, up), 12.0)
            .wait(10.0);
        let corners = [(1.0, 0.0), (1.0, 1.0), (0.0, 1.0), (0.0, 0.0)];
        for k in 0..12 {
            let (north, east) = corners[k % 4];
            // Every other corner is 5 m higher.
            let climb = if k % 2 == 0 { -5.0 } else { 0.0 };
            route = route
                .to(Vector3::new(north * side, east * side, up + climb), 15.0)
                .wait(3.0)
                .face((k + 1) as f64 * FRAC_PI_2, 4.0)
                .wait(3.0);
        }
        let route = route.to(Vector3::zeros(), 20.0).wait(10.0);
        let duration_s = route.end_s();
        Self {
            name: "square",
            motion: Motion::Rotor(route),
            ..Self::at_the_origin(0.15, duration_s, Some((150.0, 270.0)))
        }
    }

    /// A quadrotor that goes round a square of 40 m at 20 m over the ground, for an hour and two minutes. GNSS goes after the two minutes.
    pub fn patrol() -> Self {
        let (side, up) = (40.0, -20.0);
        let mut route = Waypoints::new(Vector3::zeros(), 0.0)
            .with_drag(0.3)
            .wait(15.0)
            .to(Vector3::new(0.0, 0.0, up), 10.0)
            .wait(3.0);
        let corners = [(1.0, 0.0), (1.0, 1.0), (0.0, 1.0), (0.0, 0.0)];
        let mut k = 0;
        while k % 4 != 0 || route.end_s() < PATROL_GNSS_S + PATROL_OUTAGE_S {
            let (north, east) = corners[k % 4];
            route = route
                .to(Vector3::new(north * side, east * side, up), 11.0)
                .wait(2.0)
                .face((k + 1) as f64 * FRAC_PI_2, 4.0)
                .wait(1.0);
            k += 1;
        }
        let route = route.to(Vector3::zeros(), 15.0).wait(10.0);
        let duration_s = route.end_s();
        Self {
            name: "patrol",
            motion: Motion::Rotor(route),
            ..Self::at_the_origin(0.15, duration_s, Some((PATROL_GNSS_S, PATROL_GNSS_S + PATROL_OUTAGE_S)))
        }
    }

    /// The same flight in a steady wind: fixed wings fly the same plan through the air and drift with it; a multirotor stays on its
    /// path. Only the horizontal part is taken.
    pub fn with_wind(mut self, wind_ned: Vector3<f64>) -> Self {
        self.wind_ned = Vector3::new(wind_ned.x, wind_ned.y, 0.0);
        if let Motion::Wing(wing) = &self.motion {
            self.motion = Motion::Wing(wing.in_wind(self.wind_ned));
        }
        self
    }

    /// The same flight, ended earlier, or gone on with as it ends (a fixed wing straight on or in its last turn, a multirotor standing).
    pub fn lasting(mut self, duration_s: f64) -> Self {
        self.duration_s = duration_s;
        if let Motion::Wing(wing) = &mut self.motion {
            wing.reach(duration_s);
        }
        self
    }

    /// Whether a fixed wing flies it, or a multirotor.
    pub fn is_fixed_wing(&self) -> bool {
        !matches!(self.motion, Motion::Rotor(_))
    }

    /// What the autopilot would say of the vehicle: it arms two seconds before it moves, and disarms when it stands on the ground again.
    pub fn status(&self, t_s: f64) -> VehicleStatus {
        let grounded = |t_s: f64| {
            let truth = self.at(t_s);
            self.stands(&truth) && truth.position_ned.z.abs() < 1e-3
        };
        let airframe = if self.is_fixed_wing() { Airframe::FixedWing } else { Airframe::Multirotor };
        let armed = !(grounded(t_s) && grounded(t_s + ARMED_BEFORE_S));
        VehicleStatus { airframe: Some(airframe), armed: Some(armed), landed: None }
    }

    /// Whether the vehicle stands still (on the ground, or a multirotor in its hover).
    pub fn stands(&self, truth: &Truth) -> bool {
        truth.velocity_ned.norm() < 1e-3 && truth.body_rate.norm() < 1e-6
    }

    /// What is flown before GNSS goes: turns to both sides, figures of eight, changes of height and speed.
    fn manoeuvres() -> Plan {
        let rate = PENGUIN_MPS / 250.0;
        let mut plan = Plan::new(PENGUIN_MPS, 130.0, 0.5).straight(30.0);
        for parts in [1.0, -1.0, 0.5, -0.75, 0.75, -1.0, 0.25, 1.0, -0.75, 0.75, -0.75] {
            plan = plan.turn(parts * FULL, rate, ROLL_S).straight(12.0);
        }
        let plan = plan.height(120.0, 40.0, 150.0).height(300.0, 40.0, 125.0).height(520.0, 40.0, 140.0);
        let plan = plan.speed(200.0, 20.0, 30.0).speed(260.0, 20.0, 24.0).speed(340.0, 20.0, PENGUIN_MPS);
        plan.until(PENGUIN_GNSS_S - 15.0)
    }

    fn penguin(name: &'static str, plan: Plan) -> Self {
        let end = PENGUIN_GNSS_S + PENGUIN_OUTAGE_S;
        Self::wing(name, plan.until(end), 0.0, Some((PENGUIN_GNSS_S, end)))
    }

    fn wing(name: &'static str, plan: Plan, ground_down_m: f64, outage_s: Option<(f64, f64)>) -> Self {
        let duration_s = outage_s.map_or(plan.now_s(), |(_, end)| end);
        let motion = Motion::Wing(PlannedFlight::new(plan, duration_s, Vector3::zeros(), 1.0));
        Self { name, motion, ..Self::at_the_origin(ground_down_m, duration_s, outage_s) }
    }

    /// Everything but the name and the motion. The place is on the Norwegian coast: the field dips by 75°.
    pub(super) fn at_the_origin(ground_down_m: f64, duration_s: f64, outage_s: Option<(f64, f64)>) -> Self {
        let origin = Geodetic::from_degrees(63.4, 10.4, 100.0);
        let fallback = Environment { ground_down_m, ..Environment::trondheim() };
        Self {
            name: "hover",
            origin,
            environment: Environment::of(&origin, ground_down_m).unwrap_or(fallback),
            duration_s,
            outage_s,
            wind_ned: Vector3::zeros(),
            motion: Motion::Rotor(Waypoints::new(Vector3::zeros(), 0.0)),
        }
    }
}

/// Rate of a coordinated level turn, rad/s.
fn turn_rate(bank_deg: f64, speed_mps: f64) -> f64 {
    NOMINAL_GRAVITY_MPS2 * bank_deg.to_radians().tan() / speed_mps
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::geo::so3::Euler;
    use crate::sim::trajectory::testing::{assert_continuous, assert_derivatives};

    fn all() -> impl Iterator<Item = Scenario> {
        Scenario::NAMES.iter().map(|n| Scenario::by_name(n).unwrap())
    }

    #[test]
    fn every_quantity_is_the_derivative_of_the_one_before() {
        for s in all().chain([Scenario::circles().with_wind(Vector3::new(4.0, -3.0, 0.0))]) {
            let n = (s.duration_s / 0.61) as i32;
            assert_derivatives(s.name, &s, (1..n).map(|k| 0.61 * f64::from(k) + 0.0031));
            let joins = match &s.motion {
                Motion::Wing(w) => w.joins(),
                Motion::Figure(_) => Vec::new(),
                Motion::Rotor(r) => r.joins(),
            };
            assert!(joins.len() > 8);
            assert_continuous(s.name, &s, joins);
        }
    }

    #[test]
    fn the_outages_are_flown_as_they_are_named() {
        for (name, low_km, high_km) in
            [("circles", 15.0, 17.0), ("legs", 15.0, 17.0), ("straight", 15.0, 17.0)]
        {
            let s = Scenario::by_name(name).unwrap();
            let (from, to) = s.outage_s.unwrap();
            assert_eq!((from, to, s.duration_s), (720.0, 1320.0, 1320.0));
            let at = |k: i32| s.at(from + 0.1 * f64::from(k));
            let km =
                (0..6000).map(|k| (at(k + 1).position_ned - at(k).position_ned).norm()).sum::<f64>() * 1e-3;
            assert!((low_km..high_km).contains(&km), "{name}: {km} km");
            let away = (s.at(to).position_ned - s.at(from).position_ned).xy().norm();
            assert_eq!(away > 15_000.0, name == "straight", "{name}: {away} m");
            for k in 0..13_200 {
                let height = s.environment.height(&s.at(0.1 * f64::from(k)));
                assert!((110.0..165.0).contains(&height), "{name}: {height} m");
            }
        }
    }

    #[test]
    fn the_cessna_takes_off_and_banks_as_the_paper_says() {
        let s = Scenario::cessna();
        assert!(s.stands(&s.at(3.0)) && !s.stands(&s.at(20.0)));
        assert_eq!(s.at(20.0).position_ned.z, 0.0);
        let rolls = |from: i32, to: i32| {
            (from..to).map(|t| Euler::from_rotation(&s.at(f64::from(t)).r_body_to_ned).roll_rad.to_degrees())
        };
        let (left, right) = (rolls(120, 190).fold(0.0, f64::min), rolls(195, 260).fold(0.0, f64::max));
        assert!((left + 45.0).abs() < 3.0 && (right - 55.0).abs() < 3.0, "{left} {right}");
        assert!((s.at(250.0).velocity_ned.norm() - 60.0).abs() < 2.0);
        assert!((s.environment.height(&s.at(250.0)) - 451.0).abs() < 8.0);
    }

    #[test]
    fn the_square_begins_and_ends_on_the_ground() {
        let s = Scenario::square();
        for t in [0.0, 19.9, s.duration_s] {
            assert!(s.stands(&s.at(t)) && (s.environment.height(&s.at(t)) - 0.15).abs() < 1e-12, "{t}");
        }
        assert!((s.at(42.0).position_ned.z + 30.0).abs() < 1e-9);
        let armed = |t| s.status(t).armed.unwrap();
        assert!(!armed(5.0) && armed(18.5) && armed(100.0) && armed(360.0) && !armed(s.duration_s));
        assert_eq!(s.status(0.0).airframe, Some(Airframe::Multirotor));
        assert!(Scenario::circles().status(0.0).armed == Some(true));
        let (from, to) = s.outage_s.unwrap();
        assert!(from > 60.0 && to + 30.0 < s.duration_s);
    }
}
