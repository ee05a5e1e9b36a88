//! The magnetometer: heard while its field has the strength of the place, and while it turns when the vehicle does.

use nalgebra::Vector3;

use crate::geo::so3;
use crate::sample::MagSample;
use crate::time::{AutopilotTime, Span};

use super::super::context::Context;
use super::super::core::Core;
use super::super::judge::Charge;
use super::super::observation::Observation;
use super::super::reset::Reset;
use super::super::solution::Mode;
use super::super::verdict::Reason;
use super::compass_step::{ComparedField, StepWatch};
use super::magnetic_latency::MagneticLatency;
use super::magnetic_noise::MagneticNoise;
use super::status::{SourceHealth, SourceId, SourceKind};
use crate::navigator::tuning::compass_step::{KNOWN_YAW, LONGEST_GAP_S};
use crate::navigator::tuning::every_source::LATE_S;
use crate::navigator::tuning::magnetic_latency::{SIGMA_S, SIGMAS};
use crate::navigator::tuning::magnetometer::{
    AGREES, AGREES_S, DIP_LEAST_S, DIP_MEAN_S, FEELS_GRAVITY, LARGEST_DIP, STUCK_LOOK_S, STUCK_RATE, STUCK_S,
    STUCK_TURN, STUCK_UNKNOWN_RATE,
};

const IMU: SourceId = SourceId::only(SourceKind::Imu);

/// The same field, told again and again.
#[derive(Clone, Copy, Debug)]
struct SameField {
    since: AutopilotTime,
    /// When it was measured: before that by the latency.
    taken: AutopilotTime,
    field: Vector3<f64>,
    /// While the vehicle turned: it is stuck.
    stuck: bool,
}

/// What the vehicle has turned by between two times, body, rad. A field may come before the IMU's sample of its time: what it had turned by until just before is as good.
fn turned(core: &Core, from: AutopilotTime, to: AutopilotTime) -> Option<Vector3<f64>> {
    let newest = core.stream.newest()?;
    let (from, to) = (from.min(newest), to.min(newest));
    Some(core.timeline.mean_rate(from, to)? * to.seconds_since(from))
}

/// Whether an axis of the IMU may be wrong.
fn doubts_gyros(core: &Core) -> bool {
    core.witnesses.jumps.suspects() || core.statuses.charge(IMU).is_some()
}

/// See the module's documentation.
#[derive(Clone, Copy, Debug)]
pub(in super::super) struct MagnetometerSource {
    newest: Option<(AutopilotTime, Vector3<f64>)>,
    /// The newest of any strength and direction, body, T.
    heard: Option<Vector3<f64>>,
    same: Option<SameField>,
    /// Mean of how much steeper it dips than Earth's field, rad, over how long, s, and since when.
    dip: (f64, f64),
    dip_heard: Option<AutopilotTime>,
    /// Motion has contradicted it, or its dip, or the gyros: with what …
    contradicted: Option<Charge>,
    /// Its heading against the gyros'.
    steps: StepWatch,
    /// … and for how long it has agreed with the heading again, s, by when.
    agreed: (f64, Option<AutopilotTime>),
    noise: MagneticNoise,
    latency: MagneticLatency,
}

impl MagnetometerSource {
    /// Noise of a sample, T, and walk of its bias, T/√s, as configured.
    pub(super) fn new(sigma_t: f64, walk_t: f64) -> Self {
        Self {
            newest: None,
            heard: None,
            same: None,
            dip: (0.0, 0.0),
            dip_heard: None,
            contradicted: None,
            steps: StepWatch::default(),
            agreed: (0.0, None),
            noise: MagneticNoise::expecting(sigma_t, walk_t),
            latency: MagneticLatency::new(),
        }
    }

    /// The newest field, body, T.
    pub(super) fn newest(&self) -> Option<(AutopilotTime, Vector3<f64>)> {
        self.newest
    }

    /// The field that the newest sample shows to whom `down_body` points to the ground, NED with north where it points, T.
    pub(in super::super) fn field_by(&self, down_body: &Vector3<f64>) -> Option<Vector3<f64>> {
        let field = self.heard?;
        let down = field.dot(down_body);
        Some(Vector3::new((field - down_body * down).norm(), 0.0, down))
    }

    pub(in super::super) fn observe(
        &mut self,
        s: &MagSample,
        context: &Context<'_>,
    ) -> Result<Observation, Reason> {
        let settings = &context.core.settings.magnetometer;
        if !settings.enabled {
            return Err(Reason::SwitchedOff);
        }
        let norm = s.field.raw().norm();
        if !norm.is_finite() {
            return Err(Reason::NotFinite);
        }
        if self.newest.is_some_and(|(t, _)| s.time < t) {
            return Err(Reason::OutOfOrder);
        }
        self.heard = Some(s.field.raw()).filter(|_| norm > 0.0);
        let field_ned = context
            .core
            .surroundings
            .environment()
            .and_then(|e| e.field_ned)
            .ok_or(Reason::NoReferenceYet)?;
        if (norm / field_ned.norm() - 1.0).abs() > settings.norm_error {
            return Err(Reason::FieldStrength);
        }
        if self.is_dipped(s, &field_ned, context) {
            // At another heading the same iron may leave the dip right, and the heading wrong.
            self.contradict(Charge::Impossible);
            return Err(Reason::FieldDirection);
        }
        if context.is_late(s.time, LATE_S) {
            return Err(Reason::Late);
        }
        if self.is_stuck(s, context) {
            return Err(Reason::Stuck);
        }
        // Another one, of whatever strength, is newer.
        let Some(same) = self.same.filter(|same| same.field == s.field.raw()) else {
            return Err(Reason::OutOfOrder);
        };
        let field_body = self.carried(&same, s, context.core);
        let late_t = self.late_t(&same, context.core);
        let moved = context.core.attitude.r_body_to_ned * late_t;
        // A field that is wrong scatters, too, and is to be judged nevertheless.
        let known = (SIGMA_S / self.latency.sigma_s()).min(1.0);
        let late = SIGMAS * known * moved.xy().norm() / field_ned.xy().norm();
        self.watch_steps(&same, late, &field_ned, context);
        if !self.is_believed((s.time, &field_body), late, &field_ned, context) {
            return Err(Reason::ContradictsMotion);
        }
        if self.steps.is_doubted() {
            return Err(Reason::Innovation);
        }
        self.newest = Some((s.time, field_body));
        // What the world's model and the mounting are off by is no noise, and no sample tells it.
        let (noise_t, walk_t) = self.noise.sigma();
        let sigma_t = noise_t.max(settings.sigma_t);
        Ok(Observation::Magnetic { field_body, field_ned, sigma_t, late_t, walk_t })
    }

    /// A field that is finite, whatever becomes of it: when it was measured, and what that tells of its noise and its latency: what is far off tells how far
    /// off the rest may be. `None` when it overtakes another.
    pub(in super::super) fn hear(&mut self, s: &MagSample, core: &Core) -> Option<AutopilotTime> {
        let raw = s.field.raw();
        // One that lies far ahead was not of this clock.
        self.same = self.same.filter(|same| same.since.seconds_since(s.time) < STUCK_LOOK_S);
        if self.same.is_some_and(|same| s.time < same.since) {
            return None;
        }
        if let Some(same) = self.same.filter(|same| same.field == raw) {
            return Some(same.taken);
        }
        let late = Span::from_seconds(self.latency.latency_s());
        // What is learned of the latency does not change the order.
        let taken = self.same.map_or(s.time - late, |same| (s.time - late).max(same.taken));
        self.same = Some(SameField { since: s.time, taken, field: raw, stuck: false });
        let field = raw - core.magnetic_bias();
        if self.contradicted.is_none() && !doubts_gyros(core) && !core.witnesses.field.suspects() {
            self.latency.observe(s.time, &field, self.noise.sigma().0, |from, to| turned(core, from, to));
        } else {
            self.latency.interrupt();
        }
        if self.noise.is_due(taken) {
            let rate = |since| Some(turned(core, since, taken)? / taken.seconds_since(since));
            self.noise.observe(taken, &field, rate, core.estimator.gyro_density());
        }
        Some(taken)
    }

    /// The latency in force, s, and by how much a field may be later or earlier, 1 sigma. `None` where none was heard.
    pub(in super::super) fn latency_s(&self) -> Option<(f64, f64)> {
        self.same.map(|_| (self.latency.latency_s(), self.latency.sigma_s()))
    }

    /// The newest field as it would be measured now, body, T.
    fn carried(&self, same: &SameField, s: &MagSample, core: &Core) -> Vector3<f64> {
        let turn = Some(same.taken).filter(|taken| s.time.seconds_since(*taken) < STUCK_LOOK_S);
        let turn = turn.and_then(|taken| turned(core, taken, s.time));
        turn.map_or(same.field, |turn| so3::exp(&-turn) * same.field)
    }

    /// What its latency may be misjudged by makes of a field, body, 1 sigma, T.
    fn late_t(&self, same: &SameField, core: &Core) -> Vector3<f64> {
        let sigma_s = self.latency.sigma_s();
        let now = core.attitude.angular_rate_body;
        let then = turned(core, same.taken - Span::from_seconds(sigma_s), same.taken);
        let then = then.map_or(now, |turn| turn / sigma_s);
        let rate = if then.norm() > now.norm() { then } else { now };
        rate.cross(&same.field) * sigma_s
    }

    /// Whether the field stands still in the body while the body turns. At rest a coarse magnetometer may tell the same for long.
    fn is_stuck(&mut self, s: &MagSample, context: &Context<'_>) -> bool {
        let Some(same) = &mut self.same else { return false };
        let core = context.core;
        let now = context.now().map_or(s.time, |now| now.min(s.time));
        let from = same.since.max(now - Span::from_seconds(STUCK_LOOK_S));
        let elapsed = now.seconds_since(from);
        // What turns slower than this may be a gyro's bias, which is not known before there is an estimate, nor soon after.
        let known = core.mode != Mode::Aligning && !context.on_ground();
        let slow = if known { STUCK_RATE } else { STUCK_UNKNOWN_RATE };
        let turned = |w: Vector3<f64>| (w.norm() - slow) * elapsed > STUCK_TURN;
        same.stuck |= elapsed > STUCK_S && core.timeline.mean_rate(from, now).is_some_and(turned);
        same.stuck
    }

    /// Whether the field dips otherwise than Earth's does here: then something on the vehicle bends it, and the heading it shows is as wrong.
    /// Down is the estimate's where there is one, and else what the accelerometers show while they feel gravity alone.
    fn is_dipped(&mut self, s: &MagSample, field_ned: &Vector3<f64>, context: &Context<'_>) -> bool {
        let core = context.core;
        let felt = core.stream.last().map(|imu| -imu.specific_force.raw());
        let gravity = core.surroundings.environment().map_or(f64::NAN, |e| e.gravity_ned.norm());
        let down_body = if core.mode != Mode::Aligning {
            Some(core.attitude.r_body_to_ned.row(2).transpose())
        } else {
            felt.filter(|f| (f.norm() / gravity - 1.0).abs() < FEELS_GRAVITY).map(|f| f.normalize())
        };
        let dt = self.dip_heard.replace(s.time).map_or(0.0, |t| s.time.seconds_since(t)).clamp(0.0, 1.0);
        // After a hole in the stream the attitude says nothing until it is found again.
        if let Some(down) = down_body.filter(|_| !core.estimator.is_settling()) {
            let dip = |field: &Vector3<f64>, down: &Vector3<f64>| (field.dot(down) / field.norm()).asin();
            let steeper = dip(&s.field.raw(), &down) - dip(field_ned, &Vector3::z());
            // The plain mean at first, a low pass later.
            let (mean, over_s) = &mut self.dip;
            *over_s = (*over_s + dt).min(DIP_MEAN_S);
            *mean += (steeper - *mean) * (dt / over_s.max(1e-3)).min(1.0);
        }
        let (mean, over_s) = self.dip;
        over_s > DIP_LEAST_S && mean.abs() > LARGEST_DIP
    }

    /// The heading of the field against the gyros', while the attitude is known.
    fn watch_steps(&mut self, same: &SameField, late: f64, field_ned: &Vector3<f64>, context: &Context<'_>) {
        let core = context.core;
        let known = core.mode != Mode::Aligning
            && !core.estimator.is_settling()
            && !core.witnesses.inertia.is_doubted()
            && core.estimator.yaw_sigma().is_some_and(|sigma| sigma < KNOWN_YAW);
        let attitude = core.timeline.attitude(same.taken).unwrap_or(core.attitude.r_body_to_ned);
        if !known || self.contradicted.is_some() {
            return self.steps.forget();
        }
        let heard = ComparedField {
            time: same.taken,
            field: same.field - core.magnetic_bias(),
            late,
            r_body_to_ned: attitude,
            // What an axis of the gyros makes of a turn is not the compass' fault.
            judged: !context.on_ground() && !core.witnesses.field.suspects(),
            gyros_doubted: doubts_gyros(core),
            horizontal_t: field_ned.xy().norm(),
            turned: &|since| turned(core, since, same.taken),
        };
        if self.steps.observe(&heard).is_some() {
            self.contradict(Charge::ContradictsInertia);
        }
    }

    /// What has contradicted it, until it is believed again.
    pub(in super::super) fn contradicted(&self) -> Option<Charge> {
        self.contradicted
    }

    /// Motion shows another heading than it does, or its own field cannot be right.
    pub(in super::super) fn contradict(&mut self, charge: Charge) {
        self.newest = None;
        self.contradicted.get_or_insert(charge);
        self.agreed = (0.0, None);
    }

    /// Whether it is believed again: it has agreed with the heading for long enough.
    pub(in super::super) fn takes_back(&mut self) -> bool {
        self.agreed.0 > AGREES_S && self.contradicted.take().is_some()
    }

    /// Whether motion has not contradicted it; if it has, the field is set against the heading that motion has shown. What its latency may make of a turn, `late`
    /// rad, tells nothing either way.
    fn is_believed(
        &mut self,
        (time, field_body): (AutopilotTime, &Vector3<f64>),
        late: f64,
        field_ned: &Vector3<f64>,
        context: &Context<'_>,
    ) -> bool {
        if self.contradicted.is_none() {
            return true;
        }
        let seen = context.core.attitude.r_body_to_ned * field_body;
        let angle = (seen.x * field_ned.y - seen.y * field_ned.x).atan2(seen.xy().dot(&field_ned.xy())).abs();
        // Before there is a heading to set it against, a dip that is right has to do.
        let agrees = angle < AGREES || context.core.mode == Mode::Aligning;
        let (seconds, by) = self.agreed;
        let dt = by.map_or(0.0, |by| time.seconds_since(by)).clamp(0.0, LONGEST_GAP_S);
        let seconds = match agrees {
            true => seconds + dt,
            false if angle < AGREES + late => seconds,
            false => 0.0,
        };
        self.agreed = (seconds, Some(time));
        false
    }

    /// What is known against it.
    pub(super) fn health(&self) -> SourceHealth {
        let faulty = self.same.is_some_and(|s| s.stuck)
            || self.contradicted.is_some()
            || self.dip.0.abs() > LARGEST_DIP;
        if faulty { SourceHealth::Faulty } else { SourceHealth::Healthy }
    }

    pub(super) fn reset(&mut self, reset: &Reset) {
        if reset.reboots() {
            self.newest = None;
            self.contradicted = None;
            self.steps = StepWatch::default();
            self.dip = (0.0, 0.0);
            self.noise.interrupt();
            self.latency.interrupt();
        }
        if reset.sets_clock_back() {
            self.same = None;
        }
    }
}
