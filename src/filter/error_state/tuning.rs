//! The error-state filter's tuning constants, with their reasons. Its noise is [`super::EskfSettings`].

/// Longest step of the covariance, s, where nobody asks for another. The error's transition is linear in sums over it: of second order in the rotation within, some 10⁻³ at
/// 2 rad/s. Longer saves time, shorter follows faster rotations.
pub(super) const COVARIANCE_STEP_S: f64 = 0.02;
/// Samples between two orthonormalisations: a product of rotations leaves SO(3) by 10⁻¹⁶ a sample.
pub(super) const REORTHONORMALISE: u32 = 100;
/// Slower than this through the air, neither airspeed nor sideslip say anything, m/s: a pitot tube shows the square of it, and the direction of
/// the wind's error is the sideslip's.
pub(super) const MIN_AIRSPEED: f64 = 3.0;
/// The onsets of jumps that are watched for: so far apart, s, times so much, from the newest on. 14 s are long enough for what shows slowly, and a second's step is told from a
/// slow one early.
pub(super) const JUMP_SPACING_S: f64 = 1.0;
pub(super) const JUMP_EVERY: [u32; JUMP_WINDOWS] = [1, 1, 2, 2, 4, 4];
pub(super) const JUMP_WINDOWS: usize = 6;
/// Their sensitivity follows the motion in steps of this, s.
pub(super) const JUMP_STEP_S: f64 = 0.1;
/// A jump happened between two onsets: its size is off by about this part of it.
pub const JUMP_ONSET_PART: f64 = 0.5;
/// In them an innovation counts for no more than so many sigmas.
pub(super) const OUTLIER_SIGMAS: f64 = 5.0;
/// Beyond so many of its sigmas what has happened is no jump.
pub(super) const IMPLAUSIBLE_SIGMAS: f64 = 3.5;
