//! Truth and the autopilot's own estimate: [`Reference`], never a sample.

use mavlink::dialects::ardupilotmega as apm;
use nalgebra::{Quaternion, UnitQuaternion, Vector3};

use crate::geo::{BodyToNed, Geodetic, Ned};
use crate::sample::{Input, Reference, TruthState};

use super::{Cause, Decoder, Out, finite, limits};

impl Decoder {
    pub(super) fn sim_state(&mut self, m: &apm::SIM_STATE_DATA, out: Out<'_>) -> Result<(), Cause> {
        let time = self.now()?;
        // The float fields hold degrees or (ArduPilot 4.7) degE7 with a metre of resolution; the integers are exact.
        let (lat, lon) = match (m.lat_int, m.lon_int) {
            (0, 0) => (f64::from(m.lat), f64::from(m.lon)),
            (lat, lon) => (f64::from(lat) * 1e-7, f64::from(lon) * 1e-7),
        };
        truth(
            time,
            [m.q1, m.q2, m.q3, m.q4],
            (lat, lon, f64::from(m.alt)),
            Some(finite(m.vn, m.ve, m.vd)?),
            out,
        )
    }

    /// SIMSTATE has attitude and horizontal position only.
    pub(super) fn simstate(&mut self, m: &apm::SIMSTATE_DATA, out: Out<'_>) -> Result<(), Cause> {
        let time = self.now()?;
        let angles = finite(m.roll, m.pitch, m.yaw)?;
        let attitude = UnitQuaternion::from_euler_angles(angles.x, angles.y, angles.z).into();
        let state = TruthState { time, attitude: Some(attitude), position: None, velocity: None };
        out.push(Input::Reference(Reference::Truth(state)));
        Ok(())
    }

    pub(super) fn hil_state(
        &mut self,
        m: &apm::HIL_STATE_QUATERNION_DATA,
        out: Out<'_>,
    ) -> Result<(), Cause> {
        let time = self.clock.usec(m.time_usec)?;
        let position = (f64::from(m.lat) * 1e-7, f64::from(m.lon) * 1e-7, f64::from(m.alt) * 1e-3);
        let velocity = Vector3::new(f64::from(m.vx), f64::from(m.vy), f64::from(m.vz)) * 0.01;
        truth(time, m.attitude_quaternion, position, Some(velocity), out)
    }

    pub(super) fn attitude(&mut self, m: &apm::ATTITUDE_DATA, out: Out<'_>) -> Result<(), Cause> {
        let time = self.clock.boot_ms(m.time_boot_ms)?;
        let angles = finite(m.roll, m.pitch, m.yaw)?;
        if self.attitude.take(1, time) {
            let attitude = UnitQuaternion::from_euler_angles(angles.x, angles.y, angles.z).into();
            out.push(Input::Reference(Reference::Attitude { time, attitude }));
        }
        Ok(())
    }

    pub(super) fn attitude_quaternion(
        &mut self,
        m: &apm::ATTITUDE_QUATERNION_DATA,
        out: Out<'_>,
    ) -> Result<(), Cause> {
        let time = self.clock.boot_ms(m.time_boot_ms)?;
        let attitude = attitude([m.q1, m.q2, m.q3, m.q4])?;
        self.attitude.take(0, time);
        out.push(Input::Reference(Reference::Attitude { time, attitude }));
        Ok(())
    }

    pub(super) fn local_position(
        &mut self,
        m: &apm::LOCAL_POSITION_NED_DATA,
        out: Out<'_>,
    ) -> Result<(), Cause> {
        let time = self.clock.boot_ms(m.time_boot_ms)?;
        let (position_ned, velocity_ned) = (finite(m.x, m.y, m.z)?, finite(m.vx, m.vy, m.vz)?);
        // What is sent is aligned with this: a wild value must not get in.
        if position_ned.amax() > limits::LOCAL_M || velocity_ned.amax() > limits::LOCAL_MPS {
            return Err(Cause::Absurd);
        }
        let (position, velocity) = (Ned::new(position_ned), Ned::new(velocity_ned));
        out.push(Input::Reference(Reference::Local { time, position, velocity }));
        Ok(())
    }

    pub(super) fn global_position(
        &mut self,
        m: &apm::GLOBAL_POSITION_INT_DATA,
        out: Out<'_>,
    ) -> Result<(), Cause> {
        let time = self.clock.boot_ms(m.time_boot_ms)?;
        if (m.lat, m.lon) == (0, 0) {
            return Ok(());
        }
        let position =
            Geodetic::from_degrees(f64::from(m.lat) * 1e-7, f64::from(m.lon) * 1e-7, f64::from(m.alt) * 1e-3);
        if !position.is_plausible() {
            return Err(Cause::Absurd);
        }
        let velocity_ned = Vector3::new(f64::from(m.vx), f64::from(m.vy), f64::from(m.vz)) * 0.01;
        let velocity = Ned::new(velocity_ned);
        out.push(Input::Reference(Reference::Global { time, position, velocity }));
        Ok(())
    }
}

fn truth(
    time: crate::time::AutopilotTime,
    q: [f32; 4],
    (lat_deg, lon_deg, height_m): (f64, f64, f64),
    velocity_ned: Option<Vector3<f64>>,
    out: Out<'_>,
) -> Result<(), Cause> {
    let position = Geodetic::from_degrees(lat_deg, lon_deg, height_m);
    if !position.is_plausible() {
        return Err(if height_m.is_finite() { Cause::Absurd } else { Cause::NotFinite });
    }
    let velocity = velocity_ned.map(Ned::new);
    let state = TruthState { time, attitude: Some(attitude(q)?), position: Some(position), velocity };
    out.push(Input::Reference(Reference::Truth(state)));
    Ok(())
}

fn attitude(q: [f32; 4]) -> Result<BodyToNed, Cause> {
    let q = Quaternion::new(f64::from(q[0]), f64::from(q[1]), f64::from(q[2]), f64::from(q[3]));
    if !q.coords.iter().all(|c| c.is_finite()) {
        return Err(Cause::NotFinite);
    }
    let norm = q.norm();
    if (norm - 1.0).abs() > 0.05 {
        return Err(Cause::Absurd);
    }
    Ok(UnitQuaternion::new_unchecked(q / norm).into())
}
