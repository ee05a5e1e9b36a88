//! One shadow: the filter as it was when GNSS was there, without it since.

use nalgebra::{Matrix2, Vector2, Vector3};

use crate::filter::error_state::JumpWindow;
use crate::geo::Body;
use crate::sample::ImuSample;
use crate::time::{AutopilotTime, Span};

use super::super::environment::LocalEnvironment;
use super::super::estimator::{ErrorStateStage, FilterPast};
use super::super::observation::{Fused, Observation};
use super::super::solution::VelocitySource;
use super::super::timeline::Timeline;
use crate::navigator::tuning::shadow::{
    CARRIED_PART, COVARIANCE_STEP_S, FLOW_PERIOD_S, HEIGHT_PERIOD_S, MAGNETIC_PERIOD_S, STEP_S,
};

/// What a shadow goes on with.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) enum Goes {
    /// Everything but GNSS.
    Carried,
    /// The same without flow.
    WithoutFlow,
    /// Inertia, magnetometer and height.
    Coasting,
}

/// What stands beside the observations while a shadow goes on.
#[derive(Clone, Copy, Debug)]
pub(super) struct Present {
    /// What would carry an outage now.
    pub(super) carrier: VelocitySource,
    /// Airspeed or drag, whichever can carry.
    pub(super) air: Option<VelocitySource>,
    /// The vehicle is in the air.
    pub(super) flies: bool,
}

/// IMU samples since the last step, summed over their time.
#[derive(Clone, Copy, Debug, Default)]
struct ImuSum {
    seconds: f64,
    angle: Vector3<f64>,
    impulse: Vector3<f64>,
}

/// How long each has carried, s.
#[derive(Clone, Copy, Debug, Default)]
struct CarriedSeconds {
    flow: f64,
    air: f64,
    inertial: f64,
    /// Of all that, in the air.
    flown: f64,
}

/// See the module's documentation.
#[derive(Clone, Debug)]
pub(super) struct Run {
    stage: ErrorStateStage,
    pub(super) goes: Goes,
    started: AutopilotTime,
    /// Of the position at the start, NE, m².
    start: Matrix2<f64>,
    flow_due: AutopilotTime,
    mean: ImuSum,
    carried: CarriedSeconds,
    /// The horizons before this one are done.
    pub(super) horizon: usize,
}

/// How far a shadow is off.
#[derive(Clone, Copy, Debug)]
pub(super) struct Drifted {
    /// A fix less the shadow at its time, NE, m.
    pub(super) error: Vector2<f64>,
    /// Covariance of its position, and what it was at the start, NE, m².
    pub(super) claimed: Matrix2<f64>,
    pub(super) start: Matrix2<f64>,
}

impl Run {
    /// Begins where the filter is, and knows it as well.
    pub(super) fn start(now: AutopilotTime, from: &ErrorStateStage, goes: Goes) -> Self {
        let stage =
            from.shadow(COVARIANCE_STEP_S, [MAGNETIC_PERIOD_S, HEIGHT_PERIOD_S], goes == Goes::Carried);
        let start = stage.filter().position_covariance().fixed_view::<2, 2>(0, 0).into_owned();
        let (mean, carried) = (ImuSum::default(), CarriedSeconds::default());
        Self { stage, goes, started: now, start, flow_due: now, mean, carried, horizon: 0 }
    }

    /// Its age at a time, s.
    pub(super) fn age_s(&self, at: AutopilotTime) -> f64 {
        at.seconds_since(self.started)
    }

    /// What its innovations show of jumps of the IMU's axes.
    pub(super) fn jump_windows(&self) -> &[JumpWindow] {
        self.stage.filter().jump_windows()
    }

    /// What has carried it, if one has for nearly all of its time and it flew.
    pub(super) fn carrier(&self) -> Option<VelocitySource> {
        let CarriedSeconds { flow, air, inertial, flown } = self.carried;
        let most = CARRIED_PART * (flow + air + inertial);
        let by = [
            (VelocitySource::Flow, flow),
            (VelocitySource::Airspeed, air),
            (VelocitySource::Inertial, inertial),
        ];
        by.into_iter().find(|(_, s)| *s >= most && flown >= most).map(|(source, _)| source)
    }

    /// One IMU sample. False when it is not finite any more.
    pub(super) fn step(
        &mut self,
        s: &ImuSample,
        dt: f64,
        environment: &LocalEnvironment,
        height_m: Option<f64>,
        present: &Present,
    ) -> bool {
        self.mean.seconds += dt;
        self.mean.angle += s.angular_rate.raw() * dt;
        self.mean.impulse += s.specific_force.raw() * dt;
        let seconds = match present.carrier {
            _ if self.goes == Goes::Coasting => &mut self.carried.inertial,
            _ if self.goes == Goes::WithoutFlow && present.air.is_some() => &mut self.carried.air,
            _ if self.goes == Goes::WithoutFlow => &mut self.carried.inertial,
            VelocitySource::Flow => &mut self.carried.flow,
            VelocitySource::Airspeed | VelocitySource::Drag => &mut self.carried.air,
            _ => &mut self.carried.inertial,
        };
        *seconds += dt;
        if present.flies {
            self.carried.flown += dt;
        }
        self.mean.seconds < STEP_S || self.catch_up(s.time, environment, height_m)
    }

    /// Goes on by what was felt since the last step. False when it is not finite any more.
    fn catch_up(
        &mut self,
        now: AutopilotTime,
        environment: &LocalEnvironment,
        height_m: Option<f64>,
    ) -> bool {
        let ImuSum { seconds, angle, impulse } = std::mem::take(&mut self.mean);
        if seconds <= 0.0 {
            return true;
        }
        let mean = ImuSample {
            time: now,
            angular_rate: Body::new(angle / seconds),
            specific_force: Body::new(impulse / seconds),
        };
        self.stage.step(&mean, seconds, environment, height_m, &mut Fused::nothing()).is_some()
    }

    /// Takes what the filter is about to take, unless it is GNSS's, or this shadow goes on without.
    pub(super) fn observe(
        &mut self,
        now: AutopilotTime,
        observation: &Observation,
        filter: &ErrorStateStage,
        (timeline, environment): (&Timeline, &LocalEnvironment),
        present: &Present,
    ) {
        let takes = match observation {
            Observation::Fix { .. } | Observation::Pose { .. } => false,
            Observation::Magnetic { .. } | Observation::Standstill { .. } => true,
            // As in an outage: a flow that carries knows the velocity better than gusts let the drag know it.
            Observation::Drag { .. } => match self.goes {
                Goes::Carried => present.carrier != VelocitySource::Flow,
                Goes::WithoutFlow => true,
                Goes::Coasting => false,
            },
            Observation::Flow { .. } => self.goes == Goes::Carried && now >= self.flow_due,
            Observation::Airspeed { .. } => self.goes != Goes::Coasting,
        };
        if takes && matches!(observation, Observation::Flow { .. }) {
            self.flow_due = now + Span::from_seconds(FLOW_PERIOD_S);
        }
        if takes {
            self.catch_up(now, environment, None);
            let past = FilterPast::beside(timeline, self.stage.filter().state(), filter.filter().state());
            self.stage.fuse(now, observation, &past, environment, &mut Fused::nothing());
        }
    }

    /// How far a fix of `measured`, which lies `error` from the filter at that time, NE, m, is from the shadow.
    pub(super) fn drifted(
        &mut self,
        now: AutopilotTime,
        measured: AutopilotTime,
        error: &Vector2<f64>,
        filter: &ErrorStateStage,
        environment: &LocalEnvironment,
    ) -> Drifted {
        self.catch_up(now, environment, None);
        let (own, theirs) = (self.stage.filter().state(), filter.filter().state());
        let apart = own.position_ned - theirs.position_ned;
        let faster = own.velocity_ned - theirs.velocity_ned;
        Drifted {
            error: error - (apart - faster * now.seconds_since(measured)).xy(),
            claimed: self.stage.filter().position_covariance().fixed_view::<2, 2>(0, 0).into_owned(),
            start: self.start,
        }
    }
}
