//! A recorded flight with frames in it that are not the autopilot's, and on another clock: what is sent stays what it was.

use std::sync::OnceLock;

use crate::command::{COPTER, Record, records};
use holdover::config::{Settings, Sources};
use holdover::outbound::Publish;
use holdover::outbound::message::{Odometry, OutboundMessage};
use holdover::pipeline::Pipeline;
use holdover::time::Stamp;
use holdover::wire::counters::Counters;
use holdover::wire::decode::Decoder;
use holdover::wire::frame::{ComponentId, Scan, SystemId, scan};
use holdover::wire::session::Address;
use holdover::wire::session::identity::{AutopilotKind, Vehicle};
use holdover::wire::session::outgoing::FrameWriter;
use mavlink::dialects::ardupilotmega::{self as apm, MavMessage};

/// When GNSS is lost, and when what is forged comes: in flight. Seconds of the log.
const LOST_S: f64 = 62.0;
const FORGED_S: f64 = 70.0;
const END_S: f64 = 85.0;

fn real() -> &'static [Record] {
    static REAL: OnceLock<Vec<Record>> = OnceLock::new();
    REAL.get_or_init(|| records(COPTER, 5.0, END_S))
}

/// What came of a flight.
struct Flown {
    sent: Vec<Odometry>,
    reboots: u32,
    rejected: Counters,
    contradicted: usize,
}

fn fly(log: &[Record]) -> Flown {
    let mut settings = Settings::load(&Sources::default()).unwrap().pipeline;
    settings.outbound.publish = Publish::Always;
    let mut decoder = Decoder::new();
    let vehicle = Vehicle {
        system: SystemId(1),
        component: ComponentId::AUTOPILOT,
        autopilot: AutopilotKind::ArduPilot,
        vehicle_type: 2,
        armed: false,
        version: None,
    };
    decoder.follow(&vehicle);
    let mut pipeline = Pipeline::new(&settings);
    pipeline.follow(&vehicle);
    let (mut items, mut out, mut sent) = (Vec::new(), Vec::new(), Vec::new());
    let mut contradicted = 0;
    for record in log {
        let (Scan::Frame(frame) | Scan::Unknown(frame)) = scan(&record.frame, true) else { continue };
        let at = Stamp::from_micros(i64::try_from(record.written_us).unwrap());
        decoder.decode(&frame, Some(at), &mut items);
        for item in items.drain(..) {
            pipeline.take(decoder.clock(), &item, &mut out);
        }
        sent.extend(out.drain(..).filter_map(|m| match m {
            OutboundMessage::Odometry(o) => Some(o),
            _ => None,
        }));
        let code = |e: &holdover::navigator::event::Event| e.kind.code() == "origin-contradicted";
        contradicted += pipeline.navigator.drain_events().filter(code).count();
    }
    let (reboots, rejected) = (decoder.clock().reboots(), decoder.counters().clone());
    Flown { sent, reboots, rejected, contradicted }
}

fn index_at(log: &[Record], seconds: f64) -> usize {
    let begun = log[0].written_us;
    let at = (seconds * 1e6) as u64;
    log.iter().position(|r| r.written_us - begun >= at).unwrap()
}

/// The flight with these messages in it, as if the autopilot had sent them, one after the other at the same moment.
fn with(log: &[Record], forged: &[MavMessage]) -> Vec<Record> {
    let mut writer = FrameWriter::new(Address { system: SystemId(1), component: ComponentId::AUTOPILOT });
    let at = index_at(log, FORGED_S - 5.0);
    let written_us = log[at].written_us;
    let record = |m: &MavMessage| Record { written_us, frame: writer.write(m).unwrap().to_vec() };
    let forged: Vec<Record> = forged.iter().map(record).collect();
    [&log[..at], &forged, &log[at..]].concat()
}

/// The flight without GNSS from [`LOST_S`] on.
fn in_an_outage() -> Vec<Record> {
    let lost = index_at(real(), LOST_S - 5.0);
    let kept = |(i, r): &(usize, &Record)| *i < lost || r.id() != 24;
    real().iter().enumerate().filter(kept).map(|(_, r)| r.clone()).collect()
}

fn same(attacked: &Flown, whole: &Flown) {
    assert_eq!(attacked.sent.len(), whole.sent.len());
    assert!(whole.sent.len() > 1000, "{}", whole.sent.len());
    for (a, w) in attacked.sent.iter().zip(&whole.sent) {
        assert_eq!(
            (a.position, a.attitude, a.quality, a.reset_counter),
            (w.position, w.attitude, w.quality, w.reset_counter)
        );
    }
}

#[test]
fn an_origin_in_one_frame_moves_nothing_that_is_sent() {
    for log in [real().to_vec(), in_an_outage()] {
        let whole = fly(&log);
        // 5 m, 1 km and 90 km from where it is.
        let told = log.iter().find(|r| r.id() == 49).unwrap();
        let (Scan::Frame(frame) | Scan::Unknown(frame)) = scan(&told.frame, true) else { panic!() };
        let Ok(MavMessage::GPS_GLOBAL_ORIGIN(origin)) = frame.parse() else { panic!() };
        for north_e7 in [450, 90_000, 8_100_000] {
            let mut forged = origin.clone();
            forged.latitude += north_e7;
            let attacked = fly(&with(&log, &[MavMessage::GPS_GLOBAL_ORIGIN(forged)]));
            same(&attacked, &whole);
            assert_eq!(attacked.contradicted, 1);
        }
    }
}

/// An IMU's message with a stamp.
fn imu(us: u64) -> MavMessage {
    MavMessage::RAW_IMU(apm::RAW_IMU_DATA { time_usec: us, zacc: -1000, ..Default::default() })
}

fn system_time(ms: u32) -> MavMessage {
    MavMessage::SYSTEM_TIME(apm::SYSTEM_TIME_DATA { time_unix_usec: 1_700_000_000_000_000, time_boot_ms: ms })
}

#[test]
fn a_burst_of_stamps_in_an_outage_makes_nobody_silent() {
    let log = in_an_outage();
    let whole = fly(&log);
    let burst = |from_ms: u32| -> Vec<MavMessage> {
        (0..100)
            .flat_map(|n| [imu(u64::from(from_ms + n * 10) * 1000), system_time(from_ms + n * 10)])
            .collect()
    };
    for from_ms in [100, 20_000, 4_000_000] {
        let attacked = fly(&with(&log, &burst(from_ms)));
        same(&attacked, &whole);
        assert_eq!(attacked.reboots, 0);
    }
}

#[test]
fn a_heartbeat_of_another_vehicle_changes_nothing() {
    let log = in_an_outage();
    let whole = fly(&log);
    let beat = |mavtype, autopilot| {
        MavMessage::HEARTBEAT(apm::HEARTBEAT_DATA {
            custom_mode: 0,
            mavtype,
            autopilot,
            base_mode: apm::MavModeFlag::empty(),
            system_status: apm::MavState::MAV_STATE_ACTIVE,
            mavlink_version: 3,
        })
    };
    let wing = beat(apm::MavType::MAV_TYPE_FIXED_WING, apm::MavAutopilot::MAV_AUTOPILOT_ARDUPILOTMEGA);
    let px4 = beat(apm::MavType::MAV_TYPE_QUADROTOR, apm::MavAutopilot::MAV_AUTOPILOT_PX4);
    let attacked = fly(&with(&log, &[wing, px4.clone(), px4]));
    same(&attacked, &whole);
    assert_eq!(attacked.rejected.of(holdover::wire::counters::Cause::Unconfirmed), 3);
}

/// The same frame of an autopilot that booted so much earlier.
fn earlier(record: &Record, by_us: u64) -> Record {
    let (Scan::Frame(frame) | Scan::Unknown(frame)) = scan(&record.frame, true) else {
        return record.clone();
    };
    let Ok(mut message) = frame.parse() else { return record.clone() };
    let by_ms = (by_us / 1000) as u32;
    let ms = |t: &mut u32| *t = t.wrapping_add(by_ms);
    match &mut message {
        MavMessage::SYSTEM_TIME(m) => ms(&mut m.time_boot_ms),
        MavMessage::SCALED_IMU2(m) => ms(&mut m.time_boot_ms),
        MavMessage::SCALED_IMU3(m) => ms(&mut m.time_boot_ms),
        MavMessage::SCALED_PRESSURE(m) => ms(&mut m.time_boot_ms),
        MavMessage::SCALED_PRESSURE2(m) => ms(&mut m.time_boot_ms),
        MavMessage::ATTITUDE(m) => ms(&mut m.time_boot_ms),
        MavMessage::ATTITUDE_QUATERNION(m) => ms(&mut m.time_boot_ms),
        MavMessage::LOCAL_POSITION_NED(m) => ms(&mut m.time_boot_ms),
        MavMessage::GLOBAL_POSITION_INT(m) => ms(&mut m.time_boot_ms),
        MavMessage::DISTANCE_SENSOR(m) => ms(&mut m.time_boot_ms),
        MavMessage::RAW_IMU(m) => m.time_usec += by_us,
        MavMessage::HIGHRES_IMU(m) => m.time_usec += by_us,
        // Where it is not counted from 1970.
        MavMessage::GPS_RAW_INT(m) if (1..1_000_000_000_000_000).contains(&m.time_usec) => {
            m.time_usec += by_us
        }
        // ArduPilot's are milliseconds of 32 bits.
        MavMessage::OPTICAL_FLOW(m) => m.time_usec = u64::from((m.time_usec as u32).wrapping_add(by_ms)),
        _ => return record.clone(),
    }
    let from = Address { system: frame.system(), component: frame.component() };
    let mut bytes = FrameWriter::new(from).write(&message).unwrap().to_vec();
    if bytes[0] == 0xFD {
        bytes[4] = frame.sequence();
    }
    let mut record = Record { written_us: record.written_us, frame: bytes };
    record.seal();
    record
}

#[test]
fn a_flight_in_which_milliseconds_wrap_is_the_same_flight() {
    let whole = fly(real());
    let flow = |r: &Record| r.id() == 100;
    assert!(real().iter().filter(|r| flow(r)).count() > 100);
    // 2^32 ms are over in flight; were over before; are over at the end, and many times.
    let first_ms = 5000;
    for boot_ms in [(1 << 32) - 60_000, (1u64 << 32) + first_ms, 3 * (1 << 32) - 80_000] {
        let log: Vec<Record> = real().iter().map(|r| earlier(r, boot_ms * 1000)).collect();
        let wrapped = fly(&log);
        same(&wrapped, &whole);
        assert_eq!((wrapped.reboots, &wrapped.rejected), (0, &whole.rejected), "{boot_ms}");
    }
}
