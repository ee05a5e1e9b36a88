//! Logging that pauses, begins late or ends early: what was said of the vehicle is heard all the same, and nothing beside the pause is lost.

use holdover::sample::{Input, Sample};
use holdover::wire::counters::Cause;

use crate::command::{holdover, write_log};
use crate::dataflash_file::DataFlashFile;
use crate::inputs;
use crate::ulog_file::{Fields, UlogFile};

const ARMED: f64 = 10.0;
const DISARMED: f64 = 11.0;
const LANDED: f64 = 18.0;
const TAKEN_OFF: f64 = 28.0;
/// When the logs here begin, s since boot.
const BEGINS_S: f64 = 20.0;

fn micros(t_s: f64) -> u64 {
    ((BEGINS_S + t_s) * 1e6).round() as u64
}

/// A log of ArduPilot's, told in seconds since its first sample.
struct Told(DataFlashFile);

impl Told {
    fn new() -> Self {
        Self(DataFlashFile::new())
    }

    fn imu(&mut self, t_s: f64) {
        let told = [0.0, 0.1, 0.0, 0.0, 0.0, 0.0, -9.8, 0.0, 0.0, 40.0, 1.0, 1.0, 1000.0, 1000.0];
        self.0.message("IMU", micros(t_s), &told);
    }

    /// The IMU at 50 Hz, from when to when.
    fn runs(&mut self, from_s: f64, to_s: f64) {
        let n = ((to_s - from_s) * 50.0).round() as u32;
        (0..=n).for_each(|i| self.imu(from_s + f64::from(i) * 0.02));
    }

    fn event(&mut self, t_s: f64, id: f64) {
        self.0.message("EV", micros(t_s), &[id]);
    }

    /// An event as Copter wrote it to 3.3: without a time.
    fn old_event(&mut self, id: f64) {
        const KIND: u8 = 90;
        let text = |text: &str, n| text.bytes().chain(std::iter::repeat(0)).take(n).collect::<Vec<u8>>();
        let described = [text("EV", 4), text("B", 16), text("Id", 64)].concat();
        self.0.bytes.extend([&[0xA3, 0x95, 128, KIND, 4][..], &described].concat());
        self.0.bytes.extend([0xA3, 0x95, KIND, id as u8]);
    }

    fn read(&self) -> (Vec<Input>, holdover::log::LogSummary) {
        let folder = tempfile::tempdir().unwrap();
        inputs(&write_log(folder.path(), "log", &self.0.bytes))
    }

    /// When it was armed and when it flew, as `inspect` has it.
    fn periods(&self) -> [Vec<(f64, f64)>; 2] {
        let folder = tempfile::tempdir().unwrap();
        let log = write_log(folder.path(), "log", &self.0.bytes);
        let report = holdover(&["inspect", log.to_str().unwrap(), "--json"]).json();
        ["armed", "in_air"].map(|key| {
            let number = |v: &serde_json::Value| v.as_f64().unwrap();
            let all = report[key].as_array().unwrap();
            all.iter().map(|p| (number(&p["from_s"]), number(&p["to_s"]))).collect()
        })
    }
}

fn near(told: &[(f64, f64)], expected: &[(f64, f64)]) {
    let same = |a: f64, b: f64| (a - b).abs() < 0.05;
    let fits = told.iter().zip(expected).all(|(a, b)| same(a.0, b.0) && same(a.1, b.1));
    assert!(told.len() == expected.len() && fits, "{told:?} instead of {expected:?}");
}

fn imu_times(inputs: &[Input]) -> Vec<i64> {
    let imu = |i: &Input| match i {
        Input::Sample(Sample::Imu(s)) => Some(s.time.micros()),
        _ => None,
    };
    inputs.iter().filter_map(imu).collect()
}

#[test]
fn what_ends_a_pause_is_read_in_its_order() {
    let mut log = Told::new();
    log.runs(0.0, 5.0);
    // A jump is believed by the fourth stamp; these are before it.
    log.event(30.0, ARMED);
    log.imu(30.01);
    log.event(30.02, TAKEN_OFF);
    log.runs(30.04, 60.0);
    let (inputs, summary) = log.read();
    assert_eq!(summary.counters.seen().count(), 0, "{:?}", summary.remarks());
    let times = imu_times(&inputs);
    assert_eq!(times.len(), 251 + 1 + 1499, "every sample");
    assert!(times.is_sorted());
    assert_eq!(times[251] - times[250], 25_010_000);
    let [armed, in_air] = log.periods();
    near(&armed, &[(30.0, 60.0)]);
    near(&in_air, &[(30.0, 60.0)]);
}

#[test]
fn damaged_stamps_cost_themselves_and_no_state() {
    let mut log = Told::new();
    log.runs(0.0, 5.0);
    for wild_s in [400.0, 4000.0, 90.0] {
        log.imu(wild_s);
    }
    log.runs(5.02, 10.0);
    log.event(700.0, ARMED);
    log.runs(10.02, 15.0);
    let (inputs, summary) = log.read();
    let times = imu_times(&inputs);
    assert!(times.is_sorted() && times.len() == 751, "{}", times.len());
    assert_eq!(times.last(), Some(&((BEGINS_S as i64 + 15) * 1_000_000)));
    assert_eq!(summary.counters.of(Cause::Stale), 3);
    near(&log.periods()[0], &[(10.0, 15.0)]);
}

#[test]
fn a_pause_of_another_autopilots_log_costs_nothing_either() {
    let mut file = UlogFile::new(&[]);
    let declaration = "float[3] gyro_rad;uint32_t gyro_integral_dt;float[3] accelerometer_m_s2";
    let mut combined = |us: u64| {
        let fields = Fields::default().f32(0.2).f32(0.0).f32(0.0).u32(4000).f32(0.0).f32(0.0).f32(-9.7);
        file.data("sensor_combined", declaration, us, fields);
    };
    (0..500).for_each(|i| combined(2_000_000 + i * 4000));
    (0..500).for_each(|i| combined(9_000_000 + i * 4000));
    let folder = tempfile::tempdir().unwrap();
    let (inputs, summary) = inputs(&write_log(folder.path(), "log", &file.bytes));
    assert_eq!((imu_times(&inputs).len(), summary.counters.seen().count()), (1000, 0));
}

#[test]
fn who_is_armed_again_after_a_pause_was_disarmed_when_it_began() {
    let mut log = Told::new();
    log.event(0.0, ARMED);
    log.runs(0.0, 5.0);
    log.event(5.0, TAKEN_OFF);
    // The motors stop, and with them the log.
    log.runs(5.02, 20.0);
    log.event(50.0, ARMED);
    log.runs(50.02, 60.0);
    log.event(60.0, TAKEN_OFF);
    log.runs(60.02, 70.0);
    // Lost data, and no word of arms.
    log.runs(80.0, 90.0);
    log.event(90.0, LANDED);
    log.runs(90.02, 91.0);
    log.event(91.0, DISARMED);
    log.runs(91.02, 95.0);
    let [armed, in_air] = log.periods();
    near(&armed, &[(0.0, 20.0), (50.0, 91.0)]);
    near(&in_air, &[(5.0, 20.0), (60.0, 90.0)]);
}

#[test]
fn a_pause_before_the_first_sample_is_no_time() {
    let mut log = Told::new();
    // What the autopilot says of its start.
    log.event(-19.0, 62.0);
    log.runs(0.0, 5.0);
    log.event(5.0, ARMED);
    log.runs(5.02, 30.0);
    near(&log.periods()[0], &[(5.0, 30.0)]);
}

#[test]
fn a_log_that_begins_in_flight_tells_of_its_end() {
    let mut log = Told::new();
    log.runs(0.0, 30.0);
    log.event(30.0, LANDED);
    log.runs(30.02, 32.0);
    log.0.message("ARM", micros(32.0), &[0.0]);
    log.event(32.0, DISARMED);
    log.runs(32.02, 40.0);
    let [armed, in_air] = log.periods();
    near(&armed, &[(0.0, 32.0)]);
    near(&in_air, &[(0.0, 30.0)]);
}

#[test]
fn what_ends_without_a_word_of_its_beginning_began_no_earlier_than_the_pause_ended() {
    let mut log = Told::new();
    log.runs(0.0, 14.0);
    // Logging stands still while it is disarmed, and goes on with the motors.
    log.runs(630.0, 680.0);
    log.event(680.0, LANDED);
    log.runs(680.02, 682.0);
    log.event(682.0, DISARMED);
    log.runs(682.02, 690.0);
    let [armed, in_air] = log.periods();
    near(&armed, &[(630.0, 682.0)]);
    near(&in_air, &[(630.0, 680.0)]);
}

#[test]
fn events_without_a_time_are_of_the_time_of_what_stands_before_them() {
    let mut log = Told::new();
    log.runs(0.0, 5.0);
    log.old_event(ARMED);
    log.runs(5.02, 10.0);
    log.old_event(TAKEN_OFF);
    log.runs(10.02, 20.0);
    // It is disarmed, falls silent, and is armed again: all of it between two stamps, and the first of it not said.
    log.old_event(ARMED);
    log.runs(40.0, 50.0);
    log.old_event(TAKEN_OFF);
    log.runs(50.02, 55.0);
    // The same, and all of it said.
    [LANDED, DISARMED, ARMED].into_iter().for_each(|id| log.old_event(id));
    log.runs(70.0, 80.0);
    log.old_event(DISARMED);
    let (_, summary) = log.read();
    assert_eq!(summary.counters.seen().count(), 0, "{:?}", summary.remarks());
    let [armed, in_air] = log.periods();
    near(&armed, &[(5.0, 20.0), (40.0, 55.0), (70.0, 80.0)]);
    near(&in_air, &[(10.0, 20.0), (50.0, 55.0)]);
}

#[test]
fn a_time_of_day_that_is_not_believed_is_called_so() {
    let mut log = Told::new();
    for i in 0..4u32 {
        let t_s = f64::from(i) * 0.2;
        log.runs(t_s, t_s + 0.18);
        let milliseconds = if i == 0 { 1000.0 } else { 19_000.0 } + t_s * 1e3;
        let fix = [0.0, 3.0, milliseconds, 2300.0, 9.0, 1.0, 47.0, 8.0, 500.0, 0.0, 0.0, 0.0, 0.0, 1.0];
        log.0.message("GPS", micros(t_s), &fix);
    }
    let remarks = log.read().1.remarks();
    assert!(remarks.iter().any(|r| r.contains("3 unconfirmed (a time of day")), "{remarks:?}");
}

#[test]
fn fixes_of_a_few_seconds_are_nothing_to_score_against_and_receivers_are_told_apart() {
    let folder = tempfile::tempdir().unwrap();
    let report = |seconds: u32| {
        let mut log = Told::new();
        log.runs(0.0, 30.0);
        for i in 0..seconds * 5 {
            let t_s = f64::from(i) * 0.2;
            for receiver in [0.0, 1.0] {
                let fix = [receiver, 3.0, 0.0, 0.0, 9.0, 1.0, 47.0, 8.0, 500.0, 0.0, 0.0, 0.0, 0.0, 1.0];
                log.0.message("GPS", micros(t_s), &fix);
            }
        }
        let log = write_log(folder.path(), "log", &log.0.bytes);
        holdover(&["inspect", log.to_str().unwrap()]).out
    };
    let (few, many) = (report(3), report(20));
    assert!(few.contains("no score: GNSS has fixes over 2.8 s alone"), "{few}");
    assert!(many.contains("score against GNSS"), "{many}");
    assert!(many.contains("GNSS 2"), "{many}");
    let rates: Vec<&str> = many.lines().filter(|l| l.trim_start().starts_with("GNSS")).collect();
    assert!(rates[..2].iter().all(|row| row.contains(" 100 ") && row.contains(" 5.0 ")), "{rates:?}");
}

#[test]
fn a_ulog_of_another_autopilot_says_that_nothing_in_it_is_known() {
    let mut file = UlogFile::new(&[]);
    for i in 0..20 {
        let us = 2_000_000 + i * 100_000;
        file.data("PathPlanner", "float target", us, Fields::default().f32(1.0));
        file.data("Vehicle", "float thrust", us, Fields::default().f32(1.0));
    }
    let folder = tempfile::tempdir().unwrap();
    let log = write_log(folder.path(), "log", &file.bytes);
    let text = holdover(&["inspect", log.to_str().unwrap()]).out;
    assert!(text.contains("another autopilot (system 1), ULog"), "{text}");
    assert!(text.contains("none of its messages is known (PathPlanner, Vehicle)"), "{text}");
}
