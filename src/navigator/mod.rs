//! The navigator: samples in, a solution out. Pure, synchronous, deterministic: the same samples give the same bytes.
//!
//! While GNSS is trusted, Grip's observer (IMU, GNSS, magnetometer) estimates attitude, gyro bias, position and velocity, the height
//! filter the height, and every flow sensor is compared with GNSS. When the observer has found the attitude it starts the error-state
//! filter, whose estimate is published from then on, and watches it. Without magnetometer and flow a bank of filters finds the heading from
//! motion and starts it, and nothing watches. When GNSS is lost, the filter goes on with flow, or airspeed, rotor drag or standing still, with
//! magnetometer and height, and its covariance grows; beside it Fusini's dead-reckoning observer goes on from Grip's state with the gyro bias frozen, which is
//! what is published where the observers navigate alone (`nlo`), with an error budget. [`modes`] says when.

mod aiding;
pub mod air;
mod bridge;
pub mod budget;
pub mod drag;
pub mod event;
mod flow;
mod gnss;
mod heading;
mod height;
pub mod history;
mod inertial;
mod kalman;
pub mod landmarks;
pub mod latency;
pub mod modes;
pub mod nis;
mod patches;
mod rest;
pub mod settings;
pub mod solution;
pub mod trust;
pub mod verdict;
mod xkf;

use nalgebra::{Matrix3, Vector3};

use crate::altimeter::HeightFilter;
use crate::filter::HeadingBank;
use crate::filter::error_state::EskfState;
use crate::geo::{
    Body, BodyToNed, Geodetic, LocalNed, Ned, earth_rate_ned, gravity::gravity_ned, magnetic_field,
};
use crate::observer::fusini::FlowBiasForm;
use crate::observer::{FusiniParams, GripParams, ObserverState, Predictor, Scheme};
use crate::sample::{ImuSample, Sample, VehicleStatus};
use crate::time::{AutopilotTime, Span};

use budget::ErrorBudget;
use drag::{DragError, DragMean};
use event::{Event, What};
use flow::FlowSensor;
use height::HeightState;
use history::History;
use kalman::Kalman;
use landmarks::LandmarkSense;
use latency::LatencyEstimator;
use modes::ModeState;
use nis::NisTally;
use patches::Gathering;
use rest::Rest;
use settings::{Estimator, FlowBiasSource, NavigatorSettings};
use solution::{Carrier, Mode, Solution};
use trust::{GnssState, GnssTrust};
use verdict::{Tally, Verdict};
use xkf::SecondStage;

/// How long after its last measurement an axis of the measurement signal counts as measured.
const SIGNAL_HOLD: Span = Span::from_millis(700);
/// The predictor remembers this much of the past; fixes have to be younger still, see [`history::CORRECTED_S`].
const LONGEST_DELAY: Span = Span::from_millis(1500);
/// IMU samples remembered: 1.5 s at 333 Hz.
const HISTORY_SAMPLES: usize = 512;
/// An origin further from the vehicle's first place than this is a damaged or hostile message, m.
const FARTHEST_ORIGIN_M: f64 = 100_000.0;
/// The year whose magnetic field is taken while no clock has told the date.
const DEFAULT_YEAR: f64 = 2026.0;

/// The local frame and what belongs to the place.
#[derive(Clone, Debug)]
struct Place {
    frame: LocalNed,
    gravity_ned: Vector3<f64>,
    earth_rate_ned: Vector3<f64>,
    field_ned: Option<Vector3<f64>>,
}

/// See the module's documentation.
#[derive(Clone, Debug)]
pub struct Navigator {
    settings: NavigatorSettings,
    grip: GripParams,
    /// Grip's observer while aligning: fast gains.
    grip_start: GripParams,
    fusini: FusiniParams,
    /// The same for Fusini's observer with GNSS.
    fusini_start: FusiniParams,
    place: Option<Place>,
    decimal_year: f64,
    /// `None` until the attitude has a first guess.
    state: Option<ObserverState>,
    /// The filter, once the observer has found the attitude.
    kalman: Option<Kalman>,
    /// The second stage over the observer, for `xkf`.
    xkf: Option<SecondStage>,
    /// Seeks the heading while there is no magnetometer.
    heading: Option<HeadingBank>,
    /// The heading that is flown on came from there.
    heading_by_motion: bool,
    predictor: Predictor,
    scheme: Scheme,
    history: History,
    height: HeightFilter,
    trust: GnssTrust,
    latency: LatencyEstimator,
    receiver: u8,
    receiver_heard: Option<AutopilotTime>,
    gnss_sigma_m: f64,
    heights: HeightState,
    flows: Vec<FlowSensor>,
    patches: Gathering,
    /// Corrected flow velocity in body axes, for the velocity triad, and its time.
    flow_body: Option<(AutopilotTime, Vector3<f64>)>,
    magnetic: Option<(AutopilotTime, Vector3<f64>)>,
    /// Since when the magnetometer has told the same, what, and whether it is stuck at it.
    magnetic_same: Option<(AutopilotTime, Vector3<f64>, bool)>,
    range: Option<(AutopilotTime, f64)>,
    status: VehicleStatus,
    rest: Rest,
    /// Where landmarks are configured.
    landmarks: Option<LandmarkSense>,
    /// It was in the air while it said that it was disarmed.
    flew_disarmed: bool,
    drag: DragMean,
    drag_error: DragError,
    /// The newest airspeed, and the newest that was used.
    airspeed: Option<AutopilotTime>,
    airspeed_used: Option<AutopilotTime>,
    /// Height of the ground above the origin, where the rangefinder last saw it or the navigation began, m.
    ground_m: Option<f64>,
    /// Since when the rangefinder has seen the ground elsewhere, and by how much, m.
    ground_disputed_since: Option<(AutopilotTime, f64)>,
    modes: ModeState,
    budget: Option<ErrorBudget>,
    carrier: Carrier,
    /// Published position less estimated position, NED: glides to zero.
    offset_ned: Vector3<f64>,
    reset_counter: u8,
    last_imu: Option<AutopilotTime>,
    last_sample: Option<ImuSample>,
    /// Since when the IMU has told the same.
    imu_same_since: Option<AutopilotTime>,
    /// IMU samples older than the newest, one after the other: the first and the last of them.
    behind: Option<(AutopilotTime, AutopilotTime)>,
    angular_rate_body: Vector3<f64>,
    r_body_to_ned: Matrix3<f64>,
    events: Vec<Event>,
    tally: Tally,
    nis: NisTally,
}

impl Navigator {
    /// A navigator that has heard nothing yet.
    pub fn new(settings: NavigatorSettings) -> Self {
        let printed = settings.estimator == Estimator::NloPrinted;
        let (grip, grip_start, fusini) = if printed {
            (GripParams::printed(), GripParams::printed(), FusiniParams::printed())
        } else {
            (tuned_grip(&settings), GripParams::start_up(), tuned_fusini(&settings))
        };
        let (grip, grip_start) = if settings.observer.gnss_velocity {
            (grip, grip_start)
        } else {
            (grip.position_only(), grip_start.position_only())
        };
        let fusini = FusiniParams {
            flow_bias: match settings.observer.flow_bias {
                FlowBiasSource::AsPrinted => FlowBiasForm::AsPrinted,
                FlowBiasSource::Body | FlowBiasSource::Calibration => FlowBiasForm::Body,
            },
            flow_bias_time_constant_s: settings.observer.flow_bias_time_s,
            ..fusini
        };
        let fusini_start = if printed { fusini } else { fusini.starting() };
        let scheme = if printed { Scheme::Hold } else { Scheme::InterSample };
        Self {
            grip,
            grip_start,
            fusini,
            fusini_start,
            place: None,
            decimal_year: DEFAULT_YEAR,
            state: None,
            kalman: None,
            xkf: None,
            heading: None,
            heading_by_motion: false,
            predictor: Predictor::new(scheme, LONGEST_DELAY, SIGNAL_HOLD, Vector3::zeros()),
            scheme,
            history: History::new(HISTORY_SAMPLES),
            height: HeightFilter::new(settings.height.kind, settings.height.altimeter),
            trust: GnssTrust::new(settings.gnss.trust),
            latency: LatencyEstimator::new(settings.gnss.delay_s, settings.gnss.delay_sigma_s),
            receiver: 0,
            receiver_heard: None,
            gnss_sigma_m: settings.gnss.default_accuracy_m,
            heights: HeightState::default(),
            flows: Vec::new(),
            patches: Gathering::new(),
            flow_body: None,
            magnetic: None,
            magnetic_same: None,
            range: None,
            status: VehicleStatus::default(),
            rest: Rest::default(),
            landmarks: settings.landmarks.clone().map(LandmarkSense::new),
            flew_disarmed: false,
            drag: DragMean::default(),
            drag_error: DragError::new(&settings.drag),
            airspeed: None,
            airspeed_used: None,
            ground_m: None,
            ground_disputed_since: None,
            modes: ModeState::new(),
            budget: None,
            carrier: Carrier::Gnss,
            offset_ned: Vector3::zeros(),
            reset_counter: 0,
            last_imu: None,
            last_sample: None,
            imu_same_since: None,
            behind: None,
            angular_rate_body: Vector3::zeros(),
            r_body_to_ned: Matrix3::identity(),
            events: Vec::with_capacity(64),
            tally: Tally::default(),
            nis: NisTally::default(),
            settings,
        }
    }

    /// Takes one sample, in the order in which samples arrive; late ones are compared with the past they belong to.
    pub fn ingest(&mut self, sample: &Sample) -> Verdict {
        let verdict = match sample {
            Sample::Imu(s) => {
                self.patches_waited(s.time);
                self.imu(s)
            }
            Sample::Mag(s) => self.mag(s),
            Sample::Gnss(s) => self.gnss(s),
            Sample::Pressure(s) => self.pressure(s),
            Sample::Flow(s) => self.flow(s),
            Sample::Range(s) => self.range(s),
            Sample::Airspeed(s) => self.airspeed(s),
            Sample::Landmark(s) => self.landmark(s),
        };
        self.tally.count(sample.kind(), verdict);
        verdict
    }

    /// The autopilot told its origin: the frame's origin moves there. Height is above mean sea level, as everywhere. False when the
    /// origin is no place, or too far away to be one: nothing has changed then.
    pub fn set_origin(&mut self, time: AutopilotTime, origin: Geodetic) -> bool {
        if !origin.is_plausible() {
            return false;
        }
        let moved = match &self.place {
            None => Vector3::zeros(),
            Some(place) if place.frame.origin() == origin => return true,
            Some(place) => place.frame.to_ned(&origin),
        };
        if moved.norm() > FARTHEST_ORIGIN_M {
            return false;
        }
        if self.place.is_none() {
            self.modes.started(time);
        }
        self.settle(origin);
        self.height.shift_origin(-moved.z);
        self.heights.moved();
        self.ground_m = self.ground_m.map(|g| g + moved.z);
        if let Some(state) = &mut self.state {
            state.position_ned -= moved;
            if let Some(kalman) = &mut self.kalman {
                kalman.filter.shift_origin(&moved);
            }
            if let Some(stage) = &mut self.xkf {
                stage.filter.shift_position(&-moved);
            }
            self.history.clear();
            self.trust.forget_track();
        }
        if let Some(landmarks) = &mut self.landmarks {
            landmarks.origin_moved(&moved);
        }
        if moved.norm() > 0.01 {
            self.reset_counter = self.reset_counter.wrapping_add(1);
        }
        self.tell(time, What::Origin(moved.norm()));
        true
    }

    /// Sets the date, as decimal year, for the magnetic field.
    pub fn set_date(&mut self, decimal_year: f64) {
        if (decimal_year - self.decimal_year).abs() > 0.02 && decimal_year.is_finite() {
            self.decimal_year = decimal_year;
            if let Some(origin) = self.frame().map(LocalNed::origin) {
                self.place = Some(self.place_at(origin));
            }
        }
    }

    /// Takes a place as the frame's origin.
    fn settle(&mut self, origin: Geodetic) {
        let place = self.place_at(origin);
        self.predictor = Predictor::new(self.scheme, LONGEST_DELAY, SIGNAL_HOLD, place.earth_rate_ned);
        self.place = Some(place);
    }

    fn place_at(&self, origin: Geodetic) -> Place {
        Place {
            frame: LocalNed::new(origin),
            gravity_ned: gravity_ned(origin.latitude_rad, origin.height_m),
            earth_rate_ned: earth_rate_ned(origin.latitude_rad),
            field_ned: magnetic_field(&origin, self.decimal_year).ok().map(Ned::raw),
        }
    }

    /// The newest solution; `None` until the attitude has a first guess.
    pub fn solution(&self) -> Option<Solution> {
        let time = self.last_imu?;
        let (p, mut velocity_ned) = self.estimate()?;
        let mut position_ned = p + self.offset_ned;
        if let Some(height) = self.published_height_m() {
            position_ned.z = -height;
            velocity_ned.z = -self.height.climb_mps();
        }
        let (position_covariance, velocity_covariance) = self.covariances();
        Some(Solution {
            time,
            mode: self.modes.mode(),
            carrier: self.shown_carrier(time),
            position: Ned::new(position_ned),
            velocity: Ned::new(velocity_ned),
            attitude: BodyToNed::from_matrix(&self.r_body_to_ned),
            angular_rate: Body::new(self.angular_rate_body),
            position_covariance: Ned::new(position_covariance),
            velocity_covariance: Ned::new(velocity_covariance),
            attitude_variance: self.attitude_variance(),
            reset_counter: self.reset_counter,
        })
    }

    /// The mode.
    pub fn mode(&self) -> Mode {
        self.modes.mode()
    }

    /// What GNSS is worth.
    pub fn gnss_state(&self) -> GnssState {
        self.trust.state()
    }

    /// The local frame's origin, once there is one.
    pub fn frame(&self) -> Option<&LocalNed> {
        self.place.as_ref().map(|p| &p.frame)
    }

    /// The GNSS latency in force, s, and its standard deviation, s.
    pub fn gnss_latency_s(&self) -> (f64, f64) {
        (self.latency.latency_s(), self.latency.sigma_s())
    }

    /// Verdicts so far.
    pub fn tally(&self) -> &Tally {
        &self.tally
    }

    /// How likely the measurements were that the filter took.
    pub fn nis(&self) -> &NisTally {
        &self.nis
    }

    /// The state of the filter that runs, with what it has learned of the sensors.
    pub fn filter_state(&self) -> Option<&EskfState> {
        self.kalman.as_ref().map(|k| k.filter.state())
    }

    /// Estimated gyro bias, body, rad/s.
    pub fn gyro_bias(&self) -> Option<Vector3<f64>> {
        self.state.as_ref().map(|s| s.gyro_bias)
    }

    /// What happened since the last call, oldest first.
    pub fn drain_events(&mut self) -> impl Iterator<Item = Event> + '_ {
        self.events.drain(..)
    }

    /// Whether events wait.
    pub fn has_events(&self) -> bool {
        !self.events.is_empty()
    }

    fn tell(&mut self, time: AutopilotTime, what: What) {
        self.events.push(Event { time, what });
    }

    fn has_magnetometer(&self, now: AutopilotTime) -> bool {
        self.magnetic.is_some_and(|(t, _)| now.seconds_since(t) < MAGNETIC_AGE_S)
    }
}

/// A magnetometer sample is used for this long, s.
const MAGNETIC_AGE_S: f64 = 0.5;

fn tuned_grip(settings: &NavigatorSettings) -> GripParams {
    GripParams { k_p: Vector3::repeat(settings.observer.k_p), k_i: settings.observer.k_i, ..GripParams::km() }
}

fn tuned_fusini(settings: &NavigatorSettings) -> FusiniParams {
    let mut params = FusiniParams::tuned();
    params.k_p = Vector3::repeat(settings.observer.k_p);
    params.k_i = settings.observer.k_i;
    params.guard = settings.observer.guard;
    params.dead_reckoning.vv = settings.observer.holdover_k_vv;
    params.dead_reckoning.xv = settings.observer.holdover_k_xv;
    // The calibration takes the flow's bias out before the observer sees it.
    params.predict_flow_z = false;
    params
}
