//! One colour for one thing, on every plot: after Okabe and Ito (2008, "Color universal design"), which the colour-blind tell apart, darkened
//! for a light page and lightened for a dark one.

use crate::altimeter::Channel;
use crate::navigator::solution::{Mode, VelocitySource};
use crate::navigator::sources::status::{SourceHealth, SourceKind};

/// What a line, a dot or an area is of.
#[derive(Clone, Copy, Debug, PartialEq, Eq, strum::VariantArray)]
pub(super) enum Role {
    Estimate,
    Reference,
    Gnss,
    Autopilot,
    Barometer,
    SecondBarometer,
    Rangefinder,
    Magnetometer,
    Flow,
    Airspeed,
    Landmarks,
    Inertia,
    AxisX,
    AxisY,
    AxisZ,
    Fault,
}

impl Role {
    /// The class of what is drawn in this colour, and the colour on a light and on a dark page.
    pub(super) const fn colours(self) -> (&'static str, &'static str, &'static str) {
        match self {
            Role::Estimate => ("estimate", "#0072b2", "#5cb0f0"),
            Role::Reference => ("reference", "#1c1c1c", "#f0f0f0"),
            Role::Gnss => ("gnss", "#d98200", "#f2ab35"),
            Role::Autopilot => ("autopilot", "#b0508a", "#e59fca"),
            Role::Barometer => ("barometer", "#00775a", "#2fcb9c"),
            Role::SecondBarometer => ("barometer-2", "#5c8f00", "#a5d94f"),
            Role::Rangefinder => ("rangefinder", "#8a5526", "#cf9b68"),
            Role::Magnetometer => ("magnetometer", "#6448a8", "#b09cf0"),
            Role::Flow => ("flow", "#978000", "#e8d44d"),
            Role::Airspeed => ("airspeed", "#00808a", "#4fd1d9"),
            Role::Landmarks => ("landmarks", "#6b6b6b", "#b5b5b5"),
            Role::Inertia => ("inertia", "#455a80", "#a3b8e6"),
            Role::AxisX => ("axis-x", "#1f2d5a", "#e6ecff"),
            Role::AxisY => ("axis-y", "#4f6cc4", "#9db3f7"),
            Role::AxisZ => ("axis-z", "#94abee", "#5f7ad0"),
            Role::Fault => ("fault", "#cc4010", "#ff7f50"),
        }
    }

    /// The class alone.
    pub(super) const fn class(self) -> &'static str {
        self.colours().0
    }

    /// The colour of a kind of source.
    pub(super) const fn of(kind: SourceKind) -> Self {
        match kind {
            SourceKind::Imu | SourceKind::Standstill => Role::Inertia,
            SourceKind::Gnss => Role::Gnss,
            SourceKind::Barometer | SourceKind::Height => Role::Barometer,
            SourceKind::Rangefinder => Role::Rangefinder,
            SourceKind::Magnetometer => Role::Magnetometer,
            SourceKind::Flow => Role::Flow,
            SourceKind::Airspeed | SourceKind::Drag => Role::Airspeed,
            SourceKind::Landmarks => Role::Landmarks,
        }
    }

    /// The colour of a source of heights.
    pub(super) const fn of_height(channel: Channel) -> Self {
        match channel {
            Channel::Baro => Role::Barometer,
            Channel::SecondBaro => Role::SecondBarometer,
            Channel::Gnss => Role::Gnss,
            Channel::Range => Role::Rangefinder,
        }
    }

    /// The colour of what carries the velocity.
    pub(super) const fn of_carrier(source: VelocitySource) -> Self {
        match source {
            VelocitySource::Gnss => Role::Gnss,
            VelocitySource::Landmarks => Role::Landmarks,
            VelocitySource::Flow => Role::Flow,
            VelocitySource::Airspeed | VelocitySource::Drag => Role::Airspeed,
            VelocitySource::Standstill | VelocitySource::Inertial => Role::Inertia,
        }
    }
}

/// How things stand: the better first.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, strum::VariantArray)]
pub(super) enum Tone {
    /// As it should be.
    Good,
    /// Nothing can be said.
    Idle,
    /// On the way back.
    Returning,
    /// With caution.
    Caution,
    /// Wrong.
    Bad,
}

impl Tone {
    /// The class of what is drawn in this colour, and the colour on a light and on a dark page.
    pub(super) const fn colours(self) -> (&'static str, &'static str, &'static str) {
        match self {
            Tone::Good => ("good", "#8ccbb5", "#1f6f57"),
            Tone::Idle => ("idle", "#d4d4d4", "#474747"),
            Tone::Returning => ("returning", "#9ccdf0", "#245f8c"),
            Tone::Caution => ("caution", "#f2cf66", "#8a6a00"),
            Tone::Bad => ("bad", "#f0906a", "#a33a12"),
        }
    }

    /// The class alone.
    pub(super) const fn class(self) -> &'static str {
        self.colours().0
    }

    /// Of a mode.
    pub(super) const fn of(mode: Mode) -> Self {
        match mode {
            Mode::Aligning => Tone::Idle,
            Mode::Aided => Tone::Good,
            Mode::Holdover => Tone::Caution,
            Mode::Rejoining => Tone::Returning,
            Mode::Lost => Tone::Bad,
        }
    }

    /// Of a source.
    pub(super) const fn of_health(health: SourceHealth) -> Self {
        match health {
            SourceHealth::Healthy => Tone::Good,
            SourceHealth::Suspect => Tone::Caution,
            SourceHealth::Faulty => Tone::Bad,
            SourceHealth::Silent => Tone::Idle,
        }
    }

    /// Of what carries the velocity.
    pub(super) const fn of_carrier(source: VelocitySource) -> Self {
        match source {
            VelocitySource::Gnss | VelocitySource::Landmarks => Tone::Good,
            VelocitySource::Flow | VelocitySource::Standstill => Tone::Returning,
            VelocitySource::Airspeed | VelocitySource::Drag => Tone::Caution,
            VelocitySource::Inertial => Tone::Bad,
        }
    }
}
