//! What the configuration will send and needs: the side of the comparison that is not the autopilot's.

use crate::config::Settings;
use crate::navigator::settings::BudgetSettings;
use crate::outbound::{Carriage, Profile, Publish};
use crate::wire::session::standing_watch::SourceSets;

/// What an autopilot has to be set up for.
#[derive(Clone, Debug)]
pub struct Needs {
    /// When the position is sent.
    pub publish: Publish,
    /// By which message.
    pub carriage: Carriage,
    /// How often, Hz.
    pub rate_hz: f64,
    /// A configured profile; `None` is the autopilot's own.
    pub profile: Option<Profile>,
    /// Whether streams are asked for.
    pub requests: bool,
    /// Rate of the IMU that is asked for, Hz.
    pub imu_hz: f64,
    /// Which sources of the velocity are used.
    pub uses: Uses,
    /// ArduPilot's source sets.
    pub sets: SourceSets,
    /// A loss of GNSS is decided after this, s.
    pub loss_s: f64,
    /// Without any fix the navigation starts where the vehicle is after this, s; `None` waits for GNSS.
    pub without_gnss_s: Option<f64>,
    /// Without any velocity the navigator calls itself lost after this, s.
    pub max_coast_s: f64,
    /// How inertial coasting drifts.
    pub budget: BudgetSettings,
    /// Greatest height over ground of the flight, m, where it was told.
    pub altitude_m: Option<f64>,
}

/// Sensors that the configuration uses where they are heard.
#[derive(Clone, Copy, Debug)]
pub struct Uses {
    /// Optical flow.
    pub flow: bool,
    /// Magnetometer.
    pub magnetometer: bool,
    /// Airspeed of a fixed wing.
    pub airspeed: bool,
    /// Rotor drag.
    pub drag: bool,
    /// Known landmarks.
    pub landmarks: bool,
}

impl Needs {
    /// Of these settings, for a flight up to `altitude_m` over ground.
    pub fn of(settings: &Settings, altitude_m: Option<f64>) -> Self {
        let navigator = &settings.pipeline.navigator;
        let outbound = &settings.pipeline.outbound;
        Self {
            publish: outbound.publish,
            carriage: outbound.carriage,
            rate_hz: outbound.rate_hz,
            profile: settings.pipeline.profile,
            requests: settings.streams.request,
            imu_hz: settings.streams.imu_hz,
            uses: Uses {
                flow: navigator.flow.enabled,
                magnetometer: navigator.magnetometer.enabled,
                airspeed: navigator.air.enabled,
                drag: navigator.drag.enabled,
                landmarks: navigator.landmarks.is_some(),
            },
            sets: settings.source_switch.sets,
            loss_s: navigator.gnss.trust.loss_s,
            without_gnss_s: navigator.start.without_gnss_s,
            max_coast_s: navigator.holdover.max_coast_s,
            budget: navigator.holdover.budget,
            altitude_m,
        }
    }

    /// Whether anything is sent at all.
    pub fn sends(&self) -> bool {
        self.publish != Publish::Never
    }

    /// Whether the position is sent before GNSS is lost, too.
    pub fn sends_before_a_loss(&self) -> bool {
        !matches!(self.publish, Publish::Holdover | Publish::Never)
    }
}
