//! Of each sensor, whether it is good enough, and how it is had where it is not there.

use serde::Serialize;

use crate::preflight::finding::plain;
use crate::preflight::readings::Readings;
use crate::sample::{Airframe, GnssFix, Sample, SampleKind, Sighting};
use crate::time::{Companion, Stamp};
use crate::wire::messages::name_of;
use crate::wire::session::identity::AutopilotKind;

use super::survey::{HeardSensor, Survey};

/// From these rates on a sensor is as fast as is wanted, Hz: below, it is weak.
const GOOD_HZ: [(SampleKind, f64); 8] = [
    (SampleKind::Imu, 90.0),
    (SampleKind::Mag, 0.5),
    (SampleKind::Gnss, 1.0),
    (SampleKind::Pressure, 4.0),
    (SampleKind::Flow, 8.0),
    (SampleKind::Range, 4.0),
    (SampleKind::Airspeed, 2.0),
    (SampleKind::Landmark, 0.0),
];
/// A rate is measured over 4 s: so much of it may be missing.
const MISSING_PART: f64 = 0.1;
/// Flow whose best sample is worse sees nothing.
const BLIND: f64 = 0.1;
/// Fewer satellites are no fix, as by default.
const FEW_SATELLITES: u8 = 5;
/// A field that is far from Earth's, µT.
const EARTH_UT: [f64; 2] = [20.0, 70.0];

/// How good a sensor is.
#[derive(Clone, Copy, PartialEq, Eq, Debug, Serialize)]
#[serde(rename_all = "snake_case")]
pub enum SensorGrade {
    /// Good enough.
    Good,
    /// It is there, and not as good as it should be.
    Weak,
    /// It is not there.
    Missing,
}

impl SensorGrade {
    /// In a word.
    pub fn label(self) -> &'static str {
        match self {
            SensorGrade::Good => "good",
            SensorGrade::Weak => "weak",
            SensorGrade::Missing => "none",
        }
    }
}

/// What is to be said of a sensor.
#[derive(Clone, PartialEq, Debug, Serialize)]
pub struct SensorVerdict {
    /// Its kind, and its number where it is not the first.
    pub sensor: String,
    /// How good it is.
    pub grade: SensorGrade,
    /// The message that tells of it.
    pub message: Option<&'static str>,
    /// How often that comes, Hz.
    pub rate_hz: f64,
    /// The component that sends it, where that is not the autopilot.
    pub component: Option<u8>,
    /// What it tells, in words.
    pub tells: Option<String>,
    /// Why it is not good, and how that is mended.
    pub remark: Option<String>,
}

/// Every sensor that was heard, and those that were not and are of use to this vehicle.
pub fn verdicts(survey: &Survey, readings: &Readings) -> Vec<SensorVerdict> {
    let Some(now) = survey.newest else { return Vec::new() };
    let mut out = Vec::new();
    for &kind in SampleKind::ALL {
        let units = survey.sensors.iter().filter(|((k, _), s)| *k == kind && s.rate_hz(now) > 0.0);
        let heard: Vec<SensorVerdict> = units
            .enumerate()
            .map(|(i, (_, sensor))| heard_verdict((kind, i), sensor, readings, now))
            .collect();
        if heard.is_empty() {
            out.extend(missing(kind, readings));
        }
        out.extend(heard);
    }
    out
}

fn heard_verdict(
    (kind, number): (SampleKind, usize),
    sensor: &HeardSensor,
    readings: &Readings,
    now: Stamp<Companion>,
) -> SensorVerdict {
    let rate_hz = sensor.rate_hz(now);
    let good_hz = GOOD_HZ.iter().find(|(k, _)| *k == kind).map_or(0.0, |(_, hz)| *hz);
    let slow = (rate_hz < good_hz * (1.0 - MISSING_PART))
        .then(|| format!("slow: {} Hz or more are wanted", plain(good_hz)));
    let remark = slow.or_else(|| fault(sensor));
    let name = kind.label();
    SensorVerdict {
        sensor: if number == 0 { name.to_owned() } else { format!("{name} {}", number + 1) },
        grade: if remark.is_some() { SensorGrade::Weak } else { SensorGrade::Good },
        message: name_of(sensor.message),
        rate_hz: (rate_hz * 10.0).round() / 10.0,
        component: (sensor.from.1 != readings.vehicle.component.0).then_some(sensor.from.1),
        tells: tells(sensor),
        remark,
    }
}

/// What is wrong with what it tells.
fn fault(sensor: &HeardSensor) -> Option<String> {
    let text = match &sensor.newest {
        Sample::Gnss(fix) if fix.position.is_none() => {
            "no fix yet: Holdover begins where it is with flow, else it waits for one".to_owned()
        }
        Sample::Gnss(fix) if fix.satellites.is_some_and(|n| n < FEW_SATELLITES) => {
            "too few satellites (gnss.min_satellites)".to_owned()
        }
        Sample::Flow(_) if sensor.best_quality.is_some_and(|q| q < BLIND) => {
            "sees nothing: it needs light, texture and some height".to_owned()
        }
        Sample::Range(range) => {
            let [least, most] = range.limits_m?;
            let beyond = range.distance_m < least || range.distance_m > most;
            return beyond.then(|| "beyond its limits now: of use within them only".to_owned());
        }
        Sample::Mag(mag) => {
            let ut = mag.field.raw().norm() * 1e6;
            let earthly = (EARTH_UT[0]..=EARTH_UT[1]).contains(&ut);
            return (!earthly)
                .then(|| "not Earth's field: calibrate it, away from currents and iron".to_owned());
        }
        _ => return None,
    };
    Some(text)
}

fn tells(sensor: &HeardSensor) -> Option<String> {
    Some(match &sensor.newest {
        Sample::Gnss(fix) => {
            let kind = match fix.fix {
                GnssFix::None => "no fix",
                GnssFix::TwoD => "2D fix",
                _ => "3D fix",
            };
            let satellites = fix.satellites.map(|n| format!(", {n} satellites")).unwrap_or_default();
            let claimed = fix.horizontal_accuracy_m.filter(|_| fix.position.is_some());
            let claimed = claimed.map(|m| format!(", claims {m:.1} m")).unwrap_or_default();
            format!("{kind}{satellites}{claimed}")
        }
        Sample::Mag(mag) => format!("{:.0} µT", mag.field.raw().norm() * 1e6),
        Sample::Pressure(pressure) => format!("{:.0} hPa", pressure.pressure_pa / 100.0),
        Sample::Flow(_) => format!("quality up to {:.0} %", 100.0 * sensor.best_quality?),
        Sample::Range(range) => match range.limits_m {
            Some([least, most]) => {
                format!("{:.1} m of {} to {} m", range.distance_m, plain(least), plain(most))
            }
            None => format!("{:.1} m", range.distance_m),
        },
        Sample::Airspeed(air) => format!("{:.1} m/s", air.airspeed_mps),
        Sample::Landmark(landmark) => match landmark.sighting {
            Sighting::Bearing { .. } => format!("bearing of number {}", landmark.id),
            Sighting::Body(_) => format!("position of number {}", landmark.id),
        },
        Sample::Imu(_) => return None,
    })
}

/// A sensor that is not heard, where this vehicle would have some use of it: what for, and how it is had.
fn missing(kind: SampleKind, readings: &Readings) -> Option<SensorVerdict> {
    let px4 = readings.vehicle.autopilot == AutopilotKind::Px4;
    let by = |ardupilot: &'static str, px4_name: &'static str| if px4 { px4_name } else { ardupilot };
    let wing = readings.airframe == Some(Airframe::FixedWing);
    let remark = match kind {
        SampleKind::Imu => {
            "there is nothing to navigate with (HIGHRES_IMU, SCALED_IMU or RAW_IMU)".to_owned()
        }
        SampleKind::Mag => format!(
            "the heading has to show in motion ({})",
            by("COMPASS_ENABLE, COMPASS_USE", "SYS_HAS_MAG")
        ),
        SampleKind::Gnss => {
            format!("no receiver is told of ({})", by("GPS1_TYPE, GPS_TYPE", "SYS_HAS_GPS, GPS_1_CONFIG"))
        }
        SampleKind::Pressure => "the height is that of GNSS and inertia only".to_owned(),
        SampleKind::Flow => format!(
            "what carries an outage best, low and slow: a sensor of the autopilot ({}), or a camera's computer that sends OPTICAL_FLOW_RAD \
             (link.sensor_endpoints)",
            by("FLOW_TYPE", "its driver, as SENS_EN_PX4FLOW")
        ),
        SampleKind::Range if readings.has(SampleKind::Flow) => format!(
            "the flow's height is then the altimeter's over the place of take-off ({})",
            by("RNGFND1_TYPE, RNGFND1_ORIENT 25", "its driver, facing down")
        ),
        SampleKind::Airspeed if wing => format!(
            "what carries a fixed wing without flow ({})",
            by("ARSPD_TYPE", "SYS_HAS_NUM_ASPD and its driver")
        ),
        SampleKind::Range | SampleKind::Airspeed | SampleKind::Landmark => return None,
    };
    Some(SensorVerdict {
        sensor: kind.label().to_owned(),
        grade: SensorGrade::Missing,
        message: None,
        rate_hz: 0.0,
        component: None,
        tells: None,
        remark: Some(remark),
    })
}
