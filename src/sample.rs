//! Typed, stamped measurements as they enter the core, and the reference data that must not.
//!
//! A [`Sample`] is what a sensor measured, in SI units and a named frame, stamped with the autopilot's clock. A [`Reference`] is
//! simulator truth or the autopilot's own estimate: it may be compared with, drawn and (outbound) aligned to, but it has another
//! type so that no filter can take it by accident: an autopilot's estimate contains what Holdover sent.
//!
//! ```
//! use holdover::geo::Geodetic;
//! use holdover::sample::{GnssFix, GnssSample, GroundVelocity, Sample, SampleKind};
//! use holdover::time::AutopilotTime;
//!
//! let fix = GnssSample {
//!     time: AutopilotTime::from_micros(12_000_000),
//!     receiver: 0,
//!     fix: GnssFix::ThreeD,
//!     position: Some(Geodetic::from_degrees(63.4, 10.4, 150.0)),
//!     ground_velocity: Some(GroundVelocity { speed_mps: 12.0, course_rad: 0.0 }),
//!     horizontal_accuracy_m: Some(0.8),
//!     vertical_accuracy_m: None,
//!     speed_accuracy_mps: None,
//!     satellites: Some(14),
//!     warning: None,
//! };
//! assert!(fix.is_possible());
//! assert!(!GnssSample { horizontal_accuracy_m: Some(f64::NAN), ..fix }.is_possible());
//! assert_eq!(Sample::Gnss(fix).kind(), SampleKind::Gnss);
//! ```

use nalgebra::Vector3;
use strum::{IntoStaticStr, VariantArray};

use crate::geo::{Body, BodyToNed, Geodetic, Ned};
use crate::time::{AutopilotTime, ClockEvent, Span};

/// What the core is given, in the order in which it came: everything that live flight, replay and simulation have in common.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Input {
    /// A measurement.
    Sample(Sample),
    /// Truth or the autopilot's own estimate.
    Reference(Reference),
    /// The origin of the autopilot's local frame.
    Origin(Geodetic),
    /// What the vehicle is, whether it is armed and whether it has landed: when that changes.
    Status(VehicleStatus),
    /// The autopilot rebooted, or its stream had a hole.
    Clock(ClockEvent),
}

/// One measurement.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Sample {
    /// Angular rate and specific force.
    Imu(ImuSample),
    /// Magnetic field.
    Mag(MagSample),
    /// Satellite navigation fix, or the word that there is none.
    Gnss(GnssSample),
    /// Static pressure.
    Pressure(PressureSample),
    /// Optical flow of one image patch.
    Flow(FlowSample),
    /// Distance along a beam.
    Range(RangeSample),
    /// Airspeed as the autopilot measures it.
    Airspeed(AirspeedSample),
    /// A known landmark seen by a camera.
    Landmark(LandmarkSample),
}

/// Kinds of [`Sample`], for tables and counters.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Hash, IntoStaticStr, VariantArray)]
pub enum SampleKind {
    /// See [`Sample::Imu`].
    #[strum(serialize = "IMU")]
    Imu,
    /// See [`Sample::Mag`].
    #[strum(serialize = "magnetometer")]
    Mag,
    /// See [`Sample::Gnss`].
    #[strum(serialize = "GNSS")]
    Gnss,
    /// See [`Sample::Pressure`].
    #[strum(serialize = "barometer")]
    Pressure,
    /// See [`Sample::Flow`].
    #[strum(serialize = "optical flow")]
    Flow,
    /// See [`Sample::Range`].
    #[strum(serialize = "rangefinder")]
    Range,
    /// See [`Sample::Airspeed`].
    #[strum(serialize = "airspeed")]
    Airspeed,
    /// See [`Sample::Landmark`].
    #[strum(serialize = "landmark")]
    Landmark,
}

impl SampleKind {
    /// All kinds, in the order they are shown.
    pub const ALL: &'static [Self] = Self::VARIANTS;

    /// Name for tables.
    pub fn label(self) -> &'static str {
        self.into()
    }
}

/// Angular rate and specific force. Whether the values are means over the last interval or instantaneous depends on
/// the stream: at 50 Hz and more the difference is below the noise.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct ImuSample {
    /// End of the sampling interval.
    pub time: AutopilotTime,
    /// Angular rate of the body relative to inertial space, rad/s.
    pub angular_rate: Body<Vector3<f64>>,
    /// Specific force, m/s² (about −9.8 in z when level and at rest).
    pub specific_force: Body<Vector3<f64>>,
}

/// Magnetic field.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct MagSample {
    /// When it was measured.
    pub time: AutopilotTime,
    /// Which magnetometer.
    pub sensor: u8,
    /// Field, tesla.
    pub field: Body<Vector3<f64>>,
}

/// What kind of fix a receiver says it has.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub enum GnssFix {
    /// No receiver, no fix, or time only.
    None,
    /// Two dimensions: the height is a guess.
    TwoD,
    /// Three dimensions, alone or with corrections.
    ThreeD,
    /// Differential, RTK float or fixed, static or precise point positioning.
    Corrected,
}

/// What a GNSS receiver says. Without a fix, `position` is `None` whatever the message held.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct GnssSample {
    /// The receiver's stamp where it is usable, else the newest time of the stream. Latency is on top of it (configuration).
    pub time: AutopilotTime,
    /// Which receiver, 0 or 1.
    pub receiver: u8,
    /// Kind of fix.
    pub fix: GnssFix,
    /// Latitude, longitude and height above mean sea level.
    pub position: Option<Geodetic>,
    /// Speed over ground, m/s, and course over ground, rad from true north. MAVLink's GPS_RAW_INT has no vertical speed.
    pub ground_velocity: Option<GroundVelocity>,
    /// Horizontal accuracy (1 sigma), m, as the receiver claims.
    pub horizontal_accuracy_m: Option<f64>,
    /// Vertical accuracy (1 sigma), m, as the receiver claims.
    pub vertical_accuracy_m: Option<f64>,
    /// Speed accuracy (1 sigma), m/s, as the receiver claims.
    pub speed_accuracy_mps: Option<f64>,
    /// Satellites used, if told.
    pub satellites: Option<u8>,
    /// What the receiver itself says against its signals.
    pub warning: Option<GnssWarning>,
}

/// What a receiver finds wrong with its own signals.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum GnssWarning {
    /// They are spoofed.
    Spoofed,
    /// They are jammed.
    Jammed,
    /// They contradict each other (receiver autonomous integrity monitoring).
    Inconsistent,
}

impl GnssSample {
    /// Whether every number that it tells can be one: finite, and no farther, faster or worse than any receiver's.
    pub fn is_possible(&self) -> bool {
        let place = self.position.is_none_or(|p| p.is_plausible());
        let motion = self
            .ground_velocity
            .is_none_or(|v| v.speed_mps.abs() < MAX_SPEED_MPS && v.course_rad.abs() < MAX_COURSE_RAD);
        let claims = [self.horizontal_accuracy_m, self.vertical_accuracy_m, self.speed_accuracy_mps];
        place && motion && claims.iter().flatten().all(|a| (0.0..MAX_ACCURACY).contains(a))
    }
}

/// Faster than any orbit.
const MAX_SPEED_MPS: f64 = 1e4;
/// More than a turn either way.
const MAX_COURSE_RAD: f64 = 10.0;
/// Worse than the whole Earth, m or m/s.
const MAX_ACCURACY: f64 = 1e7;

/// Speed and course over ground.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct GroundVelocity {
    /// Speed over ground, m/s.
    pub speed_mps: f64,
    /// Course over ground, rad from true north. Noise when slow.
    pub course_rad: f64,
}

impl GroundVelocity {
    /// North and east components, m/s.
    pub fn north_east(&self) -> (f64, f64) {
        (self.speed_mps * self.course_rad.cos(), self.speed_mps * self.course_rad.sin())
    }
}

/// Static pressure.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct PressureSample {
    /// When it was measured (`time_boot_ms`; the message may come 0.2 s later).
    pub time: AutopilotTime,
    /// Which barometer.
    pub sensor: u8,
    /// Static pressure, Pa.
    pub pressure_pa: f64,
}

/// What an optical flow sensor saw: the mean angular flow of a patch about the image axes.
///
/// Signs are those of MAVLink: a positive rate about x (y) is a right-hand rotation of the image about the body's x (y) axis,
/// so with d the distance along the optical axis v_x = d·(rate_y − gyro_y), v_y = −d·(rate_x − gyro_x).
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct FlowSample {
    /// End of the integration interval.
    pub time: AutopilotTime,
    /// Which sensor or patch.
    pub sensor: u8,
    /// How long the flow was integrated; zero where the message gives a rate, and is sent once for each reading.
    pub interval: Span,
    /// Mean flow rate about the sensor's x and y axes, rad/s.
    pub rate_xy: [f64; 2],
    /// What of the rotation is in `rate_xy`.
    pub rotation: FlowRotation,
    /// 0 (worst) to 1 (best).
    pub quality: f64,
    /// Distance to the centre of the scene that came with the flow, m.
    pub distance_m: Option<f64>,
}

/// How a flow sensor treats the rotation of the vehicle.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum FlowRotation {
    /// The sensor's own gyro over the same interval, rad/s about x and y: to be subtracted.
    SensorGyro([f64; 2]),
    /// Contained in the flow; to be subtracted with the vehicle's gyro.
    Contained,
    /// Already taken out.
    Removed,
    /// Contained, and `rate_xy` is not rad/s but in a unit of the sensor's own, such as pixels a second.
    InOwnUnit,
}

/// Where a range beam points.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum RangeDirection {
    /// Along body +z.
    Down,
    /// Any other way: shown, not used for height.
    Other(u8),
}

/// Distance along a beam. Sensors send values beyond their own limits, so the limits come along.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct RangeSample {
    /// When it was measured.
    pub time: AutopilotTime,
    /// Which rangefinder.
    pub sensor: u8,
    /// Where it points.
    pub direction: RangeDirection,
    /// Distance along the beam, m.
    pub distance_m: f64,
    /// Least and greatest distance that the sensor can measure, m.
    pub limits_m: Option<[f64; 2]>,
}

/// Airspeed.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct AirspeedSample {
    /// When it was measured.
    pub time: AutopilotTime,
    /// Airspeed, m/s (indicated or true, as the autopilot sends it).
    pub airspeed_mps: f64,
}

/// A landmark in a camera's view.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct LandmarkSample {
    /// When the picture was taken.
    pub time: AutopilotTime,
    /// Which camera: the component that tells of it.
    pub camera: u8,
    /// Which landmark (`target_num`).
    pub id: u8,
    /// What was seen.
    pub sighting: Sighting,
}

/// A bearing, or a position relative to the vehicle.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Sighting {
    /// Angles from the optical axis along the image's x (right) and y (down), rad, and the distance if known, m.
    Bearing {
        /// Offsets from the centre of the image, rad.
        angle_xy: [f64; 2],
        /// Distance to the landmark, m.
        distance_m: Option<f64>,
    },
    /// Position of the landmark from the vehicle, m.
    Body(Body<Vector3<f64>>),
}

impl Sample {
    /// When it was measured.
    pub fn time(&self) -> AutopilotTime {
        match self {
            Sample::Imu(s) => s.time,
            Sample::Mag(s) => s.time,
            Sample::Gnss(s) => s.time,
            Sample::Pressure(s) => s.time,
            Sample::Flow(s) => s.time,
            Sample::Range(s) => s.time,
            Sample::Airspeed(s) => s.time,
            Sample::Landmark(s) => s.time,
        }
    }

    /// Its kind.
    pub fn kind(&self) -> SampleKind {
        match self {
            Sample::Imu(_) => SampleKind::Imu,
            Sample::Mag(_) => SampleKind::Mag,
            Sample::Gnss(_) => SampleKind::Gnss,
            Sample::Pressure(_) => SampleKind::Pressure,
            Sample::Flow(_) => SampleKind::Flow,
            Sample::Range(_) => SampleKind::Range,
            Sample::Airspeed(_) => SampleKind::Airspeed,
            Sample::Landmark(_) => SampleKind::Landmark,
        }
    }
}

/// What kind of vehicle it is: what it can be expected to do.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Airframe {
    /// Hovers, flies in any direction.
    Multirotor,
    /// Flies nose first.
    FixedWing,
    /// Drives or floats.
    Surface,
}

/// What the autopilot says of the vehicle itself.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct VehicleStatus {
    /// Its kind, where it says one that is known.
    pub airframe: Option<Airframe>,
    /// Whether it is armed; a disarmed one does not fly.
    pub armed: Option<bool>,
    /// Whether it finds that it stands on the ground. No filter takes its word for it.
    pub landed: Option<bool>,
}

/// Simulator truth or the autopilot's own estimate. No filter takes this type.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Reference {
    /// What the simulator knows.
    Truth(TruthState),
    /// The autopilot's attitude.
    Attitude {
        /// When.
        time: AutopilotTime,
        /// Attitude.
        attitude: BodyToNed,
    },
    /// The autopilot's position and velocity at its own origin.
    Local {
        /// When.
        time: AutopilotTime,
        /// Position, m.
        position: Ned<Vector3<f64>>,
        /// Velocity, m/s.
        velocity: Ned<Vector3<f64>>,
    },
    /// The autopilot's position on the globe.
    Global {
        /// When.
        time: AutopilotTime,
        /// Position.
        position: Geodetic,
        /// Velocity, m/s.
        velocity: Ned<Vector3<f64>>,
    },
}

/// The simulated vehicle's true state.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct TruthState {
    /// When (SIM_STATE carries no time: the newest of the stream).
    pub time: AutopilotTime,
    /// Attitude, if told.
    pub attitude: Option<BodyToNed>,
    /// Position, if told.
    pub position: Option<Geodetic>,
    /// Velocity, m/s, if told.
    pub velocity: Option<Ned<Vector3<f64>>>,
}

impl Reference {
    /// When it holds.
    pub fn time(&self) -> AutopilotTime {
        match self {
            Reference::Truth(t) => t.time,
            Reference::Attitude { time, .. }
            | Reference::Local { time, .. }
            | Reference::Global { time, .. } => *time,
        }
    }
}
