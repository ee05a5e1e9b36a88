//! How late one sensor is after the inertial unit: its changes are compared with what the inertial unit says they were, at every lag.
//!
//! A sensor that tells at t what was at t − δ changes between two of its samples by what the integral of the inertial unit's rates says between
//! the two times δ earlier. The δ that leaves the smallest sum of squares is its lag: positive late, negative ahead.

use std::fmt;

use nalgebra::Vector3;

use crate::time::AutopilotTime;

/// Lags that are tried, s.
pub(super) const MOST_S: f64 = 1.0;
const STEPS: i32 = 100;
/// Rates are kept as integrals at this step, s, for so long: two hours.
const STEP_S: f64 = 0.02;
const MOST_STEPS: usize = 360_000;
/// A longer time between two samples of the inertial unit is a hole: nothing is integrated over it, s.
const HOLE_S: f64 = 0.5;
/// Pairs of samples that are kept: an hour of five a second.
const MOST_PAIRS: usize = 20_000;
/// A lag is told from so many pairs on, where it explains so much of their changes, and where it stands out against other lags.
const LEAST_PAIRS: usize = 30;
const EXPLAINED: f64 = 0.6;
const STANDS_OUT: f64 = 1.5;

/// An integral over time.
#[derive(Clone, Debug, Default)]
pub(super) struct Integral {
    start: Option<AutopilotTime>,
    last: Option<(AutopilotTime, Vector3<f64>)>,
    sum: Vector3<f64>,
    values: Vec<[f32; 3]>,
}

impl Integral {
    /// Goes on to `time` with this rate.
    pub(super) fn add(&mut self, time: AutopilotTime, rate: Vector3<f64>) {
        let start = *self.start.get_or_insert(time);
        if let Some((before, rate_before)) = self.last.replace((time, rate)) {
            let dt = time.seconds_since(before);
            if dt <= 0.0 {
                return;
            }
            let (from, sum) = (before.seconds_since(start), self.sum);
            let mean = if dt < HOLE_S { (rate + rate_before) * 0.5 } else { Vector3::zeros() };
            self.sum += mean * dt;
            // Every step up to here, on the line between the two.
            while self.values.len() < MOST_STEPS {
                let into = self.values.len() as f64 * STEP_S - from;
                if into > dt {
                    break;
                }
                let value = sum + mean * into.max(0.0);
                self.values.push([value.x as f32, value.y as f32, value.z as f32]);
            }
        }
    }

    /// Its value; `None` outside of what is kept.
    fn at(&self, time: AutopilotTime, earlier_s: f64) -> Option<Vector3<f64>> {
        let steps = (time.seconds_since(self.start?) - earlier_s) / STEP_S;
        if steps < 0.0 {
            return None;
        }
        let (i, part) = (steps as usize, steps.fract());
        let value = |i: usize| self.values.get(i).map(|v| Vector3::from(v.map(f64::from)));
        Some(value(i)? * (1.0 - part) + value(i + 1)? * part)
    }
}

/// Two samples that follow each other, what changed, and what the integral is turned into that by.
#[derive(Clone, Copy, Debug)]
pub(super) struct SensorChange {
    pub(super) from: AutopilotTime,
    pub(super) to: AutopilotTime,
    pub(super) by: Vector3<f64>,
    /// For what turns with the vehicle: the vector that turns. Else the change is the integral's own.
    pub(super) turned: Option<Vector3<f64>>,
}

/// The changes of one sensor.
#[derive(Clone, Debug, Default)]
pub(super) struct Changes {
    pairs: Vec<SensorChange>,
    seen: u64,
}

/// A lag that was found, s, with its standard deviation.
#[derive(Clone, Copy, Debug, PartialEq, serde::Serialize)]
pub(super) struct SensorLag {
    pub(super) late_s: f64,
    pub(super) sigma_s: f64,
}

impl fmt::Display for SensorLag {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let (late_ms, sigma_ms) = (1e3 * self.late_s, 1e3 * self.sigma_s);
        let how = if late_ms < 0.0 { "ahead of" } else { "behind" };
        write!(f, "{:.0} +- {sigma_ms:.0} ms {how} the IMU, by its motion", late_ms.abs())
    }
}

impl Changes {
    /// Notes a change; of very many only some.
    pub(super) fn add(&mut self, change: SensorChange) {
        self.seen += 1;
        if self.pairs.len() < MOST_PAIRS {
            self.pairs.push(change);
        } else if let Some(place) =
            self.pairs.get_mut((self.seen.wrapping_mul(0x9E37_79B9) as usize) % MOST_PAIRS)
        {
            *place = change;
        }
    }

    /// Mean of the squares that a lag leaves, of the horizontal components or of all.
    fn left(&self, of: &Integral, lag_s: f64) -> Option<(f64, f64, usize)> {
        let (mut left, mut whole, mut n) = (0.0, 0.0, 0);
        for c in &self.pairs {
            let (Some(a), Some(b)) = (of.at(c.from, lag_s), of.at(c.to, lag_s)) else { continue };
            let expected = match c.turned {
                // A field that stands still turns backwards in the body.
                Some(vector) => vector.cross(&(b - a)),
                None => Vector3::new(b.x - a.x, b.y - a.y, 0.0),
            };
            left += (c.by - expected).norm_squared();
            whole += c.by.norm_squared();
            n += 1;
        }
        (n >= LEAST_PAIRS).then(|| (left / n as f64, whole / n as f64, n))
    }

    /// The lag that explains the changes best; `None` where none does: a vehicle that hardly moves shows nothing.
    pub(super) fn lag(&self, of: &Integral) -> Option<SensorLag> {
        let step_s = 2.0 * MOST_S / f64::from(STEPS);
        let lag_s = |i: i32| -MOST_S + f64::from(i) * step_s;
        let all: Vec<(f64, f64, usize)> =
            (0..=STEPS).map(|i| self.left(of, lag_s(i))).collect::<Option<_>>()?;
        let (best, &(least, whole, n)) = all.iter().enumerate().min_by(|a, b| a.1.0.total_cmp(&b.1.0))?;
        let mut others: Vec<f64> = all.iter().map(|a| a.0).collect();
        others.sort_by(f64::total_cmp);
        let usual = others[others.len() / 2];
        if best == 0
            || best == all.len() - 1
            || least > (1.0 - EXPLAINED) * whole
            || usual < STANDS_OUT * least
        {
            return None;
        }
        let (before, after) = (all[best - 1].0, all[best + 1].0);
        let bend = before - 2.0 * least + after;
        if bend <= 0.0 {
            return None;
        }
        let shift = 0.5 * (before - after) / bend;
        // The curvature of the sum of squares over what is left is the information on the lag.
        let sigma_s = step_s * (2.0 * least / (bend * n as f64)).sqrt();
        Some(SensorLag { late_s: lag_s(best as i32) + shift * step_s, sigma_s: sigma_s.max(STEP_S / 4.0) })
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// A motion that never repeats within a second or so.
    fn rate(t: f64) -> Vector3<f64> {
        Vector3::new((0.9 * t).sin() + (2.3 * t).cos(), (1.7 * t).sin(), (0.4 * t).cos())
    }

    fn at(t: f64) -> AutopilotTime {
        AutopilotTime::from_micros((t * 1e6).round() as i64)
    }

    fn integral() -> Integral {
        let mut integral = Integral::default();
        (0..6000).for_each(|i| integral.add(at(f64::from(i) * 0.01), rate(f64::from(i) * 0.01)));
        integral
    }

    /// What a sensor tells that is late by this.
    fn told(late_s: f64, noise: f64) -> Changes {
        let sum = |t: f64| {
            Vector3::new(-(0.9 * t).cos() / 0.9 + (2.3 * t).sin() / 2.3, -(1.7 * t).cos() / 1.7, 0.0)
        };
        let mut changes = Changes::default();
        for i in 10..270 {
            let (a, b) = (f64::from(i) * 0.2, f64::from(i + 1) * 0.2);
            let by = sum(b - late_s) - sum(a - late_s)
                + Vector3::new(noise * (f64::from(i) * 7.7).sin(), 0.0, 0.0);
            changes.add(SensorChange { from: at(a), to: at(b), by, turned: None });
        }
        changes
    }

    #[test]
    fn late_and_early_sensors_are_found() {
        let integral = integral();
        for late_s in [-0.4, -0.05, 0.0, 0.13, 0.37, 0.8] {
            let lag = told(late_s, 0.02).lag(&integral).unwrap();
            assert!((lag.late_s - late_s).abs() < 0.02, "{late_s}: {lag:?}");
            assert!(lag.sigma_s < 0.05);
        }
    }

    #[test]
    fn noise_has_no_lag() {
        let mut noise = Changes::default();
        for i in 10..270 {
            let (a, b) = (f64::from(i) * 0.2, f64::from(i + 1) * 0.2);
            let by = Vector3::new((f64::from(i) * 12.9).sin(), (f64::from(i) * 78.2).cos(), 0.0);
            noise.add(SensorChange { from: at(a), to: at(b), by, turned: None });
        }
        assert_eq!(noise.lag(&integral()), None);
        assert_eq!(Changes::default().lag(&integral()), None);
        assert_eq!(told(0.1, 0.0).lag(&Integral::default()), None);
    }

    #[test]
    fn a_field_that_stands_still_turns_in_the_body() {
        // A slow turn about z, of a field that points forward at first; the magnetometer is 0.1 s late.
        let mut integral = Integral::default();
        let yaw = |t: f64| 0.8 * (0.7 * t).sin() + 0.4 * (1.9 * t).sin();
        let turn = |t: f64| 0.56 * (0.7 * t).cos() + 0.76 * (1.9 * t).cos();
        (0..6000).for_each(|i| {
            let t = f64::from(i) * 0.01;
            integral.add(at(t), Vector3::new(0.0, 0.0, turn(t)));
        });
        let field = |t: f64| Vector3::new(yaw(t - 0.1).cos(), -yaw(t - 0.1).sin(), 0.5);
        let mut changes = Changes::default();
        for i in 10..550 {
            let (a, b) = (f64::from(i) * 0.1, f64::from(i + 1) * 0.1);
            let turned = Some((field(a) + field(b)) * 0.5);
            changes.add(SensorChange { from: at(a), to: at(b), by: field(b) - field(a), turned });
        }
        let lag = changes.lag(&integral).unwrap();
        assert!((lag.late_s - 0.1).abs() < 0.01, "{lag:?}");
    }
}
