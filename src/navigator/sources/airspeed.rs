//! Airspeed, and the nose of a fixed wing in the wind: what carries the velocity where there is no flow.
//!
//! With GNSS the filter learns the wind and the airspeed's scale in turns; without, airspeed and heading less the wind are a velocity
//! whose error grows as slowly as the wind changes.

use nalgebra::{Vector2, Vector3};

use crate::geo::atmosphere::true_airspeed_factor;
use crate::sample::{Airframe, AirspeedSample};
use crate::time::AutopilotTime;

use super::super::context::{Context, SourceFacts};
use super::super::core::Core;
use super::super::estimator::expected_airspeed;
use super::super::observation::{Fused, Observation};
use super::super::reset::Reset;
use super::super::settings::Estimator;
use super::super::verdict::{Reason, Verdict};
use super::airspeed_refit::{Deviation, RefitPrior, WindRefit};
pub(in super::super) use super::airspeed_watch::AirFinding;
use super::airspeed_watch::{AirspeedWatch, WeighedAirspeed};
use super::status::Measured;
use crate::geo::NOMINAL_GRAVITY_MPS2;
use crate::navigator::tuning::airspeed::{CARRIES_S, MAX_LOAD_G, MOST_MPS, SAMPLE_INTERVAL_S, STUCK_S};
use crate::navigator::tuning::every_source::LATE_S;

/// Settings of the airspeed.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct AirSettings {
    /// Use it.
    pub enabled: bool,
    /// Below this it is not used, m/s.
    pub min_mps: f64,
    /// Standard deviation with gusts, m/s.
    pub sigma_mps: f64,
    /// Standard deviation of the sideslip, rad; 0 does not use it.
    pub sideslip_sigma_rad: f64,
}

/// The newest airspeed, and the newest that was used.
#[derive(Clone, Copy, Debug, Default)]
pub(in super::super) struct AirspeedSource {
    heard: Option<AutopilotTime>,
    /// Since when it has told the same, and what, m/s.
    same: Option<(AutopilotTime, f64)>,
    used: Option<AutopilotTime>,
    watch: AirspeedWatch,
    /// Whether another wind explains it, while GNSS is there.
    refit: WindRefit,
    /// GNSS was there when it was last weighed.
    aided: bool,
}

/// An airspeed that can be weighed, and what it would be used as.
#[derive(Clone, Copy, Debug)]
pub(in super::super) struct MeasuredAirspeed {
    pub(in super::super) time: AutopilotTime,
    /// True airspeed and its noise, m/s.
    pub(in super::super) speed_mps: f64,
    sigma_mps: f64,
    sideslip_sigma_rad: Option<f64>,
    /// The load is one that lets it fly nose first.
    nose_first: bool,
}

impl MeasuredAirspeed {
    pub(in super::super) fn observation(&self) -> Observation {
        let &Self { speed_mps, sigma_mps, sideslip_sigma_rad, .. } = self;
        Observation::Airspeed { speed_mps, sigma_mps, sideslip_sigma_rad }
    }
}

impl AirspeedSource {
    /// When it last corrected the velocity.
    pub(super) fn used(&self) -> Option<AutopilotTime> {
        self.used
    }

    pub(in super::super) fn observe(
        &mut self,
        s: &AirspeedSample,
        context: &Context<'_>,
    ) -> Result<MeasuredAirspeed, Reason> {
        let core = context.core;
        let air = &core.settings.air;
        if !s.airspeed_mps.is_finite() {
            return Err(Reason::NotFinite);
        }
        if s.airspeed_mps.abs() > MOST_MPS {
            return Err(Reason::OutOfRange);
        }
        if !air.enabled || core.settings.estimator == Estimator::Ekf15 || core.coasts() {
            return Err(Reason::SwitchedOff);
        }
        if !core.vehicle.is(Airframe::FixedWing) {
            return Err(Reason::NotUsed);
        }
        if self.heard.is_some_and(|t| s.time <= t) {
            return Err(Reason::OutOfOrder);
        }
        if context.is_late(s.time, LATE_S) {
            return Err(Reason::Late);
        }
        let interval_s = self.heard.map_or(SAMPLE_INTERVAL_S, |t| s.time.seconds_since(t));
        self.heard = Some(s.time);
        if self.repeats(s) {
            return Err(Reason::Stuck);
        }
        let environment = core.surroundings.environment().ok_or(Reason::NoReferenceYet)?;
        let above_sea = environment.frame.origin().height_m + core.height.height_m().unwrap_or_default();
        let speed_mps = s.airspeed_mps * true_airspeed_factor(above_sea);
        if core.estimator.filter_state().is_none() {
            return Err(Reason::NoReferenceYet);
        }
        let often = (SAMPLE_INTERVAL_S / interval_s.max(1e-3)).max(1.0).sqrt();
        let load = core
            .stream
            .last()
            .map_or(f64::INFINITY, |i| i.specific_force.raw().norm() / NOMINAL_GRAVITY_MPS2);
        let nose_first = load < MAX_LOAD_G;
        let sideslip_sigma_rad =
            (nose_first && air.sideslip_sigma_rad > 0.0).then_some(air.sideslip_sigma_rad * often);
        Ok(MeasuredAirspeed {
            time: s.time,
            speed_mps,
            sigma_mps: air.sigma_mps * often,
            sideslip_sigma_rad,
            nose_first,
        })
    }

    /// The velocity through the air, NE, m/s, and the wind, by an airspeed along the nose: nothing of it is by way of GNSS.
    pub(in super::super) fn through_air(
        &self,
        m: &MeasuredAirspeed,
        core: &Core,
    ) -> Option<(Vector2<f64>, Vector2<f64>)> {
        let state = core.estimator.filter_state().filter(|_| m.nose_first)?;
        let nose_ne = state.r_body_to_ned.column(0).xy().try_normalize(0.1)?;
        let climb_mps = core.height.climb_mps();
        let level_mps = (m.speed_mps * m.speed_mps - climb_mps * climb_mps).max(0.0).sqrt();
        Some((nose_ne * level_mps, state.wind_ne))
    }

    /// Weighs what it tells against what the filter expects, while the vehicle flies.
    pub(in super::super) fn weigh(
        &mut self,
        m: &MeasuredAirspeed,
        context: &Context<'_>,
    ) -> Option<AirFinding> {
        let core = context.core;
        let gnss = !core.dead_reckoning();
        if gnss && !std::mem::replace(&mut self.aided, gnss) {
            // What the wind did in the outage was not seen.
            self.watch.doubt();
        }
        self.aided = gnss;
        let air = &core.settings.air;
        let flies = core.estimator.estimate().is_some_and(|(_, v)| v.xy().norm() > air.min_mps);
        let expected = expected_airspeed(&core.estimator).filter(|(mps, _)| *mps > air.min_mps);
        // Before it has told an airspeed there is none that it could have lost.
        let begun = self.used.is_some() || self.watch.is_astray();
        let Some((expected, variance)) = expected.filter(|_| flies && begun) else {
            self.watch.pause();
            return None;
        };
        if let Some((force_ned, _)) = felt(core) {
            self.watch.expect(expected, force_ned);
        }
        if !m.nose_first {
            return None;
        }
        let tilt =
            core.estimator.attitude_covariance().map_or(0.0, |c| (0.5 * (c[(0, 0)] + c[(1, 1)])).sqrt());
        if self.watch.is_astray() && gnss {
            let state = core.estimator.filter_state()?;
            let air_ne = state.velocity_ned.xy() - state.wind_ne;
            let off = m.speed_mps - expected;
            let speed = state.air_velocity_body().norm();
            let air = &core.settings.kalman.air;
            let (wind, scale) = (air.wind_sigma, air.airspeed_scale_sigma);
            let prior = RefitPrior { wind, scale, scale_now: state.airspeed_scale };
            let deviation = Deviation { off, sigma: m.sigma_mps, air_ne, speed };
            if let Some((change, sigma)) = self.refit.add(&deviation, &prior) {
                self.watch.believe();
                return Some(AirFinding::AnotherWind(change, sigma));
            }
        } else {
            self.refit = WindRefit::default();
        }
        self.watch.weigh(&WeighedAirspeed {
            time: m.time,
            told: m.speed_mps,
            expected,
            variance,
            tilt,
            gusts: air.sigma_mps,
            scale: core.settings.kalman.air.airspeed_scale_sigma,
            gnss,
            along_ne: felt(core)?.1.xy(),
            impulse_ne: core.timeline.impulse(m.time).map(|impulse| impulse.xy()),
            epoch: core.timeline.epoch(),
        })
    }

    /// Whether it can be used.
    pub(in super::super) fn stands(
        &self,
        m: &MeasuredAirspeed,
        settings: &AirSettings,
    ) -> Result<(), Reason> {
        if !self.watch.fits() {
            return Err(Reason::Innovation);
        }
        if m.speed_mps < settings.min_mps { Err(Reason::TooSlow) } else { Ok(()) }
    }

    /// Whether it has told the same for longer than air lets it; until it tells another.
    fn repeats(&mut self, s: &AirspeedSample) -> bool {
        let same = self.same.filter(|(_, mps)| *mps == s.airspeed_mps).unwrap_or((s.time, s.airspeed_mps));
        self.same = Some(same);
        s.airspeed_mps > 0.0 && s.time.seconds_since(same.0) > STUCK_S
    }

    /// What became of an airspeed of this time.
    pub(in super::super) fn fused(&mut self, time: AutopilotTime, fused: &Fused, core: &Core) -> Verdict {
        if !fused.took(Measured::Airspeed) {
            return Verdict::Rejected(Reason::Innovation);
        }
        if let Some(((expected, _), (force_ned, along))) = expected_airspeed(&core.estimator).zip(felt(core))
        {
            self.watch.followed(expected, &force_ned, &along);
        }
        self.used = Some(time);
        Verdict::Used
    }

    pub(super) fn reset(&mut self, reset: &Reset) {
        if reset.sets_clock_back() {
            *self = Self::default();
        }
    }
}

/// The newest specific force by the filter's attitude and bias, NED, m/s², and the direction of the velocity through the air.
fn felt(core: &Core) -> Option<(Vector3<f64>, Vector3<f64>)> {
    let (state, last) = core.estimator.filter_state().zip(core.stream.last())?;
    let air_ned = state.r_body_to_ned * state.air_velocity_body();
    let along = air_ned.try_normalize(1e-3)?;
    Some((state.r_body_to_ned * (last.specific_force.raw() - state.accel_bias), along))
}

/// Whether airspeed carries the velocity at present.
pub(in super::super) fn carries(facts: &SourceFacts, now: AutopilotTime) -> bool {
    facts.airspeed_used.is_some_and(|t| now.seconds_since(t) < CARRIES_S)
}
