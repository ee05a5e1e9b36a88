//! Vehicles that lack something, or have it of poor quality: no GNSS ever, no rangefinder, a slow receiver, a compass that is noisy, bent or turned.

use crate::flight::{self, Flight, PERIOD_S, Step};
use holdover::geo::{Body, Euler};
use holdover::navigator::Navigator;
use holdover::navigator::event::EventKind;
use holdover::navigator::solution::{Mode, VelocitySource};
use holdover::sample::{MagSample, Sample};

use nalgebra::{Rotation3, Vector3};
use rand::SeedableRng;
use rand_distr::{Distribution, StandardNormal};

/// What a flight came to.
struct Flown {
    navigator: Navigator,
    modes: Vec<(f64, Mode)>,
    events: Vec<(f64, EventKind)>,
    /// Once a second: time, how far from where it began, by truth and by the solution, m, one sigma, m, heading error, rad, and what carries.
    seconds: Vec<(f64, f64, f64, f64, f64, VelocitySource)>,
}

impl Flown {
    fn aided_s(&self) -> f64 {
        self.modes.iter().find(|(_, m)| *m == Mode::Aided).map_or(f64::INFINITY, |(t, _)| *t)
    }
}

/// Flies a multirotor; `change` makes of each sample what comes of it.
fn fly(flight: &Flight, mut change: impl FnMut(f64, Sample) -> Option<Sample>) -> Flown {
    let mut navigator = flight::navigator(&[]);
    let (mut modes, mut events, mut seconds) = (vec![(0.0, Mode::Aligning)], Vec::new(), Vec::new());
    let mut began = None;
    let give = |navigator: &mut Navigator, step: &Step, sample: &Sample| {
        if let Some(sample) = change(step.t_s, *sample) {
            navigator.ingest(&sample);
        }
    };
    flight::fly(&mut navigator, &flight.steps, give, |navigator, step| {
        events.extend(navigator.drain_events().map(|e| (step.t_s, e.kind)));
        if modes.last().is_some_and(|(_, m)| *m != navigator.mode()) {
            modes.push((step.t_s, navigator.mode()));
        }
        let due = seconds.last().is_none_or(|(t, ..): &(f64, f64, f64, f64, f64, _)| step.t_s - t >= 1.0);
        let Some(s) = navigator.solution().filter(|s| due && s.mode != Mode::Aligning) else { return };
        let (truth, ours) = (step.truth.position_ned, s.position.raw());
        let (truth_0, ours_0) = *began.get_or_insert((truth, ours));
        let turn = step.truth.r_body_to_ned.transpose() * s.attitude.matrix();
        let yaw = Euler::from_rotation(&turn).yaw_rad;
        let away = |a: Vector3<f64>, b: Vector3<f64>| (a - b).xy().norm();
        seconds.push((
            step.t_s,
            away(truth, truth_0),
            away(ours, ours_0),
            s.horizontal_sigma_m(),
            yaw,
            s.velocity_source,
        ));
    });
    Flown { navigator, modes, events, seconds }
}

fn field(s: Sample, change: impl FnOnce(Vector3<f64>) -> Vector3<f64>) -> Sample {
    match s {
        Sample::Mag(m) => Sample::Mag(MagSample { field: Body::new(change(m.field.raw())), ..m }),
        other => other,
    }
}

#[test]
fn where_there_was_never_a_fix_it_navigates_from_where_it_stands_and_joins_gnss_when_that_comes() {
    let flight = Flight::rotor(PERIOD_S, 240.0, 5);
    const COMES_S: f64 = 180.0;
    let flown = fly(&flight, |t, s| (t >= COMES_S || !matches!(s, Sample::Gnss(_))).then_some(s));
    let began = flown.modes[1];
    assert!(began.1 == Mode::Holdover && (30.0..45.0).contains(&began.0), "{:?}", flown.modes);
    let alone: Vec<_> = flown.seconds.iter().filter(|s| s.0 < COMES_S).collect();
    assert!(alone.iter().filter(|s| s.5 == VelocitySource::Flow).count() > 100, "flow carries");
    for (t, truth_m, ours_m, sigma_m, ..) in &alone {
        assert!((truth_m - ours_m).abs() < 3.0 * sigma_m, "{t}: {ours_m} of {truth_m} m, sigma {sigma_m}");
        assert!(*sigma_m < 20.0, "{t}: {sigma_m}");
    }
    assert!(alone.iter().any(|s| s.1 > 15.0), "it has moved");
    assert!(flown.events.iter().any(|(_, e)| matches!(e, EventKind::Placed(_))));
    assert!(flown.aided_s() < COMES_S + 20.0, "{:?}", flown.modes);
    let (last, solution) = (flight.steps.last().unwrap(), flown.navigator.solution().unwrap());
    let here = flown.navigator.frame().unwrap().to_geodetic(&solution.position.raw());
    let error = (flight.frame.to_ned(&here) - last.truth.position_ned).xy().norm();
    assert!(error < 4.0, "{error} m");
}

#[test]
fn without_a_rangefinder_the_place_of_take_off_is_the_ground() {
    let flight = Flight::rotor(PERIOD_S, 200.0, 6);
    let outage = |ranged: bool| {
        let mut navigator = flight::navigator(&[]);
        let mut lost = flight::masked_from(130.0);
        let give = |navigator: &mut Navigator, step: &Step, sample: &Sample| match sample {
            Sample::Range(_) if !ranged => {}
            other => lost(navigator, step, other),
        };
        flight::fly(&mut navigator, &flight.steps, give, |_, _| {});
        let (s, last) = (navigator.solution().unwrap(), flight.steps.last().unwrap());
        assert_eq!((s.mode, s.velocity_source), (Mode::Holdover, VelocitySource::Flow), "ranged: {ranged}");
        ((s.position.raw() - last.truth.position_ned).xy().norm(), s.horizontal_sigma_m())
    };
    let ((with_m, _), (without_m, sigma_m)) = (outage(true), outage(false));
    assert!(
        without_m < 3.0 * sigma_m && without_m < 2.0 * with_m + 3.0,
        "{without_m} m for {with_m}, {sigma_m}"
    );
}

#[test]
fn a_receiver_that_tells_one_fix_a_second_is_enough() {
    let flight = Flight::rotor(PERIOD_S, 120.0, 7);
    let mut next_s = 0.0;
    let flown = fly(&flight, |t, s| match s {
        Sample::Gnss(_) if t < next_s => None,
        Sample::Gnss(_) => {
            next_s = t + 0.95;
            Some(s)
        }
        other => Some(other),
    });
    assert!(flown.aided_s() < 20.0, "{:?}", flown.modes);
    assert_eq!(flown.modes.len(), 2, "one lost fix is no loss: {:?}", flown.modes);
}

#[test]
fn a_noisy_compass_aligns_and_a_slow_one_too() {
    let flight = Flight::rotor(PERIOD_S, 90.0, 8);
    let mut rng = rand_chacha::ChaCha8Rng::seed_from_u64(1);
    let mut one = move || StandardNormal.sample(&mut rng);
    // 2 µT are 5° of heading where 20 µT point north.
    let noisy = fly(&flight, |_, s| Some(field(s, |f| f + Vector3::<f64>::new(one(), one(), one()) * 2e-6)));
    let mut heard_s = f64::NEG_INFINITY;
    let slow = fly(&flight, |t, s| match s {
        Sample::Mag(_) if t - heard_s < 2.0 => None,
        Sample::Mag(_) => {
            heard_s = t;
            Some(s)
        }
        other => Some(other),
    });
    for (name, flown) in [("noisy", noisy), ("slow", slow)] {
        assert!(flown.aided_s() < 20.0, "{name}: {:?}", flown.modes);
        assert_eq!(flown.modes.len(), 2, "{name}: {:?}", flown.modes);
        let worst = flown.seconds.iter().map(|s| s.4.abs()).fold(0.0, f64::max);
        assert!(worst < 0.2, "{name}: heading {worst} rad off");
    }
}

#[test]
fn a_field_that_something_bends_is_not_believed_and_motion_shows_the_heading() {
    let flight = Flight::rotor(PERIOD_S, 150.0, 9);
    let iron = Vector3::new(14e-6, 6e-6, -16e-6);
    let flown = fly(&flight, |_, s| Some(field(s, |f| f + iron)));
    let used = flown.navigator.statuses().used(holdover::sample::SampleKind::Mag);
    assert!(used < 200, "{used} of its samples were used");
    assert!(flown.aided_s() < 100.0, "{:?}", flown.modes);
    assert_eq!(flown.modes.len(), 2, "GNSS is not blamed: {:?}", flown.modes);
    let (.., yaw, _) = flown.seconds.last().unwrap();
    assert!(yaw.abs() < 0.25, "heading {yaw} rad off");
}

#[test]
fn a_compass_that_was_always_turned_is_found_out_and_gnss_is_not_blamed() {
    let flight = Flight::rotor(PERIOD_S, 150.0, 10);
    let mut turns = 0;
    for turned_deg in [-50.0f64, 100.0, 170.0] {
        let turn = Rotation3::from_axis_angle(&Vector3::z_axis(), turned_deg.to_radians());
        let flown = fly(&flight, |_, s| Some(field(s, |f| turn * f)));
        turns += flown.events.iter().filter(|(_, e)| matches!(e, EventKind::HeadingTurned(_))).count();
        let (mode, yaw) = (flown.navigator.mode(), flown.seconds.last().unwrap().4);
        assert_eq!(mode, Mode::Aided, "{turned_deg}: {:?}", flown.modes);
        // Between a compass that is wrong by less and GNSS the filter finds a compromise.
        let most = if turned_deg.abs() < 90.0 { 0.7 * turned_deg.abs().to_radians() } else { 0.25 };
        assert!(yaw.abs() < most, "{turned_deg}: heading {yaw} rad off");
        let convicted: f64 = flown
            .modes
            .windows(2)
            .filter(|w| matches!(w[0].1, Mode::Holdover | Mode::Lost))
            .map(|w| w[1].0 - w[0].0)
            .sum();
        assert!(convicted < 10.0, "{turned_deg}: {:?}", flown.modes);
    }
    assert!(turns >= 1, "motion has turned a heading");
}
