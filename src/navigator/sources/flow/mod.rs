//! Optical flow: compared with GNSS while there is GNSS, the carrier of the velocity when there is none.

mod charged;
mod image;
mod measure;
mod repeats;
mod unit;
mod witness;

use nalgebra::{Matrix2, Matrix4, Vector2, Vector3, Vector4};

use crate::camera::{CalibrationMemory, Distrust, FlowCalibration, ReferenceVelocity};
use crate::observer::fusini::update_flow_bias;
use crate::observer::{FixSample, FusiniBiases, ObserverState};
use crate::sample::{FlowRotation, FlowSample};
use crate::time::AutopilotTime;

use super::super::context::Context;
use super::super::core::Core;
use super::super::event::EventKind;
use super::super::memory::FlowMemory;
use super::super::monitor::flow_travel::FlowTravel;
use super::super::monitor::outage::CarriedBy;
use super::super::monitor::travel_path::TravelTestimony;
use super::super::observation::Observation;
use super::super::reset::Reset;
use super::super::settings::{Estimator, FlowBiasSource, FlowSettings};
use super::super::solution::Mode;
use super::super::verdict::Reason;
use super::latency::FlowLatency;
use super::status::{SourceHealth, SourceId, SourceKind};
use crate::navigator::tuning::flow::{
    FASTEST_RADPS, FASTEST_UNITS, FIRST_INTERVAL_S, GATE_SIGMA, GYRO_OFFSET_S, GYRO_OFFSET_SIGMA,
    LATENCY_STEP_S, LONGEST_INTERVAL_S, MAX_SENSORS, RELOCK_S, SIGNAL_VARIANCE,
};
use crate::navigator::tuning::flow_travel::NO_WALK_MPS;
pub(in super::super) use charged::FlowFinding;
use charged::{Astray, HeadingByGyro, KeptCalibration, ScaledBy};
use image::ImageAssembly;
pub(in super::super) use image::PatchArrival;
use measure::FlowCorrection;
pub(in super::super) use measure::MeasuredFlow;
use repeats::{RepeatScene, RepeatWatch};
use unit::FlowUnit;
pub(in super::super) use unit::in_radians;
use witness::InertialWitness;

/// One flow sensor.
#[derive(Clone, Debug)]
pub(in super::super) struct FlowSensor {
    id: u8,
    calibration: FlowCalibration,
    /// The velocity bias as Fusini finds it, where that is wanted instead of the calibration.
    biases: FusiniBiases,
    trust: Result<(), Distrust>,
    latency: FlowLatency,
    /// Bias of its own gyro, camera x and y, rad/s, and for how long that has been compared with the vehicle's, s.
    gyro_offset: (Vector2<f64>, f64),
    last: Option<AutopilotTime>,
    outliers_s: f64,
    repeats: RepeatWatch,
    witness: InertialWitness,
    /// How far it has gone from inertia, while that is held against it.
    astray: Option<Astray>,
    /// Its errors [b_x, b_y, s, μ] and the variance of the last two together, by which it was weighed last.
    errors: (Vector4<f64>, f64),
    kept: KeptCalibration,
    heading: HeadingByGyro,
    scaled_by: ScaledBy,
}

impl FlowSensor {
    fn new(id: u8, settings: &FlowSettings) -> Self {
        Self {
            id,
            calibration: FlowCalibration::new(settings.calibration),
            biases: FusiniBiases::default(),
            trust: Err(Distrust::NotCompared),
            latency: FlowLatency::new(settings.delay_s, settings.delay_sigma_s),
            gyro_offset: (Vector2::zeros(), 0.0),
            last: None,
            outliers_s: 0.0,
            repeats: RepeatWatch::default(),
            witness: InertialWitness::new(),
            astray: None,
            errors: (Vector4::zeros(), 0.0),
            heading: HeadingByGyro::default(),
            scaled_by: ScaledBy::default(),
            kept: KeptCalibration {
                since: None,
                older: FlowCalibration::new(settings.calibration),
                newer: FlowCalibration::new(settings.calibration),
            },
        }
    }

    /// Whether it may carry: GNSS has proven it, or there was never a GNSS to prove it by, and its errors are those of any such sensor.
    fn may_carry(&self, core: &Core) -> bool {
        if self.astray.is_some() {
            return false;
        }
        match self.trust {
            Ok(()) => true,
            Err(Distrust::NotCompared) => core.integrity.never_good(),
            Err(_) => false,
        }
    }

    /// What is known of it besides its calibration. The vehicle's gyros have a bias as well, known to some σ: of the mean offset m only what
    /// exceeds that is the sensor's, (1 − σ²/|m|²)⁺ m (James and Stein's estimator of a mean).
    fn correction(&self) -> FlowCorrection {
        let mean = self.gyro_offset.0;
        let part = (1.0 - (GYRO_OFFSET_SIGMA / mean.norm().max(1e-12)).powi(2)).max(0.0);
        FlowCorrection { delay_s: self.latency.latency_s(), gyro_offset: mean * part }
    }

    /// Its own gyro against the vehicle's, whose bias is known: at first the plain mean, a low pass later.
    fn compare_gyros(&mut self, offset: &Vector2<f64>, interval_s: f64) {
        let (mean, compared_s) = &mut self.gyro_offset;
        *compared_s = (*compared_s + interval_s).min(GYRO_OFFSET_S);
        *mean += (offset - *mean) * (interval_s / *compared_s).min(1.0);
    }

    /// Time since its last sample, s.
    fn interval_s(&self, stamp: AutopilotTime) -> f64 {
        self.last.map_or(FIRST_INTERVAL_S, |t| stamp.seconds_since(t)).min(LONGEST_INTERVAL_S)
    }

    /// The flow velocity as the observers are to see it, body x and y, m/s.
    fn corrected(&self, m: &MeasuredFlow, form: FlowBiasSource) -> Vector2<f64> {
        match form {
            FlowBiasSource::Calibration => self.calibration.correct(&m.v_xy, m.distance_m),
            FlowBiasSource::Body | FlowBiasSource::AsPrinted => m.v_xy - self.biases.flow_velocity.xy(),
        }
    }

    fn observation(&self, m: &MeasuredFlow, form: FlowBiasSource) -> Observation {
        Observation::Flow {
            measured: m.time,
            v_xy: m.v_xy,
            corrected_xy: self.corrected(m, form),
            distance_m: m.distance_m,
            r_body_to_ned: m.r_body_to_ned,
            covariance: m.noise * self.calibration.noise_factor(),
        }
    }
}

/// See the module's documentation.
#[derive(Clone, Debug)]
pub(in super::super) struct FlowSource {
    sensors: Vec<FlowSensor>,
    pub(in super::super) image: ImageAssembly,
    /// Of the sensors that tell in a unit of their own, by their id.
    units: Vec<(u8, FlowUnit)>,
    /// Corrected flow velocity in body axes, for the velocity triad, and its time.
    velocity_body: Option<(AutopilotTime, Vector3<f64>)>,
}

/// What is to be measured.
#[derive(Clone, Copy, Debug)]
pub(in super::super) enum FlowInput<'a> {
    /// A sensor's own velocity.
    Patch(&'a FlowSample),
    /// The image that has been gathered.
    Image,
}

/// What a comparison with GNSS gives.
#[derive(Clone, Copy, Debug)]
pub(in super::super) struct Comparison {
    /// For the estimator, if this is the sensor that it uses.
    pub(in super::super) observation: Option<Observation>,
    /// Trust was won or lost.
    pub(in super::super) event: Option<EventKind>,
}

/// A flow velocity that is to carry.
#[derive(Clone, Copy, Debug)]
pub(in super::super) struct Carry {
    /// For the estimator, if this is the sensor that it uses.
    pub(in super::super) observation: Option<Observation>,
    /// It is an outlier where it does not fit; else, after so many of them, it is the velocity that is wrong.
    pub(in super::super) patient: bool,
    /// For the observers' signal.
    pub(in super::super) signal: FixSample,
    pub(in super::super) v_body: Vector3<f64>,
    /// Innovations of the signal beyond this are outliers, m/s.
    pub(in super::super) gate_mps: f64,
    /// For the error budget.
    pub(in super::super) by: CarriedBy,
}

impl FlowSource {
    pub(super) fn new() -> Self {
        Self { sensors: Vec::new(), image: ImageAssembly::new(), units: Vec::new(), velocity_body: None }
    }

    /// The newest corrected flow velocity, body, m/s.
    pub(super) fn velocity_body(&self) -> Option<(AutopilotTime, Vector3<f64>)> {
        self.velocity_body
    }

    /// A velocity that carries, or shows a direction.
    pub(in super::super) fn set_velocity_body(&mut self, time: AutopilotTime, v_body: Vector3<f64>) {
        self.velocity_body = Some((time, v_body));
    }

    /// Tests that need no context: a number at all, and no more than a camera sees.
    pub(in super::super) fn admit(&self, s: &FlowSample, settings: &FlowSettings) -> Result<(), Reason> {
        if !settings.enabled {
            return Err(Reason::SwitchedOff);
        }
        // Squares of what is far beyond any sensor would overflow.
        let most = if s.rotation == FlowRotation::InOwnUnit { FASTEST_UNITS } else { FASTEST_RADPS };
        if s.rate_xy.iter().any(|rate| rate.is_finite() && rate.abs() > most) {
            return Err(Reason::OutOfRange);
        }
        Ok(())
    }

    /// The sensor of a sample that is no patch of an image, if it is in order.
    pub(in super::super) fn sensor_of(
        &mut self,
        s: &FlowSample,
        settings: &FlowSettings,
    ) -> Result<usize, Reason> {
        let index = self.sensor(s.sensor, settings).ok_or(Reason::Redundant)?;
        let late = self.sensors[index].last.is_some_and(|t| s.time <= t);
        if late { Err(Reason::OutOfOrder) } else { Ok(index) }
    }

    /// Since when a sensor has repeated itself, if it does.
    pub(in super::super) fn repeats(
        &mut self,
        s: &FlowSample,
        index: usize,
        context: &Context<'_>,
    ) -> Option<AutopilotTime> {
        let sensor = &mut self.sensors[index];
        let scene = RepeatScene {
            rate_xy: measure::rotation_in(s, sensor.latency.latency_s(), context),
            noise_radps: context.core.settings.flow.rate_noise_radps,
            in_air: context.in_air(),
        };
        sensor.repeats.note(s, &scene)
    }

    /// Whether what a sensor tells can be used at present, going by inertia.
    pub(in super::super) fn stands(&self, index: usize) -> Result<(), Reason> {
        let sensor = &self.sensors[index];
        match sensor.astray {
            Some(_) => Err(Reason::ContradictsMotion),
            None if sensor.witness.is_doubted() => Err(Reason::Innovation),
            None => Ok(()),
        }
    }

    /// The place of a sensor among those that are told apart; `None` when there are too many.
    pub(in super::super) fn sensor(&mut self, id: u8, settings: &FlowSettings) -> Option<usize> {
        match self.sensors.iter().position(|f| f.id == id) {
            Some(i) => Some(i),
            None if self.sensors.len() < MAX_SENSORS => {
                self.sensors.push(FlowSensor::new(id, settings));
                Some(self.sensors.len() - 1)
            }
            None => None,
        }
    }

    /// A sensor's id.
    pub(in super::super) fn id(&self, index: usize) -> u8 {
        self.sensors[index].id
    }

    /// A flow with this stamp as a velocity. With GNSS the sensor's latency is learned on the way.
    pub(in super::super) fn observe(
        &mut self,
        stamp: AutopilotTime,
        index: usize,
        input: FlowInput<'_>,
        context: &Context<'_>,
    ) -> Result<MeasuredFlow, Reason> {
        let interval_s = self.sensors[index].interval_s(stamp);
        let correction = self.sensors[index].correction();
        let measured = self.measure(stamp, interval_s, &correction, input, context)?;
        if let Some(offset) = &measured.gyro_offset {
            self.sensors[index].compare_gyros(offset, interval_s);
        }
        if context.core.mode == Mode::Aided && self.sensors[index].latency.learns() {
            let older = FlowCorrection { delay_s: correction.delay_s + LATENCY_STEP_S, ..correction };
            match self.measure(stamp, interval_s, &older, input, context) {
                Ok(earlier) => self.learn_latency(&measured, &earlier, index, context),
                Err(_) => self.sensors[index].latency.interrupt(),
            }
        }
        self.sensors[index].last = Some(stamp);
        Ok(measured)
    }

    fn measure(
        &self,
        stamp: AutopilotTime,
        interval_s: f64,
        correction: &FlowCorrection,
        input: FlowInput<'_>,
        context: &Context<'_>,
    ) -> Result<MeasuredFlow, Reason> {
        match input {
            FlowInput::Patch(s) => measure::of_patch(s, interval_s, correction, context),
            FlowInput::Image => self.image.measure(stamp, interval_s, correction, context),
        }
    }

    /// How flow and GNSS differ, and how that would change if the flow were older.
    fn learn_latency(
        &mut self,
        now: &MeasuredFlow,
        earlier: &MeasuredFlow,
        index: usize,
        context: &Context<'_>,
    ) {
        let age = now.time.seconds_since(earlier.time);
        let velocities = gnss_velocity(now, context).zip(gnss_velocity(earlier, context));
        let Some((v_now, v_earlier)) = velocities else { return };
        if age < 0.5 * LATENCY_STEP_S {
            return;
        }
        let sensor = &mut self.sensors[index];
        let known = FlowCalibration::jacobian(&v_now, now.distance_m) * sensor.calibration.estimate();
        let residual = now.v_xy - v_now - known;
        let by_latency = ((earlier.v_xy - v_earlier) - (now.v_xy - v_now)) / age;
        let variance = 0.5 * now.noise.trace() * sensor.calibration.noise_factor();
        sensor.latency.observe(now.time, &residual, &by_latency, variance);
    }

    /// While aligning without a magnetometer the flow is the only horizontal direction in body axes.
    pub(in super::super) fn hold_direction(&mut self, m: &MeasuredFlow, index: usize, context: &Context<'_>) {
        let form = context.core.settings.observer.flow_bias;
        let corrected = self.sensors[index].corrected(m, form);
        self.set_velocity_body(m.time, m.in_body(&corrected, context.core.height.climb_mps()));
    }

    /// GNSS is there: the sensor is compared with it.
    pub(in super::super) fn compare(
        &mut self,
        m: &MeasuredFlow,
        index: usize,
        context: &Context<'_>,
    ) -> Result<Comparison, Reason> {
        self.hold_direction(m, index, context);
        let nothing = Comparison { observation: None, event: None };
        let (core, facts) = (context.core, &context.facts);
        let v_gnss = gnss_velocity(m, context).ok_or(Reason::NoReferenceYet)?;
        // While an observer still finds its heading from this very flow, its error would be learned as the flow's misalignment.
        let since = core.estimator.observer().alignment.seconds_since_attitude(m.time);
        let settled = since > core.settings.observer.start_s;
        if !core.estimator.has_error_state() && facts.magnetic.is_none() && !settled {
            return Ok(nothing);
        }
        self.filter_bias(m, index, context);
        // A distance that is not measured is wrong by the same for some time.
        let along = v_gnss * m.relative_sigma;
        let lasting = heading_doubt(&v_gnss, context) + along * along.transpose();
        let reference = ReferenceVelocity {
            v_xy: v_gnss,
            variance: core.integrity.velocity_variance(),
            renewed_s: core.integrity.interval_s(),
            lasting,
        };
        let sensor = &mut self.sensors[index];
        sensor.calibration.compare(&m.v_xy, &reference, m.distance_m, &m.noise, m.interval_s);
        let trust = sensor.calibration.trust();
        let changed = std::mem::replace(&mut sensor.trust, trust) != trust;
        let id = sensor.id;
        let event =
            trust.map_or_else(|why| EventKind::FlowDistrusted(id, why), |()| EventKind::FlowTrusted(id));
        Ok(Comparison { observation: self.observation(m, index, context), event: changed.then_some(event) })
    }

    /// For the estimator, if this is the sensor that it uses: the first that is trusted.
    fn observation(&self, m: &MeasuredFlow, index: usize, context: &Context<'_>) -> Option<Observation> {
        let form = context.core.settings.observer.flow_bias;
        (self.carrier(context.core) == Some(index)).then(|| self.sensors[index].observation(m, form))
    }

    /// GNSS is gone: the flow is to carry the velocity.
    pub(in super::super) fn carry(
        &self,
        m: &MeasuredFlow,
        index: usize,
        context: &Context<'_>,
    ) -> Result<Carry, Reason> {
        let settings = &context.core.settings;
        if settings.estimator == Estimator::Inertial {
            return Err(Reason::SwitchedOff);
        }
        let sensor = &self.sensors[index];
        if !sensor.may_carry(context.core) {
            sensor.trust?;
        }
        let form = settings.observer.flow_bias;
        let corrected = sensor.corrected(m, form);
        let v_body = m.in_body(&corrected, context.core.height.climb_mps());
        let v_ned = m.r_body_to_ned * v_body;
        let noise = m.noise * sensor.calibration.noise_factor();
        Ok(Carry {
            observation: self.observation(m, index, context),
            patient: sensor.outliers_s < RELOCK_S,
            signal: FixSample {
                stamp: m.time,
                position_ned: [None; 3],
                velocity_ned: [Some(v_ned.x), Some(v_ned.y), None],
            },
            v_body,
            gate_mps: GATE_SIGMA * (noise.trace() + SIGNAL_VARIANCE).sqrt(),
            by: CarriedBy {
                interval_s: m.interval_s,
                r_body_to_ned: m.r_body_to_ned,
                jacobian: FlowCalibration::jacobian(&corrected, m.distance_m),
                v_ne: v_ned.xy(),
                noise_density: 0.5 * noise.trace() * m.interval_s,
                ranged: m.ranged,
            },
        })
    }

    /// The velocity that the sensor in use shows by a calibration of a while ago: what testifies about GNSS. `doubted`: GNSS is, and what is
    /// learned from it with it.
    pub(in super::super) fn testify(
        &self,
        m: &MeasuredFlow,
        index: usize,
        travel: &mut FlowTravel,
        doubted: bool,
        context: &Context<'_>,
    ) {
        let core = context.core;
        let id = SourceId { kind: SourceKind::Flow, id: self.id(index) };
        if self.carrier(core) != Some(index) {
            return;
        }
        // What an IMU that is wrong makes of a flow is turned by a wrong attitude.
        let inertia = core.statuses.charge(SourceId::only(SourceKind::Imu));
        if core.statuses.charge(id).or(inertia).is_some() || core.witnesses.inertia.is_out() {
            return travel.interrupt();
        }
        let sensor = &self.sensors[index];
        let Some(calibration) = travel.calibration(m.time, &sensor.calibration, doubted) else { return };
        let v_xy = calibration.correct(&m.v_xy, m.distance_m);
        // A flow that has become small tells nothing of how fast it should have been; but what is slow may be the receiver's walk.
        let v_gnss = gnss_velocity(m, context).filter(|v| v.norm() > NO_WALK_MPS);
        let v_true = v_gnss.unwrap_or(v_xy);
        let r_xy = m.r_body_to_ned.fixed_view::<2, 2>(0, 0);
        let velocity_ned = m.r_body_to_ned * m.in_body(&v_xy, core.height.climb_mps());
        travel.path().add(
            m.time,
            TravelTestimony {
                velocity_ne: velocity_ned.xy(),
                sensitivity: r_xy * FlowCalibration::jacobian(&v_true, m.distance_m),
            },
        );
    }

    /// GNSS lied while the sensor in use learned from it: it is as it was before.
    pub(in super::super) fn unlearn(&mut self, travel: &mut FlowTravel, core: &Core) {
        if let Some((index, calibration)) = self.carrier(core).zip(travel.testifying()) {
            self.sensors[index].calibration = calibration.clone();
            travel.forget_the_young();
        }
    }

    /// A sample did not fit: an outlier.
    pub(in super::super) fn outlier(&mut self, index: usize, interval_s: f64) {
        self.sensors[index].outliers_s += interval_s;
    }

    /// A sample carried.
    pub(in super::super) fn carried(&mut self, index: usize, time: AutopilotTime, v_body: Vector3<f64>) {
        self.sensors[index].outliers_s = 0.0;
        self.set_velocity_body(time, v_body);
    }

    /// The sensor that the estimator uses: the first that is trusted.
    pub(super) fn carrier(&self, core: &Core) -> Option<usize> {
        self.sensors.iter().position(|f| f.may_carry(core))
    }

    /// Fusini's low pass of the velocity bias; not while the attitude is still being found, whose error it would take for a bias.
    fn filter_bias(&mut self, m: &MeasuredFlow, index: usize, context: &Context<'_>) {
        let core = context.core;
        let observer = core.estimator.observer();
        let settings = &core.settings.observer;
        if settings.flow_bias == FlowBiasSource::Calibration || observer.starting(m.time, core.mode, settings)
        {
            return;
        }
        let Some((state, (_, v_ned))) = observer.state().zip(observer.predicted(m.time)) else { return };
        let then = ObserverState { r_hat: m.r_body_to_ned, ..*state };
        let v_ned = Vector3::new(v_ned.x, v_ned.y, -core.height.climb_mps());
        let v_body = m.in_body(&m.v_xy, core.height.climb_mps());
        let biases = &mut self.sensors[index].biases;
        update_flow_bias(observer.fusini(), &then, biases, &v_body, &v_ned, m.interval_s);
    }

    /// The covariance of [b_x, b_y, s, μ] of the sensor that will carry.
    pub(in super::super) fn calibration_covariance(&self, settings: &FlowSettings) -> Matrix4<f64> {
        let trusted = self.sensors.iter().position(|f| f.trust.is_ok());
        let carrier = trusted.map(|i| *self.sensors[i].calibration.covariance());
        carrier.unwrap_or_else(|| *FlowCalibration::new(settings.calibration).covariance())
    }

    /// The sensors with their calibration [b_x, b_y, s, μ] and whether they are trusted.
    pub(in super::super) fn calibrations(
        &self,
    ) -> impl Iterator<Item = (u8, &FlowCalibration, Result<(), Distrust>)> {
        self.sensors.iter().map(|f| (f.id, &f.calibration, f.trust))
    }

    /// Latencies in force, s, with their standard deviations, by sensor id.
    pub(in super::super) fn latencies_s(&self) -> impl Iterator<Item = (u8, f64, f64)> {
        self.sensors.iter().map(|f| (f.id, f.latency.latency_s(), f.latency.sigma_s()))
    }

    /// What is known against a sensor; a patch is as good as its camera.
    pub(super) fn health(&self, id: u8) -> SourceHealth {
        match self.sensors.iter().find(|f| f.id == id).map(|f| f.trust) {
            Some(Ok(())) => SourceHealth::Healthy,
            Some(Err(Distrust::NotCompared)) | None => SourceHealth::Suspect,
            Some(Err(_)) => SourceHealth::Faulty,
        }
    }

    /// What was learned of every sensor.
    pub(in super::super) fn memory(&self) -> Vec<FlowMemory> {
        let memory = |f: &FlowSensor| FlowMemory {
            id: f.id,
            calibration: CalibrationMemory::of(&f.calibration),
            latency_s: [f.latency.latency_s(), f.latency.sigma_s()],
        };
        self.sensors.iter().map(memory).collect()
    }

    /// The sensors are what they were; in the order of then, for the first that is trusted carries.
    pub(in super::super) fn recall(&mut self, memory: &[FlowMemory], settings: &FlowSettings) {
        self.sensors.clear();
        for kept in memory.iter().take(MAX_SENSORS) {
            let mut sensor = FlowSensor::new(kept.id, settings);
            if let Some(calibration) = kept.calibration.calibration(settings.calibration) {
                sensor.trust = calibration.trust();
                sensor.calibration = calibration;
            }
            sensor.latency.recall(kept.latency_s);
            self.sensors.push(sensor);
        }
    }

    pub(super) fn reset(&mut self, reset: &Reset) {
        if reset.breaks_motion() {
            self.velocity_body = None;
            self.sensors.iter_mut().for_each(|sensor| sensor.witness.forget());
        }
        // Stamps begin anew; what the sensors are worth stays known.
        if reset.reboots() {
            for sensor in &mut self.sensors {
                sensor.last = None;
                sensor.repeats.interrupt();
                sensor.latency.interrupt();
            }
            self.image.clear();
        }
    }
}

/// The velocity that GNSS gives when the flow was measured, body x and y, m/s.
fn gnss_velocity(m: &MeasuredFlow, context: &Context<'_>) -> Option<Vector2<f64>> {
    let (_, v_ned) = context.core.estimator.observer().predicted(m.time)?;
    let v_ned = Vector3::new(v_ned.x, v_ned.y, -context.core.height.climb_mps());
    Some(m.r_body_to_ned.tr_mul(&v_ned).xy())
}

/// What the doubt about the heading does to the GNSS velocity in body axes: covariance, m²/s². Observers without a magnetometer have
/// their heading from this very flow: whatever it is turned by, they agree with it.
fn heading_doubt(v_gnss: &Vector2<f64>, context: &Context<'_>) -> Matrix2<f64> {
    let (core, facts) = (context.core, &context.facts);
    let across = Vector2::new(-v_gnss.y, v_gnss.x);
    let known = !core.estimator.has_error_state() && facts.magnetic.is_some();
    let variance = if known { 0.0 } else { core.attitude_variance(facts).z };
    across * across.transpose() * variance
}
