//! What single messages become.

use holdover::geo::atmosphere::pressure_altitude_m;
use holdover::log::Log;
use holdover::log::fast_samples::FastKind;
use holdover::replay::sweep::survey;
use holdover::sample::{Input, Reference, Sample, SampleKind};
use proptest::prelude::*;

use crate::command::{holdover, write_log};
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

/// As PX4 wrote it to 1.7: IMU, magnetometer and barometer, the latter two told again with every sample of the gyro, with when they had measured.
fn combined_of_2016(file: &mut UlogFile, us: u64, since_us: i32, height_m: f64) {
    const DECLARATION: &str = "float[3] gyro_rad;float gyro_integral_dt;int32_t accelerometer_timestamp_relative;\
        float[3] accelerometer_m_s2;float accelerometer_integral_dt;int32_t magnetometer_timestamp_relative;\
        float[3] magnetometer_ga;int32_t baro_timestamp_relative;float baro_alt_meter;float baro_temp_celcius";
    let since = since_us as u32;
    let fields = Fields::default().f32(0.2).f32(0.0).f32(0.0).f32(0.004).u32(0);
    let fields = fields.f32(0.0).f32(0.0).f32(-9.7).f32(0.004).u32(since);
    let fields = fields.f32(0.2).f32(0.0).f32(0.4).u32(since).f32(height_m).f32(30.0);
    file.data("sensor_combined", DECLARATION, us, fields);
}

#[test]
fn the_barometer_of_old_logs_stands_with_the_imu() {
    let mut file = UlogFile::new(&[]);
    for i in 0..500u64 {
        let us = 2_000_000 + i * 4000;
        // A barometer at 50 Hz, at 488 m and climbing.
        let (since_us, step) = (-((i % 5) as i32) * 4000 - 700, i / 5);
        combined_of_2016(&mut file, us, since_us, 488.0 + 0.02 * step as f64);
        // And the raw one of the same time, which is no second barometer.
        file.data("sensor_baro", "float pressure", us + 100, Fields::default().f32(900.0));
    }
    // One that is not there, and one that cannot be.
    combined_of_2016(&mut file, 4_000_000, i32::MAX, 0.0);
    combined_of_2016(&mut file, 4_004_000, -700, 1e6);
    let folder = tempfile::tempdir().unwrap();
    let log = write_log(folder.path(), "log", &file.bytes);
    let (inputs, summary) = inputs(&log);
    let times = |kind: SampleKind| -> Vec<i64> {
        let of = |i: &Input| match i {
            Input::Sample(s) if s.kind() == kind => Some(s.time().micros()),
            _ => None,
        };
        inputs.iter().filter_map(of).collect()
    };
    let heights = inputs.iter().filter_map(|i| match i {
        Input::Sample(Sample::Pressure(s)) => pressure_altitude_m(s.pressure_pa),
        _ => None,
    });
    let heights: Vec<f64> = heights.collect();
    assert_eq!((rates(&inputs).len(), heights.len()), (502, 100));
    assert!(
        heights.iter().enumerate().all(|(i, h)| (h - 488.0 - 0.02 * i as f64).abs() < 0.01),
        "{heights:?}"
    );
    let measured = times(SampleKind::Pressure);
    assert!(measured.windows(2).all(|w| w[1] - w[0] == 20_000) && measured[0] % 20_000 == 19_300);
    // The magnetometer likewise; its field of a barometer that cannot be is a field.
    assert_eq!((times(SampleKind::Mag)[..100].to_vec(), times(SampleKind::Mag).len()), (measured, 101));
    assert_eq!(summary.remarks(), ["not used: 1 absurd value"]);
    let text = holdover(&["inspect", log.to_str().unwrap()]).out;
    let mut rows = text.lines().map(|l| l.split_whitespace().collect::<Vec<_>>());
    assert!(rows.any(|row| row.starts_with(&["barometer", "100", "50.0"])), "{text}");
    assert!(!text.contains("no barometer"), "{text}");
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

/// What the vehicle says of whether it has landed, as it changes.
fn landings(inputs: &[Input]) -> Vec<bool> {
    let mut told: Vec<_> =
        inputs.iter().filter_map(|i| if let Input::Status(s) = i { s.landed } else { None }).collect();
    told.dedup();
    told
}

#[test]
fn landings_are_heard_of_every_autopilot() {
    let mut px4 = UlogFile::new(&[]);
    for (i, landed) in [1, 1, 0, 0, 1].into_iter().enumerate() {
        let fields = Fields::default().u8(0).u8(landed);
        px4.data(
            "vehicle_land_detected",
            "bool freefall;bool landed",
            2_000_000 + i as u64 * 100_000,
            fields,
        );
    }
    assert_eq!(landings(&read(&px4)), [true, false, true]);
    let mut copter = DataFlashFile::new();
    // Armed, flies, perhaps landed, landed, disarmed.
    for (i, event) in [10.0, 28.0, 17.0, 18.0, 11.0].into_iter().enumerate() {
        copter.message("EV", 2_000_000 + i as u64 * 1_000_000, &[event]);
    }
    assert_eq!(landings(&read_bytes(&copter.bytes)), [false, true]);
    let mut plane = DataFlashFile::new();
    for (i, flying) in [0.0, 1.0, 0.0].into_iter().enumerate() {
        plane.message("STAT", 2_000_000 + i as u64 * 1_000_000, &[flying, 0.5, 1.0, 0.0, 0.0]);
    }
    assert_eq!(landings(&read_bytes(&plane.bytes)), [true, false, true]);
}

#[test]
fn a_vehicle_without_truth_flies_when_it_says_so() {
    let flight = Flight::rotor(0.01, 60.0, 2);
    let folder = tempfile::tempdir().unwrap();
    let first_us = crate::ulog_file::micros(&flight.steps[0].samples[0]);
    let flights = |events: &[(f64, f64)]| {
        let mut file = DataFlashFile::new();
        let mut waiting = events.iter().peekable();
        for step in &flight.steps {
            let us = crate::ulog_file::micros(&step.samples[0]);
            while let Some((_, event)) = waiting.next_if(|e| (us - first_us) as f64 * 1e-6 >= e.0) {
                file.message("EV", us, &[*event]);
            }
            step.samples.iter().for_each(|sample| file.sample(us, sample));
        }
        survey(&Log::open(&write_log(folder.path(), "log", &file.bytes), None).unwrap()).unwrap().flights
    };
    let told = flights(&[(12.0, 28.0), (25.0, 18.0), (31.0, 28.0)]);
    let near = |a: f64, b: f64| (a - b).abs() < 0.2;
    assert!(told.len() == 2 && near(told[0].0, 12.0) && near(told[0].1, 25.0), "{told:?}");
    assert!(near(told[1].0, 31.0) && near(told[1].1, 60.0), "{told:?}");
    // Who tells nothing of it is seen by GNSS.
    assert_eq!(flights(&[]).len(), 1);
}

/// `ISBD`: samples by axis.
fn part_of_batch(file: &mut DataFlashFile, us: u64, number: u16, part: u16, axes: &[[i16; 32]; 3]) {
    let samples = axes.iter().flatten().map(|v| f64::from(*v));
    let told: Vec<f64> = [number, part].map(f64::from).into_iter().chain(samples).collect();
    file.message("ISBD", us, &told);
}

/// A batch of so many samples of one sensor at 1 kHz, which shakes by `size` units of the log at `hz` along y; without the `lost`-th part of it.
fn batch(
    file: &mut DataFlashFile,
    number: u16,
    [kind, unit, mul]: [f64; 3],
    n: usize,
    hz: f64,
    lost: Option<usize>,
) {
    let us = 2_000_000 + u64::from(number) * 1_100_000;
    file.message("ISBH", us, &[f64::from(number), kind, unit, mul, n as f64, us as f64, 1000.0]);
    for part in (0..n / 32).filter(|part| Some(*part) != lost) {
        let at = |i: usize| (std::f64::consts::TAU * hz * (part * 32 + i) as f64 * 1e-3).sin();
        let y: [i16; 32] = std::array::from_fn(|i| (1000.0 * at(i)) as i16);
        part_of_batch(file, us + part as u64 * 20_000, number, part as u16, &[[0; 32], y, [i16::MAX; 32]]);
    }
}

#[test]
fn batches_of_fast_samples_show_how_a_sensor_shakes_and_one_with_a_hole_is_none() {
    let mut file = DataFlashFile::new();
    let (accelerometer, gyro) = ([0.0, 1.0, 200.0], [1.0, 0.0, 1000.0]);
    batch(&mut file, 0, accelerometer, 1024, 90.0, None);
    batch(&mut file, 1, gyro, 1024, 45.0, None);
    batch(&mut file, 2, accelerometer, 1024, 90.0, Some(7));
    batch(&mut file, 3, accelerometer, 1024, 90.0, None);
    // Of the last one only the head was written.
    batch(&mut file, 4, gyro, 0, 45.0, None);
    file.message("ISBH", 9_000_000, &[5.0, 1.0, 0.0, 1000.0, 1024.0, 9e6, 1000.0]);
    let folder = tempfile::tempdir().unwrap();
    let (inputs, summary) = inputs(&write_log(folder.path(), "log", &file.bytes));
    assert_eq!(inputs, [], "they are no input of the navigation");
    let seen: Vec<_> = summary.fast.all().map(|s| (s.kind, s.unit, s.batches, s.clipped)).collect();
    assert_eq!(seen, [(FastKind::Gyro, 0, 1, 1024), (FastKind::Accelerometer, 1, 2, 2048)]);
    assert_eq!(summary.fast.broken, 1);
    for (sensor, hz, rms) in summary.fast.all().zip([45.0, 90.0]).map(|(s, hz)| (s, hz, 1000.0 / 2f64.sqrt()))
    {
        let unit = if sensor.kind == FastKind::Gyro { 1e-3 } else { 1.0 / 200.0 };
        let (tone, [x, y, z]) = (sensor.strongest().unwrap(), sensor.vibration().unwrap());
        assert!((tone.hz - hz).abs() < 1.0 && tone.part > 0.99, "{tone:?}");
        assert!((y / (unit * rms) - 1.0).abs() < 0.01 && x < 1e-9 && z < 1e-6, "{x} {y} {z}");
    }
    assert!(summary.remarks().iter().any(|r| r == "1 batches of fast samples are not whole"));
}

#[test]
fn inspect_says_what_shakes_and_what_the_imu_cannot_show() {
    let mut file = DataFlashFile::new();
    batch(&mut file, 0, [1.0, 0.0, 1000.0], 1024, 45.0, None);
    batch(&mut file, 1, [0.0, 0.0, 200.0], 1024, 90.0, None);
    batch(&mut file, 2, [0.0, 1.0, 200.0], 256, 90.0, None);
    for i in 0..2000u32 {
        let us = 6_000_000 + u64::from(i) * 40_000;
        imu(&mut file, us, 0.0, 0.1, 1.0);
        file.message("ESC", us, &[f64::from(i % 4), 2700.0, 2700.0, 16.0, 1.0, 30.0, 1.0, 30.0, 0.0]);
    }
    let folder = tempfile::tempdir().unwrap();
    let path = write_log(folder.path(), "log", &file.bytes);
    let report = holdover(&["inspect", path.to_str().unwrap(), "--json"]).json();
    let vibration = &report["vibration"];
    assert_eq!(vibration["rotors"]["hz"], serde_json::json!([45.0, 45.0, 45.0]));
    let sensors = vibration["fast_sensors"].as_array().unwrap();
    assert_eq!(sensors.len(), 3);
    assert!((sensors[0]["strongest_hz"].as_f64().unwrap() - 45.0).abs() < 1.0, "{vibration}");
    // What passes the filter is not known where the log does not tell of the filter.
    assert!(sensors[0]["folded"].is_null() && sensors[2]["vibration"].is_null(), "{vibration}");
    let text = holdover(&["inspect", path.to_str().unwrap()]).out;
    for words in [
        "4, at 45 to 45 Hz, mostly 45 Hz",
        "faster than the log's IMU can show at 25 Hz",
        "at 45 Hz, as fast as the rotors turn",
        "at 90 Hz, twice as fast as the rotors turn",
        "1 batches at 1000 Hz, too short for a spectrum",
    ] {
        assert!(text.contains(words), "{words}: {text}");
    }
}

#[test]
fn speeds_of_rotors_are_heard_of_both_autopilots() {
    let folder = tempfile::tempdir().unwrap();
    let mut copter = DataFlashFile::new();
    for i in 0..40u32 {
        let rpm = if i % 4 == 3 { 0.0 } else { 3000.0 };
        let told = [f64::from(i % 4), rpm, rpm, 16.0, 1.0, 30.0, 1.0, 30.0, 0.0];
        copter.message("ESC", 2_000_000 + u64::from(i) * 10_000, &told);
    }
    let mut px4 = UlogFile::new(&[]);
    // What esc_status holds is declared of its own.
    px4.message(
        b'F',
        b"esc_report:uint64_t timestamp;int32_t esc_rpm;uint8_t esc_state;uint8_t[3] _padding0;",
    );
    for i in 0..10 {
        let report = |fields: Fields, rpm| fields.u64(0).u32(rpm).u8(0).u8(0).u8(0).u8(0);
        let mut fields = Fields::default().u8(3);
        for rpm in [3000, 0, 3000u32.wrapping_neg()] {
            fields = report(fields, rpm);
        }
        px4.data("esc_status", "uint8_t esc_count;esc_report[3] esc", 2_000_000 + i * 100_000, fields);
    }
    for (bytes, turning) in [(&copter.bytes, 3), (&px4.bytes, 2)] {
        let (_, summary) = inputs(&write_log(folder.path(), "log", bytes));
        assert_eq!(summary.rotors.controllers(), turning);
        assert_eq!(summary.rotors.quantile_hz(0.5), Some(50.0));
    }
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(64))]
    #[test]
    fn any_batches_are_whole_or_broken(
        heads in proptest::collection::vec((any::<[u16; 5]>(), any::<f32>(), 0usize..40), 1..6),
        sample in any::<i16>(),
    ) {
        let mut file = DataFlashFile::new();
        for ([number, kind, unit, mul, count], rate, parts) in &heads {
            let told = [number, &(kind % 4), unit, mul, &(count % 1200)].map(|v| f64::from(*v));
            let us = 2_000_000;
            file.message("ISBH", us, &[&told[..], &[0.0, f64::from(*rate)]].concat());
            (0..*parts).for_each(|part| part_of_batch(&mut file, us, *number, part as u16, &[[sample; 32]; 3]));
        }
        let folder = tempfile::tempdir().unwrap();
        let (_, summary) = inputs(&write_log(folder.path(), "log", &file.bytes));
        let whole: u64 = summary.fast.all().map(|s| s.batches).sum();
        prop_assert!(whole + summary.fast.broken <= heads.len() as u64);
        for sensor in summary.fast.all() {
            prop_assert!(sensor.vibration().is_none_or(|v| v.iter().all(|v| v.is_finite())));
        }
    }
}

#[test]
fn inspect_promises_no_flow_that_comes_too_seldom_to_carry() {
    let folder = tempfile::tempdir().unwrap();
    let said = |name: &str, period_s: f64| {
        let (mut steps, mut last_s) = (Flight::rotor(0.01, 90.0, 3).steps, f64::NEG_INFINITY);
        for step in &mut steps {
            let t_s = step.t_s;
            step.samples.retain(|s| {
                let keep = s.kind() != SampleKind::Flow || t_s - last_s >= period_s;
                last_s = if keep && s.kind() == SampleKind::Flow { t_s } else { last_s };
                keep
            });
        }
        let log = write_log(folder.path(), name, &UlogFile::of(&steps).bytes);
        holdover(&["inspect", log.to_str().unwrap()]).out
    };
    let often = said("often", 0.0);
    assert!(often.contains("holdover on optical flow, its height from the rangefinder"), "{often}");
    let seldom = said("seldom", 2.0);
    assert!(!seldom.contains("on optical flow"), "{seldom}");
    assert!(
        seldom.contains("holdover on rotor drag, as far as it proves true: optical flow comes at 0.5 Hz"),
        "{seldom}"
    );
}
