//! Messages of external navigation, read as they stand.

use mavlink::dialects::ardupilotmega as apm;
use nalgebra::{Quaternion, UnitQuaternion, Vector3};

use crate::geo::so3::Euler;
use crate::sim::autopilot::external::{ExternalMessage, ExternalPose, ReportedFrame};
use crate::wire::messages::Message;

/// A message of external navigation that came at `arrived_s`, its stamp on a clock that began `booted_s` into the simulation; `None` for
/// any other message.
pub(super) fn read(message: &Message, arrived_s: f64, booted_s: f64) -> Option<ExternalPose> {
    let stamp_s = |usec: u64| usec as f64 * 1e-6 + booted_s;
    match message {
        Message::ODOMETRY(m) => Some(odometry(m, arrived_s, stamp_s(m.time_usec))),
        Message::VISION_POSITION_ESTIMATE(m) => Some(ExternalPose {
            message: ExternalMessage::VisionPosition,
            stamp_s: stamp_s(m.usec),
            arrived_s,
            position: finite([m.x, m.y, m.z]),
            attitude: Some(
                Euler { roll_rad: m.roll.into(), pitch_rad: m.pitch.into(), yaw_rad: m.yaw.into() }
                    .to_rotation(),
            ),
            quaternion_error: 0.0,
            velocity: None,
            position_variance: diagonal(&m.covariance, [0, 6, 11]),
            velocity_variance: Vector3::repeat(f64::NAN),
            reset_counter: m.reset_counter,
        }),
        Message::VISION_SPEED_ESTIMATE(m) => Some(ExternalPose {
            message: ExternalMessage::VisionSpeed,
            stamp_s: stamp_s(m.usec),
            arrived_s,
            position: None,
            attitude: None,
            quaternion_error: 0.0,
            velocity: finite([m.x, m.y, m.z]),
            position_variance: Vector3::repeat(f64::NAN),
            velocity_variance: diagonal(&m.covariance, [0, 4, 8]),
            reset_counter: m.reset_counter,
        }),
        _ => None,
    }
}

fn odometry(m: &apm::ODOMETRY_DATA, arrived_s: f64, stamp_s: f64) -> ExternalPose {
    let [w, x, y, z] = m.q.map(f64::from);
    let q = Quaternion::new(w, x, y, z);
    let norm = q.norm();
    let is_rotation = norm.is_finite() && norm > 0.5;
    ExternalPose {
        message: ExternalMessage::Odometry {
            pose: frame(m.frame_id),
            velocity: frame(m.child_frame_id),
            estimator_type: m.estimator_type as u8,
            quality: m.quality,
        },
        stamp_s,
        arrived_s,
        position: finite([m.x, m.y, m.z]),
        attitude: is_rotation.then(|| *UnitQuaternion::from_quaternion(q).to_rotation_matrix().matrix()),
        quaternion_error: (norm - 1.0).abs(),
        velocity: finite([m.vx, m.vy, m.vz]),
        position_variance: diagonal(&m.pose_covariance, [0, 6, 11]),
        velocity_variance: diagonal(&m.velocity_covariance, [0, 6, 11]),
        reset_counter: m.reset_counter,
    }
}

fn frame(frame: apm::MavFrame) -> ReportedFrame {
    match frame {
        apm::MavFrame::MAV_FRAME_LOCAL_NED => ReportedFrame::LocalNed,
        apm::MavFrame::MAV_FRAME_LOCAL_FRD => ReportedFrame::LocalFrd,
        apm::MavFrame::MAV_FRAME_BODY_FRD => ReportedFrame::BodyFrd,
        _ => ReportedFrame::Other,
    }
}

fn finite(v: [f32; 3]) -> Option<Vector3<f64>> {
    v.iter().all(|x| x.is_finite()).then(|| Vector3::from_iterator(v.into_iter().map(f64::from)))
}

fn diagonal(covariance: &[f32], places: [usize; 3]) -> Vector3<f64> {
    Vector3::from_iterator(places.into_iter().map(|i| f64::from(covariance[i])))
}
