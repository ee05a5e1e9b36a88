//! Optical flow: compared with GNSS while there is GNSS, the carrier of the velocity when there is none.

use nalgebra::{Matrix2, Matrix3, Vector2, Vector3};

use crate::camera::{Distrust, FlowCalibration, FlowPatch, FlowRefusal, PatchNoise, single_patch};
use crate::geo::Body;
use crate::observer::fusini::update_flow_bias;
use crate::observer::{FixSample, FusiniBiases, ObserverState};
use crate::sample::{FlowRotation, FlowSample};
use crate::time::{AutopilotTime, Span};

use super::Navigator;
use super::event::What;
use super::history::CORRECTED_S;
use super::latency::FlowLatency;
use super::settings::{Estimator, FlowBiasSource};
use super::solution::Mode;
use super::verdict::{Reason, Verdict};

/// Sensors (or patches) that are told apart.
const MAX_SENSORS: usize = 8;
/// Flow innovations beyond this many sigmas are outliers …
const GATE_SIGMA: f64 = 5.0;
/// … unless they go on for this long, s: then it is the velocity that is wrong.
const RELOCK_S: f64 = 1.0;
/// No camera sees the ground move faster, rad/s.
const FASTEST_RADPS: f64 = 100.0;
/// A flow that tells the same for this long is stuck, s.
const STUCK_S: f64 = 0.3;
/// The interval that a flow rate without one is taken over, s.
const RATE_INTERVAL_S: f64 = 0.05;
/// How far a flow message's own distance may be from the height over ground, m, and as a part of it.
const DISTANCE_TOLERANCE_M: f64 = 1.5;
const DISTANCE_TOLERANCE: f64 = 0.3;
/// Standard deviation of the height filter's climb rate, m/s.
pub(super) const CLIMB_SIGMA_MPS: f64 = 0.3;
/// The latency's effect is looked at over this step, s: some samples of a slow IMU stream.
const LATENCY_STEP_S: f64 = 0.04;
/// The interval taken for the first sample, s.
pub(super) const FIRST_INTERVAL_S: f64 = 0.05;

/// One flow sensor.
#[derive(Clone, Debug)]
pub(super) struct FlowSensor {
    id: u8,
    calibration: FlowCalibration,
    /// The velocity bias as Fusini finds it, where that is wanted instead of the calibration.
    biases: FusiniBiases,
    trust: Result<(), Distrust>,
    latency: FlowLatency,
    pub(super) last: Option<AutopilotTime>,
    outliers_s: f64,
    /// Since when it has told the same, and what.
    same: Option<(AutopilotTime, [f64; 2])>,
}

/// The middle of a flow's interval.
pub(super) struct FlowMoment {
    pub(super) time: AutopilotTime,
    pub(super) r_body_to_ned: Matrix3<f64>,
    /// Mean over the interval, bias removed.
    pub(super) rate_body: Vector3<f64>,
}

/// A flow velocity before calibration.
pub(super) struct Measured {
    pub(super) time: AutopilotTime,
    pub(super) r_body_to_ned: Matrix3<f64>,
    /// Body x and y, m/s.
    pub(super) v_xy: Vector2<f64>,
    pub(super) noise: Matrix2<f64>,
    /// Body z and its variance, where the image observes it by itself.
    pub(super) v_z: Option<(f64, f64)>,
    pub(super) interval_s: f64,
    /// The distance came from a rangefinder.
    pub(super) ranged: bool,
}

impl FlowSensor {
    /// Whether it has told the same numbers for longer than noise lets it. Zero is what sensors tell that see nothing move.
    fn repeats(&mut self, s: &FlowSample) -> bool {
        match self.same {
            Some((since, rate)) if rate == s.rate_xy => {
                rate != [0.0; 2] && s.time.seconds_since(since) > STUCK_S
            }
            _ => {
                self.same = Some((s.time, s.rate_xy));
                false
            }
        }
    }
}

impl Navigator {
    pub(super) fn flow(&mut self, s: &FlowSample) -> Verdict {
        if !self.settings.flow.enabled {
            return Verdict::Rejected(Reason::SwitchedOff);
        }
        // Squares of what is far beyond any sensor would overflow.
        if s.rate_xy.iter().any(|rate| rate.is_finite() && rate.abs() > FASTEST_RADPS) {
            return Verdict::Rejected(Reason::OutOfRange);
        }
        if self.settings.flow.patches.find(s.sensor).is_some() {
            return self.patch(s);
        }
        let Some(index) = self.flow_sensor(s.sensor) else { return Verdict::Rejected(Reason::Redundant) };
        let last = self.flows[index].last;
        if last.is_some_and(|t| s.time <= t) {
            return Verdict::Rejected(Reason::OutOfOrder);
        }
        if self.flows[index].repeats(s) {
            return Verdict::Rejected(Reason::Stuck);
        }
        let interval_s = last.map_or(FIRST_INTERVAL_S, |t| s.time.seconds_since(t)).min(1.0);
        self.flow_measured(s.time, index, |navigator, delay_s| navigator.measure(s, interval_s, delay_s))
    }

    /// The place of a sensor among those that are told apart; `None` when there are too many.
    pub(super) fn flow_sensor(&mut self, id: u8) -> Option<usize> {
        match self.flows.iter().position(|f| f.id == id) {
            Some(i) => Some(i),
            None if self.flows.len() < MAX_SENSORS => {
                self.flows.push(FlowSensor {
                    id,
                    calibration: FlowCalibration::new(self.settings.flow.calibration),
                    biases: FusiniBiases::default(),
                    trust: Err(Distrust::NotCompared),
                    latency: FlowLatency::new(self.settings.flow.delay_s, self.settings.flow.delay_sigma_s),
                    last: None,
                    outliers_s: 0.0,
                    same: None,
                });
                Some(self.flows.len() - 1)
            }
            None => None,
        }
    }

    /// Stamps begin anew; what the sensors are worth stays known.
    pub(super) fn forget_flow_times(&mut self) {
        for sensor in &mut self.flows {
            sensor.last = None;
            sensor.same = None;
            sensor.latency.interrupt();
        }
        self.patches.clear();
    }

    /// A flow with this stamp, as `measure` evaluates it for a latency. What the velocity is for depends on the mode.
    pub(super) fn flow_measured(
        &mut self,
        stamp: AutopilotTime,
        index: usize,
        measure: impl Fn(&Self, f64) -> Result<Measured, Reason>,
    ) -> Verdict {
        let delay_s = self.flows[index].latency.latency_s();
        let measured = match measure(self, delay_s) {
            Ok(measured) => measured,
            Err(reason) => return Verdict::Rejected(reason),
        };
        if self.modes.mode() == Mode::Aided && self.flows[index].latency.learns() {
            match measure(self, delay_s + LATENCY_STEP_S) {
                Ok(earlier) => self.learn_latency(&measured, &earlier, index),
                Err(_) => self.flows[index].latency.interrupt(),
            }
        }
        self.take_flow(stamp, &measured, index)
    }

    /// How flow and GNSS differ, and how that would change if the flow were older.
    fn learn_latency(&mut self, now: &Measured, earlier: &Measured, index: usize) {
        let age = now.time.seconds_since(earlier.time);
        let (Some(v_now), Some(v_earlier)) = (self.gnss_velocity(now), self.gnss_velocity(earlier)) else {
            return;
        };
        if age < 0.5 * LATENCY_STEP_S {
            return;
        }
        let sensor = &mut self.flows[index];
        let residual = now.v_xy - v_now - FlowCalibration::jacobian(&v_now) * sensor.calibration.estimate();
        let by_latency = ((earlier.v_xy - v_earlier) - (now.v_xy - v_now)) / age;
        let variance = 0.5 * now.noise.trace() * sensor.calibration.noise_factor();
        sensor.latency.observe(now.time, &residual, &by_latency, variance);
    }

    fn take_flow(&mut self, stamp: AutopilotTime, measured: &Measured, index: usize) -> Verdict {
        self.flows[index].last = Some(stamp);
        match self.modes.mode() {
            Mode::Aligning => self.hold_direction(measured, index),
            Mode::Aided | Mode::Rejoining => self.compare(measured, index),
            Mode::Holdover | Mode::Lost => self.carry(measured, index),
        }
    }

    /// The flow as velocity: v_x = d·(ω_flow,y − ω_y), v_y = −d·(ω_flow,x − ω_x) at the camera (spec of OPTICAL_FLOW_RAD), turned to
    /// body axes and moved to the IMU. The vertical component, which one patch does not see, is the height filter's climb rate.
    fn measure(&self, s: &FlowSample, interval_s: f64, delay_s: f64) -> Result<Measured, Reason> {
        let settings = &self.settings.flow;
        let [rate_x, rate_y] = s.rate_xy;
        if !(rate_x.is_finite() && rate_y.is_finite() && s.quality.is_finite()) {
            return Err(Reason::NotFinite);
        }
        let FlowMoment { time, r_body_to_ned: r, rate_body } =
            self.flow_moment(s.time, s.interval, delay_s)?;
        let mount = &settings.mount;
        let cosine = mount.cos_tilt(&r);
        let (distance_m, height_m) = self.distance(s, cosine);
        let ranged = distance_m.is_some();
        // A message that gives a rate is a flow over any interval.
        let dt = if s.interval > Span::ZERO { s.interval.seconds() } else { RATE_INTERVAL_S };
        let rate_camera = mount.camera_to_body.to_camera(Body::new(rate_body)).raw();
        let rotation = match s.rotation {
            FlowRotation::SensorGyro([x, y]) => Vector2::new(x, y),
            FlowRotation::Contained => rate_camera.xy(),
            FlowRotation::Removed => Vector2::zeros(),
        };
        let patch = FlowPatch {
            integration_time_s: dt,
            flow_rad: Vector2::new(rate_x, rate_y) * dt,
            rotation_rad: rotation * dt,
            body_rate: rate_body,
            distance_m,
            height_m,
            quality: s.quality,
        };
        let noise = PatchNoise {
            flow_rad: settings.rate_noise_radps * dt,
            rotation_rad: 0.0,
            distance_m: 0.05,
            distance_fraction: 0.0,
        };
        let seen = single_patch::solve(&patch, mount, &r, &settings.limits, &noise)?;
        // Two rows from the camera, one from the climb rate.
        let c = &seen.body_to_measurement;
        let rows = Matrix3::from_rows(&[c.row(0).into_owned(), c.row(1).into_owned(), r.row(2).into_owned()]);
        let v = &seen.velocity_camera;
        let right = Vector3::new(v.x, v.y, -self.height.climb_mps());
        let v_body = rows.try_inverse().ok_or(Reason::Tilt)? * right;
        if !v_body.iter().all(|v| v.is_finite()) {
            return Err(Reason::NotFinite);
        }
        Ok(Measured {
            time,
            r_body_to_ned: r,
            v_xy: v_body.xy(),
            noise: seen.covariance,
            v_z: None,
            interval_s,
            ranged,
        })
    }

    /// When a flow was really measured, and how the body stood and turned then.
    pub(super) fn flow_moment(
        &self,
        stamp: AutopilotTime,
        interval: Span,
        delay_s: f64,
    ) -> Result<FlowMoment, Reason> {
        let end = stamp - Span::from_seconds(delay_s);
        let begin = end - interval;
        let middle = end - Span::from_micros(interval.micros() / 2);
        let newest = self.last_imu.ok_or(Reason::NoReferenceYet)?;
        // A sample a little ahead of the IMU stream is as good as its newest attitude.
        let time = middle.min(newest);
        if newest.seconds_since(time) > CORRECTED_S {
            return Err(Reason::Late);
        }
        let r_body_to_ned = self.history.attitude(time).ok_or(Reason::NoReferenceYet)?;
        let rate_body =
            self.history.mean_rate(begin.min(newest), end.min(newest)).unwrap_or(self.angular_rate_body);
        Ok(FlowMoment { time, r_body_to_ned, rate_body })
    }

    /// Distance along the optical axis if it is measured, and else the height over ground. The rangefinder's own message comes with
    /// limits and is checked; the distance in the flow's message is taken only where there is no rangefinder, and where it does not
    /// contradict the height.
    pub(super) fn distance(&self, s: &FlowSample, cosine: f64) -> (Option<f64>, Option<f64>) {
        let height = self.height.height_m().zip(self.ground_m).map(|(height, ground)| height - ground);
        let ranged =
            self.range.filter(|(t, _)| s.time.seconds_since(*t).abs() < self.settings.range_max_age_s);
        let measured = match ranged {
            // The beam points along body z.
            Some((_, d)) => Some(d * self.r_body_to_ned[(2, 2)] / cosine.max(0.1)),
            None => s.distance_m.filter(|d| {
                height
                    .is_none_or(|h| (d * cosine - h).abs() < DISTANCE_TOLERANCE_M.max(DISTANCE_TOLERANCE * h))
            }),
        };
        (measured, height)
    }

    /// While aligning without a magnetometer the flow is the only horizontal direction in body axes.
    fn hold_direction(&mut self, m: &Measured, index: usize) -> Verdict {
        let corrected = self.corrected(index, &m.v_xy);
        self.flow_body = Some((m.time, self.in_body(m, &corrected)));
        Verdict::Used
    }

    /// GNSS is there: the sensor is compared with it.
    fn compare(&mut self, m: &Measured, index: usize) -> Verdict {
        let corrected = self.corrected(index, &m.v_xy);
        self.flow_body = Some((m.time, self.in_body(m, &corrected)));
        let Some(v_gnss) = self.gnss_velocity(m) else { return Verdict::Rejected(Reason::NoReferenceYet) };
        // While an observer still finds its heading from this very flow, its error would be learned as the flow's misalignment.
        let settled = self.modes.seconds_since_attitude(m.time) > self.settings.observer.start_s;
        if self.kalman.is_none() && self.magnetic.is_none() && !settled {
            return Verdict::Used;
        }
        self.filter_bias(m, index);
        let lasting = self.heading_doubt(&v_gnss);
        let sensor = &mut self.flows[index];
        sensor.calibration.compare(&m.v_xy, &v_gnss, &m.noise, &lasting, m.interval_s);
        let trust = sensor.calibration.trust();
        let covariance = m.noise * sensor.calibration.noise_factor();
        let changed = trust != sensor.trust;
        sensor.trust = trust;
        let id = sensor.id;
        if trust.is_ok() && self.carries(index) {
            self.fuse_flow(self.last_imu.unwrap_or(m.time), m.time, &m.v_xy, &m.r_body_to_ned, &covariance);
        }
        if changed {
            self.tell(
                m.time,
                trust.map_or_else(|why| What::FlowDistrusted(id, why), |()| What::FlowTrusted(id)),
            );
        }
        Verdict::Used
    }

    /// What the doubt about the heading does to the GNSS velocity in body axes: covariance, m²/s². Observers without a magnetometer have
    /// their heading from this very flow: whatever it is turned by, they agree with it.
    fn heading_doubt(&self, v_gnss: &Vector2<f64>) -> Matrix2<f64> {
        let across = Vector2::new(-v_gnss.y, v_gnss.x);
        let variance = match &self.kalman {
            Some(_) => self.attitude_variance().z,
            None if self.magnetic.is_some() => 0.0,
            None => self.attitude_variance().z,
        };
        across * across.transpose() * variance
    }

    /// The velocity that GNSS gives when the flow was measured, body x and y, m/s.
    fn gnss_velocity(&self, m: &Measured) -> Option<Vector2<f64>> {
        let (_, v_ned) = self.predicted(m.time)?;
        Some(m.r_body_to_ned.tr_mul(&Vector3::new(v_ned.x, v_ned.y, -self.height.climb_mps())).xy())
    }

    /// GNSS is gone: the flow carries the velocity.
    fn carry(&mut self, m: &Measured, index: usize) -> Verdict {
        if self.settings.estimator == Estimator::Inertial {
            return Verdict::Rejected(Reason::SwitchedOff);
        }
        let sensor = &self.flows[index];
        if sensor.trust.is_err() {
            return Verdict::Rejected(Reason::Distrusted);
        }
        let covariance = m.noise * sensor.calibration.noise_factor();
        let corrected = self.corrected(index, &m.v_xy);
        let patient = sensor.outliers_s < RELOCK_S;
        if self.carries(index)
            && !self.fuse_flow(
                self.last_imu.unwrap_or(m.time),
                m.time,
                &m.v_xy,
                &m.r_body_to_ned,
                &covariance,
            )
            && patient
        {
            self.flows[index].outliers_s += m.interval_s;
            return Verdict::Rejected(Reason::Innovation);
        }
        let sensor = &self.flows[index];
        let v_body = self.in_body(m, &corrected);
        let v_ned = m.r_body_to_ned * v_body;
        let fix = FixSample {
            stamp: m.time,
            position_ned: [None; 3],
            velocity_ned: [Some(v_ned.x), Some(v_ned.y), None],
        };
        let Some(innovation) = self.predictor.innovation(&fix) else {
            return self.restart_predictor(&v_ned);
        };
        let e = Vector2::new(
            innovation.velocity_ned[0].unwrap_or_default(),
            innovation.velocity_ned[1].unwrap_or_default(),
        );
        let factor = sensor.calibration.noise_factor();
        let sigma2 = (m.noise * factor).trace() + 1.0;
        if e.norm_squared() > GATE_SIGMA * GATE_SIGMA * sigma2 && sensor.outliers_s < RELOCK_S {
            self.flows[index].outliers_s += m.interval_s;
            return Verdict::Rejected(Reason::Innovation);
        }
        self.flows[index].outliers_s = 0.0;
        self.predictor.apply(&innovation);
        self.flow_body = Some((m.time, v_body));
        let jacobian = FlowCalibration::jacobian(&corrected);
        let density = 0.5 * (m.noise * factor).trace() * m.interval_s;
        self.carried_by_flow(m.interval_s, &m.r_body_to_ned, &jacobian, &v_ned.xy(), density, m.ranged);
        Verdict::Used
    }

    /// Whether this sensor is the one that the filter uses: the first that is trusted.
    fn carries(&self, index: usize) -> bool {
        self.carrier_index() == Some(index)
    }

    pub(super) fn carrier_index(&self) -> Option<usize> {
        self.flows.iter().position(|f| f.trust.is_ok())
    }

    fn restart_predictor(&mut self, v_ned: &Vector3<f64>) -> Verdict {
        let (Some(now), Some(state)) = (self.last_imu, self.state) else {
            return Verdict::Rejected(Reason::NoReferenceYet);
        };
        self.predictor.reset(now, &state.position_ned, v_ned);
        Verdict::Used
    }

    /// The flow velocity as the observers are to see it, body x and y, m/s.
    pub(super) fn corrected(&self, index: usize, v_xy: &Vector2<f64>) -> Vector2<f64> {
        let sensor = &self.flows[index];
        match self.settings.observer.flow_bias {
            FlowBiasSource::Calibration => sensor.calibration.correct(v_xy),
            FlowBiasSource::Body | FlowBiasSource::AsPrinted => v_xy - sensor.biases.flow_velocity.xy(),
        }
    }

    /// Fusini's low pass of the velocity bias; not while the attitude is still being found, whose error it would take for a bias.
    fn filter_bias(&mut self, m: &Measured, index: usize) {
        if self.settings.observer.flow_bias == FlowBiasSource::Calibration || self.starting(m.time) {
            return;
        }
        let (Some(state), Some((_, v_ned))) = (&self.state, self.predicted(m.time)) else { return };
        let then = ObserverState { r_hat: m.r_body_to_ned, ..*state };
        let v_ned = Vector3::new(v_ned.x, v_ned.y, -self.height.climb_mps());
        let v_body = self.in_body(m, &m.v_xy);
        let biases = &mut self.flows[index].biases;
        update_flow_bias(&self.fusini, &then, biases, &v_body, &v_ned, m.interval_s);
    }

    /// The body velocity whose x and y are `v_xy` and whose vertical part is the climb rate; body z is weighted with the image's own
    /// where it observes that.
    fn in_body(&self, m: &Measured, v_xy: &Vector2<f64>) -> Vector3<f64> {
        let down = m.r_body_to_ned.row(2);
        let v_down = -self.height.climb_mps();
        let z = (v_down - down[0] * v_xy.x - down[1] * v_xy.y) / down[2].max(0.1);
        let z = m.v_z.map_or(z, |(own, variance)| {
            let climb = CLIMB_SIGMA_MPS * CLIMB_SIGMA_MPS;
            (own * climb + z * variance) / (climb + variance)
        });
        Vector3::new(v_xy.x, v_xy.y, z)
    }

    /// The measurement signal at a past time: position and velocity.
    fn predicted(&self, time: AutopilotTime) -> Option<(Vector3<f64>, Vector3<f64>)> {
        // An innovation of a zero sample is the negative of the prediction.
        let zero = FixSample { stamp: time, position_ned: [Some(0.0); 3], velocity_ned: [Some(0.0); 3] };
        let i = self.predictor.innovation(&zero)?;
        let v = |o: &[Option<f64>; 3]| Vector3::from_fn(|row, _| -o[row].unwrap_or_default());
        Some((v(&i.position_ned), v(&i.velocity_ned)))
    }

    /// The calibration of the sensor that will carry: the first trusted one.
    pub(super) fn carrying_calibration(&self) -> FlowCalibration {
        self.flows
            .iter()
            .find(|f| f.trust.is_ok())
            .map_or_else(|| FlowCalibration::new(self.settings.flow.calibration), |f| f.calibration.clone())
    }

    /// The flow sensors with their calibration [b_x, b_y, s, μ] and whether they are trusted.
    pub fn flow_sensors(&self) -> impl Iterator<Item = (u8, &FlowCalibration, Result<(), Distrust>)> {
        self.flows.iter().map(|f| (f.id, &f.calibration, f.trust))
    }

    /// The latencies of the flow sensors in force, s, with their standard deviations, by sensor id.
    pub fn flow_latencies_s(&self) -> impl Iterator<Item = (u8, f64, f64)> {
        self.flows.iter().map(|f| (f.id, f.latency.latency_s(), f.latency.sigma_s()))
    }
}

impl From<FlowRefusal> for Reason {
    fn from(refusal: FlowRefusal) -> Self {
        match refusal {
            FlowRefusal::NotFinite => Reason::NotFinite,
            FlowRefusal::IntegrationTime(_)
            | FlowRefusal::Distance(_)
            | FlowRefusal::Height(_)
            | FlowRefusal::FocalLength(_) => Reason::OutOfRange,
            FlowRefusal::Quality(_) => Reason::LowQuality,
            FlowRefusal::Tilt(_) | FlowRefusal::Horizon => Reason::Tilt,
            FlowRefusal::DistanceMissing => Reason::NoDistance,
            FlowRefusal::TooFew(_) | FlowRefusal::Rank(_) | FlowRefusal::Condition(_) => Reason::Unobservable,
            FlowRefusal::Residual(_) | FlowRefusal::Consensus { .. } => Reason::Inconsistent,
        }
    }
}
