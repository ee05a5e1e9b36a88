//! Inertial units, magnetometers and barometers of a DataFlash log.

use nalgebra::Vector3;

use crate::time::AutopilotTime;
use crate::wire::counters::Cause;

use super::super::intake::vector;
use super::{ArduPilot, MessageMeaning, Told};

const TESLA_PER_MILLIGAUSS: f64 = 1e-7;
/// Single samples of a sensor are averaged over so long, s.
const AVERAGED_S: f64 = 0.004;
/// `IMU` ranks behind the single samples of all units.
const IMU: usize = 4;

pub(super) const MEANINGS: &[MessageMeaning] = &[
    MessageMeaning {
        names: &["IMU", "IMU2", "IMU3"],
        fields: &["TimeUS", "TimeMS", "I", "GyrX", "GyrY", "GyrZ", "AccX", "AccY", "AccZ", "GH", "AH"],
        decode: imu,
    },
    MessageMeaning {
        names: &["GYR"],
        fields: &["TimeUS", "I", "SampleUS", "GyrX", "GyrY", "GyrZ"],
        decode: gyr,
    },
    MessageMeaning {
        names: &["ACC"],
        fields: &["TimeUS", "I", "SampleUS", "AccX", "AccY", "AccZ"],
        decode: acc,
    },
    MessageMeaning {
        names: &["MAG", "MAG2", "MAG3"],
        fields: &["TimeUS", "TimeMS", "I", "MagX", "MagY", "MagZ", "Health"],
        decode: mag,
    },
    MessageMeaning {
        names: &["BARO", "BAR2", "BAR3"],
        fields: &["TimeUS", "TimeMS", "I", "Press", "SMS", "Health", "H"],
        decode: baro,
    },
];

/// Single samples on their way into a mean, of every unit.
#[derive(Clone, Copy, Debug, Default)]
pub(super) struct Batches {
    units: [Batch; IMU],
}

#[derive(Clone, Copy, Debug, Default)]
struct Batch {
    since: Option<AutopilotTime>,
    rate: Mean,
    force: Mean,
}

#[derive(Clone, Copy, Debug, Default)]
struct Mean {
    sum: Vector3<f64>,
    n: f64,
}

impl Mean {
    fn add(&mut self, value: Vector3<f64>) {
        self.sum += value;
        self.n += 1.0;
    }

    fn get(&self) -> Option<Vector3<f64>> {
        (self.n > 0.0).then(|| self.sum / self.n)
    }
}

/// `IMU`: filtered rates and forces in the body's axes, at the moment of logging. `GH` and `AH` say whether the sensors are healthy.
fn imu(vehicle: &mut ArduPilot, m: &Told<'_>) -> Result<(), Cause> {
    if m.row.byte("GH") == Some(0) || m.row.byte("AH") == Some(0) {
        return Ok(());
    }
    let rate = vector(m.row.all(["GyrX", "GyrY", "GyrZ"]))?;
    let force = vector(m.row.all(["AccX", "AccY", "AccZ"]))?;
    vehicle.intake.inertial(IMU + usize::from(m.instance), m.time, rate, force)
}

/// `GYR`: every sample of a gyroscope.
fn gyr(vehicle: &mut ArduPilot, m: &Told<'_>) -> Result<(), Cause> {
    let rate = vector(m.row.all(["GyrX", "GyrY", "GyrZ"]))?;
    let unit = usize::from(m.instance);
    let batch = vehicle.batches.units.get_mut(unit).ok_or(Cause::WrongSystem)?;
    batch.rate.add(rate);
    let since = *batch.since.get_or_insert(m.time);
    if m.time.seconds_since(since) < AVERAGED_S {
        return Ok(());
    }
    let done = std::mem::replace(batch, Batch { since: Some(m.time), ..Batch::default() });
    match (done.rate.get(), done.force.get()) {
        (Some(rate), Some(force)) => vehicle.intake.inertial(unit, m.time, rate, force),
        _ => Ok(()),
    }
}

/// `ACC`: every sample of an accelerometer.
fn acc(vehicle: &mut ArduPilot, m: &Told<'_>) -> Result<(), Cause> {
    let force = vector(m.row.all(["AccX", "AccY", "AccZ"]))?;
    let batch = vehicle.batches.units.get_mut(usize::from(m.instance)).ok_or(Cause::WrongSystem)?;
    batch.force.add(force);
    Ok(())
}

/// `MAG`: calibrated, in the body's axes, milligauss.
fn mag(vehicle: &mut ArduPilot, m: &Told<'_>) -> Result<(), Cause> {
    if m.row.byte("Health") == Some(0) {
        return Ok(());
    }
    let field = vector(m.row.all(["MagX", "MagY", "MagZ"]))? * TESLA_PER_MILLIGAUSS;
    vehicle.intake.magnetic(usize::from(m.instance), m.time, field)
}

/// `BARO`: static pressure, Pa.
fn baro(vehicle: &mut ArduPilot, m: &Told<'_>) -> Result<(), Cause> {
    if m.row.byte("Health").or(m.row.byte("H")) == Some(0) {
        return Ok(());
    }
    let pressure_pa = m.row.get("Press").ok_or(Cause::BadPayload)?;
    vehicle.intake.pressure(m.instance, m.measured("SMS"), pressure_pa)
}
