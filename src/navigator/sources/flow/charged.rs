//! What inertia holds against a flow sensor; and what is kept of before, to go back to.

use nalgebra::{Vector2, Vector3};

use crate::camera::FlowCalibration;
use crate::geo::{NOMINAL_GRAVITY_MPS2, so3};
use crate::sample::Airframe;
use crate::time::AutopilotTime;

use super::super::super::context::Context;
use super::super::super::monitor::inertia_jumps::InertiaJumps;
use super::super::super::solution::Mode;
use super::super::super::timeline::Timeline;
use super::super::drag::DragSource;
use super::super::parting::{LedAway, Parted};
use super::super::status::{SourceId, SourceKind};
use super::witness::{Contradiction, FlowAndInertia};
use super::{FlowSensor, FlowSource, MeasuredFlow, gnss_velocity};
use crate::navigator::tuning::flow::{BACK, CALIBRATION_KEPT_S, KNOWN, OFF_S, OTHERWISE_S, SPEAKS};

/// What inertia says of a flow sensor that is news.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(in super::super::super) enum FlowFinding {
    /// It contradicts inertia; until then it still fitted. It may be inertia that has led away, so.
    Astray { since: AutopilotTime, or_led: Option<LedAway> },
    /// It does, and it is inertia that has led away.
    LedAway(LedAway),
    /// It follows inertia again.
    Back,
}

/// A flow that contradicts inertia: what it had gone by when that was found, and a mean of late of what it is off the filter's velocity by, NE, m/s, and the most that was.
#[derive(Clone, Copy, Debug)]
pub(super) struct Astray {
    pub(super) went_ne: Vector2<f64>,
    pub(super) off_ne: Vector2<f64>,
    pub(super) most_mps: f64,
}

impl Astray {
    /// Takes a difference, NE, m/s, `dt` s after the last.
    pub(super) fn note(&mut self, off_ne: &Vector2<f64>, dt: f64) {
        self.off_ne += (off_ne - self.off_ne) * (dt / OFF_S).min(1.0);
        self.most_mps = self.most_mps.max(self.off_ne.norm());
    }

    /// Changes that fit do not show a constant error: the flow has to have come back as well, to a velocity that is known to `sigma_mps`, or by a step that takes
    /// back the one that it was found by. By chance an estimate that nothing carries meets any flow.
    pub(super) fn is_back(&self, sigma_mps: f64, stepped: bool) -> bool {
        (stepped || sigma_mps < KNOWN * self.most_mps) && self.off_ne.norm() < BACK * self.most_mps
    }
}

/// The calibration as it was some seconds ago: what a flow teaches before it is found to be wrong is taken back.
#[derive(Clone, Debug)]
pub(super) struct KeptCalibration {
    pub(super) since: Option<AutopilotTime>,
    /// The older is at least [`CALIBRATION_KEPT_S`] old.
    pub(super) older: FlowCalibration,
    pub(super) newer: FlowCalibration,
}

/// What the gyros have turned the heading by since some time, rad, and the last sample's time.
#[derive(Clone, Copy, Debug, Default)]
pub(super) struct HeadingByGyro {
    pub(super) last: Option<AutopilotTime>,
    pub(super) turned: f64,
}

impl HeadingByGyro {
    /// What the heading was corrected by since some time, when it was turned to `r_body_to_ned`, rad.
    pub(super) fn corrected(&mut self, m: &MeasuredFlow, timeline: &Timeline) -> f64 {
        let r = &m.r_body_to_ned;
        if let Some(last) = self.last.replace(m.time)
            && let Some(rate_body) = timeline.mean_rate(last, m.time)
        {
            self.turned += (r * rate_body).z * m.time.seconds_since(last).max(0.0);
        }
        let corrected = so3::wrap_pi(r[(1, 0)].atan2(r[(0, 0)]) - self.turned);
        // Far from ±π, so that means of it are means.
        self.turned += if corrected.abs() > 1.0 { corrected } else { 0.0 };
        if corrected.abs() > 1.0 { 0.0 } else { corrected }
    }
}

impl FlowSensor {
    /// The calibration is kept while nothing speaks against it.
    fn keep_calibration(&mut self, now: AutopilotTime) {
        let kept = &mut self.kept;
        if kept.since.is_none_or(|t| now.seconds_since(t) > CALIBRATION_KEPT_S) {
            kept.since = Some(now);
            kept.older.clone_from(&kept.newer);
            kept.newer.clone_from(&self.calibration);
        }
    }

    /// A flow with what it is compared with.
    fn against_inertia(&mut self, m: &MeasuredFlow, context: &Context<'_>) -> Option<FlowAndInertia> {
        let core = context.core;
        let climb_mps = core.height.climb_mps();
        let in_ned = |v_xy: &Vector2<f64>| (m.r_body_to_ned * m.in_body(v_xy, climb_mps)).xy();
        let reference = if core.mode == Mode::Aided { gnss_velocity(m, context) } else { None };
        let tilt = core.attitude_variance(&context.facts).xy().max().max(0.0).sqrt();
        let (errors, scale_variance) = &self.errors;
        let multirotor = core.vehicle.is(Airframe::Multirotor);
        Some(FlowAndInertia {
            time: m.time,
            v_ne: in_ned(&FlowCalibration::undo(errors, &m.v_xy, m.distance_m)),
            impulse_ne: core.timeline.impulse(m.time)?.xy(),
            sideways_ne: multirotor.then(|| core.timeline.sideways(m.time)).flatten().map(|w| w.xy()),
            held_ne: core.estimator.estimate()?.1.xy(),
            reference_ne: reference.map(|v_xy| in_ned(&v_xy)),
            variance: 0.5 * m.noise.trace() * self.calibration.noise_factor(),
            scale_variance: scale_variance + m.relative_sigma * m.relative_sigma,
            accel_sigma: NOMINAL_GRAVITY_MPS2 * tilt,
            corrected: self.heading.corrected(m, &core.timeline),
            epoch: core.timeline.epoch(),
        })
    }

    /// It contradicts inertia: what it has taught of late is forgotten.
    fn go_astray(&mut self, went_ne: Vector2<f64>) {
        self.astray = Some(Astray { went_ne, off_ne: went_ne, most_mps: went_ne.norm() });
        self.calibration.clone_from(&self.kept.older);
        self.kept.newer.clone_from(&self.kept.older);
    }

    /// Whether a flow that had gone astray, and now is `off_ne` from the filter's velocity, m/s, which is known to `sigma_mps`, has come back.
    fn may_return(&mut self, off_ne: &Vector2<f64>, sigma_mps: f64, m: &MeasuredFlow) -> bool {
        match &mut self.astray {
            Some(astray) => {
                astray.note(off_ne, m.interval_s);
                let stepped = self.witness.stepped_back();
                let back = self.witness.follows() && astray.is_back(sigma_mps, stepped);
                if back {
                    self.astray = None;
                    self.witness.forget();
                }
                back
            }
            None => {
                if !self.witness.is_doubted() {
                    self.keep_calibration(m.time);
                }
                false
            }
        }
    }
}

/// What a sensor's distance comes from, and its scale error by the filter, with its variance, while that was a rangefinder.
#[derive(Clone, Copy, Debug, Default)]
pub(super) struct ScaledBy {
    unranged: bool,
    /// For how long it has been the other way, s.
    otherwise_s: f64,
    by_range: Option<(f64, f64)>,
}

impl ScaledBy {
    /// Takes a flow, and what the filter holds its scale error to be, with its variance. What that is from now on when a rangefinder has been
    /// lost, or is back: without it the distance is wrong by a part of itself for as long as it is lost, and with it the scale is what it was.
    fn note(&mut self, m: &MeasuredFlow, (scale, variance): (f64, f64)) -> Option<(f64, f64)> {
        self.otherwise_s = if m.ranged == self.unranged { self.otherwise_s + m.interval_s } else { 0.0 };
        if !self.unranged && m.ranged {
            self.by_range = Some((scale, variance));
        }
        let (scale, variance) = self.by_range.filter(|_| self.otherwise_s > OTHERWISE_S)?;
        self.unranged = !self.unranged;
        self.otherwise_s = 0.0;
        let lost = if self.unranged { m.relative_sigma } else { 0.0 };
        Some((scale, variance.max(0.0).sqrt().hypot(lost)))
    }
}

impl FlowSource {
    /// What the filter has to take the scale error of the sensor that carries for from now on, with its standard deviation, where the distance
    /// comes from something else since this flow.
    pub(in super::super::super) fn rescaled(
        &mut self,
        m: &MeasuredFlow,
        index: usize,
        context: &Context<'_>,
    ) -> Option<(f64, f64)> {
        let (x, p) = context.core.estimator.flow_errors()?;
        let carries = self.carrier(context.core) == Some(index);
        self.sensors[index].scaled_by.note(m, (x[2], p[(2, 2)])).filter(|_| carries)
    }

    /// What inertia says of a flow; see [`super::witness`]. A sensor that GNSS agrees with, or rotor drag, is not held for wrong by inertia alone.
    pub(in super::super::super) fn weigh(
        &mut self,
        m: &MeasuredFlow,
        index: usize,
        drag: &DragSource,
        context: &Context<'_>,
    ) -> Option<FlowFinding> {
        let core = context.core;
        let inertial = SourceId::only(SourceKind::Imu);
        let by_filter = core.estimator.flow_errors().filter(|_| self.carrier(core) == Some(index));
        let sensor = &mut self.sensors[index];
        if core.statuses.charge(inertial).is_some() {
            // The witness is a liar, or was until now: what it has said does not hold.
            sensor.witness.forget();
            return sensor.astray.take().map(|_| FlowFinding::Back);
        }
        let weighed = sensor.may_carry(core) && core.estimator.has_error_state();
        if sensor.astray.is_none() && !weighed {
            // Nobody builds on it; or an observer alone does, whose tilt is no witness, and which could take nothing back.
            sensor.witness.forget();
            return None;
        }
        if sensor.astray.is_none() {
            let own = (*sensor.calibration.estimate(), *sensor.calibration.covariance());
            let (x, p) = by_filter.unwrap_or(own);
            sensor.errors = (x, p[(2, 2)] + p[(3, 3)]);
        }
        let (_, v_ned) = core.estimator.estimate()?;
        let compared = sensor.against_inertia(m, context)?;
        match sensor.witness.note(&compared, sensor.astray.as_ref().map(|astray| &astray.went_ne)) {
            // Where drag agrees with it, or all other measurements together, it is inertia that has gone.
            Some(found)
                if core.witnesses.jumps.suspects_without_flow(core.estimator.jump_windows())
                    || found.is_denied_by(drag, v_ned.z, context) =>
            {
                sensor.witness.forget();
                Some(FlowFinding::LedAway(found.led))
            }
            // … and where they parted as it leads away, if the filter's innovations do not speak for a change of the flow.
            Some(Contradiction { parted: Parted::LedAway(led), by_thrust_too, .. })
                if !InertiaJumps::favour_flow(core.estimator.jump_windows(), by_thrust_too) =>
            {
                sensor.witness.forget();
                Some(FlowFinding::LedAway(led))
            }
            Some(found) => {
                sensor.go_astray(found.apart_ne);
                Some(FlowFinding::Astray { since: found.fitted, or_led: found.parted.led() })
            }
            None => {
                let sigma_mps = core.estimator.speed_sigma().unwrap_or(f64::INFINITY);
                let back = sensor.may_return(&(compared.v_ne - v_ned.xy()), sigma_mps, m);
                back.then_some(FlowFinding::Back)
            }
        }
    }
}

impl Contradiction {
    /// Whether rotor drag speaks for the flow: two against one.
    fn is_denied_by(&self, drag: &DragSource, down_mps: f64, context: &Context<'_>) -> bool {
        let level = |v_ne: Vector2<f64>| Vector3::new(v_ne.x, v_ne.y, down_mps);
        let (by_flow, by_inertia) = (level(self.v_ne), level(self.v_ne - self.apart_ne));
        drag.speaks_for(context, &by_flow, &by_inertia).is_some_and(|more| more > SPEAKS)
    }
}
