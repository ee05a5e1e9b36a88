//! What is seen of a running daemon, as it is told: SI units but for degrees, where the name says so. Everything is a copy: whoever reads it holds nothing up.

use serde::Serialize;
use utoipa::ToSchema;

/// How everything fares at one moment.
#[derive(Clone, Debug, Default, PartialEq, Serialize, ToSchema)]
pub struct StatusView {
    /// Holdover's version.
    pub version: String,
    /// Since the daemon began, s.
    pub uptime_s: f64,
    /// The autopilot that is followed.
    pub vehicle: Option<VehicleView>,
    /// What the navigator does.
    pub mode: ModeView,
    /// How wrong it may be; none before there is a solution.
    pub uncertainty: Option<UncertaintyView>,
    /// What carries the horizontal velocity.
    pub carried_by: Option<String>,
    /// What an outage would come to.
    pub outlook: Option<OutlookView>,
    /// Every source that was heard.
    pub sources: Vec<SourceView>,
    /// Sources of height that are declared faulty.
    pub faulty_heights: Vec<String>,
    /// Where it is.
    pub plan: Option<PlanView>,
    /// What is sent.
    pub output: OutputView,
    /// What comes in.
    pub input: InputView,
    /// How the autopilot's clock is known.
    pub clock: ClockView,
}

/// The autopilot.
#[derive(Clone, Debug, Default, PartialEq, Serialize, ToSchema)]
pub struct VehicleView {
    /// Which one.
    pub autopilot: String,
    /// Its firmware, once told.
    pub version: Option<String>,
    /// Its system id.
    pub system: u8,
    /// Whether it is armed.
    pub armed: bool,
    /// Whether it is heard at present.
    pub heard: bool,
}

/// The mode.
#[derive(Clone, Debug, Default, PartialEq, Serialize, ToSchema)]
pub struct ModeView {
    /// Aligning, Aided, Holdover, Rejoining or Lost.
    pub name: String,
    /// For how long, s.
    pub for_s: f64,
    /// Why it changed last.
    pub reason: Option<String>,
    /// How the navigator stands to GNSS.
    pub gnss: String,
}

/// One standard deviation.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize, ToSchema)]
pub struct UncertaintyView {
    /// Of the horizontal position, √(P_NN + P_EE), m.
    pub horizontal_m: f64,
    /// Of the height, m.
    pub height_m: f64,
    /// Of the horizontal velocity, m/s.
    pub velocity_mps: f64,
    /// Of the heading, degrees.
    pub heading_deg: f64,
}

/// What an outage would come to, as the shadows have measured it on this flight.
#[derive(Clone, Debug, Default, PartialEq, Serialize, ToSchema)]
pub struct OutlookView {
    /// After so long without GNSS, s.
    pub after_s: f64,
    /// The position would be off by this, root mean square, m; none where it was not measured yet.
    pub off_m: Option<f64>,
    /// What would carry.
    pub carried_by: String,
    /// How often it was measured.
    pub times: u32,
}

/// A source.
#[derive(Clone, Debug, Default, PartialEq, Serialize, ToSchema)]
pub struct SourceView {
    /// Which kind.
    pub kind: String,
    /// Which of its kind.
    pub id: u8,
    /// healthy, suspect, faulty or silent.
    pub health: String,
    /// What is held against it.
    pub charge: Option<String>,
    /// Samples, 1/s.
    pub rate_hz: f64,
    /// Since the newest, s.
    pub age_s: f64,
    /// The innovations against their gate; above 1 they are outside.
    pub test_ratio: Option<f64>,
    /// Mean normalised innovation squared; 1 where the filter is honest.
    pub nis: Option<f64>,
    /// Samples used.
    pub used: u64,
    /// Samples refused.
    pub refused: u64,
    /// The reason for most of the latest refusals, while there are some.
    pub reason: Option<String>,
}

/// Plan view, in the navigator's frame.
#[derive(Clone, Debug, Default, PartialEq, Serialize, ToSchema)]
pub struct PlanView {
    /// Position, north, east and down, m.
    pub position_ned_m: [f64; 3],
    /// Velocity, north, east and down, m/s.
    pub velocity_ned_mps: [f64; 3],
    /// Heading, degrees.
    pub heading_deg: f64,
    /// The ellipse of one standard deviation: half axes, m, and the direction of the longer one from north, degrees.
    pub ellipse: EllipseView,
    /// The newest fix of GNSS, north and east, m, also where it is refused.
    pub gnss_m: Option<[f64; 2]>,
    /// The autopilot's own estimate, north and east, m.
    pub autopilot_m: Option<[f64; 2]>,
}

/// An ellipse on the ground.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize, ToSchema)]
pub struct EllipseView {
    /// Longer half axis, m.
    pub major_m: f64,
    /// Shorter half axis, m.
    pub minor_m: f64,
    /// Where the longer one points, degrees from north.
    pub azimuth_deg: f64,
}

/// What is sent to the autopilot, and what becomes of it.
#[derive(Clone, Debug, Default, PartialEq, Serialize, ToSchema)]
pub struct OutputView {
    /// Whether positions are sent, and why.
    pub sending: String,
    /// Positions sent.
    pub sent: u64,
    /// The same, 1/s.
    pub rate_hz: f64,
    /// Quality of the newest, 1 to 100, or -1.
    pub quality: Option<i8>,
    /// Withheld, as they were too old or held no number.
    pub withheld: u64,
    /// What the autopilot's position stands on.
    pub autopilot_on: Option<String>,
    /// What the autopilot makes of what is sent.
    pub fused: Option<String>,
    /// How the recording fares, where there is one.
    pub recording: Option<RecordingView>,
}

/// How a recording fares.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize, ToSchema)]
pub struct RecordingView {
    /// Bytes recorded.
    pub bytes: u64,
    /// Frames that are missing in it, as the disk was full or did not keep up.
    pub lost: u64,
}

/// What comes in.
#[derive(Clone, Debug, Default, PartialEq, Serialize, ToSchema)]
pub struct InputView {
    /// Frames taken.
    pub frames: u64,
    /// The same, 1/s.
    pub rate_hz: f64,
    /// What was refused, by cause.
    pub rejected: Vec<CountView>,
    /// Dropped because Holdover, or the kernel, did not keep up.
    pub dropped: u64,
    /// Datagrams and connections of strangers.
    pub strangers: u64,
    /// The links.
    pub links: Vec<LinkView>,
}

/// So many of something.
#[derive(Clone, Debug, Default, PartialEq, Serialize, ToSchema)]
pub struct CountView {
    /// What.
    pub cause: String,
    /// How many.
    pub count: u64,
}

/// A link.
#[derive(Clone, Debug, Default, PartialEq, Serialize, ToSchema)]
pub struct LinkView {
    /// Its endpoint.
    pub endpoint: String,
    /// The other end, while it is up.
    pub peer: Option<String>,
    /// Frames in and out.
    pub frames: [u64; 2],
    /// Frames lost on the way, by their numbers.
    pub lost: u64,
}

/// Clocks.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize, ToSchema)]
pub struct ClockView {
    /// The autopilot's less ours, s.
    pub offset_s: Option<f64>,
    /// Shortest round trip, ms.
    pub round_trip_ms: Option<f64>,
    /// Age of a position when it comes to the autopilot, ms.
    pub latency_ms: Option<f64>,
    /// Reboots of the autopilot.
    pub reboots: u32,
}

/// Something happened.
#[derive(Clone, Debug, Default, PartialEq, Serialize, ToSchema)]
pub struct EventView {
    /// Counts on from 1.
    pub number: u64,
    /// When, s since the daemon began.
    pub at_s: f64,
    /// When, by the companion's time of day, s since 1970.
    pub unix_s: f64,
    /// info, notice, warning or critical.
    pub severity: String,
    /// The event's code, where the navigator told it.
    pub code: Option<String>,
    /// A sentence.
    pub text: String,
}
