//! What can be wrong with a height channel, and what is told about it.

use std::fmt;

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
    /// It has run away slowly.
    Drift {
        /// By how much, m.
        size_m: f64,
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

impl fmt::Display for Fault {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Fault::Bias { size_m, .. } => write!(f, "off by {size_m:+.1} m"),
            Fault::Drift { size_m } => write!(f, "has drifted by {size_m:+.1} m"),
            Fault::Noise { variance_factor } => write!(f, "noise x{:.1}", variance_factor.sqrt()),
        }
    }
}

impl fmt::Display for Health {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Health::Unheard => write!(f, "not heard"),
            Health::Healthy => write!(f, "healthy"),
            Health::Faulty { fault, for_s } => write!(f, "{fault} for {for_s:.1} s"),
        }
    }
}

impl Health {
    /// Whether a fault is declared.
    pub const fn is_faulty(&self) -> bool {
        matches!(self, Health::Faulty { .. })
    }
}

/// A fault was declared, or is over.
#[derive(Clone, Copy, Debug, PartialEq)]
#[non_exhaustive]
pub enum Change {
    /// A channel is faulty.
    Faulty {
        /// Which.
        channel: Channel,
        /// What is wrong.
        fault: Fault,
        /// How long ago it began, s.
        for_s: f64,
    },
    /// A channel is healthy again.
    Healed(Channel),
    /// The inertial altitude had gone astray.
    InertialAstray {
        /// What the height moved by, m.
        height_step_m: f64,
    },
}
