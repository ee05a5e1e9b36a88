//! The navigator: samples in, a solution out. Pure, synchronous, deterministic: the same samples give the same bytes.
//!
//! ```text
//! Sample -> stream / sources::X.observe(&Context) -> Observation
//!                                                       v
//!                                    estimator.fuse -> Fused (scores, correction)
//!                                                       v
//!      StatusBoard (used, rejected and why, NIS, test ratio, health) -> monitor::mode::decide (pure) -> Decision
//!                                                       v
//!              one Reset, given to every component, where something invalidates what is remembered
//!                                                       v
//!                     published (offsets, glides, jumps, reset counter) -> Solution
//! ```
//!
//! While GNSS is trusted, Grip's observer (IMU, GNSS, magnetometer) estimates attitude, gyro bias, position and velocity, the height
//! filter the height, and every flow sensor is compared with GNSS. When the observer has found the attitude it starts the error-state
//! filter, whose estimate is published from then on, and watches it. Without magnetometer and flow a bank of filters finds the heading from
//! motion and starts it, and nothing watches. When GNSS is lost, the filter goes on with flow, or airspeed, rotor drag or standing still, with
//! magnetometer and height, and its covariance grows; beside it Fusini's dead-reckoning observer goes on from Grip's state with the gyro bias
//! frozen, which is what is published where the observers navigate alone (`nlo`), with an error budget.

mod air_judge;
mod context;
mod core;
mod environment;
mod estimator;
pub mod event;
pub mod event_codes;
mod event_log;
mod flow_judge;
mod heading_turn;
mod height;
mod height_wander;
mod inertia;
pub mod judge;
mod landmark_fix;
pub mod memory;
pub mod monitor;
mod observation;
mod published;
mod receivers;
mod relative;
mod reset;
pub mod settings;
pub mod shadow;
pub mod solution;
pub mod sources;
mod step;
mod stream;
mod stream_axes;
mod take;
mod timeline;
mod tuning;
mod uncertainty;
mod vehicle;
pub mod verdict;

use nalgebra::Vector3;

use crate::altimeter::{Channel, Health};
use crate::camera::{Distrust, FlowCalibration};
use crate::filter::error_state::EskfState;
use crate::geo::{Body, BodyToNed, Geodetic, LocalNed, Ned};
use crate::sample::{Sample, VehicleStatus};
use crate::time::AutopilotTime;

use self::core::Core;
use context::Context;
use environment::OriginVerdict;
use event::{Event, EventKind, TransitionReason};
use memory::{ResumeError, SensorsMemory, Snapshot};
use monitor::{GnssFault, GnssState};
use reset::Reset;
use settings::NavigatorSettings;
use shadow::{DriftComparison, MeasuredDrift, TimeBeside};
use solution::{Mode, Solution};
use sources::SourceSet;
use sources::status::{SourceId, SourceReport, StatusBoard};
use tuning::memory::MOST_GAP_S;
use verdict::Verdict;

/// See the module's documentation.
#[derive(Clone, Debug)]
pub struct Navigator {
    core: Core,
    sources: SourceSet,
}

impl Navigator {
    /// A navigator that has heard nothing yet.
    pub fn new(settings: NavigatorSettings) -> Self {
        Self { sources: SourceSet::new(&settings), core: Core::new(settings) }
    }

    /// One with the same settings that has heard nothing.
    pub fn anew(&self) -> Self {
        Self::new(self.core.settings.clone())
    }

    /// Takes one sample, in the order in which samples arrive; late ones are compared with the past they belong to.
    pub fn ingest(&mut self, sample: &Sample) -> Verdict {
        let verdict = match sample {
            Sample::Imu(s) => {
                self.image_waited(s.time);
                self.imu(s)
            }
            Sample::Mag(s) => self.magnetometer(s),
            Sample::Gnss(s) => self.gnss(s),
            Sample::Pressure(s) => self.barometer(s),
            Sample::Flow(s) => self.flow(s),
            Sample::Range(s) => self.rangefinder(s),
            Sample::Airspeed(s) => self.airspeed(s),
            Sample::Landmark(s) => self.landmark(s),
        };
        let source = SourceId::of(sample);
        self.core.statuses.heard(source, sample.time(), verdict);
        judge::repeats(&mut self.core, sample.time(), source, verdict);
        verdict
    }

    /// The autopilot told its origin: the frame's origin moves there. Height is above mean sea level, as everywhere. False when the
    /// origin is no place, or too far away to be one: nothing has changed then.
    pub fn set_origin(&mut self, time: AutopilotTime, origin: Geodetic) -> bool {
        if self.core.surroundings.environment().is_some()
            && !self.core.surroundings.placed()
            && origin.is_plausible()
        {
            relative::put(&mut self.core, time, origin);
            return true;
        }
        let moved = match self.core.surroundings.judge(&origin) {
            OriginVerdict::Implausible => return false,
            OriginVerdict::Known => return true,
            OriginVerdict::First => {
                self.core.estimator.observer_mut().alignment.start(time);
                Vector3::zeros()
            }
            OriginVerdict::Moved(moved) => moved,
        };
        self.core.surroundings.settle(origin);
        self.reset(&Reset::OriginMoved(moved));
        self.core.events.tell(time, EventKind::Origin(moved.norm()));
        true
    }

    /// The autopilot told an origin that would move the frame by so much, m, and its own positions contradict it: it is not used.
    pub fn contradict_origin(&mut self, time: AutopilotTime, moved_m: f64) {
        self.core.events.tell(time, EventKind::OriginContradicted(moved_m));
    }

    /// Sets the date, as decimal year, for the magnetic field.
    pub fn set_date(&mut self, decimal_year: f64) {
        self.core.surroundings.set_date(decimal_year);
    }

    /// What the autopilot says of the vehicle.
    pub fn set_status(&mut self, status: VehicleStatus) {
        self.core.vehicle.says(status);
    }

    /// GNSS is withheld from the navigator (an outage that the operator made): as if the receiver were silent.
    pub fn mask_gnss(&mut self, time: AutopilotTime) {
        self.core.integrity.bad(time, GnssFault::Masked);
    }

    /// The autopilot rebooted: the vehicle stands, nothing else is certain. In an outage there is nothing to begin anew with: what is known is
    /// carried over it as over any hole in the stream, if it is known how long that was and a vehicle does not get far in it. `time` is that of
    /// the first sample after it, `for_s` what it took since the last before, s, where that is known.
    pub fn reboot(&mut self, time: AutopilotTime, for_s: Option<f64>) {
        let short = for_s.is_some_and(|s| s <= MOST_GAP_S);
        let outage = self.core.dead_reckoning() || self.core.mode == Mode::Rejoining;
        if outage && short && self.core.estimator.doubt_gyros() {
            return;
        }
        self.reset(&Reset::Reboot);
        self.core.change_mode(time, Mode::Aligning, TransitionReason::Reboot);
    }

    /// What is known, to be kept and gone on with. `None` while there is nothing to go on from; see [`memory`].
    pub fn snapshot(&self) -> Option<Snapshot> {
        memory::snapshot(self)
    }

    /// Goes on from what was kept, with the doubt that the time since leaves; `now` is the time of the first IMU sample, which is still to be
    /// ingested, on the clock of the snapshot.
    ///
    /// # Errors
    /// [`ResumeError`]: then nothing has changed.
    pub fn resume(&mut self, kept: &Snapshot, now: AutopilotTime) -> Result<(), ResumeError> {
        memory::resume(self, kept, now)
    }

    /// What was learned of the sensors on another flight is where learning begins.
    ///
    /// # Errors
    /// [`ResumeError`]: then nothing has changed.
    pub fn recall(&mut self, kept: &SensorsMemory) -> Result<(), ResumeError> {
        memory::recall(self, &kept.to_be_confirmed())
    }

    fn reset(&mut self, reset: &Reset) {
        self.core.reset(reset);
        self.sources.reset(reset);
    }

    /// The newest solution; `None` until the attitude has a first guess, and for some tenths of a second after a long hole in the stream,
    /// until it is found again.
    pub fn solution(&self) -> Option<Solution> {
        let core = &self.core;
        if core.estimator.is_settling() {
            return None;
        }
        let time = core.stream.newest()?;
        let (p, mut velocity_ned) = core.estimator.estimate()?;
        let mut position_ned = p + core.published.offset_ned();
        if let Some(height) = core.height.height_m() {
            position_ned.z = -(height + core.published.height_offset_m());
            velocity_ned.z = -core.height.climb_mps();
        }
        let facts = self.sources.facts(&self.core);
        let (position_covariance, velocity_covariance) = core.covariances(&facts);
        Some(Solution {
            time,
            mode: core.mode,
            velocity_source: core.shown_source(time, &facts),
            position: Ned::new(position_ned),
            velocity: Ned::new(velocity_ned),
            glide_velocity: Ned::new(core.published.glide_velocity_ned()),
            attitude: BodyToNed::from_matrix(&core.attitude.r_body_to_ned),
            angular_rate: Body::new(core.attitude.angular_rate_body),
            position_covariance: Ned::new(position_covariance),
            velocity_covariance: Ned::new(velocity_covariance),
            attitude_variance: core.attitude_variance(&facts),
            reset_counter: core.published.reset_counter(),
        })
    }

    /// The mode.
    pub fn mode(&self) -> Mode {
        self.core.mode
    }

    /// What GNSS is worth.
    pub fn gnss_state(&self) -> GnssState {
        self.core.integrity.state()
    }

    /// The local frame's origin, once there is one.
    pub fn frame(&self) -> Option<&LocalNed> {
        self.core.surroundings.environment().map(|e| &e.frame)
    }

    /// The local frame, where somebody has told where on Earth it lies.
    pub fn placed_frame(&self) -> Option<&LocalNed> {
        self.frame().filter(|_| self.core.surroundings.placed())
    }

    /// The GNSS latency in force, s, and its standard deviation, s.
    pub fn gnss_latency_s(&self) -> (f64, f64) {
        let latency = &self.sources.gnss.latency;
        (latency.latency_s(), latency.sigma_s())
    }

    /// How late a field of the magnetometer is, s, and by how much one may be later or earlier, 1 sigma. `None` where none was heard.
    pub fn magnetometer_latency_s(&self) -> Option<(f64, f64)> {
        self.sources.magnetometer.latency_s()
    }

    /// Whether navigation began without any fix, and no receiver has had one since.
    pub fn is_relative(&self) -> bool {
        self.core.integrity.never_good() && self.core.mode != Mode::Aligning
    }

    /// Where navigation began without any fix, as it is configured, while no receiver has had one since.
    pub fn began_at(&self) -> Option<Geodetic> {
        self.core.settings.start.place.filter(|_| self.is_relative())
    }

    /// What dead reckonings beside GNSS have measured on this flight, whatever would carry an outage now first.
    pub fn measured_drift(&self) -> Vec<MeasuredDrift> {
        self.core.estimator.measured_drift()
    }

    /// What the time beside trusted GNSS was spent with, in which they can be compared.
    pub fn time_beside_gnss(&self) -> TimeBeside {
        self.core.estimator.time_beside()
    }

    /// What became of everything that every source told.
    pub fn statuses(&self) -> &StatusBoard {
        &self.core.statuses
    }

    /// Every source that was ever heard, as it fares at present, by kind and id.
    pub fn source_reports(&self) -> Vec<SourceReport> {
        let context = Context { core: &self.core, facts: self.sources.facts(&self.core) };
        let report = |status| SourceReport::new(status, self.sources.health(status, &context));
        let mut reports: Vec<_> = self.core.statuses.iter().map(report).collect();
        reports.sort_by_key(|r| (r.kind, r.id));
        reports
    }

    /// The state of the filter that runs, with what it has learned of the sensors.
    pub fn filter_state(&self) -> Option<&EskfState> {
        self.core.estimator.filter_state()
    }

    /// What the altimeter holds of its channels.
    pub fn height_health(&self) -> [(Channel, Health); 4] {
        Channel::ALL.map(|c| (c, self.core.height.health(c)))
    }

    /// What a channel's height is off by as a rule, m, and for how long it has been silent, s.
    pub fn height_standing(&self, channel: Channel) -> Option<(f64, f64)> {
        self.core.height.standing(channel)
    }

    /// When a channel of the altimeter was heard last, and what height it told, m above the origin, with its usual offset in it.
    pub fn height_reading(&self, channel: Channel) -> Option<(AutopilotTime, f64)> {
        self.core.height.reading(channel)
    }

    /// Earth's magnetic field at the origin, T, where the model has one.
    pub fn magnetic_field(&self) -> Option<Ned<Vector3<f64>>> {
        self.core.surroundings.environment().and_then(|e| e.field_ned).map(Ned::new)
    }

    /// The newest comparison of each of the two dead reckonings beside GNSS.
    pub fn drift_comparisons(&self) -> [Option<DriftComparison>; 2] {
        self.core.estimator.drift_comparisons()
    }

    /// The flow sensors with their calibration [b_x, b_y, s, μ] and whether they are trusted.
    pub fn flow_sensors(&self) -> impl Iterator<Item = (u8, &FlowCalibration, Result<(), Distrust>)> {
        self.sources.flow.calibrations()
    }

    /// Whether a flow sensor may carry the velocity in an outage: one that is trusted, or one that there was never a GNSS to prove by.
    pub fn may_carry_on_flow(&self) -> bool {
        self.sources.facts(&self.core).flow_trusted
    }

    /// The latencies of the flow sensors in force, s, with their standard deviations, by sensor id.
    pub fn flow_latencies_s(&self) -> impl Iterator<Item = (u8, f64, f64)> {
        self.sources.flow.latencies_s()
    }

    /// What happened since the last call, oldest first.
    pub fn drain_events(&mut self) -> impl Iterator<Item = Event> + '_ {
        self.core.events.drain()
    }

    /// Nothing more will be heard: what was held back because it had been told a moment before is told.
    pub fn close(&mut self) {
        if let Some(now) = self.core.stream.newest() {
            self.core.events.close(now);
        }
    }

    /// Whether events wait.
    pub fn has_events(&self) -> bool {
        !self.core.events.is_empty()
    }
}
