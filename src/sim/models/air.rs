//! Barometer and airspeed.

use crate::geo::atmosphere::{density_ratio, static_pressure_pa};
use crate::sim::noise::{GaussMarkov, SensorRng, Stream};
use crate::sim::trajectory::Truth;
use nalgebra::Vector3;

/// Errors of a barometer, as height.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct BarometerModel {
    /// Time between samples, s.
    pub period_s: f64,
    /// White noise, m.
    pub noise_m: f64,
    /// Wander of the bias (temperature, wind on the ports), m.
    pub wander_m: GaussMarkov,
    /// What the weather makes pressure altitude differ from height by, size, m; not in [`BarometerReading::altitude_m`].
    pub weather_m: f64,
}

impl BarometerModel {
    /// No errors, 25 Hz.
    pub fn ideal() -> Self {
        Self { period_s: 0.04, noise_m: 0.0, wander_m: GaussMarkov::NONE, weather_m: 0.0 }
    }

    /// 0.3 m of noise on 0.5 m of wander over five minutes, 20 m of weather.
    pub fn small() -> Self {
        Self {
            noise_m: 0.3,
            wander_m: GaussMarkov { sigma: 0.5, correlation: 300.0 },
            weather_m: 20.0,
            ..Self::ideal()
        }
    }
}

/// What the barometer said.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct BarometerReading {
    /// Height over the origin when the weather is taken out (as an altimeter set on the ground), m.
    pub altitude_m: f64,
    /// Static pressure, Pa.
    pub pressure_pa: f64,
}

/// A barometer in flight.
#[derive(Clone, Debug)]
pub(in crate::sim) struct Barometer {
    model: BarometerModel,
    rng: SensorRng,
    weather_m: f64,
    wander_m: f64,
    origin_m: f64,
}

impl Barometer {
    /// `origin_m` is the origin's height above sea level.
    pub(in crate::sim) fn new(model: BarometerModel, seed: u64, origin_m: f64) -> Self {
        let mut rng = SensorRng::new(seed, Stream::Barometer);
        let weather_m = rng.signed(model.weather_m);
        Self { model, rng, weather_m, wander_m: 0.0, origin_m }
    }

    pub(in crate::sim) fn sample(&mut self, truth: &Truth) -> BarometerReading {
        let m = self.model;
        self.wander_m = m.wander_m.next(self.wander_m, m.period_s, self.rng.normal());
        let altitude_m = -truth.position_ned.z + self.wander_m + m.noise_m * self.rng.normal();
        let height = self.origin_m + altitude_m + self.weather_m;
        let pressure_pa = static_pressure_pa(height);
        BarometerReading { altitude_m, pressure_pa }
    }
}

/// Errors of an airspeed sensor, which measures dynamic pressure: equivalent airspeed, that is true airspeed times √(ρ/ρ₀) in the
/// standard atmosphere.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct AirspeedModel {
    /// Time between samples, s.
    pub period_s: f64,
    /// White noise, m/s.
    pub noise_mps: f64,
    /// Scale error, size.
    pub scale: f64,
    /// Gusts an axis, m/s. The vehicle's path does not feel them, its airspeed does.
    pub gusts_mps: GaussMarkov,
}

impl AirspeedModel {
    /// A pitot tube: 0.3 m/s of noise, 2 % of scale, gusts of 0.6 m/s over 4 s.
    pub fn pitot() -> Self {
        Self {
            period_s: 0.1,
            noise_mps: 0.3,
            scale: 0.02,
            gusts_mps: GaussMarkov { sigma: 0.6, correlation: 4.0 },
        }
    }
}

/// An airspeed sensor in flight.
#[derive(Clone, Debug)]
pub(in crate::sim) struct Airspeed {
    model: AirspeedModel,
    rng: SensorRng,
    scale: f64,
    gust_ned: Vector3<f64>,
    origin_m: f64,
}

impl Airspeed {
    /// `origin_m` is the origin's height above sea level.
    pub(in crate::sim) fn new(model: AirspeedModel, seed: u64, origin_m: f64) -> Self {
        let mut rng = SensorRng::new(seed, Stream::Airspeed);
        let scale = rng.signed(model.scale);
        let gust_ned = rng.normals() * model.gusts_mps.sigma;
        Self { model, rng, scale, gust_ned, origin_m }
    }

    /// Equivalent airspeed, m/s.
    pub(in crate::sim) fn sample(&mut self, wind_ned: &Vector3<f64>, truth: &Truth) -> f64 {
        let m = self.model;
        self.gust_ned = m.gusts_mps.next3(&self.gust_ned, m.period_s, &self.rng.normals());
        let noise = m.noise_mps * self.rng.normal();
        let density = density_ratio(self.origin_m - truth.position_ned.z);
        let through_air = (truth.velocity_ned - wind_ned - self.gust_ned).norm();
        (1.0 + self.scale) * through_air * density.sqrt() + noise
    }
}
