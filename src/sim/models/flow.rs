//! Optical flow of a camera that looks down from the body's origin: a velocity, and the patch that a flow sensor would report for it.

use crate::geo::so3;
use crate::sample::FlowRotation;
use crate::sim::noise::{GaussMarkov, SensorRng, Stream};
use crate::sim::trajectory::{Trajectory, Truth};
use crate::sim::world::{Environment, mean};
use nalgebra::Vector3;

/// How flow treats the vehicle's rotation.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum RotationContent {
    /// In the flow, to be taken out with the vehicle's gyro.
    Contained,
    /// In the flow, with the sensor's own gyro beside it, whose noise is this, rad/s a sample.
    SensorGyro(f64),
    /// Taken out already.
    Removed,
}

/// Measurements that have nothing to do with the truth.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Outliers {
    /// How often, 0 to 1.
    pub fraction: f64,
    /// How far off, in the unit of what is measured.
    pub size: f64,
}

impl Outliers {
    /// Never.
    pub const NONE: Self = Self { fraction: 0.0, size: 0.0 };
}

/// Errors of a flow velocity: v_m = (1 + s + w)·Exp(μ)·v + b + noise, all in body axes.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct FlowModel {
    /// Time between samples, s.
    pub period_s: f64,
    /// Integration interval, s.
    pub interval_s: f64,
    /// How old the end of the interval is when the sample arrives; the stamp is the time of arrival, s.
    pub latency_s: f64,
    /// s: scale error, size.
    pub scale: f64,
    /// μ: misalignment, sizes of a rotation vector, rad.
    pub misalignment_rad: Vector3<f64>,
    /// b: velocity bias, sizes, m/s.
    pub bias_mps: Vector3<f64>,
    /// w: wander of the scale; remembers by the way flown, m (terrain and texture pass by).
    pub scale_wander: GaussMarkov,
    /// White noise an axis, m/s.
    pub noise_mps: Vector3<f64>,
    /// White noise of the angular rate: times the distance it adds to the above, rad/s.
    pub noise_radps: f64,
    /// Wild velocities, m/s off in a random horizontal direction.
    pub outliers: Outliers,
    /// Distances along the optical axis between which there is flow, m.
    pub limits_m: [f64; 2],
    /// What is in the rates.
    pub rotation: RotationContent,
    /// Whether the distance is told with the flow.
    pub tells_distance: bool,
}

impl FlowModel {
    /// No errors, 10 Hz.
    pub fn ideal() -> Self {
        Self {
            period_s: 0.1,
            interval_s: 0.1,
            latency_s: 0.0,
            scale: 0.0,
            misalignment_rad: Vector3::zeros(),
            bias_mps: Vector3::zeros(),
            scale_wander: GaussMarkov::NONE,
            noise_mps: Vector3::zeros(),
            noise_radps: 0.0,
            outliers: Outliers::NONE,
            limits_m: [0.2, 1000.0],
            rotation: RotationContent::SensorGyro(0.0),
            tells_distance: true,
        }
    }

    /// A camera under a fixed wing: 3 % of scale, 1° of misalignment about the vertical axis, 0.5 and 0.3 m/s of bias, 1 % of scale
    /// wander over 250 m, 0.5 m/s of noise.
    pub fn camera() -> Self {
        Self {
            scale: 0.03,
            misalignment_rad: Vector3::new(0.0, 0.0, 1f64.to_radians()),
            bias_mps: Vector3::new(0.5, 0.3, 0.0),
            scale_wander: GaussMarkov { sigma: 0.01, correlation: 250.0 },
            noise_mps: Vector3::repeat(0.5),
            ..Self::ideal()
        }
    }

    /// A flow sensor under a multirotor: 3 % of scale, 1° of misalignment, 0.02 m/s of bias, 0.02 rad/s of noise, up to 50 m.
    pub fn patch() -> Self {
        Self {
            bias_mps: Vector3::new(0.02, 0.02, 0.0),
            noise_mps: Vector3::zeros(),
            noise_radps: 0.02,
            limits_m: [0.2, 50.0],
            tells_distance: false,
            period_s: 0.05,
            interval_s: 0.05,
            ..Self::camera()
        }
    }
}

/// What the flow sensor said.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct FlowReading {
    /// Middle of the interval, s: when the velocity holds.
    pub measured_s: f64,
    /// Integration interval, s.
    pub interval_s: f64,
    /// With errors, body axes, m/s. A patch tells the x and y of it.
    pub velocity_body: Vector3<f64>,
    /// Without, at the same time.
    pub ideal_body: Vector3<f64>,
    /// Whether it is wild.
    pub outlier: bool,
    /// Distance along the optical axis, m; the rates are made with it.
    pub distance_m: f64,
    /// Whether the sensor tells the distance.
    pub tells_distance: bool,
    /// Mean flow about body x and y as a patch reports it: v_x = d·(rate_y − gyro_y), v_y = −d·(rate_x − gyro_x), rad/s.
    pub rate_xy: [f64; 2],
    /// What of the rotation is in it.
    pub rotation: FlowRotation,
}

/// A flow sensor in flight.
#[derive(Clone, Debug)]
pub(in crate::sim) struct Flow {
    model: FlowModel,
    rng: SensorRng,
    scale: f64,
    misalignment: Vector3<f64>,
    bias: Vector3<f64>,
    wander: f64,
}

impl Flow {
    pub(in crate::sim) fn new(model: FlowModel, seed: u64) -> Self {
        let mut rng = SensorRng::new(seed, Stream::Flow);
        let scale = rng.signed(model.scale);
        let misalignment = rng.signed3(&model.misalignment_rad);
        let bias = rng.signed3(&model.bias_mps);
        let wander = rng.normal() * model.scale_wander.sigma;
        Self { model, rng, scale, misalignment, bias, wander }
    }

    /// What arrives at `now_s`; `None` while the ground is too near, too far, or not in view.
    pub(in crate::sim) fn sample(
        &mut self,
        environment: &Environment,
        trajectory: &dyn Trajectory,
        now_s: f64,
    ) -> Option<FlowReading> {
        let m = self.model;
        let end = now_s - m.latency_s;
        let (begin, middle) = (end - m.interval_s, end - 0.5 * m.interval_s);
        // Drawn whether or not the ground is seen, so that the limits change no later number.
        let (noise, rate_noise, gyro_noise) = (self.rng.normals(), self.rng.normals(), self.rng.normals());
        let (wild, direction) =
            (self.rng.chance(m.outliers.fraction), self.rng.between(0.0, std::f64::consts::TAU));
        let wander_noise = self.rng.normal();
        if begin < 0.0 {
            return None;
        }
        let truth = trajectory.at(middle);
        let ideal = truth.velocity_body();
        self.wander = m.scale_wander.next(self.wander, ideal.norm() * m.period_s, wander_noise);
        let distance = slant(environment, &truth)?;
        if !(m.limits_m[0]..=m.limits_m[1]).contains(&distance) {
            return None;
        }
        let mut v = (1.0 + self.scale + self.wander) * (so3::exp(&self.misalignment) * ideal);
        v += self.bias + noise.component_mul(&m.noise_mps) + rate_noise * (m.noise_radps * distance);
        if wild {
            v += m.outliers.size * Vector3::new(direction.cos(), direction.sin(), 0.0);
        }
        let turning = mean(begin, end, Vector3::zeros(), |t| trajectory.at(t).body_rate);
        let (in_flow, rotation) = match m.rotation {
            RotationContent::Removed => (Vector3::zeros(), FlowRotation::Removed),
            RotationContent::Contained => (turning, FlowRotation::Contained),
            RotationContent::SensorGyro(sigma) => {
                let gyro = turning + gyro_noise * sigma;
                (turning, FlowRotation::SensorGyro([gyro.x, gyro.y]))
            }
        };
        Some(FlowReading {
            measured_s: middle,
            interval_s: m.interval_s,
            velocity_body: v,
            ideal_body: ideal,
            outlier: wild,
            distance_m: distance,
            tells_distance: m.tells_distance,
            rate_xy: [in_flow.x - v.y / distance, in_flow.y + v.x / distance],
            rotation,
        })
    }
}

/// Distance to the ground along body z, if it points down.
fn slant(environment: &Environment, truth: &Truth) -> Option<f64> {
    let cosine = truth.r_body_to_ned[(2, 2)];
    (cosine > 0.05).then(|| environment.height(truth) / cosine)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::sim::Scenario;

    #[test]
    fn errors_are_as_large_as_stated() {
        let env = Environment::trondheim();
        let tr = Scenario::northwards(27.0, 0.0);
        for seed in 0..8 {
            let mut flow = Flow::new(FlowModel::camera(), seed);
            let n = 20_000;
            let readings: Vec<FlowReading> =
                (0..n).map(|k| flow.sample(&env, &tr, 1.0 + 0.1 * f64::from(k)).unwrap()).collect();
            let mean = readings.iter().map(|r| r.velocity_body).sum::<Vector3<f64>>() / f64::from(n);
            let off = mean - Vector3::new(27.0, 0.0, 0.0);
            // ±3 % of 27 m/s ± 0.5 m/s, and ±1° of 27 m/s ± 0.3 m/s.
            assert!([0.31, 1.31].iter().any(|e| (off.x.abs() - e).abs() < 0.06), "{off}");
            assert!([0.17, 0.77].iter().any(|e| (off.y.abs() - e).abs() < 0.06), "{off}");
            let noise =
                readings.iter().map(|r| (r.velocity_body.y - mean.y).powi(2)).sum::<f64>() / f64::from(n);
            assert!((noise.sqrt() - 0.5).abs() < 0.02, "{}", noise.sqrt());
        }
    }
}
