//! Where the vehicle took off: the ground, for a vehicle that has no rangefinder to see it.
//!
//! While it stands disarmed the height of the ground is its own. In the air the ground is believed to be there still, with the doubt that
//! terrain leaves: σ² = σ₀² + (k s)² at the distance s from the place, for ground that is no runway.

use nalgebra::Vector2;

use super::super::context::Context;
use super::super::reset::Reset;
use crate::navigator::tuning::takeoff::{GROUND_SIGMA_M, TERRAIN_SLOPE};

/// Height of the ground above the origin, and its standard deviation, m.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(in super::super) struct Ground {
    pub(in super::super) height_m: f64,
    pub(in super::super) sigma_m: f64,
}

/// See the module's documentation.
#[derive(Clone, Copy, Debug, Default)]
pub(in super::super) struct TakeoffPlace {
    /// Height, m, and position, NE, m, where it stood last.
    stood: Option<(f64, Vector2<f64>)>,
}

impl TakeoffPlace {
    /// Takes note of where the vehicle stands, while it does.
    pub(in super::super) fn look(&mut self, standing: bool, context: &Context<'_>) {
        let core = context.core;
        if let Some(height_m) = core.height.height_m().filter(|_| standing) {
            let position = core.estimator.estimate().map_or(Vector2::zeros(), |(p, _)| p.xy());
            self.stood = Some((height_m, position));
        }
    }

    /// Height, m, and position, NE, m, of the place.
    pub(in super::super) fn memory(&self) -> Option<[f64; 3]> {
        self.stood.map(|(height_m, place)| [height_m, place.x, place.y])
    }

    /// It is where it was.
    pub(in super::super) fn recall(&mut self, place: Option<[f64; 3]>) {
        self.stood = place.map(|[height_m, north, east]| (height_m, Vector2::new(north, east)));
    }

    /// The ground below a vehicle at `position_ne`, m.
    pub(super) fn ground(&self, position_ne: &Vector2<f64>) -> Option<Ground> {
        self.stood.map(|(height_m, place)| {
            let terrain = TERRAIN_SLOPE * (position_ne - place).norm();
            Ground { height_m, sigma_m: GROUND_SIGMA_M.hypot(terrain) }
        })
    }

    pub(super) fn reset(&mut self, reset: &Reset) {
        match reset {
            Reset::OriginMoved(moved) => {
                self.stood = self.stood.map(|(height, place)| (height + moved.z, place - moved.xy()));
            }
            Reset::Reboot | Reset::ClockSetBack => *self = Self::default(),
            Reset::Relocated | Reset::Bridged | Reset::StreamBroken => {}
        }
    }
}
