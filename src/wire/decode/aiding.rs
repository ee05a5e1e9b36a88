//! Optical flow, rangefinders, airspeed and landmarks.

use mavlink::dialects::ardupilotmega as apm;
use nalgebra::Vector3;

use crate::geo::Body;
use crate::sample::{
    AirspeedSample, FlowRotation, FlowSample, Input, LandmarkSample, RangeDirection, RangeSample, Sample,
    Sighting,
};
use crate::time::{AutopilotTime, Span};

use super::super::frame::ComponentId;
use super::super::messages::Meaning;
use super::repeats::{Novelty, Repeats};
use super::{Cause, Decoder, Out, Repair, finite, limits, within};

/// MAV_SENSOR_ROTATION_PITCH_270: the beam points along body +z.
const FACING_DOWN: u8 = 25;

/// MAV_FRAME_BODY_FRD and its older name MAV_FRAME_BODY_NED: x, y and z from the vehicle in its own axes.
const BODY_FRAMES: [u8; 2] = [12, 8];

/// What one flow sensor told last: the bits of its numbers, and its quality.
#[derive(Clone, Debug)]
pub(super) struct FlowReadings {
    sensor: u8,
    repeats: Option<Repeats<([u32; 6], u8)>>,
    /// It fills the pixels only; and the last that were new, with their time and what they were counted over, s.
    pixels: bool,
    counted: Option<(AutopilotTime, [i16; 2], Option<f64>)>,
}

impl Decoder {
    pub(super) fn optical_flow(
        &mut self,
        m: &apm::OPTICAL_FLOW_DATA,
        from: ComponentId,
        out: Out<'_>,
    ) -> Result<(), Cause> {
        let time = self.stamped_usec(m.time_usec, from)?;
        let quality = f64::from(m.quality) / 255.0;
        let rates = [
            within(m.flow_rate_x, -limits::FLOW_RADPS, limits::FLOW_RADPS)?,
            within(m.flow_rate_y, -limits::FLOW_RADPS, limits::FLOW_RADPS)?,
        ];
        let compensated = [within(m.flow_comp_m_x, -1e4, 1e4)?, within(m.flow_comp_m_y, -1e4, 1e4)?];
        let readings = self.flow_readings(m.sensor_id);
        let blank = rates == [0.0, 0.0] && compensated == [0.0, 0.0];
        readings.pixels = blank && (readings.pixels || (m.flow_x, m.flow_y) != (0, 0));
        if readings.pixels {
            return self.flow_in_pixels(m, time, from, out);
        }
        let ground_m = f64::from(m.ground_distance);
        // ArduPilot fills ground_distance from its own estimator: it is not taken.
        let (rate_xy, rotation) = if self.conventions.flow_comp_is_rate {
            // The autopilot subtracted its gyro at the sensor's own instant, which a thinned IMU stream cannot do as well.
            (compensated, FlowRotation::Removed)
        } else if rates != [0.0, 0.0] {
            (rates, FlowRotation::Contained)
        } else if ground_m.is_finite() && ground_m > 0.0 {
            // A velocity only, by the sensor's own distance: v_x = d ω_y, v_y = −d ω_x.
            ([-compensated[1] / ground_m, compensated[0] / ground_m], FlowRotation::Removed)
        } else {
            return Err(Cause::NoDistance);
        };
        if rate_xy.iter().any(|r| r.abs() > limits::FLOW_RADPS) {
            return Err(Cause::Absurd);
        }
        let sample = FlowSample {
            time,
            sensor: m.sensor_id,
            interval: Span::ZERO,
            rate_xy,
            rotation,
            quality,
            distance_m: None,
        };
        // The counts of the sensor itself are compared, too: a new reading may come to the same rate.
        let reading = [
            m.flow_comp_m_x,
            m.flow_comp_m_y,
            m.flow_rate_x,
            m.flow_rate_y,
            f32::from(m.flow_x),
            f32::from(m.flow_y),
        ];
        self.flow_reading(sample, from, reading, m.quality, out);
        Ok(())
    }

    /// A flow in pixels only: their sum over the time since the reading before, in tenths; what one is worth is for the navigator to find. Flow
    /// along the image's x is seen where the camera turns about its y, and the other way round.
    fn flow_in_pixels(
        &mut self,
        m: &apm::OPTICAL_FLOW_DATA,
        time: AutopilotTime,
        from: ComponentId,
        out: Out<'_>,
    ) -> Result<(), Cause> {
        /// OPTICAL_FLOW's dpix.
        const PIXELS: f64 = 0.1;
        let reading = [m.flow_comp_m_x, m.flow_comp_m_y, f32::from(m.flow_x), f32::from(m.flow_y), 0.0, 0.0];
        let counts = [m.flow_x, m.flow_y];
        let before = &mut self.flow_readings(m.sensor_id).counted;
        if before.is_none_or(|(_, told, _)| told != counts) {
            let seconds = before.map(|(last, ..)| time.seconds_since(last));
            *before = Some((time, counts, seconds.filter(|s| (1e-3..=1.0).contains(s))));
        }
        // Of the first nobody knows what it was counted over.
        let Some((.., Some(seconds))) = *before else { return Ok(()) };
        let sample = FlowSample {
            time,
            sensor: m.sensor_id,
            interval: Span::from_seconds(seconds),
            rate_xy: [f64::from(m.flow_y), -f64::from(m.flow_x)].map(|pixels| pixels * PIXELS / seconds),
            rotation: FlowRotation::InOwnUnit,
            quality: f64::from(m.quality) / 255.0,
            distance_m: None,
        };
        self.flow_reading(sample, from, reading, m.quality, out);
        Ok(())
    }

    /// What is known of a flow sensor.
    fn flow_readings(&mut self, sensor: u8) -> &mut FlowReadings {
        let place = self.flows.iter().position(|f| f.sensor == sensor).unwrap_or_else(|| {
            self.flows.push(FlowReadings { sensor, repeats: None, pixels: false, counted: None });
            self.flows.len() - 1
        });
        &mut self.flows[place]
    }

    /// Passes a flow on if it is a new reading of its sensor.
    fn flow_reading(
        &mut self,
        mut sample: FlowSample,
        from: ComponentId,
        told: [f32; 6],
        quality: u8,
        out: Out<'_>,
    ) {
        if !self.prefers(Meaning::Flow, sample.sensor, from, sample.time) {
            return;
        }
        // Bits: the gyro's NaN has to be equal to itself.
        let reading = (told.map(f32::to_bits), quality);
        match Repeats::judge(&mut self.flow_readings(sample.sensor).repeats, sample.time, reading) {
            Novelty::Repeated => return self.repairs.count(Repair::FlowRepeated),
            Novelty::New(Some(interval)) if sample.interval == Span::ZERO => sample.interval = interval,
            Novelty::New(_) | Novelty::Held => {}
        }
        out.push(Input::Sample(Sample::Flow(sample)));
    }

    pub(super) fn optical_flow_rad(
        &mut self,
        m: &apm::OPTICAL_FLOW_RAD_DATA,
        from: ComponentId,
        out: Out<'_>,
    ) -> Result<(), Cause> {
        let time = self.stamped_usec(m.time_usec, from)?;
        let interval = Span::from_micros(i64::from(m.integration_time_us));
        let dt = interval.seconds();
        if !(1e-4..=1.0).contains(&dt) {
            return Err(Cause::Absurd);
        }
        let flow = [within(m.integrated_x, -100.0, 100.0)? / dt, within(m.integrated_y, -100.0, 100.0)? / dt];
        if flow.iter().any(|r| r.abs() > limits::FLOW_RADPS) {
            return Err(Cause::Absurd);
        }
        let gyro = [f64::from(m.integrated_xgyro) / dt, f64::from(m.integrated_ygyro) / dt];
        // NaN is the message's way to say that the sensor has no gyro.
        let rotation = if gyro.iter().all(|g| g.is_finite() && g.abs() <= limits::FLOW_RADPS) {
            FlowRotation::SensorGyro(gyro)
        } else {
            FlowRotation::Contained
        };
        let distance = f64::from(m.distance);
        let sample = FlowSample {
            time,
            sensor: m.sensor_id,
            interval,
            rate_xy: flow,
            rotation,
            quality: f64::from(m.quality) / 255.0,
            distance_m: (distance.is_finite() && distance > 0.0).then_some(distance),
        };
        let span = m.integration_time_us as f32;
        let reading =
            [m.integrated_x, m.integrated_y, m.integrated_xgyro, m.integrated_ygyro, span, m.distance];
        self.flow_reading(sample, from, reading, m.quality, out);
        Ok(())
    }

    pub(super) fn distance_sensor(
        &mut self,
        m: &apm::DISTANCE_SENSOR_DATA,
        from: ComponentId,
        out: Out<'_>,
    ) -> Result<(), Cause> {
        let time = self.stamped_ms(m.time_boot_ms, from)?;
        if !self.prefers(Meaning::Range, m.id, from, time) {
            return Ok(());
        }
        let cm = |v: u16| f64::from(v) * 0.01;
        let direction = match m.orientation as u8 {
            FACING_DOWN => RangeDirection::Down,
            other => RangeDirection::Other(other),
        };
        if direction == RangeDirection::Down {
            self.range.take(0, time);
        }
        // 65535 is "nothing within range"; a signal quality of 1 is "invalid" by the message's definition.
        if m.current_distance == u16::MAX || m.signal_quality == 1 {
            return Ok(());
        }
        let limits_m = (m.max_distance > m.min_distance).then(|| [cm(m.min_distance), cm(m.max_distance)]);
        let sample =
            RangeSample { time, sensor: m.id, direction, distance_m: cm(m.current_distance), limits_m };
        out.push(Input::Sample(Sample::Range(sample)));
        Ok(())
    }

    pub(super) fn rangefinder(&mut self, m: &apm::RANGEFINDER_DATA, out: Out<'_>) -> Result<(), Cause> {
        let time = self.now()?;
        let distance_m = within(m.distance, -1.0, limits::RANGE_M)?;
        if self.range.take(1, time) && distance_m > 0.0 {
            let direction = RangeDirection::Down;
            out.push(Input::Sample(Sample::Range(RangeSample {
                time,
                sensor: 0,
                direction,
                distance_m,
                limits_m: None,
            })));
        }
        Ok(())
    }

    /// VFR_HUD carries no time and, on vehicles without the sensor, NaN, zero, or what the autopilot's own filter thinks: that must not
    /// come back as a measurement.
    pub(super) fn airspeed(&mut self, airspeed: f32, out: Out<'_>) -> Result<(), Cause> {
        let time = self.now()?;
        let estimate = self.conventions.airspeed_may_be_estimate && self.pitot != Some(true);
        if airspeed.is_nan() || airspeed == 0.0 || estimate {
            return Ok(());
        }
        let airspeed_mps = within(airspeed, *limits::AIRSPEED_MPS.start(), *limits::AIRSPEED_MPS.end())?;
        out.push(Input::Sample(Sample::Airspeed(AirspeedSample { time, airspeed_mps })));
        Ok(())
    }

    /// LANDING_TARGET of the autopilot, or of another component of the vehicle that sees landmarks: that one's stamps are read on the
    /// autopilot's clock, and move nothing. A camera on a link of its own may have a clock of its own.
    pub(super) fn landing_target(
        &mut self,
        m: &apm::LANDING_TARGET_DATA,
        from: ComponentId,
        out: Out<'_>,
    ) -> Result<(), Cause> {
        let time = if self.is_own(from) {
            self.clock.usec(m.time_usec)?
        } else if self.apart {
            self.stamped_usec(m.time_usec, from)?
        } else {
            self.clock.foreign_usec(m.time_usec)?
        };
        let sighting = if matches!(m.position_valid, apm::MavBool::MAV_BOOL_TRUE) {
            if !BODY_FRAMES.contains(&(m.frame as u8)) {
                return Err(Cause::ForeignFrame);
            }
            let position: Vector3<f64> = finite(m.x, m.y, m.z)?;
            if position.amax() > 1e4 {
                return Err(Cause::Absurd);
            }
            Sighting::Body(Body::new(position))
        } else {
            let half_turn = std::f64::consts::FRAC_PI_2;
            let angle_xy =
                [within(m.angle_x, -half_turn, half_turn)?, within(m.angle_y, -half_turn, half_turn)?];
            let distance = f64::from(m.distance);
            Sighting::Bearing {
                angle_xy,
                distance_m: (distance.is_finite() && distance > 0.0).then_some(distance),
            }
        };
        let sample = LandmarkSample { time, camera: from.0, id: m.target_num, sighting };
        out.push(Input::Sample(Sample::Landmark(sample)));
        Ok(())
    }
}
