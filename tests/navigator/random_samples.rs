//! Random samples at random times, in random order, between those of a flight: no panic, and what the navigator tells stays a solution.

use crate::flight::{LOST_S, moved, ready_rotor, ready_wing};
use crate::sound::check_form;
use holdover::geo::{Body, Geodetic};
use holdover::sample::{
    AirspeedSample, FlowRotation, FlowSample, GnssFix, GnssSample, GroundVelocity, ImuSample, LandmarkSample,
    MagSample, PressureSample, RangeDirection, RangeSample, Sample, SampleKind, Sighting,
};
use holdover::sim::Simulation;
use holdover::time::{AutopilotTime, Span};
use nalgebra::Vector3;
use proptest::prelude::*;

/// Any number: what a sensor may say, what none can, and what is no number.
fn number() -> impl Strategy<Value = f64> {
    prop_oneof![
        6 => -60.0..60.0,
        2 => -1e-5..1e-5,
        1 => -1e6..1e6,
        1 => any::<f64>(),
        1 => prop::sample::select(vec![
            0.0, -0.0, f64::NAN, f64::INFINITY, f64::NEG_INFINITY, f64::MAX, f64::MIN, f64::MIN_POSITIVE, 1e-300, 1e150, -1e200,
        ]),
    ]
}

fn vector() -> impl Strategy<Value = Vector3<f64>> {
    [number(), number(), number()].prop_map(Vector3::from)
}

/// Microseconds from one stamp to the next.
fn step_us() -> impl Strategy<Value = i64> {
    prop_oneof![
        8 => prop::sample::select(vec![1_000, 5_000, 10_000, 50_000]),
        2 => -600_000..600_000i64,
        1 => prop::sample::select(vec![0, 1, -1, 5_000_000, -5_000_000, 3_600_000_000, -3_600_000_000]),
        1 => prop::sample::select(vec![i64::MAX, i64::MIN, i64::MAX / 2]),
    ]
}

/// A sample of any kind, its time yet to be set.
fn any_sample() -> impl Strategy<Value = Sample> {
    let time = AutopilotTime::from_micros(0);
    let some = || prop::option::of(number());
    let gnss = (
        (
            0u8..3,
            prop::sample::select(vec![GnssFix::None, GnssFix::TwoD, GnssFix::ThreeD, GnssFix::Corrected]),
        ),
        prop_oneof![
            Just(None),
            // Near the flights' origin, anywhere, nowhere.
            [-1e-4..1e-4f64, -1e-4..1e-4, -100.0..100.0].prop_map(Some),
            [number(), number(), number()].prop_map(Some),
        ],
        prop::option::of((number(), number())),
        (some(), some(), some()),
        prop::option::of(any::<u8>()),
    );
    let gnss = gnss.prop_map(move |((receiver, fix), position, velocity, (h, v, s), satellites)| {
        let origin = ready_wing().flight.frame.origin();
        Sample::Gnss(GnssSample {
            time,
            receiver,
            fix,
            position: position.map(|[lat, lon, up]| Geodetic {
                latitude_rad: origin.latitude_rad + lat,
                longitude_rad: origin.longitude_rad + lon,
                height_m: origin.height_m + up,
            }),
            ground_velocity: velocity.map(|(speed_mps, course_rad)| GroundVelocity { speed_mps, course_rad }),
            horizontal_accuracy_m: h,
            vertical_accuracy_m: v,
            speed_accuracy_mps: s,
            satellites,
            warning: None,
        })
    });
    let rotation = prop_oneof![
        [number(), number()].prop_map(FlowRotation::SensorGyro),
        Just(FlowRotation::Contained),
        Just(FlowRotation::Removed),
    ];
    let flow = (0u8..10, step_us(), [number(), number()], rotation, number(), some());
    let flow = flow.prop_map(move |(sensor, interval, rate_xy, rotation, quality, distance_m)| {
        let interval = Span::from_micros(interval);
        Sample::Flow(FlowSample { time, sensor, interval, rate_xy, rotation, quality, distance_m })
    });
    let down = prop::sample::select(vec![RangeDirection::Down, RangeDirection::Other(3)]);
    let range = (0u8..3, down, number(), prop::option::of([number(), number()]));
    prop_oneof![
        4 => (vector(), vector()).prop_map(move |(rate, force)| {
            let (angular_rate, specific_force) = (Body::new(rate), Body::new(force));
            Sample::Imu(ImuSample { time, angular_rate, specific_force })
        }),
        1 => (0u8..3, vector(), prop::bool::ANY).prop_map(move |(sensor, field, micro)| {
            let field = Body::new(if micro { field * 1e-6 } else { field });
            Sample::Mag(MagSample { time, sensor, field })
        }),
        2 => gnss,
        1 => (0u8..3, prop_oneof![number(), 80_000.0..110_000.0])
            .prop_map(move |(sensor, pressure_pa)| Sample::Pressure(PressureSample { time, sensor, pressure_pa })),
        2 => flow,
        1 => range.prop_map(move |(sensor, direction, distance_m, limits_m)| {
            Sample::Range(RangeSample { time, sensor, direction, distance_m, limits_m })
        }),
        1 => number().prop_map(move |airspeed_mps| Sample::Airspeed(AirspeedSample { time, airspeed_mps })),
        1 => number().prop_map(move |x| {
            let sighting = Sighting::Bearing { angle_xy: [x, -x], distance_m: Some(x) };
            Sample::Landmark(LandmarkSample { time, camera: 1, id: 1, sighting })
        }),
    ]
}

#[derive(Clone, Debug)]
enum Act {
    /// A sample so long after the last, µs.
    Sample(Box<Sample>, i64),
    /// So many steps of the flight as they were.
    Fly(usize),
    /// GNSS is masked from now on.
    Mask,
    Reboot(Option<f64>),
    Origin([f64; 3]),
    Date(f64),
}

fn act() -> impl Strategy<Value = Act> {
    prop_oneof![
        20 => (any_sample(), step_us()).prop_map(|(s, dt)| Act::Sample(Box::new(s), dt)),
        6 => (1usize..60).prop_map(Act::Fly),
        1 => Just(Act::Mask),
        1 => prop::option::of(0.0..100.0).prop_map(Act::Reboot),
        1 => [number(), number(), number()].prop_map(Act::Origin),
        1 => number().prop_map(Act::Date),
    ]
}

/// Two such samples once made inertia lead away by infinitely much.
#[test]
fn airspeeds_that_no_vehicle_has_leave_a_solution_that_is_one() {
    let ready = ready_wing();
    for airspeed_mps in [9e169, -1e30, 339.0] {
        let mut navigator = ready.navigator.clone();
        for (k, step) in ready.flight.steps[ready.from..].iter().take(900).enumerate() {
            navigator.set_status(step.status);
            for sample in step.samples.iter().filter(|s| s.kind() != SampleKind::Gnss) {
                let sample = match sample {
                    Sample::Airspeed(s) if k > 200 => Sample::Airspeed(AirspeedSample {
                        airspeed_mps: if k % 2 == 0 { airspeed_mps } else { 0.0 },
                        ..*s
                    }),
                    _ => *sample,
                };
                navigator.ingest(&sample);
            }
            check_form(&navigator.solution().unwrap(), "airspeeds");
        }
    }
}

proptest! {
    #![proptest_config(ProptestConfig { failure_persistence: None, ..ProptestConfig::with_cases(500) })]

    #[test]
    fn any_samples_in_any_order_leave_a_solution_that_is_one(
        start in 0usize..3,
        acts in prop::collection::vec(act(), 1..120),
    ) {
        let ready = if start == 1 { ready_wing() } else { ready_rotor() };
        let mut navigator = if start == 0 { crate::flight::navigator(&[]) } else { ready.navigator.clone() };
        let mut steps = ready.flight.steps[ready.from..].iter();
        let mut now = Simulation::ap_time(LOST_S);
        let mut masked = false;
        for act in &acts {
            match act {
                Act::Sample(sample, dt) => {
                    let time = now + Span::from_micros(*dt);
                    let sample = moved(sample, time - AutopilotTime::from_micros(0));
                    navigator.ingest(&sample);
                    // Stamps from the ends of time are one sample's, not the clock's.
                    if dt.unsigned_abs() < 1_000_000_000_000 {
                        now = time;
                    }
                }
                Act::Fly(n) => {
                    for step in steps.by_ref().take(*n) {
                        navigator.set_status(step.status);
                        for sample in step.samples.iter().filter(|s| !masked || s.kind() != SampleKind::Gnss) {
                            navigator.ingest(sample);
                            now = now.max(sample.time());
                        }
                    }
                }
                Act::Mask => {
                    masked = true;
                    navigator.mask_gnss(now);
                }
                Act::Reboot(for_s) => navigator.reboot(now, *for_s),
                Act::Origin([lat, lon, up]) => {
                    let place = Geodetic { latitude_rad: *lat, longitude_rad: *lon, height_m: *up };
                    navigator.set_origin(now, place);
                }
                Act::Date(year) => navigator.set_date(*year),
            }
            if let Some(s) = navigator.solution() {
                check_form(&s, "random samples");
            }
        }
    }
}
