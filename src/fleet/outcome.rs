//! What came of one log.

use serde::{Deserialize, Serialize};

use crate::replay::losses::LossRow;
use crate::replay::sweep::SweepRow;

/// One outage of one log with one estimator.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct OutageRow {
    /// The log.
    pub log: String,
    /// The estimator's name.
    pub estimator: String,
    /// What came of it.
    #[serde(flatten)]
    pub row: SweepRow,
}

/// A loss of GNSS that a log holds.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct NaturalLoss {
    /// The log.
    pub log: String,
    /// The estimator's name.
    pub estimator: String,
    /// What came of it.
    #[serde(flatten)]
    pub row: LossRow,
}

/// What kind of reason it is that a log has no rows.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum Unusable {
    /// It cannot be read, or is no log.
    Unreadable,
    /// It is a log that lacks what is needed.
    Lacking,
}

impl Unusable {
    /// What it is called in files.
    pub const fn label(self) -> &'static str {
        match self {
            Unusable::Unreadable => "unreadable",
            Unusable::Lacking => "lacking",
        }
    }

    /// The one of that name.
    pub fn of(label: &str) -> Option<Self> {
        [Unusable::Unreadable, Unusable::Lacking].into_iter().find(|u| u.label() == label)
    }
}

/// Why a log has no rows.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct LogFailure {
    /// What kind of reason.
    pub kind: Unusable,
    /// In words.
    pub why: String,
}

/// What came of one log with all estimators.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct LogOutcome {
    /// Its place in the whole list, from 0.
    pub index: u64,
    /// Its path or address.
    pub log: String,
    /// What tells it from another log in the same place: size and time of change, or the object's tag.
    pub identity: String,
    /// Its format's name, if it could be opened.
    pub format: Option<String>,
    /// Its autopilot's name and version, if it could be opened.
    pub autopilot: Option<String>,
    /// From its first to its last sample, s.
    pub duration_s: Option<f64>,
    /// Why there are no rows, or none of outages.
    pub failure: Option<LogFailure>,
    /// Its outages, estimator by estimator.
    pub rows: Vec<OutageRow>,
    /// Its own losses of GNSS.
    pub losses: Vec<NaturalLoss>,
}
