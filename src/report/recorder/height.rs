//! The height, and what every source of it says.

use super::super::trace::Trace;
use crate::altimeter::Channel;
use crate::navigator::Navigator;
use crate::navigator::solution::{Mode, Solution};
use crate::time::AutopilotTime;

/// What is silent for longer leaves a hole, s.
const HOLE_S: f64 = 3.0;

/// One source of heights: what it tells less what it is off by as a rule, m above the origin.
#[derive(Clone, Debug)]
pub(in super::super) struct ChannelRecord {
    pub(in super::super) channel: Channel,
    pub(in super::super) height_m: Trace,
    /// That less the estimate, m.
    pub(in super::super) apart_m: Trace,
    heard: Option<AutopilotTime>,
}

/// See the module's documentation.
#[derive(Clone, Debug)]
pub(in super::super) struct HeightRecord {
    pub(in super::super) estimate_m: Trace,
    pub(in super::super) sigma_m: Trace,
    pub(in super::super) truth_m: Trace,
    pub(in super::super) autopilot_m: Trace,
    pub(in super::super) channels: [ChannelRecord; 4],
}

impl HeightRecord {
    pub(super) fn new() -> Self {
        Self {
            estimate_m: Trace::new(HOLE_S),
            sigma_m: Trace::new(HOLE_S),
            truth_m: Trace::new(HOLE_S),
            autopilot_m: Trace::new(HOLE_S),
            channels: Channel::ALL.map(|channel| ChannelRecord {
                channel,
                height_m: Trace::new(HOLE_S),
                apart_m: Trace::new(HOLE_S),
                heard: None,
            }),
        }
    }

    pub(super) fn solved(&mut self, t_s: f64, solution: &Solution, navigator: &Navigator) {
        if solution.mode != Mode::Aligning {
            self.estimate_m.add(t_s, -solution.position.raw().z);
            self.sigma_m.add(t_s, solution.position_covariance.raw()[(2, 2)].max(0.0).sqrt());
        }
        for record in &mut self.channels {
            let Some((time, height_m)) = navigator.height_reading(record.channel) else { continue };
            if record.heard.replace(time) == Some(time) {
                continue;
            }
            let offset_m = navigator.height_standing(record.channel).map_or(0.0, |standing| standing.0);
            record.height_m.add(t_s, height_m - offset_m);
            record.apart_m.add(t_s, height_m - offset_m + solution.position.raw().z);
        }
    }

    /// A height of the simulator's truth or of the autopilot's own estimate, m above the origin.
    pub(super) fn reference(&mut self, t_s: f64, height_m: f64, truth: bool) {
        let trace = if truth { &mut self.truth_m } else { &mut self.autopilot_m };
        trace.add(t_s, height_m);
    }
}
