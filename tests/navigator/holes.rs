//! Holes in the stream, of everything at once: what was known is carried over them with the doubt that they leave, and goes on from there.

use crate::bad_input::FAULT_S;
use crate::flight::{self, Flight, LOST_S, PERIOD_S, Ready, Step, ready_rotor, ready_wing};
use crate::sound::check_form;
use holdover::geo::{Ned, so3};
use holdover::navigator::Navigator;
use holdover::navigator::event::{EventKind, TransitionReason};
use holdover::navigator::solution::{Mode, Solution, VelocitySource};
use holdover::navigator::verdict::Reason;
use holdover::sample::{Sample, SampleKind};
use holdover::sim::Truth;

/// A hole of everything that begins at [`FAULT_S`], with GNSS besides or without since [`LOST_S`].
#[derive(Clone, Copy)]
struct Hole {
    seconds: f64,
    gnss: bool,
    /// The autopilot boots in it.
    reboots: bool,
}

/// What was seen after a hole, times in seconds after its end.
struct After {
    states: Vec<(f64, Truth, Solution)>,
    events: Vec<(f64, EventKind)>,
    navigator: Navigator,
}

/// Flies on from where the vehicle is ready, with `navigator` in its place.
fn fly_over(flight: &Flight, from: usize, mut navigator: Navigator, hole: Hole) -> After {
    let end_s = FAULT_S + hole.seconds;
    let mut reboots = hole.reboots;
    let give = |navigator: &mut Navigator, step: &Step, sample: &Sample| {
        let missing = (FAULT_S..end_s).contains(&step.t_s);
        if step.t_s >= end_s && std::mem::take(&mut reboots) {
            navigator.reboot(sample.time(), Some(hole.seconds));
        }
        let masked = !hole.gnss && step.t_s >= LOST_S && sample.kind() == SampleKind::Gnss;
        if !missing && !masked {
            navigator.ingest(sample);
        }
    };
    let (mut states, mut events) = (Vec::new(), Vec::new());
    flight::fly(&mut navigator, &flight.steps[from..], give, |navigator, step| {
        events.extend(navigator.drain_events().map(|e| (step.t_s - end_s, e.kind)));
        let Some(solution) = navigator.solution().filter(|_| step.t_s >= end_s) else { return };
        check_form(&solution, "after a hole");
        let shift = flight.frame.to_ned(&navigator.frame().unwrap().origin());
        states.push((
            step.t_s - end_s,
            step.truth,
            Solution { position: solution.position + Ned::new(shift), ..solution },
        ));
    });
    After { states, events, navigator }
}

fn over(ready: &Ready, hole: Hole) -> After {
    fly_over(&ready.flight, ready.from, ready.navigator.clone(), hole)
}

/// The same with other settings: from the ground on.
fn over_with(flight: &Flight, set: &[&str], hole: Hole) -> After {
    fly_over(flight, 0, flight::navigator(set), hole)
}

impl After {
    fn at(&self, t: f64) -> &(f64, Truth, Solution) {
        self.states.iter().find(|s| s.0 >= t - 0.5 * PERIOD_S).unwrap()
    }

    /// Horizontal errors of position and velocity at a time.
    fn errors(&self, t: f64) -> (f64, f64) {
        let (_, truth, s) = self.at(t);
        let p = s.position.raw() - truth.position_ned;
        (p.xy().norm(), (s.velocity.raw() - truth.velocity_ned).xy().norm())
    }

    /// Every position's, velocity's, and height's error is what the solution claims it to be.
    fn honest(&self, what: &str) {
        for (t, truth, s) in &self.states {
            let p = s.position.raw() - truth.position_ned;
            let v = s.velocity.raw() - truth.velocity_ned;
            let (sp, sv) = (s.position_covariance.raw(), s.velocity_covariance.raw());
            let sigma_v = (sv[(0, 0)] + sv[(1, 1)]).sqrt().hypot(0.1);
            assert!(p.xy().norm() < 3.0 * s.horizontal_sigma_m(), "{what}: {} m at {t}", p.xy().norm());
            assert!(p.z.abs() < 3.0 * sp[(2, 2)].sqrt(), "{what}: height {} m at {t}", p.z);
            assert!(v.xy().norm() < 3.0 * sigma_v, "{what}: {} m/s of {sigma_v} at {t}", v.xy().norm());
        }
    }

    fn modes(&self) -> Vec<Mode> {
        let entered = |(_, e): &(f64, EventKind)| match e {
            EventKind::Mode { to, .. } => Some(*to),
            _ => None,
        };
        self.events.iter().filter_map(entered).collect()
    }

    fn first_s(&self) -> f64 {
        self.states[0].0
    }
}

const SHORT: [f64; 4] = [0.55, 0.7, 0.85, 1.4];
const LONG: [f64; 4] = [1.6, 3.0, 5.0, 10.0];

#[test]
fn a_short_hole_is_no_loss_of_gnss() {
    for (vehicle, ready) in [("wing", ready_wing()), ("rotor", ready_rotor())] {
        let untimely = |n: &Navigator| n.statuses().rejected(SampleKind::Gnss).map(|(_, n)| n).sum::<u64>();
        let whole = over(ready, Hole { seconds: 0.0, gnss: true, reboots: false });
        for seconds in SHORT {
            let what = format!("{vehicle}: {seconds} s");
            let after = over(ready, Hole { seconds, gnss: true, reboots: false });
            after.honest(&what);
            assert_eq!(after.modes(), [], "{what}: {:?}", after.events);
            assert!(after.events.iter().any(|(_, e)| matches!(e, EventKind::Bridged(_))), "{what}");
            let more = untimely(&after.navigator) - untimely(&whole.navigator);
            assert!(more <= 3, "{what}: {more} fixes more were refused");
            let (p, v) = after.errors(1.0);
            assert!(p < 3.0 && v < 0.5, "{what}: {p} m {v} m/s");
            assert_eq!(after.at(1.0).2.reset_counter, ready.navigator.solution().unwrap().reset_counter);
        }
    }
}

#[test]
fn a_hole_in_an_outage_is_carried_over_and_flow_carries_on() {
    for (vehicle, ready) in [("wing", ready_wing()), ("rotor", ready_rotor())] {
        for seconds in SHORT.into_iter().chain(LONG) {
            let what = format!("{vehicle}: {seconds} s");
            let after = over(ready, Hole { seconds, gnss: false, reboots: false });
            after.honest(&what);
            assert!(after.first_s() <= 0.26, "{what}: the first solution after {} s", after.first_s());
            assert_eq!(after.at(0.5).2.velocity_source, VelocitySource::Flow, "{what}");
            let (_, v) = after.errors(10.0);
            assert!(v < 1.2, "{what}: {v} m/s");
            // The doubt is the hole's: it does not grow as if nothing carried.
            let (first, later) =
                (after.at(1.0).2.horizontal_sigma_m(), after.at(31.0).2.horizontal_sigma_m());
            assert!(later < first + 13.0, "{what}: {first} m, then {later} m");
            let lost = after.modes().contains(&Mode::Lost);
            assert_eq!(lost, first > 100.0, "{what}: lost is for an uncertainty of more than 100 m");
        }
    }
}

#[test]
fn a_reboot_in_an_outage_is_a_hole() {
    for (vehicle, ready) in [("wing", ready_wing()), ("rotor", ready_rotor())] {
        for seconds in LONG {
            let what = format!("{vehicle}: {seconds} s");
            let after = over(ready, Hole { seconds, gnss: false, reboots: true });
            after.honest(&what);
            assert!(!after.modes().contains(&Mode::Aligning), "{what}: {:?}", after.events);
            assert!(after.first_s() <= 0.26, "{what}: the first solution after {} s", after.first_s());
            assert_eq!(after.at(0.5).2.velocity_source, VelocitySource::Flow, "{what}");
        }
    }
    // With GNSS it begins anew, and after minutes nothing that flies is where it was.
    let mut navigator = ready_rotor().navigator.clone();
    let now = navigator.solution().unwrap().time;
    navigator.reboot(now, Some(1.0));
    assert_eq!(navigator.mode(), Mode::Aligning);
    let mut navigator = over(ready_rotor(), Hole { seconds: 0.0, gnss: false, reboots: false }).navigator;
    assert_eq!(navigator.mode(), Mode::Holdover);
    navigator.reboot(navigator.solution().unwrap().time, Some(200.0));
    assert_eq!(navigator.mode(), Mode::Aligning);
}

#[test]
fn gnss_that_comes_back_after_a_long_hole_is_joined_within_seconds() {
    for (vehicle, ready) in [("wing", ready_wing()), ("rotor", ready_rotor())] {
        for seconds in LONG {
            let what = format!("{vehicle}: {seconds} s");
            let after = over(ready, Hole { seconds, gnss: true, reboots: false });
            after.honest(&what);
            let (mode, source) = (after.at(5.0).2.mode, after.at(5.0).2.velocity_source);
            assert!(matches!(mode, Mode::Aided | Mode::Rejoining), "{what}: {:?}", after.events);
            assert_eq!(source, VelocitySource::Gnss);
            let attitude = {
                let (_, truth, s) = after.at(10.0);
                so3::angle_between(s.attitude.matrix(), &truth.r_body_to_ned)
            };
            assert!(attitude < 0.05, "{what}: {attitude} rad");
        }
    }
}

#[test]
fn air_and_drag_carry_on_where_there_is_no_flow() {
    let (wing, rotor) = (&ready_wing().flight, &ready_rotor().flight);
    for (flight, source) in [(wing, VelocitySource::Airspeed), (rotor, VelocitySource::Drag)] {
        for seconds in [0.85, 3.0, 6.0] {
            let what = format!("{} after {seconds} s", source.label());
            let after = over_with(flight, &["flow.use=false"], Hole { seconds, gnss: false, reboots: false });
            after.honest(&what);
            assert_eq!(after.at(3.0).2.velocity_source, source, "{what}: {:?}", after.events);
            let (_, v) = after.errors(20.0);
            assert!(v < 2.5, "{what}: {v} m/s");
        }
    }
}

#[test]
fn what_a_user_allows_decides_when_it_is_lost() {
    let hole = Hole { seconds: 10.0, gnss: false, reboots: false };
    let flight = &ready_wing().flight;
    let patient = over_with(flight, &["holdover.max_sigma_m=500"], hole);
    patient.honest("patient");
    assert_eq!(patient.at(30.0).2.mode, Mode::Holdover, "{:?}", patient.events);
    let strict = over_with(flight, &["holdover.max_sigma_m=50"], hole);
    let lost = strict.events.iter().find_map(|(t, e)| match e {
        EventKind::Mode { to: Mode::Lost, reason, .. } => Some((*t, *reason)),
        _ => None,
    });
    let Some((t, TransitionReason::Uncertain(sigma))) = lost else { panic!("{:?}", strict.events) };
    assert!(t.abs() < 0.1 && sigma > 50.0, "{t}: {sigma}");
}

#[test]
fn a_heading_that_a_hole_has_lost_is_sought_when_gnss_is_back() {
    let flight = &ready_wing().flight;
    let set = ["flow.use=false", "magnetometer.use=false", "airspeed.use=false"];
    let after = over_with(flight, &set, Hole { seconds: 5.0, gnss: true, reboots: false });
    after.honest("no magnetometer");
    let sought = after.events.iter().find(|(_, e)| {
        matches!(e, EventKind::Mode { to: Mode::Aligning, reason: TransitionReason::HeadingLost, .. })
    });
    assert!(sought.is_some_and(|(t, _)| *t < 5.0), "{:?}", after.events);
    let (_, truth, s) = after.at(60.0);
    assert_eq!(s.mode, Mode::Aided, "{:?}", after.events);
    let yaw = so3::log(&(s.attitude.matrix() * truth.r_body_to_ned.transpose())).z;
    assert!(yaw.abs() < 0.15, "{yaw} rad");
}

#[test]
fn what_is_refused_while_the_attitude_is_found_again_says_why() {
    let ready = ready_rotor();
    let refused = |seconds: f64| {
        let after = over(ready, Hole { seconds, gnss: false, reboots: false });
        let mut flow = after.navigator.statuses().rejected(SampleKind::Flow);
        flow.find(|(reason, _)| *reason == Reason::NoReferenceYet).map_or(0, |(_, n)| n)
    };
    let more = refused(3.0) - refused(0.0);
    assert!((1..10).contains(&more), "{more} flows");
}
