//! What ArduPilot has to be set to.
//!
//! From its sources (AP_VisualOdom, AP_NavEKF_Source, AP_Arming) and from flights with 4.7: VISO_TYPE and a source set with external
//! navigation have to stand at boot, the EKF makes room for it only then; what is dropped is dropped without a word.

use std::ops::RangeInclusive;

use crate::outbound::Carriage;
use crate::sample::SampleKind;

use super::Case;
use super::finding::{Finding, FindingGrade, plain};
use super::rule::{Rule, apply, bits};

/// `AP_NavEKF_Source`: external navigation, the compass, the barometer.
const EXTERNAL: f64 = 6.0;
const COMPASS: f64 = 1.0;
const BARO: f64 = 1.0;
/// `EK3_SRC_OPTIONS`: the velocities of all sources are fused.
const FUSE_ALL: u32 = 1;
/// Bits of ARMING_CHECK and ARMING_SKIPCHK: all, visual odometry.
const CHECK_ALL: u32 = 1;
const CHECK_VISION: u32 = 1 << 18;
/// `RCx_OPTION`: EKF source set.
const SOURCE_SWITCH: f64 = 90.0;
/// A floor under our quality above this refuses positions that are still good.
const GREATEST_FLOOR: f64 = 20.0;
/// The delay may be off by this, ms: 0.3 m at 10 m/s.
const DELAY_TOLERANCE_MS: f64 = 30.0;

/// Parameters that have another name in other versions.
pub(super) const OTHER_NAMES: [(&str, &str); 2] =
    [("RNGFND1_MAX", "RNGFND1_MAX_CM"), ("ARMING_CHECK", "ARMING_SKIPCHK")];

const SOURCES: [&str; 5] = ["POSXY", "VELXY", "POSZ", "VELZ", "YAW"];
const CHANNELS: RangeInclusive<u8> = 5..=16;
/// Serial ports, and `SERIALn_PROTOCOL`: MAVLink 1, MAVLink 2.
const PORTS: RangeInclusive<u8> = 0..=7;
const MAVLINK1: f64 = 1.0;
const MAVLINK2: f64 = 2.0;

/// The parameters to read.
pub(super) fn wanted() -> Vec<String> {
    let one = RULES.iter().map(|r| r.name.to_owned());
    let sets = (1..=3).flat_map(|n| SOURCES.iter().map(move |s| format!("EK3_SRC{n}_{s}")));
    let others = ["FLOW_TYPE", "RNGFND1_TYPE"].into_iter().map(str::to_owned);
    let renamed = OTHER_NAMES.iter().flat_map(|(a, b)| [(*a).to_owned(), (*b).to_owned()]);
    let channels = CHANNELS.map(|n| format!("RC{n}_OPTION"));
    let ports = PORTS.map(|n| format!("SERIAL{n}_PROTOCOL"));
    one.chain(sets).chain(others).chain(renamed).chain(channels).chain(ports).collect()
}

/// What is wrong with it.
pub(super) fn judge(case: &Case<'_>) -> Vec<Finding> {
    if !case.needs.sends() {
        return Vec::new();
    }
    let mut out = apply(RULES, case);
    out.extend(ports(case));
    out.extend(sources(case));
    out.extend(arming(case));
    out.extend(rangefinder(case));
    out.extend(switch(case));
    out
}

static RULES: &[Rule] = &[
    Rule {
        name: "VISO_TYPE",
        grade: FindingGrade::Fault,
        good: |v, _| v == 1.0 || v == 3.0,
        mend: |_, _| 1.0,
        should: "1 (MAVLink) or 3",
        why: "external navigation is not taken at all",
        reboot: true,
    },
    Rule {
        name: "EK3_ENABLE",
        grade: FindingGrade::Fault,
        good: |v, _| v == 1.0,
        mend: |_, _| 1.0,
        should: "",
        why: "only EKF3 takes external navigation",
        reboot: true,
    },
    Rule {
        name: "AHRS_EKF_TYPE",
        grade: FindingGrade::Fault,
        good: |v, _| v == 3.0,
        mend: |_, _| 3.0,
        should: "",
        why: "the vehicle does not fly on EKF3, the one that takes external navigation",
        reboot: false,
    },
    Rule {
        name: "EK3_SRC_OPTIONS",
        grade: FindingGrade::Fault,
        good: |v, _| !bits(v, FUSE_ALL),
        mend: |v, _| f64::from(v as i64 as u32 & !FUSE_ALL),
        should: "without bit 0",
        why: "bit 0 fuses the velocities of all sources at a time: a lost or lying GNSS stays in the estimate",
        reboot: false,
    },
    Rule {
        name: "VISO_QUAL_MIN",
        grade: FindingGrade::Fault,
        good: |v, c| v <= if c.needs.carriage == Carriage::Odometry { GREATEST_FLOOR } else { 0.0 },
        mend: |_, _| 0.0,
        should: "0; up to 20 with ODOMETRY",
        why: "what is below is ignored without a word: VISION_POSITION_ESTIMATE carries no quality, and ODOMETRY's falls as the position \
              becomes uncertain",
        reboot: false,
    },
    Rule {
        name: "VISO_DELAY_MS",
        grade: FindingGrade::Fault,
        good: |v, c| c.readings.one_way_ms().is_none_or(|ms| (v - ms).abs() <= DELAY_TOLERANCE_MS),
        mend: |v, c| c.readings.one_way_ms().map_or(v, |ms| ms.round().clamp(0.0, 250.0)),
        should: "half of the measured round trip",
        why: "a constant delay is invisible to the EKF: 80 ms at 25 m/s are 2 m behind, for good",
        reboot: false,
    },
];

/// One of the EKF's source sets.
struct EkfSourceSet<'a> {
    case: &'a Case<'a>,
    number: u8,
}

impl EkfSourceSet<'_> {
    fn name(&self, source: &str) -> String {
        format!("EK3_SRC{}_{source}", self.number)
    }

    fn get(&self, source: &str) -> Option<f64> {
        self.case.readings.parameter(&self.name(source))
    }

    fn takes_us(&self) -> bool {
        self.get("POSXY") == Some(EXTERNAL)
    }

    fn is_free(&self) -> bool {
        self.get("POSXY") == Some(0.0) && self.get("VELXY") == Some(0.0)
    }

    /// What is wrong with a set that has our position, or is to have it.
    fn judge(&self) -> Vec<Finding> {
        let rows: [(&str, &[f64], f64, &str); 5] = [
            ("POSXY", &[EXTERNAL], EXTERNAL, "no source set takes our position"),
            (
                "VELXY",
                &[EXTERNAL],
                EXTERNAL,
                "our velocity is not taken: the EKF follows it more than the position",
            ),
            ("VELZ", &[0.0, EXTERNAL], EXTERNAL, "a source of this set that is lost together with GNSS"),
            ("POSZ", &[BARO, EXTERNAL], BARO, "the height of this set has to be there without GNSS"),
            ("YAW", &[COMPASS, EXTERNAL], COMPASS, "the heading of this set has to be there without GNSS"),
        ];
        let new = !self.takes_us();
        let judge = |(source, good, mend, why): (&str, &[f64], f64, &str)| {
            let value = self.get(source)?;
            let should: Vec<String> = good.iter().map(|g| plain(*g)).collect();
            let name = self.name(source);
            let found =
                Finding::parameter(FindingGrade::Fault, (&name, value), should.join(" or "), Some(mend), why);
            (!good.contains(&value)).then(|| if new { found.at_boot() } else { found })
        };
        rows.into_iter().filter_map(judge).collect()
    }
}

/// The set that navigates by GNSS has to do so, and the one that is switched to has to take what is sent.
fn sources(case: &Case<'_>) -> Vec<Finding> {
    let set = |number| EkfSourceSet { case, number };
    let (gnss, external) = (set(case.needs.sets.gnss), set(case.needs.sets.external));
    let mut out = Vec::new();
    if gnss.takes_us() && !case.needs.sends_before_a_loss() {
        let why = format!(
            "{} is 6: the EKF flies on us from the start, and gets nothing before GNSS is lost",
            gnss.name("POSXY")
        );
        out.push(publish(case, &why));
    }
    let Some(value) = external.get("POSXY") else { return out };
    if external.takes_us() || external.is_free() {
        out.extend(external.judge());
        return out;
    }
    match (1..=3).map(set).find(|s| s.takes_us() && s.number != gnss.number) {
        Some(other) => {
            let why = "that set has other sources, and this one has ours";
            let key = ("tuning.handover.external_set", external.number);
            out.push(Finding::key(FindingGrade::Fault, key, &other.number.to_string(), why));
        }
        None => {
            let why = "no source set takes external navigation, and this one is in use: free it, or choose another (handover.external_set)";
            out.push(Finding::parameter(
                FindingGrade::Fault,
                (&external.name("POSXY"), value),
                "6",
                None,
                why,
            ));
        }
    }
    out
}

fn publish(case: &Case<'_>, why: &str) -> Finding {
    let now = serde_json::to_value(case.needs.publish).unwrap_or_default();
    let now = now.as_str().unwrap_or_default().to_owned();
    Finding::key(FindingGrade::Fault, ("outbound.publish", now), "auto", why)
}

/// With VISO_TYPE set, ArduPilot arms only while messages come.
fn arming(case: &Case<'_>) -> Option<Finding> {
    let parameter = |name| case.readings.parameter(name);
    let checked = parameter("ARMING_CHECK").is_some_and(|v| bits(v, CHECK_ALL) || bits(v, CHECK_VISION))
        || parameter("ARMING_SKIPCHK").is_some_and(|v| !bits(v, CHECK_VISION));
    if !checked || case.needs.sends_before_a_loss() {
        return None;
    }
    Some(publish(
        case,
        "ArduPilot does not arm (\"VisOdom: not healthy\") unless messages come before the loss",
    ))
}

/// Ports that may be the one that leads here and sends MAVLink 1.
fn ports(case: &Case<'_>) -> Vec<Finding> {
    if !case.readings.mavlink1 {
        return Vec::new();
    }
    let old = |name: &String| case.readings.parameter(name) == Some(MAVLINK1);
    let names: Vec<String> = PORTS.map(|n| format!("SERIAL{n}_PROTOCOL")).filter(old).collect();
    // Of several only a person knows which is meant.
    let mend = (names.len() == 1).then_some(MAVLINK2);
    let why = "MAVLink 1 has no ODOMETRY";
    let judge = |name: &String| {
        Finding::parameter(
            FindingGrade::Fault,
            (name, MAVLINK1),
            "2 if it is the port that leads here",
            mend,
            why,
        )
        .at_boot()
    };
    names.iter().map(judge).collect()
}

/// The rangefinder's greatest distance, m.
pub(super) fn greatest_range_m(case: &Case<'_>) -> Option<f64> {
    let parameter = |name| case.readings.parameter(name);
    parameter("RNGFND1_TYPE").filter(|t| *t > 0.0)?;
    parameter("RNGFND1_MAX").or_else(|| Some(parameter("RNGFND1_MAX_CM")? / 100.0))
}

fn rangefinder(case: &Case<'_>) -> Option<Finding> {
    let (greatest, altitude) = (greatest_range_m(case)?, case.needs.altitude_m?);
    let needed = case.needs.uses.flow && case.readings.has(SampleKind::Flow) && greatest < altitude;
    let in_m = case.readings.parameter("RNGFND1_MAX").is_some();
    let (name, unit) = if in_m { ("RNGFND1_MAX", 1.0) } else { ("RNGFND1_MAX_CM", 100.0) };
    needed.then(|| {
        let should = format!("{} or more, if the sensor reaches so far", plain(altitude * unit));
        let why = "above it the flow has no measured height";
        Finding::parameter(FindingGrade::Fault, (name, greatest * unit), should, None, why)
    })
}

fn switch(case: &Case<'_>) -> Option<Finding> {
    let name = CHANNELS
        .map(|n| format!("RC{n}_OPTION"))
        .find(|name| case.readings.parameter(name) == Some(SOURCE_SWITCH))?;
    let why = "low is set 1, middle set 2, high set 3: a switch that stands in the middle at boot starts on set 2, without GNSS";
    Some(Finding::parameter(FindingGrade::Advice, (&name, SOURCE_SWITCH), "low at boot", None, why))
}
