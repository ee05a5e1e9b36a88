//! Monte Carlo runs for the altimeters: the error model draws its own truth, and faults are added to what is measured.
//!
//! Contreras and Hajiyev, Section 4: 600 steps of 0.5 s, faults on iterations 200 to 400, in the five scenarios of Section 4.1.3. Beyond the
//! paper there are ramps, biases that stay, faults that overlap, and outages. The truth is the model's own, so an optimal filter's errors are
//! what its covariance says: x₀ ~ N(0, P₀), x(i) = φ x(i−1) + G u; z_IBI = ΔH − B + v and z_IIG = ΔH + v with white noise of the
//! variances (13) and (18), independent of each other.

use nalgebra::Vector5;
use strum::IntoStaticStr;

use super::noise::{SensorRng, Stream};
use crate::altimeter::ErrorModel;

/// Td of Table 1, s.
pub const STEP_S: f64 = 0.5;
/// Rate of a ramp, m/s.
pub const RAMP_MPS: f64 = 0.05;
/// Iterations of the paper's runs; they count from 1.
const PAPER_STEPS: usize = 600;
/// The iterations with faults, both included.
const FAULTY: (usize, usize) = (200, 400);
/// Iterations of a run with a bias that stays.
const PERMANENT_STEPS: usize = 1500;
/// Iterations after an outage.
const AFTER_OUTAGE: usize = 400;
/// The overlapping faults of the barometer and of GNSS.
const STAGGERED: [(usize, usize); 2] = [(150, 300), (250, 400)];

/// What is wrong in a run, and when.
#[derive(Clone, Copy, Debug, PartialEq, Eq, IntoStaticStr)]
pub enum FaultCase {
    /// Scenario 0: nothing.
    #[strum(serialize = "0")]
    FaultFree,
    /// Scenario 1: both channels noisy.
    #[strum(serialize = "1")]
    BothNoisy,
    /// Scenario 2: the barometer biased.
    #[strum(serialize = "2")]
    BaroBiased,
    /// Scenario 3: both biased.
    #[strum(serialize = "3")]
    BothBiased,
    /// Scenario 4: the barometer noisy.
    #[strum(serialize = "4")]
    BaroNoisy,
    /// Scenario 5: the barometer noisy, GNSS biased.
    #[strum(serialize = "5")]
    BaroNoisyGpsBiased,
    /// The barometer's bias grows by [`RAMP_MPS`] on iterations 200 to 400, to 5 m, and is gone after.
    #[strum(serialize = "ramp_baro")]
    RampBaro,
    /// The same of GNSS.
    #[strum(serialize = "ramp_gps")]
    RampGps,
    /// The barometer biased from iteration 200 to the end of 1500.
    #[strum(serialize = "permanent")]
    PermanentBaro,
    /// The same of GNSS.
    #[strum(serialize = "permanent_gps")]
    PermanentGps,
    /// The barometer biased on iterations 150 to 300, GNSS on 250 to 400.
    #[strum(serialize = "staggered")]
    Staggered,
    /// Both channels missing for so many iterations after the 199th, and 400 more with both.
    #[strum(serialize = "outage")]
    Outage(usize),
}

impl FaultCase {
    /// The cases of the table: the paper's scenarios 0 to 5, then the others.
    pub const ALL: [Self; 14] = [
        Self::FaultFree,
        Self::BothNoisy,
        Self::BaroBiased,
        Self::BothBiased,
        Self::BaroNoisy,
        Self::BaroNoisyGpsBiased,
        Self::RampBaro,
        Self::RampGps,
        Self::PermanentBaro,
        Self::PermanentGps,
        Self::Staggered,
        Self::Outage(200),
        Self::Outage(800),
        Self::Outage(3200),
    ];

    /// The paper's scenarios are numbers.
    pub fn label(self) -> &'static str {
        self.into()
    }

    /// Length of a run.
    pub fn steps(&self) -> usize {
        match self {
            Self::PermanentBaro | Self::PermanentGps => PERMANENT_STEPS,
            Self::Outage(steps) => FAULTY.0 + steps + AFTER_OUTAGE,
            _ => PAPER_STEPS,
        }
    }

    /// What is wrong with the barometer and with GNSS on iteration `i`, which counts from 1.
    fn faults(&self, i: usize, size: FaultSize) -> [ChannelFault; 2] {
        let none = ChannelFault::NONE;
        let biased = ChannelFault { bias_m: size.bias_m, ..none };
        let noisy = ChannelFault { variance_factor: size.variance_factor, ..none };
        let within = |(from, to): (usize, usize)| (from..=to).contains(&i);
        let ramp = || {
            let since = (i + 1).saturating_sub(FAULTY.0);
            ChannelFault { bias_m: RAMP_MPS * STEP_S * since as f64, ..none }
        };
        match self {
            Self::Outage(steps) if within((FAULTY.0, FAULTY.0 + steps - 1)) => [ChannelFault::MISSING; 2],
            Self::Staggered => STAGGERED.map(|when| if within(when) { biased } else { none }),
            Self::PermanentBaro if i >= FAULTY.0 => [biased, none],
            Self::PermanentGps if i >= FAULTY.0 => [none, biased],
            Self::BothNoisy if within(FAULTY) => [noisy; 2],
            Self::BaroBiased if within(FAULTY) => [biased, none],
            Self::BothBiased if within(FAULTY) => [biased; 2],
            Self::BaroNoisy if within(FAULTY) => [noisy, none],
            Self::BaroNoisyGpsBiased if within(FAULTY) => [noisy, biased],
            Self::RampBaro if within(FAULTY) => [ramp(), none],
            Self::RampGps if within(FAULTY) => [none, ramp()],
            _ => [none; 2],
        }
    }
}

/// How large the faults are.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct FaultSize {
    /// Added to the measurement z = H_I − H of a biased channel, m.
    pub bias_m: f64,
    /// Multiplies the variance of a noisy channel's measurement noise.
    pub variance_factor: f64,
}

/// What is wrong with a channel's measurement.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct ChannelFault {
    /// Bias, m.
    pub bias_m: f64,
    /// Factor on the variance of its noise.
    pub variance_factor: f64,
    /// There is no measurement.
    pub missing: bool,
}

impl ChannelFault {
    /// All is well.
    pub const NONE: Self = Self { bias_m: 0.0, variance_factor: 1.0, missing: false };
    const MISSING: Self = Self { missing: true, ..Self::NONE };

    /// Whether there is a measurement and it is as it should be.
    pub fn is_healthy(&self) -> bool {
        *self == Self::NONE
    }
}

/// One step of a run: [`STEP_S`] after the one before.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct AltimeterStep {
    /// The truth [ΔH_I, ΔW_z, Δa_z, Δg, B], see [`ErrorModel`].
    pub truth: Vector5<f64>,
    /// Inertial less barometric altitude, m.
    pub z_ibi: Option<f64>,
    /// Inertial less GNSS altitude, m.
    pub z_iig: Option<f64>,
    /// What is wrong with the barometer.
    pub baro: ChannelFault,
    /// What is wrong with GNSS.
    pub gps: ChannelFault,
}

/// A run of the Monte Carlo.
#[derive(Clone, Debug, PartialEq)]
pub struct AltimeterRun {
    /// What is wrong in it.
    pub case: FaultCase,
    /// Its steps; the paper's iteration i is number i − 1.
    pub steps: Vec<AltimeterStep>,
}

impl AltimeterRun {
    /// The run of a seed with this number. Truth and noise depend on the seed and the number alone, not on the faults, so that cases and
    /// sizes are compared on the same numbers.
    pub fn draw(model: &ErrorModel, case: FaultCase, size: FaultSize, seed: u64, number: u32) -> Self {
        let mut rng = SensorRng::of_run(seed, Stream::Altimeter, number);
        let (phi, noise) = (model.transition(STEP_S), model.process_noise(STEP_S).map(f64::sqrt));
        let sigmas = [model.baro_variance().sqrt(), model.gps_variance().sqrt()];
        let mut x = model.start_sigmas().map(|s| s * rng.normal());
        let steps = (1..=case.steps())
            .map(|i| {
                x = phi * x + noise.map(|s| s * rng.normal());
                let faults = case.faults(i, size);
                let clean = [x[0] - x[4], x[0]];
                let z: [Option<f64>; 2] = std::array::from_fn(|c| {
                    let v = sigmas[c] * faults[c].variance_factor.sqrt() * rng.normal();
                    (!faults[c].missing).then_some(clean[c] + v + faults[c].bias_m)
                });
                AltimeterStep { truth: x, z_ibi: z[0], z_iig: z[1], baro: faults[0], gps: faults[1] }
            })
            .collect();
        Self { case, steps }
    }

    /// The first step after the last one on which anything was wrong; `None` when nothing was, or still is at the end.
    pub fn clears_at(&self) -> Option<usize> {
        let last = self.steps.iter().rposition(|s| !(s.baro.is_healthy() && s.gps.is_healthy()))?;
        (last + 1 < self.steps.len()).then_some(last + 1)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const SIZE: FaultSize = FaultSize { bias_m: 20.0, variance_factor: 100.0 };

    fn draw(case: FaultCase, number: u32) -> AltimeterRun {
        AltimeterRun::draw(&ErrorModel::table_1(), case, SIZE, 3, number)
    }

    #[test]
    fn faults_are_where_the_paper_has_them_and_change_nothing_else() {
        let clean = draw(FaultCase::FaultFree, 0);
        assert_eq!((clean.steps.len(), clean.clears_at()), (600, None));
        let biased = draw(FaultCase::BothBiased, 0);
        assert_eq!(biased.clears_at(), Some(400));
        for (k, (c, b)) in clean.steps.iter().zip(&biased.steps).enumerate() {
            let bias = if (199..400).contains(&k) { 20.0 } else { 0.0 };
            assert_eq!(c.truth, b.truth);
            assert!((b.z_ibi.unwrap() - c.z_ibi.unwrap() - bias).abs() < 1e-12);
            assert!((b.z_iig.unwrap() - c.z_iig.unwrap() - bias).abs() < 1e-12);
            assert_eq!(b.gps.is_healthy(), bias == 0.0);
        }
        let ramp = draw(FaultCase::RampGps, 0);
        assert_eq!(ramp.steps[198].gps, ChannelFault::NONE);
        assert!((ramp.steps[199].gps.bias_m - 0.025).abs() < 1e-12);
        assert!((ramp.steps[399].gps.bias_m - 5.025).abs() < 1e-12);
        assert_eq!(draw(FaultCase::PermanentBaro, 0).clears_at(), None);
        let outage = draw(FaultCase::Outage(800), 0);
        assert_eq!(outage.steps.iter().filter(|s| s.z_ibi.is_none() && s.z_iig.is_none()).count(), 800);
        assert_eq!((outage.steps.len(), outage.clears_at()), (1400, Some(999)));
    }

    #[test]
    fn runs_differ_and_repeat() {
        for case in FaultCase::ALL {
            assert_eq!(draw(case, 1), draw(case, 1));
            assert_eq!(draw(case, 1).steps.len(), case.steps());
        }
        assert_ne!(draw(FaultCase::FaultFree, 1).steps, draw(FaultCase::FaultFree, 2).steps);
    }

    #[test]
    fn the_truth_has_the_models_spread() {
        let model = ErrorModel::table_1();
        let (mut offset, mut noise, mut faulty, mut n) = (0.0, 0.0, 0.0, 0.0);
        for number in 0..300 {
            let run = draw(FaultCase::BaroNoisy, number);
            let v = |k: usize| run.steps[k].z_ibi.unwrap() - run.steps[k].truth[0] + run.steps[k].truth[4];
            for k in (0..190).step_by(10) {
                n += 1.0;
                offset += run.steps[k].truth[4].powi(2);
                noise += v(k).powi(2);
                faulty += v(200 + k).powi(2);
            }
        }
        assert!((offset / n - 1.0).abs() < 0.15, "{}", offset / n);
        assert!((noise / n / model.baro_variance() - 1.0).abs() < 0.07);
        assert!((faulty / n / model.baro_variance() - 100.0).abs() < 7.0);
    }
}
