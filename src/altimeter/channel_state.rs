//! What the altimeter remembers of a channel besides its states in the joint filter.

use super::noise_monitor::NoiseMonitor;
use super::tuning::{SETTLED, SETTLING, UNSETTLED};

/// One channel.
#[derive(Clone, Copy, Debug)]
pub(super) struct ChannelState {
    pub(super) started: bool,
    /// What it should read was once known better than a sample tells it. Before, a fault cannot be told from a wrong start.
    pub(super) settled: bool,
    /// Its last innovation was a large one.
    pub(super) far: bool,
    /// Samples so far, while it settles.
    pub(super) settling: u32,
    /// Since when a bias is declared, s.
    pub(super) biased_since_s: Option<f64>,
    /// What the offset was when the bias was declared, m.
    pub(super) offset_before_m: f64,
    pub(super) noise: NoiseMonitor,
    pub(super) heard_s: f64,
    /// Samples in a row that were not used.
    pub(super) refused: u32,
}

impl ChannelState {
    pub(super) fn new() -> Self {
        Self {
            started: false,
            settled: false,
            far: false,
            settling: 0,
            biased_since_s: None,
            offset_before_m: 0.0,
            noise: NoiseMonitor::default(),
            heard_s: f64::NEG_INFINITY,
            refused: 0,
        }
    }

    /// One more sample, of which the prediction had this variance and the sensor has that, m². Whether the channel has settled by now.
    pub(super) fn settle(&mut self, predicted: f64, r: f64) -> bool {
        self.settling = self.settling.saturating_add(1);
        self.settled |= predicted < SETTLED * r || self.settling > SETTLING;
        if predicted > UNSETTLED * r && self.biased_since_s.is_none() {
            (self.settled, self.settling) = (false, 0);
        }
        self.settled
    }
}
