//! Speeds of motors and batches of fast samples of a DataFlash log: what shakes the inertial units, and how.

use crate::wire::counters::Cause;

use super::super::fast_samples::FastKind;
use super::super::intake::possible;
use super::super::row::SHORTS;
use super::{ArduPilot, MessageMeaning, Told};

/// Sensors are sampled at rates of this order, Hz.
const RATE_HZ: std::ops::RangeInclusive<f64> = 50.0..=100_000.0;
/// `AP_InertialSensor::IMU_SENSOR_TYPE`.
const ACCELEROMETER: u8 = 0;
const GYRO: u8 = 1;

pub(super) const MEANINGS: &[MessageMeaning] = &[
    MessageMeaning { names: &["ESC"], fields: &["TimeUS", "Instance", "RPM"], decode: esc },
    MessageMeaning {
        names: &["ESC1", "ESC2", "ESC3", "ESC4", "ESC5", "ESC6", "ESC7", "ESC8"],
        fields: &["TimeUS", "RPM"],
        decode: esc,
    },
    MessageMeaning {
        names: &["ISBH"],
        fields: &["TimeUS", "N", "type", "instance", "mul", "smp_cnt", "smp_rate"],
        decode: batch,
    },
    MessageMeaning { names: &["ISBD"], fields: &["TimeUS", "N", "seqno", "x", "y", "z"], decode: samples },
];

/// A batch of which not all has come.
#[derive(Clone, Debug)]
pub(super) struct OpenBatch {
    number: f64,
    kind: FastKind,
    unit: u8,
    rate_hz: f64,
    /// What a unit of the log is, in SI units.
    unit_si: f64,
    wanted: usize,
    samples: Vec<[f64; 3]>,
    clipped: u64,
}

/// `ESC`, or `ESC1` to `ESC8` to ArduPilot 4.0: turns a minute.
fn esc(vehicle: &mut ArduPilot, m: &Told<'_>) -> Result<(), Cause> {
    vehicle.rotors.note(m.instance, m.row.get("RPM").ok_or(Cause::BadPayload)?);
    Ok(())
}

/// `ISBH`: what the samples are of that come in `ISBD` of the same number.
fn batch(vehicle: &mut ArduPilot, m: &Told<'_>) -> Result<(), Cause> {
    vehicle.fast.broken += u64::from(vehicle.batch.take().is_some());
    let kind = match m.row.byte("type") {
        Some(ACCELEROMETER) => FastKind::Accelerometer,
        Some(GYRO) => FastKind::Gyro,
        _ => return Err(Cause::BadPayload),
    };
    let wanted = m.row.known("smp_cnt").ok_or(Cause::BadPayload)? as usize;
    vehicle.batch = Some(OpenBatch {
        number: m.row.get("N").ok_or(Cause::BadPayload)?,
        kind,
        unit: m.row.byte("instance").ok_or(Cause::BadPayload)?,
        rate_hz: possible(m.row.get("smp_rate").ok_or(Cause::BadPayload)?, RATE_HZ)?,
        unit_si: 1.0 / m.row.known("mul").ok_or(Cause::BadPayload)?,
        wanted,
        samples: Vec::with_capacity(wanted),
        clipped: 0,
    });
    Ok(())
}

/// `ISBD`: so many samples more. A batch of which one is missing is none: its samples do not follow each other.
fn samples(vehicle: &mut ArduPilot, m: &Told<'_>) -> Result<(), Cause> {
    let Some(batch) = &mut vehicle.batch else { return Ok(()) };
    let next = (batch.samples.len() / SHORTS) as f64;
    if (m.row.get("N"), m.row.get("seqno")) != (Some(batch.number), Some(next)) {
        vehicle.batch = None;
        vehicle.fast.broken += 1;
        return Ok(());
    }
    let shorts = |name: &str| m.row.shorts(name).ok_or(Cause::BadPayload);
    let (x, y, z) = (shorts("x")?, shorts("y")?, shorts("z")?);
    for ((&x, &y), &z) in x.iter().zip(&y).zip(&z).take(batch.wanted - batch.samples.len()) {
        let sample = [x, y, z];
        batch.clipped += u64::from(sample.iter().any(|v| matches!(*v, i16::MIN | i16::MAX)));
        batch.samples.push(sample.map(|v| f64::from(v) * batch.unit_si));
    }
    if batch.samples.len() == batch.wanted
        && let Some(b) = vehicle.batch.take()
    {
        vehicle.fast.take(b.kind, b.unit, b.rate_hz, &b.samples, b.clipped);
    }
    Ok(())
}
