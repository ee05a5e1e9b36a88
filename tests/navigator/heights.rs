//! Heights that contradict each other: who is believed, and what is claimed meanwhile.

use crate::bad_input::{faulty, same_time};
use crate::flight::{Flight, PERIOD_S, moved, navigator, ready_rotor};
use holdover::altimeter::Channel;
use holdover::navigator::event::EventKind;
use holdover::navigator::solution::Mode;
use holdover::sample::Sample;
use holdover::time::Span;
use rand::SeedableRng;
use rand_chacha::ChaCha8Rng;
use rand_distr::{Distribution, StandardNormal};

/// dp/dh of the air near the ground, Pa/m.
const PA_PER_M: f64 = -12.0;

/// A barometer in the wash of rotors (4 m, 1 sigma, over 3 s) beside a sound GNSS height and a rangefinder: what is claimed holds.
#[test]
fn a_barometer_in_the_wash_leaves_what_is_claimed_true() {
    let (sigma_m, tau_s) = (4.0, 3.0);
    let mut rng = ChaCha8Rng::seed_from_u64(3);
    let mut off_m = 0.0;
    let washed = |_: f64, s: &Sample, out: &mut Vec<Sample>| {
        out.push(match s {
            Sample::Pressure(p) => {
                let mut p = *p;
                let keep = (-0.04f64 / tau_s).exp();
                let n: f64 = StandardNormal.sample(&mut rng);
                off_m = keep * off_m + sigma_m * (1.0 - keep * keep).sqrt() * n;
                p.pressure_pa += PA_PER_M * off_m;
                Sample::Pressure(p)
            }
            other => *other,
        });
    };
    faulty("barometer in the wash", ready_rotor(), true, washed, same_time).honest();
}

/// A vehicle that stands, armed, while its GNSS height sinks by 0.25 m/s: the barometer and the rangefinder agree, and are not convicted by it.
#[test]
fn two_that_agree_are_not_convicted_by_a_third() {
    let flight = Flight::rotor(PERIOD_S, 18.0, 9);
    let mut navigator = navigator(&[]);
    let (mut sunk_m, mut first_m, mut last_m) = (0.0, None, (0.0, 0.0));
    let mut convicted = Vec::new();
    for round in 0..8 {
        for step in flight.steps.iter().filter(|s| s.t_s >= 2.0) {
            let mut status = step.status;
            status.armed = Some(true);
            navigator.set_status(status);
            for sample in &step.samples {
                let mut sample = moved(sample, Span::from_seconds(16.0 * f64::from(round)));
                match &mut sample {
                    Sample::Gnss(fix) if round > 0 => {
                        sunk_m += 0.25 * 0.2;
                        fix.position = fix.position.map(|mut p| {
                            p.height_m -= sunk_m;
                            p
                        });
                    }
                    Sample::Range(range) => range.distance_m = 0.45,
                    _ => {}
                }
                navigator.ingest(&sample);
            }
            for event in navigator.drain_events() {
                if let EventKind::HeightFault { channel, .. } = event.kind {
                    convicted.push(channel);
                }
            }
            if let Some(s) = navigator.solution().filter(|_| navigator.mode() == Mode::Aided) {
                let down_m = s.position.raw().z;
                let first = *first_m.get_or_insert(down_m);
                last_m = (down_m - first, s.position_covariance.raw()[(2, 2)].sqrt());
            }
        }
    }
    assert!(sunk_m > 20.0, "{sunk_m}");
    assert!(first_m.is_some() && last_m.0.abs() < 2.0 * last_m.1, "{last_m:?}, {convicted:?}");
    assert!(last_m.0.abs() < 6.0, "{last_m:?}");
    assert!(!convicted.contains(&Channel::Baro), "{convicted:?}");
}
