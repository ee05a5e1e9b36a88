//! ULogs as PX4 would have written them, of the samples of a flight.
#![allow(clippy::expect_used, reason = "helpers of tests may fail like tests")]

use holdover::sample::{Airframe, FlowRotation, GnssFix, Sample, VehicleStatus};

use crate::flight::Step;

/// When logging begins, microseconds since boot.
const BEGAN_US: u64 = 1_000_000;

/// A file that grows.
pub struct UlogFile {
    pub bytes: Vec<u8>,
    topics: Vec<(String, u16)>,
}

/// The fields of a message, appended one by one.
#[derive(Default)]
pub struct Fields(Vec<u8>);

impl Fields {
    pub fn f32(mut self, value: f64) -> Self {
        self.0.extend((value as f32).to_le_bytes());
        self
    }
    pub fn f64(mut self, value: f64) -> Self {
        self.0.extend(value.to_le_bytes());
        self
    }
    pub fn vector(self, v: &nalgebra::Vector3<f64>) -> Self {
        self.f32(v.x).f32(v.y).f32(v.z)
    }
    pub fn u8(mut self, value: u8) -> Self {
        self.0.push(value);
        self
    }
    pub fn u32(mut self, value: u32) -> Self {
        self.0.extend(value.to_le_bytes());
        self
    }
    pub fn u64(mut self, value: u64) -> Self {
        self.0.extend(value.to_le_bytes());
        self
    }
}

impl UlogFile {
    /// A header, and what PX4 tells of itself.
    pub fn new(parameters: &[(&str, f64)]) -> Self {
        let mut bytes = vec![0x55, 0x4C, 0x6F, 0x67, 0x01, 0x12, 0x35, 1];
        bytes.extend(BEGAN_US.to_le_bytes());
        let mut file = Self { bytes, topics: Vec::new() };
        file.message(b'B', &[0; 40]);
        for (name, value) in parameters {
            let key = format!("float {name}");
            let length = u8::try_from(key.len()).expect("short");
            file.message(b'P', &[&[length][..], key.as_bytes(), &(*value as f32).to_le_bytes()].concat());
        }
        file
    }

    pub fn message(&mut self, kind: u8, payload: &[u8]) {
        self.bytes.extend(u16::try_from(payload.len()).expect("short").to_le_bytes());
        self.bytes.push(kind);
        self.bytes.extend(payload);
    }

    /// A message of a topic, which is declared when it comes for the first time.
    pub fn data(&mut self, topic: &str, declaration: &str, us: u64, fields: Fields) {
        let known = self.topics.iter().find(|(name, _)| name == topic).map(|(_, id)| *id);
        let id = known.unwrap_or_else(|| {
            let id = u16::try_from(self.topics.len()).expect("few");
            self.topics.push((topic.to_owned(), id));
            self.message(b'F', format!("{topic}:uint64_t timestamp;{declaration};").as_bytes());
            self.message(b'A', &[&[0][..], &id.to_le_bytes(), topic.as_bytes()].concat());
            id
        });
        self.message(b'D', &[&id.to_le_bytes()[..], &us.to_le_bytes(), &fields.0].concat());
    }

    /// A whole flight.
    pub fn of(steps: &[Step]) -> Self {
        let mut file = Self::new(&[("EKF2_GPS_DELAY", 110.0), ("MPC_XY_VEL_MAX", 12.0)]);
        let mut status = None;
        for step in steps {
            let us = micros(&step.samples[0]);
            if status.replace(step.status) != Some(step.status) {
                file.status(us, step.status);
            }
            step.samples.iter().for_each(|sample| file.sample(us, sample));
        }
        file
    }

    fn status(&mut self, us: u64, status: VehicleStatus) {
        let arming = if status.armed == Some(true) { 2 } else { 1 };
        let kind = match status.airframe {
            Some(Airframe::Multirotor) => 2,
            Some(Airframe::FixedWing) => 1,
            _ => 0,
        };
        self.data(
            "vehicle_status",
            "uint8_t arming_state;uint8_t system_type",
            us,
            Fields::default().u8(arming).u8(kind),
        );
    }

    /// A sample that was logged at `us`.
    pub fn sample(&mut self, us: u64, sample: &Sample) {
        let at = micros(sample);
        match sample {
            Sample::Imu(s) => self.data(
                "sensor_combined",
                "float[3] gyro_rad;uint32_t gyro_integral_dt;float[3] accelerometer_m_s2",
                at,
                Fields::default().vector(&s.angular_rate.raw()).u32(10_000).vector(&s.specific_force.raw()),
            ),
            Sample::Mag(s) => self.data(
                "vehicle_magnetometer",
                "uint64_t timestamp_sample;uint32_t device_id;float[3] magnetometer_ga",
                us,
                Fields::default().u64(at).u32(9).vector(&(s.field.raw() * 1e4)),
            ),
            Sample::Pressure(s) => self.data(
                "vehicle_air_data",
                "uint64_t timestamp_sample;float baro_alt_meter;float baro_pressure_pa",
                us,
                Fields::default().u64(at).f32(0.0).f32(s.pressure_pa),
            ),
            Sample::Flow(s) => {
                let dt = s.interval.seconds();
                let gyro = match s.rotation {
                    FlowRotation::SensorGyro(gyro) => gyro,
                    _ => [f64::NAN; 2],
                };
                self.data(
                    "vehicle_optical_flow",
                    "uint64_t timestamp_sample;float[2] pixel_flow;float[3] delta_angle;float distance_m;\
                     uint32_t integration_timespan_us;uint8_t quality;uint8_t[3] _padding0",
                    us,
                    Fields::default()
                        .u64(at)
                        .f32(s.rate_xy[0] * dt)
                        .f32(s.rate_xy[1] * dt)
                        .f32(gyro[0] * dt)
                        .f32(gyro[1] * dt)
                        .f32(f64::NAN)
                        .f32(s.distance_m.unwrap_or(f64::NAN))
                        .u32(u32::try_from(s.interval.micros()).expect("short"))
                        .u8((s.quality * 255.0) as u8),
                );
            }
            Sample::Range(s) => {
                let [low, high] = s.limits_m.unwrap_or_default();
                self.data(
                    "distance_sensor",
                    "float min_distance;float max_distance;float current_distance;int8_t signal_quality;uint8_t orientation",
                    at,
                    Fields::default().f32(low).f32(high).f32(s.distance_m).u8(100).u8(25),
                );
            }
            Sample::Airspeed(s) => self.data(
                "airspeed",
                "uint64_t timestamp_sample;float indicated_airspeed_m_s",
                us,
                Fields::default().u64(at).f32(s.airspeed_mps),
            ),
            Sample::Gnss(s) => {
                let p = s.position.expect("a fix");
                let (north, east) = s.ground_velocity.expect("a velocity").north_east();
                self.data(
                    "sensor_gps",
                    "uint64_t timestamp_sample;double latitude_deg;double longitude_deg;double altitude_msl_m;\
                     float s_variance_m_s;float eph;float epv;float vel_n_m_s;float vel_e_m_s;bool vel_ned_valid;\
                     uint8_t fix_type;uint8_t satellites_used;uint8_t jamming_state;uint8_t spoofing_state",
                    us,
                    Fields::default()
                        .u64(at)
                        .f64(p.latitude_rad.to_degrees())
                        .f64(p.longitude_rad.to_degrees())
                        .f64(p.height_m)
                        .f32(s.speed_accuracy_mps.unwrap_or(0.0))
                        .f32(s.horizontal_accuracy_m.unwrap_or(0.0))
                        .f32(s.vertical_accuracy_m.unwrap_or(0.0))
                        .f32(north)
                        .f32(east)
                        .u8(1)
                        .u8(if s.fix == GnssFix::ThreeD { 3 } else { 4 })
                        .u8(s.satellites.unwrap_or(0))
                        .u8(1)
                        .u8(if s.warning.is_some() { 3 } else { 1 }),
                );
            }
            Sample::Landmark(_) => {}
        }
    }
}

/// A sample's stamp.
pub fn micros(sample: &Sample) -> u64 {
    u64::try_from(sample.time().micros()).expect("after boot")
}
