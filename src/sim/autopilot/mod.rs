//! An autopilot that is none: a quadrotor flown by a controller that acts on the autopilot's *own estimate*, so that an estimate which
//! drifts moves the vehicle, with ArduPilot's or PX4's rules of what that estimate is aided by and when a failsafe ends the flight.
//!
//! No input, no output, no clock: it is stepped, it is told what external navigation sent, and it is asked what it knows. The room
//! `double` makes it speak MAVLink.

pub mod axis;
pub mod control;
pub mod ekf2;
pub mod ekf3;
pub mod external;
pub mod link;
mod own_filter;
pub mod quadrotor;
mod recent;
pub mod script;
mod sensors;

use nalgebra::Vector3;
use strum::Display;

use super::models::{GnssReading, ImuModel, OutageKind};
use super::noise::{GaussMarkov, SensorRng, Stream};
use super::scenario::Scenario;
use super::trajectory::Truth;
use super::world::Environment;
use crate::geo::{Geodetic, LocalNed};
use crate::time::AutopilotTime;
use axis::AxisQuantity;
use control::{ControlTarget, PositionControl};
use ekf2::{Ekf2, Ekf2Settings};
use ekf3::{Ekf3, Ekf3Settings};
use external::{ExternalCounts, ExternalPose};
pub use own_filter::{AxisMeasurement, OwnFilter};
use quadrotor::{Quadrotor, QuadrotorModel};
use recent::RecentTruth;
use script::{FlightScript, ScriptOrder, ScriptView};
pub use sensors::NewestSamples;
use sensors::VehicleSensors;

/// Height of the vehicle's origin over the ground when it stands, m.
const LEGS_M: f64 = 0.15;
/// Fixes for so long make the origin, and GPS usable, s.
const ORIGIN_AFTER_S: f64 = 8.0;
/// Noise of the barometer as the filter assumes it, m.
const BARO_NOISE_M: f64 = 0.6;
/// The barometer is set to zero over the first so many readings.
const BARO_ZERO_READINGS: u32 = 25;
/// On the ground for so long after a landing, it disarms, s.
const DISARM_AFTER_S: f64 = 1.0;
/// Gusts: this part of the steady wind, over some seconds.
const GUST_PART: f64 = 0.12;
const GUST_S: f64 = 4.0;

/// Whose rules are in force.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum AidingRules {
    /// ArduPilot's.
    Ekf3(Ekf3Settings),
    /// PX4's.
    Ekf2(Ekf2Settings),
}

/// The state of those rules.
#[derive(Clone, Debug)]
pub enum OwnAiding {
    /// ArduPilot's.
    Ekf3(Ekf3),
    /// PX4's.
    Ekf2(Ekf2),
}

impl OwnAiding {
    fn new(rules: AidingRules) -> Self {
        match rules {
            AidingRules::Ekf3(settings) => Self::Ekf3(Ekf3::new(settings)),
            AidingRules::Ekf2(settings) => Self::Ekf2(Ekf2::new(settings)),
        }
    }

    /// Whether there is a horizontal position.
    pub fn has_position(&self, now_s: f64) -> bool {
        match self {
            Self::Ekf3(ekf) => ekf.has_position(now_s),
            Self::Ekf2(ekf) => ekf.has_position(now_s),
        }
    }

    /// Test ratios of the last velocity and position.
    pub fn ratios(&self) -> [f64; 2] {
        match self {
            Self::Ekf3(ekf) => ekf.ratios(),
            Self::Ekf2(ekf) => ekf.ratios(),
        }
    }

    fn failsafe(&self, now_s: f64) -> bool {
        match self {
            Self::Ekf3(ekf) => ekf.failsafe(now_s),
            Self::Ekf2(ekf) => ekf.failsafe(now_s),
        }
    }
}

/// What the double is made with.
#[derive(Clone, Debug, PartialEq)]
pub struct VehicleSetup {
    /// Whose rules.
    pub rules: AidingRules,
    /// The IMU.
    pub imu: ImuModel,
    /// Whether it carries a flow sensor and a rangefinder.
    pub sees: bool,
    /// The steady wind, NED, m/s.
    pub wind_ned: Vector3<f64>,
    /// What the pilot does.
    pub script: FlightScript,
    /// Time of a step, µs.
    pub step_us: i64,
    /// Everything random is drawn from this.
    pub seed: u64,
}

/// What the vehicle is doing.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum FlightMode {
    /// What the pilot's script says.
    Script,
    /// Landing because the script says so.
    Landing,
    /// Landing because the position is lost.
    FailsafeLanding,
}

/// Something that the autopilot tells in words.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Display)]
#[strum(serialize_all = "lowercase")]
pub enum VehicleNews {
    /// It armed.
    Armed,
    /// It disarmed.
    Disarmed,
    /// Arming was refused: external navigation is not healthy.
    #[strum(to_string = "arming refused: VisOdom: not healthy")]
    ExternalNotHealthy,
    /// Arming was refused: no position.
    #[strum(to_string = "arming refused: no position")]
    NoPosition,
    /// The origin was set.
    #[strum(to_string = "origin set")]
    OriginSet,
    /// The position is lost: it lands.
    #[strum(to_string = "failsafe: the position is lost, it lands")]
    Failsafe,
    /// The pilot selected this source set.
    #[strum(to_string = "source set {0} selected")]
    SetSelected(u8),
}

/// The world around the double, which it does not know.
#[derive(Clone, Debug)]
struct DoubleWorld {
    environment: Environment,
    frame: LocalNed,
    quad: Quadrotor,
    recent: RecentTruth,
    wind_ned: Vector3<f64>,
    gust_ned: Vector3<f64>,
    gusts: GaussMarkov,
    rng: SensorRng,
}

/// What it knows of where it is, and how.
#[derive(Clone, Debug)]
struct OwnNavigation {
    filter: OwnFilter,
    aiding: OwnAiding,
    counts: ExternalCounts,
    first_fix_s: Option<f64>,
    /// Its origin in the simulation's frame, and on the globe.
    origin: Option<(Vector3<f64>, Geodetic)>,
    baro_zero: (u32, f64),
}

/// An autopilot that is none. See the module.
#[derive(Clone, Debug)]
pub struct SimulatedAutopilot {
    setup: VehicleSetup,
    world: DoubleWorld,
    sensors: VehicleSensors,
    own: OwnNavigation,
    control: PositionControl,
    target: ControlTarget,
    /// Where it took off, in its own frame.
    home: Vector3<f64>,
    mode: FlightMode,
    armed: bool,
    landed_s: Option<f64>,
    now_us: i64,
    booted_us: i64,
    news: Vec<VehicleNews>,
}

impl OwnNavigation {
    fn new(rules: AidingRules, quad: &Quadrotor, seed: u64) -> Self {
        Self {
            filter: OwnFilter::at_rest(quad.truth().r_body_to_ned, seed),
            aiding: OwnAiding::new(rules),
            counts: ExternalCounts::default(),
            first_fix_s: None,
            origin: None,
            baro_zero: (0, 0.0),
        }
    }

    fn barometer(&mut self, now_s: f64, altitude_m: f64) {
        let (n, zero) = &mut self.baro_zero;
        if *n < BARO_ZERO_READINGS {
            *n += 1;
            *zero += (altitude_m - *zero) / f64::from(*n);
            return;
        }
        let value_ned = Vector3::new(0.0, 0.0, *zero - altitude_m);
        let variance = Vector3::repeat(BARO_NOISE_M.powi(2));
        self.filter.fuse(
            &AxisMeasurement { what: AxisQuantity::Position, value_ned, variance, time_s: now_s },
            &[2],
        );
    }

    /// Takes a fix; true when it made the origin.
    fn fix(&mut self, now_s: f64, fix: &GnssReading, frame: &LocalNed) -> bool {
        let since = *self.first_fix_s.get_or_insert(now_s);
        let makes_origin = self.origin.is_none() && now_s - since >= ORIGIN_AFTER_S;
        if makes_origin {
            self.origin = Some((fix.position_ned, frame.to_geodetic(&fix.position_ned)));
        }
        let Some((origin_ned, _)) = self.origin else { return false };
        let position = fix.position_ned - origin_ned;
        match &mut self.aiding {
            OwnAiding::Ekf3(ekf) => ekf.gps(now_s, &position, &fix.velocity_ned, &mut self.filter),
            OwnAiding::Ekf2(ekf) => ekf.gnss(now_s, &position, &fix.velocity_ned, &mut self.filter),
        }
        makes_origin
    }
}

impl SimulatedAutopilot {
    /// A vehicle that stands on the ground and boots.
    pub fn new(setup: VehicleSetup) -> Self {
        let scenario = Scenario::at_the_origin(LEGS_M, 0.0, None);
        let quad = Quadrotor::standing(QuadrotorModel::small(), 0.0);
        let frame = LocalNed::new(scenario.origin);
        let gusts = GaussMarkov { sigma: GUST_PART * setup.wind_ned.norm(), correlation: GUST_S };
        let environment = scenario.environment;
        let world = DoubleWorld {
            recent: RecentTruth::new(*quad.truth()),
            wind_ned: setup.wind_ned,
            gust_ned: Vector3::zeros(),
            rng: SensorRng::new(setup.seed, Stream::Wind),
            environment,
            frame,
            quad,
            gusts,
        };
        Self {
            sensors: VehicleSensors::new(setup.imu, setup.sees, setup.seed, &world.environment, &world.frame),
            own: OwnNavigation::new(setup.rules, &world.quad, setup.seed),
            world,
            control: PositionControl::new(),
            target: ControlTarget::Stopped,
            home: Vector3::zeros(),
            mode: FlightMode::Script,
            armed: false,
            landed_s: None,
            now_us: 0,
            booted_us: 0,
            news: Vec::new(),
            setup,
        }
    }

    /// Seconds since the simulation began.
    pub fn now_s(&self) -> f64 {
        self.now_us as f64 * 1e-6
    }

    /// Its clock: microseconds since it booted.
    pub fn boot_time(&self) -> AutopilotTime {
        AutopilotTime::from_micros(self.now_us - self.booted_us)
    }

    /// Goes on by one step.
    pub fn step(&mut self) {
        let from_us = self.now_us;
        self.now_us += self.setup.step_us;
        let (now_s, dt_s) = (self.now_s(), self.setup.step_us as f64 * 1e-6);
        let gravity = self.world.environment.gravity_mps2;
        let command = self.control.command(dt_s, &self.target, &self.own.filter, gravity);
        let world = &mut self.world;
        world.gust_ned = world.gusts.next3(&world.gust_ned, dt_s, &world.rng.normals());
        let wind = world.wind_ned + Vector3::new(world.gust_ned.x, world.gust_ned.y, 0.0);
        let truth = world.quad.step(dt_s, &command, &world.environment, &wind);
        world.recent.push(truth);
        let when = (from_us, self.now_us, AutopilotTime::from_micros(self.now_us - self.booted_us));
        let new = self.sensors.read(&world.environment, &world.frame, &world.recent, &truth, when);
        let own = &mut self.own;
        if let Some(imu) = self.sensors.newest().imu {
            own.filter.predict(now_s, dt_s, &imu.specific_force.raw(), &truth.r_body_to_ned, gravity);
        }
        match &mut own.aiding {
            OwnAiding::Ekf3(ekf) => ekf.step(dt_s, &mut own.filter),
            OwnAiding::Ekf2(ekf) => ekf.step(now_s, dt_s, &mut own.filter),
        }
        if let Some(altitude_m) = new.altitude_m {
            own.barometer(now_s, altitude_m);
        }
        if new.fix.is_some_and(|fix| own.fix(now_s, &fix, &world.frame)) {
            self.news.push(VehicleNews::OriginSet);
        }
        self.fly(now_s);
    }

    /// The pilot, the failsafes and the landing.
    fn fly(&mut self, now_s: f64) {
        let view = ScriptView {
            now_s,
            armed: self.armed,
            way_ned: self.own.filter.position() - self.home,
            speed_mps: self.own.filter.velocity().norm(),
        };
        let order = self.setup.script.step(&view);
        self.obey(order);
        let in_air = self.armed && !self.world.quad.stands();
        if in_air && self.mode != FlightMode::FailsafeLanding && self.own.aiding.failsafe(now_s) {
            self.news.push(VehicleNews::Failsafe);
            self.land(FlightMode::FailsafeLanding);
        }
        if let ControlTarget::Descend { over, heading_rad } = self.target
            && !self.own.aiding.has_position(now_s)
            && over.is_some()
        {
            self.target = ControlTarget::Descend { over: None, heading_rad };
        }
        let down = self.mode != FlightMode::Script && self.armed && self.world.quad.stands();
        self.landed_s = if down { self.landed_s.or(Some(now_s)) } else { None };
        if self.landed_s.is_some_and(|t| now_s - t > DISARM_AFTER_S) {
            self.armed = false;
            self.target = ControlTarget::Stopped;
            self.news.push(VehicleNews::Disarmed);
        }
    }

    fn obey(&mut self, order: ScriptOrder) {
        match order {
            ScriptOrder::Nothing => {}
            ScriptOrder::Arm => drop(self.arm()),
            ScriptOrder::Be(place, heading_rad) if self.armed && self.mode == FlightMode::Script => {
                self.target = ControlTarget::Place { position: self.home + place, heading_rad };
            }
            ScriptOrder::Be(..) => {}
            ScriptOrder::Gnss(loss) => self.sensors.lose_gnss(loss),
            ScriptOrder::SelectSet(number) => drop(self.select_set(number)),
            ScriptOrder::Land if self.mode == FlightMode::Script => self.land(FlightMode::Landing),
            ScriptOrder::Land => {}
        }
    }

    fn land(&mut self, mode: FlightMode) {
        self.mode = mode;
        let heading_rad = match self.target {
            ControlTarget::Place { heading_rad, .. } | ControlTarget::Descend { heading_rad, .. } => {
                heading_rad
            }
            ControlTarget::Stopped => 0.0,
        };
        self.target = ControlTarget::Descend { over: Some(self.own.filter.position()), heading_rad };
    }

    /// Arms, or says why not.
    ///
    /// # Errors
    /// [`VehicleNews::ExternalNotHealthy`] and [`VehicleNews::NoPosition`].
    pub fn arm(&mut self) -> Result<(), VehicleNews> {
        let now_s = self.now_s();
        let deaf = matches!(&self.own.aiding, OwnAiding::Ekf3(ekf) if !ekf.external_is_healthy(now_s));
        let refusal = if deaf {
            Some(VehicleNews::ExternalNotHealthy)
        } else {
            (!self.own.aiding.has_position(now_s)).then_some(VehicleNews::NoPosition)
        };
        if let Some(refusal) = refusal {
            self.news.push(refusal);
            return Err(refusal);
        }
        if !self.armed {
            self.armed = true;
            self.home = self.own.filter.position();
            self.news.push(VehicleNews::Armed);
        }
        Ok(())
    }

    /// A message of external navigation.
    pub fn external(&mut self, pose: &ExternalPose, stamps_believed: bool) {
        let own = &mut self.own;
        let fate = match &mut own.aiding {
            OwnAiding::Ekf3(ekf) => ekf.external(pose, &mut own.filter),
            OwnAiding::Ekf2(ekf) => ekf.external(pose, stamps_believed, &mut own.filter),
        };
        own.counts.count(fate);
    }

    /// Selects a source set; false where there is none of this number.
    pub fn select_set(&mut self, number: u8) -> bool {
        let selected = match &mut self.own.aiding {
            OwnAiding::Ekf3(ekf) => ekf.select(number),
            OwnAiding::Ekf2(_) => false,
        };
        if selected {
            self.news.push(VehicleNews::SetSelected(number));
        }
        selected
    }

    /// MAV_CMD_EXTERNAL_POSITION_ESTIMATE: a place on the globe, good to `noise_m`; false where it is not taken.
    pub fn place(&mut self, place: &Geodetic, noise_m: f64) -> bool {
        let now_s = self.now_s();
        let (Some((origin_ned, _)), OwnAiding::Ekf3(ekf)) = (self.own.origin, &mut self.own.aiding) else {
            return false;
        };
        let position = self.world.frame.to_ned(place) - origin_ned;
        ekf.place(now_s, &position, noise_m, &mut self.own.filter)
    }

    /// Other parameters of aiding. Those of the other autopilot change nothing.
    pub fn set_rules(&mut self, rules: AidingRules) {
        self.setup.rules = rules;
        match (&mut self.own.aiding, rules) {
            (OwnAiding::Ekf3(ekf), AidingRules::Ekf3(settings)) => ekf.set(settings),
            (OwnAiding::Ekf2(ekf), AidingRules::Ekf2(settings)) => ekf.set(settings),
            _ => {}
        }
    }

    /// Boots anew: the estimate, the origin and the clock are forgotten. Refused while it is armed.
    pub fn reboot(&mut self) -> bool {
        if self.armed {
            return false;
        }
        self.booted_us = self.now_us;
        self.own = OwnNavigation::new(self.setup.rules, &self.world.quad, self.setup.seed);
        self.sensors.forget();
        true
    }

    /// The receiver has no fix, in this way, or has it again.
    pub fn lose_gnss(&mut self, loss: Option<OutageKind>) {
        self.sensors.lose_gnss(loss);
    }

    /// The truth, in the simulation's frame.
    pub fn truth(&self) -> &Truth {
        self.world.quad.truth()
    }

    /// The world it flies in.
    pub fn environment(&self) -> &Environment {
        &self.world.environment
    }

    /// The simulation's frame on the globe.
    pub fn frame(&self) -> &LocalNed {
        &self.world.frame
    }

    /// What it believes of itself.
    pub fn filter(&self) -> &OwnFilter {
        &self.own.filter
    }

    /// Its origin on the globe, once it has one.
    pub fn origin(&self) -> Option<Geodetic> {
        self.own.origin.map(|(_, place)| place)
    }

    /// How far its estimate is from the truth, NED, m: where the estimate says to be, the vehicle flies off by the opposite. `None` before
    /// there is an origin.
    pub fn estimate_error(&self) -> Option<Vector3<f64>> {
        let (origin_ned, _) = self.own.origin?;
        Some(self.own.filter.position() + origin_ned - self.truth().position_ned)
    }

    /// Whether the receiver has lost its fix.
    pub fn gnss_is_lost(&self) -> bool {
        self.sensors.gnss_is_lost()
    }

    /// How its estimate is aided.
    pub fn aiding(&self) -> &OwnAiding {
        &self.own.aiding
    }

    /// What became of the messages of external navigation since it booted.
    pub fn external_counts(&self) -> &ExternalCounts {
        &self.own.counts
    }

    /// What its sensors said last.
    pub fn newest(&self) -> &NewestSamples {
        self.sensors.newest()
    }

    /// What it is doing.
    pub fn mode(&self) -> FlightMode {
        self.mode
    }

    /// Whether it is armed.
    pub fn armed(&self) -> bool {
        self.armed
    }

    /// Whether it is in the air.
    pub fn in_air(&self) -> bool {
        !self.world.quad.stands()
    }

    /// Whether the script is over and the vehicle has landed.
    pub fn is_done(&self) -> bool {
        (self.setup.script.is_over() || self.mode == FlightMode::FailsafeLanding) && !self.armed
    }

    /// What happened since it was asked last.
    pub fn take_news(&mut self) -> Vec<VehicleNews> {
        std::mem::take(&mut self.news)
    }
}

#[cfg(test)]
mod tests;
