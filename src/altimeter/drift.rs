//! Slow drift: what no onset has.
//!
//! A height that runs away slowly takes the joint filter along, and the barometer's offset takes the difference. So the offset is held
//! against what it may be by its own model, D²/var, a test over all of the time: beyond it the difference is charged to the barometer,
//! for weather and warming are what drifts, and the offset is let go. Between two channels nothing tells a slow drift of the other from
//! it: that is a choice, and the height follows GNSS then.

use super::fault::{Change, Fault};
use super::fault_tolerant::Altimeter;
use super::joint::Channel;
use super::tuning::{DRIFTED, LOOSE, UNDRIFTED};

/// What the barometer's offset is held against.
#[derive(Clone, Copy, Debug)]
pub(super) struct OffsetReference {
    /// Its value, m, and how well that was known, m².
    value_m: f64,
    variance: f64,
    since_s: f64,
}

/// The test's state.
#[derive(Clone, Copy, Debug, Default)]
pub(super) struct Drift {
    reference: Option<OffsetReference>,
    /// Since when the barometer is charged with the difference, s.
    pub(super) since_s: Option<f64>,
    /// When it was last looked at, s.
    looked_s: f64,
}

impl Altimeter {
    /// Difference of the barometer's offset to what it should be, m, and the variance that it may have, by its model and by what is known
    /// of it, m².
    pub(super) fn offset_difference(&self) -> Option<(f64, f64)> {
        let reference = self.drift.reference?;
        let model = &self.settings.channels[Channel::Baro.index()].offset;
        let variance = if model.rate > 0.0 {
            model.sigma_m * model.sigma_m
        } else {
            reference.variance + model.walk * model.walk * (self.clock_s - reference.since_s)
        };
        let o = Channel::Baro.offset();
        Some((self.joint.x[o] - reference.value_m, variance + self.joint.p[(o, o)]))
    }

    /// The origin moved: so did what offsets are held against.
    pub(super) fn shift_offset_reference(&mut self, up_m: f64) {
        if let Some(reference) = &mut self.drift.reference {
            reference.value_m += up_m;
        }
    }

    /// The barometer's offset may have walked by `variance` m² beyond its model, and so it is not held to that.
    pub(super) fn loosen_offset_reference(&mut self, variance: f64) {
        if let Some(reference) = &mut self.drift.reference {
            reference.variance += variance;
        }
    }

    /// Looks whether the barometer's offset is still what it may be.
    pub(super) fn look_for_drift(&mut self) {
        let elapsed = self.clock_s - std::mem::replace(&mut self.drift.looked_s, self.clock_s);
        let settled = |c: Channel| self.channels[c.index()].settled;
        if self.drift.reference.is_none() && settled(Channel::Baro) && settled(Channel::Gnss) {
            let (o, model) = (Channel::Baro.offset(), &self.settings.channels[Channel::Baro.index()].offset);
            let value_m = if model.rate > 0.0 { 0.0 } else { self.joint.x[o] };
            self.drift.reference =
                Some(OffsetReference { value_m, variance: self.joint.p[(o, o)], since_s: self.clock_s });
        }
        let Some((difference, variance)) = self.offset_difference() else { return };
        let odds = 0.5 * difference * difference / variance;
        if self.drift.since_s.is_some() {
            let walk = self.settings.channels[Channel::Baro.index()].offset.walk;
            // That is no model of what it may be: the reference stays.
            let o = Channel::Baro.offset();
            self.joint.p[(o, o)] += (LOOSE * walk).powi(2) * elapsed;
            if odds < UNDRIFTED {
                self.drift.since_s = None;
                if !self.health(Channel::Baro).is_faulty() {
                    self.tell(Change::Healed(Channel::Baro));
                }
            }
        } else if odds > DRIFTED && !self.health(Channel::Baro).is_faulty() {
            self.drift.since_s = Some(self.clock_s);
            self.tell(Change::Faulty {
                channel: Channel::Baro,
                fault: Fault::Drift { size_m: difference },
                for_s: 0.0,
            });
        }
    }
}
