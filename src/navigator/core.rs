//! What navigates, but for the sources: the state that they read and that their observations change, and the decisions about it.

use nalgebra::{Matrix2, Matrix3, Matrix4, Vector3};

use crate::filter::HeadingEstimate;
use crate::geo::Geodetic;
use crate::time::AutopilotTime;

use super::context::SourceFacts;
use super::environment::Surroundings;
use super::estimator::{EstimatorStack, StartPoint, Stepped};
use super::event::{EventKind, TransitionReason};
use super::event_log::EventLog;
use super::flow_judge;
use super::height::HeightEstimate;
use super::monitor::gnss_integrity::{GnssFault, GnssIntegrity};
use super::monitor::mode::{Decision, ModeInputs, decide};
use super::monitor::outage::Outage;
use super::monitor::witnesses::Witnesses;
use super::observation::Fused;
use super::published::Published;
use super::receivers;
use super::reset::Reset;
use super::settings::{Estimator as Kind, FlowSettings, NavigatorSettings};
use super::shadow;
use super::solution::{Mode, VelocitySource};
use super::sources::gnss::FixReading;
use super::sources::status::{SourceId, StatusBoard};
use super::stream::ImuStream;
use super::timeline::Timeline;
use super::vehicle::VehicleState;
use crate::navigator::tuning::core::{LANDMARKS_CARRY_S, REMEMBERED};
use crate::navigator::tuning::relative::PLACE_SIGMA_M;

/// How the body stands and turns, as it is published.
#[derive(Clone, Copy, Debug)]
pub(super) struct Attitude {
    pub(super) r_body_to_ned: Matrix3<f64>,
    /// Gyro bias taken out, rad/s.
    pub(super) angular_rate_body: Vector3<f64>,
}

/// See the module's documentation.
#[derive(Clone, Debug)]
pub(super) struct Core {
    pub(super) settings: NavigatorSettings,
    pub(super) surroundings: Surroundings,
    pub(super) vehicle: VehicleState,
    pub(super) stream: ImuStream,
    pub(super) attitude: Attitude,
    pub(super) estimator: EstimatorStack,
    pub(super) timeline: Timeline,
    pub(super) height: HeightEstimate,
    pub(super) integrity: GnssIntegrity,
    pub(super) witnesses: Witnesses,
    pub(super) mode: Mode,
    pub(super) outage: Outage,
    pub(super) published: Published,
    pub(super) events: EventLog,
    pub(super) statuses: StatusBoard,
}

impl Core {
    pub(super) fn new(settings: NavigatorSettings) -> Self {
        Self {
            surroundings: Surroundings::new(),
            vehicle: VehicleState::default(),
            stream: ImuStream::default(),
            attitude: Attitude { r_body_to_ned: Matrix3::identity(), angular_rate_body: Vector3::zeros() },
            estimator: EstimatorStack::new(&settings),
            timeline: Timeline::new(REMEMBERED),
            height: HeightEstimate::new(&settings.height),
            integrity: GnssIntegrity::new(settings.gnss.trust),
            witnesses: Witnesses::default(),
            mode: Mode::Aligning,
            outage: Outage::new(),
            published: Published::default(),
            events: EventLog::new(),
            statuses: StatusBoard::new(),
            settings,
        }
    }

    /// GNSS is not navigated on.
    pub(super) fn dead_reckoning(&self) -> bool {
        matches!(self.mode, Mode::Holdover | Mode::Lost)
    }

    /// In an outage nothing that tells the velocity is used.
    pub(super) fn coasts(&self) -> bool {
        self.settings.estimator == Kind::Inertial && self.dead_reckoning()
    }

    /// What a filter starts from besides the observer's state.
    pub(super) fn start_point<'a>(
        settings: &'a NavigatorSettings,
        height: &HeightEstimate,
        facts: &SourceFacts,
    ) -> StartPoint<'a> {
        StartPoint {
            settings,
            height_m: height.height_m(),
            height_sigma_m: height.height_sigma_m(),
            position_sigma_m: facts.gnss_sigma_m,
        }
    }

    /// How the body stands and turns after a step.
    pub(super) fn stand(&mut self, stepped: &Stepped) {
        self.attitude =
            Attitude { r_body_to_ned: stepped.r_body_to_ned, angular_rate_body: stepped.angular_rate_body };
    }

    /// What was fused is counted, carried into the remembered past, and on the way back to GNSS it is part of the way.
    pub(super) fn absorb(&mut self, now: AutopilotTime, source: SourceId, fused: &Fused) {
        self.statuses.fused(source, now, fused);
        if fused.moves() {
            self.timeline.correct(now, &fused.position_ned, &fused.velocity_ned);
        }
        if self.mode == Mode::Rejoining {
            self.published.stays(&fused.position_ned);
        }
    }

    /// What carries, as it is told: landmarks where they are in view.
    pub(super) fn shown_source(&self, now: AutopilotTime, facts: &SourceFacts) -> VelocitySource {
        let fixed = facts.landmark_fix.is_some_and(|(t, _)| now.seconds_since(t) < LANDMARKS_CARRY_S);
        if self.dead_reckoning() && fixed { VelocitySource::Landmarks } else { self.outage.source() }
    }

    /// What carries the velocity without GNSS.
    fn carrying(&self, now: AutopilotTime, facts: &SourceFacts) -> VelocitySource {
        let coasts = self.settings.estimator == Kind::Inertial;
        let facts = SourceFacts { flow_trusted: facts.flow_trusted && !coasts, ..*facts };
        shadow::carrier(&facts, now)
    }

    /// Time goes on by `dt` s: dead reckoning and glides do, and what they lead to is decided.
    pub(super) fn advance(
        &mut self,
        now: AutopilotTime,
        dt: f64,
        facts: &SourceFacts,
        calibration: impl Fn(&FlowSettings) -> Matrix4<f64>,
    ) {
        let mut sigma_m = 0.0;
        if self.dead_reckoning() {
            let source = self.carrying(now, facts);
            self.outage_source(now, dt, source, facts);
            self.estimator.grow(dt, source);
            self.published.glide(dt, &self.settings.rejoin);
            if self.mode == Mode::Holdover {
                sigma_m = self.horizontal_sigma_m(facts).unwrap_or(f64::INFINITY);
            }
        } else if self.mode == Mode::Rejoining && self.integrity.trusted() {
            self.published.glide(dt, &self.settings.rejoin);
        } else {
            self.published.rest();
        }
        let heading = if self.mode == Mode::Aligning { self.estimator.heading_found() } else { None };
        let observer = self.estimator.observer();
        let inputs = ModeInputs {
            mode: self.mode,
            gnss: self.integrity.state(),
            attitude_found: observer.alignment.attitude_found(now, &self.settings.observer),
            height_known: self.height.height_m().is_some(),
            heading_found: heading.is_some(),
            joined: self.published.has_joined(),
            sigma_m,
            coasted_s: self.outage.coasted_s(now),
        };
        if let Some(decision) = decide(&inputs, &self.settings.holdover) {
            self.follow(now, decision, heading.as_ref(), facts, calibration);
        }
    }

    fn outage_source(&mut self, now: AutopilotTime, dt: f64, source: VelocitySource, facts: &SourceFacts) {
        let on_landmarks = self.shown_source(now, facts) == VelocitySource::Landmarks;
        let shown = if on_landmarks { VelocitySource::Landmarks } else { source };
        if let Some(carries) = self.outage.go_on(now, dt, source, shown) {
            self.events.tell(now, EventKind::Carried(carries));
        }
    }

    fn follow(
        &mut self,
        now: AutopilotTime,
        decision: Decision,
        heading: Option<&HeadingEstimate>,
        facts: &SourceFacts,
        calibration: impl Fn(&FlowSettings) -> Matrix4<f64>,
    ) {
        let start = Self::start_point(&self.settings, &self.height, facts);
        match decision {
            Decision::Align => {
                self.estimator.align(now, &start);
                self.begin_publishing();
                self.change_mode(now, Mode::Aided, TransitionReason::Aligned);
            }
            Decision::AlignByMotion => {
                let Some(estimate) = heading else { return };
                self.estimator.align_by_motion(now, estimate, &start);
                self.begin_publishing();
                // What is remembered was remembered at another heading.
                self.timeline.reset(&Reset::Relocated);
                self.events.tell(now, EventKind::HeadingFound(estimate.heading_sigma));
                self.change_mode(now, Mode::Aided, TransitionReason::Aligned);
            }
            Decision::HoldOver(fault) => self.hold_over(now, fault, facts, calibration),
            Decision::Join => {
                self.published.begin();
                self.change_mode(now, Mode::Aided, TransitionReason::Joined);
            }
            Decision::GiveUp(reason) => self.change_mode(now, Mode::Lost, reason),
        }
    }

    /// What is published begins at the estimate.
    fn begin_publishing(&mut self) {
        self.published.begin();
        self.outage.end_budget();
    }

    /// There was never a fix: Holdover from the beginning, at a place that is exact by definition.
    pub(super) fn start_relative(
        &mut self,
        now: AutopilotTime,
        facts: &SourceFacts,
        at_rest: bool,
        calibration: &Matrix4<f64>,
    ) {
        let start = Self::start_point(&self.settings, &self.height, facts);
        let start = StartPoint { position_sigma_m: PLACE_SIGMA_M, ..start };
        self.estimator.align_without_gnss(now, &start, at_rest);
        self.begin_publishing();
        let exact = Matrix2::identity() * PLACE_SIGMA_M.powi(2);
        self.outage.begin_budget(&self.settings.holdover, exact, calibration);
        self.estimator.hold_over();
        self.outage.begin();
        self.change_mode(now, Mode::Holdover, TransitionReason::NoGnss);
    }

    /// GNSS is lost: what it added slowly is taken back, and dead reckoning begins.
    fn hold_over(
        &mut self,
        now: AutopilotTime,
        fault: GnssFault,
        facts: &SourceFacts,
        calibration: impl Fn(&FlowSettings) -> Matrix4<f64>,
    ) {
        receivers::charge(self, now, facts.gnss_receiver, Err(fault), false);
        if matches!(fault, GnssFault::Inconsistent | GnssFault::ContradictsFlow) {
            // What the slow lie added is taken back; the published position glides after it.
            let led = self.integrity.led();
            let led = Vector3::new(led.x, led.y, 0.0);
            self.estimator.relocate(&-led);
            self.timeline.reset(&Reset::Relocated);
            self.published.stays(&-led);
            self.witnesses.unexplained.taken_back(now, &led.xy(), self.integrity.walked_spread_m());
            self.events.tell(now, EventKind::WalkedBack(led.norm()));
        }
        let wrong_since = match fault {
            GnssFault::ContradictsInertia => facts.lying_since,
            GnssFault::Frozen => self.integrity.frozen_since(),
            _ => None,
        };
        if let Some(since) = wrong_since {
            flow_judge::take_back(self, since);
            self.witnesses.unexplained.undone();
        }
        self.estimator.hold_over();
        // Gliding on without GNSS would be a wrong velocity: where it was published to be is where it is, plus what is missing.
        let start = Matrix2::identity() * facts.gnss_sigma_m.powi(2) + self.published.offset_covariance();
        self.outage.begin_budget(&self.settings.holdover, start, &calibration(&self.settings.flow));
        self.outage.begin();
        self.change_mode(now, Mode::Holdover, TransitionReason::GnssLost(fault));
    }

    /// What the filter takes the magnetometer to be biased by, body, T.
    pub(super) fn magnetic_bias(&self) -> Vector3<f64> {
        self.estimator.filter_state().map_or(Vector3::zeros(), |state| state.magnetic_bias)
    }

    /// The estimate moves to a fix at once; the published position stays and glides after it.
    pub(super) fn go_to(&mut self, now: AutopilotTime, reading: &FixReading) {
        let Some((before, _)) = self.estimator.estimate() else { return };
        let e_v = reading.velocity_error.unwrap_or_default();
        let shift = reading.position_error + e_v * now.seconds_since(reading.measured);
        let shift = Vector3::new(shift.x, shift.y, 0.0);
        let position_ne = (before + shift).xy();
        let sigma = reading.sigma_on_return();
        self.estimator.rejoin(&reading.innovation, &position_ne, reading.velocity_error.as_ref(), sigma);
        if self.estimator.is_filtered() {
            self.timeline.reset(&Reset::Relocated);
        }
        self.published.stays(&shift);
        self.came_back(now);
    }

    /// GNSS is trusted again and the estimate has moved to it; the published position still stands where it was.
    pub(super) fn came_back(&mut self, now: AutopilotTime) {
        self.outage.end_budget();
        if self.mode == Mode::Lost || self.published.offset_ned().norm() > self.settings.rejoin.jump_m {
            let away = self.published.jump();
            self.events.tell(now, EventKind::Reset(away));
            self.change_mode(now, Mode::Aided, TransitionReason::GnssBack);
        } else {
            self.change_mode(now, Mode::Rejoining, TransitionReason::GnssBack);
        }
    }

    /// Trusted fixes do not fit the estimate, which lies `apart_m` from them: it starts anew at them, and what is published with it.
    pub(super) fn start_at_fixes(&mut self, now: AutopilotTime, apart_m: f64, facts: &SourceFacts) {
        let start = Self::start_point(&self.settings, &self.height, facts);
        self.estimator.restart(now, &start);
        self.begin_publishing();
        self.timeline.reset(&Reset::Relocated);
        self.published.count_reset();
        self.events.tell(now, EventKind::Reset(apart_m));
    }

    /// The first fix is the frame's origin. What was measured before there was a place could not be used: the wait for it begins anew.
    pub(super) fn settle(&mut self, now: AutopilotTime, origin: Geodetic) {
        self.surroundings.settle(origin);
        if let Some(environment) = self.surroundings.environment() {
            self.estimator.observer_mut().settle(environment);
        }
        self.estimator.observer_mut().alignment.start(now);
        self.events.tell(now, EventKind::Origin(0.0));
    }

    pub(super) fn change_mode(&mut self, time: AutopilotTime, to: Mode, reason: TransitionReason) {
        let from = self.mode;
        if from == to {
            return;
        }
        self.mode = to;
        self.outage.mode_changed(to);
        if to == Mode::Aligning {
            self.estimator.observer_mut().alignment.forget();
        }
        self.events.tell(time, EventKind::Mode { from, to, reason });
    }

    /// Every component invalidates what a reset invalidates of its own.
    pub(super) fn reset(&mut self, reset: &Reset) {
        self.stream.reset(reset);
        self.vehicle.reset(reset);
        self.estimator.reset(reset, self.surroundings.environment());
        self.timeline.reset(reset);
        self.height.reset(reset, &self.settings.height);
        self.integrity.reset(reset);
        self.witnesses.forget();
        self.published.reset(reset);
    }

    /// The mode after the stream or the estimate broke.
    pub(super) fn broken_off(&mut self, time: AutopilotTime, reason: TransitionReason) {
        let to = match self.mode {
            Mode::Aligning => return,
            Mode::Aided => Mode::Aligning,
            Mode::Holdover | Mode::Rejoining | Mode::Lost => Mode::Lost,
        };
        self.change_mode(time, to, reason);
    }
}
