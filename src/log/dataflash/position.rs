//! GNSS receivers of a DataFlash log, the autopilot's own estimate, and the simulator's truth.

use nalgebra::{UnitQuaternion, Vector3};

use crate::geo::{BodyToNed, Ned};
use crate::sample::{GnssFix, GnssSample, GroundVelocity, Input, TruthState};
use crate::time::AutopilotTime;
use crate::wire::counters::Cause;

use super::super::intake::{attitude, position, vector};
use super::{ArduPilot, MessageMeaning, Told};

/// The GPS epoch, 1980-01-06, and a week, s; UTC is behind GPS by the leap seconds since (18 from 2017 on).
const GPS_EPOCH_S: f64 = 315_964_800.0;
const WEEK_S: f64 = 604_800.0;
const LEAP_S: f64 = 18.0;
/// What the simulator tells in two messages goes together within this, s.
const TOGETHER_S: f64 = 0.01;

const XKF1: &[&str] = &["TimeUS", "TimeMS", "C", "Roll", "Pitch", "Yaw", "VN", "VE", "VD", "PN", "PE", "PD"];

pub(super) const MEANINGS: &[MessageMeaning] = &[
    MessageMeaning {
        names: &["GPS", "GPS2"],
        fields: &[
            "TimeUS", "T", "TimeMS", "I", "Status", "GMS", "GWk", "NSats", "Lat", "Lng", "Alt", "Spd", "GCrs",
        ],
        decode: gps,
    },
    MessageMeaning {
        names: &["GPA", "GPA2"],
        fields: &["TimeUS", "I", "HAcc", "VAcc", "SAcc", "SMS"],
        decode: gpa,
    },
    MessageMeaning { names: &["ORGN"], fields: &["TimeUS", "Type", "Lat", "Lng", "Alt"], decode: origin },
    MessageMeaning { names: &["XKF1"], fields: XKF1, decode: xkf1 },
    MessageMeaning { names: &["NKF1"], fields: XKF1, decode: nkf1 },
    MessageMeaning { names: &["XKF4"], fields: &["TimeUS", "C", "PI"], decode: xkf4 },
    MessageMeaning { names: &["POS"], fields: &["TimeUS", "Lat", "Lng", "Alt"], decode: pos },
    MessageMeaning { names: &["ATT"], fields: &["TimeUS", "TimeMS", "Roll", "Pitch", "Yaw"], decode: att },
    MessageMeaning {
        names: &["SIM"],
        fields: &["TimeUS", "Alt", "Lat", "Lng", "Q1", "Q2", "Q3", "Q4"],
        decode: sim,
    },
    MessageMeaning { names: &["SIM2"], fields: &["TimeUS", "VN", "VE", "VD"], decode: sim2 },
];

/// What the messages about position told last.
#[derive(Clone, Copy, Debug, Default)]
pub(super) struct OwnEstimate {
    /// A fix whose accuracies come in the next message, and its stamp.
    fix: Option<(u64, GnssSample)>,
    /// Which core of EKF3 flies.
    primary: u8,
    /// EKF3 is heard: EKF2 beside it does not fly.
    ekf3: bool,
    velocity_ned: Vector3<f64>,
    true_velocity: Option<(AutopilotTime, Vector3<f64>)>,
}

impl ArduPilot {
    /// A fix for which no accuracies came is passed on before what is later.
    pub(super) fn flush_before(&mut self, us: u64) {
        if self.estimate.fix.is_some_and(|(at, _)| at != us) {
            self.flush();
        }
    }

    /// The same at the end.
    pub(super) fn flush(&mut self) {
        if let Some((_, fix)) = self.estimate.fix.take()
            && let Err(cause) = self.intake.gnss(fix)
        {
            self.intake.counters.count(cause);
        }
    }
}

/// `GPS`: one message a fix and receiver.
fn gps(vehicle: &mut ArduPilot, m: &Told<'_>) -> Result<(), Cause> {
    vehicle.flush();
    if let Some([week, ms]) = m.row.all(["GWk", "GMS"])
        && week > 0.0
    {
        let unix_s = GPS_EPOCH_S + week * WEEK_S + ms * 1e-3 - LEAP_S;
        vehicle.intake.date((unix_s * 1e6) as u64, m.us);
    }
    let fix = match m.row.byte("Status").ok_or(Cause::BadPayload)? {
        0 | 1 => GnssFix::None,
        2 => GnssFix::TwoD,
        3 => GnssFix::ThreeD,
        _ => GnssFix::Corrected,
    };
    let [lat, lon, alt] = m.row.all(["Lat", "Lng", "Alt"]).ok_or(Cause::BadPayload)?;
    let position = (fix > GnssFix::None).then(|| position(lat, lon, alt)).transpose()?;
    let motion = m.row.all(["Spd", "GCrs"]).filter(|v| v.iter().all(|c| c.is_finite()));
    let ground_velocity =
        motion.map(|[speed_mps, course]| GroundVelocity { speed_mps, course_rad: course.to_radians() });
    let sample = GnssSample {
        time: m.time,
        receiver: m.instance,
        fix,
        position,
        ground_velocity: position.and(ground_velocity),
        horizontal_accuracy_m: None,
        vertical_accuracy_m: None,
        speed_accuracy_mps: None,
        satellites: m.row.byte("NSats"),
        warning: None,
    };
    vehicle.estimate.fix = Some((m.us, sample));
    Ok(())
}

/// `GPA`: the accuracies of the fix before it, and when it came.
fn gpa(vehicle: &mut ArduPilot, m: &Told<'_>) -> Result<(), Cause> {
    if let Some((at, fix)) = &mut vehicle.estimate.fix
        && *at == m.us
        && fix.receiver == m.instance
    {
        fix.time = m.measured("SMS");
        fix.horizontal_accuracy_m = m.row.known("HAcc");
        fix.vertical_accuracy_m = m.row.known("VAcc");
        fix.speed_accuracy_mps = m.row.known("SAcc");
        vehicle.flush();
    }
    Ok(())
}

/// `ORGN`: type 0 is the origin of the estimator.
fn origin(vehicle: &mut ArduPilot, m: &Told<'_>) -> Result<(), Cause> {
    if m.row.byte("Type") == Some(0) {
        let [lat, lon, alt] = m.row.all(["Lat", "Lng", "Alt"]).ok_or(Cause::BadPayload)?;
        vehicle.intake.out.push(Input::Origin(position(lat, lon, alt)?));
    }
    Ok(())
}

/// `XKF4` tells which core flies.
fn xkf4(vehicle: &mut ArduPilot, m: &Told<'_>) -> Result<(), Cause> {
    if let Some(primary) = m.row.byte("PI") {
        vehicle.estimate.primary = primary;
    }
    Ok(())
}

/// `XKF1`: what EKF3 believes.
fn xkf1(vehicle: &mut ArduPilot, m: &Told<'_>) -> Result<(), Cause> {
    vehicle.estimate.ekf3 = true;
    if m.instance == vehicle.estimate.primary { local(vehicle, m) } else { Ok(()) }
}

/// `NKF1`: what EKF2 believes, where it flies.
fn nkf1(vehicle: &mut ArduPilot, m: &Told<'_>) -> Result<(), Cause> {
    if vehicle.estimate.ekf3 || m.instance != 0 { Ok(()) } else { local(vehicle, m) }
}

fn local(vehicle: &mut ArduPilot, m: &Told<'_>) -> Result<(), Cause> {
    let velocity = vector(m.row.all(["VN", "VE", "VD"]))?;
    vehicle.estimate.velocity_ned = velocity;
    vehicle.intake.local(m.time, vector(m.row.all(["PN", "PE", "PD"]))?, velocity)
}

/// `POS`: the same on the globe.
fn pos(vehicle: &mut ArduPilot, m: &Told<'_>) -> Result<(), Cause> {
    let [lat, lon, alt] = m.row.all(["Lat", "Lng", "Alt"]).ok_or(Cause::BadPayload)?;
    let velocity = vehicle.estimate.velocity_ned;
    vehicle.intake.global(m.time, position(lat, lon, alt)?, velocity);
    Ok(())
}

/// `ATT`.
fn att(vehicle: &mut ArduPilot, m: &Told<'_>) -> Result<(), Cause> {
    let angles = vector(m.row.all(["Roll", "Pitch", "Yaw"]))?.map(f64::to_radians);
    let attitude: BodyToNed = UnitQuaternion::from_euler_angles(angles.x, angles.y, angles.z).into();
    vehicle.intake.attitude(m.time, attitude);
    Ok(())
}

/// `SIM`: true position and attitude. The velocity of the same moment comes in `SIM2`.
fn sim(vehicle: &mut ArduPilot, m: &Told<'_>) -> Result<(), Cause> {
    let [lat, lon, alt] = m.row.all(["Lat", "Lng", "Alt"]).ok_or(Cause::BadPayload)?;
    let velocity = vehicle.estimate.true_velocity;
    let velocity = velocity.filter(|(at, _)| m.time.seconds_since(*at).abs() <= TOGETHER_S);
    let truth = TruthState {
        time: m.time,
        attitude: m.row.all(["Q1", "Q2", "Q3", "Q4"]).map(|q| attitude(Some(q))).transpose()?,
        position: Some(position(lat, lon, alt)?),
        velocity: velocity.map(|(_, v)| Ned::new(v)),
    };
    vehicle.intake.truth(truth);
    Ok(())
}

/// `SIM2`: true velocity.
fn sim2(vehicle: &mut ArduPilot, m: &Told<'_>) -> Result<(), Cause> {
    vehicle.estimate.true_velocity = Some((m.time, vector(m.row.all(["VN", "VE", "VD"]))?));
    Ok(())
}
