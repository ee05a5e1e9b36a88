//! Inertial units, magnetometers and barometers of a ULog, and the rotors that shake them.

use crate::geo::atmosphere::static_pressure_pa;
use crate::time::AutopilotTime;
use crate::wire::counters::Cause;

use super::super::intake::{Intake, MOST_SENSORS, possible, vector};
use super::{Logged, Px4, Topic};

const TESLA_PER_GAUSS: f64 = 1e-4;
const PASCAL_PER_HECTOPASCAL: f64 = 100.0;
/// Beyond this a pressure is in Pa, as `sensor_baro` tells it since PX4 1.14; before it told hPa.
const IN_PASCAL: f64 = 2000.0;
/// `vehicle_imu` has up to so many units; `sensor_combined` ranks behind them.
const UNITS: usize = 4;
const COMBINED: usize = UNITS + 1;
/// What `sensor_combined` says of the time of a sensor that it has nothing of: INT32_MAX, µs.
const NEVER_US: f64 = i32::MAX as f64;
/// Heights of the standard atmosphere's troposphere, m: a barometer tells no other.
const HEIGHTS_M: std::ops::RangeInclusive<f64> = -2000.0..=11_000.0;
/// Integrals that follow each other without a gap before a stream of them is used.
const GAPLESS: u32 = 10;
/// Of an interval, what may be missing between one integral and the next.
const GAP: f64 = 0.5;

pub(super) const TOPICS: &[Topic] = &[
    Topic {
        name: "vehicle_imu",
        fields: &[
            "timestamp_sample",
            "accel_device_id",
            "delta_angle_dt",
            "delta_velocity_dt",
            "delta_angle[0]",
            "delta_angle[1]",
            "delta_angle[2]",
            "delta_velocity[0]",
            "delta_velocity[1]",
            "delta_velocity[2]",
        ],
        decode: vehicle_imu,
    },
    Topic {
        name: "sensor_combined",
        fields: &[
            "gyro_rad[0]",
            "gyro_rad[1]",
            "gyro_rad[2]",
            "accelerometer_m_s2[0]",
            "accelerometer_m_s2[1]",
            "accelerometer_m_s2[2]",
            "magnetometer_ga[0]",
            "magnetometer_ga[1]",
            "magnetometer_ga[2]",
            "magnetometer_timestamp_relative",
            "baro_alt_meter",
            "baro_timestamp_relative",
        ],
        decode: sensor_combined,
    },
    Topic {
        name: "vehicle_magnetometer",
        fields: &["timestamp_sample", "magnetometer_ga[0]", "magnetometer_ga[1]", "magnetometer_ga[2]"],
        decode: vehicle_magnetometer,
    },
    Topic {
        name: "vehicle_air_data",
        fields: &["timestamp_sample", "baro_pressure_pa"],
        decode: vehicle_air_data,
    },
    Topic { name: "esc_status", fields: &ROTORS, decode: esc_status },
    Topic { name: "sensor_baro", fields: &["timestamp_sample", "pressure"], decode: sensor_baro },
];

/// Speed controllers of `esc_status`.
const ROTORS: [&str; 8] = [
    "esc[0].esc_rpm",
    "esc[1].esc_rpm",
    "esc[2].esc_rpm",
    "esc[3].esc_rpm",
    "esc[4].esc_rpm",
    "esc[5].esc_rpm",
    "esc[6].esc_rpm",
    "esc[7].esc_rpm",
];

/// Which of the inertial units are fit to be integrated.
#[derive(Clone, Copy, Debug, Default)]
pub(super) struct Units {
    /// The accelerometer that the autopilot itself uses.
    selected: Option<u32>,
    streams: [UnitStream; UNITS],
    /// When `vehicle_air_data`, or a barometer in `sensor_combined`, was heard last.
    air_data: Option<AutopilotTime>,
    /// When the magnetometer and the barometer of `sensor_combined` had measured last.
    combined: [Option<AutopilotTime>; 2],
}

impl Units {
    /// When a sensor of `sensor_combined` has measured, so long after the stamp, µs; `None` for what is not there, or was told before.
    fn measured_anew(&mut self, sensor: usize, m: &Logged<'_>, relative: &str) -> Option<AutopilotTime> {
        let since_us = m.row.get(relative).unwrap_or(0.0);
        if since_us == NEVER_US {
            return None;
        }
        let sample_us = m.us.checked_add_signed(since_us as i64);
        let time = Intake::measured(m.time, m.us, sample_us);
        let last = self.combined.get_mut(sensor)?;
        let anew = last.is_none_or(|last| time > last);
        anew.then(|| *last.insert(time))
    }
}

#[derive(Clone, Copy, Debug, Default)]
struct UnitStream {
    last: Option<AutopilotTime>,
    gapless: u32,
}

/// `sensor_selection`.
pub(super) fn selection(px4: &mut Px4, m: &Logged<'_>) -> Result<(), Cause> {
    px4.units.selected = m.row.known("accel_device_id").map(|id| id as u32);
    Ok(())
}

/// `vehicle_imu`: the integrals over an interval that ends at `timestamp_sample`. Logged in full they are the best there is; PX4 by default
/// logs every hundredth, which are of no use.
fn vehicle_imu(px4: &mut Px4, m: &Logged<'_>) -> Result<(), Cause> {
    let instance = usize::from(m.instance);
    let time = m.measured();
    let stream = px4.units.streams.get_mut(instance).ok_or(Cause::WrongSystem)?;
    let dt = |name: &str| possible(m.row.get(name).ok_or(Cause::BadPayload)? * 1e-6, 1e-5..=1.0);
    let (angle_dt, velocity_dt) = (dt("delta_angle_dt")?, dt("delta_velocity_dt")?);
    let gap = stream.last.map(|last| time.seconds_since(last) - velocity_dt);
    stream.last = Some(time);
    stream.gapless = match gap {
        Some(gap) if gap.abs() < GAP * velocity_dt => stream.gapless.saturating_add(1),
        // One that is missing from a stream leaves a hole, and the stream what it is.
        Some(gap) if gap < 1.0 && stream.gapless > GAPLESS => GAPLESS,
        _ => 0,
    };
    if stream.gapless < GAPLESS {
        return Ok(());
    }
    let rate = vector(m.row.all(["delta_angle[0]", "delta_angle[1]", "delta_angle[2]"]))? / angle_dt;
    let force =
        vector(m.row.all(["delta_velocity[0]", "delta_velocity[1]", "delta_velocity[2]"]))? / velocity_dt;
    let selected = px4.units.selected.is_some()
        && m.row.known("accel_device_id").map(|id| id as u32) == px4.units.selected;
    let rank = if selected { 0 } else { instance + 1 };
    px4.intake.inertial(rank, time, rate, force)
}

/// `sensor_combined`: means over the interval that ends at its stamp, of the unit that is selected. PX4 before 1.8 had the magnetometer and the
/// barometer in it as well, each with its own time, and told them again with every sample of the gyro. Of the pressure there is only the height
/// that PX4 made of it in the standard atmosphere.
fn sensor_combined(px4: &mut Px4, m: &Logged<'_>) -> Result<(), Cause> {
    let rate = vector(m.row.all(["gyro_rad[0]", "gyro_rad[1]", "gyro_rad[2]"]))?;
    let force =
        vector(m.row.all(["accelerometer_m_s2[0]", "accelerometer_m_s2[1]", "accelerometer_m_s2[2]"]))?;
    px4.intake.inertial(COMBINED, m.time, rate, force)?;
    if let Some(height_m) = m.row.get("baro_alt_meter")
        && let Some(time) = px4.units.measured_anew(1, m, "baro_timestamp_relative")
    {
        px4.units.air_data = Some(m.time);
        let told = possible(height_m, HEIGHTS_M)
            .and_then(|height_m| px4.intake.pressure(0, time, static_pressure_pa(height_m)));
        if let Err(cause) = told {
            px4.intake.counters.count(cause);
        }
    }
    if let Some(field) = m.row.all(["magnetometer_ga[0]", "magnetometer_ga[1]", "magnetometer_ga[2]"])
        && let Some(time) = px4.units.measured_anew(0, m, "magnetometer_timestamp_relative")
    {
        return px4.intake.magnetic(MOST_SENSORS - 1, time, vector(Some(field))? * TESLA_PER_GAUSS);
    }
    Ok(())
}

/// `vehicle_magnetometer`: calibrated, in the body's axes.
fn vehicle_magnetometer(px4: &mut Px4, m: &Logged<'_>) -> Result<(), Cause> {
    let field = vector(m.row.all(["magnetometer_ga[0]", "magnetometer_ga[1]", "magnetometer_ga[2]"]))?;
    px4.intake.magnetic(usize::from(m.instance), m.measured(), field * TESLA_PER_GAUSS)
}

/// `vehicle_air_data`: the barometer that is selected.
fn vehicle_air_data(px4: &mut Px4, m: &Logged<'_>) -> Result<(), Cause> {
    px4.units.air_data = Some(m.time);
    px4.intake.pressure(0, m.measured(), m.row.get("baro_pressure_pa").ok_or(Cause::BadPayload)?)
}

/// `sensor_baro`: every barometer, uncorrected. It is used where nothing selects one.
fn sensor_baro(px4: &mut Px4, m: &Logged<'_>) -> Result<(), Cause> {
    if px4.units.air_data.is_some() {
        return Ok(());
    }
    let told = m.row.get("pressure").ok_or(Cause::BadPayload)?;
    let pressure_pa = if told < IN_PASCAL { told * PASCAL_PER_HECTOPASCAL } else { told };
    px4.intake.pressure(m.instance, m.measured(), pressure_pa)
}

/// `esc_status`: turns a minute.
fn esc_status(px4: &mut Px4, m: &Logged<'_>) -> Result<(), Cause> {
    for (controller, name) in ROTORS.iter().enumerate() {
        if let Some(rpm) = m.row.get(name) {
            px4.rotors.note(controller as u8, rpm);
        }
    }
    Ok(())
}
