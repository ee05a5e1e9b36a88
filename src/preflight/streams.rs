//! What comes of the sensors, how the link carries it, and what the configuration says of the vehicle.

use crate::outbound::{Profile, Publish};
use crate::sample::SampleKind;
use crate::wire::session::identity::AutopilotKind;

use super::Case;
use super::finding::{Finding, FindingGrade, plain};

/// IMU streams slower than this cannot be integrated, Hz.
const LEAST_IMU_HZ: f64 = 20.0;
/// From this rate on the IMU is as fast as is wanted, Hz.
const GOOD_IMU_HZ: f64 = 90.0;

/// What is wrong with the streams and the link.
pub(super) fn judge(case: &Case<'_>) -> Vec<Finding> {
    let mut out = Vec::new();
    out.extend(protocol(case));
    out.extend(profile(case));
    out.extend(silence(case));
    out.extend(imu(case));
    out.extend(gnss(case));
    out.extend(others(case));
    out
}

/// An autopilot of which no rule knows anything.
pub(super) fn unknown_autopilot(case: &Case<'_>) -> Finding {
    Finding {
        grade: FindingGrade::Advice,
        subject: case.readings.vehicle.autopilot.to_string(),
        value: None,
        should: "ArduPilot or PX4".into(),
        why: "no other autopilot's parameters are known: only the streams were checked".into(),
        mend: None,
        example: None,
        reboot: false,
    }
}

fn protocol(case: &Case<'_>) -> Option<Finding> {
    if !case.readings.mavlink1 {
        return None;
    }
    let px4 = case.readings.vehicle.autopilot == AutopilotKind::Px4;
    let example = if px4 { "param set MAV_PROTO_VER 2" } else { "param set SERIAL2_PROTOCOL 2" };
    Some(Finding {
        grade: FindingGrade::Fault,
        subject: "MAVLink".into(),
        value: Some(super::finding::FoundValue::Number(1.0)),
        should: "2".into(),
        why: "this link carries MAVLink 1, which has no ODOMETRY: set the port that leads here (SERIALn_PROTOCOL, MAV_PROTO_VER)".into(),
        mend: None,
        example: Some(example.into()),
        reboot: true,
    })
}

fn profile(case: &Case<'_>) -> Option<Finding> {
    let (wrong, right) = match (case.needs.profile?, case.readings.vehicle.autopilot) {
        (Profile::Px4, AutopilotKind::ArduPilot) => (Profile::Px4, Profile::Ardupilot),
        (Profile::Ardupilot, AutopilotKind::Px4) => (Profile::Ardupilot, Profile::Px4),
        _ => return None,
    };
    let why =
        format!("{} drops what is sent in another's frames without a word", case.readings.vehicle.autopilot);
    Some(Finding::key(FindingGrade::Fault, ("vehicle.profile", wrong), &right.to_string(), why))
}

fn silence(case: &Case<'_>) -> Option<Finding> {
    let why = "nothing is sent: the settings of external navigation were not checked";
    let never = case.needs.publish == Publish::Never;
    never.then(|| Finding::key(FindingGrade::Advice, ("outbound.publish", "never"), "auto", why))
}

fn imu(case: &Case<'_>) -> Option<Finding> {
    let rate = case.readings.rate_hz(SampleKind::Imu);
    let wanted = if case.needs.requests { case.needs.imu_hz } else { GOOD_IMU_HZ };
    if rate >= GOOD_IMU_HZ.min(0.8 * wanted) {
        return None;
    }
    let grade = if rate < LEAST_IMU_HZ { FindingGrade::Fault } else { FindingGrade::Advice };
    let example = match case.readings.vehicle.autopilot {
        _ if !case.needs.requests => Some("holdover run --set streams.request=true".to_owned()),
        AutopilotKind::Px4 => Some("param set MAV_1_MODE 2".to_owned()),
        AutopilotKind::ArduPilot if rate > 0.0 => {
            Some(format!("param set SCHED_LOOP_RATE {}", (wanted / 0.8).clamp(100.0, 400.0).round()))
        }
        _ => None,
    };
    let why = if rate > 0.0 {
        "attitude and velocity are integrated from it, the better the faster; the autopilot's loop, its port's rate, and other clients cap it"
    } else {
        "HIGHRES_IMU, RAW_IMU or SCALED_IMU: there is nothing to navigate with"
    };
    let should = format!("{LEAST_IMU_HZ} Hz at least, {GOOD_IMU_HZ} and more wanted");
    Some(Finding::stream(grade, ("IMU", rate), should, why, example))
}

fn gnss(case: &Case<'_>) -> Option<Finding> {
    let readings = case.readings;
    let rate = readings.rate_hz(SampleKind::Gnss);
    if rate > 0.0 && readings.gnss_fix {
        return None;
    }
    let indoors = [SampleKind::Flow, SampleKind::Mag, SampleKind::Pressure].iter().all(|k| readings.has(*k));
    let start = case.needs.without_gnss_s.filter(|_| indoors && case.needs.uses.flow);
    let (grade, why) = match start {
        Some(seconds) => {
            let why = "without a fix the navigation starts where the vehicle stands";
            (FindingGrade::Advice, format!("{why}, {} s after Holdover", plain(seconds)))
        }
        None if rate > 0.0 => {
            (FindingGrade::Advice, "the receiver has no fix yet: Holdover aligns once it has".to_owned())
        }
        None => {
            (FindingGrade::Fault, "GPS_RAW_INT does not come: there is no place to start from".to_owned())
        }
    };
    Some(Finding::stream(grade, ("GNSS", rate), "1 Hz at least, with a fix", why, None))
}

fn others(case: &Case<'_>) -> Vec<Finding> {
    let (readings, uses) = (case.readings, &case.needs.uses);
    let mut out = Vec::new();
    let mut missing = |kind: SampleKind, grade, why: &str| {
        if !readings.has(kind) {
            out.push(Finding::stream(grade, (kind.label(), 0.0), "to come", why, None));
        }
    };
    missing(
        SampleKind::Pressure,
        FindingGrade::Advice,
        "without a barometer the height is that of GNSS and inertia only",
    );
    if uses.magnetometer {
        let why = "without a magnetometer the heading has to show in motion: Aligning takes until then";
        missing(SampleKind::Mag, FindingGrade::Advice, why);
    }
    let has_flow_sensor = readings.parameter("FLOW_TYPE").is_some_and(|t| t > 0.0)
        || readings.parameter("SENS_EN_PX4FLOW").is_some_and(|t| t > 0.0);
    if uses.flow && has_flow_sensor {
        let why = "a flow sensor is set up, and neither OPTICAL_FLOW nor OPTICAL_FLOW_RAD comes";
        missing(SampleKind::Flow, FindingGrade::Fault, why);
    }
    if uses.flow && readings.has(SampleKind::Flow) {
        let why = "the flow's height is the altimeter's over the place of take-off: a slope is an error of its scale";
        missing(SampleKind::Range, FindingGrade::Advice, why);
    }
    out
}
