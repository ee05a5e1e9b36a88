//! The navigation's state in a file: kept every second, and gone on from once when a process begins.

use std::path::PathBuf;

use crate::outbound::alignment::AlignmentMemory;
use crate::pipeline::Pipeline;
use crate::state::{KeptState, Moment, StateError, StateFile, go_on, read, served_lately};
use crate::time::{AutopilotTime, Companion, Span, Stamp};
use crate::wire::frame::SystemId;
use crate::wire::session::identity::Vehicle;

/// Time between two states.
const PERIOD: Span = Span::from_millis(1000);

/// See the module's documentation.
#[derive(Debug, Default)]
pub(super) struct Keeping {
    folder: Option<PathBuf>,
    /// It was looked into.
    looked: bool,
    /// Since the vehicle is known.
    file: Option<StateFile>,
    /// What a process before has kept, until the first IMU sample says how long ago that was.
    kept: Option<Box<KeptState>>,
    due: Option<Stamp<Companion>>,
    /// The time of the newest state that was kept, µs.
    newest_us: Option<i64>,
}

impl Keeping {
    /// Keeps states in this folder, where there is one.
    pub(super) fn new(folder: Option<PathBuf>) -> Self {
        Self { folder, ..Self::default() }
    }

    /// The system of whom a state was kept a moment before `unix_us`.
    pub(super) fn served_lately(&self, unix_us: i64) -> Option<SystemId> {
        served_lately(self.folder.as_deref()?, unix_us)
    }

    /// Another vehicle is served.
    pub(super) fn begin_anew(&mut self) {
        *self = Self::new(self.folder.take());
    }

    /// The vehicle is known: looks for what was kept of it. A sentence where there is something that cannot be gone on from.
    pub(super) fn found(&mut self, vehicle: &Vehicle) -> Option<String> {
        let folder = self.folder.clone().filter(|_| !std::mem::replace(&mut self.looked, true))?;
        let kept = read(&folder, vehicle.system).and_then(|kept| kept.is_of(vehicle).map(|()| kept));
        match StateFile::open(folder, vehicle.system) {
            Ok(file) => self.file = Some(file),
            Err(e) => tracing::warn!("the state cannot be kept: {e}"),
        }
        match kept {
            Ok(kept) => {
                self.kept = Some(Box::new(kept));
                None
            }
            Err(StateError::None) => None,
            Err(e) => Some(format!("state not used: {e}")),
        }
    }

    /// What was kept that the first IMU sample decides about.
    pub(super) fn waiting(&self) -> Option<&KeptState> {
        self.kept.as_deref()
    }

    /// The first IMU sample of this process is about to be taken. A sentence where the state of before is not gone on from; the navigator
    /// tells of itself where it is.
    pub(super) fn resume(
        &mut self,
        pipeline: &mut Pipeline,
        moment: &Moment<'_>,
        first: AutopilotTime,
    ) -> Option<String> {
        let kept = self.kept.take()?;
        go_on(&kept, (&mut pipeline.navigator, &mut pipeline.outbound), moment, first)
    }

    /// Keeps the state when it is time, or at once.
    pub(super) fn keep(
        &mut self,
        now: Stamp<Companion>,
        pipeline: &Pipeline,
        vehicle: Option<&Vehicle>,
        moment: &Moment<'_>,
    ) {
        let (Some(file), Some(vehicle)) = (&self.file, vehicle) else { return };
        if self.due.is_some_and(|due| now < due) {
            return;
        }
        self.due = Some(now + PERIOD);
        let Some(snapshot) = pipeline.navigator.snapshot() else { return };
        // Of a stream that has stopped the last state is kept, with the time of day that it was of. That is known to a tick.
        if self.newest_us.replace(snapshot.time_us) == Some(snapshot.time_us) {
            return;
        }
        let boot = moment.boot(AutopilotTime::from_micros(snapshot.time_us));
        let alignment: AlignmentMemory = pipeline.outbound.alignment().memory();
        file.keep(KeptState::new(vehicle, boot, alignment, snapshot));
    }

    /// The process ends: what is known last is kept.
    pub(super) fn end(
        &mut self,
        now: Stamp<Companion>,
        pipeline: &Pipeline,
        vehicle: Option<&Vehicle>,
        moment: &Moment<'_>,
    ) {
        self.due = None;
        self.keep(now, pipeline, vehicle, moment);
        self.file = None;
    }
}
