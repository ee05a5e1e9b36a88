//! What can be wrong with a height channel, and what is told about it.

use super::joint::Channel;

/// What is wrong.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Fault {
    /// It is off by a constant.
    Bias {
        /// By how much, m.
        size_m: f64,
        /// How well that is known (1 sigma), m.
        sigma_m: f64,
    },
    /// Its noise has grown.
    Noise {
        /// The variance over what it should be.
        variance_factor: f64,
    },
}

/// The state of a channel.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Health {
    /// Nothing was heard of it yet.
    Unheard,
    /// It fits.
    Healthy,
    /// It does not.
    Faulty {
        /// What is wrong.
        fault: Fault,
        /// Since how long, s: from the estimated onset on.
        for_s: f64,
    },
}

impl Health {
    /// Whether a fault is declared.
    pub const fn is_faulty(&self) -> bool {
        matches!(self, Health::Faulty { .. })
    }
}

/// A fault was declared, or is over.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Change {
    /// A channel is faulty.
    Faulty {
        /// Which.
        channel: Channel,
        /// What is wrong.
        fault: Fault,
        /// How long ago it began, s.
        for_s: f64,
        /// What the height moved by when the fault's effect was taken out of it, m.
        height_step_m: f64,
    },
    /// A channel is healthy again.
    Healed {
        /// Which.
        channel: Channel,
        /// What the height moved by, m.
        height_step_m: f64,
    },
    /// The inertial altitude had gone astray.
    InertialAstray {
        /// What the height moved by, m.
        height_step_m: f64,
    },
}

impl Change {
    /// What the height moved by, m, up.
    pub const fn height_step_m(&self) -> f64 {
        match self {
            Change::Faulty { height_step_m, .. }
            | Change::Healed { height_step_m, .. }
            | Change::InertialAstray { height_step_m } => *height_step_m,
        }
    }
}
