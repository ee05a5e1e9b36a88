//! What became of every sample: used, waiting, or rejected with a reason. Silence is a bug, so all of it is counted.

use super::monitor::GnssFault;
use crate::camera::calibration::Distrust;

/// Why a sample was not used.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub enum Reason {
    /// A number in it is not finite.
    NotFinite,
    /// Older than the newest of its kind.
    OutOfOrder,
    /// It came so long after it was measured that it cannot be set against its own time any more.
    Late,
    /// The sensor repeats itself where it cannot.
    Stuck,
    /// There is no origin, attitude or height yet to use it with.
    NoReferenceYet,
    /// The innovation is out of bounds.
    Innovation,
    /// The GNSS trust monitor rejected it.
    Gnss(GnssFault),
    /// Another sensor of the same kind is used.
    Redundant,
    /// Switched off by configuration.
    SwitchedOff,
    /// The magnetic field has the wrong strength.
    FieldStrength,
    /// The flow sensor itself calls it bad.
    LowQuality,
    /// The height over the ground is not known, or the vehicle stands.
    NoDistance,
    /// The vehicle leans too much for the ground to be seen.
    Tilt,
    /// Beyond the sensor's own limits.
    OutOfRange,
    /// The image's features or patches lie so that they do not observe the velocity.
    Unobservable,
    /// The features or patches of one image do not agree on one motion.
    Inconsistent,
    /// The vehicle is too slow for it to mean anything.
    TooSlow,
    /// The sensor contradicts GNSS.
    Distrusted,
    /// Its stamp lies further ahead than any sensor's may.
    Early,
    /// It was told before.
    Duplicate,
    /// No landmark of this id is configured.
    UnknownLandmark,
    /// No camera of this component is configured.
    UnknownCamera,
    /// Of no use on this vehicle, or to this version of the navigator.
    NotUsed,
}

impl Reason {
    /// A few words for tables.
    pub const fn label(self) -> &'static str {
        match self {
            Reason::NotFinite => "not finite",
            Reason::OutOfOrder => "out of order",
            Reason::Late => "too late",
            Reason::Stuck => "stuck",
            Reason::NoReferenceYet => "no reference yet",
            Reason::Innovation => "innovation out of bounds",
            Reason::Gnss(fault) => fault.reason(),
            Reason::Redundant => "another sensor is used",
            Reason::SwitchedOff => "switched off",
            Reason::FieldStrength => "wrong field strength",
            Reason::LowQuality => "low quality",
            Reason::NoDistance => "no height over ground",
            Reason::Tilt => "too much tilt",
            Reason::OutOfRange => "out of range",
            Reason::Unobservable => "velocity not observed",
            Reason::Inconsistent => "patches disagree",
            Reason::TooSlow => "too slow",
            Reason::Distrusted => "contradicts GNSS",
            Reason::Early => "from the future",
            Reason::Duplicate => "told before",
            Reason::UnknownLandmark => "unknown landmark",
            Reason::UnknownCamera => "unknown camera",
            Reason::NotUsed => "not used",
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
