//! The published altimeters on a vehicle's own sensors: samples come when they come, and the inertial altitude is integrated here.

use super::error_model::ErrorModel;
use super::ibig::{AltimeterMethod, AltimeterScheme, PublishedAltimeter};
use super::tuning::LEAST_PROB;
use crate::altimeter::Channel;
use crate::altimeter::HeightVerdict;

/// The published altimeter over a free-running inertial altitude, H = H_I − ΔH, (21).
///
/// H_I is the vertical specific force integrated twice and never corrected: its error is what the filters estimate. The barometer's
/// height is counted from where the height was when it was first heard.
#[derive(Clone, Debug)]
pub struct BaselineAltimeter {
    altimeter: PublishedAltimeter,
    started: bool,
    /// H_I and its rate, m and m/s.
    inertial: (f64, f64),
    /// Time since the last measurement, s.
    pending_s: f64,
    /// Pressure altitude less height, when the barometer was first heard, m.
    baro_zero_m: Option<f64>,
}

impl BaselineAltimeter {
    /// An altimeter that waits for its first height.
    pub fn new(model: ErrorModel, method: AltimeterMethod) -> Self {
        Self {
            altimeter: PublishedAltimeter::new(model, method),
            started: false,
            inertial: (0.0, 0.0),
            pending_s: 0.0,
            baro_zero_m: None,
        }
    }

    /// Height above the origin, m, once a source has given it.
    pub fn height_m(&self) -> Option<f64> {
        let error =
            self.altimeter.estimate(AltimeterScheme::Ibig).delta_h_m + self.pending_s * self.speed_error();
        self.started.then_some(self.inertial.0 - error)
    }

    /// Climb rate, m/s: by the channel that knows the height better.
    pub fn climb_mps(&self) -> f64 {
        self.inertial.1 - self.speed_error()
    }

    fn speed_error(&self) -> f64 {
        let (ibi, iig) = self.altimeter.channels();
        if ibi.variance() < iig.variance() { ibi.state()[1] } else { iig.state()[1] }
    }

    /// Standard deviation of the height, m.
    pub fn height_sigma_m(&self) -> f64 {
        self.altimeter.estimate(AltimeterScheme::Ibig).variance_m2.max(0.0).sqrt()
    }

    /// Standard deviation of the climb rate, m/s.
    pub fn climb_sigma_mps(&self) -> f64 {
        let (ibi, iig) = self.altimeter.channels();
        ibi.covariance()[(1, 1)].min(iig.covariance()[(1, 1)]).max(0.0).sqrt()
    }

    /// What comes on a channel is another sensor's from now on: the barometer's height is counted anew.
    pub fn another(&mut self, channel: Channel) {
        if channel == Channel::Baro {
            self.baro_zero_m = None;
        }
    }

    /// The origin has moved up by `up_m`: heights above it become smaller.
    pub fn shift_origin(&mut self, up_m: f64) {
        self.inertial.0 -= up_m;
        self.baro_zero_m = self.baro_zero_m.map(|z| z + up_m);
    }

    /// Integrates the upward acceleration `accel_up` (m/s², gravity taken out) over `dt` seconds.
    pub fn predict(&mut self, dt: f64, accel_up: f64) {
        if dt > 0.0 && dt.is_finite() && accel_up.is_finite() {
            self.inertial.0 += dt * (self.inertial.1 + 0.5 * dt * accel_up);
            self.inertial.1 += dt * accel_up;
            self.pending_s += dt;
        }
    }

    /// A channel's height, m, measured `age_s` ago. The published altimeters know of a barometer and of GNSS; `None` for other channels.
    pub fn measure(&mut self, channel: Channel, height_m: f64, age_s: f64) -> Option<HeightVerdict> {
        let y = height_m + self.climb_mps() * age_s;
        if !y.is_finite() {
            return Some(HeightVerdict::Rejected(f64::NAN));
        }
        if !self.started {
            self.started = true;
            self.pending_s = 0.0;
            self.inertial = (if channel == Channel::Gnss { y } else { 0.0 }, 0.0);
        }
        let z = |height: f64| Some(self.inertial.0 - height);
        let (z_ibi, z_iig) = match channel {
            Channel::Baro => {
                let height = self.height_m().unwrap_or_default();
                (z(y - *self.baro_zero_m.get_or_insert(y - height)), None)
            }
            Channel::Gnss => (None, z(y)),
            Channel::SecondBaro | Channel::Range => return None,
        };
        let report = self.altimeter.step(std::mem::take(&mut self.pending_s), z_ibi, z_iig);
        let innovation = report.ibi.or(report.iig);
        Some(innovation.map_or(HeightVerdict::Rejected(f64::NAN), |i| {
            if i.prob < LEAST_PROB {
                HeightVerdict::Rejected(i.normalised)
            } else {
                HeightVerdict::Used { weight: i.prob, normalised: i.normalised }
            }
        }))
    }
}
