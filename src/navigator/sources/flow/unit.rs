//! A flow that is told in a unit of the sensor's own, pixels: what one of them is worth is found while GNSS is there.
//!
//! With z = ω_x + iω_y, a flow p of unknown scale, turn and handedness is p = z/c or p = z*/c, c complex. z is what the camera should see
//! (spec of OPTICAL_FLOW_RAD): ω_y = v_x/d + r_y, ω_x = r_x − v_y/d in camera axes, with the velocity v by GNSS, the distance d of the ground and the
//! rotation r by the gyros. The regression is that of p on z, 1/c = Σ p z*/Σ|z|²: the noise is the sensor's. It runs for several ages of the
//! flow at once, since a late one would look too small; the age that explains most is believed. What is left is for the calibration.

use nalgebra::{Complex, Vector2, Vector3};

use crate::geo::Body;
use crate::sample::{FlowRotation, FlowSample};
use crate::time::{AutopilotTime, Span};

use super::super::super::context::Context;
use super::super::super::solution::Mode;
use super::super::super::verdict::Reason;
use super::FlowSource;
use super::measure::{FlowMoment, distance, moment};
use crate::navigator::tuning::flow_unit::{AGES_S, EXPLAINS, KNOWN, LASTING_S, LONGEST_S, MEMORY_S};

/// One age and handedness.
#[derive(Clone, Copy, Debug, Default)]
struct Regression {
    /// Σ|z|², Σ|p|², Σ p z*, and how many, forgotten slowly.
    expected: f64,
    told: f64,
    product: Complex<f64>,
    n: f64,
}

impl Regression {
    fn add(&mut self, told: Complex<f64>, expected: Complex<f64>, kept: f64) {
        self.expected = self.expected * kept + expected.norm_sqr();
        self.told = self.told * kept + told.norm_sqr();
        self.product = self.product * kept + told * expected.conj();
        self.n = self.n * kept + 1.0;
    }

    /// What part of the flow it explains.
    fn explained(&self) -> f64 {
        let all = self.expected * self.told;
        if all > 0.0 { self.product.norm_sqr() / all } else { 0.0 }
    }

    /// c, where it is known, from samples `dt` s apart.
    fn unit(&self, dt: f64) -> Option<Complex<f64>> {
        let explained = self.explained();
        let worth_n = self.n * (dt / LASTING_S).min(1.0);
        let relative = ((1.0 - explained) / (explained * worth_n).max(1e-9)).sqrt();
        let inverse = self.product / self.expected;
        let unit = Complex::new(1.0, 0.0) / inverse;
        if !(unit.re.is_finite() && unit.im.is_finite()) {
            return None;
        }
        (explained > EXPLAINS && relative < KNOWN && self.n * dt > MEMORY_S).then_some(unit)
    }
}

/// What is known of one sensor's unit.
#[derive(Clone, Copy, Debug, Default)]
pub(super) struct FlowUnit {
    last: Option<AutopilotTime>,
    /// By handedness (as it should be, mirrored) and age.
    regressions: [[Regression; AGES_S.len()]; 2],
    /// c, rad a unit, and whether it is mirrored.
    found: Option<(Complex<f64>, bool)>,
}

impl FlowUnit {
    /// In rad/s, once that can be told.
    fn convert(&self, told: Complex<f64>) -> Option<[f64; 2]> {
        let (unit, mirrored) = self.found?;
        let z = if mirrored { (told * unit).conj() } else { told * unit };
        Some([z.re, z.im])
    }

    /// Takes a flow of `dt` s and what the camera should have seen, by age; whether the unit is known now.
    fn learn(
        &mut self,
        told: Complex<f64>,
        expected: &[Option<Complex<f64>>; AGES_S.len()],
        dt: f64,
    ) -> bool {
        let kept = (-dt / LONGEST_S).exp();
        for (age, z) in expected.iter().enumerate() {
            let Some(z) = z else { continue };
            self.regressions[0][age].add(told, *z, kept);
            self.regressions[1][age].add(told, z.conj(), kept);
        }
        let best = |r: &[Regression; AGES_S.len()]| {
            r.iter().copied().max_by(|a, b| a.explained().total_cmp(&b.explained())).unwrap_or_default()
        };
        let [straight, mirrored] = self.regressions.each_ref().map(best);
        let is_mirrored = mirrored.explained() > straight.explained();
        let best = if is_mirrored { mirrored } else { straight };
        self.found = best.unit(dt).map(|unit| (unit, is_mirrored));
        self.found.is_some()
    }
}

/// A flow in rad/s, whatever it was told in; and what one of its units is, rad, where that was found just now.
///
/// # Errors
/// Why it cannot be told yet.
pub(in super::super::super) fn in_radians(
    source: &mut FlowSource,
    s: &FlowSample,
    context: &Context<'_>,
) -> Result<(FlowSample, Option<f64>), Reason> {
    if s.rotation != FlowRotation::InOwnUnit {
        return Ok((*s, None));
    }
    if !s.rate_xy.iter().all(|r| r.is_finite()) {
        return Err(Reason::NotFinite);
    }
    let told = Complex::new(s.rate_xy[0], s.rate_xy[1]);
    let known = source.units.iter().position(|(id, _)| *id == s.sensor);
    let index = known.unwrap_or_else(|| {
        source.units.push((s.sensor, FlowUnit::default()));
        source.units.len() - 1
    });
    let unit = &mut source.units[index].1;
    let radians = |rate_xy| FlowSample { rate_xy, rotation: FlowRotation::Contained, ..*s };
    if let Some(rate_xy) = unit.convert(told) {
        return Ok((radians(rate_xy), None));
    }
    let dt = unit.last.replace(s.time).map(|last| s.time.seconds_since(last));
    let dt = dt.filter(|dt| *dt > 0.0 && *dt < 1.0).ok_or(Reason::NoReferenceYet)?;
    let mut seen = [None; AGES_S.len()];
    if context.core.mode == Mode::Aided {
        seen = AGES_S.map(|age_s| expected(s, Span::from_seconds(dt), age_s, context));
    }
    if !unit.learn(told, &seen, dt) {
        return Err(Reason::UnknownUnit);
    }
    let found = unit.found.map(|(c, _)| c.norm());
    let rate_xy = unit.convert(told).ok_or(Reason::UnknownUnit)?;
    Ok((radians(rate_xy), found))
}

/// What the camera should have seen `age_s` before a flow's stamp, rad/s about its x and y.
fn expected(s: &FlowSample, interval: Span, age_s: f64, context: &Context<'_>) -> Option<Complex<f64>> {
    let core = context.core;
    let FlowMoment { time, r_body_to_ned, rate_body } = moment(s.time, interval, age_s, context).ok()?;
    let mount = &core.settings.flow.mount;
    let cosine = mount.cos_tilt(&r_body_to_ned);
    let seen = distance(s, cosine, context);
    let d = seen.measured_m.or_else(|| seen.height_m.map(|h| h / cosine.max(0.1)))?;
    let limits = &core.settings.flow.limits;
    if !(limits.min_distance_m..=limits.max_distance_m).contains(&d) {
        return None;
    }
    let (_, v_ned) = core.estimator.observer().predicted(time)?;
    let v_body = r_body_to_ned.tr_mul(&Vector3::new(v_ned.x, v_ned.y, -core.height.climb_mps()));
    let in_camera = |v: Vector3<f64>| mount.camera_to_body.to_camera(Body::new(v)).raw();
    let (v, rate): (Vector3<f64>, Vector2<f64>) = (in_camera(v_body), in_camera(rate_body).xy());
    Some(Complex::new(rate.x - v.y / d, rate.y + v.x / d))
}
