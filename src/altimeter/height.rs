//! A Kalman filter for height from the vertical specific force, the barometer and GNSS.
//!
//! State x = [h, w, b_a, b_B]: height above the origin (m, up), climb rate (m/s), bias of the vertical acceleration (m/s²), and
//! the barometer's offset (m). With the upward acceleration a = −(R f + g)_D:
//!
//! ḣ = w,  ẇ = a − b_a,  b_a and b_B random walks;  z_B = h + b_B,  z_G = h.
//!
//! This is the joint form of the baro-inertial and inertial-GNSS channels of Contreras and Hajiyev (models (11)-(13) and (18)): both
//! measurements share one inertial error, so they belong into one filter. A measurement whose normalised innovation is out of
//! bounds is rejected; the barometer's offset takes a lasting step of the barometer, so that the height itself goes on without one.

use nalgebra::{Matrix4, RowVector4, Vector4};

/// Noise and gates.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct HeightSettings {
    /// Noise density of the vertical acceleration, m/s²/√Hz.
    pub accel_noise: f64,
    /// Random walk of the acceleration bias, m/s³/√Hz.
    pub accel_bias_walk: f64,
    /// Noise of one barometer sample, m.
    pub baro_noise_m: f64,
    /// Random walk of the barometer's offset (weather, temperature), m/√s.
    pub baro_offset_walk: f64,
    /// Noise of one GNSS height, m: the floor under what the receiver claims.
    pub gnss_noise_m: f64,
    /// Innovations beyond this many sigmas are rejected.
    pub gate_sigma: f64,
    /// A barometer that is rejected for this long, while nothing else disputes the height, has changed its offset, s.
    pub baro_relock_s: f64,
}

/// What became of a height measurement.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum HeightVerdict {
    /// Used; the innovation over its standard deviation.
    Used(f64),
    /// Rejected; the innovation over its standard deviation.
    Rejected(f64),
    /// The barometer's offset was set anew: it had stepped by this many metres. The height did not move.
    OffsetReset(f64),
}

/// See the module's documentation.
#[derive(Clone, Debug)]
pub struct HeightFilter {
    settings: HeightSettings,
    x: Vector4<f64>,
    p: Matrix4<f64>,
    started: bool,
    baro_started: bool,
    baro_rejected_s: f64,
    last_baro_m: Option<f64>,
    /// The barometer's rejection began with a step of its own.
    baro_stepped: bool,
    gnss_quiet_s: f64,
    baro_quiet_s: f64,
}

const H_BARO: RowVector4<f64> = RowVector4::new(1.0, 0.0, 0.0, 1.0);
const H_GNSS: RowVector4<f64> = RowVector4::new(1.0, 0.0, 0.0, 0.0);
/// Longest step of the prediction, s: a hole in the stream is bridged in steps.
const MAX_STEP_S: f64 = 0.1;
/// Nothing else disputes the height when no GNSS height was used for this long, s.
const GNSS_QUIET_S: f64 = 2.0;
/// There is no barometer when none was heard for this long, s.
const BARO_QUIET_S: f64 = 5.0;
/// Steps below this are not told from noise, m.
const STEP_FLOOR_M: f64 = 2.0;
/// An inertial height that is off by 1 m has a climb rate that is off by this, 1/s.
const ASTRAY_RATE: f64 = 0.5;

impl HeightFilter {
    /// A filter that waits for its first height.
    pub fn new(settings: HeightSettings) -> Self {
        Self {
            settings,
            x: Vector4::zeros(),
            p: Matrix4::from_diagonal(&Vector4::new(1e4, 4.0, 0.04, 1e8)),
            started: false,
            baro_started: false,
            baro_rejected_s: 0.0,
            last_baro_m: None,
            baro_stepped: false,
            gnss_quiet_s: f64::INFINITY,
            baro_quiet_s: f64::INFINITY,
        }
    }

    /// Height above the origin, m, once a source has given it.
    pub fn height_m(&self) -> Option<f64> {
        self.started.then_some(self.x[0])
    }

    /// Climb rate, m/s.
    pub fn climb_mps(&self) -> f64 {
        self.x[1]
    }

    /// Standard deviation of the height, m.
    pub fn height_sigma_m(&self) -> f64 {
        self.p[(0, 0)].max(0.0).sqrt()
    }

    /// Standard deviation of the climb rate, m/s.
    pub fn climb_sigma_mps(&self) -> f64 {
        self.p[(1, 1)].max(0.0).sqrt()
    }

    /// The barometer's offset: pressure altitude less height, m.
    pub fn baro_offset_m(&self) -> Option<f64> {
        self.baro_started.then_some(self.x[3])
    }

    /// The origin has moved up by `up_m`: heights above it become smaller.
    pub fn shift_origin(&mut self, up_m: f64) {
        if self.started {
            self.x[0] -= up_m;
            self.x[3] += up_m;
        }
    }

    /// Predicts over `dt` seconds with the upward acceleration `accel_up` (m/s², gravity taken out).
    pub fn predict(&mut self, dt: f64, accel_up: f64) {
        if !(dt > 0.0 && accel_up.is_finite()) {
            return;
        }
        self.gnss_quiet_s += dt;
        self.baro_quiet_s += dt;
        let steps = (dt / MAX_STEP_S).ceil().clamp(1.0, 100.0);
        for _ in 0..steps as usize {
            self.predict_step(dt / steps, accel_up);
        }
    }

    fn predict_step(&mut self, dt: f64, accel_up: f64) {
        let a = accel_up - self.x[2];
        self.x[0] += dt * (self.x[1] + 0.5 * dt * a);
        self.x[1] += dt * a;
        let mut phi = Matrix4::identity();
        phi[(0, 1)] = dt;
        phi[(0, 2)] = -0.5 * dt * dt;
        phi[(1, 2)] = -dt;
        let s = &self.settings;
        self.p = phi * self.p * phi.transpose();
        self.p[(1, 1)] += s.accel_noise * s.accel_noise * dt;
        self.p[(2, 2)] += s.accel_bias_walk * s.accel_bias_walk * dt;
        self.p[(3, 3)] += s.baro_offset_walk * s.baro_offset_walk * dt;
    }

    /// A pressure altitude, m, `interval_s` after the last one, measured `age_s` ago.
    pub fn baro(&mut self, altitude_m: f64, interval_s: f64, age_s: f64) -> HeightVerdict {
        if altitude_m.is_finite() {
            self.baro_quiet_s = 0.0;
        }
        if !self.baro_started {
            self.baro_started = true;
            if !self.started {
                self.started = true;
                self.x[0] = 0.0;
            }
            self.set_offset(altitude_m);
            return HeightVerdict::Used(0.0);
        }
        let z = altitude_m + self.x[1] * age_s;
        // A step of the barometer comes from one sample to the next; an inertial height that has gone astray comes slowly.
        let predicted = self.x[1] * interval_s;
        let noise = self.settings.gate_sigma * self.settings.baro_noise_m * std::f64::consts::SQRT_2;
        if self.last_baro_m.is_some_and(|last| (altitude_m - last - predicted).abs() > noise + STEP_FLOOR_M) {
            self.baro_stepped = true;
        }
        if altitude_m.is_finite() {
            self.last_baro_m = Some(altitude_m);
        }
        let mut verdict = self.update(&H_BARO, z, self.settings.baro_noise_m);
        if let HeightVerdict::Rejected(_) = verdict
            && !self.baro_stepped
            && z.is_finite()
            && self.gnss_quiet_s > GNSS_QUIET_S
        {
            // Nothing but the inertial height says otherwise: it has gone astray.
            let innovation = z - self.x[0] - self.x[3];
            self.p[(0, 0)] += innovation * innovation;
            self.p[(1, 1)] += innovation * innovation * ASTRAY_RATE * ASTRAY_RATE;
            verdict = self.update(&H_BARO, z, self.settings.baro_noise_m);
        }
        match verdict {
            HeightVerdict::Rejected(_) => {
                self.baro_rejected_s += interval_s;
                if self.baro_rejected_s > self.settings.baro_relock_s && self.gnss_quiet_s > GNSS_QUIET_S {
                    let step = z - self.x[0] - self.x[3];
                    self.set_offset(z);
                    return HeightVerdict::OffsetReset(step);
                }
            }
            _ => {
                self.baro_rejected_s = 0.0;
                self.baro_stepped = false;
            }
        }
        verdict
    }

    /// The next pressure altitude is another barometer's: its offset is found anew, the height stays.
    pub fn another_barometer(&mut self) {
        self.baro_started = false;
        self.last_baro_m = None;
    }

    /// Puts all of a pressure altitude's disagreement into the offset. The height stays.
    fn set_offset(&mut self, altitude_m: f64) {
        self.x[3] = altitude_m - self.x[0];
        self.baro_rejected_s = 0.0;
        self.baro_stepped = false;
        for i in 0..3 {
            self.p[(i, 3)] = -self.p[(i, 0)];
            self.p[(3, i)] = -self.p[(0, i)];
        }
        self.p[(3, 3)] = self.p[(0, 0)] + self.settings.baro_noise_m * self.settings.baro_noise_m;
    }

    /// A GNSS height above the origin, m, with the receiver's standard deviation, measured `age_s` ago.
    pub fn gnss(&mut self, height_m: f64, sigma_m: f64, age_s: f64) -> HeightVerdict {
        let sigma = sigma_m.max(self.settings.gnss_noise_m);
        if !self.started {
            self.started = true;
            self.x[0] = height_m;
            self.p[(0, 0)] = sigma * sigma;
            self.gnss_quiet_s = 0.0;
            return HeightVerdict::Used(0.0);
        }
        let z = height_m + self.x[1] * age_s;
        let mut verdict = self.update(&H_GNSS, z, sigma);
        if matches!(verdict, HeightVerdict::Rejected(_))
            && z.is_finite()
            && self.gnss_quiet_s > GNSS_QUIET_S
            && self.baro_quiet_s > BARO_QUIET_S
        {
            // No barometer: nothing but the inertial height says otherwise, and it has gone astray.
            let innovation = z - self.x[0];
            self.p[(0, 0)] += innovation * innovation;
            self.p[(1, 1)] += innovation * innovation * ASTRAY_RATE * ASTRAY_RATE;
            verdict = self.update(&H_GNSS, z, sigma);
        }
        if matches!(verdict, HeightVerdict::Used(_)) {
            self.gnss_quiet_s = 0.0;
        }
        verdict
    }

    /// The scalar update in Joseph's form, P ← (I − KH)P(I − KH)ᵀ + KRKᵀ, which keeps P symmetric and positive.
    fn update(&mut self, h: &RowVector4<f64>, z: f64, sigma: f64) -> HeightVerdict {
        let r = sigma * sigma;
        let ph = self.p * h.transpose();
        let s = (h * ph)[0] + r;
        let innovation = z - (h * self.x)[0];
        let normalised = innovation / s.sqrt();
        if !normalised.is_finite() || normalised.abs() > self.settings.gate_sigma {
            return HeightVerdict::Rejected(normalised);
        }
        let k = ph / s;
        let i_kh = Matrix4::identity() - k * h;
        self.x += k * innovation;
        self.p = i_kh * self.p * i_kh.transpose() + k * r * k.transpose();
        HeightVerdict::Used(normalised)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn settings() -> HeightSettings {
        HeightSettings {
            accel_noise: 0.1,
            accel_bias_walk: 0.002,
            baro_noise_m: 0.3,
            baro_offset_walk: 0.02,
            gnss_noise_m: 1.5,
            gate_sigma: 5.0,
            baro_relock_s: 5.0,
        }
    }

    /// Climbs at 1 m/s with a biased accelerometer; the barometer reads 300 m too much.
    fn fly(filter: &mut HeightFilter, from_s: f64, to_s: f64, gnss: bool, baro_extra: f64) -> f64 {
        let dt = 0.01;
        let mut t = from_s;
        let mut k = 0u32;
        while t < to_s - 1e-9 {
            t += dt;
            k += 1;
            filter.predict(dt, 0.05);
            if k.is_multiple_of(4) {
                filter.baro(t + 300.0 + baro_extra, 0.04, 0.0);
            }
            if gnss && k.is_multiple_of(20) {
                filter.gnss(t, 1.0, 0.0);
            }
        }
        t
    }

    #[test]
    fn without_a_barometer_gnss_leads_an_inertial_height_that_went_astray() {
        let mut f = HeightFilter::new(settings());
        f.gnss(100.0, 1.0, 0.0);
        // Ten seconds with a wrong tilt.
        for _ in 0..1000 {
            f.predict(0.01, 4.0);
        }
        assert!((f.height_m().unwrap() - 300.0).abs() < 20.0);
        for _ in 0..50 {
            for _ in 0..10 {
                f.predict(0.01, 0.0);
            }
            f.gnss(100.0, 1.0, 0.0);
        }
        assert!((f.height_m().unwrap() - 100.0).abs() < 2.0, "{:?}", f.height_m());
    }

    #[test]
    fn height_climb_bias_and_offset_are_found() {
        let mut f = HeightFilter::new(settings());
        f.gnss(0.0, 1.0, 0.0);
        let t = fly(&mut f, 0.0, 120.0, true, 0.0);
        assert!((f.height_m().unwrap() - t).abs() < 0.2);
        assert!((f.climb_mps() - 1.0).abs() < 0.05);
        assert!((f.x[2] - 0.05).abs() < 0.01);
        assert!((f.baro_offset_m().unwrap() - 300.0).abs() < 0.3);
    }

    #[test]
    fn the_height_goes_on_when_gnss_ends() {
        let mut f = HeightFilter::new(settings());
        f.gnss(0.0, 1.0, 0.0);
        let t = fly(&mut f, 0.0, 60.0, true, 0.0);
        let sigma = f.height_sigma_m();
        let t = fly(&mut f, t, t + 60.0, false, 0.0);
        assert!((f.height_m().unwrap() - t).abs() < 0.5);
        assert!(f.height_sigma_m() > sigma);
    }

    #[test]
    fn a_step_of_the_barometer_is_not_a_step_of_the_height() {
        let mut f = HeightFilter::new(settings());
        f.gnss(0.0, 1.0, 0.0);
        let t = fly(&mut f, 0.0, 60.0, true, 0.0);
        let t = fly(&mut f, t, t + 30.0, false, 25.0);
        assert!((f.height_m().unwrap() - t).abs() < 2.0, "{} at {t}", f.height_m().unwrap());
        assert!((f.baro_offset_m().unwrap() - 325.0).abs() < 2.0);
    }

    #[test]
    fn a_gnss_height_jump_is_rejected() {
        let mut f = HeightFilter::new(settings());
        f.gnss(0.0, 1.0, 0.0);
        let t = fly(&mut f, 0.0, 60.0, true, 0.0);
        assert!(matches!(f.gnss(t - 88.0, 2.0, 0.0), HeightVerdict::Rejected(_)));
    }

    #[test]
    fn nothing_wild_gets_in() {
        let mut f = HeightFilter::new(settings());
        f.gnss(0.0, 1.0, 0.0);
        fly(&mut f, 0.0, 5.0, true, 0.0);
        let before = f.x;
        f.predict(f64::NAN, 1.0);
        f.predict(0.01, f64::NAN);
        assert!(matches!(f.baro(f64::NAN, 0.04, 0.0), HeightVerdict::Rejected(_)));
        assert_eq!(f.x, before);
    }
}
