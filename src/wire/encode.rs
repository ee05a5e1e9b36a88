//! [`OutboundMessage`] to MAVLink: the fields, frames and units of the wire.
//!
//! Stamps are the autopilot's own boot clock, the clock that its TIMESYNC questions are answered with, so that there is one time
//! base on the link. A message that holds a number which is not finite, or an attitude that is no rotation, is not made at all:
//! ArduPilot tests one covariance for NaN and trusts the rest.

use mavlink::dialects::ardupilotmega::{
    MavEstimatorType, MavFrame, MavMessage, ODOMETRY_DATA, VISION_POSITION_ESTIMATE_DATA,
    VISION_SPEED_ESTIMATE_DATA,
};
use nalgebra::{Matrix3, Vector3};

use crate::geo::{BodyToNed, Euler};
use crate::outbound::message::{Odometry, OutboundMessage, PoseFrame, VisionPosition};
use crate::time::AutopilotTime;

use super::clock::AutopilotClock;

/// How far the norm of a sent quaternion may be from 1. PX4 drops the attitude silently beyond 1e-5.
const NORM_TOLERANCE: f32 = 1e-6;

/// The message as MAVLink, stamped with the boot time of `clock`'s autopilot. `None` if a number in it is not finite (also not
/// as a 32-bit float), the attitude is no rotation, or the time lies before the autopilot's boot.
pub fn encode(message: &OutboundMessage, clock: &AutopilotClock) -> Option<MavMessage> {
    match message {
        OutboundMessage::Odometry(o) => odometry(o, clock),
        OutboundMessage::VisionPosition(v) => vision_position(v, clock),
        OutboundMessage::VisionSpeed { time, velocity, covariance, reset_counter } => {
            let [x, y, z] = triple(&velocity.raw())?;
            Some(MavMessage::VISION_SPEED_ESTIMATE(VISION_SPEED_ESTIMATE_DATA {
                usec: boot_usec(*time, clock)?,
                x,
                y,
                z,
                covariance: row_major(&covariance.raw())?,
                reset_counter: *reset_counter,
            }))
        }
    }
}

fn odometry(o: &Odometry, clock: &AutopilotClock) -> Option<MavMessage> {
    let [x, y, z] = triple(&o.position.raw())?;
    let [vx, vy, vz] = triple(&o.velocity.raw())?;
    let [rollspeed, pitchspeed, yawspeed] = triple(&o.angular_rate.raw())?;
    Some(MavMessage::ODOMETRY(ODOMETRY_DATA {
        time_usec: boot_usec(o.time, clock)?,
        x,
        y,
        z,
        q: unit(&o.attitude)?,
        vx,
        vy,
        vz,
        rollspeed,
        pitchspeed,
        yawspeed,
        pose_covariance: floats(&o.pose_covariance)?,
        velocity_covariance: floats(&o.velocity_covariance)?,
        frame_id: match o.frame {
            PoseFrame::LocalFrd => MavFrame::MAV_FRAME_LOCAL_FRD,
            PoseFrame::LocalNed => MavFrame::MAV_FRAME_LOCAL_NED,
        },
        child_frame_id: MavFrame::MAV_FRAME_BODY_FRD,
        reset_counter: o.reset_counter,
        // PX4 refuses GPS_INS and AUTOPILOT, and drops the covariance of NAIVE.
        estimator_type: MavEstimatorType::MAV_ESTIMATOR_TYPE_VIO,
        quality: o.quality,
    }))
}

fn vision_position(v: &VisionPosition, clock: &AutopilotClock) -> Option<MavMessage> {
    let [x, y, z] = triple(&v.position.raw())?;
    let euler = Euler::from_rotation(v.attitude.matrix());
    let [roll, pitch, yaw] = triple(&Vector3::new(euler.roll_rad, euler.pitch_rad, euler.yaw_rad))?;
    Some(MavMessage::VISION_POSITION_ESTIMATE(VISION_POSITION_ESTIMATE_DATA {
        usec: boot_usec(v.time, clock)?,
        x,
        y,
        z,
        roll,
        pitch,
        yaw,
        covariance: floats(&v.pose_covariance)?,
        reset_counter: v.reset_counter,
    }))
}

fn boot_usec(time: AutopilotTime, clock: &AutopilotClock) -> Option<u64> {
    u64::try_from(clock.boot_micros(time)).ok()
}

pub(super) fn float(v: f64) -> Option<f32> {
    let f = v as f32;
    f.is_finite().then_some(f)
}

fn floats<const N: usize>(values: &[f64; N]) -> Option<[f32; N]> {
    let out = values.map(|v| v as f32);
    out.iter().all(|v| v.is_finite()).then_some(out)
}

pub(super) fn triple(v: &Vector3<f64>) -> Option<[f32; 3]> {
    Some([float(v.x)?, float(v.y)?, float(v.z)?])
}

fn row_major(m: &Matrix3<f64>) -> Option<[f32; 9]> {
    // nalgebra stores columns; the matrix is symmetric, but a rounding difference must not depend on that.
    let t = m.transpose();
    let mut out = [0.0; 9];
    for (to, from) in out.iter_mut().zip(t.iter()) {
        *to = float(*from)?;
    }
    Some(out)
}

/// [w, x, y, z] with a norm of 1 as 32-bit floats.
fn unit(attitude: &BodyToNed) -> Option<[f32; 4]> {
    let q = attitude.quaternion();
    let norm = q.norm();
    if !norm.is_finite() || (norm - 1.0).abs() > 0.01 {
        return None;
    }
    let out = [q.w, q.i, q.j, q.k].map(|c| (c / norm) as f32);
    let rounded = out.iter().map(|c| c * c).sum::<f32>().sqrt();
    ((rounded - 1.0).abs() <= NORM_TOLERANCE).then_some(out)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::geo::{Body, Ned, so3};
    use crate::wire::frame::{ComponentId, SystemId};
    use crate::wire::session::Address;
    use crate::wire::session::outgoing::FrameWriter;
    use proptest::prelude::*;

    fn sample(frame: PoseFrame) -> Odometry {
        let mut pose_covariance = [0.0; 21];
        for (i, c) in pose_covariance.iter_mut().enumerate() {
            *c = 0.5 + i as f64;
        }
        Odometry {
            time: AutopilotTime::from_micros(123_456_789),
            frame,
            position: Ned::new(Vector3::new(1.5, -2.5, -30.25)),
            attitude: BodyToNed::from_matrix(&so3::exp(&Vector3::new(0.3, -0.2, 2.5))),
            velocity: Body::new(Vector3::new(4.0, 0.5, -0.25)),
            angular_rate: Body::new(Vector3::new(0.01, 0.02, -0.03)),
            pose_covariance,
            velocity_covariance: [0.25; 21],
            reset_counter: 7,
            quality: 42,
        }
    }

    /// Through the wire and the crate's parser.
    fn round_trip(message: &MavMessage) -> MavMessage {
        let from = Address { system: SystemId(1), component: ComponentId::ODOMETRY_SOURCE };
        let bytes = FrameWriter::new(from).write(message).unwrap();
        let frame = bytes.frame().unwrap();
        assert!(frame.checksum_fits());
        assert_eq!((frame.system(), frame.component()), (SystemId(1), ComponentId(197)));
        frame.parse().unwrap()
    }

    fn parsed(o: Odometry) -> ODOMETRY_DATA {
        let message = encode(&OutboundMessage::Odometry(o), &AutopilotClock::new()).unwrap();
        match round_trip(&message) {
            MavMessage::ODOMETRY(data) => data,
            other => panic!("{other:?}"),
        }
    }

    #[test]
    fn every_field_of_odometry_arrives() {
        let o = sample(PoseFrame::LocalFrd);
        let m = parsed(o);
        assert_eq!(m.time_usec, 123_456_789);
        assert_eq!((m.x, m.y, m.z), (1.5, -2.5, -30.25));
        assert_eq!((m.vx, m.vy, m.vz), (4.0, 0.5, -0.25));
        assert_eq!((m.rollspeed, m.pitchspeed, m.yawspeed), (0.01, 0.02, -0.03));
        let q = o.attitude.quaternion();
        assert!(m.q.iter().zip([q.w, q.i, q.j, q.k]).all(|(a, b)| (f64::from(*a) - b).abs() < 1e-6));
        assert_eq!(
            (m.pose_covariance[0], m.pose_covariance[20], m.velocity_covariance[6]),
            (0.5, 20.5, 0.25)
        );
        assert_eq!((m.reset_counter, m.quality), (7, 42));
        assert_eq!(m.estimator_type as u8, 3);
    }

    #[test]
    fn each_autopilot_gets_the_frames_it_reads() {
        for (frame, number) in [(PoseFrame::LocalFrd, 20), (PoseFrame::LocalNed, 1)] {
            let m = parsed(sample(frame));
            assert_eq!((m.frame_id as u8, m.child_frame_id as u8), (number, 12));
        }
    }

    #[test]
    fn lost_and_worst_qualities_survive_the_wire() {
        for quality in [-1, 1, 100] {
            assert_eq!(parsed(Odometry { quality, ..sample(PoseFrame::LocalNed) }).quality, quality);
        }
    }

    #[test]
    fn vision_messages_arrive() {
        let o = sample(PoseFrame::LocalNed);
        let attitude = BodyToNed::from_matrix(&Euler::new(0.1, -0.2, 3.0).to_rotation());
        let position = OutboundMessage::VisionPosition(VisionPosition {
            time: o.time,
            position: o.position,
            attitude,
            pose_covariance: o.pose_covariance,
            reset_counter: 9,
        });
        let MavMessage::VISION_POSITION_ESTIMATE(m) =
            round_trip(&encode(&position, &AutopilotClock::new()).unwrap())
        else {
            panic!("another message")
        };
        assert_eq!((m.usec, m.x, m.yaw, m.covariance[6], m.reset_counter), (123_456_789, 1.5, 3.0, 6.5, 9));
        let covariance = Ned::new(Matrix3::new(1.0, 2.0, 3.0, 4.0, 5.0, 6.0, 7.0, 8.0, 9.0));
        let velocity = Ned::new(Vector3::new(1.0, 2.0, -3.0));
        let speed = OutboundMessage::VisionSpeed { time: o.time, velocity, covariance, reset_counter: 9 };
        let MavMessage::VISION_SPEED_ESTIMATE(m) =
            round_trip(&encode(&speed, &AutopilotClock::new()).unwrap())
        else {
            panic!("another message")
        };
        assert_eq!((m.usec, m.x, m.y, m.z, m.reset_counter), (123_456_789, 1.0, 2.0, -3.0, 9));
        assert_eq!(m.covariance, [1.0, 2.0, 3.0, 4.0, 5.0, 6.0, 7.0, 8.0, 9.0]);
    }

    #[test]
    fn stamps_are_boot_time_also_after_a_reboot() {
        let mut clock = AutopilotClock::new();
        clock.boot_ms(500_000).unwrap();
        for ms in (1000..1600).step_by(10) {
            let _ = clock.boot_ms(ms);
        }
        let after = clock.newest().unwrap();
        assert!(after > AutopilotTime::from_micros(500_000_000), "the axis goes on");
        let o = Odometry { time: after, ..sample(PoseFrame::LocalFrd) };
        let Some(MavMessage::ODOMETRY(m)) = encode(&OutboundMessage::Odometry(o), &clock) else {
            panic!("not encoded")
        };
        assert_eq!(m.time_usec, 1_590_000);
        let before = Odometry { time: AutopilotTime::from_micros(0), ..o };
        assert_eq!(encode(&OutboundMessage::Odometry(before), &clock), None, "before the boot");
    }

    proptest! {
        #[test]
        fn a_sent_quaternion_is_of_unit_norm(x in -3.0..3.0f64, y in -3.0..3.0f64, z in -3.0..3.0f64) {
            let o = Odometry {
                attitude: BodyToNed::from_matrix(&(so3::exp(&Vector3::new(x, y, z)) * 1.0005)),
                ..sample(PoseFrame::LocalFrd)
            };
            let norm = parsed(o).q.iter().map(|&c| f64::from(c).powi(2)).sum::<f64>().sqrt();
            prop_assert!((norm - 1.0).abs() < 1e-6);
        }

        #[test]
        fn nothing_that_is_not_finite_is_sent(
            place in 0usize..60,
            bad in prop::sample::select(vec![f64::NAN, f64::INFINITY, f64::NEG_INFINITY, 1e300]),
        ) {
            let mut o = sample(PoseFrame::LocalFrd);
            let with = |mut v: Vector3<f64>, axis: usize| {
                v[axis] = bad;
                v
            };
            match place {
                0..3 => o.position = Ned::new(with(o.position.raw(), place)),
                3..6 => o.velocity = Body::new(with(o.velocity.raw(), place - 3)),
                6..9 => o.angular_rate = Body::new(with(o.angular_rate.raw(), place - 6)),
                9..18 => {
                    let mut matrix = *o.attitude.matrix();
                    matrix[place - 9] = bad;
                    o.attitude = BodyToNed::from_matrix(&matrix);
                }
                18..39 => o.pose_covariance[place - 18] = bad,
                _ => o.velocity_covariance[place - 39] = bad,
            }
            prop_assert_eq!(encode(&OutboundMessage::Odometry(o), &AutopilotClock::new()), None);
        }
    }
}
