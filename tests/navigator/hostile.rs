//! Whatever comes over the wire and in whatever order: the decoder and the navigator take it without a panic, and no solution is
//! ever anything but finite.

use std::sync::OnceLock;

use crate::command::{COPTER, Record, records};
use crate::sound::is_finite;
use holdover::config::{Settings, Sources};
use holdover::geo::{Body, Geodetic};
use holdover::navigator::Navigator;
use holdover::navigator::settings::NavigatorSettings;
use holdover::outbound::message::OutboundMessage;
use holdover::pipeline::{Pipeline, PipelineSettings};
use holdover::sample::{
    FlowRotation, FlowSample, GnssFix, GnssSample, GroundVelocity, ImuSample, MagSample, PressureSample,
    RangeDirection, RangeSample, Sample,
};
use holdover::time::{AutopilotTime, Span};
use holdover::wire::decode::Decoder;
use holdover::wire::frame::{ComponentId, Scan, SystemId, scan};
use holdover::wire::session::identity::{AutopilotKind, Vehicle};
use nalgebra::Vector3;
use proptest::prelude::*;

fn settings() -> PipelineSettings {
    Settings::load(&Sources::default()).unwrap().pipeline
}

fn navigator_settings() -> NavigatorSettings {
    settings().navigator
}

/// Real frames from the ground and from flight.
fn real() -> &'static [Record] {
    static REAL: OnceLock<Vec<Record>> = OnceLock::new();
    REAL.get_or_init(|| records(COPTER, 5.0, 75.0))
}

fn decoder() -> Decoder {
    let mut decoder = Decoder::new();
    decoder.follow(&Vehicle {
        system: SystemId(1),
        component: ComponentId::AUTOPILOT,
        autopilot: AutopilotKind::ArduPilot,
        vehicle_type: 2,
        armed: false,
        version: None,
    });
    decoder
}

/// Feeds frames through decoder, navigator and output; fails on anything that is not finite.
fn run(frames: impl Iterator<Item = Vec<u8>>) -> Pipeline {
    let mut decoder = decoder();
    let mut pipeline = Pipeline::new(&settings());
    let (mut items, mut out) = (Vec::new(), Vec::new());
    for bytes in frames {
        let (Scan::Frame(frame) | Scan::Unknown(frame)) = scan(&bytes, true) else { continue };
        decoder.decode(&frame, None, &mut items);
        for item in items.drain(..) {
            if let Some(solution) = pipeline.take(decoder.clock(), &item, &mut out) {
                assert!(is_finite(&solution), "{item:?} gave {solution:?}");
            }
        }
        for message in out.drain(..) {
            if let OutboundMessage::Odometry(o) = message {
                assert!(
                    o.position.raw().iter().chain(o.velocity.raw().iter()).all(|c| c.is_finite()),
                    "{o:?}"
                );
                assert!((o.attitude.quaternion().norm() - 1.0).abs() < 1e-6, "{o:?}");
            }
        }
    }
    pipeline
}

/// (which frame, where in its payload, what is put there)
fn edit() -> impl Strategy<Value = (prop::sample::Index, prop::sample::Index, [u8; 4])> {
    let words = prop_oneof![
        any::<[u8; 4]>(),
        prop::sample::select(vec![
            f32::NAN.to_le_bytes(),
            f32::INFINITY.to_le_bytes(),
            f32::MAX.to_le_bytes(),
            f32::MIN.to_le_bytes(),
            [0; 4],
            [0xFF; 4],
            i32::MAX.to_le_bytes(),
            i32::MIN.to_le_bytes(),
        ]),
    ];
    (any::<prop::sample::Index>(), any::<prop::sample::Index>(), words)
}

proptest! {
    #![proptest_config(ProptestConfig { cases: 24, max_shrink_iters: 200, failure_persistence: None, ..ProptestConfig::default() })]

    #[test]
    fn mutated_frames_of_a_real_flight(edits in prop::collection::vec(edit(), 1..400)) {
        let mut log = real().to_vec();
        for (which, at, word) in edits {
            let record = &mut log[which.index(real().len())];
            let payload = record.payload();
            let from = payload.start + 4 * at.index(payload.len().div_ceil(4));
            for (byte, new) in record.frame[from..payload.end].iter_mut().zip(word) {
                *byte = new;
            }
            record.seal();
        }
        run(log.into_iter().map(|r| r.frame));
    }

    #[test]
    fn frames_in_any_order(seed in any::<u64>(), swaps in prop::collection::vec((any::<prop::sample::Index>(), any::<prop::sample::Index>()), 0..2000)) {
        let mut log = real().to_vec();
        let n = log.len();
        log.rotate_left((seed % n as u64) as usize);
        for (a, b) in swaps {
            log.swap(a.index(n), b.index(n));
        }
        run(log.into_iter().map(|r| r.frame));
    }
}

/// A navigator that has flown for a while.
fn in_flight() -> &'static Navigator {
    static FLOWN: OnceLock<Navigator> = OnceLock::new();
    FLOWN.get_or_init(|| run(real().iter().map(|r| r.frame.clone())).navigator)
}

#[test]
fn the_flight_itself_navigates() {
    // What the other tests mutate does arrive somewhere when it is whole.
    let pipeline = run(real().iter().map(|r| r.frame.clone()));
    assert!(pipeline.navigator.gnss_latency_s().0.is_finite());
    assert_eq!(pipeline.navigator.mode().label(), "Aided");
}

#[test]
fn an_origin_at_the_other_end_of_the_world_is_refused() {
    let mut log = real().to_vec();
    let half = log.len() / 2;
    let origin = log.iter_mut().skip(half).find(|r| r.id() == 49).unwrap();
    let payload = origin.payload();
    origin.frame[payload.start..payload.start + 4].copy_from_slice(&(-338_000_000i32).to_le_bytes());
    origin.seal();
    let attacked = run(log.into_iter().map(|r| r.frame));
    let (attacked, whole) = (attacked.navigator.solution().unwrap(), in_flight().solution().unwrap());
    assert!((attacked.position - whole.position).raw().norm() < 1e-9, "{:?}", attacked.position);
}

proptest! {
    #![proptest_config(ProptestConfig { cases: 256, failure_persistence: None, ..ProptestConfig::default() })]

    #[test]
    fn arbitrary_payloads_of_every_message_of_interest(
        frames in prop::collection::vec((prop::sample::select(vec![
            2u32, 24, 26, 27, 29, 30, 31, 32, 33, 49, 74, 100, 105, 106, 108, 115, 116, 124, 129, 132, 137, 143, 149, 164, 173,
        ]), prop::collection::vec(any::<u8>(), 0..255)), 0..200),
    ) {
        run(frames.into_iter().map(|(id, payload)| {
            let mut record = Record { written_us: 0, frame: vec![0xFD, payload.len() as u8, 0, 0, 0, 1, 1] };
            record.frame.extend_from_slice(&id.to_le_bytes()[..3]);
            record.frame.extend_from_slice(&payload);
            record.frame.extend_from_slice(&[0, 0]);
            record.seal();
            record.frame
        }));
    }
}

/// Mostly sane, sometimes extreme, sometimes no number at all.
fn number(sane: f64) -> impl Strategy<Value = f64> {
    prop_oneof![
        20 => -sane..sane,
        1 => prop::sample::select(vec![
            0.0, f64::NAN, f64::INFINITY, f64::NEG_INFINITY, f64::MAX, f64::MIN, 1e300, -1e300, 1e30, -1e30, 1e-300,
        ]),
    ]
}

fn vector(sane: f64) -> impl Strategy<Value = Vector3<f64>> {
    (number(sane), number(sane), number(sane)).prop_map(|(x, y, z)| Vector3::new(x, y, z))
}

/// Where the next sample stands after the last, ms: mostly onwards, sometimes far, sometimes back.
fn step() -> impl Strategy<Value = i64> {
    prop_oneof![20 => 0i64..30, 2 => -500i64..500, 1 => any::<i64>().prop_map(|v| v / 1_000_000)]
}

fn gnss() -> impl Strategy<Value = Sample> {
    let place = prop_oneof![
        10 => (47.8999f64..47.9001, 15.0999f64..15.1001, 250.0f64..350.0),
        1 => (-90.0f64..90.0, -180.0f64..180.0, -1000.0f64..60_000.0),
    ];
    let fix = prop::sample::select(vec![
        GnssFix::None,
        GnssFix::TwoD,
        GnssFix::ThreeD,
        GnssFix::ThreeD,
        GnssFix::Corrected,
    ]);
    let velocity = prop::option::of((number(30.0), number(7.0)));
    let accuracy = prop::option::of(number(5.0));
    (place, fix, velocity, accuracy, 0u8..2, prop::option::of(0u8..30)).prop_map(
        |((lat, lon, h), fix, velocity, accuracy, receiver, satellites)| {
            Sample::Gnss(GnssSample {
                time: AutopilotTime::from_micros(0),
                receiver,
                fix,
                position: (fix > GnssFix::None).then(|| Geodetic::from_degrees(lat, lon, h)),
                ground_velocity: velocity
                    .map(|(speed_mps, course_rad)| GroundVelocity { speed_mps, course_rad }),
                horizontal_accuracy_m: accuracy,
                vertical_accuracy_m: accuracy,
                speed_accuracy_mps: accuracy,
                satellites,
                warning: None,
            })
        },
    )
}

fn sample() -> impl Strategy<Value = Sample> {
    let time = AutopilotTime::from_micros(0);
    prop_oneof![
        10 => (vector(0.5), vector(3.0)).prop_map(move |(rate, f)| Sample::Imu(ImuSample {
            time, angular_rate: Body::new(rate), specific_force: Body::new(f - Vector3::z() * 9.8),
        })),
        3 => (vector(2e-5), 0u8..2).prop_map(move |(b, sensor)| Sample::Mag(MagSample {
            time, sensor, field: Body::new(b + Vector3::new(2e-5, 0.0, 4e-5)),
        })),
        3 => gnss(),
        2 => (number(5e3), 0u8..3).prop_map(move |(p, sensor)| Sample::Pressure(PressureSample {
            time, sensor, pressure_pa: 9.6e4 + p,
        })),
        2 => (number(2.0), number(2.0), number(1.0), prop::option::of(number(30.0)), 0i64..200_000, 0u8..12, any::<bool>())
            .prop_map(move |(x, y, quality, distance_m, us, sensor, removed)| Sample::Flow(FlowSample {
                time, sensor, interval: Span::from_micros(us), rate_xy: [x, y],
                rotation: if removed { FlowRotation::Removed } else { FlowRotation::SensorGyro([y, x]) },
                quality, distance_m,
            })),
        2 => (number(40.0), number(50.0)).prop_map(move |(d, limit)| Sample::Range(RangeSample {
            time, sensor: 0, direction: RangeDirection::Down, distance_m: d.abs(), limits_m: Some([0.1, limit]),
        })),
    ]
}

fn at(mut sample: Sample, stamp: AutopilotTime) -> Sample {
    match &mut sample {
        Sample::Imu(s) => s.time = stamp,
        Sample::Mag(s) => s.time = stamp,
        Sample::Gnss(s) => s.time = stamp,
        Sample::Pressure(s) => s.time = stamp,
        Sample::Flow(s) => s.time = stamp,
        Sample::Range(s) => s.time = stamp,
        Sample::Airspeed(s) => s.time = stamp,
        Sample::Landmark(s) => s.time = stamp,
    }
    sample
}

proptest! {
    #![proptest_config(ProptestConfig { cases: 128, max_shrink_iters: 2000, failure_persistence: None, ..ProptestConfig::default() })]

    #[test]
    fn random_samples_in_random_order(
        flying in any::<bool>(),
        samples in prop::collection::vec((step(), sample()), 1..1500),
    ) {
        let mut navigator = if flying { in_flight().clone() } else { Navigator::new(navigator_settings()) };
        let mut ms = navigator.solution().map_or(0, |s| s.time.micros() / 1000);
        for (step, sample) in samples {
            ms = ms.saturating_add(step);
            let sample = at(sample, AutopilotTime::from_micros(ms.saturating_mul(1000)));
            navigator.ingest(&sample);
            if let Some(solution) = navigator.solution() {
                prop_assert!(is_finite(&solution), "{:?} gave {:?}", sample, solution);
            }
            navigator.drain_events().for_each(drop);
        }
    }
}
