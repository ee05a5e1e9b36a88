//! What became of every sample: used, waiting, or rejected with a reason. Silence is a bug, so all of it is counted.

use super::monitor::GnssFault;
use crate::camera::calibration::Distrust;

/// Why a sample was not used.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Hash, strum::IntoStaticStr)]
pub enum Reason {
    /// A number in it is not finite.
    #[strum(serialize = "not finite")]
    NotFinite,
    /// Older than the newest of its kind.
    #[strum(serialize = "out of order")]
    OutOfOrder,
    /// It came so long after it was measured that it cannot be set against its own time any more.
    #[strum(serialize = "too late")]
    Late,
    /// The sensor repeats itself where it cannot.
    #[strum(serialize = "stuck")]
    Stuck,
    /// There is no origin, attitude or height yet to use it with.
    #[strum(serialize = "no reference yet")]
    NoReferenceYet,
    /// The innovation is out of bounds.
    #[strum(serialize = "innovation out of bounds")]
    Innovation,
    /// The GNSS trust monitor rejected it.
    #[strum(serialize = "GNSS")]
    Gnss(GnssFault),
    /// Another sensor of the same kind is used.
    #[strum(serialize = "another sensor is used")]
    Redundant,
    /// Switched off by configuration.
    #[strum(serialize = "switched off")]
    SwitchedOff,
    /// The magnetic field has the wrong strength.
    #[strum(serialize = "wrong field strength")]
    FieldStrength,
    /// The magnetic field dips otherwise than Earth's.
    #[strum(serialize = "wrong field direction")]
    FieldDirection,
    /// The flow sensor itself calls it bad.
    #[strum(serialize = "low quality")]
    LowQuality,
    /// The height over the ground is not known, or the vehicle stands.
    #[strum(serialize = "no height over ground")]
    NoDistance,
    /// The vehicle leans too much for the ground to be seen.
    #[strum(serialize = "too much tilt")]
    Tilt,
    /// Beyond the sensor's own limits.
    #[strum(serialize = "out of range")]
    OutOfRange,
    /// The image's features or patches lie so that they do not observe the velocity.
    #[strum(serialize = "velocity not observed")]
    Unobservable,
    /// The features or patches of one image do not agree on one motion.
    #[strum(serialize = "patches disagree")]
    Inconsistent,
    /// The vehicle is too slow for it to mean anything.
    #[strum(serialize = "too slow")]
    TooSlow,
    /// The sensor contradicts GNSS.
    #[strum(serialize = "contradicts GNSS")]
    Distrusted,
    /// Motion shows another heading.
    #[strum(serialize = "contradicts motion")]
    ContradictsMotion,
    /// Its stamp lies further ahead than any sensor's may.
    #[strum(serialize = "from the future")]
    Early,
    /// It was told before.
    #[strum(serialize = "told before")]
    Duplicate,
    /// No landmark of this id is configured.
    #[strum(serialize = "unknown landmark")]
    UnknownLandmark,
    /// It is told in pixels, and what one is worth is not found yet.
    #[strum(serialize = "scale not known yet")]
    UnknownUnit,
    /// No camera of this component is configured.
    #[strum(serialize = "unknown camera")]
    UnknownCamera,
    /// Of no use on this vehicle, or to this version of the navigator.
    #[strum(serialize = "not used")]
    NotUsed,
}

impl Reason {
    /// A few words for tables.
    pub fn label(self) -> &'static str {
        match self {
            Reason::Gnss(fault) => fault.reason(),
            other => other.into(),
        }
    }
}

impl From<Distrust> for Reason {
    fn from(_: Distrust) -> Self {
        Reason::Distrusted
    }
}

/// What became of a sample.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Verdict {
    /// It corrected or propagated the solution, or taught a calibration.
    Used,
    /// It waits for the rest of its image, and is counted with it.
    Waiting,
    /// It was not used.
    Rejected(Reason),
}
