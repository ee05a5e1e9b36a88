//! Everything that can be set, in SI units. The configuration is validated into this.

use std::sync::Arc;
use strum::VariantArray;

use serde::{Deserialize, Serialize};

use crate::altimeter::{AltimeterKind, AltimeterSettings};
use crate::camera::{CalibrationSettings, PatchLimits, PatchTable};
use crate::geo::{CameraMount, Geodetic};

use crate::filter::error_state::EskfSettings;

pub use super::monitor::budget::BudgetSettings;
pub use super::monitor::gnss_integrity::TrustSettings;
pub use super::sources::airspeed::AirSettings;
pub use super::sources::drag::DragSettings;
use super::sources::landmarks::LandmarkSetup;

/// What navigates.
#[derive(
    Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize, strum::IntoStaticStr, strum::VariantArray,
)]
#[serde(rename_all = "snake_case")]
pub enum Estimator {
    /// The best there is, what the daemon flies: the error-state filter, started and watched by the observers.
    #[strum(serialize = "shipped")]
    Shipped,
    /// The nonlinear observers, tuned.
    #[strum(serialize = "nlo")]
    Nlo,
    /// The nonlinear observers with the gains and discretisation that the papers print; the flow's errors are taken out as for the others,
    /// see [`FlowBiasSource`].
    #[strum(serialize = "nlo_printed")]
    NloPrinted,
    /// The paper's filter: an exogenous Kalman filter over the nonlinear observers (Fusini (10), (2)).
    #[strum(serialize = "xkf")]
    Xkf,
    /// The baseline: an error-state Kalman filter with attitude, position, velocity and IMU biases (15 states) and a flow bias, fed with
    /// IMU, GNSS, flow, magnetometer and height.
    #[strum(serialize = "ekf15")]
    Ekf15,
    /// The shipped filter with GNSS, inertial coasting without: what there is to be gained from flow and airspeed.
    #[strum(serialize = "inertial")]
    Inertial,
}

impl Estimator {
    /// All, in the order they are shown.
    pub const ALL: &'static [Self] = Self::VARIANTS;

    /// Its name, as in the configuration.
    pub fn label(self) -> &'static str {
        self.into()
    }

    /// Whether an error-state filter runs and is published.
    pub const fn has_filter(self) -> bool {
        matches!(self, Estimator::Shipped | Estimator::Ekf15 | Estimator::Inertial)
    }
}

/// Settings of the navigator.
#[derive(Clone, Debug, PartialEq)]
pub struct NavigatorSettings {
    /// What navigates.
    pub estimator: Estimator,
    /// IMU.
    pub imu: ImuSettings,
    /// Magnetometer.
    pub magnetometer: MagnetometerSettings,
    /// Filter.
    pub kalman: EskfSettings,
    /// Where nobody has a fix.
    pub start: StartSettings,
    /// Receiver.
    pub gnss: GnssSettings,
    /// Flow sensor.
    pub flow: FlowSettings,
    /// Airspeed.
    pub air: AirSettings,
    /// Rotor drag.
    pub drag: DragSettings,
    /// Known landmarks; without any no sighting is used. Shared, for settings are copied.
    pub landmarks: Option<Arc<LandmarkSetup>>,
    /// Rangefinder samples are used for this long, s.
    pub range_max_age_s: f64,
    /// Height.
    pub height: HeightSettings,
    /// Gains.
    pub observer: ObserverSettings,
    /// Dead reckoning.
    pub holdover: HoldoverSettings,
    /// The way back.
    pub rejoin: RejoinSettings,
}

/// How to start where no receiver has ever had a fix.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct StartSettings {
    /// A vehicle with optical flow that has heard no fix for this long starts without, s; `None`: it waits.
    pub without_gnss_s: Option<f64>,
    /// Where that is, if it is known.
    pub place: Option<Geodetic>,
}

/// Settings of the IMU's stream.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct ImuSettings {
    /// A longer hole in the stream interrupts the navigation, s.
    pub max_gap_s: f64,
    /// The filter is carried over holes up to this, s.
    pub bridge_s: f64,
    /// Samples are values of an instant, as autopilots stream them, and not means over the interval before.
    pub instantaneous: bool,
}

/// Settings of the magnetometer.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct MagnetometerSettings {
    /// Use it.
    pub enabled: bool,
    /// Largest relative deviation of the field's strength.
    pub norm_error: f64,
    /// Noise of an axis, T.
    pub sigma_t: f64,
}

/// Settings of the height.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct HeightSettings {
    /// Which altimeter.
    pub kind: AltimeterKind,
    /// The fault-tolerant altimeter.
    pub altimeter: AltimeterSettings,
    /// Noise density of the vertical acceleration beyond the altimeter's own, per acceleration: (m/s²/√Hz)/(m/s²).
    pub accel_load_noise: f64,
    /// The rangefinder is a source of heights below this height over ground, m.
    pub range_below_m: f64,
    /// The barometer is in the ground effect below this height over ground, m …
    pub ground_effect_below_m: f64,
    /// … and its offset walks by this much there, m/√s.
    pub ground_effect_walk: f64,
    /// The ground under a vehicle that moves changes by this much, m/√s.
    pub ground_walk: f64,
    /// Speed at which the published height glides to the estimate, m/s.
    pub glide_mps: f64,
    /// A longer way is jumped, and the reset counter says so, m.
    pub jump_m: f64,
}

/// Settings of GNSS.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct GnssSettings {
    /// Age of a fix beyond its own stamp, s.
    pub delay_s: f64,
    /// Its standard deviation, s; 0 keeps it.
    pub delay_sigma_s: f64,
    /// Horizontal accuracy of a fix that claims none, m.
    pub default_accuracy_m: f64,
    /// Trust.
    pub trust: TrustSettings,
}

/// Settings of the flow.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct FlowSettings {
    /// Use it.
    pub enabled: bool,
    /// Age of a sample beyond its own stamp, s.
    pub delay_s: f64,
    /// Its standard deviation, s; 0 keeps it.
    pub delay_sigma_s: f64,
    /// Noise of the rate of a sample, rad/s.
    pub rate_noise_radps: f64,
    /// What is refused.
    pub limits: PatchLimits,
    /// Where and how the camera sits.
    pub mount: CameraMount,
    /// Sensor ids that are patches of one image.
    pub patches: PatchTable,
    /// What is known beforehand.
    pub calibration: CalibrationSettings,
}

/// What takes the flow's systematic errors out before an observer sees it.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum FlowBiasSource {
    /// The calibration against GNSS: bias, scale and misalignment. The one to use.
    Calibration,
    /// The low pass of Fusini, Section IV, in body axes: [`crate::observer::fusini::FlowBiasForm::Body`].
    Body,
    /// The same as printed: [`crate::observer::fusini::FlowBiasForm::AsPrinted`].
    AsPrinted,
}

/// Gains of the observers.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct ObserverSettings {
    /// K_P, 1/s.
    pub k_p: f64,
    /// k_I, 1/s.
    pub k_i: f64,
    /// The start-up gains are in force for this long after the first guess of the attitude, s.
    pub start_s: f64,
    /// The velocity of fixes is injected, too; without, Grip's observer is that of Theorem 2.
    pub gnss_velocity: bool,
    /// What takes the flow's errors out.
    pub flow_bias: FlowBiasSource,
    /// Time constant of the low pass, s.
    pub flow_bias_time_s: f64,
    /// Factor on K_P in holdover.
    pub holdover_k_p_factor: f64,
    /// K'_vv, 1/s.
    pub holdover_k_vv: f64,
    /// K'_ξv, 1/s².
    pub holdover_k_xv: f64,
    /// Assumption 3's bound, m²/s³.
    pub guard: f64,
    /// The attitude is found when ‖J‖ stays below this …
    pub aligned_injection: f64,
    /// … for this long, s.
    pub aligned_s: f64,
}

/// Settings of dead reckoning.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct HoldoverSettings {
    /// Horizontal uncertainty that is called lost, m.
    pub max_sigma_m: f64,
    /// Longest coasting, s.
    pub max_coast_s: f64,
    /// The vehicle cannot fly faster over ground, m/s; `None`: by its class.
    pub max_speed_mps: Option<f64>,
    /// Error sources.
    pub budget: BudgetSettings,
}

/// Settings of the way back to GNSS.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct RejoinSettings {
    /// Speed of the glide, m/s.
    pub glide_mps: f64,
    /// A longer way is jumped, m.
    pub jump_m: f64,
}
