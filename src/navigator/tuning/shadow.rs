//! Constants of the shadows that prove the sigma.

/// Ages of a dead reckoning at which it is compared with GNSS, s.
pub(in crate::navigator) const HORIZONS_S: [f64; 4] = [10.0, 30.0, 60.0, 120.0];
/// What an outage of up to this would come to is told in a line, s.
pub(in crate::navigator) const TOLD_S: f64 = 60.0;
/// The IMU is averaged over this long for a shadow, s …
pub(in crate::navigator) const STEP_S: f64 = 0.02;
/// … its covariance follows in steps of this, s …
pub(in crate::navigator) const COVARIANCE_STEP_S: f64 = 0.1;
/// … and flow, magnetometer and height are fused this often, s.
pub(in crate::navigator) const FLOW_PERIOD_S: f64 = 0.1;
pub(in crate::navigator) const MAGNETIC_PERIOD_S: f64 = 0.2;
pub(in crate::navigator) const HEIGHT_PERIOD_S: f64 = 0.5;
/// A source has carried a shadow when it did so for this part of its time.
pub(in crate::navigator) const CARRIED_PART: f64 = 0.8;
/// A receiver's error wanders within this time, s: ionosphere, multipath and constellation.
pub(in crate::navigator) const WANDER_S: f64 = 300.0;
/// What a fix is off by for itself is averaged over so many fixes.
pub(in crate::navigator) const FIX_NOISE_FIXES: f64 = 50.0;
/// Who is this high above the ground, m, or this fast, m/s, flies.
pub(in crate::navigator) const FLIES_M: f64 = 1.5;
pub(in crate::navigator) const FLIES_MPS: f64 = 2.0;
/// Factors that are weighed against each other: 2^(i/4) from the least on, 1/2 to 16.
pub(in crate::navigator) const FACTORS: usize = 21;
pub(in crate::navigator) const LEAST_LOG2: f64 = -1.0;
pub(in crate::navigator) const LOG2_STEP: f64 = 0.25;
/// Before anything was measured the factor is 1 to within this, log₂, 1 sigma: IMUs and their mounts differ by a factor of ten and more in what
/// they make of vibration. A flow was compared with GNSS before it was trusted, and its noise measured.
pub(in crate::navigator) const PRIOR_LOG2: f64 = 1.5;
pub(in crate::navigator) const PRIOR_LOG2_FLOW: f64 = 0.5;
/// From one horizon to the next it changes by a quarter, 1 sigma.
pub(in crate::navigator) const CHANGE_LOG2: f64 = 0.3;
/// So many comparisons are remembered: a vehicle that hovers and then races is another.
pub(in crate::navigator) const MEMORY: f64 = 20.0;
/// What was learned on another flight is known worse by this, log₂.
pub(in crate::navigator) const ANOTHER_FLIGHT_LOG2: f64 = 0.5;
