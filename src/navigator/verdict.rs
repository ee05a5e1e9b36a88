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
    pub fn label(self) -> String {
        match self {
            Reason::NotFinite => "not finite".into(),
            Reason::OutOfOrder => "out of order".into(),
            Reason::Late => "too late".into(),
            Reason::Stuck => "stuck".into(),
            Reason::NoReferenceYet => "no reference yet".into(),
            Reason::Innovation => "innovation out of bounds".into(),
            Reason::Gnss(fault) => fault.reason().into(),
            Reason::Redundant => "another sensor is used".into(),
            Reason::SwitchedOff => "switched off".into(),
            Reason::FieldStrength => "wrong field strength".into(),
            Reason::LowQuality => "low quality".into(),
            Reason::NoDistance => "no height over ground".into(),
            Reason::Tilt => "too much tilt".into(),
            Reason::OutOfRange => "out of range".into(),
            Reason::Unobservable => "velocity not observed".into(),
            Reason::Inconsistent => "patches disagree".into(),
            Reason::TooSlow => "too slow".into(),
            Reason::Distrusted => "contradicts GNSS".into(),
            Reason::Early => "from the future".into(),
            Reason::Duplicate => "told before".into(),
            Reason::UnknownLandmark => "unknown landmark".into(),
            Reason::UnknownCamera => "unknown camera".into(),
            Reason::NotUsed => "not used".into(),
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
