//! What shakes the inertial units, and how: the rotors' speeds, and the spectra of fast samples where a log holds batches of them.

use serde::Serialize;

use crate::log::LogSummary;
use crate::log::Parameters;
use crate::log::fast_samples::{FastKind, FastSensor};
use crate::log::rotors::RotorSpeeds;

/// Of the speeds that were told, these parts are below the ones that are shown.
const SHOWN: [f64; 3] = [0.1, 0.5, 0.9];
/// A tone is the rotors' if it is within this part of their speeds.
const CLOSE: f64 = 0.05;
const GYRO: &str = "gyro";
/// In `INS_LOG_BAT_OPT`: samples are of after the filter.
const AFTER_FILTER: u32 = 1 << 1;

/// The log's own stream of the inertial unit, which batches are compared with.
#[derive(Clone, Copy, Debug)]
pub(super) struct LoggedImu {
    /// Its rate, Hz.
    pub(super) rate_hz: Option<f64>,
    /// Its samples are single ones, and no means of faster ones.
    pub(super) single: bool,
    /// The log's length, s.
    pub(super) duration_s: f64,
}

/// See the module's documentation.
#[derive(Debug, Serialize)]
pub(super) struct VibrationReport {
    rotors: Option<RotorReport>,
    fast_sensors: Vec<FastReport>,
    /// What the log's own stream can show ends at half of this, Hz.
    imu_hz: Option<f64>,
}

#[derive(Clone, Copy, Debug, Serialize)]
struct RotorReport {
    controllers: u32,
    /// Slowest, middle and fastest, without a tenth at either end.
    hz: [f64; 3],
}

/// Batches of one sensor. Vibration is in rad/s or m/s², along the body's axes.
#[derive(Debug, Serialize)]
struct FastReport {
    sensor: &'static str,
    unit: u8,
    batches: u64,
    rate_hz: f64,
    part_of_time: f64,
    clipped: u64,
    vibration: Option<[f64; 3]>,
    strongest_hz: Option<f64>,
    strongest_part: Option<f64>,
    folded: Option<f64>,
    filter_hz: Option<f64>,
}

impl VibrationReport {
    pub(super) fn of(summary: &LogSummary, logged: LoggedImu) -> Self {
        let fast = summary.fast.all().map(|s| FastReport::of(s, &summary.parameters, logged));
        Self {
            rotors: RotorReport::of(&summary.rotors),
            fast_sensors: fast.collect(),
            imu_hz: logged.rate_hz,
        }
    }

    pub(super) fn print(&self) {
        if self.rotors.is_none() && self.fast_sensors.is_empty() {
            return;
        }
        outln!("\nVibration");
        if let Some(RotorReport { controllers, hz: [slow, middle, fast] }) = self.rotors {
            outln!("  {:<17} {controllers}, at {slow:.0} to {fast:.0} Hz, mostly {middle:.0} Hz", "rotors");
            if let Some(imu_hz) = self.imu_hz.filter(|hz| *hz < 2.0 * middle) {
                outln!(
                    "  {:<17} faster than the log's IMU can show at {imu_hz:.0} Hz: what filters and means leave of it stands in there as slow motion",
                    ""
                );
            }
        }
        self.fast_sensors.iter().for_each(|sensor| sensor.print(self.rotors.as_ref(), self.imu_hz));
    }
}

impl RotorReport {
    fn of(speeds: &RotorSpeeds) -> Option<Self> {
        let [slow, middle, fast] = SHOWN.map(|part| speeds.quantile_hz(part));
        Some(Self { controllers: speeds.controllers(), hz: [slow?, middle?, fast?] })
    }

    /// Whose a tone is, in words.
    fn explains(&self, tone_hz: f64) -> &'static str {
        let [slow, _, fast] = self.hz;
        let within = |hz: f64| hz > slow * (1.0 - CLOSE) && hz < fast * (1.0 + CLOSE);
        match (within(tone_hz), within(0.5 * tone_hz)) {
            (true, _) => ", as fast as the rotors turn",
            (_, true) => ", twice as fast as the rotors turn",
            _ => "",
        }
    }
}

impl FastReport {
    fn of(sensor: &FastSensor, parameters: &Parameters, logged: LoggedImu) -> Self {
        let (name, filter) = match sensor.kind {
            FastKind::Gyro => (GYRO, "INS_GYRO_FILTER"),
            FastKind::Accelerometer => ("accelerometer", "INS_ACCEL_FILTER"),
        };
        let after = parameters.get("INS_LOG_BAT_OPT").is_some_and(|o| o as u32 & AFTER_FILTER != 0);
        let filter_hz = parameters.get(filter).filter(|hz| *hz > 0.0);
        let tone = sensor.strongest();
        Self {
            sensor: name,
            unit: sensor.unit,
            batches: sensor.batches,
            rate_hz: sensor.rate_hz,
            part_of_time: sensor.samples as f64 / sensor.rate_hz / logged.duration_s,
            clipped: sensor.clipped,
            vibration: sensor.vibration(),
            strongest_hz: tone.map(|t| t.hz),
            strongest_part: tone.map(|t| t.part),
            folded: folded(sensor, filter_hz.filter(|_| !after), after, logged),
            filter_hz,
        }
    }

    fn print(&self, rotors: Option<&RotorReport>, imu_hz: Option<f64>) {
        let (name, percent) = (format!("{} {}", self.sensor, self.unit), 100.0 * self.part_of_time);
        let is_gyro = self.sensor == GYRO;
        let unit = if is_gyro { "deg/s" } else { "m/s²" };
        let of = |v: f64| if is_gyro { v.to_degrees() } else { v };
        let FastReport { batches, rate_hz, .. } = self;
        let Some(vibration) = self.vibration else {
            outln!("  {name:<17} {batches} batches at {rate_hz:.0} Hz, too short for a spectrum");
            return;
        };
        let [x, y, z] = vibration.map(of);
        outln!(
            "  {name:<17} {batches} batches at {rate_hz:.0} Hz, {percent:.0} % of the time: {x:.2} {y:.2} {z:.2} {unit} along x, y, z"
        );
        if let (Some(hz), Some(part)) = (self.strongest_hz, self.strongest_part) {
            let whose = rotors.map_or("", |r| r.explains(hz));
            outln!("  {:<17} {:.0} % of its square at {hz:.0} Hz{whose}", "", 100.0 * part);
        }
        if let (Some(folded), Some(imu_hz)) = (self.folded, imu_hz) {
            let filter = self.filter_hz.map_or(String::new(), |hz| format!(" of {hz:.0} Hz"));
            outln!(
                "  {:<17} {:.2} {unit} of it passes the autopilot's filter{filter} and is too fast for the log's IMU at {imu_hz:.0} Hz: it is noise there",
                "",
                of(folded)
            );
        }
        if self.clipped > 0 {
            outln!("  {:<17} {} samples clip", "", self.clipped);
        }
    }
}

/// Root mean square, over the axes, of what the log's own stream of single samples folds into slow motion: what is faster than half its rate
/// and passes the filter, a Butterworth low-pass of second order. `None` where that is not known.
fn folded(sensor: &FastSensor, filter_hz: Option<f64>, after_filter: bool, logged: LoggedImu) -> Option<f64> {
    let half_hz = 0.5 * logged.rate_hz.filter(|_| logged.single)?;
    let corner_hz = if after_filter { f64::INFINITY } else { filter_hz? };
    let gain = |hz: f64| if hz > half_hz { (1.0 + (hz / corner_hz).powi(4)).sqrt().recip() } else { 0.0 };
    let passed = sensor.passed(gain)?;
    Some((passed.iter().map(|v| v * v).sum::<f64>() / 3.0).sqrt())
}
