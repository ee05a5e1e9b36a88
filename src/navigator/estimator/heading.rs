//! Heading from motion, for a vehicle that has nothing better: the bank of [`crate::filter::heading_bank`], fed while aligning.

use nalgebra::{Matrix3, Vector2, Vector3};

use crate::filter::{HeadingBank, HeadingBankSettings, HeadingEstimate};
use crate::geo::{polar_rotation, so3};
use crate::sample::ImuSample;
use crate::time::AutopilotTime;

use super::error_state::StartSigmas;
use crate::navigator::tuning::error_state::{START_TILT, START_VELOCITY};
use crate::navigator::tuning::heading::LEAST_YAW;

/// The search for a heading, and whether the one that is flown on came from it.
#[derive(Clone, Debug, Default)]
pub(super) struct HeadingSearch {
    bank: Option<HeadingBank>,
    by_motion: bool,
}

impl HeadingSearch {
    /// An IMU sample while a heading is sought. True when the search begins with it.
    pub(super) fn seek(&mut self, s: &ImuSample, dt: f64, gravity_mps2: f64, shared_instants: bool) -> bool {
        let begins = self.bank.is_none();
        let bank = self.bank.get_or_insert_with(|| {
            let settings = HeadingBankSettings { shared_instants, ..HeadingBankSettings::standard() };
            HeadingBank::new(settings, gravity_mps2)
        });
        bank.imu(s.time, dt, &s.angular_rate.raw(), &s.specific_force.raw());
        begins
    }

    /// Nobody seeks a heading any more.
    pub(super) fn stop(&mut self) {
        self.bank = None;
    }

    /// A velocity of GNSS. What the bank believes with it, while it seeks.
    pub(super) fn weigh(
        &mut self,
        measured: AutopilotTime,
        v: &Vector2<f64>,
        sigma: f64,
        latency_sigma: f64,
    ) -> Option<HeadingEstimate> {
        let bank = self.bank.as_mut()?;
        bank.velocity(measured, v, sigma, latency_sigma);
        bank.estimate()
    }

    /// The heading, once motion has shown it.
    pub(super) fn found(&self) -> Option<HeadingEstimate> {
        self.bank.as_ref()?.found()
    }

    /// The heading that was found is flown on.
    pub(super) fn fly_on(&mut self) {
        self.bank = None;
        self.by_motion = true;
    }

    /// Whether the heading that is flown on came from motion.
    pub(super) fn by_motion(&self) -> bool {
        self.by_motion
    }
}

/// What a filter starts from that starts at the bank's estimate.
pub(super) fn start_sigmas(e: &HeadingEstimate) -> StartSigmas {
    StartSigmas {
        tilt: e.tilt_sigma.max(START_TILT),
        yaw: e.heading_sigma.max(LEAST_YAW),
        velocity: e.velocity_sigma.max(START_VELOCITY),
        gyro_bias: e.gyro_bias_sigma,
    }
}

/// The attitude with the tilt of `other` that is nearest to `r`: its heading, as far as there is one.
pub(super) fn tilted_as(r: &Matrix3<f64>, other: &Matrix3<f64>) -> Option<Matrix3<f64>> {
    let down = r * other.row(2).transpose();
    let axis = down.cross(&Vector3::z());
    let angle = axis.norm().atan2(down.z);
    let turn = axis.try_normalize(1e-9).map_or(Matrix3::identity(), |axis| so3::exp(&(axis * angle)));
    polar_rotation(&(turn * r))
}
