//! What ends the validity of what is remembered: one event for every component, each of which knows what of its own it invalidates.

use nalgebra::Vector3;

/// A break in what the navigator stands on.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) enum Reset {
    /// NED's origin has moved by this, NED, m: coordinates are others, the vehicle is where it was.
    OriginMoved(Vector3<f64>),
    /// The estimate was set anew: what is remembered of its past does not belong to it.
    Relocated,
    /// A hole in the IMU stream was bridged: nothing is remembered of it.
    Bridged,
    /// The IMU stream or the estimate broke: velocity and attitude are not known any more.
    StreamBroken,
    /// The autopilot rebooted: the vehicle stands somewhere, and nothing else is certain.
    Reboot,
    /// The autopilot's clock was set back: as a reboot, and no remembered time can be compared with those that come.
    ClockSetBack,
}

impl Reset {
    /// Whether the motion is not known any more.
    pub(super) const fn breaks_motion(&self) -> bool {
        matches!(self, Self::StreamBroken | Self::Reboot | Self::ClockSetBack)
    }

    /// Whether the vehicle may be another, somewhere else.
    pub(super) const fn reboots(&self) -> bool {
        matches!(self, Self::Reboot | Self::ClockSetBack)
    }

    /// Whether remembered times mean nothing.
    pub(super) const fn sets_clock_back(&self) -> bool {
        matches!(self, Self::ClockSetBack)
    }
}
