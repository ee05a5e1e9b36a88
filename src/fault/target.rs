//! Which sensor, and which of its axes, a fault is of.

use std::fmt;

use strum::VariantArray;

use crate::sample::Sample;

/// What can fail.
#[derive(Clone, Copy, Debug, PartialEq, Eq, strum::IntoStaticStr, strum::VariantArray)]
#[strum(serialize_all = "lowercase")]
pub enum Sensor {
    /// Every input at once: the link.
    All,
    /// Gyros and accelerometers.
    Imu,
    /// Gyros.
    Gyro,
    /// Accelerometers.
    Accel,
    /// Magnetometers.
    Mag,
    /// GNSS receivers.
    Gnss,
    /// Barometers.
    Baro,
    /// Optical flow.
    Flow,
    /// Rangefinders.
    Range,
    /// Pitot tube.
    Airspeed,
    /// Cameras that see landmarks.
    Landmark,
}

impl Sensor {
    /// All of them.
    pub const ALL: &'static [Self] = Self::VARIANTS;

    /// Its name in a fault's text.
    pub fn label(self) -> &'static str {
        self.into()
    }
}

/// A sensor, one of its kind or all of them, with one axis or all of them.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Target {
    /// What kind of sensor.
    pub sensor: Sensor,
    /// Which of its kind, as the table of sources numbers them; `None`: all.
    pub id: Option<u8>,
    /// Which axis, 0 to 2; `None`: all.
    pub axis: Option<usize>,
}

impl Target {
    /// Whether a sample is its.
    pub fn is_of(&self, sample: &Sample) -> bool {
        let (sensor, id) = match sample {
            Sample::Imu(_) => match self.sensor {
                Sensor::Gyro | Sensor::Accel => (self.sensor, 0),
                _ => (Sensor::Imu, 0),
            },
            Sample::Mag(s) => (Sensor::Mag, s.sensor),
            Sample::Gnss(s) => (Sensor::Gnss, s.receiver),
            Sample::Pressure(s) => (Sensor::Baro, s.sensor),
            Sample::Flow(s) => (Sensor::Flow, s.sensor),
            Sample::Range(s) => (Sensor::Range, s.sensor),
            Sample::Airspeed(_) => (Sensor::Airspeed, 0),
            Sample::Landmark(s) => (Sensor::Landmark, s.camera),
        };
        let kind = self.sensor == Sensor::All || self.sensor == sensor;
        kind && self.id.is_none_or(|wanted| wanted == id)
    }

    /// The unit of its values in a fault's text.
    pub fn unit(&self) -> &'static str {
        match self.sensor {
            Sensor::Gyro => "deg/s",
            Sensor::Accel => "m/s2",
            Sensor::Mag => "uT",
            Sensor::Gnss | Sensor::Baro | Sensor::Range => "m",
            Sensor::Flow => "rad/s",
            Sensor::Airspeed => "m/s",
            Sensor::All | Sensor::Imu | Sensor::Landmark => "",
        }
    }

    /// The unit in the unit that samples have.
    pub(super) fn in_si(&self) -> f64 {
        match self.sensor {
            Sensor::Gyro => std::f64::consts::PI / 180.0,
            Sensor::Mag => 1e-6,
            _ => 1.0,
        }
    }

    /// How many axes can be named.
    pub(super) fn axes(&self) -> usize {
        match self.sensor {
            Sensor::Gyro | Sensor::Accel | Sensor::Mag => 3,
            Sensor::Flow => 2,
            _ => 0,
        }
    }
}

impl fmt::Display for Target {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "{}", self.sensor.label())?;
        if let Some(id) = self.id {
            write!(f, "{id}")?;
        }
        match self.axis {
            Some(axis) => write!(f, ".{}", ["x", "y", "z"][axis.min(2)]),
            None => Ok(()),
        }
    }
}
