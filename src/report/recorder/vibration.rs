//! How the IMU shakes: the part of the specific force above 5 Hz, as ArduPilot's VIBE message has it, so that its limits hold here, too.

use nalgebra::Vector3;

use super::super::trace::Trace;
use crate::sample::ImuSample;
use crate::time::AutopilotTime;

/// What is slower is motion, Hz.
const MOTION_HZ: f64 = 5.0;
/// The squares of what is left are averaged below this, Hz.
const MEAN_HZ: f64 = 2.0;
/// A longer step is a hole, s.
const LONGEST_S: f64 = 0.5;
/// Over this the rate is counted, s.
const RATE_S: f64 = 1.0;

/// See the module's documentation.
#[derive(Clone, Debug)]
pub(in super::super) struct VibrationRecord {
    /// Along body x, y and z, m/s².
    pub(in super::super) axes: [Trace; 3],
    /// Samples a second.
    pub(in super::super) rate_hz: Trace,
    motion: Option<(AutopilotTime, Vector3<f64>)>,
    squares: Vector3<f64>,
    counted: (f64, u32),
}

/// Of a first-order low-pass.
fn gain(dt: f64, cutoff_hz: f64) -> f64 {
    dt / (dt + 1.0 / (std::f64::consts::TAU * cutoff_hz))
}

impl VibrationRecord {
    pub(super) fn new() -> Self {
        Self {
            axes: [(); 3].map(|()| Trace::new(LONGEST_S)),
            rate_hz: Trace::new(3.0 * RATE_S),
            motion: None,
            squares: Vector3::zeros(),
            counted: (f64::NEG_INFINITY, 0),
        }
    }

    pub(super) fn add(&mut self, t_s: f64, imu: &ImuSample) {
        let force = imu.specific_force.raw();
        if !force.iter().all(|v| v.is_finite()) {
            return;
        }
        self.count(t_s);
        let before = self.motion.filter(|(time, _)| {
            let dt = imu.time.seconds_since(*time);
            dt > 0.0 && dt < LONGEST_S
        });
        let Some((time, motion)) = before else {
            self.motion = Some((imu.time, force));
            self.squares = Vector3::zeros();
            return;
        };
        let dt = imu.time.seconds_since(time);
        let motion = motion + (force - motion) * gain(dt, MOTION_HZ);
        self.motion = Some((imu.time, motion));
        let rest = force - motion;
        self.squares += (rest.component_mul(&rest) - self.squares) * gain(dt, MEAN_HZ);
        for (trace, square) in self.axes.iter_mut().zip(self.squares.iter()) {
            trace.add(t_s, square.sqrt());
        }
    }

    fn count(&mut self, t_s: f64) {
        let (from_s, samples) = self.counted;
        if t_s - from_s >= RATE_S {
            if from_s.is_finite() {
                self.rate_hz.add(t_s, f64::from(samples) / (t_s - from_s));
            }
            self.counted = (t_s, 0);
        }
        self.counted.1 += 1;
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::geo::Body;

    #[test]
    fn a_shaking_axis_shows_its_root_mean_square_and_gravity_and_motion_do_not() {
        let mut record = VibrationRecord::new();
        for i in 0..20_000 {
            let t = f64::from(i) * 0.0025;
            // 4 m/s² at 80 Hz along z, 3 m/s² at 0.3 Hz along x.
            let force = Vector3::new(3.0 * (1.9 * t).sin(), 0.0, -9.8 + 4.0 * (502.7 * t).sin());
            let sample = ImuSample {
                time: AutopilotTime::from_micros((t * 1e6) as i64),
                angular_rate: Body::new(Vector3::zeros()),
                specific_force: Body::new(force),
            };
            record.add(t, &sample);
        }
        let at = |axis: usize| record.axes[axis].last().unwrap().1;
        assert!((at(2) - 4.0 / 2f64.sqrt()).abs() < 0.35, "{}", at(2));
        assert!(at(0) < 0.3 && at(1) < 1e-9, "{} {}", at(0), at(1));
        assert!((record.rate_hz.last().unwrap().1 - 400.0).abs() < 1.0);
    }
}
