//! What a fault makes of the numbers of a sample.

use nalgebra::Vector3;

use crate::geo::Body;
use crate::geo::atmosphere::{pressure_altitude_m, static_pressure_pa};
use crate::sample::Sample;

use super::target::{Sensor, Target};

/// What becomes of one number, in the target's unit: its index and its value.
pub(super) type Change<'a> = &'a mut dyn FnMut(usize, f64) -> f64;

/// Changes the numbers of a sample that the target names. A barometer's is its pressure altitude, m.
pub(super) fn numbers(target: &Target, sample: &mut Sample, change: Change<'_>) {
    match sample {
        Sample::Imu(s) => {
            if target.sensor != Sensor::Accel {
                let mut v = s.angular_rate.raw();
                vector(target, &mut v, change);
                s.angular_rate = Body::new(v);
            }
            if target.sensor != Sensor::Gyro {
                let mut v = s.specific_force.raw();
                vector(target, &mut v, change);
                s.specific_force = Body::new(v);
            }
        }
        Sample::Mag(s) => {
            let mut v = s.field.raw();
            vector(target, &mut v, change);
            s.field = Body::new(v);
        }
        Sample::Pressure(s) => {
            let altitude = pressure_altitude_m(s.pressure_pa).unwrap_or(f64::NAN);
            s.pressure_pa = static_pressure_pa(change(0, altitude));
        }
        Sample::Flow(s) => {
            for (i, rate) in s.rate_xy.iter_mut().enumerate() {
                if target.axis.is_none_or(|axis| axis == i) {
                    *rate = change(i, *rate);
                }
            }
        }
        Sample::Range(s) => s.distance_m = change(0, s.distance_m),
        Sample::Airspeed(s) => s.airspeed_mps = change(0, s.airspeed_mps),
        Sample::Gnss(_) | Sample::Landmark(_) => {}
    }
}

fn vector(target: &Target, v: &mut Vector3<f64>, change: Change<'_>) {
    for i in 0..3 {
        if target.axis.is_none_or(|axis| axis == i) {
            v[i] = change(i, v[i]);
        }
    }
}

/// The vectors of a sample turned, or their x and y exchanged.
pub(super) fn whole(target: &Target, sample: &mut Sample, change: impl Fn(Vector3<f64>) -> Vector3<f64>) {
    match sample {
        Sample::Imu(s) => {
            if target.sensor != Sensor::Accel {
                s.angular_rate = Body::new(change(s.angular_rate.raw()));
            }
            if target.sensor != Sensor::Gyro {
                s.specific_force = Body::new(change(s.specific_force.raw()));
            }
        }
        Sample::Mag(s) => s.field = Body::new(change(s.field.raw())),
        Sample::Flow(s) => {
            let v = change(Vector3::new(s.rate_xy[0], s.rate_xy[1], 0.0));
            s.rate_xy = [v.x, v.y];
        }
        _ => {}
    }
}

/// What `held` said, told again with `sample`'s stamp; of an IMU only what the target names.
pub(super) fn told_again(target: &Target, held: &Sample, sample: &Sample) -> Sample {
    match (*held, *sample) {
        (Sample::Imu(h), Sample::Imu(s)) => {
            let mut told = Sample::Imu(s);
            let held_rate = h.angular_rate.raw();
            let held_force = h.specific_force.raw();
            if target.sensor != Sensor::Accel {
                let only = Target { sensor: Sensor::Gyro, ..*target };
                numbers(&only, &mut told, &mut |i, _| held_rate[i]);
            }
            if target.sensor != Sensor::Gyro {
                let only = Target { sensor: Sensor::Accel, ..*target };
                numbers(&only, &mut told, &mut |i, _| held_force[i]);
            }
            told
        }
        (Sample::Mag(h), Sample::Mag(_)) if target.axis.is_some() => {
            let (mut told, field) = (*sample, h.field.raw());
            numbers(target, &mut told, &mut |i, _| field[i]);
            told
        }
        (Sample::Flow(h), Sample::Flow(s)) if target.axis.is_some() => {
            let mut told = Sample::Flow(s);
            numbers(target, &mut told, &mut |i, _| h.rate_xy[i]);
            told
        }
        (Sample::Mag(h), Sample::Mag(s)) => Sample::Mag(crate::sample::MagSample { time: s.time, ..h }),
        (Sample::Gnss(h), Sample::Gnss(s)) => Sample::Gnss(crate::sample::GnssSample { time: s.time, ..h }),
        (Sample::Pressure(h), Sample::Pressure(s)) => {
            Sample::Pressure(crate::sample::PressureSample { time: s.time, ..h })
        }
        (Sample::Flow(h), Sample::Flow(s)) => {
            Sample::Flow(crate::sample::FlowSample { time: s.time, interval: s.interval, ..h })
        }
        (Sample::Range(h), Sample::Range(s)) => {
            Sample::Range(crate::sample::RangeSample { time: s.time, ..h })
        }
        (Sample::Airspeed(h), Sample::Airspeed(s)) => {
            Sample::Airspeed(crate::sample::AirspeedSample { time: s.time, ..h })
        }
        (Sample::Landmark(h), Sample::Landmark(s)) => {
            Sample::Landmark(crate::sample::LandmarkSample { time: s.time, ..h })
        }
        _ => *sample,
    }
}
