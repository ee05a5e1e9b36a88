//! Settings that match the simulated sensors of a fixed wing, for examples and tests.

/// What the simulated sensors are, as configuration: the sensors' data sheets.
const SENSORS: [&str; 14] = [
    "imu.samples=means",
    "gnss.delay_ms=200",
    // 0.5 m/s from 125 m are 0.004; the wander of the scale, 1 % over 250 m of path, counts as white noise of 3.7 m/s along the path and
    // none across it: this stands for both.
    "flow.rate_noise_radps=0.015",
    "flow.bias_sigma_mps=0.5",
    "flow.scale_sigma=0.03",
    "flow.misalignment_sigma_deg=1",
    "flow.max_height_m=1000",
    "kalman.flow_bias_walk=0.0001",
    "kalman.flow_scale_walk=0.0001",
    "kalman.magnetic_bias_sigma_ut=2",
    "kalman.magnetic_bias_walk_ut=0.001",
    "magnetometer.noise_ut=0.35",
    "kalman.gyro_rate_noise=0",
    "kalman.accel_load_noise=0",
];
const TACTICAL: [&str; 5] = [
    "kalman.gyro_noise=0.00006",
    "kalman.accel_noise=0.0025",
    "kalman.gyro_bias_walk=0.0000003",
    "kalman.accel_bias_walk=0.0001",
    "kalman.gyro_scale_sigma=0.0003",
];
const MEMS: [&str; 5] = [
    "kalman.gyro_noise=0.0002",
    "kalman.accel_noise=0.004",
    "kalman.gyro_bias_walk=0.000005",
    "kalman.accel_bias_walk=0.0003",
    "kalman.gyro_scale_sigma=0.002",
];

/// The settings that fit `SensorSuite::tactical` or `SensorSuite::mems`.
pub fn data_sheet(mems: bool) -> Vec<String> {
    let own = if mems { MEMS } else { TACTICAL };
    SENSORS.iter().chain(&own).map(|s| (*s).to_owned()).collect()
}
