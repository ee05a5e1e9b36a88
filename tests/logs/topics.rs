//! What single messages become.

use holdover::sample::{Input, Reference, Sample, SampleKind};

use crate::command::write_log;
use crate::dataflash_file::DataFlashFile;
use crate::flight::Flight;
use crate::inputs;
use crate::ulog_file::{Fields, UlogFile};

const UNIT: &str = "uint64_t timestamp_sample;uint32_t accel_device_id;uint32_t gyro_device_id;float[3] delta_angle;\
                    float[3] delta_velocity;uint32_t delta_angle_dt;uint32_t delta_velocity_dt";
const FLOW: &str = "uint64_t timestamp_sample;float[2] pixel_flow;float[3] delta_angle;bool delta_angle_available;\
                    float distance_m;bool distance_available;uint32_t integration_timespan_us;uint8_t quality";

fn read(file: &UlogFile) -> Vec<Input> {
    read_bytes(&file.bytes)
}

fn read_bytes(bytes: &[u8]) -> Vec<Input> {
    let folder = tempfile::tempdir().unwrap();
    inputs(&write_log(folder.path(), "log", bytes)).0
}

fn unit(file: &mut UlogFile, us: u64, dt_us: u32) {
    let dt = f64::from(dt_us) * 1e-6;
    let fields = Fields::default()
        .u64(us - 900)
        .u32(7)
        .u32(8)
        .f32(0.1 * dt)
        .f32(0.0)
        .f32(0.0)
        .f32(0.0)
        .f32(0.0)
        .f32(-9.8 * dt)
        .u32(dt_us)
        .u32(dt_us);
    file.data("vehicle_imu", UNIT, us, fields);
}

fn combined(file: &mut UlogFile, us: u64) {
    let fields = Fields::default().f32(0.2).f32(0.0).f32(0.0).u32(4000).f32(0.0).f32(0.0).f32(-9.7);
    file.data(
        "sensor_combined",
        "float[3] gyro_rad;uint32_t gyro_integral_dt;float[3] accelerometer_m_s2",
        us,
        fields,
    );
}

/// Rates about x, rad/s, with their stamps.
fn rates(inputs: &[Input]) -> Vec<(i64, f64)> {
    let imu = |i: &Input| match i {
        Input::Sample(Sample::Imu(s)) => Some((s.time.micros(), s.angular_rate.raw().x)),
        _ => None,
    };
    inputs.iter().filter_map(imu).collect()
}

#[test]
fn integrals_without_gaps_are_preferred_and_thinned_ones_are_not_used() {
    let (mut full, mut thinned) = (UlogFile::new(&[]), UlogFile::new(&[]));
    for i in 0..1000 {
        let us = 2_000_000 + i * 5000;
        combined(&mut full, us);
        combined(&mut thinned, us);
        unit(&mut full, us + 1000, 5000);
        if i % 100 == 0 {
            unit(&mut thinned, us + 1000, 5000);
        }
    }
    let used = rates(&read(&full));
    let (first, rest) = used.split_at(20);
    assert!(first.iter().any(|(_, rate)| *rate > 0.15), "before the integrals prove gapless");
    assert!(rest.iter().all(|(us, rate)| (rate - 0.1).abs() < 1e-6 && us % 5000 == 100), "{:?}", &rest[..3]);
    assert!(rates(&read(&thinned)).iter().all(|(_, rate)| (rate - 0.2).abs() < 1e-6));
}

#[test]
fn a_sensors_flow_is_turned_and_scaled_as_the_parameters_say() {
    let mut file = UlogFile::new(&[("SENS_FLOW_ROT", 2.0), ("SENS_FLOW_SCALE", 1.5)]);
    let fields = Fields::default()
        .u64(2_000_000)
        .f32(0.02)
        .f32(0.0)
        .f32(0.01)
        .f32(0.0)
        .f32(0.0)
        .u8(1)
        .f32(3.0)
        .u8(0)
        .u32(20_000)
        .u8(255);
    file.data("sensor_optical_flow", FLOW, 2_000_100, fields);
    let read = read(&file);
    let [Input::Sample(Sample::Flow(flow))] = read.as_slice() else { panic!("{read:?}") };
    // A quarter turn: what is about the sensor's x is about the body's y.
    assert!((flow.rate_xy[0]).abs() < 1e-6 && (flow.rate_xy[1] - 1.5).abs() < 1e-5, "{flow:?}");
    let holdover::sample::FlowRotation::SensorGyro(gyro) = flow.rotation else { panic!("{flow:?}") };
    assert!(gyro[0].abs() < 1e-6 && (gyro[1] - 0.5).abs() < 1e-5, "{flow:?}");
    assert_eq!((flow.distance_m, flow.time.micros()), (None, 2_000_000));
}

#[test]
fn what_was_published_before_the_log_is_stale_but_for_what_the_vehicle_is() {
    let mut file = UlogFile::new(&[]);
    let status = "uint8_t arming_state;uint8_t system_type";
    file.data("vehicle_status", status, 10_000, Fields::default().u8(2).u8(2));
    combined(&mut file, 20_000);
    for i in 0..50 {
        combined(&mut file, 5_000_000 + i * 4000);
    }
    let folder = tempfile::tempdir().unwrap();
    let (inputs, summary) = inputs(&write_log(folder.path(), "log", &file.bytes));
    assert!(matches!(inputs[0], Input::Status(s) if s.armed == Some(true)), "{:?}", inputs[0]);
    assert_eq!(rates(&inputs).len(), 50);
    assert_eq!((summary.reboots, summary.remarks()), (0, vec!["not used: 1 stale".to_owned()]));
}

#[test]
fn an_estimate_is_a_reference_and_one_without_a_position_is_none() {
    let mut file = UlogFile::new(&[]);
    let declaration =
        "bool xy_valid;bool z_valid;bool v_xy_valid;float x;float y;float z;float vx;float vy;float vz";
    for valid in [0, 1] {
        let mut fields = Fields::default().u8(valid).u8(1).u8(1);
        for value in [3.0, -4.0, -12.0, 1.0, 2.0, 0.5] {
            fields = fields.f32(value);
        }
        file.data("vehicle_local_position", declaration, 2_000_000 + u64::from(valid), fields);
    }
    let read = read(&file);
    let [Input::Reference(Reference::Local { time, position, velocity })] = read.as_slice() else {
        panic!("{read:?}")
    };
    assert_eq!((time.micros(), position.raw().y, velocity.raw().z), (2_000_001, -4.0, 0.5));
}

#[test]
fn a_receiver_that_says_it_is_spoofed_is_heard() {
    let flight = Flight::rotor(0.01, 5.0, 1);
    let mut file = UlogFile::new(&[]);
    for sample in flight.steps.iter().flat_map(|s| &s.samples).filter(|s| s.kind() == SampleKind::Gnss) {
        let Sample::Gnss(mut fix) = *sample else { continue };
        fix.warning = Some(holdover::sample::GnssWarning::Spoofed);
        file.sample(crate::ulog_file::micros(sample), &Sample::Gnss(fix));
    }
    let warned = read(&file).iter().all(|i| {
        matches!(i, Input::Sample(Sample::Gnss(g)) if g.warning == Some(holdover::sample::GnssWarning::Spoofed))
    });
    assert!(warned);
}

/// `IMU` of a unit, turning at `rate` rad/s about x.
fn imu(file: &mut DataFlashFile, us: u64, unit: f64, rate: f64, healthy: f64) {
    let told = [unit, rate, 0.0, 0.0, 0.0, 0.0, -9.8, 0.0, 0.0, 40.0, healthy, 1.0, 1000.0, 1000.0];
    file.message("IMU", us, &told);
}

#[test]
fn a_unit_that_is_not_healthy_is_replaced_by_the_next() {
    let mut file = DataFlashFile::new();
    for i in 0..500u32 {
        let us = 2_000_000 + u64::from(i) * 20_000;
        imu(&mut file, us, 0.0, 0.1, f64::from(i < 200));
        imu(&mut file, us, 1.0, 0.2, 1.0);
    }
    let used = rates(&read_bytes(&file.bytes));
    let by = |rate: f64| used.iter().filter(|(_, r)| (r - rate).abs() < 1e-6).count();
    // The second is taken a second after the first was heard last.
    assert_eq!((by(0.1), by(0.2)), (200, 250));
    assert!(used.is_sorted());
}

#[test]
fn single_samples_are_averaged_and_preferred() {
    let mut file = DataFlashFile::new();
    for i in 0..2000u32 {
        let us = 2_000_000 + u64::from(i) * 1000;
        // What alternates from sample to sample is gone from the mean.
        let shaken = if i % 2 == 0 { 0.5 } else { -0.5 };
        file.message("ACC", us, &[0.0, us as f64, 0.0, 0.0, -9.8 + 10.0 * shaken]);
        file.message("GYR", us, &[0.0, us as f64, 0.3 + shaken, 0.0, 0.0]);
        if i % 40 == 0 {
            imu(&mut file, us, 0.0, 0.1, 1.0);
        }
    }
    let read = read_bytes(&file.bytes);
    let rates = rates(&read);
    assert!((495..505).contains(&rates.len()), "{}", rates.len());
    let (first, rest) = rates.split_at(3);
    assert!(first.len() == 3 && rest.iter().all(|(_, rate)| (rate - 0.3).abs() < 1e-6), "{rest:?}");
    assert!(rest.windows(2).all(|w| w[1].0 - w[0].0 == 4000));
}
