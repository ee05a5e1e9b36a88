//! The altimeter's tuning constants, with their reasons. What a vehicle's sensors are like is in [`super::AltimeterSettings`].

use super::settings::DetectionSettings;

// The prediction.

/// Longest step of the prediction, s: the paper's Td. Its transition is of the first order in the rates, so this is well below their inverse.
pub(super) const MAX_STEP_S: f64 = 0.5;
/// Longest time that is predicted at once, s: nobody is without an IMU for longer and knows the height. Bounds the work of one call.
pub(super) const MAX_TIME_S: f64 = 5000.0;
/// Beyond this nothing is a height, a distance, or what an origin moves by, m: far above any flight, far below what overflows when squared.
pub(super) const LARGEST_M: f64 = 1e6;
/// Beyond this nothing is an acceleration, or the noise of one, m/s²: a thousand g.
pub(super) const LARGEST_MPS2: f64 = 1e4;
/// Variance of a height of which nothing is known any more, m²: from here on time stands still, for the doubt grows without bound.
pub(super) const LOST_VARIANCE: f64 = LARGEST_M * LARGEST_M;

// How much of the noise that is asked for is there.

/// The least part of it, as variance. Never zero: a part of zero could not grow again, for it grows by a factor.
pub(super) const LEAST_NOISE_SHARE: f64 = 0.02;
/// How fast the part grows and shrinks with the surprise of a sample. Up four times as fast as down: an underestimated noise costs the height,
/// an overestimated one only sharpness.
pub(super) const NOISE_SHARE_GAIN: [f64; 2] = [0.03, 0.0075];
/// ν² at which the part stays as it is. The mean of a healthy ν² is 1; 2 leaves room for noise that is not quite white, so that the part
/// shrinks in a calm flight.
pub(super) const SURPRISE: f64 = 2.0;

// The guard of every sample.

/// The limit of (32), in standard deviations: the paper's. A sample at 3 σ has a weight of one half.
pub(super) const LIMIT: f64 = 3.0;
/// A channel without a height of its own that was silent for this long begins anew, s. A longer
/// time trusts a ground that is not there any more, a shorter one begins anew after every dropout.
pub(super) const FORGOTTEN_S: f64 = 3.0;
/// So many distances in a row that do not fit are to another ground. Fewer would follow single reflections,
/// more would leave the height without it over every step of the ground.
pub(super) const ANOTHER_GROUND: u32 = 5;
/// A channel has settled when its prediction's variance is this part of a sample's: the innovation is then a sample's own noise to 5 %, so that
/// (32) judges the channel and not the start.
pub(super) const SETTLED: f64 = 0.1;
/// Or after so many samples: an offset that is as large as the noise never becomes known better, and has to be judged all the same.
pub(super) const SETTLING: u32 = 20;
/// A channel whose prediction is so much worse than a sample, as variance, has to settle again: after a long silence of all, nobody knows
/// what it should read.
pub(super) const UNSETTLED: f64 = 25.0;
/// An innovation beyond this may be the first of a fault and opens an onset at once, in standard deviations. A healthy channel has one in
/// eighty; one that is missed is found at the next regular onset, at most a spacing later.
pub(super) const SUSPICIOUS: f64 = 2.5;

// The bank of onsets.

/// Onsets that are looked at. The cost of a sample grows with them (`benches/altimeter.rs`); fewer estimate the onset, and so the size, less well.
pub(super) const ONSETS: usize = 14;
/// The newest of them are kept one by one, the older ones are thinned: a fault is found by its youngest onsets, if it is large.
pub(super) const DENSE: usize = 6;
/// ν²/S of a sample counts for no more than this in the bounded sums, which say whether noise has grown: (4 σ)², so that one outlier
/// is no noise.
pub(super) const BOUNDED_SQUARE: f64 = 16.0;

// What is declared, and when it is over.

/// Log-odds of zero against a bias above which it is over: zero may be e² times less likely. A higher one
/// leaves a channel unused for longer after its bias has gone; a lower one takes a bias that is still there for over.
pub(super) const HEALED: f64 = -2.0;
/// A barometer and GNSS that are off by sizes within so many standard deviations of each other agree.
pub(super) const AGREE: f64 = 3.0;
/// Samples over which the grown noise's variance is averaged: 40 know it to 22 %.
pub(super) const NOISE_MEMORY: f64 = 40.0;
/// A factor on the variance below this is no fault: with [`NOISE_MEMORY`] samples it is two sigmas from 1.
pub(super) const LEAST_NOISE_FACTOR: f64 = 1.5;
/// ½ D²/var of the barometer's offset from which on it has drifted: 5 σ, for the test is over all of the flight.
pub(super) const DRIFTED: f64 = 12.5;
/// The same below which it has not any more: 2 σ, where a healthy offset is nineteen times of twenty.
pub(super) const UNDRIFTED: f64 = 2.0;
/// A barometer that drifts has an offset that walks by so many times what it does otherwise: more follows the drift sooner, and leaves less of
/// the barometer in the height.
pub(super) const LOOSE: f64 = 5.0;
/// Changes that can wait to be asked for: more than four channels can have between two samples.
pub(super) const CHANGES: usize = 16;

impl DetectionSettings {
    /// Chosen on runs of the paper's scenarios (seeds other than those that are reported), for samples as its Td has them.
    pub(super) const fn paper(step_s: f64) -> Self {
        Self {
            // Odds of e^13.5, 700 000 to 1.
            ratio: 13.5,
            margin: 4.0,
            jump_cost: 2.0,
            both_cost: 3.0,
            noise_cost: 2.0,
            // The paper's inertial system never goes astray.
            climb_jump_mps: 0.0,
            samples: 5,
            lasting_s: 0.0,
            spacing_s: step_s,
            window_s: 80.0 * step_s,
            bias_m: 30.0,
            relief: 9.0,
        }
    }

    /// For a vehicle's own sensors, whose noise is neither white nor Gaussian: with a larger log-likelihood ratio `ratio`, over a window
    /// of `window_s`, s.
    pub const fn recorded(ratio: f64, window_s: f64) -> Self {
        Self { ratio, lasting_s: 0.4, spacing_s: 0.1, window_s, ..Self::paper(0.5) }
    }
}
