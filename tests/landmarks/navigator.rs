//! A quadrotor over a field of markers: what landmarks take out of a drift, and how little wrong ones can do.

use std::sync::{Arc, OnceLock};

use crate::flight::{self, Step};
use crate::sound;
use holdover::config::{Settings, Sources};
use holdover::geo::{Body, CameraMount, CameraToBody};
use holdover::landmark::{LandmarkCamera, LandmarkSettings};
use holdover::navigator::Navigator;
use holdover::navigator::event::{Event, EventKind};
use holdover::navigator::solution::{Mode, VelocitySource};
use holdover::navigator::sources::landmarks::{ComponentCamera, LandmarkFrame, LandmarkPlace, LandmarkSetup};
use holdover::navigator::verdict::Reason;
use holdover::sample::{LandmarkSample, Sample, SampleKind, Sighting};
use holdover::sim::models::ImuModel;
use holdover::sim::{
    MarkerCamera, MarkerField, MarkerWatch, Scenario, SeenLandmark, SensorSuite, Simulation, Truth,
};
use holdover::time::{AutopilotTime, Span};
use nalgebra::Vector3;

/// GNSS goes, and landmarks have had the time to take the position over, s.
const LOST_S: f64 = 110.0;
const TAKEN_OVER_S: f64 = 122.0;
const END_S: f64 = 240.0;
const COMPONENT: u8 = 100;

fn sighting(seen: &SeenLandmark) -> Sample {
    let sighting = Sighting::Bearing { angle_xy: seen.angle_xy, distance_m: None };
    let time = Simulation::ap_time(seen.taken_s);
    Sample::Landmark(LandmarkSample { time, camera: COMPONENT, id: seen.id, sighting })
}

struct Field {
    origin: holdover::geo::Geodetic,
    markers: Vec<(u8, Vector3<f64>)>,
    /// With what the camera tells at each.
    steps: Vec<Step>,
}

fn camera() -> MarkerCamera {
    MarkerCamera {
        every: 10,
        half_field_of_view_rad: [0.7; 2],
        delay_s: 0.06,
        jitter_s: 0.03,
        ..MarkerCamera::downward()
    }
}

impl Field {
    fn sightings(&self) -> u64 {
        let samples = self.steps.iter().flat_map(|s| &s.samples);
        samples.filter(|s| s.kind() == SampleKind::Landmark).count() as u64
    }
}

/// The patrol over markers, read once.
fn field() -> &'static Field {
    static FIELD: OnceLock<Field> = OnceLock::new();
    FIELD.get_or_init(|| {
        let scenario = Scenario::patrol().lasting(END_S);
        let field = MarkerField::along(&scenario, END_S, 0.15, 8.0, 7).unwrap();
        let mut watch = MarkerWatch::new(field.clone(), camera(), 7);
        let suite = SensorSuite::of(&scenario, ImuModel::mems());
        let with_markers = |mut step: Step| {
            step.samples.extend(watch.step(&step.truth).map(|seen| sighting(&seen)));
            step
        };
        let steps = flight::steps(Simulation::new(scenario.clone(), suite, 7)).map(with_markers).collect();
        Field { origin: scenario.origin, markers: field.markers, steps }
    })
}

fn setup(points: impl IntoIterator<Item = (u8, Vector3<f64>)>) -> LandmarkSetup {
    let camera = camera();
    let MarkerCamera { mount, half_field_of_view_rad, .. } = camera;
    LandmarkSetup {
        frame: LandmarkFrame::Surveyed,
        points: points.into_iter().map(|(id, p)| (id, LandmarkPlace::Ned(p))).collect(),
        cameras: vec![ComponentCamera {
            component: 0,
            camera: LandmarkCamera { mount, half_field_of_view_rad },
            delay_s: 0.0,
        }],
        filter: LandmarkSettings {
            position_drift: 0.15,
            attitude_drift: 0.02f64.to_radians(),
            gravity_sigma_rad: 0.012,
            ..LandmarkSettings::seen_from(15.0)
        },
        survey_sigma_m: 0.05,
    }
}

fn surveyed() -> LandmarkSetup {
    setup(field().markers.iter().copied())
}

/// What came of a flight.
struct Flight {
    navigator: Navigator,
    events: Vec<(f64, EventKind)>,
    /// Largest horizontal error of what is published, and largest ratio of it to its standard deviation, after landmarks took over.
    error_m: f64,
    over_sigma: f64,
    /// At the end.
    sigma_m: f64,
    yaw_error: f64,
    /// Seconds of holdover on landmarks.
    on_landmarks_s: f64,
    /// While landmarks carry: largest unannounced step of the published position beyond its velocity, m, and changes of the reset counter.
    step_m: f64,
    resets: u32,
}

impl Flight {
    fn told(&self, wanted: impl Fn(&EventKind) -> bool) -> bool {
        self.events.iter().any(|(_, what)| wanted(what))
    }

    fn rejected(&self, wanted: Reason) -> u64 {
        self.navigator
            .statuses()
            .rejected(SampleKind::Landmark)
            .filter(|(r, _)| *r == wanted)
            .map(|(_, n)| n)
            .sum()
    }

    /// Landmarks carried, and as well as they should.
    fn assert_carried(&self, error_m: f64) {
        assert!(
            self.on_landmarks_s > 0.95 * (END_S - TAKEN_OVER_S),
            "{} s: {:?}",
            self.on_landmarks_s,
            self.events
        );
        assert!(self.error_m < error_m, "{} m: {:?}", self.error_m, self.events);
        assert!(self.over_sigma < 3.0, "{} sigma", self.over_sigma);
    }
}

fn pilot(landmarks: Option<LandmarkSetup>, overrides: &[&str]) -> Navigator {
    let overrides = overrides.iter().map(|s| (*s).to_owned()).collect();
    let mut settings =
        Settings::load(&Sources { overrides, ..Sources::default() }).unwrap().pipeline.navigator;
    settings.landmarks = landmarks.map(Arc::new);
    let mut navigator = Navigator::new(settings);
    navigator.set_origin(Simulation::ap_time(0.0), field().origin);
    navigator
}

/// Flies with GNSS until [`LOST_S`]; `change` does with each sighting what it will.
fn fly(
    landmarks: Option<LandmarkSetup>,
    overrides: &[&str],
    mut change: impl FnMut(f64, LandmarkSample, &mut Vec<LandmarkSample>),
) -> Flight {
    let mut f = Flight {
        navigator: pilot(landmarks, overrides),
        events: Vec::new(),
        error_m: 0.0,
        over_sigma: 0.0,
        sigma_m: f64::NAN,
        yaw_error: f64::NAN,
        on_landmarks_s: 0.0,
        step_m: 0.0,
        resets: 0,
    };
    let mut last = None;
    let mut changed = Vec::new();
    let give = |navigator: &mut Navigator, step: &Step, sample: &Sample| match sample {
        Sample::Landmark(seen) => {
            change(step.t_s, *seen, &mut changed);
            for s in changed.drain(..) {
                navigator.ingest(&Sample::Landmark(s));
            }
        }
        Sample::Gnss(_) if step.t_s >= LOST_S => {}
        other => {
            navigator.ingest(other);
        }
    };
    flight::fly(&mut f.navigator, &field().steps, give, |navigator, step| {
        let seconds = |e: Event| (Simulation::seconds(e.time), e.kind);
        f.events.extend(navigator.drain_events().map(seconds));
        let Some(s) = navigator.solution().filter(|s| s.mode != Mode::Aligning) else { return };
        sound::check_form(&s, "with landmarks");
        if let Some((position, counter)) = last.replace((s.position.raw(), s.reset_counter))
            && s.velocity_source == VelocitySource::Landmarks
        {
            let moved: Vector3<f64> = s.position.raw() - position;
            let beyond = (moved - s.velocity.raw() * 0.01).xy().norm();
            if counter == s.reset_counter {
                f.step_m = f.step_m.max(beyond);
            } else {
                f.resets += 1;
            }
        }
        if step.t_s > TAKEN_OVER_S {
            let error = (s.position.raw() - step.truth.position_ned).xy().norm();
            f.error_m = f.error_m.max(error);
            f.over_sigma = f.over_sigma.max(error / s.horizontal_sigma_m());
            f.sigma_m = s.horizontal_sigma_m();
            f.on_landmarks_s += if s.velocity_source == VelocitySource::Landmarks { 0.01 } else { 0.0 };
            let turn = s.attitude.matrix() * step.truth.r_body_to_ned.transpose();
            f.yaw_error = turn[(1, 0)].atan2(turn[(0, 0)]).abs();
        }
    });
    f
}

fn unchanged(_: f64, s: LandmarkSample, out: &mut Vec<LandmarkSample>) {
    out.push(s);
}

#[test]
fn landmarks_take_the_drift_out() {
    let with = fly(Some(surveyed()), &[], unchanged);
    with.assert_carried(0.3);
    assert!(
        with.told(|w| *w == EventKind::LandmarksFound)
            && with.told(|w| *w == EventKind::Carried(VelocitySource::Landmarks))
    );
    assert!(with.sigma_m < 0.3 && with.yaw_error < 0.02, "{} m, {} rad", with.sigma_m, with.yaw_error);
    assert_eq!(with.resets, 0);
    // The glide, one fix and what the filter corrects besides.
    assert!(with.step_m < 0.12, "{} m", with.step_m);
    let without = fly(None, &[], unchanged);
    assert!(without.error_m > 5.0 * with.error_m, "{} and {} m", without.error_m, with.error_m);
    assert!(without.sigma_m > 5.0 * with.sigma_m && without.on_landmarks_s == 0.0);
    assert_eq!(
        without.rejected(Reason::NotUsed),
        field().steps.iter().flat_map(|s| &s.samples).filter(|s| s.kind() == SampleKind::Landmark).count()
            as u64
    );
}

#[test]
fn landmarks_that_come_into_view_late_take_a_long_drift_out_without_a_jump() {
    let late = |t: f64, s, out: &mut Vec<_>| {
        if !(30.0..=190.0).contains(&t) {
            out.push(s)
        }
    };
    let blind = ["flow.use=false", "drag.use=false", "holdover.max_coast_s=200", "holdover.max_sigma_m=5000"];
    let worst = |f: &Flight| (f.error_m, f.over_sigma, f.sigma_m, f.resets, f.step_m);
    // A way that has to be a jump is announced.
    let far = fly(Some(surveyed()), &[&blind[..], &["tuning.rejoin.jump_m=10"]].concat(), late);
    assert!(far.error_m > 20.0 && far.sigma_m < 0.3 && far.over_sigma < 4.0, "{:?}", worst(&far));
    assert!(
        far.resets == 1 && far.told(|w| matches!(w, EventKind::Reset(m) if *m > 10.0)),
        "{:?}",
        far.events
    );
    assert!(far.step_m < 0.12, "{:?}", worst(&far));
    // Otherwise it glides, a centimetre a step.
    let glides = fly(Some(surveyed()), &blind, late);
    assert!(glides.sigma_m < 0.3 && glides.resets == 0 && glides.over_sigma < 4.0, "{:?}", worst(&glides));
    assert!(glides.step_m < 0.12, "{:?}", worst(&glides));
    // And where it was too much for Holdover, landmarks bring it back.
    let lost = fly(Some(surveyed()), &[&blind[..3], &["holdover.max_sigma_m=20"]].concat(), late);
    assert_eq!((lost.navigator.mode(), lost.sigma_m < 0.3), (Mode::Holdover, true), "{:?}", lost.events);
    assert!(lost.told(|w| matches!(w, EventKind::Mode { to: Mode::Lost, .. })));
}

#[test]
fn every_estimator_gains_and_claims_no_more_than_it_has() {
    for estimator in ["nlo", "xkf", "ekf15"] {
        let f = fly(Some(surveyed()), &[&format!("navigator.estimator={estimator}")], unchanged);
        assert!(
            f.error_m < 1.0 && f.over_sigma < 3.5,
            "{estimator}: {} m, {} sigma",
            f.error_m,
            f.over_sigma
        );
    }
    let f = fly(Some(surveyed()), &["navigator.estimator=inertial"], unchanged);
    assert_eq!(f.on_landmarks_s, 0.0);
}

#[test]
fn a_frame_of_its_own_is_found_while_gnss_is_good() {
    let turn = holdover::geo::so3::exp(&Vector3::new(0.0, 0.0, 2.2));
    let place = |p: &Vector3<f64>| turn.transpose() * (p - Vector3::new(300.0, -200.0, 12.0));
    let points = field().markers.iter().map(|(id, p)| (*id, place(p)));
    let f = fly(Some(LandmarkSetup { frame: LandmarkFrame::Local, ..setup(points) }), &[], unchanged);
    // As good as GNSS is, which wanders by a metre and placed it.
    f.assert_carried(3.0);
    let heading = f.events.iter().find_map(|(_, w)| match w {
        EventKind::LandmarkFrame(heading, sigma) => Some((*heading, *sigma)),
        _ => None,
    });
    let (heading, sigma) = heading.expect("the frame was aligned");
    assert!((heading - 2.2).abs() < 0.15 && (heading - 2.2).abs() < 3.0 * sigma, "{heading} +- {sigma}");
}

#[test]
fn sightings_that_overtake_the_inertial_stream_wait_for_it() {
    // Every IMU stamp is 80 ms older than the picture that comes with it.
    let ahead = |_: f64, s: LandmarkSample, out: &mut Vec<_>| {
        out.push(LandmarkSample { time: s.time + Span::from_millis(130), ..s });
    };
    let late = ComponentCamera { delay_s: 0.13, ..surveyed().cameras[0] };
    fly(Some(LandmarkSetup { cameras: vec![late], ..surveyed() }), &[], ahead).assert_carried(0.3);
    // Without that delay they are wrong by as much, wait, and are counted when they are used.
    let f = fly(Some(surveyed()), &[], ahead);
    let heard = field().sightings();
    let tally = f.navigator.statuses();
    let rejected: u64 = tally.rejected(SampleKind::Landmark).map(|(_, n)| n).sum();
    assert!(heard - rejected - tally.used(SampleKind::Landmark) < 40, "none is lost");
    assert!(tally.used(SampleKind::Landmark) > heard / 2);
}

#[test]
fn what_cannot_be_is_told_and_does_no_harm() {
    let mut n = 0u64;
    let f = fly(Some(surveyed()), &[], |_, s, out| {
        let time = |by: f64| s.time + Span::from_seconds(by);
        let angles = |x: f64| Sighting::Bearing { angle_xy: [x, 0.1], distance_m: None };
        n += 1;
        out.push(s);
        out.push(match n % 9 {
            0 => LandmarkSample { id: 250, ..s },
            1 => LandmarkSample { time: time(10.0), ..s },
            2 => LandmarkSample { time: time(-5.0), ..s },
            3 => LandmarkSample { sighting: angles(f64::NAN), ..s },
            4 => LandmarkSample { sighting: angles(1.4), ..s },
            5 => s,
            6 => LandmarkSample { sighting: Sighting::Body(Body::new(Vector3::repeat(f64::INFINITY))), ..s },
            7 => LandmarkSample { time: AutopilotTime::from_micros(i64::MAX / 2), ..s },
            _ => LandmarkSample { sighting: Sighting::Body(Body::new(Vector3::zeros())), ..s },
        });
    });
    f.assert_carried(0.3);
    for reason in [
        Reason::UnknownLandmark,
        Reason::Early,
        Reason::Late,
        Reason::NotFinite,
        Reason::OutOfRange,
        Reason::Duplicate,
    ] {
        assert!(f.rejected(reason) > n / 15, "{reason:?}: {} of {n}", f.rejected(reason));
    }
}

#[test]
fn a_camera_that_is_not_configured_is_not_listened_to() {
    let only = ComponentCamera { component: 101, ..surveyed().cameras[0] };
    let f = fly(Some(LandmarkSetup { cameras: vec![only], ..surveyed() }), &[], unchanged);
    assert!(f.on_landmarks_s == 0.0 && f.rejected(Reason::UnknownCamera) > 1000);
}

#[test]
fn swapped_ids_and_a_misplaced_landmark_are_told_and_left_out() {
    let markers = &field().markers;
    // A marker in the middle of the route, which is seen all the time.
    let near = |p: Vector3<f64>| {
        let by = |m: &&(u8, Vector3<f64>)| ordered_float((m.1 - p).norm());
        markers.iter().min_by_key(by).unwrap().0
    };
    let (a, b) = (near(Vector3::new(20.0, 3.0, 0.0)), near(Vector3::new(3.0, 20.0, 0.0)));
    assert_ne!(a, b);
    let swapped = fly(Some(surveyed()), &[], |_, s, out| {
        let id = if s.id == a {
            b
        } else if s.id == b {
            a
        } else {
            s.id
        };
        out.push(LandmarkSample { id, ..s });
    });
    swapped.assert_carried(0.5);
    assert!(swapped.told(|w| matches!(w, EventKind::LandmarkContradicts(id) if [a, b].contains(id))));
    let wrong =
        |(id, p): &(u8, Vector3<f64>)| (*id, if *id == a { p + Vector3::new(4.0, -3.0, 0.0) } else { *p });
    let misplaced = fly(Some(setup(markers.iter().map(wrong))), &[], unchanged);
    misplaced.assert_carried(0.5);
    assert!(misplaced.told(|w| *w == EventKind::LandmarkContradicts(a)), "{:?}", misplaced.events);
    // A few percent of ids are just anything.
    let mut n = 0usize;
    let noisy = fly(Some(surveyed()), &[], |_, s, out| {
        n += 1;
        let id = if n.is_multiple_of(20) { markers[n / 20 % markers.len()].0 } else { s.id };
        out.push(LandmarkSample { id, ..s });
    });
    noisy.assert_carried(0.4);
    assert!(noisy.rejected(Reason::Innovation) > 500);
}

fn ordered_float(v: f64) -> u64 {
    v.abs().to_bits()
}

#[test]
fn a_field_that_contradicts_gnss_is_told_and_never_used() {
    let moved = field().markers.iter().map(|(id, p)| (*id, p + Vector3::new(25.0, 0.0, 0.0)));
    let f = fly(Some(setup(moved)), &[], unchanged);
    let apart = |w: &EventKind| matches!(w, EventKind::LandmarksApart(m) if (m - 25.0).abs() < 3.0);
    assert!(f.told(apart), "{:?}", f.events);
    assert_eq!(f.on_landmarks_s, 0.0);
    let without = fly(None, &[], unchanged);
    assert!((f.error_m - without.error_m).abs() < 1e-9 && f.sigma_m == without.sigma_m);
}

#[test]
fn the_camera_may_tell_positions_and_look_anywhere() {
    // A second camera looks forward and down; both tell where landmarks are, in body axes.
    let pitched = CameraToBody::from_matrix(&holdover::geo::so3::exp(&Vector3::new(0.0, 0.8, 0.0)));
    let first = surveyed().cameras[0];
    let mount = CameraMount { camera_to_body: pitched, ..first.camera.mount };
    let second =
        ComponentCamera { component: 101, camera: LandmarkCamera { mount, ..first.camera }, delay_s: 0.0 };
    let cameras = vec![first, second];
    let in_body = |truth: &Truth, id: u8| {
        let q = field().markers.iter().find(|m| m.0 == id).unwrap().1;
        truth.r_body_to_ned.tr_mul(&(q - truth.position_ned))
    };
    let at = |time: AutopilotTime| {
        let step = (Simulation::seconds(time) * 100.0).round() as usize - 1;
        field().steps[step].truth
    };
    let f = fly(Some(LandmarkSetup { cameras, ..surveyed() }), &[], |_, s, out| {
        let p = in_body(&at(s.time), s.id);
        let sighting = Sighting::Body(Body::new(p) * (1.0 + 0.02 * f64::from(s.id % 3) - 0.02));
        out.push(LandmarkSample { sighting, ..s });
        out.push(LandmarkSample { camera: 101, sighting, ..s });
    });
    f.assert_carried(0.3);
    assert!(f.rejected(Reason::OutOfRange) > 1000, "the second camera does not see all of them");
}

#[test]
fn nothing_allocates_while_landmarks_are_seen() {
    let mut navigator = pilot(Some(surveyed()), &[]);
    let mut counted = [0; 2];
    for step in field().steps.iter().take_while(|s| s.t_s < 180.0) {
        navigator.set_status(step.status);
        for sample in step.samples.iter().filter(|s| step.t_s < LOST_S || s.kind() != SampleKind::Gnss) {
            let allocations = allocation_counter::measure(|| {
                navigator.ingest(sample);
            });
            // Found, and then for a while on landmarks.
            if (60.0..LOST_S).contains(&step.t_s) || step.t_s > TAKEN_OVER_S {
                assert_eq!(allocations.count_total, 0, "{} s: {sample:?}", step.t_s);
                counted[usize::from(step.t_s > LOST_S)] += u32::from(sample.kind() == SampleKind::Landmark);
            }
        }
        navigator.drain_events().for_each(drop);
    }
    assert!(counted.iter().all(|n| *n > 2000), "{counted:?}");
}
