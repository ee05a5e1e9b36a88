//! GNSS receivers: which one is listened to, how old its fixes are, and what a fix is compared with.

use nalgebra::{Vector2, Vector3};

use crate::observer::{FixSample, Innovation};
use crate::sample::{GnssFix, GnssSample};
use crate::time::{AutopilotTime, Span};

use super::super::context::Context;
use super::super::memory::ReceiverMemory;
use super::super::monitor::flow_travel::FlowTravel;
use super::super::monitor::gnss_by_air::GnssByAir;
use super::super::monitor::gnss_by_flow::GnssByFlow;
use super::super::monitor::gnss_integrity::{FixInnovation, GnssFault, GnssIntegrity};
use super::super::monitor::velocity_step::VelocitySteps;
use super::super::reset::Reset;
use super::super::settings::GnssSettings;
use super::super::solution::VelocitySource;
use super::super::timeline::CORRECTED_S;
use super::agreement::Agreement;
use super::gnss_latency::GnssLatency;
use super::held_course::HeldCourse;
use super::inertial_noise::InertialNoise;
use crate::navigator::tuning::gnss::{
    CLAIM_GAIN, DOUBTFUL_MPS, LATENCY_JITTER_S, LEAST_SPEED_SIGMA, RECEIVER_SILENCE_S, UNCLAIMED_SPEED_SIGMA,
    VERTICAL_RATIO,
};

/// What a sample's receiver is to the one that is listened to.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(in super::super) enum ReceiverChoice {
    /// The same.
    Same,
    /// It takes over.
    Another,
    /// It waits.
    Redundant,
}

/// See the module's documentation.
#[derive(Clone, Debug)]
pub(in super::super) struct GnssSource {
    receiver: u8,
    heard: Option<AutopilotTime>,
    pub(in super::super) latency: GnssLatency,
    inertia: InertialNoise,
    /// Horizontal standard deviation as the receiver claims it of late, m.
    sigma_m: f64,
    /// How far the flow says that it has travelled.
    pub(in super::super) travel: FlowTravel,
    /// And what that says of the receiver.
    pub(in super::super) witness: GnssByFlow,
    /// Its velocity against inertia.
    pub(in super::super) steps: VelocitySteps,
    /// What is known of the receiver that is not listened to.
    pub(in super::super) spare: GnssIntegrity,
    /// Where the last fix lay from the estimate, NE, m.
    error: Option<(AutopilotTime, Vector2<f64>)>,
    agreement: Agreement,
    /// The air's word on it.
    pub(in super::super) air: GnssByAir,
    /// What of the velocities is none.
    course: HeldCourse,
}

/// A fix in the local frame, and what was expected of it.
#[derive(Clone, Copy, Debug)]
pub(in super::super) struct FixReading {
    /// As it is stamped: what lies between two of these is the receiver's own time, whatever is learned of its latency between.
    pub(in super::super) stamp: AutopilotTime,
    /// When it was measured.
    pub(in super::super) measured: AutopilotTime,
    /// NED, m.
    pub(in super::super) position_ned: Vector3<f64>,
    /// NE, m/s, if the fix has one.
    pub(in super::super) velocity_ne: Option<Vector2<f64>>,
    /// Against the measurement signal.
    pub(in super::super) innovation: Innovation,
    /// Against the estimate of its time: the filter's, or in dead reckoning the observer's; with GNSS the observer follows the measurement
    /// signal. NE, m and m/s.
    pub(in super::super) position_error: Vector2<f64>,
    pub(in super::super) velocity_error: Option<Vector2<f64>>,
    /// Horizontal and vertical standard deviation that it claims, m.
    pub(in super::super) claimed_m: f64,
    pub(in super::super) vertical_sigma_m: f64,
    /// Of the speed, as claimed, m/s.
    pub(in super::super) speed_claimed_mps: Option<f64>,
}

impl FixReading {
    /// Standard deviations of position and velocity where it is one of many.
    pub(in super::super) fn sigma(&self) -> [f64; 2] {
        [self.claimed_m, self.speed_claimed_mps.unwrap_or(0.0).max(LEAST_SPEED_SIGMA)]
    }

    /// The same where it is the first after an outage.
    pub(in super::super) fn sigma_on_return(&self) -> [f64; 2] {
        [self.claimed_m, self.speed_claimed_mps.unwrap_or(UNCLAIMED_SPEED_SIGMA)]
    }
}

impl GnssSource {
    pub(super) fn new(settings: &GnssSettings, accel_noise: f64) -> Self {
        Self {
            receiver: 0,
            heard: None,
            latency: GnssLatency::new(settings.delay_s, settings.delay_sigma_s),
            inertia: InertialNoise::new(accel_noise),
            sigma_m: settings.default_accuracy_m,
            travel: FlowTravel::new(),
            witness: GnssByFlow::new(),
            steps: VelocitySteps::new(),
            spare: GnssIntegrity::new(settings.trust),
            error: None,
            agreement: Agreement::new(),
            air: GnssByAir::new(),
            course: HeldCourse::default(),
        }
    }

    /// Horizontal standard deviation, m.
    pub(super) fn sigma_m(&self) -> f64 {
        self.sigma_m.hypot(0.5 * self.agreement.apart_m())
    }

    /// The receiver that is listened to.
    pub(in super::super) fn receiver(&self) -> u8 {
        self.receiver
    }

    /// Whether this sample's receiver is listened to.
    pub(in super::super) fn select(&mut self, s: &GnssSample) -> ReceiverChoice {
        if s.receiver == self.receiver {
            return ReceiverChoice::Same;
        }
        let silent = self.heard.is_none_or(|t| s.time.seconds_since(t) > RECEIVER_SILENCE_S);
        if !silent || s.fix < GnssFix::ThreeD {
            return ReceiverChoice::Redundant;
        }
        self.use_receiver(s.receiver);
        ReceiverChoice::Another
    }

    /// What the receiver tells, less what it does not know.
    pub(in super::super) fn sift(&mut self, s: &GnssSample) -> GnssSample {
        GnssSample { ground_velocity: self.course.velocity(s), ..*s }
    }

    /// Another receiver is listened to from now on.
    pub(in super::super) fn use_receiver(&mut self, receiver: u8) {
        self.receiver = receiver;
        self.latency.interrupt();
        self.inertia.interrupt();
        self.witness.acquit();
        self.steps.forget();
        self.error = None;
        self.agreement.end();
        self.air.interrupt();
    }

    /// Whether it may lie with position and velocity together: nothing that testifies about it is to be learned from it.
    pub(in super::super) fn doubts(&self) -> bool {
        self.witness.doubts() || self.steps.is_doubted()
    }

    /// Whether the two receivers are too far apart at present.
    pub(in super::super) fn disagrees(&self) -> bool {
        self.agreement.apart_m() > 0.0
    }

    /// Whether a fix of the other receiver and the last of this one are further apart than is usual; `None` where they cannot be compared.
    pub(in super::super) fn compare(&mut self, spare: &FixReading) -> Option<bool> {
        let (time, error) = self.error?;
        let late = spare.measured.seconds_since(time).abs() > RECEIVER_SILENCE_S;
        if late || self.witness.doubts() {
            return None;
        }
        let apart_m = (spare.position_error - error).norm();
        self.agreement.compare(spare.measured, apart_m, self.sigma_m.hypot(spare.claimed_m))
    }

    /// It had a fix.
    pub(in super::super) fn had_fix(&mut self, s: &GnssSample) {
        self.heard = Some(s.time);
    }

    /// When a fix was measured.
    ///
    /// # Errors
    /// [`GnssFault::Untimely`] when that is longer ago than corrections are carried back.
    pub(in super::super) fn measured(
        &self,
        now: AutopilotTime,
        s: &GnssSample,
    ) -> Result<AutopilotTime, GnssFault> {
        let measured = s.time - Span::from_seconds(self.latency.latency_s());
        if now.seconds_since(measured) > CORRECTED_S { Err(GnssFault::Untimely) } else { Ok(measured) }
    }

    /// A fix of `measured`, compared with what was expected. The predictor has to run.
    ///
    /// # Errors
    /// [`GnssFault::Untimely`] when nothing is remembered of its time.
    pub(in super::super) fn observe(
        &self,
        s: &GnssSample,
        measured: AutopilotTime,
        position_ned: Vector3<f64>,
        context: &Context<'_>,
    ) -> Result<FixReading, GnssFault> {
        let settings = &context.core.settings;
        let v = s.ground_velocity.map(|g| g.north_east());
        let mut sample = FixSample::position(measured, &position_ned).without_vertical_position();
        if let Some((north, east)) = v.filter(|_| settings.observer.gnss_velocity) {
            sample = sample.with_horizontal_velocity(north, east);
        }
        let innovation = context.core.estimator.observer().predictor().innovation(&sample);
        let innovation = innovation.ok_or(GnssFault::Untimely)?;
        let velocity_ne = v.map(|(north, east)| Vector2::new(north, east));
        let (position_error, velocity_error) =
            errors(&innovation, measured, &position_ned, velocity_ne, context);
        let claimed_m = s.horizontal_accuracy_m.unwrap_or(settings.gnss.default_accuracy_m);
        Ok(FixReading {
            stamp: s.time,
            measured,
            position_ned,
            velocity_ne,
            innovation,
            position_error,
            velocity_error,
            claimed_m,
            vertical_sigma_m: s.vertical_accuracy_m.unwrap_or(claimed_m * VERTICAL_RATIO),
            speed_claimed_mps: s.speed_accuracy_mps,
        })
    }

    /// The fix passed every test: what it claims is what the receiver is worth.
    pub(in super::super) fn accepted(&mut self, reading: &FixReading) {
        self.sigma_m += CLAIM_GAIN * (reading.claimed_m - self.sigma_m);
        self.error = Some((reading.measured, reading.position_error));
    }

    /// How noisy accelerometers are beside it, m/s²/√Hz.
    pub(in super::super) fn accel_density(&self) -> f64 {
        self.inertia.density()
    }

    /// A fix that is navigated on is set against what inertia felt.
    pub(in super::super) fn weigh_inertia(&mut self, reading: &FixReading, context: &Context<'_>) {
        let timeline = &context.core.timeline;
        let impulse = timeline.impulse(reading.measured).map(|i| (i.xy(), timeline.epoch()));
        match &reading.velocity_ne {
            Some(v) => self.inertia.observe(reading.stamp, v, impulse),
            None => self.inertia.interrupt(),
        }
    }

    /// Standard deviations of position and velocity of a fix that is navigated on, m and m/s: its velocity is worth no more than how it fits what inertia feels.
    pub(in super::super) fn sigma_of(&self, reading: &FixReading) -> [f64; 2] {
        let [position, velocity] = reading.sigma();
        [position, velocity.max(self.inertia.between_fixes_mps())]
    }

    /// What was learned of the receiver.
    pub(in super::super) fn memory(&self) -> ReceiverMemory {
        ReceiverMemory {
            receiver: self.receiver,
            sigma_m: self.sigma_m,
            latency_s: [self.latency.latency_s(), self.latency.sigma_s()],
        }
    }

    /// It is what it was. False where no receiver is like that.
    pub(in super::super) fn recall(&mut self, memory: &ReceiverMemory) -> bool {
        if !(1e-3..=1e4).contains(&memory.sigma_m) {
            return false;
        }
        (self.receiver, self.sigma_m) = (memory.receiver, memory.sigma_m);
        self.latency.recall(memory.latency_s);
        true
    }

    pub(super) fn reset(&mut self, reset: &Reset) {
        if reset.breaks_motion() || *reset == Reset::Bridged {
            self.latency.interrupt();
            self.inertia.interrupt();
        }
        self.spare.reset(reset);
        self.witness.interrupt();
        self.travel.interrupt();
        self.air.interrupt();
        self.error = None;
        if reset.sets_clock_back() {
            self.heard = None;
        }
    }
}

/// Horizontal position and velocity errors of a fix against the estimate at its time.
fn errors(
    innovation: &Innovation,
    measured: AutopilotTime,
    p: &Vector3<f64>,
    v: Option<Vector2<f64>>,
    context: &Context<'_>,
) -> (Vector2<f64>, Option<Vector2<f64>>) {
    let core = context.core;
    if core.estimator.is_filtered()
        && let Some((past_p, past_v)) = core.timeline.motion(measured).or_else(|| core.estimator.estimate())
    {
        return ((p - past_p).xy(), v.map(|v| v - past_v.xy()));
    }
    let observer = core.estimator.observer();
    let lag = match (observer.predictor().latest(), observer.state()) {
        (Some(w), Some(state)) if core.dead_reckoning() => (w.position_ned - state.position_ned).xy(),
        _ => Vector2::zeros(),
    };
    let position = horizontal(&innovation.position_ned).map_or(Vector2::zeros(), |e| e + lag);
    (position, horizontal(&innovation.velocity_ned))
}

/// How far the fix lies from what was expected, and how well that was known.
pub(in super::super) fn expectation(reading: &FixReading, context: &Context<'_>) -> FixInnovation {
    let (core, facts) = (context.core, &context.facts);
    let mut expected = FixInnovation {
        position_m: reading.position_error.norm(),
        velocity_mps: reading.velocity_error.map(|e| e.norm()),
        position_sigma_m: 0.0,
        velocity_sigma_mps: 0.0,
        drift_sigma_m: 0.0,
        aided: core.integrity.trusted() && !core.dead_reckoning(),
        carried: matches!(core.outage.source(), VelocitySource::Flow | VelocitySource::Landmarks),
        speed_mps: 0.0,
    };
    let Some((_, v)) = core.estimator.estimate() else { return expected };
    expected.speed_mps = v.xy().norm();
    expected.position_sigma_m = expected.speed_mps * LATENCY_JITTER_S;
    let acceleration = core.timeline.acceleration(reading.measured).map_or(0.0, |a| a.xy().norm());
    expected.velocity_sigma_mps = acceleration * LATENCY_JITTER_S;
    // With GNSS the receiver's own wander is what is expected; but after a hole in the stream the doubt is ours.
    let doubtful = core.estimator.speed_sigma().is_some_and(|sigma| sigma > DOUBTFUL_MPS);
    if core.dead_reckoning() || doubtful {
        let (p, v) = core.covariances(facts);
        // What is in dispute is no reason to believe the receiver sooner.
        let [apart, parting] = core.disputed(facts);
        let position = (p[(0, 0)] + p[(1, 1)] - 2.0 * apart).max(0.0);
        expected.position_sigma_m = position.sqrt().hypot(expected.position_sigma_m);
        expected.velocity_sigma_mps =
            (v[(0, 0)] + v[(1, 1)] - 2.0 * parting).max(0.0).sqrt().hypot(expected.velocity_sigma_mps);
        expected.drift_sigma_m = (position - 2.0 * facts.gnss_sigma_m.powi(2)).max(0.0).sqrt();
    }
    expected
}

/// North and east, if both are there.
pub(in super::super) fn horizontal(v: &[Option<f64>; 3]) -> Option<Vector2<f64>> {
    Some(Vector2::new(v[0]?, v[1]?))
}
