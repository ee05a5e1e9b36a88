//! Samples of everything but the IMU: observed by their source, fused, and what follows.

use nalgebra::Vector3;

use crate::altimeter::{Channel, HeightVerdict};
use crate::geo::Geodetic;
use crate::sample::{
    Airframe, AirspeedSample, FlowSample, GnssSample, LandmarkSample, MagSample, PressureSample, RangeSample,
};
use crate::time::AutopilotTime;

use super::context::Context;
use super::event::{EventKind, TransitionReason};
use super::height::{HeightReading, verdict};
use super::inertia;
use super::monitor::gnss_integrity::{GnssFault, Standing};
use super::observation::{Fused, Observation};
use super::reset::Reset;
use super::sources::flow::{self, FlowInput, MeasuredFlow, PatchArrival};
use super::sources::gnss::{FixReading, ReceiverChoice, expectation, horizontal};
use super::sources::status::{Measured, SourceId, SourceKind};
use super::verdict::{Reason, Verdict};
use super::{Mode, Navigator, air_judge, flow_judge, heading_turn, receivers, relative};
use crate::navigator::tuning::height::UNSEEN_JUMP_M;
use crate::navigator::tuning::hole::LOST_YAW;

impl Navigator {
    /// What a source observed goes to the estimator, and what became of it to everybody whom it concerns.
    fn fuse(&mut self, now: AutopilotTime, source: SourceId, observation: &Observation) -> Fused {
        let core = &mut self.core;
        let Some(environment) = core.surroundings.environment() else { return Fused::nothing() };
        let fused = core.estimator.fuse(now, observation, &core.timeline, environment);
        core.absorb(now, source, &fused);
        fused
    }

    pub(super) fn magnetometer(&mut self, s: &MagSample) -> Verdict {
        if s.field.raw().norm().is_normal()
            && let Some(taken) = self.sources.magnetometer.hear(s, &self.core)
            && self.sources.magnetometer.contradicted().is_none()
        {
            inertia::hear_field(&mut self.core, taken, &s.field.raw());
        }
        let context = Context { core: &self.core, facts: self.sources.facts(&self.core) };
        let source = SourceId { kind: SourceKind::Magnetometer, id: s.sensor };
        let observed = self.sources.magnetometer.observe(s, &context);
        heading_turn::weigh_compass(&mut self.core, &mut self.sources, s.time, source);
        match observed {
            Err(reason) => Verdict::Rejected(reason),
            Ok(observation) => {
                if self.fuse(s.time, source, &observation).gated(Measured::Magnetometer) {
                    Verdict::Rejected(Reason::Innovation)
                } else {
                    Verdict::Used
                }
            }
        }
    }

    pub(super) fn airspeed(&mut self, s: &AirspeedSample) -> Verdict {
        let context = Context { core: &self.core, facts: self.sources.facts(&self.core) };
        match self.sources.airspeed.observe(s, &context) {
            Err(reason) => Verdict::Rejected(reason),
            Ok(measured) => {
                if let Err(reason) = air_judge::weigh(&mut self.core, &mut self.sources, &measured) {
                    return Verdict::Rejected(reason);
                }
                if let Some((air_ne, wind_ne)) = self.sources.airspeed.through_air(&measured, &self.core) {
                    self.sources.gnss.air.tell(s.time, air_ne, wind_ne);
                }
                let now = self.core.stream.newest().unwrap_or(s.time);
                let fused = self.fuse(now, SourceId::only(SourceKind::Airspeed), &measured.observation());
                self.sources.airspeed.fused(s.time, &fused, &self.core)
            }
        }
    }

    /// A height to the altimeter: the published height goes on without a step.
    fn take_height(&mut self, now: AutopilotTime, reading: &HeightReading) -> Option<HeightVerdict> {
        let core = &mut self.core;
        let update = core.height.take(now, reading, &mut core.events);
        if update.told {
            self.sources.barometer.height_moved();
        }
        core.integrity.height_fault(core.height.health(Channel::Gnss).is_faulty());
        if let Some(moved_m) = update.moved_m {
            // A decision or a return moves the height once, and it glides there; all else is tracking.
            core.published.height_moved(moved_m, update.decision);
        }
        // Over a hole nobody was told one either, and what is known again is not to be glided to for a minute.
        let jump_m = core.settings.height.jump_m;
        let most_m = if update.unseen { jump_m.min(UNSEEN_JUMP_M) } else { jump_m };
        if core.mode == Mode::Aligning {
            // Nobody was told a height yet: there is nothing to be continuous with.
            core.published.begin_height();
        } else if core.published.height_offset_m().abs() > most_m
            && let Some(jump) = core.published.jump_height()
        {
            core.events.tell(now, EventKind::HeightReset(jump));
        }
        update.verdict
    }

    pub(super) fn barometer(&mut self, s: &PressureSample) -> Verdict {
        let context = Context { core: &self.core, facts: self.sources.facts(&self.core) };
        let read = match self.sources.barometer.observe(s, &context) {
            Err(reason) => return Verdict::Rejected(reason),
            Ok(read) => read,
        };
        if read.another {
            self.core.height.another(read.reading.channel);
        }
        if let Some((climb_mps, for_s)) = read.led {
            self.core.height.doubt(climb_mps, for_s);
        }
        inertia::hear_barometer(&mut self.core, s.time, &read.reading, read.usable.is_ok());
        match (read.usable, self.core.stream.newest()) {
            (Ok(()), Some(now)) => verdict(self.take_height(now, &read.reading)),
            (Err(reason), _) => Verdict::Rejected(reason),
            (Ok(()), None) => Verdict::Rejected(Reason::NoReferenceYet),
        }
    }

    pub(super) fn rangefinder(&mut self, s: &RangeSample) -> Verdict {
        let context = Context { core: &self.core, facts: self.sources.facts(&self.core) };
        let observed = self.sources.rangefinders.observe(s, &context);
        if let Some(above_m) = self.sources.rangefinders.told(s.time) {
            self.core.height.hear_ground(above_m);
        }
        match observed {
            Err(reason) => Verdict::Rejected(reason),
            Ok(reading) => {
                if let (Some(reading), Some(now)) = (reading, self.core.stream.newest()) {
                    self.take_height(now, &reading);
                }
                Verdict::Used
            }
        }
    }

    pub(super) fn landmark(&mut self, s: &LandmarkSample) -> Verdict {
        let facts = self.sources.facts(&self.core);
        let Some(landmarks) = &mut self.sources.landmarks else { return Verdict::Rejected(Reason::NotUsed) };
        landmarks.observe(s, &Context { core: &self.core, facts })
    }

    pub(super) fn gnss(&mut self, s: &GnssSample) -> Verdict {
        if !s.is_possible() {
            return Verdict::Rejected(Reason::NotFinite);
        }
        let Some(now) = self.core.stream.newest() else { return Verdict::Rejected(Reason::NoReferenceYet) };
        let s = &self.sources.gnss.sift(s);
        let mut switched = false;
        match self.sources.gnss.select(s) {
            ReceiverChoice::Same => {}
            ReceiverChoice::Redundant if !receivers::spare(&mut self.core, &mut self.sources, now, s) => {
                return Verdict::Rejected(Reason::Redundant);
            }
            ReceiverChoice::Redundant => {
                switched = receivers::other_lied(&self.core, s.receiver);
                self.core.height.another(Channel::Gnss);
                self.core.events.tell(s.time, EventKind::Receiver(s.receiver));
            }
            ReceiverChoice::Another => {
                self.core.integrity.take_over(&mut self.sources.gnss.spare);
                self.core.height.another(Channel::Gnss);
                self.core.events.tell(s.time, EventKind::Receiver(s.receiver));
            }
        }
        let judged = self.fix(now, s, switched);
        if let Err(fault) = judged {
            self.core.integrity.bad(now, fault);
        }
        let trusted = self.core.integrity.trusted();
        receivers::charge(&mut self.core, now, s.receiver, judged, trusted);
        match judged {
            Ok(()) => Verdict::Used,
            Err(fault) => {
                self.sources.gnss.latency.interrupt();
                Verdict::Rejected(Reason::Gnss(fault))
            }
        }
    }

    /// A fix of the receiver in use; `switched`: only now, for the other lied.
    fn fix(&mut self, now: AutopilotTime, s: &GnssSample, switched: bool) -> Result<(), GnssFault> {
        self.core.integrity.admit(s)?;
        let position = s.position.ok_or(GnssFault::NoFix)?;
        self.sources.gnss.had_fix(s);
        self.place_at(now, &position);
        let Some(environment) = self.core.surroundings.environment() else {
            self.core.settle(now, position);
            return Ok(());
        };
        let position_ned = environment.frame.to_ned(&position);
        let measured = self.sources.gnss.measured(now, s)?;
        if self.core.estimator.observer().state().is_none() {
            return Ok(());
        }
        let v = s.ground_velocity.map_or((0.0, 0.0), |g| g.north_east());
        let aligning = self.core.mode == Mode::Aligning;
        let velocity_ned = Vector3::new(v.0, v.1, 0.0);
        self.core.estimator.observer_mut().begin_signal(now, &position_ned, &velocity_ned, aligning);
        let context = Context { core: &self.core, facts: self.sources.facts(&self.core) };
        let reading = self.sources.gnss.observe(s, measured, position_ned, &context)?;
        let regained = self.judge(now, &reading)?;
        self.sources.gnss.accepted(&reading);
        match self.core.mode {
            // Where another receiver has led the estimate astray it is not led back by small corrections.
            mode if regained && mode != Mode::Aligning && (self.core.dead_reckoning() || switched) => {
                self.rejoin(now, &reading);
            }
            _ if self.core.dead_reckoning() => return Ok(()),
            _ => self.take_fix(now, &reading),
        }
        self.learn_gnss_latency(&reading);
        self.take_fix_height(now, &reading);
        Ok(())
    }

    /// The first fix tells where navigation that began without any has begun.
    fn place_at(&mut self, now: AutopilotTime, position: &Geodetic) {
        if self.core.surroundings.environment().is_some() && !self.core.surroundings.placed() {
            relative::place(&mut self.core, now, position);
        }
    }

    fn take_fix_height(&mut self, now: AutopilotTime, reading: &FixReading) {
        let height = HeightReading {
            channel: Channel::Gnss,
            height_m: -reading.position_ned.z,
            sigma_m: Some(reading.vertical_sigma_m),
            age_s: now.seconds_since(reading.measured),
        };
        self.take_height(now, &height);
    }

    /// What the monitor says of a fix; whether GNSS is trusted again by it.
    fn judge(&mut self, now: AutopilotTime, reading: &FixReading) -> Result<bool, GnssFault> {
        let context = Context { core: &self.core, facts: self.sources.facts(&self.core) };
        let expected = (self.core.mode != Mode::Aligning).then(|| expectation(reading, &context));
        receivers::hear_flow(&mut self.core, &mut self.sources, reading)
            .and_then(|()| receivers::hear_inertia(&mut self.core, &mut self.sources, reading))
            .inspect_err(|_| self.core.witnesses.unexplained.settled())?;
        let core = &mut self.core;
        let position_ne = reading.position_ned.xy();
        let judged = core.integrity.judge(reading.stamp, position_ne, reading.velocity_ne, expected);
        receivers::dispute(core, &self.sources, now, reading, judged);
        let standing = match judged {
            Ok(standing) => standing,
            Err(fault) => {
                if fault == GnssFault::Inconsistent && !core.dead_reckoning() {
                    core.integrity.leads(&reading.position_error);
                }
                if fault == GnssFault::PositionJump && !core.dead_reckoning() {
                    core.witnesses.unexplained.jumped(reading.position_error.xy().norm());
                }
                heading_turn::witness(&mut self.core, &mut self.sources, now, reading, Some(fault));
                return Err(fault);
            }
        };
        heading_turn::witness(&mut self.core, &mut self.sources, now, reading, None);
        let core = &mut self.core;
        let (wander, unexplained) = (core.integrity.wander(), &mut core.witnesses.unexplained);
        unexplained.wanders(now, &wander.gap_ne, wander.beyond_m, reading.claimed_m);
        let gnss = &self.sources.gnss;
        let walked_ne = gnss.witness.may_have_led();
        unexplained.wanders(now, &walked_ne, walked_ne.norm(), reading.claimed_m);
        // An estimate that does not follow it is not led.
        if !core.dead_reckoning() {
            let led_ne = gnss.steps.may_have_led(reading.measured);
            core.witnesses.unexplained.suspected(now, &led_ne, reading.claimed_m);
        }
        // A receiver that comes back at another height is not where it says.
        let height_m = -reading.position_ned.z;
        let gate = core.settings.gnss.trust.gate_sigma;
        let elsewhere = standing == Standing::Near
            && core.dead_reckoning()
            && core.height.contradicts(Channel::Gnss, height_m, reading.vertical_sigma_m, gate);
        Ok(core.integrity.good(now, if elsewhere { Standing::Far } else { standing }))
    }

    /// GNSS is navigated on.
    fn take_fix(&mut self, now: AutopilotTime, reading: &FixReading) {
        let facts = self.sources.facts(&self.core);
        let context = Context { core: &self.core, facts };
        // Rotors shake all the time; what a wing's accelerometers are off by comes with its manoeuvres, and is noise of those.
        let shaken = context.core.vehicle.is(Airframe::Multirotor);
        self.sources.gnss.weigh_inertia(reading, &context);
        let accel_density = self.sources.gnss.accel_density();
        let sigma = self.sources.gnss.sigma_of(reading);
        let core = &mut self.core;
        if shaken {
            core.estimator.believe_inertia(accel_density);
        }
        core.estimator.observer_mut().apply(&reading.innovation);
        if let Some(v) = &reading.velocity_ne {
            core.estimator.weigh_headings(now, reading.measured, v, sigma[1], &facts);
        }
        let observation = Observation::Fix {
            measured: reading.measured,
            position_error: reading.position_error,
            velocity_error: reading.velocity_error,
            sigma,
        };
        let source = SourceId { kind: SourceKind::Gnss, id: self.sources.gnss.receiver() };
        let fused = self.fuse(now, source, &observation);
        let locked_out = self.core.estimator.is_locked_out(now, &fused);
        if locked_out && self.core.mode == Mode::Aided {
            // GNSS is trusted and the filter will not have it: then the filter is wrong.
            if self.core.estimator.is_led(&facts, now) {
                // The observer knows no better: it only follows.
                self.reset(&Reset::StreamBroken);
                self.core.broken_off(now, TransitionReason::HeadingWrong);
            } else {
                self.core.start_at_fixes(now, reading.position_error.norm(), &facts);
            }
        }
    }

    /// GNSS is trusted again: the estimate moves to it at once, the published position stays and glides after it.
    fn rejoin(&mut self, now: AutopilotTime, reading: &FixReading) {
        let feels = !self.core.witnesses.inertia.is_out();
        if feels && self.core.estimator.yaw_sigma().is_some_and(|sigma| sigma > LOST_YAW) {
            // No correction that is linear finds a heading that may be any: it is sought as at the start.
            self.reset(&Reset::StreamBroken);
            self.core.change_mode(now, Mode::Aligning, TransitionReason::HeadingLost);
            return;
        }
        let facts = self.sources.facts(&self.core);
        if let Some(sigma_m) = self.core.horizontal_sigma_m(&facts) {
            self.core.witnesses.unexplained.came_back(now, &reading.position_error.xy(), sigma_m);
        }
        self.core.go_to(now, reading);
    }

    /// The receiver's latency shows in how its velocity lags behind what inertia felt.
    fn learn_gnss_latency(&mut self, reading: &FixReading) {
        let timeline = &self.core.timeline;
        let felt = (timeline.epoch(), self.sources.gnss.accel_density());
        let latency = &mut self.sources.gnss.latency;
        match &reading.velocity_ne {
            Some(v) if self.core.mode == Mode::Aided => {
                let impulse = |time| timeline.impulse(time).map(|i| i.xy());
                latency.observe(reading.measured, v, felt, impulse);
            }
            _ => latency.interrupt(),
        }
    }

    pub(super) fn flow(&mut self, s: &FlowSample) -> Verdict {
        let settings = &self.core.settings.flow;
        if let Err(reason) = self.sources.flow.admit(s, settings) {
            return Verdict::Rejected(reason);
        }
        if settings.patches.find(s.sensor).is_some() {
            return self.patch(s);
        }
        let context = Context { core: &self.core, facts: self.sources.facts(&self.core) };
        let (s, found) = match flow::in_radians(&mut self.sources.flow, s, &context) {
            Ok(told) => told,
            Err(reason) => return Verdict::Rejected(reason),
        };
        if let Some(unit) = found {
            self.core.events.tell(s.time, EventKind::FlowUnit(s.sensor, unit));
        }
        let s = &s;
        match self.sources.flow.sensor_of(s, &self.core.settings.flow) {
            Ok(index) if flow_judge::repeats(&mut self.core, &mut self.sources, s, index) => {
                Verdict::Rejected(Reason::Stuck)
            }
            Ok(index) => self.take_flow(s.time, index, FlowInput::Patch(s)),
            Err(reason) => Verdict::Rejected(reason),
        }
    }

    /// A patch of an image has come.
    fn patch(&mut self, s: &FlowSample) -> Verdict {
        let Some(now) = self.core.stream.newest() else { return Verdict::Rejected(Reason::NoReferenceYet) };
        match self.sources.flow.image.arrival(s, &self.core.settings.flow) {
            Err(reason) => return Verdict::Rejected(reason),
            Ok(PatchArrival::Later) => {
                let verdict = self.solve_image();
                self.count_patches(verdict, None);
            }
            Ok(PatchArrival::Fits) => {}
        }
        match self.sources.flow.image.add(s, now, &self.core.settings.flow) {
            Err(reason) => Verdict::Rejected(reason),
            Ok(false) => Verdict::Waiting,
            Ok(true) => {
                let verdict = self.solve_image();
                // The one in hand is counted by whoever brought it.
                self.count_patches(verdict, Some(s.sensor));
                verdict
            }
        }
    }

    /// Time goes on: an image whose rest does not come is solved without it.
    pub(super) fn image_waited(&mut self, now: AutopilotTime) {
        if self.sources.flow.image.has_waited(now) {
            let verdict = self.solve_image();
            self.count_patches(verdict, None);
        }
    }

    fn solve_image(&mut self) -> Verdict {
        let settings = &self.core.settings.flow;
        let camera = settings.patches.camera_id().and_then(|id| self.sources.flow.sensor(id, settings));
        match (camera, self.sources.flow.image.stamp()) {
            (None, _) => Verdict::Rejected(Reason::Redundant),
            (_, None) => Verdict::Rejected(Reason::NotUsed),
            (Some(index), Some(stamp)) => self.take_flow(stamp, index, FlowInput::Image),
        }
    }

    /// Counts the patches of an image by its verdict, but for the one in hand, and begins the next.
    fn count_patches(&mut self, verdict: Verdict, in_hand: Option<u8>) {
        let statuses = &mut self.core.statuses;
        self.sources.flow.image.solved(verdict, |s, verdict| {
            if in_hand != Some(s.sensor) {
                statuses.count(SourceId { kind: SourceKind::Flow, id: s.sensor }, s.time, verdict);
            }
        });
    }

    /// What a flow velocity is for depends on the mode.
    fn take_flow(&mut self, stamp: AutopilotTime, index: usize, input: FlowInput<'_>) -> Verdict {
        if self.core.estimator.is_settling() {
            return Verdict::Rejected(Reason::NoReferenceYet);
        }
        let context = Context { core: &self.core, facts: self.sources.facts(&self.core) };
        let measured = match self.sources.flow.observe(stamp, index, input, &context) {
            Ok(measured) => measured,
            Err(reason) => return Verdict::Rejected(reason),
        };
        if let Err(reason) = flow_judge::weigh(&mut self.core, &mut self.sources, &measured, index) {
            return Verdict::Rejected(reason);
        }
        let context = Context { core: &self.core, facts: self.sources.facts(&self.core) };
        let gnss = &mut self.sources.gnss;
        let doubted = gnss.doubts() || self.core.dead_reckoning();
        self.sources.flow.testify(&measured, index, &mut gnss.travel, doubted, &context);
        if let Some(by) = gnss.travel.take_recalibration() {
            gnss.witness.recalibrate(&by);
        }
        let taken = match self.core.mode {
            Mode::Aligning => {
                self.sources.flow.hold_direction(&measured, index, &context);
                Ok(())
            }
            Mode::Aided | Mode::Rejoining => self.compare_flow(&measured, index),
            Mode::Holdover | Mode::Lost => self.carry_flow(&measured, index),
        };
        taken.map_or_else(Verdict::Rejected, |()| Verdict::Used)
    }

    fn flow_id(&self, index: usize) -> SourceId {
        SourceId { kind: SourceKind::Flow, id: self.sources.flow.id(index) }
    }

    /// GNSS is there: the sensor is compared with it, and helps where it is trusted.
    fn compare_flow(&mut self, m: &MeasuredFlow, index: usize) -> Result<(), Reason> {
        let context = Context { core: &self.core, facts: self.sources.facts(&self.core) };
        let compared = self.sources.flow.compare(m, index, &context)?;
        let now = self.core.stream.newest().unwrap_or(m.time);
        if let Some(observation) = &compared.observation {
            self.fuse(now, self.flow_id(index), observation);
        }
        if let Some(event) = compared.event {
            self.core.events.tell(m.time, event);
        }
        Ok(())
    }

    /// GNSS is gone: the flow carries the velocity.
    fn carry_flow(&mut self, m: &MeasuredFlow, index: usize) -> Result<(), Reason> {
        let context = Context { core: &self.core, facts: self.sources.facts(&self.core) };
        let carry = self.sources.flow.carry(m, index, &context)?;
        let now = self.core.stream.newest().unwrap_or(m.time);
        if let Some(observation) = &carry.observation {
            let fused = self.fuse(now, self.flow_id(index), observation);
            if fused.gated(Measured::Flow) && carry.patient {
                self.sources.flow.outlier(index, m.interval_s);
                return Err(Reason::Innovation);
            }
        }
        let observer = self.core.estimator.observer_mut();
        if !observer.predictor().is_running() {
            let v_ned = m.r_body_to_ned * carry.v_body;
            if !observer.restart_signal(now, &v_ned) {
                return Err(Reason::NoReferenceYet);
            }
        } else if let Some(innovation) = observer.predictor().innovation(&carry.signal) {
            let e = horizontal(&innovation.velocity_ned).unwrap_or_default();
            if e.norm() > carry.gate_mps && carry.patient {
                self.sources.flow.outlier(index, m.interval_s);
                return Err(Reason::Innovation);
            }
            observer.apply(&innovation);
        }
        // A flow from before the signal began corrects it no more; it has carried all the same.
        self.sources.flow.carried(index, m.time, carry.v_body);
        self.core.outage.carried_by_flow(&carry.by);
        Ok(())
    }
}
