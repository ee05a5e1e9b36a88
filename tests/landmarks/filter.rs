//! The drone's landmark filter over simulated fields of markers: what it reaches, and what bad input does to it.

use crate::marker_flight::{
    Case, Error, STEP_S, Track, converged_at, error, error_of, errors, fly, motion, rms, sighting, stamp,
    track,
};
use allocation_counter::measure;
use holdover::geo::{Body, Camera};
use holdover::landmark::{
    BodyMotion, Definiteness, LandmarkCamera, LandmarkFilter, LandmarkMap, LandmarkSettings,
    LandmarkSighting, MapError, MotionVerdict, Observability, PoseGuess, PoseSource, Seen, SightingVerdict,
};
use holdover::sim::landmarks::SeenLandmark;
use holdover::sim::{LandmarkFlight, MarkerCamera, MarkerField, MotionNoise, Wander};
use holdover::time::{AutopilotTime, Span};
use nalgebra::{Matrix3, Vector3};
use proptest::prelude::*;

const LIMITS: Error = [0.5, 0.0873];

fn field(seed: u64) -> MarkerField {
    MarkerField::scattered(seed, 10, 4.0, 1.3)
}

/// The usual conditions: 100 ms late, 40 % lost, 3 % wrong, any first attitude.
fn usual<'a>(trajectory: &'a Wander, field: &'a MarkerField, seed: u64) -> Case<'a> {
    Case {
        trajectory,
        field,
        camera: MarkerCamera { delay_s: 0.1, dropout: 0.4, wrong_ids: 0.03, ..MarkerCamera::downward() },
        noise: MotionNoise::mems(),
        settings: LandmarkSettings::default(),
        attitude_rad: None,
        tells_attitude: false,
        duration_s: 40.0,
        seed,
    }
}

/// Flies a case whose sightings are changed on the way; the filter, its verdicts and the refined errors.
fn flown(
    case: &Case<'_>,
    change: impl Fn(&mut SeenLandmark),
) -> (LandmarkFilter, Vec<(SeenLandmark, SightingVerdict)>, Track) {
    let mut flight = case.flight();
    flight.seen.iter_mut().for_each(change);
    let mut filter = case.filter(&flight);
    let (verdicts, errors) = track(&mut filter, &flight);
    (filter, verdicts, errors)
}

#[test]
fn without_noise_the_pose_is_exact() {
    for seed in 0..4 {
        let (w, f) = (Wander::over_field(0.17 * seed as f64), field(seed));
        let mut case = usual(&w, &f, seed);
        case.noise = MotionNoise::NONE;
        (case.camera.bearing_sigma_rad, case.camera.wrong_ids) = (0.0, 0.0);
        let (hinf, refined) = errors(&case, 5);
        for e in [hinf, refined] {
            let (_, [position, attitude]) = e.last().unwrap();
            assert!(*position < 1e-4 && *attitude < 1e-5, "{seed}: {position} {attitude}");
        }
    }
}

#[test]
fn any_attitude_is_found_however_late_and_rare_sightings_are() {
    for (delay_s, dropout) in [(0.0, 0.0), (0.3, 0.8)] {
        let (mut times, mut worst) = (Vec::new(), [0.0f64; 2]);
        for seed in 500..512 {
            let (w, f) = (Wander::over_field(0.618 * seed as f64 % 1.0), field(seed));
            let mut case = usual(&w, &f, seed);
            (case.camera.delay_s, case.camera.dropout) = (delay_s, dropout);
            let (_, refined) = errors(&case, 5);
            if let Some(t) = converged_at(&refined, LIMITS, 24.0) {
                times.push(t);
                let e = rms(&refined, 24.0);
                worst = [worst[0].max(e[0]), worst[1].max(e[1])];
            }
        }
        times.sort_by(f64::total_cmp);
        assert!(times.len() >= 12, "{delay_s} {dropout}: {} of 12", times.len());
        assert!(times[5] <= 1.5 && times[10] <= 8.0, "{delay_s} {dropout}: {times:?}");
        assert!(worst[0] < 0.1 && worst[1] < 0.02, "{delay_s} {dropout}: {worst:?}");
    }
}

/// A field of 24 m far from the origin, flown over at 20 m; dead reckoning as bad in angle as before.
#[test]
fn from_20_m_it_is_good_to_a_few_decimetres() {
    let away = Vector3::new(3000.0, -7000.0, 40.0);
    for seed in 70..76 {
        let mut f = MarkerField::scattered(seed, 10, 12.0, 3.0);
        f.markers.iter_mut().for_each(|m| m.1 += away);
        let w = Wander {
            centre_ned: away + Vector3::new(0.0, 0.0, -20.0),
            amplitude_m: Vector3::new(8.0, 8.0, 2.0),
            ..Wander::over_field(0.618 * seed as f64 % 1.0)
        };
        let mut case = usual(&w, &f, seed);
        (case.settings, case.duration_s) = (LandmarkSettings::seen_from(20.0), 60.0);
        let (_, refined) = errors(&case, 5);
        let e = rms(&refined, 30.0);
        assert!(converged_at(&refined, LIMITS, 24.0).is_some(), "{seed}: {e:?}");
        assert!(e[0] < 0.3 && e[1] < 0.02, "{seed}: {e:?}");
        println!("{seed}: {e:?}");
    }
}

#[test]
fn a_delay_that_is_not_known_costs_what_the_drone_flies_in_it() {
    let (w, f) = (Wander::over_field(0.4), field(3));
    let mut case = usual(&w, &f, 3);
    case.camera.delay_s = 0.3;
    let (.., told) = flown(&case, |_| {});
    let (.., ignored) = flown(&case, |s| s.taken_s = s.heard_s);
    assert!(rms(&told, 24.0)[0] < 0.08);
    assert!(rms(&ignored, 24.0)[0] > 0.2, "{:?}", rms(&ignored, 24.0));
}

#[test]
fn the_order_of_arrival_does_not_matter() {
    let (w, f) = (Wander::over_field(0.1), field(8));
    let mut case = usual(&w, &f, 8);
    (case.camera.delay_s, case.camera.wrong_ids, case.duration_s) = (0.0, 0.1, 12.0);
    let flight = case.flight();
    let run = |delay: &dyn Fn(usize) -> f64| {
        let mut flight = LandmarkFlight { seen: flight.seen.clone(), ..flight.clone() };
        for (i, s) in flight.seen.iter_mut().enumerate() {
            // All have come by the end.
            s.heard_s = (s.taken_s + delay(i)).min(12.0);
        }
        flight.seen.sort_by(|a, b| a.heard_s.total_cmp(&b.heard_s));
        let mut filter = case.filter(&flight);
        let mut used = Vec::new();
        fly(&mut filter, &flight, |s, v| used.push((s.taken_s.to_bits(), s.id, v.is_used())), |_, _| {});
        used.sort_unstable();
        (filter.pose().unwrap(), filter.acquiring_pose().unwrap())
    };
    let (pose, hinf) = run(&|_| 0.0);
    assert!(pose.converged);
    for salt in 1..6usize {
        let (other, other_hinf) = run(&|i| 0.9 * ((i * 7919 * salt) % 101) as f64 / 101.0);
        for (a, b) in [(&pose, &other), (&hinf, &other_hinf)] {
            assert!((a.position_ned - b.position_ned).norm() < 1e-12);
            assert!((a.r_body_to_ned - b.r_body_to_ned).norm() < 1e-12);
            assert!((a.covariance - b.covariance).norm() < 1e-12);
        }
    }
}

#[test]
fn the_covariance_is_honest() {
    let mut sum = 0.0;
    let mut count = 0.0;
    for seed in 40..52 {
        let (w, f) = (Wander::over_field(0.618 * seed as f64 % 1.0), field(seed));
        let case = usual(&w, &f, seed);
        let flight = case.flight();
        let mut filter = case.filter(&flight);
        fly(
            &mut filter,
            &flight,
            |_, _| {},
            |step, f| {
                let Some(pose) = f.pose().filter(|p| p.converged && step.truth.t_s > 15.0) else { return };
                let dp = step.truth.position_ned - pose.position_ned;
                let dr =
                    holdover::geo::so3::log(&(step.truth.r_body_to_ned * pose.r_body_to_ned.transpose()));
                let e = nalgebra::Vector6::new(dp.x, dp.y, dp.z, dr.x, dr.y, dr.z);
                sum += e.dot(&pose.covariance.cholesky().unwrap().solve(&e)) / 6.0;
                count += 1.0;
            },
        );
    }
    let mean: f64 = sum / count;
    assert!((0.4..2.0).contains(&mean), "mean NEES over its dimension {mean}");
}

#[test]
fn a_good_guess_is_kept_where_nothing_better_can_be_had() {
    // Over coplanar markers a hover finds no attitude, but need not lose one.
    let mut kept = 0;
    for seed in 0..8 {
        let (w, f) = (Wander::hover(0.1 * seed as f64), MarkerField::scattered(seed, 10, 4.0, 0.0));
        let mut case = usual(&w, &f, seed);
        (case.attitude_rad, case.tells_attitude) = (Some(0.15), true);
        let (_, refined) = errors(&case, 5);
        kept += usize::from(converged_at(&refined, LIMITS, 5.0).is_some());
    }
    assert!(kept >= 7, "{kept} of 8");
}

/// A filter over the usual field that has converged, with its flight; `each` may still be told more.
fn converged() -> (LandmarkFilter, AutopilotTime, LandmarkFlight) {
    let (w, f) = (Wander::over_field(0.3), field(2));
    let mut case = usual(&w, &f, 2);
    (case.camera.delay_s, case.camera.dropout, case.duration_s) = (0.0, 0.0, 15.0);
    let flight = case.flight();
    let mut filter = case.filter(&flight);
    fly(&mut filter, &flight, |_, _| {}, |_, _| {});
    assert!(filter.pose().unwrap().converged);
    (filter, stamp(15.0), flight)
}

fn angles(x: f64, y: f64) -> Seen {
    Seen::Angles { angle_xy: [x, y], distance_m: None }
}

#[test]
fn what_is_no_sighting_is_told_and_changes_nothing() {
    let (mut filter, now, _) = converged();
    let before = filter.pose().unwrap();
    let at = |ms: i64| now + Span::from_millis(ms);
    let s = |time, camera, id, seen| LandmarkSighting { time, camera, id, seen };
    let nan = f64::NAN;
    for (given, want) in [
        (s(now, 0, 99, angles(0.0, 0.0)), SightingVerdict::UnknownId),
        (s(now, 1, 3, angles(0.0, 0.0)), SightingVerdict::UnknownCamera),
        (s(now, 0, 3, angles(1.2, 0.0)), SightingVerdict::OutOfFieldOfView),
        (s(now, 0, 3, angles(0.0, -1.2)), SightingVerdict::OutOfFieldOfView),
        (s(now, 0, 3, angles(3.0, 0.0)), SightingVerdict::OutOfFieldOfView),
        (
            s(now, 0, 3, Seen::InCamera(Camera::new(Vector3::new(0.0, 0.0, -3.0)))),
            SightingVerdict::OutOfFieldOfView,
        ),
        (s(at(40), 0, 3, angles(0.0, 0.0)), SightingVerdict::FromTheFuture(0.04)),
        (s(at(-1200), 0, 3, angles(0.0, 0.0)), SightingVerdict::TooOld(0.2)),
        (s(now, 0, 3, angles(nan, 0.0)), SightingVerdict::NotFinite),
        (s(now, 0, 3, angles(f64::INFINITY, 0.0)), SightingVerdict::NotFinite),
        (s(now, 0, 3, Seen::InCamera(Camera::new(Vector3::zeros()))), SightingVerdict::NotFinite),
        (s(now, 0, 3, Seen::InBody(Body::new(Vector3::new(1e300, nan, 0.0)))), SightingVerdict::NotFinite),
        (
            s(now, 0, 3, Seen::Angles { angle_xy: [0.0; 2], distance_m: Some(-1.0) }),
            SightingVerdict::NotFinite,
        ),
    ] {
        let verdict = filter.sighting(&given);
        let close = |a: f64, b: f64| (a - b).abs() < 1e-9;
        let same = match (verdict, want) {
            (SightingVerdict::FromTheFuture(a), SightingVerdict::FromTheFuture(b))
            | (SightingVerdict::TooOld(a), SightingVerdict::TooOld(b)) => close(a, b),
            (a, b) => a == b,
        };
        assert!(same, "{given:?}: {verdict:?}");
    }
    assert_eq!(filter.pose().unwrap(), before);
}

#[test]
fn a_message_heard_twice_counts_once() {
    let (mut filter, _, flight) = converged();
    let last = sighting(flight.seen.last().unwrap());
    let before = filter.pose().unwrap();
    assert_eq!(filter.sighting(&last), SightingVerdict::Duplicate);
    assert_eq!(filter.pose().unwrap(), before);
}

#[test]
fn positions_do_as_well_as_angles() {
    for in_body in [false, true] {
        let (w, f) = (Wander::over_field(0.7), field(6));
        let mut case = usual(&w, &f, 6);
        (case.camera.delay_s, case.duration_s) = (0.0, 20.0);
        let (flight, mount) = (case.flight(), case.camera.mount);
        let mut filter = case.filter(&flight);
        let mut next = flight.seen.iter().peekable();
        for step in &flight.steps {
            filter.push(stamp(step.truth.t_s), &motion(step), None);
            while let Some(seen) = next.next_if(|s| s.heard_s <= step.truth.t_s + 1e-9) {
                let q = f.markers.iter().find(|m| m.0 == seen.id).unwrap().1;
                let body = Body::new(step.truth.r_body_to_ned.tr_mul(&(q - step.truth.position_ned)));
                let camera = mount.camera_to_body.to_camera(body - mount.lever_arm);
                let what = if in_body { Seen::InBody(body) } else { Seen::InCamera(camera) };
                filter.sighting(&LandmarkSighting { seen: what, ..sighting(seen) });
            }
        }
        let (end, pose) = (flight.steps.last().unwrap(), filter.pose().unwrap());
        let e = error(&end.truth, &pose.position_ned, &pose.r_body_to_ned);
        assert!(pose.converged && e[0] < 0.1 && e[1] < 0.02, "{e:?}");
    }
}

#[test]
fn swapped_ids_are_rejected_and_the_pose_stays() {
    let (w, f) = (Wander::over_field(0.5), field(11));
    let case = usual(&w, &f, 11);
    let (filter, verdicts, errors) = flown(&case, |s| {
        s.id = match s.id {
            2 => 5,
            5 => 2,
            id => id,
        }
    });
    let late = verdicts.iter().filter(|(s, _)| s.taken_s > 10.0 && [2, 5].contains(&s.id));
    let (gated, all) = late.fold((0, 0), |(g, n), (_, v)| (g + usize::from(!v.is_used()), n + 1));
    assert!(all > 100 && gated * 10 > all * 9, "{gated} of {all}");
    assert!(filter.pose().unwrap().converged);
    let e = rms(&errors, 20.0);
    assert!(e[0] < 0.1 && e[1] < 0.02, "{e:?}");
}

#[test]
fn a_landmark_that_is_5_m_off_is_rejected_and_the_pose_stays() {
    for seed in 20..26 {
        let (w, f) = (Wander::over_field(0.1 * seed as f64 % 1.0), field(seed));
        let mut surveyed = f.clone();
        surveyed.markers[4].1.x += 5.0;
        let case = usual(&w, &f, seed);
        let flight = case.flight();
        let mut filter = Case { field: &surveyed, ..case }.filter(&flight);
        let (verdicts, errors) = track(&mut filter, &flight);
        let of_it = verdicts.iter().filter(|(s, _)| s.taken_s > 15.0 && s.id == 4 && s.is_right);
        let (gated, all) = of_it.fold((0, 0), |(g, n), (_, v)| (g + usize::from(!v.is_used()), n + 1));
        assert!(all > 20 && gated * 10 > all * 9, "{seed}: {gated} of {all}");
        let e = rms(&errors, 20.0);
        assert!(e[0] < 0.1 && e[1] < 0.02, "{seed}: {e:?}");
    }
}

/// With few landmarks nobody can tell which is wrong: then there is no pose to rely on, rather than a wrong one.
#[test]
fn one_wrong_landmark_of_few_makes_no_wrong_pose_to_rely_on() {
    for count in [3, 4, 5, 6] {
        let (mut wrong, mut all) = (0, 0);
        for seed in 0..12 {
            let w = Wander::over_field(0.137 * seed as f64 % 1.0);
            let f = MarkerField::scattered(seed, count, 4.0, 1.3);
            let mut surveyed = f.clone();
            surveyed.markers[1].1.x += 5.0;
            let case = usual(&w, &f, seed);
            let flight = case.flight();
            let mut filter = Case { field: &surveyed, ..case }.filter(&flight);
            fly(
                &mut filter,
                &flight,
                |_, _| {},
                |step, f| {
                    let pose = f.pose().filter(|p| p.converged && step.truth.t_s > 10.0);
                    all += 1;
                    wrong += usize::from(pose.is_some() && error_of(&step.truth, pose)[0] > 1.0);
                },
            );
        }
        assert!(wrong * 100 < all, "{count}: {wrong} of {all}");
    }
}

#[test]
fn a_line_or_a_pair_never_counts_as_a_pose() {
    let pair = MarkerField { markers: MarkerField::row(2, 3.0).markers };
    for (f, want) in [(MarkerField::row(8, 1.0), Observability::OnALine), (pair, Observability::TooFew(2))] {
        let w = Wander::over_field(0.6);
        let mut case = usual(&w, &f, 4);
        case.camera.wrong_ids = 0.0;
        let flight = case.flight();
        let mut filter = case.filter(&flight);
        fly(
            &mut filter,
            &flight,
            |_, _| {},
            |_, f| {
                assert!(
                    f.pose().is_none_or(|p| !p.converged && p.position_ned.iter().all(|v| v.is_finite()))
                );
            },
        );
        assert_eq!(filter.health().observability, want);
        assert_eq!(filter.health().definiteness, Definiteness::Definite);
    }
}

#[test]
fn a_filter_that_is_locked_out_gets_out_again() {
    // Somebody carries the drone away: the dead reckoning knows nothing of it.
    let (w, f) = (Wander::over_field(0.2), field(14));
    let mut case = usual(&w, &f, 14);
    (case.duration_s, case.camera.delay_s) = (60.0, 0.0);
    let mut flight = case.flight();
    let moved = &Wander { phase: 0.75, ..w };
    let other = Case { trajectory: moved, ..case }.flight();
    for (step, o) in flight.steps.iter_mut().zip(&other.steps).skip(1000) {
        *step = *o;
    }
    flight.seen.retain(|s| s.taken_s < 20.0);
    flight.seen.extend(other.seen.iter().filter(|s| s.taken_s >= 20.0));
    let mut filter = case.filter(&flight);
    let (_, errors) = track(&mut filter, &flight);
    let back = converged_at(&errors, LIMITS, 40.0).unwrap_or(f64::INFINITY);
    assert!((20.0..32.0).contains(&back), "{back}");
    assert!(filter.health().resets > 0);
}

#[test]
fn unseen_for_an_hour_the_doubt_grows_and_the_pose_comes_back() {
    let (mut filter, now, flight) = converged();
    let truth = flight.steps.last().unwrap().truth;
    let sigma = |f: &LandmarkFilter| f.pose().unwrap().covariance[(0, 0)].sqrt();
    let (mut last, mut time) = (sigma(&filter), now);
    for _ in 0..6 {
        for _ in 0..30_000 {
            time = time + Span::from_millis(20);
            assert_eq!(filter.push(time, &BodyMotion::REST, None), MotionVerdict::Used);
        }
        assert!(sigma(&filter) > last);
        last = sigma(&filter);
    }
    let pose = filter.pose().unwrap();
    assert!(!pose.converged && pose.source == PoseSource::Refined);
    assert_eq!(filter.health().definiteness, Definiteness::Definite);
    // The markers are in view again, of a drone that has not moved.
    let mount = MarkerCamera::downward().mount;
    for _ in 0..50 {
        time = time + Span::from_millis(100);
        filter.push(time, &BodyMotion::REST, None);
        for (id, q) in field(2).markers {
            let body = Body::new(truth.r_body_to_ned.tr_mul(&(q - truth.position_ned))) - mount.lever_arm;
            let [right, down, along] = mount.camera_to_body.to_camera(body).right_down_along();
            let seen = angles(right.atan2(along), down.atan2(along));
            filter.sighting(&LandmarkSighting { time, camera: 0, id, seen });
        }
    }
    let pose = filter.pose().unwrap();
    let e = error(&truth, &pose.position_ned, &pose.r_body_to_ned);
    assert!(pose.converged && e[0] < 0.05 && e[1] < 0.01, "{e:?}");
}

#[test]
fn motions_that_cannot_be_are_told_and_a_gap_is_doubt() {
    let (mut filter, now, _) = converged();
    let nan = BodyMotion { velocity_body: Vector3::new(f64::NAN, 0.0, 0.0), ..BodyMotion::REST };
    assert_eq!(filter.push(now + Span::from_millis(20), &nan, None), MotionVerdict::NotFinite);
    assert_eq!(filter.push(now, &BodyMotion::REST, None), MotionVerdict::OutOfOrder);
    assert!(filter.pose().unwrap().converged);
    let verdict = filter.push(now + Span::from_millis(900), &BodyMotion::REST, None);
    assert!(matches!(verdict, MotionVerdict::Gap(s) if (s - 0.9).abs() < 1e-9));
    assert!(!filter.pose().unwrap().converged);
}

#[test]
fn a_map_without_landmarks_or_with_two_of_one_id_is_none() {
    let q = Vector3::zeros();
    assert_eq!(LandmarkMap::new([]), Err(MapError::Empty));
    assert_eq!(LandmarkMap::new([(3, q), (4, q), (3, q)]), Err(MapError::Twice(3)));
    assert_eq!(
        LandmarkMap::new([(3, q), (4, Vector3::new(0.0, f64::NAN, 0.0))]),
        Err(MapError::Impossible(4))
    );
}

#[test]
fn no_step_and_no_sighting_allocates() {
    let (w, f) = (Wander::over_field(0.3), field(2));
    let mut case = usual(&w, &f, 2);
    (case.camera.jitter_s, case.duration_s) = (0.3, 20.0);
    let flight = case.flight();
    let mut filter = case.filter(&flight);
    let all = measure(|| {
        let mut next = flight.seen.iter().peekable();
        for step in &flight.steps {
            filter.push(stamp(step.truth.t_s), &motion(step), Some(&step.down_body));
            while let Some(seen) = next.next_if(|s| s.heard_s <= step.truth.t_s) {
                filter.sighting(&sighting(seen));
            }
            filter.pose();
        }
    });
    assert_eq!(all.count_total, 0);
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(24))]
    #[test]
    fn nothing_that_is_told_makes_a_pose_that_is_no_number(
        told in proptest::collection::vec((0..40i64, 0..12u8, -2.0..2.0f64, -2.0..2.0f64, proptest::num::f64::ANY), 200..400),
        start in proptest::array::uniform3(-1e4..1e4f64),
    ) {
        let map = LandmarkMap::new(field(1).markers).unwrap();
        let guess = PoseGuess {
            position_ned: Vector3::from(start),
            r_body_to_ned: Matrix3::identity(),
            position_sigma_m: 10.0,
            attitude_sigma_rad: PoseGuess::ANY_ATTITUDE,
        };
        let cameras = vec![LandmarkCamera::downward([1.0, 1.0])];
        let mut filter = LandmarkFilter::new(LandmarkSettings::default(), map, cameras, stamp(0.0), &guess);
        for (k, (age, id, x, y, any)) in told.into_iter().enumerate() {
            let t = stamp((k + 1) as f64 * STEP_S);
            let input = BodyMotion { velocity_body: Vector3::new(any, x, y), angular_rate_body: Vector3::new(x, y, any) };
            filter.push(t, &input, Some(&Vector3::new(x, any, y)));
            filter.push(t, &BodyMotion { velocity_body: Vector3::new(x, y, 0.0), angular_rate_body: Vector3::new(y, x, 3.0 * x) }, None);
            let distance_m = (k % 3 == 0).then_some(any);
            let time = t - Span::from_millis(20 * age);
            filter.sighting(&LandmarkSighting { time, camera: 0, id, seen: Seen::Angles { angle_xy: [x, y], distance_m } });
            if let Some(pose) = filter.pose() {
                prop_assert!(pose.position_ned.iter().chain(pose.covariance.iter()).all(|v| v.is_finite()));
                prop_assert!((pose.r_body_to_ned.determinant() - 1.0).abs() < 1e-6);
            }
        }
        prop_assert_eq!(filter.health().definiteness, Definiteness::Definite);
    }
}
