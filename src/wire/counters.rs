//! What happened to the bytes that came in: every frame is either used, of no interest, or rejected for a counted cause.

use serde::Serialize;
use strum::{IntoStaticStr, VariantArray};

/// Why bytes or a frame were not used.
#[derive(
    Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Hash, Debug, Serialize, IntoStaticStr, VariantArray,
)]
#[serde(rename_all = "snake_case")]
pub enum Cause {
    /// Bytes that belong to no frame.
    #[strum(serialize = "garbage bytes")]
    Garbage,
    /// The checksum does not fit: a damaged frame.
    #[strum(serialize = "bad checksum")]
    BadChecksum,
    /// The message id is not in the dialect.
    #[strum(serialize = "unknown id")]
    UnknownId,
    /// An enumerated field has a value that the dialect does not know.
    #[strum(serialize = "unknown enum value")]
    UnknownEnum,
    /// The payload is longer than the message's definition allows, or cannot be read.
    #[strum(serialize = "bad payload")]
    BadPayload,
    /// Another vehicle, a ground station or a component that is not the autopilot's.
    #[strum(serialize = "wrong system")]
    WrongSystem,
    /// A field that must be finite is not.
    #[strum(serialize = "not finite")]
    NotFinite,
    /// A field has an impossible value (a pressure of zero, a position beyond the globe).
    #[strum(serialize = "absurd value")]
    Absurd,
    /// A velocity of the flow over ground that comes without the distance that it stands on.
    #[strum(serialize = "flow without distance")]
    NoDistance,
    /// The sample is older than one already used and too old to be put in order.
    #[strum(serialize = "out of order")]
    OutOfOrder,
    /// The sample is much older than the newest of its clock.
    #[strum(serialize = "stale")]
    Stale,
    /// It contradicts what is known, and nothing has confirmed it yet.
    #[strum(serialize = "unconfirmed")]
    Unconfirmed,
    /// The message tells of a frame of reference that is not what it is taken for.
    #[strum(serialize = "unusable frame of reference")]
    ForeignFrame,
    /// The signature does not fit: another key, or a forged frame.
    #[strum(serialize = "bad signature")]
    BadSignature,
    /// A signed frame was heard before, or a later one of its stream.
    #[strum(serialize = "replayed")]
    Replayed,
    /// The first signed frame of a stream is more than a minute behind.
    #[strum(serialize = "signature too old")]
    OldSignature,
    /// There is no signature, and there has to be one.
    #[strum(serialize = "unsigned")]
    Unsigned,
}

impl Cause {
    /// Every cause, in the order they are shown.
    pub const ALL: &'static [Self] = Self::VARIANTS;

    /// A short name for tables.
    pub fn label(self) -> &'static str {
        self.into()
    }
}

/// Counts by [`Cause`], and the frames that passed.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct Counters {
    /// Frames whose checksum is right, known message or not.
    pub frames: u64,
    by_cause: [u64; Cause::ALL.len()],
}

impl Counters {
    /// Counts one event of `cause`.
    pub fn count(&mut self, cause: Cause) {
        self.add(cause, 1);
    }

    /// Counts `n` events of `cause` ([`Cause::Garbage`] counts bytes).
    pub fn add(&mut self, cause: Cause, n: u64) {
        self.by_cause[cause as usize] += n;
    }

    /// How often `cause` was counted.
    pub fn of(&self, cause: Cause) -> u64 {
        self.by_cause[cause as usize]
    }

    /// The causes that were counted at least once.
    pub fn seen(&self) -> impl Iterator<Item = (Cause, u64)> + '_ {
        Cause::ALL.iter().copied().map(|c| (c, self.of(c))).filter(|&(_, n)| n > 0)
    }

    /// Adds all of `other`'s counts.
    pub fn merge(&mut self, other: &Counters) {
        self.frames += other.frames;
        for (mine, theirs) in self.by_cause.iter_mut().zip(other.by_cause) {
            *mine += theirs;
        }
    }
}
