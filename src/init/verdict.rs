//! Of each sensor, whether it is good enough, and how it is had where it is not there.

use serde::Serialize;

use crate::preflight::finding::plain;
use crate::preflight::readings::Readings;
use crate::sample::{Airframe, GnssFix, Sample, SampleKind, Sighting};
use crate::time::{Companion, Stamp};
use crate::wire::messages::name_of;
use crate::wire::session::identity::AutopilotKind;

use super::survey::{HeardSensor, LinkSurvey};

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
pub fn verdicts(survey: &LinkSurvey, readings: &Readings) -> Vec<SensorVerdict> {
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

#[cfg(test)]
mod tests {
    use nalgebra::Vector3;

    use super::*;
    use crate::geo::Body;
    use crate::preflight::readings::Readings;
    use crate::sample::{
        FlowRotation, FlowSample, GnssSample, Input, MagSample, RangeDirection, RangeSample,
    };
    use crate::time::{AutopilotTime, Span};
    use crate::wire::frame::{ComponentId, SystemId};
    use crate::wire::session::heartbeat_fields::testing::heartbeat_frame;
    use crate::wire::session::identity::Vehicle;

    const T: AutopilotTime = AutopilotTime::from_micros(1);

    fn readings(airframe: Airframe, heard: &[SampleKind]) -> Readings {
        let mut rates_hz = [0.0; SampleKind::ALL.len()];
        heard.iter().for_each(|k| rates_hz[*k as usize] = 10.0);
        let (system, component) = (SystemId(1), ComponentId(1));
        let autopilot = AutopilotKind::Px4;
        let vehicle = Vehicle { system, component, autopilot, vehicle_type: 2, armed: false, version: None };
        Readings {
            vehicle,
            airframe: Some(airframe),
            mavlink1: false,
            rates_hz,
            gnss_fix: false,
            round_trip: None,
            parameters: Default::default(),
            untold: Vec::new(),
        }
    }

    /// The verdict of a sensor that told `sample` at `hz` for 4 s, by a component.
    fn of(sample: Sample, hz: i64, component: u8) -> SensorVerdict {
        let mut survey = LinkSurvey::default();
        let frame = heartbeat_frame(1, component, 2, 12, 0);
        for i in 0..4 * hz {
            let at = Stamp::from_micros(i * 1_000_000 / hz);
            survey.hear(&frame.frame().unwrap(), at, &[Input::Sample(sample)]);
        }
        let kind = sample.kind();
        let all = verdicts(&survey, &readings(Airframe::Multirotor, &[kind]));
        all.into_iter().find(|v| v.sensor == kind.label()).unwrap()
    }

    fn fix(satellites: u8, position: bool) -> Sample {
        Sample::Gnss(GnssSample {
            time: T,
            receiver: 0,
            fix: if position { GnssFix::ThreeD } else { GnssFix::None },
            position: position.then(|| crate::geo::Geodetic::from_degrees(1.0, 2.0, 3.0)),
            ground_velocity: None,
            horizontal_accuracy_m: Some(0.8),
            vertical_accuracy_m: None,
            speed_accuracy_mps: None,
            satellites: Some(satellites),
            warning: None,
        })
    }

    fn flow(quality: f64) -> Sample {
        let rotation = FlowRotation::Contained;
        let (time, interval) = (T, Span::ZERO);
        Sample::Flow(FlowSample {
            time,
            sensor: 0,
            interval,
            rate_xy: [0.0; 2],
            rotation,
            quality,
            distance_m: None,
        })
    }

    fn range(distance_m: f64) -> Sample {
        let (direction, limits_m) = (RangeDirection::Down, Some([0.1, 40.0]));
        Sample::Range(RangeSample { time: T, sensor: 0, direction, distance_m, limits_m })
    }

    fn field(ut: f64) -> Sample {
        Sample::Mag(MagSample { time: T, sensor: 0, field: Body::new(Vector3::new(ut * 1e-6, 0.0, 0.0)) })
    }

    #[test]
    fn a_sensor_is_good_or_it_is_said_what_is_not() {
        for (sample, hz) in [(fix(12, true), 5), (flow(0.6), 20), (range(3.0), 20), (field(48.0), 50)] {
            let v = of(sample, hz, 1);
            assert_eq!((v.grade, v.remark.clone(), v.component), (SensorGrade::Good, None, None), "{v:?}");
            assert!((v.rate_hz - hz as f64).abs() <= 0.5, "{v:?}");
        }
        for (sample, hz, why) in [
            (fix(12, false), 5, "no fix yet"),
            (fix(3, true), 5, "too few satellites"),
            (flow(0.6), 3, "slow: 8 Hz"),
            (flow(0.0), 20, "sees nothing"),
            (range(60.0), 20, "beyond its limits"),
            (field(300.0), 50, "not Earth's field"),
        ] {
            let v = of(sample, hz, 1);
            let told = v.remark.unwrap_or_default();
            assert!(v.grade == SensorGrade::Weak && told.contains(why), "{why}: {told}");
        }
        assert_eq!(of(flow(0.6), 20, 100).component, Some(100), "whose it is");
        assert_eq!(of(fix(12, true), 5, 1).tells.as_deref(), Some("3D fix, 12 satellites, claims 0.8 m"));
    }

    #[test]
    fn what_is_not_there_is_missed_where_the_vehicle_would_use_it() {
        let missed = |airframe, heard: &[SampleKind]| -> Vec<String> {
            let survey = LinkSurvey { newest: Some(Stamp::from_micros(0)), ..LinkSurvey::default() };
            let all = verdicts(&survey, &readings(airframe, heard));
            assert!(all.iter().all(|v| v.grade == SensorGrade::Missing && v.remark.is_some()));
            all.into_iter().map(|v| v.sensor).collect()
        };
        let always = ["IMU", "magnetometer", "GNSS", "barometer", "optical flow"];
        assert_eq!(missed(Airframe::Multirotor, &[]), always);
        assert_eq!(missed(Airframe::FixedWing, &[]), [&always[..], &["airspeed"]].concat());
        let with_flow = missed(Airframe::Multirotor, &[SampleKind::Flow]);
        assert!(with_flow.contains(&"rangefinder".to_owned()), "{with_flow:?}");
    }
}
