//! The exogenous Kalman filter in the navigator: a second stage over whichever observer is in force (`xkf`).
//!
//! The observers run as for `nlo`. When the observer has converged, and only then, the second stage starts from it, linearised about its
//! trajectory; what the second stage estimates is published and never goes back into the observer. It starts anew when the two disagree
//! for long, or when trusted fixes do not fit it, and it is given up while there is no trajectory to be linearised about (the nose near
//! the vertical), the observer being published then. With GNSS its biases are estimated; in holdover they are frozen, and as the
//! covariance then says nothing of them, the error budget is added to it.
//!
//! The flow's systematic errors are taken out by the calibration before it sees the flow, as for the observers.

use nalgebra::Vector3;

use crate::geo::so3;
use crate::observer::{BiasMode, EulerState, ObserverState, SpecificForceForm, Xkf, XkfInput, XkfSettings};
use crate::sample::ImuSample;
use crate::time::{AutopilotTime, Span};

use super::super::environment::LocalEnvironment;
use super::super::observation::{Fused, Observation};
use super::super::solution::Mode;
use super::super::sources::status::Measured;
use super::super::timeline::Timeline;
use super::error_state::StartPoint;
use super::step::{Progress, StepInput, Stepped, Watch};
use crate::navigator::tuning::error_state::{
    HEIGHT_PERIOD_S, HEIGHT_SIGMA_M, MAGNETIC_PERIOD_S, START_ACCEL_BIAS, START_GYRO_BIAS, START_TILT,
    START_VELOCITY, START_YAW,
};
use crate::navigator::tuning::exogenous::NOISE_FACTOR;

/// The second stage, and when it was last fed.
#[derive(Clone, Debug)]
pub(super) struct ExogenousStage {
    filter: Xkf,
    /// The observer's newest state: what is linearised about.
    about: EulerState,
    magnetic_due: AutopilotTime,
    height_due: AutopilotTime,
    pub(super) watch: Watch,
}

impl ExogenousStage {
    /// Starts from the observer. `None` when there is nothing to linearise about.
    pub(super) fn start(
        now: AutopilotTime,
        observed: &ObserverState,
        from: &StartPoint<'_>,
        flow_bias_time_constant_s: f64,
    ) -> Option<Self> {
        let about = EulerState::of_observer(observed, Vector3::zeros())?;
        let k = &from.settings.kalman;
        let settings = XkfSettings {
            gyro_noise: NOISE_FACTOR * k.gyro_noise,
            accel_noise: NOISE_FACTOR * k.accel_noise,
            gyro_bias_walk: k.gyro_bias_walk,
            accel_bias_walk: k.accel_bias_walk,
            flow_bias_time_constant_s,
            gate_sigma: k.gate_sigma,
            specific_force: SpecificForceForm::WithBias,
        };
        let start = EulerState { position_ned: from.position(&about.position_ned), ..about };
        let sigma = [
            Vector3::new(START_TILT, START_TILT, START_YAW),
            from.position_sigma(),
            Vector3::repeat(START_VELOCITY),
            Vector3::repeat(START_GYRO_BIAS),
            Vector3::repeat(START_ACCEL_BIAS),
        ];
        Some(Self {
            filter: Xkf::new(settings, &start, &sigma, Vector3::zeros()),
            about,
            magnetic_due: now,
            height_due: now,
            watch: Watch::default(),
        })
    }

    pub(super) fn filter(&self) -> &Xkf {
        &self.filter
    }

    pub(super) fn filter_mut(&mut self) -> &mut Xkf {
        &mut self.filter
    }

    /// What is linearised about. Without any velocity the observer does not converge, and its trajectory is worth nothing: then the filter
    /// is linearised about its own, as any extended Kalman filter is.
    fn about(&self, observed: &ObserverState, input: &StepInput<'_>) -> Option<EulerState> {
        if input.dead_reckoning && !input.carried_by_flow {
            Some(self.filter.state()).filter(EulerState::is_regular)
        } else {
            EulerState::of_observer(observed, Vector3::zeros())
        }
    }

    /// One IMU sample, after the observer has taken it. False when the stage has to be given up.
    pub(super) fn step(
        &mut self,
        s: &ImuSample,
        dt_s: f64,
        observed: &ObserverState,
        input: &StepInput<'_>,
        fused: &mut Fused,
    ) -> bool {
        let biases = if input.dead_reckoning { BiasMode::Frozen } else { BiasMode::Estimated };
        let xkf_input = XkfInput {
            dt_s,
            angular_rate_body: s.angular_rate.raw(),
            specific_force_body: s.specific_force.raw(),
            gravity_ned: input.environment.gravity_ned,
            earth_rate_ned: input.environment.earth_rate_ned,
        };
        let predicted = self.filter.predict(&self.about, &xkf_input, biases);
        let sound = predicted.is_ok() && self.filter.is_finite();
        let Some(about) = self.about(observed, input).filter(|_| sound) else { return false };
        self.about = about;
        self.fuse_slow(s.time, input, fused);
        true
    }

    /// What of the second stage is published after a step; the signal that is injected into the observer stays the observer's own.
    pub(super) fn stepped(&self, s: &ImuSample, injected_ned: Vector3<f64>, e: &LocalEnvironment) -> Stepped {
        let state = self.filter.state();
        let r = state.r_body_to_ned();
        Stepped {
            r_body_to_ned: r,
            angular_rate_body: s.angular_rate.raw() - state.gyro_bias,
            acceleration_ned: r * (s.specific_force.raw() - state.accel_bias) + e.gravity_ned,
            injected_ned,
        }
    }

    /// Height, and the magnetic field, which is Grip's measurement.
    fn fuse_slow(&mut self, now: AutopilotTime, input: &StepInput<'_>, fused: &mut Fused) {
        if let Some(height) = input.height_m
            && now >= self.height_due
        {
            self.height_due = now + Span::from_seconds(HEIGHT_PERIOD_S);
            let innovation = -height - self.filter.state().position_ned.z;
            let result = self.filter.fuse_position(2, innovation, HEIGHT_SIGMA_M.powi(2));
            fused.note(Measured::Height, result);
        }
        let magnetic = input.magnetic.filter(|(t, _)| now.seconds_since(*t) < MAGNETIC_PERIOD_S);
        if let Some(((_, body), field)) = magnetic.zip(input.environment.field_ned)
            && now >= self.magnetic_due
        {
            self.magnetic_due = now + Span::from_seconds(MAGNETIC_PERIOD_S);
            let variance = input.settings.magnetometer.sigma_t.powi(2);
            for axis in 0..3 {
                let result = self.filter.fuse_direction(&self.about, axis, body[axis], &field, variance);
                fused.note(Measured::Magnetometer, result);
            }
        }
    }

    /// The angle between the two stages' attitudes, rad.
    pub(super) fn apart(&self) -> f64 {
        so3::angle_between(&self.filter.state().r_body_to_ned(), &self.about.r_body_to_ned())
    }

    /// Takes an observation that this filter has a model for.
    pub(super) fn fuse(&mut self, observation: &Observation, timeline: &Timeline, fused: &mut Fused) {
        match observation {
            Observation::Fix { position_error, velocity_error, sigma, .. } => {
                for axis in 0..2 {
                    // What the components before it have changed already.
                    let innovation = position_error[axis] - fused.position_ned[axis];
                    let result = self.filter.fuse_position(axis, innovation, sigma[0].powi(2));
                    fused.note(Measured::GnssPosition, result);
                }
                for axis in 0..2 {
                    let Some(error) = velocity_error else { break };
                    let innovation = error[axis] - fused.velocity_ned[axis];
                    let result = self.filter.fuse_velocity(axis, innovation, sigma[1].powi(2));
                    fused.note(Measured::GnssVelocity, result);
                }
            }
            Observation::Flow { measured, corrected_xy, r_body_to_ned, covariance, .. } => {
                let state = self.filter.state();
                let (_, velocity) =
                    timeline.motion(*measured).unwrap_or((state.position_ned, state.velocity_ned));
                let innovation = corrected_xy - r_body_to_ned.tr_mul(&velocity).xy();
                let result = self.filter.fuse_late_flow(&self.about, &innovation, &covariance.diagonal());
                fused.note_all(Measured::Flow, result);
            }
            // The paper's filter has no states for the others.
            Observation::Magnetic { .. }
            | Observation::Airspeed { .. }
            | Observation::Drag { .. }
            | Observation::Standstill { .. }
            | Observation::Pose { .. } => {}
        }
    }
}

/// One IMU sample for the stage, after the observer has taken it; it starts when the observer has converged. Where they disagree for long it
/// starts anew; how far apart they were, rad, is returned too.
pub(super) fn step(
    stage: &mut Option<Box<ExogenousStage>>,
    s: &ImuSample,
    dt: f64,
    input: &StepInput<'_>,
    progress: &Progress<'_>,
    fused: &mut Fused,
) -> (Option<Stepped>, Option<f64>) {
    let start = || {
        let time_constant = progress.flow_bias_time_constant_s;
        ExogenousStage::start(s.time, progress.observed, &input.start_point(), time_constant).map(Box::new)
    };
    let aided = input.mode == Mode::Aided;
    if stage.is_none() && aided && progress.calm {
        *stage = start();
    }
    let Some(filter) = stage else { return (None, None) };
    if !filter.step(s, dt, progress.observed, input, fused) {
        *stage = None;
        return (None, None);
    }
    let apart = aided.then(|| filter.apart());
    let restarted = apart.filter(|_| {
        filter.watch.disagrees(s.time, apart) && progress.calm && filter.watch.is_doubted(s.time)
    });
    if restarted.is_some() {
        *stage = start();
    }
    let stepped = stage.as_ref().map(|filter| filter.stepped(s, progress.injected_ned, input.environment));
    (stepped, restarted)
}
