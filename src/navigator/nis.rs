//! How likely the measurements were that the filter took: normalised innovations squared, by kind.
//!
//! Where the filter is honest the mean is 1 (each is counted per scalar). Well above: it is too sure of itself. Well below: too cautious.

use crate::filter::error_state::Gated;

/// What was fused.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Measured {
    /// A GNSS position component.
    GnssPosition,
    /// A GNSS velocity component.
    GnssVelocity,
    /// A magnetometer vector.
    Magnetometer,
    /// A flow velocity component.
    Flow,
    /// The height filter's height.
    Height,
    /// Airspeed.
    Airspeed,
    /// No sideslip.
    Sideslip,
    /// Rotor drag along an axis.
    Drag,
    /// Standing still.
    Standstill,
    /// A component of the position that landmarks give.
    LandmarkPosition,
    /// The heading that landmarks give.
    LandmarkHeading,
}

impl Measured {
    /// All, in the order they are shown.
    pub const ALL: [Measured; 11] = [
        Measured::GnssPosition,
        Measured::GnssVelocity,
        Measured::Magnetometer,
        Measured::Flow,
        Measured::Height,
        Measured::Airspeed,
        Measured::Sideslip,
        Measured::Drag,
        Measured::Standstill,
        Measured::LandmarkPosition,
        Measured::LandmarkHeading,
    ];

    /// Name for tables.
    pub const fn label(self) -> &'static str {
        match self {
            Measured::GnssPosition => "GNSS position",
            Measured::GnssVelocity => "GNSS velocity",
            Measured::Magnetometer => "magnetometer",
            Measured::Flow => "optical flow",
            Measured::Height => "height",
            Measured::Airspeed => "airspeed",
            Measured::Sideslip => "sideslip",
            Measured::Drag => "rotor drag",
            Measured::Standstill => "standstill",
            Measured::LandmarkPosition => "landmark position",
            Measured::LandmarkHeading => "landmark heading",
        }
    }
}

/// Count, mean and rejections of one kind.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct NisCount {
    /// Scalars fused.
    pub fused: u64,
    /// Measurements outside the gate.
    pub gated: u64,
    sum: f64,
}

impl NisCount {
    /// Mean normalised innovation squared of what was fused.
    pub fn mean(&self) -> Option<f64> {
        (self.fused > 0).then(|| self.sum / self.fused as f64)
    }
}

/// Of every kind.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct NisTally([NisCount; Measured::ALL.len()]);

impl NisTally {
    pub(super) fn fused(&mut self, kind: Measured, nis: f64) {
        let count = &mut self.0[kind as usize];
        count.fused += 1;
        count.sum += nis;
    }

    pub(super) fn gated(&mut self, kind: Measured) {
        self.0[kind as usize].gated += 1;
    }

    /// Counts what became of a scalar measurement; `nis` reads it from what was fused.
    pub(super) fn note<T>(
        &mut self,
        kind: Measured,
        fused: Result<T, Gated>,
        nis: impl Fn(&T) -> f64,
    ) -> Option<T> {
        match fused {
            Ok(correction) => {
                self.fused(kind, nis(&correction));
                Some(correction)
            }
            Err(_) => {
                self.gated(kind);
                None
            }
        }
    }

    /// Of one kind.
    pub fn of(&self, kind: Measured) -> NisCount {
        self.0[kind as usize]
    }
}
