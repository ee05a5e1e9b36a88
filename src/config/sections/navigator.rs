//! `[navigator]`: which algorithms run.

use serde::Deserialize;

use crate::altimeter::{AltimeterKind, AltimeterMethod};
use crate::config::key::{Type, Typed, section};
use crate::navigator::settings::Estimator;

section! {
    /// Which algorithms run.
    "navigator" struct NavigatorKeys {
        /// What navigates: "shipped" is the error-state filter started and watched by the observers; "nlo" the tuned nonlinear observers alone; "nlo_printed" with the gains as printed; "xkf" the exogenous Kalman filter over them; "ekf15" is a plain Kalman filter, for comparison; "inertial" coasts.
        estimator: Estimator = "shipped" of "shipped" | "nlo" | "nlo_printed" | "xkf" | "ekf15" | "inertial" was "observer.estimator";
        /// The altimeter: "default" is the fault-tolerant one; the others are the published baro-inertial-GNSS altimeters with the optimal Kalman filter, the robust one as printed or with the consistent covariance, or the mode that the paper recommends, for comparison.
        altimeter: AltimeterName = "default" of "default" | "okf" | "rkf" | "rkf_joseph" | "selector" was "height.filter";
    }
}

/// The altimeters by the names that the configuration has for them.
#[derive(Clone, Copy, Debug, Deserialize)]
#[serde(rename_all = "snake_case")]
pub(in crate::config) enum AltimeterName {
    Default,
    Okf,
    Rkf,
    RkfJoseph,
    Selector,
}

impl Typed for AltimeterName {
    const TYPE: Type = Type::Text;
}

impl From<AltimeterName> for AltimeterKind {
    fn from(name: AltimeterName) -> Self {
        match name {
            AltimeterName::Default => Self::FaultTolerant,
            AltimeterName::Okf => Self::Published(AltimeterMethod::Okf),
            AltimeterName::Rkf => Self::Published(AltimeterMethod::Rkf),
            AltimeterName::RkfJoseph => Self::Published(AltimeterMethod::RkfJoseph),
            AltimeterName::Selector => Self::Published(AltimeterMethod::Selector),
        }
    }
}
