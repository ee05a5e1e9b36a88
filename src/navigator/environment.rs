//! The local frame and what belongs to the place: gravity, the Earth's rate, and its magnetic field.

use nalgebra::Vector3;

use crate::geo::{
    Geodetic, LocalNed, NOMINAL_GRAVITY_MPS2, Ned, earth_rate_ned, gravity::gravity_ned, magnetic_field,
};
use crate::navigator::tuning::environment::{DEFAULT_YEAR, FARTHEST_ORIGIN_M, YEAR_TOLERANCE};

/// A place, as far as navigation is concerned.
#[derive(Clone, Debug)]
pub(super) struct LocalEnvironment {
    pub(super) frame: LocalNed,
    /// m/s².
    pub(super) gravity_ned: Vector3<f64>,
    /// rad/s.
    pub(super) earth_rate_ned: Vector3<f64>,
    /// T; `None` where the model has none.
    pub(super) field_ned: Option<Vector3<f64>>,
    /// Somebody has told where on Earth it is: a receiver, or the autopilot.
    pub(super) placed: bool,
}

impl LocalEnvironment {
    fn at(origin: Geodetic, decimal_year: f64) -> Self {
        Self {
            frame: LocalNed::new(origin),
            gravity_ned: gravity_ned(origin.latitude_rad, origin.height_m),
            earth_rate_ned: earth_rate_ned(origin.latitude_rad),
            field_ned: magnetic_field(&origin, decimal_year).ok().map(Ned::raw),
            placed: true,
        }
    }

    /// Somewhere: gravity is nominal, north is where the magnetic field points that was measured, NED, T.
    fn somewhere(field_ned: Vector3<f64>) -> Self {
        Self {
            frame: LocalNed::new(Geodetic { latitude_rad: 0.0, longitude_rad: 0.0, height_m: 0.0 }),
            gravity_ned: Vector3::new(0.0, 0.0, NOMINAL_GRAVITY_MPS2),
            earth_rate_ned: Vector3::zeros(),
            field_ned: Some(field_ned),
            placed: false,
        }
    }
}

/// The environment, once there is a place, and the date.
#[derive(Clone, Debug)]
pub(super) struct Surroundings {
    environment: Option<LocalEnvironment>,
    decimal_year: f64,
}

/// What a new origin means.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) enum OriginVerdict {
    /// It is no place, or too far away to be one.
    Implausible,
    /// It is where it was.
    Known,
    /// It is the first.
    First,
    /// It lies elsewhere: by this, NED, m.
    Moved(Vector3<f64>),
}

impl Surroundings {
    pub(super) fn new() -> Self {
        Self { environment: None, decimal_year: DEFAULT_YEAR }
    }

    pub(super) fn environment(&self) -> Option<&LocalEnvironment> {
        self.environment.as_ref()
    }

    /// What `origin` would change.
    pub(super) fn judge(&self, origin: &Geodetic) -> OriginVerdict {
        if !origin.is_plausible() {
            return OriginVerdict::Implausible;
        }
        match &self.environment {
            None => OriginVerdict::First,
            Some(e) if !e.placed => OriginVerdict::First,
            Some(e) if e.frame.origin() == *origin => OriginVerdict::Known,
            Some(e) => match e.frame.to_ned(origin) {
                moved if moved.norm() > FARTHEST_ORIGIN_M => OriginVerdict::Implausible,
                moved => OriginVerdict::Moved(moved),
            },
        }
    }

    /// Takes a place as the frame's origin.
    pub(super) fn settle(&mut self, origin: Geodetic) {
        self.environment = Some(LocalEnvironment::at(origin, self.decimal_year));
    }

    /// Nobody tells the place: a frame that begins where the vehicle is.
    pub(super) fn settle_somewhere(&mut self, field_ned: Vector3<f64>) {
        self.environment = Some(LocalEnvironment::somewhere(field_ned));
    }

    /// Nobody tells the place, but it should be near this one.
    pub(super) fn settle_about(&mut self, place: Geodetic) {
        self.environment =
            Some(LocalEnvironment { placed: false, ..LocalEnvironment::at(place, self.decimal_year) });
    }

    /// Whether it is known where on Earth the frame lies.
    pub(super) fn placed(&self) -> bool {
        self.environment.as_ref().is_some_and(|e| e.placed)
    }

    /// The date in force, as decimal year.
    pub(super) fn decimal_year(&self) -> f64 {
        self.decimal_year
    }

    /// The date, as decimal year.
    pub(super) fn set_date(&mut self, decimal_year: f64) {
        if (decimal_year - self.decimal_year).abs() > YEAR_TOLERANCE && decimal_year.is_finite() {
            self.decimal_year = decimal_year;
            if let Some(origin) = self.environment.as_ref().filter(|e| e.placed).map(|e| e.frame.origin()) {
                self.settle(origin);
            }
        }
    }
}
