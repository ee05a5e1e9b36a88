//! The settings as they are written, and their validation into the types that the code works with.

use std::sync::Arc;

use serde::Deserialize;

use crate::altimeter::{
    AltimeterKind, AltimeterMethod, AltimeterSettings, ChannelSettings, DetectionSettings, InertialModel,
    OffsetModel,
};
use crate::camera::{CalibrationSettings, MAX_PATCHES, PatchCentre, PatchLimits, PatchTable};
use crate::filter::error_state::{AirModel, EskfSettings};
use crate::geo::{Body, CameraMount, Euler};
use crate::navigator::settings::AirSettings;
use crate::navigator::settings::BudgetSettings;
use crate::navigator::settings::DragSettings;
use crate::navigator::settings::TrustSettings;
use crate::navigator::settings::{
    Estimator, FlowBiasSource, FlowSettings, GnssSettings, HeightSettings, HoldoverSettings,
    NavigatorSettings, ObserverSettings, RejoinSettings,
};
use crate::navigator::sources::landmarks::LandmarkSetup;
use crate::outbound::{Carriage, OutboundSettings, Profile, Publish};
use crate::wire::endpoint::Endpoint;
use crate::wire::frame::SystemId;
use nalgebra::Vector3;

use super::error::{ConfigError, Problem};
use super::landmarks::Landmarks;
use super::{LinkSettings, PipelineSettings, Settings};
use crate::wire::session::requests::StreamSettings;

#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
pub(super) struct Raw {
    vehicle: Vehicle,
    link: Link,
    streams: Streams,
    imu: Imu,
    magnetometer: Magnetometer,
    gnss: Gnss,
    flow: Flow,
    airspeed: Airspeed,
    drag: Drag,
    range: Range,
    landmarks: Landmarks,
    height: Height,
    observer: Observer,
    kalman: Kalman,
    holdover: Holdover,
    rejoin: Rejoin,
    outbound: Outbound,
    log: Log,
}

#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
struct Vehicle {
    system_id: u8,
    profile: String,
}

#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
struct Link {
    endpoints: Vec<String>,
    peer_timeout_s: f64,
    reconnect_min_ms: u64,
    reconnect_max_ms: u64,
    queue_frames: usize,
    stale_output_ms: u64,
}

#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
struct Streams {
    request: bool,
    imu_hz: f64,
    gnss_hz: f64,
    pressure_hz: f64,
    flow_hz: f64,
    range_hz: f64,
    local_position_hz: f64,
    slow_hz: f64,
    airspeed_hz: f64,
    retries: u8,
}

#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
struct Imu {
    max_gap_ms: f64,
    bridge_ms: f64,
    samples: String,
}

#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
struct Magnetometer {
    r#use: bool,
    max_norm_error: f64,
    noise_ut: f64,
}

#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
struct Gnss {
    delay_ms: f64,
    delay_sigma_ms: f64,
    loss_s: f64,
    recover_s: f64,
    recover_far_s: f64,
    min_satellites: u8,
    max_horizontal_accuracy_m: f64,
    gate_sigma: f64,
    min_position_gate_m: f64,
    min_velocity_gate_mps: f64,
    consistency_window_s: f64,
    consistency_limit_m: f64,
    consistency_rate_mps: f64,
    default_accuracy_m: f64,
}

#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
struct Flow {
    r#use: bool,
    delay_ms: f64,
    delay_sigma_ms: f64,
    min_quality: f64,
    rate_noise_radps: f64,
    max_tilt_deg: f64,
    min_height_m: f64,
    max_height_m: f64,
    mount_roll_deg: f64,
    mount_pitch_deg: f64,
    mount_yaw_deg: f64,
    lever_arm_x_m: f64,
    lever_arm_y_m: f64,
    lever_arm_z_m: f64,
    patches_deg: Vec<String>,
    bias_sigma_mps: f64,
    scale_sigma: f64,
    misalignment_sigma_deg: f64,
    bias_walk: f64,
    scale_walk: f64,
    max_scale_error: f64,
    max_bias_mps: f64,
}

#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
struct Airspeed {
    r#use: bool,
    min_mps: f64,
    sigma_mps: f64,
    sideslip_sigma_deg: f64,
}

#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
struct Drag {
    r#use: bool,
    sigma_mps2: f64,
    lasting_mps2: f64,
    coefficient_per_s: f64,
    coefficient_sigma_per_s: f64,
}

#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
struct Range {
    max_age_s: f64,
}

#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
struct Height {
    filter: AltimeterName,
    accel_noise: f64,
    accel_load_noise: f64,
    accel_bias_walk: f64,
    baro_noise_m: f64,
    baro_offset_walk: f64,
    gnss_noise_m: f64,
    gnss_wander_m: f64,
    gnss_wander_s: f64,
    range_below_m: f64,
    range_noise_m: f64,
    ground_walk: f64,
    ground_effect_below_m: f64,
    ground_effect_walk: f64,
    fault_evidence: f64,
    fault_window_s: f64,
    fault_size_m: f64,
    climb_jump_mps: f64,
    glide_mps: f64,
    jump_m: f64,
}

/// The altimeters by the names that the configuration has for them.
#[derive(Clone, Copy, Debug, Deserialize)]
#[serde(rename_all = "snake_case")]
enum AltimeterName {
    Default,
    Okf,
    Rkf,
    RkfJoseph,
    Selector,
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

impl Height {
    fn settings(&self) -> HeightSettings {
        // Of a barometer's offset, of the ground and of a climb rate nothing is known at first.
        const UNKNOWN_M: f64 = 1e4;
        let baro = ChannelSettings {
            noise_m: self.baro_noise_m,
            offset: OffsetModel { sigma_m: UNKNOWN_M, walk: self.baro_offset_walk, rate: 0.0 },
        };
        let rate = 1.0 / self.gnss_wander_s;
        let gnss = ChannelSettings {
            noise_m: self.gnss_noise_m,
            offset: OffsetModel {
                sigma_m: self.gnss_wander_m,
                walk: self.gnss_wander_m * (2.0 * rate).sqrt(),
                rate,
            },
        };
        let range = ChannelSettings {
            noise_m: self.range_noise_m,
            offset: OffsetModel { sigma_m: UNKNOWN_M, walk: self.ground_walk, rate: 0.0 },
        };
        HeightSettings {
            kind: self.filter.into(),
            altimeter: AltimeterSettings {
                inertial: InertialModel {
                    accel_noise: self.accel_noise,
                    accel_bias_sigma: 0.2,
                    accel_bias_walk: self.accel_bias_walk,
                    accel_bias_rate: 0.0,
                    start_sigma: [100.0, 2.0],
                    gravity_gradient: 0.0,
                },
                channels: [baro, gnss, baro, range],
                least_prob: 0.02,
                detection: DetectionSettings {
                    climb_jump_mps: self.climb_jump_mps,
                    bias_m: self.fault_size_m,
                    ..DetectionSettings::recorded(self.fault_evidence, self.fault_window_s)
                },
            },
            accel_load_noise: self.accel_load_noise,
            range_below_m: self.range_below_m,
            ground_effect_below_m: self.ground_effect_below_m,
            ground_effect_walk: self.ground_effect_walk,
            glide_mps: self.glide_mps,
            jump_m: self.jump_m,
        }
    }
}

#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
struct Observer {
    estimator: Estimator,
    k_p: f64,
    k_i: f64,
    start_s: f64,
    gnss_velocity: bool,
    flow_bias: FlowBiasSource,
    flow_bias_time_s: f64,
    holdover_k_p_factor: f64,
    holdover_k_vv: f64,
    holdover_k_xv: f64,
    guard: f64,
    aligned_injection: f64,
    aligned_s: f64,
}

#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
struct Kalman {
    gyro_noise: f64,
    accel_noise: f64,
    gyro_rate_noise: f64,
    accel_load_noise: f64,
    gyro_bias_walk: f64,
    accel_bias_walk: f64,
    magnetic_bias_sigma_ut: f64,
    magnetic_bias_walk_ut: f64,
    gyro_scale_sigma: f64,
    wind_sigma_mps: f64,
    wind_walk: f64,
    airspeed_scale_sigma: f64,
    flow_bias_walk: f64,
    flow_scale_walk: f64,
    gate_sigma: f64,
}

#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
struct Holdover {
    max_sigma_m: f64,
    max_coast_s: f64,
    heading_sigma_deg: f64,
    heading_drift_dpm: f64,
    scale_wander: f64,
    height_scale_sigma: f64,
    velocity_sigma_mps: f64,
    tilt_sigma_deg: f64,
    gyro_bias_sigma_dpm: f64,
}

#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
struct Rejoin {
    glide_mps: f64,
    jump_m: f64,
}

#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
struct Outbound {
    publish: Publish,
    message: Carriage,
    rate_hz: f64,
    farewell_s: f64,
    statustext: bool,
}

#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
struct Log {
    level: String,
}

/// Degrees a minute in radians a second.
fn dpm(v: f64) -> f64 {
    v.to_radians() / 60.0
}

/// The steepest angle from the optical axis at which a patch can be, degrees.
const STEEPEST_PATCH_DEG: f64 = 70.0;

/// `SENSOR:RIGHT:FORWARD`, angles in degrees.
fn patch_table(texts: &[String], mut complain: impl FnMut(String)) -> PatchTable {
    let mut table = PatchTable::default();
    for text in texts {
        let mut parts = text.split(':').map(str::trim);
        let sensor = parts.next().and_then(|p| p.parse::<u8>().ok());
        let mut angle = || {
            let degrees = parts.next()?.parse::<f64>().ok()?;
            (degrees.abs() <= STEEPEST_PATCH_DEG).then_some(degrees.to_radians())
        };
        let (right, forward) = (angle(), angle());
        match (sensor, right, forward, parts.next()) {
            (Some(sensor), Some(right), Some(forward), None) => {
                if !table.add(PatchCentre::from_angles(sensor, right, forward)) {
                    complain(format!(
                        "\"{text}\": the sensor id stands there twice, or there are more than {MAX_PATCHES}"
                    ));
                }
            }
            _ => complain(format!(
                "\"{text}\" is not SENSOR:RIGHT:FORWARD, an id of 0 to 255 and two angles of at most {STEEPEST_PATCH_DEG} degrees"
            )),
        }
    }
    table
}

impl Raw {
    pub(super) fn validate(self) -> Result<Settings, ConfigError> {
        let mut problems = Vec::new();
        let mut complain = |key: &str, what: String| {
            problems.push(Problem { source: "settings".into(), key: key.into(), what });
        };
        let mut endpoints = Vec::new();
        for text in &self.link.endpoints {
            match text.parse::<Endpoint>() {
                Ok(e) => endpoints.push(e),
                Err(e) => complain("link.endpoints", e.to_string()),
            }
        }
        let patches = patch_table(&self.flow.patches_deg, |what| complain("flow.patches_deg", what));
        let landmarks = self.landmarks.setup(&mut complain);
        if self.link.reconnect_min_ms > self.link.reconnect_max_ms {
            complain("link.reconnect_min_ms", "is greater than link.reconnect_max_ms".into());
        }
        if self.gnss.recover_far_s < self.gnss.recover_s {
            complain("gnss.recover_far_s", "is less than gnss.recover_s".into());
        }
        let profile = match self.vehicle.profile.as_str() {
            "auto" => None,
            other => other.parse::<Profile>().map_err(|e| complain("vehicle.profile", e)).ok(),
        };
        if !problems.is_empty() {
            return Err(ConfigError { problems });
        }
        let outbound = OutboundSettings {
            publish: self.outbound.publish,
            carriage: self.outbound.message,
            profile: profile.unwrap_or(Profile::Ardupilot),
            rate_hz: self.outbound.rate_hz,
            worst_sigma_m: self.holdover.max_sigma_m,
            farewell_s: self.outbound.farewell_s,
        };
        Ok(Settings {
            system: (self.vehicle.system_id != 0).then_some(SystemId(self.vehicle.system_id)),
            endpoints,
            link: LinkSettings {
                peer_timeout_s: self.link.peer_timeout_s,
                reconnect_min_ms: self.link.reconnect_min_ms,
                reconnect_max_ms: self.link.reconnect_max_ms,
                queue_frames: self.link.queue_frames,
                stale_output_ms: self.link.stale_output_ms,
            },
            streams: StreamSettings {
                request: self.streams.request,
                imu_hz: self.streams.imu_hz,
                gnss_hz: self.streams.gnss_hz,
                pressure_hz: self.streams.pressure_hz,
                flow_hz: self.streams.flow_hz,
                range_hz: self.streams.range_hz,
                local_position_hz: self.streams.local_position_hz,
                slow_hz: self.streams.slow_hz,
                airspeed_hz: self.streams.airspeed_hz,
                retries: self.streams.retries,
            },
            statustext: self.outbound.statustext,
            log_level: self.log.level.clone(),
            pipeline: PipelineSettings { navigator: self.navigator(patches, landmarks), outbound, profile },
        })
    }

    fn air_model(&self) -> AirModel {
        AirModel {
            wind_sigma: self.kalman.wind_sigma_mps,
            wind_walk: self.kalman.wind_walk,
            airspeed_scale_sigma: self.kalman.airspeed_scale_sigma,
            drag_sigma: self.drag.coefficient_sigma_per_s,
        }
    }

    fn navigator(&self, patches: PatchTable, landmarks: Option<LandmarkSetup>) -> NavigatorSettings {
        let (g, o) = (&self.gnss, &self.observer);
        NavigatorSettings {
            estimator: o.estimator,
            imu_instantaneous: self.imu.samples == "instants",
            imu_bridge_s: self.imu.bridge_ms * 1e-3,
            imu_max_gap_s: self.imu.max_gap_ms * 1e-3,
            magnetometer: self.magnetometer.r#use,
            magnetometer_norm_error: self.magnetometer.max_norm_error,
            magnetometer_sigma_t: self.magnetometer.noise_ut * 1e-6,
            kalman: EskfSettings {
                gyro_noise: self.kalman.gyro_noise,
                accel_noise: self.kalman.accel_noise,
                gyro_rate_noise: self.kalman.gyro_rate_noise,
                accel_load_noise: self.kalman.accel_load_noise,
                gyro_bias_walk: self.kalman.gyro_bias_walk,
                accel_bias_walk: self.kalman.accel_bias_walk,
                magnetic_bias_sigma: self.kalman.magnetic_bias_sigma_ut * 1e-6,
                magnetic_bias_walk: self.kalman.magnetic_bias_walk_ut * 1e-6,
                gyro_scale_sigma: self.kalman.gyro_scale_sigma,
                air: self.air_model(),
                flow_bias_walk: self.kalman.flow_bias_walk,
                flow_scale_walk: self.kalman.flow_scale_walk,
                gate_sigma: self.kalman.gate_sigma,
            },
            gnss: GnssSettings {
                delay_s: g.delay_ms * 1e-3,
                delay_sigma_s: g.delay_sigma_ms * 1e-3,
                default_accuracy_m: g.default_accuracy_m,
                trust: TrustSettings {
                    loss_s: g.loss_s,
                    recover_s: g.recover_s,
                    recover_far_s: g.recover_far_s,
                    min_satellites: g.min_satellites,
                    max_horizontal_accuracy_m: g.max_horizontal_accuracy_m,
                    gate_sigma: g.gate_sigma,
                    min_position_gate_m: g.min_position_gate_m,
                    min_velocity_gate_mps: g.min_velocity_gate_mps,
                    consistency_window_s: g.consistency_window_s,
                    consistency_limit_m: g.consistency_limit_m,
                    consistency_rate_mps: g.consistency_rate_mps,
                },
            },
            flow: self.flow(patches),
            air: AirSettings {
                enabled: self.airspeed.r#use,
                min_mps: self.airspeed.min_mps,
                sigma_mps: self.airspeed.sigma_mps,
                sideslip_sigma_rad: self.airspeed.sideslip_sigma_deg.to_radians(),
            },
            drag: DragSettings {
                enabled: self.drag.r#use,
                coefficient: self.drag.coefficient_per_s,
                sigma_mps2: self.drag.sigma_mps2,
                lasting_mps2: self.drag.lasting_mps2,
            },
            landmarks: landmarks.map(Arc::new),
            range_max_age_s: self.range.max_age_s,
            height: self.height.settings(),
            observer: ObserverSettings {
                k_p: o.k_p,
                k_i: o.k_i,
                start_s: o.start_s,
                gnss_velocity: o.gnss_velocity,
                flow_bias: o.flow_bias,
                flow_bias_time_s: o.flow_bias_time_s,
                holdover_k_p_factor: o.holdover_k_p_factor,
                holdover_k_vv: o.holdover_k_vv,
                holdover_k_xv: o.holdover_k_xv,
                guard: o.guard,
                aligned_injection: o.aligned_injection,
                aligned_s: o.aligned_s,
            },
            holdover: self.holdover(),
            rejoin: RejoinSettings { glide_mps: self.rejoin.glide_mps, jump_m: self.rejoin.jump_m },
        }
    }

    fn flow(&self, patches: PatchTable) -> FlowSettings {
        let f = &self.flow;
        let mounting = Euler {
            roll_rad: f.mount_roll_deg.to_radians(),
            pitch_rad: f.mount_pitch_deg.to_radians(),
            yaw_rad: f.mount_yaw_deg.to_radians(),
        };
        FlowSettings {
            enabled: f.r#use,
            delay_s: f.delay_ms * 1e-3,
            delay_sigma_s: f.delay_sigma_ms * 1e-3,
            rate_noise_radps: f.rate_noise_radps,
            limits: PatchLimits {
                max_tilt_rad: f.max_tilt_deg.to_radians(),
                min_distance_m: f.min_height_m,
                max_distance_m: f.max_height_m,
                min_quality: f.min_quality,
                min_integration_s: 1e-3,
                max_integration_s: 0.5,
            },
            mount: CameraMount::turned(
                mounting,
                Body::new(Vector3::new(f.lever_arm_x_m, f.lever_arm_y_m, f.lever_arm_z_m)),
            ),
            patches,
            calibration: CalibrationSettings {
                bias_sigma_mps: f.bias_sigma_mps,
                scale_sigma: f.scale_sigma,
                misalignment_sigma_rad: f.misalignment_sigma_deg.to_radians(),
                bias_walk: f.bias_walk,
                scale_walk: f.scale_walk,
                max_scale_error: f.max_scale_error,
                max_bias_mps: f.max_bias_mps,
            },
        }
    }

    fn holdover(&self) -> HoldoverSettings {
        let h = &self.holdover;
        HoldoverSettings {
            max_sigma_m: h.max_sigma_m,
            max_coast_s: h.max_coast_s,
            budget: BudgetSettings {
                heading_sigma_rad: h.heading_sigma_deg.to_radians(),
                heading_drift_radps: dpm(h.heading_drift_dpm),
                scale_wander: h.scale_wander,
                height_scale_sigma: h.height_scale_sigma,
                velocity_sigma_mps: h.velocity_sigma_mps,
                tilt_sigma_rad: h.tilt_sigma_deg.to_radians(),
                gyro_bias_sigma_radps: dpm(h.gyro_bias_sigma_dpm),
            },
        }
    }
}
