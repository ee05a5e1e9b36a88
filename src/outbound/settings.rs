//! What can be chosen of the output.

use serde::{Deserialize, Serialize};
use strum::{Display, EnumString};

/// When to send.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Publish {
    /// As the autopilot needs it: see [`super::handover`].
    Auto,
    /// While GNSS is not trusted, until the position has glided back and the autopilot has been seen on GNSS.
    Holdover,
    /// Whenever there is a solution.
    Always,
    /// Not at all: look, do not touch.
    Never,
}

/// Whether a position that nothing but inertia carries is sent in an outage.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Coasting {
    /// Not at all.
    Never,
    /// Over gaps in what else carries: see the module `coasting`.
    Briefly,
    /// For as long as the navigator does not call itself lost.
    Always,
}

/// Which covariance is sent.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Covariance {
    /// What makes an autopilot that takes it for white noise weigh ours as they deserve: see the module `covariance`.
    Correlated,
    /// The navigator's own.
    Absolute,
}

/// Which message carries the solution.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Carriage {
    /// ODOMETRY (331).
    Odometry,
    /// VISION_POSITION_ESTIMATE (102), and for ArduPilot VISION_SPEED_ESTIMATE (103).
    VisionPositionEstimate,
}

/// How a kind of autopilot wants to be told.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize, Display, EnumString)]
#[serde(rename_all = "snake_case")]
#[strum(serialize_all = "snake_case", parse_err_ty = String, parse_err_fn = unknown_profile)]
pub enum Profile {
    /// ArduPilot.
    Ardupilot,
    /// PX4.
    Px4,
}

fn unknown_profile(name: &str) -> String {
    format!("unknown profile \"{name}\": expected \"ardupilot\" or \"px4\"")
}

/// Settings of the output.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct OutboundSettings {
    /// When to send.
    pub publish: Publish,
    /// Whether inertia alone is sent.
    pub coasting: Coasting,
    /// Which covariance.
    pub covariance: Covariance,
    /// Which message.
    pub carriage: Carriage,
    /// For whom.
    pub profile: Profile,
    /// Messages a second.
    pub rate_hz: f64,
    /// Horizontal uncertainty at which the quality reaches 1, m: where the navigator calls itself lost.
    pub worst_sigma_m: f64,
    /// For how long a lost navigator says so (quality -1) before it is silent, s.
    pub farewell_s: f64,
}
