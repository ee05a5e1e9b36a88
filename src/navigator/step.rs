//! The IMU sample: what moves everything.

use nalgebra::Vector3;

use crate::sample::{Airframe, ImuSample};

use super::context::{Context, SourceFacts};
use super::core::Core;
use super::estimator::{CarryInput, SeekInput, StepInput, StepOutcome, Stepped};
use super::event::{EventKind, TransitionReason, Waits};
use super::inertia;
use super::monitor::GnssState;
use super::observation::Observation;
use super::receivers;
use super::reset::Reset;
use super::sources::drag::DragSource;
use super::sources::status::{SourceId, SourceKind};
use super::stream::Heard;
use super::timeline::MotionNow;
use super::vehicle::VehicleState;
use super::verdict::{Reason, Verdict};
use super::{Mode, Navigator, landmark_fix, relative};
use crate::navigator::tuning::height::UNKNOWN_VERTICAL;
use crate::navigator::tuning::height_wander::GROUND_CHANGES_MPS;
use crate::navigator::tuning::inertia_witness::{STUCK_FOR_S, WRONG_FOR_S};
use crate::navigator::tuning::step::{HELD_FIELD_S, LONG_STEP_S};
use crate::time::AutopilotTime;

impl Navigator {
    pub(super) fn imu(&mut self, s: &ImuSample) -> Verdict {
        let (disarmed, max_gap_s) = (self.core.vehicle.disarmed(), self.core.settings.imu.max_gap_s);
        let dt = match self.core.stream.hear(s, disarmed, max_gap_s) {
            Heard::Refused(reason) => return Verdict::Rejected(reason),
            Heard::First => {
                self.core.estimator.observer_mut().alignment.start(s.time);
                return Verdict::Used;
            }
            Heard::ClockSetBack => {
                self.reset(&Reset::ClockSetBack);
                self.core.change_mode(s.time, Mode::Aligning, TransitionReason::Reboot);
                return Verdict::Rejected(Reason::OutOfOrder);
            }
            Heard::Next(dt) => dt,
        };
        self.core.events.go_on(s.time);
        if dt > max_gap_s {
            self.core.integrity.deaf(dt, self.core.settings.imu.bridge_s);
            self.core.integrity.check(s.time);
            self.over_a_hole(s, dt);
            return Verdict::Used;
        }
        self.core.integrity.check(s.time);
        if dt > LONG_STEP_S {
            self.core.estimator.doubt(dt);
        }
        let verdict = match inertia::missing(&mut self.core, s.time) {
            Some(reason) => self.coast_on(s, dt, reason),
            None => self.step(s, dt),
        };
        if self.core.mode == Mode::Aligning {
            relative::consider(&mut self.core, &mut self.sources, s);
        }
        if self.core.mode == Mode::Aligning && self.core.estimator.observer_mut().alignment.tells(s.time) {
            let facts = self.sources.facts(&self.core);
            let waits = self.core.waits_for(s.time, &facts);
            self.core.events.tell(s.time, EventKind::Waits(waits));
        }
        verdict
    }

    /// A hole of `gap_s` in the stream: the filter goes on over it with the doubt that it leaves, or everything begins anew.
    fn over_a_hole(&mut self, s: &ImuSample, gap_s: f64) {
        self.core.height.blind(gap_s, gap_s > self.core.settings.imu.bridge_s);
        if !self.carry_over(s, gap_s) {
            self.break_off(s, TransitionReason::ImuGap(gap_s));
        }
    }

    fn break_off(&mut self, s: &ImuSample, reason: TransitionReason) {
        self.reset(&Reset::StreamBroken);
        self.core.broken_off(s.time, reason);
    }

    /// False when there is no filter.
    fn carry_over(&mut self, s: &ImuSample, gap_s: f64) -> bool {
        let core = &mut self.core;
        let Some(environment) = core.surroundings.environment() else { return false };
        let wing = core.vehicle.is(Airframe::FixedWing);
        let input = CarryInput { settings: &core.settings, environment, wing };
        let Some(last) = core.stream.last().copied() else { return false };
        let Some(stepped) = core.estimator.carry_over(&last, s, gap_s, &input) else { return false };
        core.stream.over_the_interval(s, false);
        core.stand(&stepped);
        self.reset(&Reset::Bridged);
        self.core.remember(s, &stepped, Vector3::zeros());
        self.core.events.tell(s.time, EventKind::Bridged(gap_s));
        let facts = self.sources.facts(&self.core);
        self.advance(s, gap_s, &facts);
        true
    }

    fn step(&mut self, s: &ImuSample, dt: f64) -> Verdict {
        let facts = self.sources.facts(&self.core);
        let core = &mut self.core;
        let Some(environment) = core.surroundings.environment() else {
            return Verdict::Rejected(Reason::NoReferenceYet);
        };
        let input = StepInput {
            settings: &core.settings,
            environment,
            mode: core.mode,
            dead_reckoning: core.dead_reckoning(),
            carried_by_flow: core.outage.source() == super::solution::VelocitySource::Flow,
            height_m: core.height.height_m(),
            height_sigma_m: core.height.height_sigma_m(),
            climb_mps: core.height.climb_mps(),
            magnetic: facts.magnetic.and_then(|m| core.carried_field(s.time, m)),
            flow_velocity: facts.flow_velocity,
            gnss_sigma_m: facts.gnss_sigma_m,
            wing: core.vehicle.is(Airframe::FixedWing),
        };
        if let Some(r) = core.estimator.observer_mut().first_attitude(s, &input) {
            core.attitude.r_body_to_ned = r;
        }
        if core.estimator.observer().state().is_none() {
            return Verdict::Rejected(Reason::NoReferenceYet);
        }
        let mean = core.stream.over_the_interval(s, core.settings.imu.instantaneous);
        match core.estimator.step(&mean, dt, &input, &facts, &core.attitude.r_body_to_ned) {
            Some(outcome) => self.after_step(&mean, dt, &outcome, &facts),
            None => {
                self.core.estimator.lose_attitude();
                self.break_off(s, TransitionReason::Broken);
            }
        }
        Verdict::Used
    }

    /// What the sample tells is not believed: the vehicle goes on as it went, less surely so from moment to moment.
    fn coast_on(&mut self, s: &ImuSample, dt: f64, reason: Reason) -> Verdict {
        let facts = self.sources.facts(&self.core);
        let core = &mut self.core;
        core.stream.pass_over(s);
        let lag_s = if reason == Reason::Stuck { STUCK_FOR_S } else { WRONG_FOR_S };
        if let Some(stepped) = core.estimator.coast_on(s, dt, lag_s) {
            core.stand(&stepped);
            let velocity_ned = core.remember(s, &stepped, Vector3::zeros());
            core.estimator.observer_mut().propagate(s.time, &Vector3::zeros(), &velocity_ned);
            core.height.predict(dt, 0.0, UNKNOWN_VERTICAL);
            core.published.glide_height(dt, &core.settings.height);
            self.advance(s, dt, &facts);
        }
        Verdict::Rejected(reason)
    }

    fn after_step(&mut self, s: &ImuSample, dt: f64, outcome: &StepOutcome, facts: &SourceFacts) {
        let StepOutcome { stepped, report, fused, restarted, settled } = outcome;
        let core = &mut self.core;
        if *settled {
            // What is remembered since the hole was remembered at another attitude.
            core.timeline.reset(&Reset::Relocated);
        }
        // After a hole a height says something of the horizontal position as well.
        core.absorb(s.time, SourceId::only(SourceKind::Height), fused);
        if let Some(apart) = restarted {
            core.events.tell(s.time, EventKind::FilterRestarted(*apart));
        }
        core.stand(stepped);
        let velocity_ned = core.remember(s, stepped, stepped.angular_rate_body * dt);
        core.estimator.observer_mut().propagate(s.time, &stepped.injected_ned, &velocity_ned);
        let load = core.settings.height.accel_load_noise * stepped.acceleration_ned.norm();
        core.height.predict(dt, -stepped.acceleration_ned.z, load);
        core.witnesses.barometer.feel(dt, -stepped.acceleration_ned.z);
        core.feel_ground(dt, facts);
        core.published.glide_height(dt, &core.settings.height);
        let mut facts = *facts;
        self.look_for_rest(s, &facts);
        facts.resting = self.sources.standstill.resting();
        self.feel_drag(s, dt, &facts);
        facts.drag_used = self.sources.drag.used();
        self.core.estimator.lead_observer(&facts, s.time);
        self.seek_heading(s, dt, &facts);
        if self.sources.landmarks.is_some() {
            self.feel_landmarks(s, dt, &facts);
            facts = self.sources.facts(&self.core);
        }
        let on_ground = Context { core: &self.core, facts }.on_ground();
        let core = &mut self.core;
        core.stream.stands(on_ground);
        core.estimator.observer_mut().injected(s.time, dt, report, &core.settings.observer);
        inertia::judge_speed(core, s.time);
        inertia::judge_axes(core, s.time, &facts, &self.sources.gnss.steps);
        receivers::judge_innovations(core, &mut self.sources, s.time, &facts);
        self.advance(s, dt, &facts);
    }

    fn advance(&mut self, s: &ImuSample, dt: f64, facts: &SourceFacts) {
        let flow = &self.sources.flow;
        self.core.advance(s.time, dt, facts, |settings| flow.calibration_covariance(settings));
    }

    /// Standing still, where the vehicle's own word for it can be believed.
    fn look_for_rest(&mut self, s: &ImuSample, facts: &SourceFacts) {
        self.core.doubt_disarmed(facts.ground.map(|g| g.height_m));
        let context = Context { core: &self.core, facts: *facts };
        let observation = self.sources.standstill.observe(s, &context);
        let standing = self.sources.standstill.quiet(s.time);
        self.sources.takeoff.look(standing, &context);
        let Some(observation) = observation else { return };
        let core = &mut self.core;
        let Some(environment) = core.surroundings.environment() else { return };
        let fused = core.estimator.fuse(s.time, &observation, &core.timeline, environment);
        self.sources.standstill.fused(&fused);
        core.absorb(s.time, SourceId::only(SourceKind::Standstill), &fused);
    }

    fn feel_drag(&mut self, s: &ImuSample, dt: f64, facts: &SourceFacts) {
        let context = Context { core: &self.core, facts: *facts };
        let Some(observation) = self.sources.drag.observe(s, dt, &context) else { return };
        let core = &mut self.core;
        if let Observation::Drag { force_xy, .. } = &observation
            && let Some((air_ne, wind_ne)) = DragSource::through_air(force_xy, &core.estimator)
        {
            self.sources.gnss.air.tell(s.time, air_ne, wind_ne);
        }
        let Some(environment) = core.surroundings.environment() else { return };
        let fused = core.estimator.fuse(s.time, &observation, &core.timeline, environment);
        self.sources.drag.fused(s.time, &fused, &core.estimator);
        core.absorb(s.time, SourceId::only(SourceKind::Drag), &fused);
    }

    fn seek_heading(&mut self, s: &ImuSample, dt: f64, facts: &SourceFacts) {
        let core = &mut self.core;
        let Some(environment) = core.surroundings.environment() else { return };
        let input = SeekInput { settings: &core.settings, environment, facts };
        if core.estimator.seek_heading(s, dt, core.mode, &input) {
            core.events.tell(s.time, EventKind::HeadingSought);
        }
    }

    fn feel_landmarks(&mut self, s: &ImuSample, dt: f64, facts: &SourceFacts) {
        let Some(landmarks) = &mut self.sources.landmarks else { return };
        let mut statuses = std::mem::take(&mut self.core.statuses);
        let context = Context { core: &self.core, facts: *facts };
        let moved = landmarks.carry_on(s.time, dt, &context, |camera, time, verdict| {
            statuses.count(SourceId { kind: SourceKind::Landmarks, id: camera }, time, verdict);
        });
        self.core.statuses = statuses;
        if moved {
            landmark_fix::judge(&mut self.core, &mut self.sources, s.time);
        }
    }
}

impl Core {
    /// A magnetic field turned by as much as the vehicle has turned since: a slow magnetometer is as good as a fast one.
    fn carried_field(
        &self,
        now: AutopilotTime,
        (time, field_body): (AutopilotTime, Vector3<f64>),
    ) -> Option<(AutopilotTime, Vector3<f64>)> {
        if now.seconds_since(time) < HELD_FIELD_S {
            return Some((time, field_body));
        }
        let then = self.timeline.attitude(time)?;
        Some((time, self.attitude.r_body_to_ned.tr_mul(&(then * field_body))))
    }

    /// What keeps the navigator from navigating.
    fn waits_for(&self, now: AutopilotTime, facts: &SourceFacts) -> Waits {
        let observer = self.estimator.observer();
        if self.integrity.settles() {
            Waits::Trust
        } else if let GnssState::Untrusted(fault) = self.integrity.state() {
            Waits::Fix(fault)
        } else if self.height.height_m().is_none() {
            Waits::Height
        } else if !super::estimator::has_magnetometer(facts, now) {
            Waits::Motion
        } else {
            Waits::Attitude(observer.alignment.off_rad().unwrap_or(std::f64::consts::PI))
        }
    }

    /// The instant is remembered; the velocity that is estimated at it.
    fn remember(&mut self, s: &ImuSample, stepped: &Stepped, turned: Vector3<f64>) -> Vector3<f64> {
        let (position_ned, velocity_ned) = self.estimator.estimate().unwrap_or_default();
        let bias = self.estimator.filter_state().map_or(Vector3::zeros(), |state| state.accel_bias);
        let force = s.specific_force.raw() - bias;
        let level = Vector3::new(force.x, force.y, 0.0);
        self.timeline.push(
            s.time,
            &MotionNow {
                r_body_to_ned: stepped.r_body_to_ned,
                turned,
                acceleration_ned: stepped.acceleration_ned,
                sideways_ned: stepped.r_body_to_ned * level,
                position_ned,
                velocity_ned,
            },
        );
        velocity_ned
    }

    /// The air under a multirotor near the ground is not what the barometer thinks: its offset is loose there. So is every height as this vehicle has shown.
    fn feel_ground(&mut self, dt: f64, facts: &SourceFacts) {
        let h = &self.settings.height;
        let near = facts
            .ground
            .zip(self.height.height_m())
            .is_some_and(|(ground, height)| (height - ground.height_m).abs() < h.ground_effect_below_m);
        if near && !facts.resting && self.mode != Mode::Aligning {
            self.height.loosen_barometers(h.ground_effect_walk, dt);
        }
        // Below a vehicle that stands the ground is what it was; without a trusted velocity nobody knows whether it does.
        let speed =
            self.estimator.estimate().filter(|_| self.mode == Mode::Aided).map(|(_, v)| v.xy().norm());
        let changes = speed.map_or(1.0, |v| (v / GROUND_CHANGES_MPS).min(1.0).sqrt());
        self.height.loosen_ground(h.ground_walk * changes, dt);
        self.height.wander(dt, facts.resting || self.mode == Mode::Aligning);
    }

    /// What moves like something that flies is not disarmed, whatever it says.
    fn doubt_disarmed(&mut self, ground_m: Option<f64>) {
        if self.mode != Mode::Aided || !self.vehicle.disarmed() {
            return;
        }
        let height =
            self.height.height_m().filter(|_| self.height.height_sigma_m() < VehicleState::TELLING_SIGMA_M);
        let above_m = height.zip(ground_m).map(|(height, ground)| height - ground);
        self.vehicle.seen_moving(self.estimator.estimate().map(|(_, v)| v.xy().norm()), above_m);
    }
}
