//! The sections, one file each, and their validation into the types that the code works with.

mod air;
mod cameras;
mod filter;
mod flow;
mod gnss;
mod handover;
mod height;
mod holdover;
mod imu;
mod landmarks;
mod link;
mod navigator;
mod observer;
mod outbound;
mod record;
mod signing;
mod start;
mod state;
mod status;
mod streams;
mod vehicle;

use std::sync::Arc;

use serde::Deserialize;

use crate::navigator::settings::{ImuSettings, MagnetometerSettings, NavigatorSettings};
use crate::outbound::{OutboundSettings, Profile};
use crate::pipeline::PipelineSettings;
use crate::state::StateDirectory;
use crate::wire::endpoint::Endpoint;
use crate::wire::frame::{ComponentId, SystemId};

use super::Settings;
use super::key::Section;

/// Everything as it is written. The names of the fields are those of the sections.
#[derive(Debug, Deserialize)]
#[serde(deny_unknown_fields)]
pub(super) struct AllKeys {
    vehicle: vehicle::VehicleKeys,
    link: link::LinkKeys,
    streams: streams::StreamsKeys,
    outbound: outbound::OutboundKeys,
    handover: handover::HandoverKeys,
    log: outbound::LogKeys,
    state: state::StateKeys,
    record: record::RecordKeys,
    status: status::StatusKeys,
    signing: signing::SigningKeys,
    navigator: navigator::NavigatorKeys,
    holdover: holdover::HoldoverKeys,
    start: start::StartKeys,
    gnss: gnss::GnssKeys,
    magnetometer: imu::MagnetometerKeys,
    airspeed: air::AirspeedKeys,
    drag: air::DragKeys,
    cameras: Vec<cameras::CameraKeys>,
    flow: flow::FlowKeys,
    landmarks: landmarks::LandmarksKeys,
    tuning: Tuning,
}

#[derive(Debug, Deserialize)]
#[serde(deny_unknown_fields)]
struct Tuning {
    link: link::LinkTuning,
    record: record::RecordTuning,
    handover: handover::HandoverTuning,
    imu: imu::ImuTuning,
    magnetometer: imu::MagnetometerTuning,
    gnss: gnss::GnssTuning,
    flow: flow::FlowTuning,
    airspeed: air::AirspeedTuning,
    drag: air::DragTuning,
    landmarks: landmarks::LandmarksTuning,
    range: height::RangeTuning,
    height: height::HeightTuning,
    observer: observer::ObserverTuning,
    filter: filter::FilterTuning,
    holdover: holdover::HoldoverTuning,
    rejoin: holdover::RejoinTuning,
}

/// All sections, in the order in which they are shown.
pub static SECTIONS: &[Section] = &[
    vehicle::VehicleKeys::SECTION,
    link::LinkKeys::SECTION,
    signing::SigningKeys::SECTION,
    streams::StreamsKeys::SECTION,
    outbound::OutboundKeys::SECTION,
    handover::HandoverKeys::SECTION,
    outbound::LogKeys::SECTION,
    state::StateKeys::SECTION,
    record::RecordKeys::SECTION,
    status::StatusKeys::SECTION,
    navigator::NavigatorKeys::SECTION,
    holdover::HoldoverKeys::SECTION,
    gnss::GnssKeys::SECTION,
    start::StartKeys::SECTION,
    imu::MagnetometerKeys::SECTION,
    air::AirspeedKeys::SECTION,
    air::DragKeys::SECTION,
    cameras::SECTION,
    flow::FlowKeys::SECTION,
    landmarks::LandmarksKeys::SECTION,
    link::LinkTuning::SECTION,
    record::RecordTuning::SECTION,
    handover::HandoverTuning::SECTION,
    imu::ImuTuning::SECTION,
    imu::MagnetometerTuning::SECTION,
    gnss::GnssTuning::SECTION,
    flow::FlowTuning::SECTION,
    air::AirspeedTuning::SECTION,
    air::DragTuning::SECTION,
    landmarks::LandmarksTuning::SECTION,
    height::RangeTuning::SECTION,
    height::HeightTuning::SECTION,
    observer::ObserverTuning::SECTION,
    filter::FilterTuning::SECTION,
    holdover::HoldoverTuning::SECTION,
    holdover::RejoinTuning::SECTION,
];

impl AllKeys {
    /// Settings that hold together, or `complain`ts: the key, and what is wrong with it.
    pub(super) fn validate(&self, complain: &mut impl FnMut(&str, String)) -> Settings {
        let tuning = &self.tuning;
        if tuning.link.reconnect_min_ms > tuning.link.reconnect_max_ms {
            complain("tuning.link.reconnect_min_ms", "is greater than tuning.link.reconnect_max_ms".into());
        }
        if tuning.gnss.recover_far_s < tuning.gnss.recover_s {
            complain("tuning.gnss.recover_far_s", "is less than tuning.gnss.recover_s".into());
        }
        let endpoints = endpoints_of(&self.link.endpoints, "link.endpoints", complain);
        let sensor_endpoints = endpoints_of(&self.link.sensor_endpoints, "link.sensor_endpoints", complain);
        let profile = self.vehicle.profile.parse::<Profile>().ok();
        let outbound = OutboundSettings {
            publish: self.outbound.publish,
            coasting: self.outbound.coasting,
            covariance: self.outbound.covariance,
            carriage: self.outbound.message,
            profile: profile.unwrap_or(Profile::Ardupilot),
            rate_hz: self.outbound.rate_hz,
            worst_sigma_m: self.holdover.max_sigma_m,
            farewell_s: self.outbound.farewell_s,
        };
        Settings {
            system: (self.vehicle.system_id != 0).then_some(SystemId(self.vehicle.system_id)),
            component: (self.vehicle.component_id != 0).then_some(ComponentId(self.vehicle.component_id)),
            endpoints,
            sensor_endpoints,
            link: self.link.settings(&tuning.link),
            signing: self.signing.settings(complain),
            streams: self.streams.settings(),
            statustext: self.outbound.statustext,
            source_switch: self.handover.settings(&tuning.handover, complain),
            log: self.log.settings(),
            state: StateDirectory::new(&self.state.dir),
            record: self.record.settings(&self.tuning.record),
            status: self.status.settings(complain),
            pipeline: PipelineSettings { navigator: self.navigator(complain), outbound, profile },
        }
    }

    fn navigator(&self, complain: &mut impl FnMut(&str, String)) -> NavigatorSettings {
        let tuning = &self.tuning;
        cameras::check(&self.cameras, complain);
        let max_speed_mps = Some(self.vehicle.max_speed_mps).filter(|v| *v > 0.0);
        NavigatorSettings {
            estimator: self.navigator.estimator,
            imu: ImuSettings {
                instantaneous: tuning.imu.samples == imu::ImuSamples::Instants,
                bridge_s: tuning.imu.bridge_ms * 1e-3,
                max_gap_s: tuning.imu.max_gap_ms * 1e-3,
            },
            magnetometer: MagnetometerSettings {
                enabled: self.magnetometer.r#use,
                norm_error: tuning.magnetometer.max_norm_error,
                sigma_t: tuning.magnetometer.noise_ut * 1e-6,
            },
            kalman: tuning.filter.settings(tuning.drag.coefficient_sigma_per_s),
            start: self.start.settings(complain),
            gnss: self.gnss.settings(&tuning.gnss),
            flow: self.flow.settings(&tuning.flow, &self.cameras, complain),
            air: self.airspeed.settings(&tuning.airspeed),
            drag: self.drag.settings(&tuning.drag),
            landmarks: self.landmarks.setup(&tuning.landmarks, &self.cameras, complain).map(Arc::new),
            range_max_age_s: tuning.range.max_age_s,
            height: tuning.height.settings(self.navigator.altimeter),
            observer: tuning.observer.settings(),
            holdover: self.holdover.settings(&tuning.holdover, max_speed_mps),
            rejoin: tuning.rejoin.settings(),
        }
    }
}

/// Texts as endpoints, or complaints about the `key`.
fn endpoints_of(texts: &[String], key: &str, complain: &mut impl FnMut(&str, String)) -> Vec<Endpoint> {
    let mut endpoints = Vec::new();
    for text in texts {
        match text.parse::<Endpoint>() {
            Ok(endpoint) => endpoints.push(endpoint),
            Err(e) => complain(key, format!("has a wrong one: {e}")),
        }
    }
    endpoints
}
