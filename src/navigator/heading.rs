//! Heading from motion, for a vehicle that has nothing better: the bank of [`crate::filter::heading_bank`] fed while aligning, and what
//! follows for the observer, which has no second direction then: it finds no attitude, so it follows instead of watching.

use nalgebra::{Matrix3, Vector2, Vector3};

use crate::filter::{HeadingBank, HeadingBankSettings, HeadingEstimate};
use crate::geo::{polar_rotation, so3};
use crate::sample::ImuSample;
use crate::time::AutopilotTime;

use super::Navigator;
use super::event::What;
use super::inertial::{FLOW_AGE_S, WAIT_FOR_MAGNETOMETER_S};
use super::kalman::{START_TILT, START_VELOCITY, StartSigmas};
use super::solution::Mode;

/// A heading from motion is not believed better than this, rad: what is systematic in a manoeuvre (scale, latency, alignment).
const LEAST_YAW: f64 = 0.12;

impl Navigator {
    /// An IMU sample for the bank, which lives while the vehicle aligns without a magnetometer.
    pub(super) fn seek_heading(&mut self, s: &ImuSample, dt: f64) {
        let magnetic = self.magnetic.is_some_and(|(t, _)| s.time.seconds_since(t) < WAIT_FOR_MAGNETOMETER_S);
        // Without a filter nobody carries the heading on: the observers have no direction to hold it by.
        let waited = self.modes.seconds_since_start(s.time) >= WAIT_FOR_MAGNETOMETER_S;
        let sought = self.modes.mode() == Mode::Aligning
            && self.settings.estimator.has_filter()
            && waited
            && !magnetic;
        if !sought {
            self.heading = None;
            return;
        }
        if self.heading.is_none() {
            let gravity = self.place.as_ref().map_or(9.81, |p| p.gravity_ned.z);
            let settings = HeadingBankSettings {
                shared_instants: self.settings.imu_instantaneous,
                ..HeadingBankSettings::standard()
            };
            self.heading = Some(HeadingBank::new(settings, gravity));
            self.tell(s.time, What::HeadingSought);
        }
        if let Some(bank) = &mut self.heading {
            bank.imu(s.time, dt, &s.angular_rate.raw(), &s.specific_force.raw());
        }
    }

    /// A velocity of GNSS for the bank; a blind observer is levelled by it.
    pub(super) fn weigh_headings(
        &mut self,
        now: AutopilotTime,
        measured: AutopilotTime,
        velocity_ne: Option<Vector2<f64>>,
        sigma: f64,
    ) {
        let latency_sigma = self.latency.sigma_s();
        let blind = self.blind(now);
        let (Some(bank), Some(v)) = (&mut self.heading, velocity_ne) else { return };
        bank.velocity(measured, &v, sigma, latency_sigma);
        if blind
            && let (Some(e), Some(state)) = (bank.estimate(), &mut self.state)
            && let Some(r) = state.r_body_to_ned().and_then(|r| tilted_as(&r, &e.r_body_to_ned))
        {
            state.r_hat = r;
            state.gyro_bias = e.gyro_bias;
            state.xi_ned = Vector3::zeros();
        }
    }

    /// The heading, once motion has shown it.
    pub(super) fn heading_found(&self) -> Option<HeadingEstimate> {
        self.heading.as_ref()?.found()
    }

    /// Observer and filter start at what the bank has found.
    pub(super) fn align_by_motion(&mut self, now: AutopilotTime, e: &HeadingEstimate) {
        self.take_fix_over();
        if let Some(state) = &mut self.state {
            state.r_hat = e.r_body_to_ned;
            state.gyro_bias = e.gyro_bias;
            state.xi_ned = Vector3::zeros();
            state.velocity_ned.x = e.velocity_ne.x;
            state.velocity_ned.y = e.velocity_ne.y;
        }
        self.start_kalman_as(
            now,
            &StartSigmas {
                tilt: e.tilt_sigma.max(START_TILT),
                yaw: e.heading_sigma.max(LEAST_YAW),
                velocity: e.velocity_sigma.max(START_VELOCITY),
                gyro_bias: e.gyro_bias_sigma,
                gyro_noise: e.gyro_vibration,
                accel_noise: e.accel_vibration,
            },
        );
        // What is remembered was remembered at another heading.
        self.history.clear();
        self.heading = None;
        self.heading_by_motion = true;
        self.tell(now, What::HeadingFound(e.heading_sigma));
    }

    /// Whether the observer has no direction but gravity.
    fn blind(&self, now: AutopilotTime) -> bool {
        let flowing = self.flow_body.is_some_and(|(t, _)| now.seconds_since(t) < FLOW_AGE_S);
        !flowing && !self.has_magnetometer(now)
    }

    /// Whether the heading came from motion and the observer has still nothing to find it by.
    pub(super) fn led(&self, now: AutopilotTime) -> bool {
        self.heading_by_motion && self.blind(now)
    }

    /// A blind observer follows the filter: left alone it would drift, and start the filter from there one day.
    pub(super) fn lead_observer(&mut self, now: AutopilotTime) {
        if self.led(now)
            && let (Some(kalman), Some(state)) = (&self.kalman, &mut self.state)
        {
            state.r_hat = kalman.filter.state().r_body_to_ned;
            state.gyro_bias = kalman.filter.state().gyro_bias;
            state.xi_ned = Vector3::zeros();
        }
    }
}

/// The attitude with the tilt of `other` that is nearest to `r`: its heading, as far as there is one.
fn tilted_as(r: &Matrix3<f64>, other: &Matrix3<f64>) -> Option<Matrix3<f64>> {
    let down = r * other.row(2).transpose();
    let axis = down.cross(&Vector3::z());
    let angle = axis.norm().atan2(down.z);
    let turn = axis.try_normalize(1e-9).map_or(Matrix3::identity(), |axis| so3::exp(&(axis * angle)));
    polar_rotation(&(turn * r))
}
