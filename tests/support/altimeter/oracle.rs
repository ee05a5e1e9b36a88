//! What could be known at best: one joint filter that is told which channel is faulty, how, and when, but not how large a bias is.

use holdover::altimeter::ErrorModel;
use holdover::sim::altimeter::{AltimeterStep, ChannelFault, STEP_S};
use nalgebra::{SMatrix, SVector};

/// The model's states, and a bias of the barometer and of GNSS.
const N: usize = 7;
/// Doubt about a bias when it begins, m.
const BIAS_SIGMA_M: f64 = 1000.0;

/// What the oracle does with a channel of which it knows that it is biased.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum OnBias {
    /// Leaves its measurements out.
    LeaveOut,
    /// Estimates the bias as an unknown constant from its true onset to its true end. A ramp is none.
    Estimate,
}

/// The filter: optimal, both measurements in one, noisy measurements with their true variance.
#[derive(Clone, Debug)]
pub struct Oracle {
    model: ErrorModel,
    on_bias: OnBias,
    x: SVector<f64, N>,
    p: SMatrix<f64, N, N>,
    biased: [bool; 2],
}

impl Oracle {
    pub fn new(model: ErrorModel, on_bias: OnBias) -> Self {
        let mut p = SMatrix::zeros();
        let start = model.start_sigmas();
        (0..5).for_each(|i| p[(i, i)] = start[i] * start[i]);
        Self { model, on_bias, x: SVector::zeros(), p, biased: [false; 2] }
    }

    pub fn step(&mut self, step: &AltimeterStep) {
        let mut phi = SMatrix::<f64, N, N>::identity();
        phi.fixed_view_mut::<5, 5>(0, 0).copy_from(&self.model.transition(STEP_S));
        self.x = phi * self.x;
        self.p = phi * self.p * phi.transpose();
        let q = self.model.process_noise(STEP_S);
        (0..5).for_each(|i| self.p[(i, i)] += q[i]);
        let r = [self.model.baro_variance(), self.model.gps_variance()];
        for (c, (z, fault)) in [(step.z_ibi, step.baro), (step.z_iig, step.gps)].into_iter().enumerate() {
            self.tell(c, &fault);
            if let Some(z) = z.filter(|_| !(self.biased[c] && self.on_bias == OnBias::LeaveOut)) {
                let mut h = SMatrix::<f64, 1, N>::zeros();
                h[0] = 1.0;
                h[5 + c] = 1.0;
                h[4] = if c == 0 { -1.0 } else { 0.0 };
                self.update(&h, z, r[c] * fault.variance_factor);
            }
        }
    }

    /// A bias begins or ends: it is unknown, or zero.
    fn tell(&mut self, c: usize, fault: &ChannelFault) {
        let biased = fault.bias_m != 0.0;
        if biased == self.biased[c] {
            return;
        }
        self.biased[c] = biased;
        let i = 5 + c;
        self.x[i] = 0.0;
        self.p.row_mut(i).fill(0.0);
        self.p.column_mut(i).fill(0.0);
        self.p[(i, i)] = if biased { BIAS_SIGMA_M * BIAS_SIGMA_M } else { 0.0 };
    }

    fn update(&mut self, h: &SMatrix<f64, 1, N>, z: f64, r: f64) {
        let k = self.p * h.transpose() / ((h * self.p * h.transpose())[0] + r);
        self.x += k * (z - (h * self.x)[0]);
        let rest = SMatrix::<f64, N, N>::identity() - k * h;
        self.p = rest * self.p * rest.transpose() + k * k.transpose() * r;
    }

    pub fn delta_h(&self) -> f64 {
        self.x[0]
    }
}
