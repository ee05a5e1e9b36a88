//! The altimeter that flies: the fault-tolerant one, or a published one for comparison.

use super::fault::{Change, Health};
use super::fault_tolerant::{Altimeter, HeightVerdict};
use super::joint::{Channel, UnseenClimb};
use super::memory::AltimeterMemory;
use super::published::AltimeterMethod;
use super::published::BaselineAltimeter;
use super::published::ErrorModel;
use super::settings::AltimeterSettings;

/// Which altimeter.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[non_exhaustive]
pub enum AltimeterKind {
    /// The fault-tolerant one.
    FaultTolerant,
    /// A published one, IBIG, with the parameters of [`ErrorModel::recorded`].
    Published(AltimeterMethod),
}

/// Either altimeter, as the navigator uses it. Heights are above the origin, up.
#[derive(Clone, Debug)]
pub enum HeightFilter {
    /// The fault-tolerant one.
    FaultTolerant(Box<Altimeter>),
    /// A published one.
    Published(Box<BaselineAltimeter>),
}

macro_rules! either {
    ($self:ident, $f:ident => $call:expr) => {
        match $self {
            HeightFilter::FaultTolerant($f) => $call,
            HeightFilter::Published($f) => $call,
        }
    };
}

impl HeightFilter {
    /// An altimeter that waits for its first height.
    pub fn new(kind: AltimeterKind, settings: AltimeterSettings) -> Self {
        match kind {
            AltimeterKind::FaultTolerant => Self::FaultTolerant(Box::new(Altimeter::new(settings))),
            AltimeterKind::Published(method) => {
                Self::Published(Box::new(BaselineAltimeter::new(ErrorModel::recorded(), method)))
            }
        }
    }

    /// Height above the origin, m, once a source has given it.
    pub fn height_m(&self) -> Option<f64> {
        either!(self, f => f.height_m())
    }

    /// Climb rate, m/s.
    pub fn climb_mps(&self) -> f64 {
        either!(self, f => f.climb_mps())
    }

    /// Standard deviation of the height, m.
    pub fn height_sigma_m(&self) -> f64 {
        either!(self, f => f.height_sigma_m())
    }

    /// Standard deviation of the climb rate, m/s.
    pub fn climb_sigma_mps(&self) -> f64 {
        either!(self, f => f.climb_sigma_mps())
    }

    /// The origin has moved up by `up_m`: heights above it become smaller.
    pub fn shift_origin(&mut self, up_m: f64) {
        either!(self, f => f.shift_origin(up_m));
    }

    /// Predicts over `dt` seconds with the upward acceleration `accel_up` (m/s², gravity taken out).
    /// `noise` is the noise density of that acceleration beyond the settings', m/s²/√Hz; the published altimeters have their own.
    pub fn predict(&mut self, dt: f64, accel_up: f64, noise: f64) {
        match self {
            Self::FaultTolerant(f) => f.predict(dt, accel_up, noise),
            Self::Published(f) => f.predict(dt, accel_up),
        }
    }

    /// See [`Altimeter::blind`]; the published altimeters fly straight on.
    pub fn blind(&mut self, gap_s: f64, climb: &UnseenClimb) {
        match self {
            Self::FaultTolerant(f) => f.blind(gap_s, climb),
            Self::Published(f) => f.predict(gap_s, 0.0),
        }
    }

    /// See [`Altimeter::doubt`]; the published altimeters doubt nothing.
    pub fn doubt(&mut self, climb_mps: f64, for_s: f64) {
        if let Self::FaultTolerant(f) = self {
            f.doubt(climb_mps, for_s);
        }
    }

    /// A channel's height, m, measured `age_s` ago, with the standard deviation that the sensor claims, if it does. `None` when this
    /// altimeter has no use for the channel.
    pub fn measure(
        &mut self,
        channel: Channel,
        height_m: f64,
        claimed_sigma_m: Option<f64>,
        age_s: f64,
    ) -> Option<HeightVerdict> {
        match self {
            Self::FaultTolerant(f) => Some(f.measure(channel, height_m, claimed_sigma_m, age_s)),
            Self::Published(f) => f.measure(channel, height_m, age_s),
        }
    }

    /// What comes on a channel is another sensor's from now on.
    pub fn another(&mut self, channel: Channel) {
        match self {
            Self::FaultTolerant(f) => f.another(channel),
            Self::Published(f) => f.another(channel),
        }
    }

    /// A channel's offset may change faster for now: it walks by `walk` m/√s over `dt` seconds.
    pub fn loosen(&mut self, channel: Channel, walk: f64, dt: f64) {
        if let Self::FaultTolerant(f) = self {
            f.loosen(channel, walk, dt);
        }
    }

    /// What a channel's health is; the published altimeters do not say.
    pub fn health(&self, channel: Channel) -> Health {
        match self {
            Self::FaultTolerant(f) => f.health(channel),
            Self::Published(_) => Health::Unheard,
        }
    }

    /// How far a channel's height, m, lies from what is expected of it, in standard deviations, without using it; the published
    /// altimeters do not say.
    pub fn disagreement(&self, channel: Channel, height_m: f64, sigma_m: f64) -> Option<f64> {
        match self {
            Self::FaultTolerant(f) => f.disagreement(channel, height_m, sigma_m),
            Self::Published(_) => None,
        }
    }

    /// What a channel's height is off by as a rule, m, and for how long it has been silent, s; the published altimeters do not say.
    pub fn standing(&self, channel: Channel) -> Option<(f64, f64)> {
        match self {
            Self::FaultTolerant(f) => f.offset_m(channel).map(|offset| (offset, f.quiet_s(channel))),
            Self::Published(_) => None,
        }
    }

    /// What is known, to be kept; the published altimeters are not.
    pub fn memory(&self) -> Option<AltimeterMemory> {
        match self {
            Self::FaultTolerant(f) => AltimeterMemory::of(f),
            Self::Published(_) => None,
        }
    }

    /// Knows what was kept. False, and nothing has changed, where that is no height of anything, or this is a published altimeter.
    pub fn remember(&mut self, memory: &AltimeterMemory) -> bool {
        let Self::FaultTolerant(f) = self else { return false };
        let Some(altimeter) = memory.altimeter(f.settings) else { return false };
        **f = altimeter;
        true
    }

    /// The oldest change that was not asked for yet.
    pub fn next_change(&mut self) -> Option<Change> {
        match self {
            Self::FaultTolerant(f) => f.next_change(),
            Self::Published(_) => None,
        }
    }
}
