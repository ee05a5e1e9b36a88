//! Why a flow gives no velocity.

use thiserror::Error;

/// Why a patch, or a set of features, gives no velocity.
#[derive(Clone, Copy, Debug, PartialEq, Error)]
pub enum FlowRefusal {
    /// A value is not finite.
    #[error("a value is not finite")]
    NotFinite,
    /// Δt is zero, negative or absurd.
    #[error("integration time of {0} s")]
    IntegrationTime(f64),
    /// Quality below the limit.
    #[error("quality {0} is too low")]
    Quality(f64),
    /// The optical axis is too far from straight down.
    #[error("tilt of {0} rad is too large")]
    Tilt(f64),
    /// Neither a distance nor a height.
    #[error("no distance to the ground")]
    DistanceMissing,
    /// The distance is outside the limits.
    #[error("distance of {0} m is out of range")]
    Distance(f64),
    /// The height over the ground is outside the limits.
    #[error("height of {0} m is out of range")]
    Height(f64),
    /// The focal length is not positive.
    #[error("focal length of {0}")]
    FocalLength(f64),
    /// The ray does not meet the ground, or only near the horizon.
    #[error("the ray does not meet the ground")]
    Horizon,
    /// Too few features see the ground.
    #[error("{0} features are too few")]
    TooFew(usize),
    /// The features lie so that not every unknown is observed.
    #[error("the matrix is singular: rank {0}")]
    Rank(usize),
    /// The unknowns are observed, but badly.
    #[error("condition number {0} is too large")]
    Condition(f64),
    /// The residuals are larger than the noise explains: root mean square over noise.
    #[error("residuals of {0} times the noise")]
    Residual(f64),
    /// The features do not agree on one motion.
    #[error("only {inliers} of {of} features agree")]
    Consensus {
        /// Features that agree.
        inliers: usize,
        /// Features that see the ground.
        of: usize,
    },
}
