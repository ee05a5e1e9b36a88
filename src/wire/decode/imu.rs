//! Inertial and magnetic measurements, and static pressure.

use mavlink::dialects::ardupilotmega as apm;
use nalgebra::Vector3;

use crate::geo::{Body, STANDARD_GRAVITY_MPS2};
use crate::sample::{ImuSample, Input, MagSample, PressureSample, Sample};
use crate::time::{AutopilotTime, Span};

use super::{Cause, Decoder, Out, Repair, finite, limits, within};

const TESLA_PER_GAUSS: f64 = 1e-4;
/// An inertial measurement this much older than the newest is of no use to anybody.
const LATE_INERTIA: Span = Span::from_millis(150);
/// Places of [`Decoder`]'s field units.
const HIGHRES_FIELD: usize = 0;
const MILLI_FIELD: usize = 1;

impl Decoder {
    pub(super) fn highres_imu(&mut self, m: &apm::HIGHRES_IMU_DATA, out: Out<'_>) -> Result<(), Cause> {
        let time = self.clock.usec(m.time_usec)?;
        if m.id != 0 {
            return Ok(());
        }
        let rate = finite(m.xgyro, m.ygyro, m.zgyro)?;
        let force = finite(m.xacc, m.yacc, m.zacc)?;
        self.inertial(0, time, rate, force, out)?;
        if m.fields_updated.contains(apm::HighresImuUpdatedFlags::HIGHRES_IMU_UPDATED_XMAG) {
            let field = finite(m.xmag, m.ymag, m.zmag)? * TESLA_PER_GAUSS;
            self.magnetic(HIGHRES_FIELD, time, field, out)?;
        }
        if m.fields_updated.contains(apm::HighresImuUpdatedFlags::HIGHRES_IMU_UPDATED_ABS_PRESSURE)
            && self.pressure.take(1, time)
        {
            out.push(Input::Sample(pressure_sample(time, 0, m.abs_pressure)?));
        }
        Ok(())
    }

    pub(super) fn scaled_imu(
        &mut self,
        rank: usize,
        m: &apm::SCALED_IMU_DATA,
        out: Out<'_>,
    ) -> Result<(), Cause> {
        let time = self.clock.boot_ms(m.time_boot_ms)?;
        let milli = [m.xacc, m.yacc, m.zacc, m.xgyro, m.ygyro, m.zgyro, m.xmag, m.ymag, m.zmag];
        self.milli_units(rank, time, milli, out)
    }

    pub(super) fn scaled_imu2(&mut self, m: &apm::SCALED_IMU2_DATA, out: Out<'_>) -> Result<(), Cause> {
        let time = self.clock.boot_ms(m.time_boot_ms)?;
        let milli = [m.xacc, m.yacc, m.zacc, m.xgyro, m.ygyro, m.zgyro, m.xmag, m.ymag, m.zmag];
        self.milli_units(3, time, milli, out)
    }

    pub(super) fn scaled_imu3(&mut self, m: &apm::SCALED_IMU3_DATA, out: Out<'_>) -> Result<(), Cause> {
        let time = self.clock.boot_ms(m.time_boot_ms)?;
        let milli = [m.xacc, m.yacc, m.zacc, m.xgyro, m.ygyro, m.zgyro, m.xmag, m.ymag, m.zmag];
        self.milli_units(4, time, milli, out)
    }

    pub(super) fn raw_imu(&mut self, m: &apm::RAW_IMU_DATA, out: Out<'_>) -> Result<(), Cause> {
        let time = self.clock.usec(m.time_usec)?;
        if !self.conventions.raw_imu_is_scaled {
            return Ok(());
        }
        let milli = [m.xacc, m.yacc, m.zacc, m.xgyro, m.ygyro, m.zgyro, m.xmag, m.ymag, m.zmag];
        self.milli_units(2, time, milli, out)
    }

    fn milli_units(
        &mut self,
        rank: usize,
        time: AutopilotTime,
        raw: [i16; 9],
        out: Out<'_>,
    ) -> Result<(), Cause> {
        let v =
            |i: usize| Vector3::new(f64::from(raw[i]), f64::from(raw[i + 1]), f64::from(raw[i + 2])) * 1e-3;
        let used = self.inertial(rank, time, v(3), v(0) * STANDARD_GRAVITY_MPS2, out)?;
        if used && raw[6..] != [0, 0, 0] {
            self.magnetic(MILLI_FIELD, time, v(6) * TESLA_PER_GAUSS, out)?;
        }
        Ok(())
    }

    /// Whether the sample was taken (and no better source is alive).
    fn inertial(
        &mut self,
        rank: usize,
        time: AutopilotTime,
        angular_rate_body: Vector3<f64>,
        specific_force_body: Vector3<f64>,
        out: Out<'_>,
    ) -> Result<bool, Cause> {
        if specific_force_body.amax() > limits::SPECIFIC_FORCE_MPS2
            || angular_rate_body.amax() > limits::ANGULAR_RATE_RADPS
        {
            return Err(Cause::Absurd);
        }
        // An accelerometer in flight or at rest never reads exactly zero on all axes: the message is a shell without a sensor, as
        // SCALED_IMU3 of a vehicle that has no third one.
        if specific_force_body == Vector3::zeros() {
            return if angular_rate_body == Vector3::zeros() { Ok(false) } else { Err(Cause::Absurd) };
        }
        let used = self.imu.take(rank, time);
        // The navigator takes a stream that goes on in the past for a clock that was set back. That of a link is judged where arrival is known.
        let newest = self.newest_inertial.map_or(time, |newest| newest.max(time));
        if used && newest - time > LATE_INERTIA {
            return Err(Cause::OutOfOrder);
        }
        if used {
            self.newest_inertial = Some(newest);
            let (angular_rate, specific_force) =
                (Body::new(angular_rate_body), Body::new(specific_force_body));
            out.push(Input::Sample(Sample::Imu(ImuSample { time, angular_rate, specific_force })));
        }
        Ok(used)
    }

    fn magnetic(
        &mut self,
        stream: usize,
        time: AutopilotTime,
        field: Vector3<f64>,
        out: Out<'_>,
    ) -> Result<(), Cause> {
        let Some((field, off)) = self.field_units[stream].put_right(field) else {
            // Before its first measurement a magnetometer is reported as zero: no news, not a fault.
            return if field == Vector3::zeros() { Ok(()) } else { Err(Cause::Absurd) };
        };
        if off != 0 {
            self.repairs.count(Repair::FieldUnit(off));
        }
        out.push(Input::Sample(Sample::Mag(MagSample { time, sensor: 0, field: Body::new(field) })));
        Ok(())
    }

    pub(super) fn scaled_pressure(
        &mut self,
        m: &apm::SCALED_PRESSURE_DATA,
        out: Out<'_>,
    ) -> Result<(), Cause> {
        self.differential_pressure(m.press_diff);
        self.pressure(0, m.time_boot_ms, m.press_abs, out)
    }

    pub(super) fn pressure(&mut self, sensor: u8, boot_ms: u32, hpa: f32, out: Out<'_>) -> Result<(), Cause> {
        let time = self.clock.boot_ms(boot_ms)?;
        let sample = pressure_sample(time, sensor, hpa)?;
        if sensor == 0 {
            self.pressure.take(0, time);
        }
        out.push(Input::Sample(sample));
        Ok(())
    }
}

fn pressure_sample(time: AutopilotTime, sensor: u8, hpa: f32) -> Result<Sample, Cause> {
    let bounds = limits::PRESSURE_PA;
    let pressure_pa = within(hpa, bounds.start() * 0.01, bounds.end() * 0.01)? * 100.0;
    Ok(Sample::Pressure(PressureSample { time, sensor, pressure_pa }))
}
