//! The daemon's part of a recording: what is handed over beside the frames, so that they fly again as they were flown.

use crate::outbound::handover::StandsOn;
use crate::record::{LinkRecorder, RecordCounts, RecordNews};
use crate::state::KeptState;
use crate::time::{Companion, Stamp};
use crate::wire::frame::Frame;
use crate::wire::recording::{HeardAs, Mark};
use crate::wire::session::identity::Vehicle;
use crate::wire::session::transmitter::Transmitter;

/// See the module's documentation. Without a recorder nothing happens.
#[derive(Debug, Default)]
pub(super) struct Recording {
    recorder: Option<LinkRecorder>,
    standing: StandsOn,
}

impl Recording {
    /// Into this recorder; GNSS is withheld in the intervals `drills`, s since the first sample.
    pub(super) fn new(
        mut recorder: Option<LinkRecorder>,
        now: Stamp<Companion>,
        drills: &[(f64, f64)],
    ) -> Self {
        if let Some(recorder) = &mut recorder {
            for &(from_s, to_s) in drills {
                recorder.holds(now, Mark::Drill { from_s, to_s });
            }
        }
        Self { recorder, standing: StandsOn::default() }
    }

    /// Whether there is one.
    pub(super) fn is_on(&self) -> bool {
        self.recorder.is_some()
    }

    /// A frame that was heard is taken at `now`.
    pub(super) fn heard(&mut self, now: Stamp<Companion>, how: HeardAs, frame: &Frame<'_>) {
        if let Some(recorder) = &mut self.recorder {
            recorder.heard(now, how, frame);
        }
    }

    /// What was sent.
    pub(super) fn sent(&mut self, now: Stamp<Companion>, by: &mut Transmitter) {
        if let Some(recorder) = &mut self.recorder {
            by.take_sent().for_each(|frame| recorder.sent(now, &frame));
        }
    }

    /// A vehicle is followed; `anew` instead of another. It may be gone on from `kept` at its first IMU sample.
    pub(super) fn follows(
        &mut self,
        now: Stamp<Companion>,
        vehicle: &Vehicle,
        anew: bool,
        kept: Option<&KeptState>,
    ) {
        let Some(recorder) = &mut self.recorder else { return };
        recorder.follows(now, vehicle, anew);
        if let Some(state) = kept.and_then(|kept| kept.encode().ok()) {
            recorder.kept(now, &state);
        }
    }

    /// What the autopilot is known to stand on.
    pub(super) fn stands(&mut self, now: Stamp<Companion>, on: StandsOn) {
        if let Some(recorder) = &mut self.recorder
            && std::mem::replace(&mut self.standing, on) != on
        {
            recorder.holds(now, Mark::Stands(on));
        }
    }

    /// Time passes. What is to be told.
    pub(super) fn poll(&mut self, now: Stamp<Companion>) -> Option<RecordNews> {
        let recorder = self.recorder.as_mut()?;
        recorder.poll(now);
        recorder.news()
    }

    /// How it fares.
    pub(super) fn counts(&self) -> Option<RecordCounts> {
        self.recorder.as_ref().map(LinkRecorder::counts)
    }
}
