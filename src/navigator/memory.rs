//! What a navigator knows, to be kept beside it and gone on with by another: a process that was restarted in an outage.
//!
//! [`Navigator::snapshot`] gives what is known, [`Navigator::resume`] goes on from it: as after a hole in the stream, for nothing else has
//! happened. The first IMU sample ends the hole, and the doubt that it leaves is the hole's (see `estimator::hole`).
//! [`Navigator::recall`] takes no more than what was learned of the sensors.

use nalgebra::Vector3;
use serde::{Deserialize, Serialize};

use crate::altimeter::AltimeterMemory;
use crate::camera::CalibrationMemory;
use crate::filter::error_state::EskfMemory;
use crate::geo::{Body, Geodetic};
use crate::sample::ImuSample;
use crate::time::AutopilotTime;

use super::Navigator;
use super::event::{EventKind, TransitionReason};
use super::judge::Charge;
use super::solution::Mode;
use crate::navigator::tuning::memory::{LARGEST_OFFSET_M, MOST_GAP_S};
use crate::navigator::tuning::shadow::ANOTHER_FLIGHT_LOG2;

/// Everything that a navigator goes on from. Units are SI, frames those of the local frame at `origin`.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Snapshot {
    /// When it was so, µs of the autopilot's clock.
    pub time_us: i64,
    /// The mode.
    pub mode: Mode,
    /// Latitude and longitude, rad, and height above mean sea level, m, of the local frame's origin.
    pub origin: [f64; 3],
    /// For the magnetic field.
    pub decimal_year: f64,
    /// The newest angular rate, rad/s, and specific force, m/s², body.
    pub imu: [[f64; 3]; 2],
    /// The filter.
    pub filter: EskfMemory,
    /// The heading was found from motion.
    pub by_motion: bool,
    /// The altimeter, where it has a height.
    pub height: Option<AltimeterMemory>,
    /// What is published beside what is estimated.
    pub published: PublishedMemory,
    /// What was learned of the sensors.
    pub sensors: SensorsMemory,
    /// The vehicle has flown while it said that it was disarmed.
    pub flew_disarmed: bool,
    /// Without GNSS: for how long, s, what the trace of the position's covariance was, m², and what of that has grown while flow, air and inertia carried.
    #[serde(default)]
    pub growth: [f64; 5],
}

/// Published less estimated, and how often it jumped.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct PublishedMemory {
    /// Position, NED, m.
    pub offset_ned: [f64; 3],
    /// Height that still glides and that is still smoothed, m.
    pub height_m: [f64; 2],
    /// The reset counter.
    pub reset_counter: u8,
}

/// What was learned of the sensors.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct SensorsMemory {
    /// The GNSS receiver.
    pub receiver: ReceiverMemory,
    /// The flow sensors, in the order in which they were first heard.
    pub flow: Vec<FlowMemory>,
    /// The barometers' numbers, by their place.
    pub barometers: [Option<u8>; 2],
    /// The rangefinder that measures, and where it has seen the ground, m above the origin.
    pub ground: Option<(u8, f64)>,
    /// Where it took off: height, m, and position, NE, m, where that is known.
    pub takeoff: Option<[f64; 3]>,
    /// Motion has contradicted the magnetometer.
    pub compass_wrong: bool,
    /// Mean square of what is wrong with the drag for some time, m²/s⁴.
    pub drag_spread: f64,
    /// By what the drift exceeds what is claimed.
    #[serde(default)]
    pub drift: DriftMemory,
}

/// By what the drift exceeds what is claimed, at each horizon of the shadows: log₂ of the factor and its standard deviation; `None` where it was not
/// measured.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct DriftMemory {
    /// While flow carried.
    pub flow: [Option<[f64; 2]>; 4],
    /// Airspeed or drag.
    pub air: [Option<[f64; 2]>; 4],
    /// Nothing.
    pub inertial: [Option<[f64; 2]>; 4],
}

/// A GNSS receiver.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct ReceiverMemory {
    /// Its number.
    pub receiver: u8,
    /// Horizontal standard deviation that it claims, m.
    pub sigma_m: f64,
    /// Its latency and the standard deviation of that, s.
    pub latency_s: [f64; 2],
}

/// A flow sensor.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct FlowMemory {
    /// Its number.
    pub id: u8,
    /// Bias, scale and misalignment.
    pub calibration: CalibrationMemory,
    /// Its latency and the standard deviation of that, s.
    pub latency_s: [f64; 2],
}

/// Why a navigator does not go on from what was kept.
#[derive(Clone, Copy, Debug, PartialEq, thiserror::Error)]
pub enum ResumeError {
    /// It navigates already.
    #[error("navigating already")]
    Navigating,
    /// What was kept was not navigating.
    #[error("nothing was known yet")]
    NothingKnown,
    /// It is from after the present.
    #[error("it is from later than now")]
    FromTheFuture,
    /// So old that a vehicle may be anywhere, s.
    #[error("it is {0:.0} s old")]
    TooOld(f64),
    /// It has no value that a vehicle or a sensor has: which part.
    #[error("its {0} is impossible")]
    Impossible(&'static str),
}

impl Snapshot {
    fn origin(&self) -> Option<Geodetic> {
        let [latitude_rad, longitude_rad, height_m] = self.origin;
        let origin = Geodetic { latitude_rad, longitude_rad, height_m };
        origin.is_plausible().then_some(origin)
    }

    fn last_imu(&self, time: AutopilotTime) -> ImuSample {
        let [rate, force] = self.imu.map(|v| Body::new(Vector3::from(v)));
        ImuSample { time, angular_rate: rate, specific_force: force }
    }

    /// What needs no part of a navigator to be judged.
    fn check(&self) -> Result<(), ResumeError> {
        let near = |values: &[f64]| values.iter().all(|v| v.abs() <= LARGEST_OFFSET_M);
        let ground = self.sensors.ground.is_none_or(|(_, ground_m)| near(&[ground_m]))
            && self.sensors.takeoff.is_none_or(|place| near(&place));
        if self.mode == Mode::Aligning {
            Err(ResumeError::NothingKnown)
        } else if !self.imu.as_flattened().iter().all(|v| v.abs() < 200.0) {
            Err(ResumeError::Impossible("IMU"))
        } else if !near(&self.published.offset_ned) || !near(&self.published.height_m) {
            Err(ResumeError::Impossible("published position"))
        } else if !ground {
            Err(ResumeError::Impossible("ground"))
        } else if !(1900.0..2200.0).contains(&self.decimal_year) {
            Err(ResumeError::Impossible("date"))
        } else {
            Ok(())
        }
    }
}

/// What `navigator` knows. `None` while it aligns, while its attitude is found again after a hole, where no filter runs, and in a frame whose
/// place on Earth nobody has told.
pub(super) fn snapshot(navigator: &Navigator) -> Option<Snapshot> {
    let (core, sources) = (&navigator.core, &navigator.sources);
    let last = core.stream.last().filter(|_| core.mode != Mode::Aligning)?;
    let origin = core.surroundings.environment().filter(|e| e.placed)?.frame.origin();
    let (offset_ned, height_m, reset_counter) = core.published.memory();
    let (drift, growth) = core.estimator.drift_memory();
    Some(Snapshot {
        time_us: last.time.micros(),
        mode: core.mode,
        origin: [origin.latitude_rad, origin.longitude_rad, origin.height_m],
        decimal_year: core.surroundings.decimal_year(),
        imu: [last.angular_rate.raw().into(), last.specific_force.raw().into()],
        filter: core.estimator.memory()?,
        by_motion: core.estimator.by_motion(),
        height: core.height.memory(),
        published: PublishedMemory { offset_ned, height_m, reset_counter },
        sensors: SensorsMemory {
            receiver: sources.gnss.memory(),
            flow: sources.flow.memory(),
            barometers: sources.barometer.sensors(),
            ground: sources.rangefinders.ground(),
            takeoff: sources.takeoff.memory(),
            compass_wrong: sources.magnetometer.contradicted().is_some(),
            drag_spread: sources.drag.spread(),
            drift,
        },
        flew_disarmed: core.vehicle.flew_disarmed(),
        growth,
    })
}

/// `navigator`, which has not navigated yet, goes on from what was kept; `now` is the time of the first IMU sample, which is still to come.
/// It is on the clock of the snapshot.
///
/// # Errors
/// [`ResumeError`]: then nothing has changed.
pub(super) fn resume(
    navigator: &mut Navigator,
    kept: &Snapshot,
    now: AutopilotTime,
) -> Result<(), ResumeError> {
    let then = AutopilotTime::from_micros(kept.time_us);
    let gap_s = now.seconds_since(then);
    if navigator.core.mode != Mode::Aligning {
        return Err(ResumeError::Navigating);
    }
    if gap_s <= 0.0 {
        return Err(ResumeError::FromTheFuture);
    }
    if gap_s > MOST_GAP_S {
        return Err(ResumeError::TooOld(gap_s));
    }
    kept.check()?;
    let origin = kept.origin().ok_or(ResumeError::Impossible("origin"))?;
    let mut going_on = navigator.clone();
    restore(&mut going_on, kept, then, origin)?;
    let told = navigator.core.surroundings.environment().map(|e| e.frame.origin());
    *navigator = going_on;
    navigator.core.events.tell(now, EventKind::Resumed(gap_s));
    let to = if kept.mode == Mode::Lost { Mode::Lost } else { Mode::Holdover };
    navigator.core.change_mode(now, to, TransitionReason::Restarted);
    // The autopilot may have told where its frame begins before.
    if let Some(told) = told {
        navigator.set_origin(now, told);
    }
    Ok(())
}

/// Every component knows what it knew.
fn restore(
    navigator: &mut Navigator,
    kept: &Snapshot,
    then: AutopilotTime,
    origin: Geodetic,
) -> Result<(), ResumeError> {
    let core = &mut navigator.core;
    core.surroundings.set_date(kept.decimal_year);
    core.surroundings.settle(origin);
    if let Some(environment) = core.surroundings.environment() {
        core.estimator.observer_mut().settle(environment);
    }
    if !core.estimator.remember(then, &kept.filter, &core.settings) {
        return Err(ResumeError::Impossible("filter"));
    }
    if !core.estimator.recall_growth(kept.growth) {
        return Err(ResumeError::Impossible("growth"));
    }
    if kept.by_motion {
        core.estimator.lead_by_motion();
    }
    if let Some(height) = &kept.height
        && !core.height.remember(height)
    {
        return Err(ResumeError::Impossible("height"));
    }
    let PublishedMemory { offset_ned, height_m, reset_counter } = kept.published;
    core.published.recall((offset_ned, height_m, reset_counter));
    core.vehicle.recall(kept.flew_disarmed);
    core.stream.recall(kept.last_imu(then));
    core.outage.begin();
    navigator.sources.barometer.recall(kept.sensors.barometers, then);
    if let Some(ground) = kept.sensors.ground {
        navigator.sources.rangefinders.recall(ground);
    }
    navigator.sources.takeoff.recall(kept.sensors.takeoff);
    if kept.sensors.compass_wrong {
        navigator.sources.magnetometer.contradict(Charge::ContradictsMotion);
    }
    recall(navigator, &kept.sensors)
}

/// The sensors are what they were; where they are on another flight, that has to be confirmed ([`SensorsMemory::to_be_confirmed`]).
pub(super) fn recall(navigator: &mut Navigator, kept: &SensorsMemory) -> Result<(), ResumeError> {
    let (settings, sources) = (&navigator.core.settings, &mut navigator.sources);
    let sound = |f: &FlowMemory| f.calibration.calibration(settings.flow.calibration).is_some();
    if !kept.flow.iter().all(sound) {
        return Err(ResumeError::Impossible("flow"));
    }
    if !sources.gnss.recall(&kept.receiver) {
        return Err(ResumeError::Impossible("receiver"));
    }
    sources.flow.recall(&kept.flow, &settings.flow);
    sources.drag.recall(kept.drag_spread);
    navigator.core.estimator.recall_drift(&kept.drift);
    Ok(())
}

impl DriftMemory {
    /// The same for another flight: with another load, in another wind.
    fn to_be_confirmed(&self) -> Self {
        let wider = |of: [Option<[f64; 2]>; 4]| {
            of.map(|h| h.map(|[log2, sigma]| [log2, sigma.hypot(ANOTHER_FLIGHT_LOG2)]))
        };
        Self { flow: wider(self.flow), air: wider(self.air), inertial: wider(self.inertial) }
    }
}

impl SensorsMemory {
    /// The same for another flight of the same vehicle: a flow sensor has to be compared with GNSS again before it is believed.
    pub fn to_be_confirmed(&self) -> Self {
        let confirm =
            |f: &FlowMemory| FlowMemory { calibration: f.calibration.to_be_confirmed(), ..f.clone() };
        let drift = self.drift.to_be_confirmed();
        Self { flow: self.flow.iter().map(confirm).collect(), drift, ..self.clone() }
    }
}
