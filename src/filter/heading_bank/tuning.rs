//! The heading bank's tuning constants, with their reasons.

use super::HeadingBankSettings;

// The hypotheses.

/// Hypotheses: 22.5° apart, within what an error-state filter's linearisation reaches. Time and memory grow with them.
pub(super) const HYPOTHESES: usize = 16;
/// Standard deviation of a hypothesis over the distance to the next: their sum is then nearly flat.
pub(super) const OVERLAP: f64 = 0.6;
/// No hypothesis is ever less likely than this: what was wrongly given up can come back.
pub(super) const LEAST_WEIGHT: f64 = 1e-6;
/// Corrections of the attitude beyond this leave a linearisation error worth counting, rad: half of its square is 10⁻³.
pub(super) const LARGE_TURN: f64 = 0.05;
/// The covariance is propagated this often when no fix comes, s: the force counts as constant over it.
pub(super) const COVARIANCE_STEP_S: f64 = 0.5;
/// Samples that may wait for a fix: 2 s at 500 Hz, more than any receiver is late.
pub(super) const WAITING: usize = 1024;

// The start.

/// The specific force is averaged over this long before the tilt is read off it, s: longer than a rotor's vibration, shorter than a turn.
pub(super) const LEVELLING_S: f64 = 0.3;
/// At least over this much of it, s.
pub(super) const LEAST_LEVELLING_S: f64 = 0.05;
/// Below this part of gravity the specific force has no direction worth taking: the vehicle falls.
pub(super) const LEAST_FORCE: f64 = 0.3;
/// Tilt error of a vehicle whose specific force looks like gravity, rad: 1 m/s² of acceleration hides in a force of that size.
pub(super) const LEAST_TILT: f64 = 0.1;

// The fixes.

/// A fix may lie this far ahead of the newest sample, s: it is taken for one of that time. Clocks of receiver and IMU jitter by some samples.
pub(super) const AHEAD_S: f64 = 0.05;
/// The errors of GNSS velocities go on for this long, s: fixes that come faster are worth less each.
pub(super) const CORRELATION_S: f64 = 0.3;
/// A fix that surprises all hypotheses by more than this many (squared) sigmas is an outlier: two components exceed it three times in ten
/// million.
pub(super) const GATE_NIS: f64 = 30.0;
/// So many outliers in a row and it is the bank that is wrong: it starts anew.
pub(super) const OUTLIERS: u32 = 10;
/// Longest time between two fixes, s: after it the bank starts anew, for the velocities have drifted apart by more than fixes can tell.
pub(super) const LONGEST_GAP_S: f64 = 10.0;

// Whether the heading is found.

/// Time constant of the mean turn rate, the mean surprise and the vibration, s: some tens of fixes.
pub(super) const MEAN_S: f64 = 5.0;
/// Mean surprise (squared sigmas of two components: 2 in the mean) above which the bank does not know what it is doing.
pub(super) const DOUBTFUL_NIS: f64 = 6.0;

impl HeadingBankSettings {
    /// For small MEMS sensors.
    pub const fn standard() -> Self {
        Self {
            shared_instants: false,
            gyro_noise: 0.002,
            gyro_rate_noise: 0.015,
            accel_noise: 0.05,
            gyro_bias_sigma: 0.02,
            gyro_bias_walk: 1e-4,
            // 10°.
            found_sigma: 0.1745,
            found_s: 2.0,
        }
    }
}
