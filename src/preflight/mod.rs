//! Before the flight: whether an autopilot is set up for what Holdover will send, and sends what Holdover needs.
//!
//! [`conversation`] reads it out, told what was heard and what time it is; [`judge`] compares what was read with what is needed, and is a
//! pure function; [`outlook`] says what a loss of GNSS would be carried by. Nothing here knows a link or a clock.

mod ardupilot;
pub mod conversation;
pub mod finding;
mod needs;
pub mod outlook;
mod px4;
pub mod readings;
pub mod recent_rate;
mod rule;
mod streams;
#[cfg(test)]
mod tests;

use crate::wire::session::identity::AutopilotKind;

use finding::Finding;
pub use needs::Needs;
use readings::Readings;

/// What was read, and what is needed: all that a rule knows.
#[derive(Clone, Copy, Debug)]
struct Case<'a> {
    readings: &'a Readings,
    needs: &'a Needs,
}

/// The parameters to read of an autopilot of this kind.
pub fn wanted_parameters(autopilot: AutopilotKind) -> Vec<String> {
    match autopilot {
        AutopilotKind::ArduPilot => ardupilot::wanted(),
        AutopilotKind::Px4 => px4::wanted(),
        AutopilotKind::Other(_) => Vec::new(),
    }
}

/// Everything that is wrong, and everything that is worth knowing: faults first.
pub fn judge(readings: &Readings, needs: &Needs) -> Vec<Finding> {
    let case = Case { readings, needs };
    let mut findings = streams::judge(&case);
    match readings.vehicle.autopilot {
        AutopilotKind::ArduPilot => findings.extend(ardupilot::judge(&case)),
        AutopilotKind::Px4 => findings.extend(px4::judge(&case)),
        AutopilotKind::Other(_) => findings.push(streams::unknown_autopilot(&case)),
    }
    findings.extend(outlook::outlook(readings, needs).finding);
    findings.sort_by_key(|f| f.grade);
    findings
}

/// The parameters that were not told, without those that only some versions, or some numbers of ports and channels, have.
pub fn untold(readings: &Readings) -> Vec<String> {
    let known = |name: &str| readings.parameters.contains_key(name);
    let of_some = |name: &str| {
        ["SERIAL", "RC", "MAV_", "SENS_EN_"].iter().any(|p| name.starts_with(p))
            || ardupilot::OTHER_NAMES
                .iter()
                .any(|(a, b)| (name == *a && known(b)) || (name == *b && known(a)))
    };
    readings.untold.iter().filter(|name| !of_some(name)).cloned().collect()
}
