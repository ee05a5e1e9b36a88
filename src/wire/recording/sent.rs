//! Whether a flight that is flown again says what was said.

use std::collections::VecDeque;

use mavlink::dialects::ardupilotmega::MavMessage;
use serde::Serialize;

use crate::outbound::message::OutboundMessage;
use crate::wire::clock::AutopilotClock;
use crate::wire::encode::encode;
use crate::wire::frame::{ComponentId, Frame, SystemId};
use crate::wire::frame_bytes::FrameBytes;
use crate::wire::session::Address;
use crate::wire::session::outgoing::FrameWriter;

/// Positions that may wait for their like: more than any that are sent on one sample.
const WAITING: usize = 256;

/// How what is sent now compares with what was sent then.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize)]
pub struct SentReport {
    /// Positions and velocities that were sent.
    pub sent: u64,
    /// Of them, those that are sent again with the same bytes …
    pub same: u64,
    /// … and those of the same time that say something else.
    pub different: u64,
    /// How far the positions of those lie apart at most, m.
    pub apart_m: f64,
}

/// Compares them.
#[derive(Clone, Debug)]
pub struct SentAgain {
    writer: FrameWriter,
    waiting: VecDeque<FrameBytes>,
    report: SentReport,
}

impl SentAgain {
    /// Nothing was sent yet.
    pub fn new() -> Self {
        let from = Address { system: SystemId(1), component: ComponentId::ODOMETRY_SOURCE };
        Self { writer: FrameWriter::new(from), waiting: VecDeque::new(), report: SentReport::default() }
    }

    /// This is sent now.
    pub fn again(&mut self, message: &OutboundMessage, clock: &AutopilotClock) {
        let frame = encode(message, clock).and_then(|encoded| self.writer.write(&encoded));
        let Some(frame) = frame else { return };
        if self.waiting.len() == WAITING {
            self.waiting.pop_front();
        }
        self.waiting.push_back(frame);
    }

    /// This was sent then, after the samples that it stands on were heard.
    pub fn then(&mut self, frame: &Frame<'_>) {
        let Some((time_us, position)) = position_of(frame) else { return };
        self.report.sent += 1;
        let same = |f: &FrameBytes| {
            f.frame().is_some_and(|f| (f.message_id(), f.payload()) == (frame.message_id(), frame.payload()))
        };
        if let Some(at) = self.waiting.iter().position(same) {
            // What stands before it was withheld then.
            self.waiting.drain(..=at);
            self.report.same += 1;
            return;
        }
        let now = self.waiting.iter().filter_map(FrameBytes::frame);
        let mut of_then =
            now.filter(|f| f.message_id() == frame.message_id()).filter_map(|f| position_of(&f));
        if let Some((_, now)) = of_then.rfind(|(time, _)| *time == time_us) {
            self.report.different += 1;
            let apart = position.iter().zip(now).map(|(a, b)| f64::from(a - b).powi(2)).sum::<f64>().sqrt();
            self.report.apart_m = self.report.apart_m.max(apart);
        }
    }

    /// How they compare so far.
    pub fn report(&self) -> SentReport {
        self.report
    }
}

impl Default for SentAgain {
    fn default() -> Self {
        Self::new()
    }
}

/// Time, µs, and position, m, of a position; a velocity is told with none.
fn position_of(frame: &Frame<'_>) -> Option<(u64, [f32; 3])> {
    match frame.parse().ok()? {
        MavMessage::ODOMETRY(m) => Some((m.time_usec, [m.x, m.y, m.z])),
        MavMessage::VISION_POSITION_ESTIMATE(m) => Some((m.usec, [m.x, m.y, m.z])),
        MavMessage::VISION_SPEED_ESTIMATE(m) => Some((m.usec, [0.0; 3])),
        _ => None,
    }
}
