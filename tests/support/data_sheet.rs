//! Settings that match the simulated sensors of a fixed wing, for examples and tests.

/// What the simulated sensors are, as configuration: the sensors' data sheets.
const SENSORS: [&str; 14] = [
    "tuning.imu.samples=means",
    "gnss.delay_ms=200",
    // 0.5 m/s from 125 m are 0.004; the wander of the scale, 1 % over 250 m of path, counts as white noise of 3.7 m/s along the path and
    // none across it: this stands for both.
    "tuning.flow.rate_noise_radps=0.015",
    "tuning.flow.bias_sigma_radps=0.004",
    "tuning.flow.scale_sigma=0.03",
    "tuning.flow.misalignment_sigma_deg=1",
    "flow.max_height_m=1000",
    "tuning.filter.flow_bias_walk_radps=0.000001",
    "tuning.filter.flow_scale_walk=0.0001",
    "tuning.filter.magnetic_bias_sigma_ut=2",
    "tuning.filter.magnetic_bias_walk_ut=0.001",
    "tuning.magnetometer.noise_ut=0.35",
    "tuning.filter.gyro_rate_noise=0",
    "tuning.filter.accel_load_noise=0",
];
const TACTICAL: [&str; 5] = [
    "tuning.filter.gyro_noise=0.00006",
    "tuning.filter.accel_noise=0.0025",
    "tuning.filter.gyro_bias_walk=0.0000003",
    "tuning.filter.accel_bias_walk=0.0001",
    "tuning.filter.gyro_scale_sigma=0.0003",
];
const MEMS: [&str; 5] = [
    "tuning.filter.gyro_noise=0.0002",
    "tuning.filter.accel_noise=0.004",
    "tuning.filter.gyro_bias_walk=0.000005",
    "tuning.filter.accel_bias_walk=0.0003",
    "tuning.filter.gyro_scale_sigma=0.002",
];

/// The settings that fit `SensorSuite::tactical` or `SensorSuite::mems`.
pub fn data_sheet(mems: bool) -> Vec<String> {
    let own = if mems { MEMS } else { TACTICAL };
    SENSORS.iter().chain(&own).map(|s| (*s).to_owned()).collect()
}
