//! What batches of fast samples show of gyros and accelerometers: how they shake, at which frequencies, and whether they clip.
//!
//! ArduPilot (`INS_LOG_BAT_MASK`) writes the samples of one sensor for a second or so, then those of the next: never those of a gyro and of an
//! accelerometer together. Nothing can be integrated over that, but a spectrum needs no more than one batch: here it is the mean over
//! windows that overlap by half (P. D. Welch, The use of fast Fourier transform for the estimation of power spectra, 1967).

use microfft::real::rfft_512;

/// Samples of a window.
const WINDOW: usize = 512;
const BINS: usize = WINDOW / 2;
/// What is slower is motion and no vibration, Hz.
const MOTION_HZ: f64 = 5.0;
/// A tone is spread over so many bins to either side of its own by the window.
const TONE: usize = 2;
/// Rates that are measured differ by less than this part from batch to batch.
const SAME_RATE: f64 = 0.05;
/// Sensors that are told apart.
const MOST: usize = 16;

/// What a batch is of.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub enum FastKind {
    /// Angular rates, rad/s.
    Gyro,
    /// Specific forces, m/s².
    Accelerometer,
}

/// One sensor's batches.
#[derive(Clone, Debug)]
pub struct FastSensor {
    /// What it measures.
    pub kind: FastKind,
    /// Which of several.
    pub unit: u8,
    /// Samples a second within a batch.
    pub rate_hz: f64,
    /// Batches that were whole.
    pub batches: u64,
    /// Samples in them.
    pub samples: u64,
    /// Samples with a component at the end of what the log can hold.
    pub clipped: u64,
    /// Mean squares by frequency, one sum a body axis, and the number of windows in them.
    power: [Vec<f64>; 3],
    windows: u64,
}

/// All of them.
#[derive(Clone, Debug, Default)]
pub struct FastSensors {
    sensors: Vec<FastSensor>,
    /// Batches of which something is missing.
    pub broken: u64,
}

/// The frequency at which most of a vibration is.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct VibrationTone {
    /// Hz.
    pub hz: f64,
    /// Part of the mean square of all that vibrates.
    pub part: f64,
}

impl FastSensors {
    /// The sensors in their order.
    pub fn all(&self) -> impl Iterator<Item = &FastSensor> {
        self.sensors.iter()
    }

    /// Takes a whole batch in SI units along the body's axes.
    pub(super) fn take(
        &mut self,
        kind: FastKind,
        unit: u8,
        rate_hz: f64,
        samples: &[[f64; 3]],
        clipped: u64,
    ) {
        let at = match self.sensors.binary_search_by_key(&(kind, unit), |s| (s.kind, s.unit)) {
            Ok(at) => at,
            Err(_) if self.sensors.len() >= MOST => return,
            Err(at) => {
                self.sensors.insert(at, FastSensor::new(kind, unit, rate_hz));
                at
            }
        };
        let sensor = &mut self.sensors[at];
        if (rate_hz / sensor.rate_hz - 1.0).abs() > SAME_RATE {
            // Set up anew: a spectrum has one rate.
            *sensor = FastSensor::new(kind, unit, rate_hz);
        }
        sensor.add(samples, clipped);
    }
}

impl FastSensor {
    fn new(kind: FastKind, unit: u8, rate_hz: f64) -> Self {
        let power = [(); 3].map(|()| vec![0.0; BINS]);
        Self { kind, unit, rate_hz, batches: 0, samples: 0, clipped: 0, power, windows: 0 }
    }

    fn add(&mut self, samples: &[[f64; 3]], clipped: u64) {
        self.batches += 1;
        self.samples += samples.len() as u64;
        self.clipped += clipped;
        let weight = |i: usize| 0.5 - 0.5 * (std::f64::consts::TAU * i as f64 / WINDOW as f64).cos();
        // The sum of the squares of the weights is 3/8 of the window; half of every frequency's power is at its negative.
        let scale = 2.0 / (WINDOW as f64 * 0.375 * WINDOW as f64);
        for start in (0..).map(|n| n * WINDOW / 2).take_while(|start| start + WINDOW <= samples.len()) {
            let window = &samples[start..start + WINDOW];
            for (axis, power) in self.power.iter_mut().enumerate() {
                let mean = window.iter().map(|s| s[axis]).sum::<f64>() / WINDOW as f64;
                let mut weighted: [f32; WINDOW] =
                    std::array::from_fn(|i| ((window[i][axis] - mean) * weight(i)) as f32);
                let spectrum = rfft_512(&mut weighted);
                // The first holds the mean, and what alternates from sample to sample.
                for (sum, bin) in power.iter_mut().zip(spectrum.iter()).skip(1) {
                    *sum += scale * f64::from(bin.norm_sqr());
                }
            }
            self.windows += 1;
        }
    }

    fn bin_hz(&self) -> f64 {
        self.rate_hz / WINDOW as f64
    }

    /// Mean squares of an axis by frequency, Hz, from where vibration begins.
    fn vibrating(&self, axis: usize) -> impl Iterator<Item = (f64, f64)> + '_ {
        let (bin_hz, n) = (self.bin_hz(), self.windows as f64);
        let all = self.power[axis].iter().enumerate().map(move |(i, p)| (i as f64 * bin_hz, p / n));
        all.filter(|(hz, _)| *hz >= MOTION_HZ)
    }

    /// Root mean square of what vibrates, along the body's axes; `None` where every batch is shorter than a window.
    pub fn vibration(&self) -> Option<[f64; 3]> {
        self.passed(|_| 1.0)
    }

    /// The same of what is left of it by a filter with this gain (of amplitudes) at a frequency, Hz.
    pub fn passed(&self, gain: impl Fn(f64) -> f64) -> Option<[f64; 3]> {
        let rms = |axis| self.vibrating(axis).map(|(hz, p)| gain(hz).powi(2) * p).sum::<f64>().sqrt();
        (self.windows > 0).then(|| std::array::from_fn(rms))
    }

    /// Where most of it is.
    pub fn strongest(&self) -> Option<VibrationTone> {
        let bin_hz = self.bin_hz();
        let first = (MOTION_HZ / bin_hz).ceil() as usize;
        let all: Vec<f64> = (0..BINS)
            .map(|i| if i < first { 0.0 } else { self.power.iter().map(|axis| axis[i]).sum() })
            .collect();
        let whole: f64 = all.iter().sum();
        let (peak, _) = all.iter().enumerate().max_by(|a, b| a.1.total_cmp(b.1))?;
        let around = peak.saturating_sub(TONE)..(peak + TONE + 1).min(BINS);
        let tone: f64 = all[around.clone()].iter().sum();
        let hz = around.map(|i| i as f64 * all[i]).sum::<f64>() / tone * bin_hz;
        (whole > 0.0).then_some(VibrationTone { hz, part: tone / whole })
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    /// 2 units along x at 80 Hz, half a unit of white noise along y, motion along z.
    fn shaken(n: usize, rate_hz: f64) -> Vec<[f64; 3]> {
        let mut state = 1u64;
        let mut noise = || {
            state = state.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1_442_695_040_888_963_407);
            // Uniform, of the standard deviation 1/2.
            ((state >> 11) as f64 / (1u64 << 53) as f64 - 0.5) * 3f64.sqrt()
        };
        let at = |i: usize| std::f64::consts::TAU * i as f64 / rate_hz;
        (0..n).map(|i| [2.0 * (80.0 * at(i)).sin(), noise(), 9.8 + 5.0 * (0.5 * at(i)).sin()]).collect()
    }

    #[test]
    fn a_tone_is_found_with_its_size_and_motion_is_none() {
        let mut sensors = FastSensors::default();
        for _ in 0..4 {
            sensors.take(FastKind::Accelerometer, 0, 1000.0, &shaken(1024, 1000.0), 0);
        }
        let sensor = sensors.all().next().unwrap();
        let [x, y, z] = sensor.vibration().unwrap();
        assert!((x - 2f64.sqrt()).abs() < 0.01 && (y - 0.5).abs() < 0.03 && z < 0.1, "{x} {y} {z}");
        let tone = sensor.strongest().unwrap();
        // A tone of the mean square 2 beside noise of 1/4.
        assert!((tone.hz - 80.0).abs() < 0.5 && (tone.part - 0.89).abs() < 0.02, "{tone:?}");
        let [x, y, _] = sensor.passed(|hz| f64::from(u8::from(hz > 100.0))).unwrap();
        assert!(x < 0.01 && (y - 0.5 * 0.8f64.sqrt()).abs() < 0.03, "{x} {y}");
        assert_eq!((sensor.batches, sensor.samples), (4, 4096));
    }

    #[test]
    fn sensors_are_told_apart_short_batches_have_no_spectrum_and_another_rate_begins_anew() {
        let mut sensors = FastSensors::default();
        sensors.take(FastKind::Accelerometer, 1, 1000.0, &shaken(256, 1000.0), 7);
        sensors.take(FastKind::Gyro, 1, 1000.0, &shaken(600, 1000.0), 0);
        sensors.take(FastKind::Gyro, 0, 1000.0, &shaken(600, 1000.0), 0);
        sensors.take(FastKind::Gyro, 0, 999.0, &shaken(600, 1000.0), 0);
        sensors.take(FastKind::Gyro, 1, 4000.0, &shaken(600, 4000.0), 0);
        let seen: Vec<_> = sensors.all().map(|s| (s.kind, s.unit, s.batches, s.rate_hz)).collect();
        use FastKind::{Accelerometer, Gyro};
        assert_eq!(seen, [(Gyro, 0, 2, 1000.0), (Gyro, 1, 1, 4000.0), (Accelerometer, 1, 1, 1000.0)]);
        let short = sensors.all().last().unwrap();
        assert_eq!((short.vibration(), short.strongest(), short.clipped), (None, None, 7));
    }

    proptest! {
        #[test]
        fn any_samples_have_a_finite_spectrum_or_none(
            batches in proptest::collection::vec(
                (any::<bool>(), any::<u8>(), 1.0..1e5f64, proptest::collection::vec(proptest::array::uniform3(-160.0..160.0f64), 0..1100)),
                0..8
            )
        ) {
            let mut sensors = FastSensors::default();
            for (gyro, unit, rate_hz, samples) in &batches {
                let kind = if *gyro { FastKind::Gyro } else { FastKind::Accelerometer };
                sensors.take(kind, *unit, *rate_hz, samples, 0);
            }
            for sensor in sensors.all() {
                if let Some(v) = sensor.vibration() {
                    prop_assert!(v.iter().all(|v| v.is_finite() && *v < 500.0), "{v:?}");
                }
                if let Some(tone) = sensor.strongest() {
                    prop_assert!(tone.hz > 0.0 && tone.hz < sensor.rate_hz && tone.part <= 1.0 + 1e-9, "{tone:?}");
                }
            }
        }
    }
}
