//! SourceSet: one file a sensor, each with its state and with what makes it start, stop, be used and be forgotten.
//!
//! A source turns a sample into an observation, or into a reason why not. It reads the `Context`; it never touches the
//! estimator. To add one: a file here, an arm in `SourceKind`, and a line where its samples come in.

mod agreement;
pub mod airspeed;
mod airspeed_refit;
mod airspeed_watch;
pub(super) mod barometer;
mod compass_step;
pub mod drag;
pub(super) mod flow;
mod following;
pub(super) mod gnss;
mod gnss_latency;
mod held_course;
mod inertial_noise;
pub mod landmarks;
mod latency;
mod magnetic_latency;
mod magnetic_noise;
pub(super) mod magnetometer;
pub(super) mod parting;
mod rangefinder;
pub(super) mod rangefinders;
pub(super) mod standstill;
pub mod status;
pub(super) mod takeoff;

use nalgebra::Vector2;

use crate::altimeter::Channel;

use super::context::{Context, SourceFacts};
use super::core::Core;
use super::monitor::GnssState;
use super::reset::Reset;
use super::settings::NavigatorSettings;
use crate::navigator::tuning::every_source::SILENT_S;
use status::{SourceHealth, SourceKind, SourceStatus};
use takeoff::Ground;

/// Every source of a vehicle.
#[derive(Clone, Debug)]
pub(super) struct SourceSet {
    pub(super) gnss: gnss::GnssSource,
    pub(super) magnetometer: magnetometer::MagnetometerSource,
    pub(super) barometer: barometer::BarometerSource,
    pub(super) rangefinders: rangefinders::Rangefinders,
    pub(super) flow: flow::FlowSource,
    pub(super) airspeed: airspeed::AirspeedSource,
    pub(super) drag: drag::DragSource,
    pub(super) standstill: standstill::StandstillSource,
    pub(super) takeoff: takeoff::TakeoffPlace,
    /// Where landmarks are configured.
    pub(super) landmarks: Option<landmarks::LandmarkSource>,
}

impl SourceSet {
    pub(super) fn new(settings: &NavigatorSettings) -> Self {
        Self {
            gnss: gnss::GnssSource::new(&settings.gnss, settings.kalman.accel_noise),
            magnetometer: magnetometer::MagnetometerSource::new(
                settings.magnetometer.sigma_t,
                settings.kalman.magnetic_bias_walk,
            ),
            barometer: barometer::BarometerSource::default(),
            rangefinders: rangefinders::Rangefinders::default(),
            flow: flow::FlowSource::new(),
            airspeed: airspeed::AirspeedSource::default(),
            drag: drag::DragSource::new(&settings.drag),
            standstill: standstill::StandstillSource::default(),
            takeoff: takeoff::TakeoffPlace::default(),
            landmarks: settings.landmarks.clone().map(landmarks::LandmarkSource::new),
        }
    }

    /// What they know, for each other and for the estimator.
    pub(super) fn facts(&self, core: &Core) -> SourceFacts {
        let range = self.rangefinders.in_use();
        let believed = |r: &&rangefinder::RangefinderSource| {
            r.health() != SourceHealth::Faulty && !core.height.health(Channel::Range).is_faulty()
        };
        let seen = range
            .and_then(rangefinder::RangefinderSource::ground_m)
            .map(|height_m| Ground { height_m, sigma_m: 0.0 });
        SourceFacts {
            magnetic: self.magnetometer.newest(),
            flow_velocity: self.flow.velocity_body(),
            flow_trusted: self.flow.carrier(core).is_some(),
            range: range.filter(believed).and_then(rangefinder::RangefinderSource::newest),
            rangefinder_heard: range.is_some_and(|r| r.newest().is_some()),
            disputed_ratio: core
                .stream
                .newest()
                .zip(range)
                .and_then(|(now, r)| r.disputed_ratio(now, core.height.height_m())),
            ground: seen.or_else(|| {
                self.takeoff.ground(&core.estimator.estimate().map_or(Vector2::zeros(), |(p, _)| p.xy()))
            }),
            resting: self.standstill.resting(),
            airspeed_used: self.airspeed.used(),
            drag_used: self.drag.used(),
            gnss_receiver: self.gnss.receiver(),
            gnss_sigma_m: self.gnss.sigma_m(),
            gnss_latency_sigma_s: self.gnss.latency.sigma_s(),
            lying_since: self.gnss.steps.lie().filter(|lie| !lie.undone).map(|lie| lie.since),
            landmark_fix: self.landmarks.as_ref().and_then(landmarks::LandmarkSource::fix),
        }
    }

    /// Whether a source can be believed at present: by what it knows of itself, by what the altimeter and the GNSS monitor found, and by what
    /// is held against it.
    pub(super) fn health(&self, status: &SourceStatus, context: &Context<'_>) -> SourceHealth {
        let core = context.core;
        let silent = core
            .stream
            .newest()
            .zip(status.last_heard)
            .is_some_and(|(now, heard)| now.seconds_since(heard) > SILENT_S);
        if silent {
            return SourceHealth::Silent;
        }
        let by_altimeter = |channel: Channel| {
            if core.height.health(channel).is_faulty() { SourceHealth::Faulty } else { SourceHealth::Healthy }
        };
        let id = status.source.id;
        let found = match status.source.kind {
            SourceKind::Gnss if id == self.gnss.receiver() => match core.integrity.state() {
                GnssState::Trusted => by_altimeter(Channel::Gnss),
                GnssState::Untrusted(_) => SourceHealth::Suspect,
            },
            SourceKind::Barometer => self
                .barometer
                .channel(id)
                .map_or(SourceHealth::Suspect, |(channel, own)| own.worse(by_altimeter(channel))),
            SourceKind::Rangefinder => match self.rangefinders.health(id) {
                (own, true) => own.worse(by_altimeter(Channel::Range)),
                (own, false) => own,
            },
            SourceKind::Magnetometer => self.magnetometer.health().worse(status.fit()),
            SourceKind::Flow => self.flow.health(id),
            SourceKind::Landmarks => {
                self.landmarks.as_ref().map_or(SourceHealth::Suspect, landmarks::LandmarkSource::health)
            }
            _ => status.fit(),
        };
        found.worse(status.charged_health())
    }

    pub(super) fn reset(&mut self, reset: &Reset) {
        self.gnss.reset(reset);
        self.magnetometer.reset(reset);
        self.barometer.reset(reset);
        self.rangefinders.reset(reset);
        self.flow.reset(reset);
        self.airspeed.reset(reset);
        self.drag.reset(reset);
        self.standstill.reset(reset);
        self.takeoff.reset(reset);
        if let Some(landmarks) = &mut self.landmarks {
            landmarks.reset(reset);
        }
    }
}
