//! What comes of the vehicle's sensors, and how often.

use std::collections::BTreeMap;

use crate::preflight::recent_rate::RecentRate;
use crate::sample::{Airframe, Input, RangeDirection, Sample, SampleKind};
use crate::time::{Companion, Stamp};

/// Samples as they arrive, by kind and sensor.
#[derive(Clone, Debug, Default)]
pub(super) struct Arrivals {
    rates: BTreeMap<(SampleKind, u8), RecentRate>,
    gnss_fix: bool,
    airframe: Option<Airframe>,
}

impl Arrivals {
    /// Takes note of what a frame that came at `at` told.
    pub(super) fn note(&mut self, input: &Input, at: Stamp<Companion>) {
        match input {
            Input::Status(status) => self.airframe = status.airframe,
            Input::Sample(sample) => {
                if let Sample::Gnss(fix) = sample {
                    self.gnss_fix = fix.position.is_some();
                }
                if let Some(unit) = sensor_unit(sample) {
                    self.rates.entry((sample.kind(), unit)).or_default().note(at);
                }
            }
            Input::Reference(_) | Input::Origin(_) | Input::Clock(_) => {}
        }
    }

    /// Whether the newest GNSS message held a position.
    pub(super) fn gnss_fix(&self) -> bool {
        self.gnss_fix
    }

    /// What the vehicle can be expected to do.
    pub(super) fn airframe(&self) -> Option<Airframe> {
        self.airframe
    }

    /// The rate of the fastest sensor of each kind, Hz.
    pub(super) fn rates_hz(&self, now: Stamp<Companion>) -> [f64; SampleKind::ALL.len()] {
        let mut rates = [0.0f64; SampleKind::ALL.len()];
        for ((kind, _), recent) in &self.rates {
            let rate = &mut rates[*kind as usize];
            *rate = rate.max(recent.hz(now));
        }
        rates
    }
}

/// Which of several sensors of its kind tells this; `None` for one that says nothing of height: a rangefinder that does not look down.
pub fn sensor_unit(sample: &Sample) -> Option<u8> {
    Some(match sample {
        Sample::Imu(_) | Sample::Airspeed(_) => 0,
        Sample::Mag(s) => s.sensor,
        Sample::Gnss(s) => s.receiver,
        Sample::Pressure(s) => s.sensor,
        Sample::Flow(s) => s.sensor,
        Sample::Range(s) if s.direction != RangeDirection::Down => return None,
        Sample::Range(s) => s.sensor,
        Sample::Landmark(s) => s.camera,
    })
}
