//! `holdover simulate`: the log of a simulated flight, with the truth in it, as an autopilot's telemetry would have it; or, live, the
//! autopilot itself ([`super::autopilot`]).

use std::io::Write;
use std::path::{Path, PathBuf};

use clap::{Args, ValueEnum};
use nalgebra::Vector3;

use crate::fault::{InjectedFault, Injector};
use crate::files::{OutputFile, Overwrite, READABLE, write_whole};
use crate::geo::{Body, BodyToNed, Ned};
use crate::sample::{Input, Sample};
use crate::sim::models::{AirspeedModel, GnssOutage, ImuModel, OutageKind, RangeModel};
use crate::sim::{Environment, MarkerWatch, Reading, Scenario, SensorSuite, Simulation, Truth};
use crate::wire::encode_vehicle::{self, VehicleTruth};
use crate::wire::frame::{ComponentId, SystemId};
use crate::wire::messages::Message;
use crate::wire::session::Address;
use crate::wire::session::identity::AutopilotKind;
use crate::wire::tlog_writer::TlogWriter;

use super::Failure;
use super::autopilot::{self, AutopilotArgs};
use super::flight::parse_interval;
use super::markers::{CAMERA, MarkerArgs, sighting, to_toml};
use super::progress::{ProgressUnit, bar};

/// Grades of IMU.
#[derive(Clone, Copy, Debug, PartialEq, Eq, ValueEnum)]
pub enum ImuGrade {
    /// 0.003 deg/s/sqrt(Hz), biases of some 0.03 deg/s that hardly move
    Tactical,
    /// 0.01 deg/s/sqrt(Hz), biases of some 0.5 deg/s that wander by 6 deg/h
    Mems,
}

impl ImuGrade {
    /// The model of it.
    pub(super) fn model(self) -> ImuModel {
        match self {
            ImuGrade::Tactical => ImuModel::tactical(),
            ImuGrade::Mems => ImuModel::mems(),
        }
    }
}

/// Whose messages are written.
#[derive(Clone, Copy, Debug, PartialEq, Eq, ValueEnum)]
pub enum Dialect {
    /// Truth in SIM_STATE
    Ardupilot,
    /// Truth in HIL_STATE_QUATERNION
    Px4,
}

/// Arguments of `simulate`.
#[derive(Debug, Args)]
pub struct SimulateArgs {
    /// What is flown: cessna, circles, legs, straight, square or patrol
    #[arg(required_unless_present = "autopilot")]
    pub scenario: Option<String>,
    /// The log to write (.tlog)
    #[arg(long, value_name = "FILE", required_unless_present = "autopilot")]
    pub out: Option<PathBuf>,
    /// Errors are drawn from this; the same seed gives the same bytes
    #[arg(long, default_value_t = 1)]
    pub seed: u64,
    /// How good the IMU is
    #[arg(long, value_enum, default_value = "tactical")]
    pub imu: ImuGrade,
    /// End earlier, or go on for longer, s
    #[arg(long, value_name = "S")]
    pub duration: Option<f64>,
    /// Whose messages are written
    #[arg(long, value_enum, default_value = "ardupilot")]
    pub dialect: Dialect,
    /// The receiver loses its fix from A to B, s (`replay --outage` makes outages of a good log instead)
    #[arg(long, value_name = "A..B", value_parser = parse_interval)]
    pub lose_gnss: Option<(f64, f64)>,
    /// Put a fault into what is recorded, as `replay --fault` does into what was; may be given several times
    #[arg(long, value_name = "FAULT", conflicts_with = "autopilot")]
    pub fault: Vec<InjectedFault>,
    /// A steady wind towards north and east, m/s, as in 4,-2
    #[arg(long, value_name = "N,E", value_parser = parse_wind, allow_hyphen_values = true)]
    pub wind: Option<(f64, f64)>,
    /// Carry an airspeed sensor
    #[arg(long)]
    pub airspeed: bool,
    /// Carry a rangefinder that reaches this far, m (a multirotor has one of 50 m anyway)
    #[arg(long, value_name = "M")]
    pub range: Option<f64>,
    /// Carry no optical flow
    #[arg(long)]
    pub no_flow: bool,
    /// Markers
    #[command(flatten)]
    pub markers: MarkerArgs,
    /// Overwrite the log if it is there
    #[arg(long)]
    pub force: bool,
    /// Being an autopilot instead
    #[command(flatten)]
    pub double: AutopilotArgs,
}

/// Longest flight: a day.
const LONGEST_S: f64 = 86_400.0;
/// Strongest wind, m/s: nothing small flies in more.
const STRONGEST_MPS: f64 = 20.0;
/// Farthest that DISTANCE_SENSOR can tell, m.
const FARTHEST_M: f64 = 600.0;
/// When the flights begin, µs since 1970: the first of January 2026, for which the simulated magnetic field holds.
const UNIX_US: u64 = 1_767_225_600_000_000;
/// The vehicle's id.
const VEHICLE: Address = Address { system: SystemId(1), component: ComponentId::AUTOPILOT };
/// Between messages that come by themselves, steps of the IMU.
const TRUTH_EVERY: u64 = 10;
const HEARTBEAT_EVERY: u64 = 100;
const ORIGIN_EVERY: u64 = 3000;

/// `N,E` in m/s.
///
/// # Errors
/// What is wrong with the text.
fn parse_wind(text: &str) -> Result<(f64, f64), String> {
    let wrong = || format!("\"{text}\" is not a wind: expected N,E in m/s, up to {STRONGEST_MPS} m/s");
    let (n, e) = text.split_once(',').ok_or_else(wrong)?;
    let (n, e): (f64, f64) = (n.trim().parse().map_err(|_| wrong())?, e.trim().parse().map_err(|_| wrong())?);
    if n.hypot(e) <= STRONGEST_MPS { Ok((n, e)) } else { Err(wrong()) }
}

/// Runs the command.
///
/// # Errors
/// [`Failure`].
pub fn run(args: &SimulateArgs, quiet: bool) -> Result<(), Failure> {
    if let Some(dialect) = args.double.autopilot {
        return autopilot::run(args, dialect);
    }
    let (Some(name), Some(out)) = (&args.scenario, &args.out) else {
        return Err(Failure::Usage("a scenario and --out are needed, or --autopilot".into()));
    };
    write_log(args, name, out, quiet)
}

fn write_log(args: &SimulateArgs, name: &str, out: &Path, quiet: bool) -> Result<(), Failure> {
    let (scenario, suite) = plan(args, name)?;
    let summary = scenario.summary();
    let (duration_s, outage) = (scenario.duration_s, scenario.outage_s);
    let camera = args.markers.camera(suite.imu.period_s)?;
    let field = args.markers.field(&scenario, args.seed)?;
    let landmarks =
        field.as_ref().map(|field| (to_toml(field, &camera, &scenario.origin), field.markers.len()));
    let watch = field.map(|field| MarkerWatch::new(field, camera, args.seed));
    let overwrite = Overwrite::forced(args.force);
    let sink = OutputFile::create(out, overwrite, READABLE)?;
    let mut recorder = Recorder::new(Simulation::new(scenario, suite, args.seed), watch, args.dialect, sink);
    recorder.faults = Injector::new(args.fault.clone(), args.seed);
    let bar = bar(ProgressUnit::Seconds, duration_s as u64, quiet);
    while let Some(t_s) = recorder.step()? {
        bar.set_position(t_s as u64);
    }
    let (count, bytes) = (recorder.log.count(), recorder.log.bytes());
    recorder.log.into_sink().finish()?;
    bar.finish_and_clear();
    let path = out.display();
    outln!("{path}: {summary}");
    outln!("  {duration_s:.1} s, {} messages, {:.1} MB, seed {}", count, bytes as f64 * 1e-6, args.seed);
    let mut config = String::new();
    if let Some((toml, count)) = landmarks {
        let beside = out.with_extension("landmarks.toml");
        write_whole(&beside, toml.as_bytes(), overwrite, READABLE)?;
        outln!("  {}: {count} markers and the camera", beside.display());
        config = format!(" --config {}", beside.display());
    }
    if let (Some((from, to)), None) = (outage.filter(|o| o.0 < duration_s), args.lose_gnss) {
        outln!(
            "  GNSS is good throughout; take it away with: holdover replay {path}{config} --outage {from}..{to}"
        );
    }
    Ok(())
}

/// The scenario and the sensors that the arguments ask for.
fn plan(args: &SimulateArgs, name: &str) -> Result<(Scenario, SensorSuite), Failure> {
    let mut scenario = Scenario::by_name(name).ok_or_else(|| {
        let known = Scenario::NAMES.join(", ");
        Failure::Usage(format!("there is no scenario \"{name}\"; there are: {known}"))
    })?;
    if let Some(duration_s) = args.duration {
        if !(1.0..=LONGEST_S).contains(&duration_s) {
            return Err(Failure::Usage(format!(
                "a flight of {duration_s} s: expected --duration from 1 to {LONGEST_S}"
            )));
        }
        scenario = scenario.lasting(duration_s);
    }
    if let Some((north, east)) = args.wind {
        scenario = scenario.with_wind(Vector3::new(north, east, 0.0));
    }
    let mut suite = SensorSuite::of(&scenario, args.imu.model());
    if let (Some((from_s, to_s)), Some(gnss)) = (args.lose_gnss, &mut suite.gnss) {
        gnss.outage = Some(GnssOutage { from_s, to_s, kind: OutageKind::NoFix });
    }
    if let Some(reach_m) = args.range {
        if !(1.0..=FARTHEST_M).contains(&reach_m) {
            return Err(Failure::Usage(format!(
                "a rangefinder of {reach_m} m: expected --range from 1 to {FARTHEST_M}"
            )));
        }
        suite.range = Some(RangeModel { limits_m: [0.1, reach_m], ..RangeModel::lidar() });
    }
    if args.airspeed {
        suite.airspeed = Some(AirspeedModel::pitot());
    }
    if args.no_flow {
        suite.flow = None;
    }
    Ok((scenario, suite))
}

/// Writes a flight as its autopilot would have sent it.
struct Recorder<W> {
    simulation: Simulation,
    markers: Option<MarkerWatch>,
    faults: Injector,
    autopilot: AutopilotKind,
    log: TlogWriter<W>,
    steps: u64,
    /// Of one step; kept for its memory.
    messages: Vec<Message>,
}

impl<W: Write> Recorder<W> {
    fn new(simulation: Simulation, markers: Option<MarkerWatch>, dialect: Dialect, sink: W) -> Self {
        let autopilot = match dialect {
            Dialect::Ardupilot => AutopilotKind::ArduPilot,
            Dialect::Px4 => AutopilotKind::Px4,
        };
        let log = TlogWriter::new(sink, VEHICLE);
        Self {
            simulation,
            markers,
            faults: Injector::default(),
            autopilot,
            log,
            steps: 0,
            messages: Vec::with_capacity(16),
        }
    }

    /// Writes the messages of one IMU step, the first time those of the beginning before. Its time, s; `None` when the flight is over.
    fn step(&mut self) -> std::io::Result<Option<f64>> {
        if self.steps == 0 {
            self.announce(0.0);
            // So that time 0 of the log is that of the flight.
            let start = self.simulation.truth(0.0);
            self.messages.extend(self.truth(&start));
            self.write(0.0)?;
        }
        let Some(reading) = self.simulation.next() else { return Ok(None) };
        self.steps += 1;
        self.messages_of(&reading);
        self.write(reading.t_s)?;
        self.pictures(&reading.truth)?;
        Ok(Some(reading.t_s))
    }

    /// What the camera tells of markers.
    fn pictures(&mut self, truth: &Truth) -> std::io::Result<()> {
        let Some(markers) = &mut self.markers else { return Ok(()) };
        let seen = markers.step(truth).map(|seen| sighting(&seen));
        let samples: Vec<_> = seen.filter_map(|s| heard(&mut self.faults, truth.t_s, s)).collect();
        encode_vehicle::samples(&samples, &mut self.messages);
        for message in self.messages.drain(..) {
            self.log.write_from(CAMERA, unix_us(truth.t_s), &message)?;
        }
        Ok(())
    }

    /// Who and when.
    fn announce(&mut self, t_s: f64) {
        let time = Simulation::ap_time(t_s);
        let status = self.simulation.scenario().status(t_s);
        self.messages.push(encode_vehicle::heartbeat(self.autopilot, &status));
        self.messages.push(encode_vehicle::sensors_present(self.simulation.suite().airspeed.is_some()));
        self.messages.extend(encode_vehicle::system_time(time, unix_us(t_s)));
    }

    fn messages_of(&mut self, reading: &Reading) {
        let told: Vec<Sample> =
            reading.samples.iter().filter_map(|s| heard(&mut self.faults, reading.t_s, *s)).collect();
        encode_vehicle::samples(&told, &mut self.messages);
        // The truth comes after the IMU sample whose time it takes.
        if self.steps.is_multiple_of(TRUTH_EVERY) {
            self.messages.extend(self.truth(&reading.truth));
        }
        if self.steps.is_multiple_of(HEARTBEAT_EVERY) {
            self.announce(reading.t_s);
        }
        if self.steps.is_multiple_of(ORIGIN_EVERY) || self.steps == HEARTBEAT_EVERY {
            let origin = self.simulation.scenario().origin;
            self.messages.extend(encode_vehicle::origin(reading.time, &origin));
        }
    }

    fn truth(&self, truth: &Truth) -> Option<Message> {
        let world: &Environment = &self.simulation.scenario().environment;
        let felt = world.imu_at(truth);
        let truth = VehicleTruth {
            time: Simulation::ap_time(truth.t_s),
            attitude: BodyToNed::from_matrix(&truth.r_body_to_ned),
            position: self.simulation.frame().to_geodetic(&truth.position_ned),
            velocity: Ned::new(truth.velocity_ned),
            angular_rate: Body::new(felt.angular_rate),
            specific_force: Body::new(felt.specific_force),
        };
        encode_vehicle::truth(self.autopilot, &truth)
    }

    fn write(&mut self, t_s: f64) -> std::io::Result<()> {
        for message in self.messages.drain(..) {
            self.log.write(unix_us(t_s), &message)?;
        }
        Ok(())
    }
}

/// What a sensor tells with the faults that are put in.
fn heard(faults: &mut Injector, t_s: f64, sample: Sample) -> Option<Sample> {
    match faults.alter(t_s, &Input::Sample(sample))? {
        Input::Sample(told) => Some(told),
        _ => None,
    }
}

/// Microseconds since 1970 of a time of the flight.
fn unix_us(t_s: f64) -> u64 {
    UNIX_US + (t_s * 1e6).round() as u64
}
