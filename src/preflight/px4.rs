//! What PX4 has to be set to.
//!
//! From EKF2's sources and from flights with 1.17 (SIH quadrotor).

use crate::outbound::Carriage;
use crate::sample::SampleKind;

use super::Case;
use super::finding::{Finding, FindingGrade, plain};
use super::rule::{Rule, apply, bits};

/// `EKF2_EV_CTRL`: horizontal and vertical position, velocity.
const POSITION: u32 = 1 | 2;
const VELOCITY: u32 = 4;
const YAW: u32 = 8;
/// `EKF2_HGT_REF`: vision.
const VISION_HEIGHT: f64 = 3.0;
/// PX4 throws away TIMESYNC answers that took longer, ms.
const TIMESYNC_LIMIT_MS: f64 = 10.0;
/// Room in EKF2_DELAY_MAX beyond the way here, ms: our own and PX4's scheduling.
const DELAY_MARGIN_MS: f64 = 50.0;
/// As for ArduPilot.
const DELAY_TOLERANCE_MS: f64 = 30.0;
const GREATEST_FLOOR: f64 = 20.0;
/// Fusion starts from 5.3 messages a second on.
const LEAST_RATE_HZ: f64 = 6.0;
/// The first message is fused this long after the loss was decided, at the latest, s.
const FIRST_MESSAGE_S: f64 = 2.0;
/// `MAV_x_MODE`: onboard.
const ONBOARD: f64 = 2.0;
/// Rates of the IMU from here on are as wanted, Hz.
const GOOD_IMU_HZ: f64 = 90.0;

/// The parameters to read.
pub(super) fn wanted() -> Vec<String> {
    let mut one: Vec<String> = RULES.iter().map(|r| r.name.to_owned()).collect();
    one.dedup();
    let others = ["EKF2_OF_CTRL", "SYS_HAS_MAG", "SENS_EN_PX4FLOW"].map(str::to_owned);
    let links = (0..=2).flat_map(|n| ["CONFIG", "MODE"].map(|k| format!("MAV_{n}_{k}")));
    one.into_iter().chain(others).chain(links).collect()
}

/// What is wrong with it.
pub(super) fn judge(case: &Case<'_>) -> Vec<Finding> {
    if !case.needs.sends() {
        return Vec::new();
    }
    let mut out = apply(RULES, case);
    out.extend(rate(case));
    out.extend(same_flow(case));
    out.extend(modes(case));
    out
}

/// What EKF2_EV_CTRL has to hold for what is sent.
fn needed(case: &Case<'_>) -> u32 {
    match case.needs.carriage {
        Carriage::Odometry => POSITION | VELOCITY,
        Carriage::VisionPositionEstimate => POSITION,
    }
}

fn has_magnetometer(case: &Case<'_>) -> bool {
    case.readings.parameter("SYS_HAS_MAG").is_none_or(|n| n > 0.0)
}

/// Whether PX4 takes our stamps: it believes TIMESYNC, and that is quick enough.
fn synchronised(case: &Case<'_>) -> bool {
    case.readings.round_trip.is_some_and(|r| r.seconds() * 1e3 < TIMESYNC_LIMIT_MS)
}

/// What EKF2_EV_DELAY should be, ms; `None` where the round trip is not known.
fn delay_ms(case: &Case<'_>) -> Option<f64> {
    let one_way = case.readings.one_way_ms()?;
    Some(if synchronised(case) { 0.0 } else { one_way.round().clamp(0.0, 300.0) })
}

static RULES: &[Rule] = &[
    Rule {
        name: "EKF2_EV_CTRL",
        grade: FindingGrade::Fault,
        good: |v, c| bits(v, needed(c)) && (!bits(v, YAW) || !has_magnetometer(c)),
        mend: |_, c| f64::from(needed(c)),
        should: "7 with ODOMETRY: position and velocity, not yaw (3 with VISION_POSITION_ESTIMATE)",
        why: "what is not chosen here is not fused; with the yaw bit (8) PX4 copies our error of heading into its own",
        reboot: false,
    },
    Rule {
        name: "EKF2_HGT_REF",
        grade: FindingGrade::Fault,
        good: |v, _| v != VISION_HEIGHT,
        mend: |_, _| 0.0,
        should: "0 (barometer), never 3",
        why: "the reference of the height would be ours: it would follow its own error",
        reboot: true,
    },
    Rule {
        name: "EKF2_HGT_REF",
        grade: FindingGrade::Advice,
        good: |v, _| v == 0.0 || v == VISION_HEIGHT,
        mend: |_, _| 0.0,
        should: "0 (barometer)",
        why: "the reference of the height goes with GNSS, and another takes over in the moment of the loss",
        reboot: true,
    },
    Rule {
        name: "EKF2_EV_DELAY",
        grade: FindingGrade::Fault,
        good: |v, c| delay_ms(c).is_none_or(|ms| (v - ms).abs() <= DELAY_TOLERANCE_MS),
        mend: |v, c| delay_ms(c).unwrap_or(v),
        should: "0 with TIMESYNC below 10 ms, else half of the round trip",
        why: "with TIMESYNC our stamps are used, and a delay is counted twice; a round trip of 10 ms or more is thrown away, and the time \
              of arrival is used",
        reboot: true,
    },
    Rule {
        name: "EKF2_DELAY_MAX",
        grade: FindingGrade::Fault,
        good: |v, c| c.readings.one_way_ms().is_none_or(|ms| v >= ms + DELAY_MARGIN_MS),
        mend: |v, c| {
            let ms = c.readings.one_way_ms().unwrap_or(0.0) + 2.0 * DELAY_MARGIN_MS;
            v.max((ms / 50.0).ceil() * 50.0).min(1000.0)
        },
        should: "half of the round trip and 50 ms more",
        why: "what comes later is dropped, and nobody is told",
        reboot: true,
    },
    Rule {
        name: "EKF2_EV_QMIN",
        grade: FindingGrade::Fault,
        good: |v, c| v <= if c.needs.carriage == Carriage::Odometry { GREATEST_FLOOR } else { 0.0 },
        mend: |_, _| 0.0,
        should: "0; up to 20 with ODOMETRY",
        why: "what is below is not fused: VISION_POSITION_ESTIMATE carries no quality, and ODOMETRY's falls as the position becomes uncertain",
        reboot: false,
    },
    Rule {
        name: "EKF2_EV_NOISE_MD",
        grade: FindingGrade::Fault,
        good: |v, _| v == 0.0,
        mend: |_, _| 0.0,
        should: "",
        why: "our variances are not used, and they are what grows when the position becomes uncertain",
        reboot: false,
    },
    Rule {
        name: "EKF2_NOAID_TOUT",
        grade: FindingGrade::Fault,
        good: |v, c| v * 1e-6 >= c.needs.loss_s + FIRST_MESSAGE_S,
        mend: |_, c| ((c.needs.loss_s + FIRST_MESSAGE_S) * 1e6).clamp(5e6, 1e7),
        should: "5000000 (5 s), more than a loss takes to be decided and our first message to be fused",
        why: "PX4 gives up its position before ours is there",
        reboot: false,
    },
];

fn rate(case: &Case<'_>) -> Option<Finding> {
    let rate = case.needs.rate_hz;
    let why = "PX4 begins to fuse from 5.3 messages a second on";
    (rate < LEAST_RATE_HZ)
        .then(|| Finding::key(FindingGrade::Fault, ("outbound.rate_hz", plain(rate)), "30", why))
}

fn same_flow(case: &Case<'_>) -> Option<Finding> {
    let value = case.readings.parameter("EKF2_OF_CTRL").filter(|v| *v > 0.0)?;
    if !case.needs.uses.flow || !case.readings.has(SampleKind::Flow) {
        return None;
    }
    let why = "PX4 fuses the same flow itself: its estimate and ours share that sensor's errors, and do not confirm each other";
    Some(Finding::parameter(FindingGrade::Advice, ("EKF2_OF_CTRL", value), "known", None, why))
}

/// Serial links that are not in the mode whose streams a companion needs, where the IMU is slow.
fn modes(case: &Case<'_>) -> Vec<Finding> {
    if case.readings.rate_hz(SampleKind::Imu) >= GOOD_IMU_HZ {
        return Vec::new();
    }
    let judge = |n: u8| {
        let name = format!("MAV_{n}_MODE");
        case.readings.parameter(&format!("MAV_{n}_CONFIG")).filter(|c| *c > 0.0)?;
        let mode = case.readings.parameter(&name).filter(|m| *m != ONBOARD)?;
        let why = "if this is the link to Holdover: other modes, and a MAV_x_RATE, slow the streams down";
        Some(Finding::parameter(FindingGrade::Advice, (&name, mode), "2 (onboard)", None, why))
    };
    (0..=2).filter_map(judge).collect()
}
