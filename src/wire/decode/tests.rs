//! Messages as autopilots really fill them.

use mavlink::dialects::ardupilotmega::{self as apm, MavMessage};
use nalgebra::Vector3;

use super::*;
use crate::sample::{FlowRotation, FlowSample, Sample};
use crate::wire::session::heartbeat_fields::testing::frame_of;

/// A vehicle whose decoder is told of messages, with the time of the autopilot, ms.
struct TestVehicle {
    decoder: Decoder,
    ms: u32,
}

impl TestVehicle {
    fn new(autopilot: AutopilotKind) -> Self {
        let mut decoder = Decoder::new();
        decoder.follow(&Vehicle {
            system: SystemId(1),
            component: ComponentId(1),
            autopilot,
            vehicle_type: 2,
            armed: false,
            version: None,
        });
        Self { decoder, ms: 100_000 }
    }

    fn hear(&mut self, component: u8, message: &MavMessage) -> Vec<Sample> {
        let mut out = Vec::new();
        self.decoder.decode(&frame_of(1, component, message).frame().unwrap(), None, &mut out);
        out.into_iter()
            .filter_map(|input| match input {
                Input::Sample(sample) => Some(sample),
                _ => None,
            })
            .collect()
    }

    /// Time goes on by `ms`, as the IMU tells.
    fn wait(&mut self, ms: u32) -> Vec<Sample> {
        self.ms += ms;
        let imu = imu(self.ms, Vector3::new(0.2, -0.03, 0.42));
        self.hear(1, &imu)
    }
}

fn imu(ms: u32, gauss: Vector3<f32>) -> MavMessage {
    MavMessage::HIGHRES_IMU(apm::HIGHRES_IMU_DATA {
        time_usec: u64::from(ms) * 1000,
        xacc: 0.01,
        yacc: 0.02,
        zacc: -9.8,
        xgyro: 0.0,
        ygyro: 0.0,
        zgyro: 0.001,
        xmag: gauss.x,
        ymag: gauss.y,
        zmag: gauss.z,
        abs_pressure: 0.0,
        diff_pressure: 0.0,
        pressure_alt: 0.0,
        temperature: 20.0,
        fields_updated: apm::HighresImuUpdatedFlags::HIGHRES_IMU_UPDATED_XMAG,
        id: 0,
    })
}

/// A fix with the stamp `time_usec`, `north` steps of 1 cm from the first.
fn fix(time_usec: u64, north: i32) -> MavMessage {
    MavMessage::GPS_RAW_INT(apm::GPS_RAW_INT_DATA {
        time_usec,
        fix_type: apm::GpsFixType::GPS_FIX_TYPE_3D_FIX,
        lat: 473_977_420 + north,
        lon: 85_455_940,
        alt: 488_000,
        eph: 100,
        epv: 100,
        vel: 10,
        cog: 0,
        satellites_visible: 12,
        alt_ellipsoid: 0,
        h_acc: 500,
        v_acc: 800,
        vel_acc: 100,
        hdg_acc: 0,
        yaw: 0,
    })
}

/// A flow of the sensor 0: its own gyro taken out, rad/s.
fn flow(ms: u32, rate: f32) -> MavMessage {
    MavMessage::OPTICAL_FLOW(apm::OPTICAL_FLOW_DATA {
        time_usec: u64::from(ms) * 1000,
        sensor_id: 0,
        flow_x: 0,
        flow_y: 0,
        flow_comp_m_x: rate,
        flow_comp_m_y: 0.0,
        quality: 200,
        ground_distance: -1.0,
        flow_rate_x: rate,
        flow_rate_y: 0.0,
    })
}

fn repaired(decoder: &Decoder, label: &str) -> u64 {
    decoder.repairs().seen().filter(|(r, _)| r.label() == label).map(|(_, n)| n).sum()
}

/// Fixes every 200 ms for 4 s, each with the stamp that `stamp` makes of the time, ms; the times of those that were taken, less the
/// time of their message.
fn ages(stamp: impl Fn(u32) -> u64) -> (Vec<i64>, Decoder) {
    let mut vehicle = TestVehicle::new(AutopilotKind::Px4);
    let mut ages = Vec::new();
    for k in 0..20 {
        (0..20).for_each(|_| drop(vehicle.wait(10)));
        let fix = fix(stamp(vehicle.ms), k);
        for sample in vehicle.hear(1, &fix) {
            ages.push((AutopilotTime::from_micros(i64::from(vehicle.ms) * 1000) - sample.time()).micros());
        }
    }
    (ages, vehicle.decoder)
}

#[test]
fn fixes_without_a_stamp_of_the_autopilots_clock_are_stamped_by_arrival() {
    type Stamped = (&'static str, fn(u32) -> u64);
    let stamps: [Stamped; 4] = [
        ("missing", |_| 0),
        ("1970, and no SYSTEM_TIME", |ms| 1_790_000_000_000_000 + u64::from(ms) * 1000),
        ("another clock", |ms| u64::from(ms) * 1000 - 90_000_000),
        ("milliseconds of another clock", |ms| u64::from(ms) + 7_000_000),
    ];
    for (what, stamp) in stamps {
        let (ages, mut decoder) = ages(stamp);
        assert_eq!(ages, [0; 20], "{what}");
        assert_eq!(repaired(&decoder, Repair::GnssByArrival.label()), 20, "{what}");
        assert_eq!(decoder.take_repair_news(), Some(Repair::GnssByArrival), "{what}");
        assert_eq!(decoder.counters().seen().count(), 0, "{what}: {:?}", decoder.counters());
        assert_eq!(decoder.clock().reboots(), 0, "{what}");
    }
}

#[test]
fn a_stamp_that_stays_the_same_is_found_out() {
    let (ages, decoder) = ages(|_| 100_150_000);
    // Until then it could be right.
    assert_eq!(ages.len(), 20);
    assert!(ages[..5].iter().all(|age| *age > 0) && ages[9..].iter().all(|age| *age == 0), "{ages:?}");
    assert!(repaired(&decoder, Repair::GnssByArrival.label()) >= 10);
}

#[test]
fn good_stamps_are_taken_and_a_fix_that_is_sent_twice_is_one() {
    let (ages, decoder) = ages(|ms| u64::from(ms) * 1000 - 120_000);
    assert_eq!((ages, decoder.repairs().seen().count()), (vec![120_000; 20], 0));

    let mut vehicle = TestVehicle::new(AutopilotKind::ArduPilot);
    let mut taken = 0;
    for k in 0..20u32 {
        vehicle.wait(100);
        // A receiver of 5 Hz, sent at 10 Hz.
        let reading = k / 2;
        let stamp = 100_000_000 + u64::from(reading) * 200_000;
        taken += vehicle.hear(1, &fix(stamp, reading.cast_signed())).len();
    }
    assert_eq!((taken, repaired(&vehicle.decoder, Repair::GnssRepeated.label())), (10, 10));
}

#[test]
fn a_field_in_milligauss_times_1000_is_put_right() {
    let mut vehicle = TestVehicle::new(AutopilotKind::ArduPilot);
    let mut fields = Vec::new();
    for _ in 0..100 {
        vehicle.ms += 5;
        let imu = imu(vehicle.ms, Vector3::new(200_000.0, -30_000.0, 420_000.0));
        fields.extend(vehicle.hear(1, &imu).into_iter().filter_map(|s| match s {
            Sample::Mag(m) => Some(m.field.raw()),
            _ => None,
        }));
    }
    assert_eq!(fields.len(), 81);
    assert!(fields.iter().all(|f| (f - Vector3::new(20e-6, -3e-6, 42e-6)).norm() < 1e-9), "{:?}", fields[0]);
    assert_eq!(vehicle.decoder.take_repair_news(), Some(Repair::FieldUnit(6)));
}

#[test]
fn an_imu_that_is_not_there_is_no_fault() {
    let mut vehicle = TestVehicle::new(AutopilotKind::ArduPilot);
    vehicle.wait(10);
    let data = apm::SCALED_IMU3_DATA {
        time_boot_ms: vehicle.ms,
        xacc: 0,
        yacc: 0,
        zacc: 0,
        xgyro: 0,
        ygyro: 0,
        zgyro: 0,
        xmag: 0,
        ymag: 0,
        zmag: 0,
        temperature: 0,
    };
    assert!(vehicle.hear(1, &MavMessage::SCALED_IMU3(data)).is_empty());
    assert_eq!(vehicle.decoder.counters().seen().count(), 0);
}

#[test]
fn a_flow_that_is_sent_several_times_is_used_once() {
    let mut vehicle = TestVehicle::new(AutopilotKind::ArduPilot);
    let mut flows = Vec::new();
    for k in 0..100u32 {
        vehicle.wait(20);
        // A sensor of 20 Hz, sent at 50 Hz with new stamps.
        let rate = (k * 20 / 50) as f32 * 1e-3;
        flows.extend(vehicle.hear(1, &flow(vehicle.ms, rate)));
    }
    assert_eq!((flows.len(), repaired(&vehicle.decoder, Repair::FlowRepeated.label())), (40, 60));
    let intervals = flows[2..].iter().map(|s| match s {
        Sample::Flow(f) => f.interval.micros() / 1000,
        other => panic!("{other:?}"),
    });
    assert!(intervals.clone().all(|ms| ms == 40 || ms == 60), "{:?}", intervals.collect::<Vec<_>>());
    // At rest the flow is zero for a while: that is a measurement, and not fifty a second.
    let rest: usize = (0..50)
        .map(|_| {
            vehicle.wait(20);
            let still = flow(vehicle.ms, 0.0);
            vehicle.hear(1, &still).len()
        })
        .sum();
    assert!((8..=11).contains(&rest), "{rest}");
}

#[test]
fn sensors_of_other_components_are_heard_while_the_autopilot_does_not_tell_of_them() {
    let camera = 100;
    let mut vehicle = TestVehicle::new(AutopilotKind::Px4);
    vehicle.wait(10);
    let heard = vehicle.hear(camera, &flow(vehicle.ms - 3, 0.1));
    let Some(Sample::Flow(first)) = heard.first() else { panic!("{heard:?}") };
    assert_eq!(first.time.micros(), i64::from(vehicle.ms - 3) * 1000);
    // On its own clock.
    vehicle.wait(50);
    let own_clock = vehicle.hear(camera, &flow(5_000, 0.2));
    assert_eq!(own_clock.first().map(|s| s.time().micros()), Some(i64::from(vehicle.ms) * 1000));
    assert_eq!(repaired(&vehicle.decoder, Repair::ForeignByArrival.label()), 1);
    // PX4 sends it out again.
    vehicle.wait(50);
    assert_eq!(vehicle.hear(1, &flow(vehicle.ms, 0.3)).len(), 1);
    vehicle.wait(50);
    assert!(vehicle.hear(camera, &flow(vehicle.ms, 0.4)).is_empty());
    vehicle.wait(1500);
    assert_eq!(vehicle.hear(camera, &flow(vehicle.ms, 0.5)).len(), 1);
    // The IMU of a camera is not the vehicle's.
    assert!(vehicle.hear(camera, &imu(vehicle.ms, Vector3::zeros())).is_empty());
}

/// An OPTICAL_FLOW with these fields: pixels, velocities, rates, distance.
fn flow_of(ms: u32, pixels: [i16; 2], comp: [f32; 2], rate: [f32; 2], distance: f32) -> MavMessage {
    let MavMessage::OPTICAL_FLOW(zero) = flow(ms, 0.0) else { unreachable!() };
    MavMessage::OPTICAL_FLOW(apm::OPTICAL_FLOW_DATA {
        flow_x: pixels[0],
        flow_y: pixels[1],
        flow_comp_m_x: comp[0],
        flow_comp_m_y: comp[1],
        flow_rate_x: rate[0],
        flow_rate_y: rate[1],
        ground_distance: distance,
        ..zero
    })
}

fn flows(samples: Vec<Sample>) -> Vec<FlowSample> {
    let of = |s| if let Sample::Flow(f) = s { Some(f) } else { None };
    samples.into_iter().filter_map(of).collect()
}

#[test]
fn a_flow_in_pixels_only_is_their_sum_over_the_time_since_the_last_and_keeps_its_unit() {
    for autopilot in [AutopilotKind::Px4, AutopilotKind::ArduPilot] {
        let mut vehicle = TestVehicle::new(autopilot);
        let mut heard = Vec::new();
        for k in 0..10 {
            vehicle.wait(50);
            // Every reading is sent twice; a reading of nothing is one as well.
            let pixels = if k == 5 { [0, 0] } else { [100 + k, -20] };
            for _ in 0..2 {
                vehicle.wait(50);
                let message = flow_of(vehicle.ms, pixels, [0.0; 2], [0.0; 2], -1.0);
                heard.extend(flows(vehicle.hear(1, &message)));
            }
        }
        assert_eq!(heard.len(), 9, "{autopilot:?}");
        assert!(heard.iter().all(|f| f.rotation == FlowRotation::InOwnUnit), "{autopilot:?}");
        // 10.1 and 2 pixels in 0.15 s: along x they are seen where the camera turns about y.
        let f = &heard[0];
        assert!(
            (f.rate_xy[0] + 2.0 / 0.15).abs() < 1e-9 && (f.rate_xy[1] + 10.1 / 0.15).abs() < 1e-9,
            "{f:?}"
        );
        assert_eq!(heard[4].rate_xy, [0.0, 0.0], "{autopilot:?}");
    }
}

#[test]
fn a_flow_as_velocity_only_stands_on_the_distance_that_comes_with_it() {
    let mut vehicle = TestVehicle::new(AutopilotKind::Px4);
    vehicle.wait(50);
    let message = flow_of(vehicle.ms, [0, 0], [2.0, -1.0], [0.0; 2], 4.0);
    let [f] = flows(vehicle.hear(1, &message))[..] else { panic!() };
    assert_eq!((f.rate_xy, f.rotation), ([0.25, 0.5], FlowRotation::Removed));
    vehicle.wait(50);
    let message = flow_of(vehicle.ms, [0, 0], [2.0, -1.0], [0.0; 2], -1.0);
    assert!(flows(vehicle.hear(1, &message)).is_empty());
    let counted = vehicle.decoder.counters().of(Cause::NoDistance);
    assert_eq!(counted, 1);
}

#[test]
fn landings_are_told_beside_what_the_heartbeat_says() {
    let mut vehicle = TestVehicle::new(AutopilotKind::Px4);
    let mut statuses = Vec::new();
    for state in [
        apm::MavLandedState::MAV_LANDED_STATE_ON_GROUND,
        apm::MavLandedState::MAV_LANDED_STATE_UNDEFINED,
        apm::MavLandedState::MAV_LANDED_STATE_TAKEOFF,
        apm::MavLandedState::MAV_LANDED_STATE_IN_AIR,
        apm::MavLandedState::MAV_LANDED_STATE_LANDING,
        apm::MavLandedState::MAV_LANDED_STATE_ON_GROUND,
    ] {
        let message = MavMessage::EXTENDED_SYS_STATE(apm::EXTENDED_SYS_STATE_DATA {
            vtol_state: apm::MavVtolState::MAV_VTOL_STATE_UNDEFINED,
            landed_state: state,
        });
        let mut out = Vec::new();
        vehicle.decoder.decode(&frame_of(1, 1, &message).frame().unwrap(), None, &mut out);
        // Of another component it is not the autopilot's word.
        vehicle.decoder.decode(&frame_of(1, 42, &message).frame().unwrap(), None, &mut out);
        statuses.extend(out);
    }
    let landed: Vec<_> =
        statuses.iter().map(|i| if let Input::Status(s) = i { s.landed } else { None }).collect();
    assert_eq!(landed, [Some(true), Some(false), Some(true)]);
}

#[test]
fn speed_controllers_tell_of_four_rotors_at_a_time() {
    let word = |message: &MavMessage| RotorWord::of(&frame_of(1, 1, message).frame().unwrap());
    let of_status = MavMessage::ESC_STATUS(apm::ESC_STATUS_DATA {
        index: 4,
        time_usec: 1,
        rpm: [3000, -3100, 0, 7],
        voltage: [0.0; 4],
        current: [0.0; 4],
    });
    assert_eq!(word(&of_status), Some(RotorWord { first: 4, rpm: [3000.0, -3100.0, 0.0, 7.0] }));
    let of_telemetry = MavMessage::ESC_TELEMETRY_5_TO_8(apm::ESC_TELEMETRY_5_TO_8_DATA {
        temperature: [0; 4],
        voltage: [0; 4],
        current: [0; 4],
        totalcurrent: [0; 4],
        rpm: [1, 2, 3, 65_535],
        count: [0; 4],
    });
    assert_eq!(word(&of_telemetry), Some(RotorWord { first: 4, rpm: [1.0, 2.0, 3.0, 65_535.0] }));
    assert_eq!(word(&imu(1, Vector3::zeros())), None);
}
