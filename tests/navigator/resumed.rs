//! A navigator that is dropped in an outage, and another that goes on from what was kept of it: on a recorded flight, against the
//! simulator's truth; and whatever is in the file.

use std::sync::OnceLock;

use crate::command::{COPTER, sitl_log};
use crate::flight::{self, Step, ready_rotor, ready_wing};
use crate::sound::check_form;
use holdover::config::{Settings, Sources};
use holdover::geo::Ned;
use holdover::log::Log;
use holdover::metrics::ReferenceState;
use holdover::navigator::Navigator;
use holdover::navigator::event::EventKind;
use holdover::navigator::memory::{ResumeError, Snapshot};
use holdover::navigator::solution::{Mode, Solution, VelocitySource};
use holdover::outbound::alignment::AlignmentMemory;
use holdover::replay::runner::Runner;
use holdover::sample::{Input, Reference, Sample, SampleKind};
use holdover::state::{Boot, KeptState, MOST_BYTES, StateError, StateFile, read};
use holdover::time::{AutopilotTime, Span};
use holdover::wire::frame::SystemId;
use holdover::wire::session::identity::Vehicle;
use nalgebra::Vector3;
use proptest::prelude::*;
use serde_json::Value;

/// GNSS is lost here and the process is killed there, s since the first sample of the recorded flight.
const OUTAGE: (f64, f64) = (265.0, 325.0);
const KILLED_S: f64 = 285.0;

/// What was flown after the process was killed, or would have been.
struct After {
    /// Seconds since it was killed, horizontal errors of position and velocity, and the solution.
    states: Vec<(f64, f64, f64, Solution)>,
    events: Vec<EventKind>,
    /// When the first solution came after the first IMU sample, s.
    waited_s: f64,
}

impl After {
    fn at(&self, t: f64) -> &(f64, f64, f64, Solution) {
        self.states.iter().find(|s| s.0 >= t).unwrap()
    }
}

/// Replays the recorded flight; with a gap the navigator is dropped at [`KILLED_S`], and another goes on so many seconds later.
fn recorded(gap_s: Option<f64>) -> After {
    let settings = Settings::load(&Sources::default()).unwrap().pipeline;
    let log = Log::open(&sitl_log(COPTER), None).unwrap();
    let mut runner = Runner::new(&settings, &[OUTAGE]);
    runner.pipeline.follow(log.vehicle());
    let mut kept: Option<Snapshot> = None;
    let (mut first_imu, mut status) = (None, None);
    let mut after = After { states: Vec::new(), events: Vec::new(), waited_s: f64::INFINITY };
    let mut solution: Option<Solution> = None;
    log.play(
        |_, _| {},
        |clock, item| {
            let time = match item {
                Input::Sample(s) => Some(s.time()),
                Input::Reference(r) => Some(r.time()),
                _ => None,
            };
            if let Input::Status(_) = item {
                status = Some(*item);
            }
            let t = time.map_or(0.0, |time| runner.seconds(time)) - KILLED_S;
            if let Some(gap_s) = gap_s
                && first_imu.is_none()
                && time.is_some()
                && t >= 0.0
            {
                if kept.is_none() {
                    let snapshot = runner.pipeline.navigator.snapshot().unwrap();
                    kept = Some(serde_json::from_slice(&serde_json::to_vec(&snapshot).unwrap()).unwrap());
                    runner.pipeline.navigator = Navigator::new(settings.navigator.clone());
                }
                match item {
                    Input::Sample(Sample::Imu(s)) if t >= gap_s => {
                        let navigator = &mut runner.pipeline.navigator;
                        navigator.resume(kept.as_ref().unwrap(), s.time).unwrap();
                        first_imu = Some(t);
                        runner.take(clock, status.as_ref().unwrap());
                    }
                    _ => return,
                }
            }
            runner.take(clock, item);
            if matches!(item, Input::Sample(Sample::Imu(_))) {
                solution = runner.pipeline.navigator.solution();
                if let (Some(from), Some(s)) = (first_imu, &solution) {
                    check_form(s, "resumed");
                    after.waited_s = after.waited_s.min(t - from);
                }
            }
            let truth = match item {
                Input::Reference(Reference::Truth(truth)) if t > 0.0 && t < 38.0 => truth,
                _ => return,
            };
            let (Some(s), Some(frame)) = (solution, runner.pipeline.navigator.frame()) else { return };
            let Some(state) = ReferenceState::from_truth(truth, frame) else { return };
            if state.time.seconds_since(s.time).abs() > 0.1 {
                return;
            }
            let v = state.velocity_ned.unwrap();
            let moved = s.position.raw() + v * state.time.seconds_since(s.time);
            let p = (moved - state.position_ned).xy().norm();
            after.states.push((t, p, (s.velocity.raw() - v).xy().norm(), s));
        },
    )
    .unwrap();
    after.events = runner.events().iter().map(|(_, e)| e.kind).collect();
    after
}

#[test]
fn a_recorded_flight_goes_on_after_the_process_was_killed_in_an_outage() {
    let whole = recorded(None);
    for gap_s in [0.5, 2.0, 10.0] {
        let after = recorded(Some(gap_s));
        let resumed = |e: &EventKind| matches!(e, EventKind::Resumed(s) if (s - gap_s).abs() < 0.1);
        assert!(after.events.iter().any(resumed), "{gap_s} s: {:?}", after.events);
        assert!(after.waited_s < 0.26, "{gap_s} s: the first solution after {} s", after.waited_s);
        for (t, p, v, s) in &after.states {
            let c = s.velocity_covariance.raw();
            let sigma_v = (c[(0, 0)] + c[(1, 1)]).sqrt().hypot(0.1);
            assert!(
                *p < 3.0 * s.horizontal_sigma_m(),
                "{gap_s} s: {p} m of {} at {t}",
                s.horizontal_sigma_m()
            );
            assert!(*v < 3.0 * sigma_v, "{gap_s} s: {v} m/s of {sigma_v} at {t}");
            assert_eq!(s.mode, Mode::Holdover);
        }
        let (_, p, v, s) = after.at(gap_s + 8.0);
        let (_, p_whole, v_whole, s_whole) = whole.at(gap_s + 8.0);
        println!(
            "{gap_s} s: {p} m {v} m/s sigma {}, whole {p_whole} m {v_whole} m/s",
            s.horizontal_sigma_m()
        );
        assert_eq!(s.velocity_source, VelocitySource::Flow, "{gap_s} s");
        // The velocity is what it would have been; the position has the doubt of the gap and no less.
        assert!((v - v_whole).abs() < 0.4, "{gap_s} s: {v} and {v_whole} m/s");
        // A gap that is no hole leaves next to none.
        assert!(gap_s < 1.0 || s.horizontal_sigma_m() > s_whole.horizontal_sigma_m());
        assert!(s.horizontal_sigma_m() < s_whole.horizontal_sigma_m() + 2.0 + 4.0 * gap_s);
        assert_eq!(s.reset_counter, s_whole.reset_counter);
    }
}

/// A quadrotor in an outage since 5 s, what is known of it then, and the steps that come.
fn in_an_outage() -> &'static (Navigator, Snapshot) {
    static KNOWN: OnceLock<(Navigator, Snapshot)> = OnceLock::new();
    KNOWN.get_or_init(|| {
        let ready = ready_rotor();
        let mut navigator = ready.navigator.clone();
        let steps = &ready.flight.steps[ready.from..ready.from + 500];
        flight::fly(&mut navigator, steps, flight::masked_from(0.0), |_, _| {});
        let snapshot = navigator.snapshot().unwrap();
        (navigator, snapshot)
    })
}

/// Another navigator goes on from `snapshot` after `gap` steps, for `steps` more.
fn go_on(snapshot: &Snapshot, gap: usize, steps: usize) -> Result<Navigator, ResumeError> {
    let ready = ready_rotor();
    let from = ready.from + 500 + gap;
    let mut navigator = flight::navigator(&[]);
    let first = ready.flight.steps[from].samples[0].time();
    navigator.resume(snapshot, first)?;
    let without_gnss = |n: &mut Navigator, _: &Step, s: &Sample| {
        if s.kind() != SampleKind::Gnss {
            n.ingest(s);
        }
    };
    flight::fly(&mut navigator, &ready.flight.steps[from..from + steps], without_gnss, |n, _| {
        if let Some(s) = n.solution() {
            check_form(&s, "from what was kept");
        }
    });
    Ok(navigator)
}

#[test]
fn what_was_learned_of_the_sensors_is_known_again() {
    let (before, snapshot) = in_an_outage();
    let after = go_on(snapshot, 200, 1).unwrap();
    let (a, b) = (before.filter_state().unwrap(), after.filter_state().unwrap());
    assert!((a.gyro_bias - b.gyro_bias).norm() < 1e-12 && (a.accel_bias - b.accel_bias).norm() < 1e-12);
    assert!((a.magnetic_bias - b.magnetic_bias).norm() < 1e-12 && (a.flow - b.flow).norm() < 1e-12);
    assert!((a.wind_ne - b.wind_ne).norm() < 1e-12 && a.drag == b.drag);
    assert_eq!(before.gnss_latency_s(), after.gnss_latency_s());
    let latencies = |n: &Navigator| n.flow_latencies_s().collect::<Vec<_>>();
    assert!(!latencies(before).is_empty());
    assert_eq!(latencies(before), latencies(&after));
    for ((id, x, trusted), (same, y, still)) in before.flow_sensors().zip(after.flow_sensors()) {
        assert_eq!((id, trusted), (same, still));
        assert!((x.estimate() - y.estimate()).norm() < 1e-12);
    }
    let offset = |n: &Navigator| n.height_standing(holdover::altimeter::Channel::Baro).unwrap().0;
    assert!((offset(before) - offset(&after)).abs() < 1.0);
    // On a flight after a longer gap the sensors are the same, and a flow has to be compared again.
    let mut other = flight::navigator(&[]);
    other.recall(&snapshot.sensors).unwrap();
    let (_, calibration, trust) = other.flow_sensors().next().unwrap();
    let (_, learned, _) = before.flow_sensors().next().unwrap();
    assert_eq!(calibration.estimate(), learned.estimate());
    assert!(trust.is_err() && other.mode() == Mode::Aligning);
}

#[test]
fn what_is_too_old_or_from_later_or_of_nothing_is_not_gone_on_from() {
    let (navigator, snapshot) = in_an_outage();
    let now = AutopilotTime::from_micros(snapshot.time_us) + Span::from_seconds(1.0);
    let resume = |s: &Snapshot, now: AutopilotTime| flight::navigator(&[]).resume(s, now);
    assert_eq!(resume(snapshot, now), Ok(()));
    assert_eq!(resume(snapshot, now + Span::from_seconds(-1.0)), Err(ResumeError::FromTheFuture));
    assert!(matches!(resume(snapshot, now + Span::from_seconds(60.0)), Err(ResumeError::TooOld(_))));
    let aligning = Snapshot { mode: Mode::Aligning, ..snapshot.clone() };
    assert_eq!(resume(&aligning, now), Err(ResumeError::NothingKnown));
    assert_eq!(navigator.clone().resume(snapshot, now), Err(ResumeError::Navigating));
    assert!(flight::navigator(&[]).snapshot().is_none());
    let nlo = flight::navigator(&["navigator.estimator=nlo"]).resume(snapshot, now);
    assert_eq!(nlo, Err(ResumeError::Impossible("filter")));
}

#[test]
fn an_origin_that_was_told_before_is_where_the_frame_begins() {
    let (_, snapshot) = in_an_outage();
    let now = AutopilotTime::from_micros(snapshot.time_us) + Span::from_seconds(1.0);
    let mut as_kept = flight::navigator(&[]);
    as_kept.resume(snapshot, now).unwrap();
    let frame = as_kept.frame().unwrap().clone();
    let elsewhere = frame.to_geodetic(&Vector3::new(30.0, -40.0, 0.0));
    let mut told = flight::navigator(&[]);
    assert!(told.set_origin(now, elsewhere));
    told.resume(snapshot, now).unwrap();
    assert_eq!(told.frame().unwrap().origin(), elsewhere);
    let p = |n: &Navigator| n.solution().unwrap().position;
    let apart = p(&as_kept) - p(&told) - Ned::new(Vector3::new(30.0, -40.0, 0.0));
    assert!(apart.raw().norm() < 0.1, "{apart:?}");
}

fn a_vehicle(system: u8) -> Vehicle {
    Vehicle { system: SystemId(system), ..*Log::open(&sitl_log(COPTER), None).unwrap().vehicle() }
}

fn kept() -> KeptState {
    let (_, snapshot) = in_an_outage();
    let alignment = AlignmentMemory { offset: [1.0, 2.0, 3.0], learned: true, origin_shared: true };
    let boot = Boot { since_us: snapshot.time_us, unix_us: 1_790_000_000_000_000 };
    KeptState::new(&a_vehicle(1), boot, alignment, snapshot.clone())
}

/// The same state, but for the last digit of its numbers.
fn same(a: &KeptState, b: &KeptState) {
    let [mut a, mut b] = [a, b].map(|kept| serde_json::from_slice::<Value>(&kept.encode().unwrap()).unwrap());
    let (mut of_a, mut of_b) = (Vec::new(), Vec::new());
    numbers(&mut a, &mut of_a);
    numbers(&mut b, &mut of_b);
    assert_eq!(of_a.len(), of_b.len());
    for (x, y) in of_a.into_iter().zip(of_b) {
        let (p, q) = (x.as_f64().unwrap(), y.as_f64().unwrap());
        assert!((p - q).abs() <= 1e-12 * p.abs(), "{p} {q}");
        (*x, *y) = (Value::Null, Value::Null);
    }
    assert_eq!(a, b);
}

#[test]
fn a_file_is_whole_or_told_and_never_a_link() {
    let folder = tempfile::tempdir().unwrap();
    let (system, path) = (SystemId(1), folder.path().join("system-1.json"));
    let target = folder.path().join("target");
    std::fs::write(&target, "precious").unwrap();
    assert!(matches!(read(folder.path(), system), Err(StateError::None)));
    // A link in the file's place, and in that of the one beside it, is replaced and what it points to left alone.
    std::os::unix::fs::symlink(&target, &path).unwrap();
    std::os::unix::fs::symlink(&target, path.with_extension("json.new")).unwrap();
    assert!(matches!(read(folder.path(), system), Err(StateError::NotAFile)));
    drop({
        let file = StateFile::open(folder.path().to_owned(), system).unwrap();
        file.keep(kept());
        file
    });
    assert_eq!(std::fs::read_to_string(&target).unwrap(), "precious");
    same(&read(folder.path(), system).unwrap(), &kept());
    assert_eq!(kept().is_of(&a_vehicle(1)).ok(), Some(()));
    assert!(matches!(kept().is_of(&a_vehicle(2)), Err(StateError::OtherVehicle)));
    std::fs::write(&path, vec![b' '; MOST_BYTES as usize + 1]).unwrap();
    assert!(matches!(read(folder.path(), system), Err(StateError::TooLarge)));
    std::fs::write(&path, r#"{"version": 7, "anything": []}"#).unwrap();
    assert!(matches!(read(folder.path(), system), Err(StateError::Version(7))));
    std::fs::remove_file(&path).unwrap();
    std::fs::create_dir(&path).unwrap();
    assert!(matches!(read(folder.path(), system), Err(StateError::NotAFile)));
    // A folder that is gone costs the state and nothing else.
    let file = StateFile::open(folder.path().join("nowhere"), system).unwrap();
    file.keep(kept());
    drop(file);
}

/// Every number of a JSON value, to be changed.
fn numbers<'a>(value: &'a mut Value, out: &mut Vec<&'a mut Value>) {
    match value {
        Value::Array(values) => values.iter_mut().for_each(|v| numbers(v, out)),
        Value::Object(fields) => fields.values_mut().for_each(|v| numbers(v, out)),
        Value::Number(_) => out.push(value),
        _ => {}
    }
}

proptest! {
    #![proptest_config(ProptestConfig { cases: 192, ..ProptestConfig::default() })]

    #[test]
    fn any_bytes_are_a_state_or_told_to_be_none(bytes in proptest::collection::vec(any::<u8>(), 0..400), at in 0.0..1.0f64) {
        prop_assert!(KeptState::decode(&bytes).is_err());
        let whole = kept().encode().unwrap();
        let cut = (whole.len() as f64 * at) as usize;
        prop_assert!(KeptState::decode(&whole[..cut]).is_err());
        let mut mixed = whole.clone();
        let end = (cut + bytes.len()).min(whole.len());
        mixed[cut..end].copy_from_slice(&bytes[..end - cut]);
        if let Ok(state) = KeptState::decode(&mixed) {
            let zero = AutopilotTime::from_micros(0);
            let now = Boot { since_us: 130_000_000, unix_us: 1_790_000_005_000_000 };
            if let Ok(snapshot) = state.snapshot_on(&now, zero) {
                drop(go_on(&snapshot, 100, 50));
            }
        }
    }

    /// Whatever the numbers are, a solution is one: finite, with covariances that are.
    #[test]
    fn any_numbers_are_refused_or_flown_on(
        changes in proptest::collection::vec((any::<prop::sample::Index>(), prop_oneof![
            any::<f64>().prop_filter("JSON has no others", |v| v.is_finite()),
            -1e3..1e3f64,
            Just(0.0),
            Just(-1.0),
            Just(1e300),
        ]), 1..4),
        gap in 1usize..800,
    ) {
        let (_, snapshot) = in_an_outage();
        let mut value = serde_json::to_value(snapshot).unwrap();
        let mut all = Vec::new();
        numbers(&mut value, &mut all);
        for (index, number) in changes {
            let at = index.index(all.len());
            *all[at] = Value::from(number);
        }
        if let Ok(changed) = serde_json::from_value::<Snapshot>(value) {
            let changed = Snapshot { time_us: snapshot.time_us, ..changed };
            drop(go_on(&changed, gap, 200));
        }
    }
}

#[test]
fn a_process_that_is_restarted_with_gnss_is_aided_again_within_seconds() {
    let ready = ready_rotor();
    let snapshot = ready.navigator.snapshot().unwrap();
    let from = ready.from + 200;
    let mut another = flight::navigator(&[]);
    another.resume(&snapshot, ready.flight.steps[from].samples[0].time()).unwrap();
    assert_eq!(another.mode(), Mode::Holdover);
    let give = |n: &mut Navigator, _: &Step, s: &Sample| {
        n.ingest(s);
    };
    let mut modes = Vec::new();
    flight::fly(&mut another, &ready.flight.steps[from..from + 1500], give, |n, step| {
        if modes.last() != Some(&n.mode()) {
            modes.push(n.mode());
        }
        let Some(s) = n.solution() else { return };
        let shift = ready.flight.frame.to_ned(&n.frame().unwrap().origin());
        let error = (s.position.raw() + shift - step.truth.position_ned).xy().norm();
        assert!(error < 3.0 * s.horizontal_sigma_m(), "{error} of {}", s.horizontal_sigma_m());
    });
    assert_eq!(modes, [Mode::Holdover, Mode::Rejoining, Mode::Aided]);
}

#[test]
fn a_wing_goes_on_as_well() {
    let ready = ready_wing();
    let mut navigator = ready.navigator.clone();
    let steps = &ready.flight.steps;
    let killed = ready.from + 500;
    flight::fly(&mut navigator, &steps[ready.from..killed], flight::masked_from(0.0), |_, _| {});
    let snapshot = navigator.snapshot().unwrap();
    let from = killed + 300;
    let mut another = flight::navigator(&[]);
    another.resume(&snapshot, steps[from].samples[0].time()).unwrap();
    let mut honest = 0;
    flight::fly(&mut another, &steps[from..from + 3000], flight::masked_from(0.0), |n, step| {
        let Some(s) = n.solution() else { return };
        let shift = ready.flight.frame.to_ned(&n.frame().unwrap().origin());
        let error = (s.position.raw() + shift - step.truth.position_ned).xy().norm();
        assert!(error < 3.0 * s.horizontal_sigma_m(), "{error} of {}", s.horizontal_sigma_m());
        honest += 1;
    });
    assert!(honest > 2900, "{honest}");
    assert_eq!(another.solution().unwrap().velocity_source, VelocitySource::Flow);
}
