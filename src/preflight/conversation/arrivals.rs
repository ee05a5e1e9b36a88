//! What comes of the vehicle's sensors, and how often.

use std::collections::{BTreeMap, VecDeque};

use crate::sample::{Airframe, Input, RangeDirection, Sample, SampleKind};
use crate::time::{Companion, Span, Stamp};

/// Rates are those of the last so long.
const WINDOW: Span = Span::from_millis(4000);

/// Samples as they arrive, by kind and sensor.
#[derive(Clone, Debug, Default)]
pub(super) struct Arrivals {
    stamps: BTreeMap<(SampleKind, u8), VecDeque<Stamp<Companion>>>,
    gnss_fix: bool,
    airframe: Option<Airframe>,
}

impl Arrivals {
    /// Takes note of what a frame that came at `at` told.
    pub(super) fn note(&mut self, input: &Input, at: Stamp<Companion>) {
        match input {
            Input::Status(status) => self.airframe = status.airframe,
            Input::Sample(sample) => {
                let sensor = match sample {
                    Sample::Imu(_) | Sample::Airspeed(_) => 0,
                    Sample::Mag(s) => s.sensor,
                    Sample::Gnss(s) => {
                        self.gnss_fix = s.position.is_some();
                        s.receiver
                    }
                    Sample::Pressure(s) => s.sensor,
                    Sample::Flow(s) => s.sensor,
                    Sample::Range(s) if s.direction != RangeDirection::Down => return,
                    Sample::Range(s) => s.sensor,
                    Sample::Landmark(s) => s.camera,
                };
                let stamps = self.stamps.entry((sample.kind(), sensor)).or_default();
                stamps.push_back(at);
                while stamps.front().is_some_and(|&first| at - first > WINDOW) {
                    stamps.pop_front();
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
        for ((kind, _), stamps) in &self.stamps {
            let n = stamps.iter().filter(|&&s| now - s <= WINDOW).count();
            let rate = &mut rates[*kind as usize];
            *rate = rate.max(n as f64 / WINDOW.seconds());
        }
        rates
    }
}
