//! Sensors that fall silent, stick, saturate, lie or come at the wrong time: the solution stays finite, what it claims stays honest, and
//! every sample is accounted for with a reason.

use crate::flight::{self, LOST_S, PERIOD_S, Ready, Step, moved, ready_rotor, ready_wing};
use crate::sound::check_form;
use holdover::geo::Body;
use holdover::navigator::Navigator;
use holdover::navigator::solution::Mode;
use holdover::navigator::verdict::Reason;
use holdover::sample::{Sample, SampleKind};
use holdover::sim::Simulation;
use holdover::time::{AutopilotTime, Span};
use nalgebra::Vector3;

/// The fault begins here, s.
pub const FAULT_S: f64 = 120.0;

/// What was seen of a flight with something wrong.
pub struct Seen {
    name: String,
    /// Largest error over its standard deviation while the solution was offered, and when: horizontal, vertical.
    pub horizontal: (f64, f64),
    vertical: (f64, f64),
    /// Largest horizontal error while it was offered, m.
    pub error_m: f64,
    pub modes: Vec<(f64, Mode)>,
    pub navigator: Navigator,
}

/// Flies on with GNSS or without; `fault` does with each sample of a step what it will, and tells which true time a solution of a time
/// belongs to (clocks may step).
pub fn faulty(
    name: &str,
    ready: &Ready,
    gnss: bool,
    mut fault: impl FnMut(f64, &Sample, &mut Vec<Sample>),
    true_time: impl Fn(f64, AutopilotTime) -> f64,
) -> Seen {
    let mut seen = Seen {
        name: format!("{name}{}", if gnss { "" } else { ", no GNSS" }),
        horizontal: (0.0, 0.0),
        vertical: (0.0, 0.0),
        error_m: 0.0,
        modes: vec![(LOST_S, ready.navigator.mode())],
        navigator: ready.navigator.clone(),
    };
    let mut taken = ready.taken.clone();
    let mut navigator = ready.navigator.clone();
    let mut out = Vec::new();
    let give = |navigator: &mut Navigator, step: &Step, sample: &Sample| {
        if !gnss && sample.kind() == SampleKind::Gnss {
            return;
        }
        if step.t_s < FAULT_S {
            out.push(*sample)
        } else {
            fault(step.t_s, sample, &mut out)
        }
        for sample in out.drain(..) {
            navigator.ingest(&sample);
            *taken.entry(sample.kind()).or_default() += 1;
        }
    };
    flight::fly(&mut navigator, &ready.flight.steps[ready.from..], give, |n, step| {
        seen.look(n, ready, step, &true_time);
    });
    seen.navigator = navigator;
    for (kind, taken) in taken {
        let tally = seen.navigator.statuses();
        let rejected: u64 = tally.rejected(kind).map(|(_, n)| n).sum();
        assert_eq!(tally.used(kind) + rejected, taken, "{}: {kind:?} unaccounted for", seen.name);
    }
    seen
}

impl Seen {
    fn look(
        &mut self,
        navigator: &Navigator,
        ready: &Ready,
        step: &Step,
        true_time: &impl Fn(f64, AutopilotTime) -> f64,
    ) {
        let mode = navigator.mode();
        if self.modes.last().is_none_or(|(_, m)| *m != mode) {
            self.modes.push((step.t_s, mode));
        }
        let Some(s) = navigator.solution() else { return };
        check_form(&s, &self.name);
        if matches!(mode, Mode::Aligning | Mode::Lost) {
            return;
        }
        let t = true_time(step.t_s, s.time);
        let at = ready.flight.steps.partition_point(|x| x.t_s < t - 1e-6).min(ready.flight.steps.len() - 1);
        let truth = &ready.flight.steps[at].truth;
        let shift = ready.flight.frame.to_ned(&navigator.frame().unwrap().origin());
        let p = s.position.raw() + shift - truth.position_ned;
        let note = |worst: &mut (f64, f64), ratio: f64| {
            if ratio > worst.0 {
                *worst = (ratio, step.t_s);
            }
        };
        note(&mut self.horizontal, p.xy().norm() / s.horizontal_sigma_m());
        note(&mut self.vertical, p.z.abs() / s.position_covariance.raw()[(2, 2)].sqrt());
        self.error_m = self.error_m.max(p.xy().norm());
    }

    /// The errors of the position are what the solution claims them to be.
    pub fn honest(&self) -> &Self {
        assert!(self.vertical.0 < 5.0, "{}: vertical {:?} at {:?}", self.name, self.vertical, self.modes);
        self.honest_horizontally()
    }

    fn honest_horizontally(&self) -> &Self {
        assert!(
            self.horizontal.0 < 5.0,
            "{}: horizontal {:?} at {:?}",
            self.name,
            self.horizontal,
            self.modes
        );
        self
    }

    fn rejected(&self, kind: SampleKind, reason: Reason) -> u64 {
        self.navigator.statuses().rejected(kind).find(|(r, _)| *r == reason).map_or(0, |(_, n)| n)
    }
}

pub fn same_time(_: f64, time: AutopilotTime) -> f64 {
    Simulation::seconds(time)
}

fn vehicles() -> [(&'static str, &'static Ready); 2] {
    [("wing", ready_wing()), ("rotor", ready_rotor())]
}

const KINDS: [SampleKind; 7] = [
    SampleKind::Imu,
    SampleKind::Mag,
    SampleKind::Gnss,
    SampleKind::Pressure,
    SampleKind::Flow,
    SampleKind::Range,
    SampleKind::Airspeed,
];

#[test]
fn any_sensor_may_fall_silent_for_any_time() {
    for (vehicle, ready) in vehicles() {
        for kind in KINDS {
            for seconds in [0.1, 1.0, 10.0, 60.0, f64::INFINITY] {
                for gnss in [true, false] {
                    let name = format!("{vehicle}: {} silent for {seconds} s", kind.label());
                    let silent = |t: f64, s: &Sample, out: &mut Vec<Sample>| {
                        if s.kind() != kind || t > FAULT_S + seconds {
                            out.push(*s);
                        }
                    };
                    faulty(&name, ready, gnss, silent, same_time).honest();
                }
            }
        }
    }
}

#[test]
fn a_stuck_sensor_is_outvoted_or_owned_up_to() {
    for (vehicle, ready) in vehicles() {
        for kind in KINDS {
            for gnss in [true, false] {
                let name = format!("{vehicle}: {} stuck", kind.label());
                let mut stuck: Option<Sample> = None;
                let hold = |t: f64, s: &Sample, out: &mut Vec<Sample>| {
                    if s.kind() != kind || t > FAULT_S + 30.0 {
                        return out.push(*s);
                    }
                    let first = *stuck.get_or_insert(*s);
                    out.push(moved(&first, s.time() - first.time()));
                };
                let seen = faulty(&name, ready, gnss, hold, same_time);
                // Nothing but GNSS knows better than a barometer that the vehicle stays at its height.
                if kind == SampleKind::Pressure {
                    seen.honest_horizontally()
                } else {
                    seen.honest()
                };
            }
        }
    }
}

#[test]
fn a_clipped_imu_is_owned_up_to() {
    for (vehicle, ready) in vehicles() {
        for (what, rate, force) in [("gyros", 0.05, 1e9), ("accelerometers", 1e9, 9.0), ("both", 0.1, 8.0)] {
            // For long it takes GNSS to set it right.
            for (gnss, seconds) in [(true, 2.0), (true, 20.0), (false, 2.0)] {
                let name = format!("{vehicle}: {what} clipped for {seconds} s");
                let clipped = |t: f64, s: &Sample, out: &mut Vec<Sample>| {
                    let mut s = *s;
                    if let Sample::Imu(imu) = &mut s
                        && t < FAULT_S + seconds
                    {
                        let clip = |v: &mut Body<Vector3<f64>>, most: f64| {
                            *v = Body::new(v.raw().map(|c| c.clamp(-most, most)));
                        };
                        clip(&mut imu.angular_rate, rate);
                        clip(&mut imu.specific_force, force);
                    }
                    out.push(s);
                };
                faulty(&name, ready, gnss, clipped, same_time).honest();
            }
        }
    }
}

#[test]
fn an_imu_at_its_limits_is_owned_up_to() {
    for (vehicle, ready) in vehicles() {
        for gnss in [true, false] {
            for seconds in [0.02, 0.3, 3.0] {
                let name = format!("{vehicle}: IMU at its limits for {seconds} s");
                let shaken = |t: f64, s: &Sample, out: &mut Vec<Sample>| {
                    let mut s = *s;
                    if let Sample::Imu(imu) = &mut s
                        && t < FAULT_S + seconds
                    {
                        // 2000 °/s and 16 g, as sensors have them.
                        imu.angular_rate = Body::new(Vector3::new(34.9, -34.9, 34.9));
                        imu.specific_force = Body::new(Vector3::new(157.0, 157.0, -157.0));
                    }
                    out.push(s);
                };
                faulty(&name, ready, gnss, shaken, same_time).honest();
            }
        }
    }
}

#[test]
fn a_rangefinder_out_of_range_is_rejected_as_such() {
    for (distance, reason) in [
        (0.0, Reason::OutOfRange),
        (1e6, Reason::OutOfRange),
        (f64::NAN, Reason::NotFinite),
        (-3.0, Reason::OutOfRange),
    ] {
        for gnss in [true, false] {
            let name = format!("rotor: range {distance}");
            let wrong = |_: f64, s: &Sample, out: &mut Vec<Sample>| {
                let mut s = *s;
                if let Sample::Range(r) = &mut s {
                    r.distance_m = distance;
                }
                out.push(s);
            };
            let seen = faulty(&name, ready_rotor(), gnss, wrong, same_time);
            assert!(seen.honest().rejected(SampleKind::Range, reason) > 100);
        }
    }
}

#[test]
fn a_disturbed_magnetometer_does_not_take_the_position_along() {
    for (vehicle, ready) in vehicles() {
        for axis in 0..3 {
            for gnss in [true, false] {
                let name = format!("{vehicle}: 20 µT on magnetometer axis {axis}");
                let disturbed = |t: f64, s: &Sample, out: &mut Vec<Sample>| {
                    let mut s = *s;
                    if let Sample::Mag(m) = &mut s
                        && t < FAULT_S + 30.0
                    {
                        let mut disturbance = Vector3::zeros();
                        disturbance[axis] = 20e-6;
                        m.field = m.field + Body::new(disturbance);
                    }
                    out.push(s);
                };
                let seen = faulty(&name, ready, gnss, disturbed, same_time);
                let mag =
                    seen.honest().navigator.statuses().rejected(SampleKind::Mag).map(|(_, n)| n).sum::<u64>();
                assert!(mag > 0, "{name}: never rejected");
            }
        }
    }
}

#[test]
fn a_magnetic_field_that_is_overtaken_by_a_wrong_one_is_not_taken_for_it() {
    for (vehicle, ready) in vehicles() {
        let overtaken = |t: f64, s: &Sample, out: &mut Vec<Sample>| {
            if let Sample::Mag(m) = s
                && t < FAULT_S + 30.0
            {
                // Three times as strong, turned, and stamped a moment later.
                let field = m.field.raw();
                let mut wrong = *m;
                wrong.field = Body::new(Vector3::new(-field.y, field.x, field.z) * 3.0);
                wrong.time = m.time + Span::from_seconds(0.004);
                out.push(Sample::Mag(wrong));
            }
            out.push(*s);
        };
        let seen = faulty(vehicle, ready, true, overtaken, same_time);
        let statuses = seen.honest().navigator.statuses();
        let rejected = |reason: Reason| {
            statuses.rejected(SampleKind::Mag).filter(|(r, _)| *r == reason).map(|(_, n)| n).sum::<u64>()
        };
        assert!(rejected(Reason::FieldStrength) > 100, "{vehicle}: {}", rejected(Reason::FieldStrength));
        assert!(rejected(Reason::OutOfOrder) > 100, "{vehicle}: {}", rejected(Reason::OutOfOrder));
    }
}

#[test]
fn a_receiver_that_comes_back_far_away_is_not_believed_at_once() {
    for (vehicle, ready) in vehicles() {
        let frame = &ready.flight.frame;
        // Away for less time than it takes to believe that it is the dead reckoning that is wrong.
        let away = |t: f64, s: &Sample, out: &mut Vec<Sample>| {
            let mut s = *s;
            if let Sample::Gnss(g) = &mut s {
                if t < FAULT_S + 20.0 {
                    return;
                }
                if t < FAULT_S + 80.0 {
                    let moved = |p| frame.to_geodetic(&(frame.to_ned(&p) + Vector3::new(90.0, 120.0, 0.0)));
                    g.position = g.position.map(moved);
                }
            }
            out.push(s);
        };
        let seen = faulty(&format!("{vehicle}: GNSS back 150 m away"), ready, true, away, same_time);
        assert!(seen.honest().error_m < 60.0, "{}: {} m", seen.name, seen.error_m);
        assert_eq!(seen.navigator.mode(), Mode::Aided, "{}: {:?}", seen.name, seen.modes);
    }
}

#[test]
fn late_samples_are_used_or_rejected_for_it() {
    for (vehicle, ready) in vehicles() {
        for late_s in [0.3, 1.0, 3.0, 30.0] {
            for gnss in [true, false] {
                let name = format!("{vehicle}: all but the IMU {late_s} s late");
                let mut waiting = std::collections::VecDeque::new();
                let late = |t: f64, s: &Sample, out: &mut Vec<Sample>| {
                    if s.kind() != SampleKind::Imu {
                        return waiting.push_back((t, *s));
                    }
                    out.push(*s);
                    while waiting.front().is_some_and(|(then, _)| then + late_s <= t) {
                        out.extend(waiting.pop_front().map(|(_, s)| s));
                    }
                };
                faulty(&name, ready, gnss, late, same_time).honest();
            }
        }
    }
}

#[test]
fn clocks_that_stand_or_step_are_owned_up_to() {
    for (vehicle, ready) in vehicles() {
        for gnss in [true, false] {
            // The same stamp twice.
            let doubled = |_: f64, s: &Sample, out: &mut Vec<Sample>| out.extend([*s, *s]);
            let seen = faulty(&format!("{vehicle}: every sample twice"), ready, gnss, doubled, same_time);
            assert!(seen.honest().rejected(SampleKind::Imu, Reason::OutOfOrder) > 1000);
            // One sample with a stamp that is wrong, every other second.
            for by_s in [-5.0, -0.02, 0.02, 5.0] {
                let name = format!("{vehicle}: a stamp wrong by {by_s} s now and then");
                let now_and_then = |t: f64, s: &Sample, out: &mut Vec<Sample>| {
                    let wrong =
                        s.kind() == SampleKind::Imu && t < FAULT_S + 20.0 && (t + 0.001) % 2.0 < PERIOD_S;
                    out.push(if wrong { moved(s, Span::from_seconds(by_s)) } else { *s });
                };
                faulty(&name, ready, gnss, now_and_then, |t, _| t).honest();
            }
            // The clock steps, for all.
            for by_s in [-60.0, -5.0, -0.5, 0.15, 2.0, 60.0] {
                let name = format!("{vehicle}: the clock steps by {by_s} s");
                let stepped =
                    |_: f64, s: &Sample, out: &mut Vec<Sample>| out.push(moved(s, Span::from_seconds(by_s)));
                let true_time = |t: f64, time: AutopilotTime| {
                    // Until a sample with the new clock was used, the solution is the old clock's.
                    let new = Simulation::seconds(time) - by_s;
                    if (new - t).abs() < 0.5 * PERIOD_S { t } else { Simulation::seconds(time) }
                };
                faulty(&name, ready, gnss, stepped, true_time).honest();
            }
        }
    }
}
