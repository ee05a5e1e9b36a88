//! What the altimeter has to be told: models, noise and limits.

use super::joint::{InertialModel, OffsetModel};
use super::published::ErrorModel;

/// One channel.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct ChannelSettings {
    /// Noise of one sample, m: the floor under what a sensor claims for itself.
    pub noise_m: f64,
    /// How its offset behaves.
    pub offset: OffsetModel,
}

/// When a fault is declared, and when it is over.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct DetectionSettings {
    /// Log-likelihood ratio at which a fault is declared.
    pub ratio: f64,
    /// Log-likelihood ratio by which an explanation has to be ahead of the others.
    pub margin: f64,
    /// What the jump of a channel costs.
    pub jump_cost: f64,
    /// What a fault of two channels at once costs against one of a single channel, as log-likelihood.
    pub both_cost: f64,
    /// What grown noise costs.
    pub noise_cost: f64,
    /// The inertial altitude goes astray by jumps of its climb rate of this size, m/s (1 sigma); 0 where it never does.
    pub climb_jump_mps: f64,
    /// Samples of a channel that a fault of it takes at least.
    pub samples: u32,
    /// A fault has to last for this long, s: the errors of real sensors are not white.
    pub lasting_s: f64,
    /// GlrBank are looked for at this spacing, s …
    pub spacing_s: f64,
    /// … and over this time, s.
    pub window_s: f64,
    /// Biases are of this size, m (1 sigma): what a bias that has become nearly zero is weighed against.
    pub bias_m: f64,
    /// Log-likelihood ratio at which noise that has grown is back to normal.
    pub relief: f64,
}

/// All of it.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct AltimeterSettings {
    /// The inertial part.
    pub inertial: InertialModel,
    /// Barometer, GNSS, second barometer, rangefinder.
    pub channels: [ChannelSettings; 4],
    /// Innovations with a probability of normal operation below this are not used.
    pub least_prob: f64,
    /// Fault detection.
    pub detection: DetectionSettings,
}

impl AltimeterSettings {
    /// The altimeter of the paper's Table 1, for z of (13) and (18) with Td = 0.5 s: heights are −z, the acceleration is zero. The two
    /// Markov processes Δa and Δg are one here, with the sum of their variances and of their noise.
    pub fn table_1() -> Self {
        let (model, step_s) = (ErrorModel::table_1(), 0.5);
        let phi = model.transition(step_s);
        let q = model.process_noise(step_s);
        let bias_variance = model.accel_sigma_mps2.powi(2) + model.gravity_sigma_mps2.powi(2);
        let walk = |variance: f64| (variance / step_s).sqrt();
        let known = OffsetModel { sigma_m: 0.0, walk: 0.0, rate: 0.0 };
        let baro_offset =
            OffsetModel { sigma_m: model.baro_offset_sigma_m, walk: walk(q[4]), rate: model.beta_per_s };
        let channel = |variance: f64, offset| ChannelSettings { noise_m: variance.sqrt(), offset };
        Self {
            inertial: InertialModel {
                accel_noise: 0.0,
                accel_bias_sigma: bias_variance.sqrt(),
                accel_bias_walk: walk(q[2] + q[3]),
                accel_bias_rate: (q[2] + q[3]) / (2.0 * step_s * bias_variance),
                start_sigma: [model.start_height_sigma_m, model.start_speed_sigma_mps],
                gravity_gradient: phi[(1, 0)] / step_s,
            },
            channels: [
                channel(model.baro_variance(), baro_offset),
                channel(model.gps_variance(), known),
                channel(model.baro_variance(), baro_offset),
                channel(model.gps_variance(), known),
            ],
            least_prob: 0.02,
            detection: DetectionSettings::paper(step_s),
        }
    }
}
