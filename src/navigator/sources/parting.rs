//! How two velocities parted that had agreed: at once, as where a sensor tells something else from one moment on, or little by little, as inertia leads away.
//!
//! With d = v − I, what a sensor tells less what inertia has added up to since some time, I, and θ the moment that fits best:
//!
//! - the sensor: d = c + s·1(t ≥ θ), a bias, or d = c + (κ + κ' J)(I + c)·1(t ≥ θ), a scale, a turn, a standstill of its own (κ = −1), of the velocity I + c;
//! - inertia: d = c + a τ, τ = max(t − θ, 0), an acceleration that is not there, of a bias or a tilt, or d = c + b τ²/2, one that grows, of a tilt that does.
//!
//! Each has as many free numbers. With noise of a variance that nobody knows, n ln of the ratio of the sums of squares that two of them leave is twice the logarithm of their
//! likelihoods' ratio.

use nalgebra::{Matrix2, Matrix4, SMatrix, Vector2, Vector4};

use crate::navigator::tuning::parting::{
    BEFORE, CLEAR_OF, LEADS_POINTS, LEAST_SQUARE, NOISIER, POINTS_SINCE, RIDGE,
};

/// A mean over some time.
#[derive(Clone, Copy, Debug, Default)]
pub(super) struct PartingPoint {
    /// s, from any zero.
    pub(super) t: f64,
    /// d and I, m/s.
    pub(super) apart: Vector2<f64>,
    pub(super) felt: Vector2<f64>,
    /// What is navigated on less what the sensor tells, m/s: some of what inertia did has been corrected.
    pub(super) off: Vector2<f64>,
}

/// Whose way of parting it was.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(in super::super) enum Parted {
    /// A sensor's.
    AtOnce,
    /// Inertia's, so.
    LedAway(LedAway),
    /// Nobody can tell; if inertia's, so.
    Either(LedAway),
}

impl Parted {
    /// How inertia has led away, or may have.
    pub(super) fn led(self) -> Option<LedAway> {
        if let Parted::LedAway(led) | Parted::Either(led) = self { Some(led) } else { None }
    }
}

/// How inertia led away, if that it was.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(in super::super) struct LedAway {
    /// For how long, s.
    pub(in super::super) for_s: f64,
    /// How far d has gone by now, m/s.
    pub(in super::super) velocity_mps: f64,
    /// How far what is navigated on has followed it, if the sensor is right: m/s, and what that has added up to, m.
    pub(in super::super) off_mps: f64,
    pub(in super::super) off_m: f64,
}

impl LedAway {
    /// Since `onset`, by `velocity_mps`; oldest first.
    pub(super) fn new(points: &[PartingPoint], onset: f64, velocity_mps: f64) -> Self {
        let now = points.last().map_or(onset, |p| p.t);
        let off = points.last().map_or(Vector2::zeros(), |p| p.off);
        let since = points.windows(2).filter(|pair| pair[1].t > onset);
        let went: Vector2<f64> = since.map(|pair| pair[1].off * (pair[1].t - pair[0].t.max(onset))).sum();
        Self { for_s: now - onset, velocity_mps, off_mps: off.norm(), off_m: went.norm() }
    }
}

/// A fit: what it leaves, when it began, and what it had made of d at the end.
#[derive(Clone, Copy, Debug)]
struct PartingFit {
    left: f64,
    onset: f64,
    /// So many points ago.
    since: usize,
    /// What it leaves of a point since then.
    scatter: f64,
    went: Vector2<f64>,
}

/// Whose way of parting explains the points clearly better. `None` for a few points.
pub(super) fn parted(points: &[PartingPoint]) -> Option<Parted> {
    let onsets = || BEFORE..points.len().saturating_sub(POINTS_SINCE - 1);
    let best = |ways: [Way; 2]| {
        onsets()
            .flat_map(|k| ways.map(|way| fit(points, k, way)))
            .flatten()
            .min_by(|a, b| a.left.total_cmp(&b.left))
    };
    let sensor = best([Way::Bias, Way::Scale])?;
    let inertia = best([Way::Acceleration, Way::Jerk])?;
    let least = points.len() as f64 * LEAST_SQUARE;
    let odds = 2.0 * points.len() as f64 * ((sensor.left + least) / (inertia.left + least)).ln();
    let calm = scatter(points.get(..points.len() / 3)?) + LEAST_SQUARE;
    let led = LedAway::new(points, inertia.onset, inertia.went.norm());
    Some(match odds {
        // What comes within a mean or two cannot be told from a step, and what scatters since then is a sensor's noise.
        odds if odds < -CLEAR_OF || inertia.since < LEADS_POINTS || inertia.scatter > NOISIER * calm => {
            Parted::AtOnce
        }
        odds if odds > CLEAR_OF => Parted::LedAway(led),
        _ => Parted::Either(led),
    })
}

/// What points leave of their mean, each.
fn scatter(points: &[PartingPoint]) -> f64 {
    let n = points.len().max(1) as f64;
    let mean = points.iter().map(|p| p.apart).sum::<Vector2<f64>>() / n;
    points.iter().map(|p| (p.apart - mean).norm_squared()).sum::<f64>() / n
}

/// The ways to part.
#[derive(Clone, Copy, Debug)]
enum Way {
    Bias,
    Scale,
    Acceleration,
    Jerk,
}

/// The two numbers of a way that begins before point `k`, and c, by least squares. That point, which may lie on both sides of it, does not count.
fn fit(points: &[PartingPoint], k: usize, way: Way) -> Option<PartingFit> {
    let agreed = points.get(..k)?;
    let c = agreed.iter().map(|p| p.apart).sum::<Vector2<f64>>() / agreed.len() as f64;
    let (last_before, onset) = (agreed.last()?.t, points.get(k)?.t);
    // What one unit of each of the two numbers makes of d: [north, east].
    let effect = |i: usize, p: &PartingPoint| match way {
        _ if i < k => Matrix2::zeros(),
        Way::Bias => Matrix2::identity(),
        Way::Scale => {
            let v = p.felt + c;
            Matrix2::new(v.x, -v.y, v.y, v.x)
        }
        Way::Acceleration => Matrix2::identity() * (p.t - last_before),
        Way::Jerk => Matrix2::identity() * (0.5 * (p.t - last_before).powi(2)),
    };
    let row = |i: usize, p: &PartingPoint| {
        let e = effect(i, p);
        SMatrix::<f64, 2, 4>::new(1.0, 0.0, e[(0, 0)], e[(0, 1)], 0.0, 1.0, e[(1, 0)], e[(1, 1)])
    };
    let (mut normal, mut right) = (Matrix4::identity() * RIDGE, Vector4::zeros());
    for (i, p) in points.iter().enumerate().filter(|(i, _)| *i != k) {
        let row = row(i, p);
        normal += row.tr_mul(&row);
        right += row.tr_mul(&p.apart);
    }
    let x = normal.cholesky()?.solve(&right);
    let left = |(i, p): (usize, &PartingPoint)| (p.apart - row(i, p) * x).norm_squared();
    let before = points.iter().enumerate().take(k).map(left).sum::<f64>();
    let after = points.iter().enumerate().skip(k + 1).map(left).sum::<f64>();
    let since = points.len() - k;
    let end = effect(points.len() - 1, points.last()?);
    Some(PartingFit {
        left: before + after,
        since,
        scatter: after / since as f64,
        onset: 0.5 * (last_before + onset),
        went: end * x.fixed_rows::<2>(2),
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    /// 6 s of a vehicle that flies to and fro, parted by `apart` of (seconds since 3 s, velocity).
    fn flight(apart: impl Fn(f64, Vector2<f64>) -> Vector2<f64>) -> Vec<PartingPoint> {
        (0..24u32)
            .map(|k| {
                let t = 0.25 * f64::from(k);
                let felt = Vector2::new((1.3 * t).sin() * 2.0, (0.7 * t).cos());
                let noise = Vector2::new(f64::from(k * 7919 % 13) - 6.0, f64::from(k * 104_729 % 11) - 5.0);
                let gone = if t < 3.0 { Vector2::zeros() } else { apart(t - 3.0, felt) };
                let apart = Vector2::new(1.0, -2.0) + gone + noise * 0.01;
                PartingPoint { t, apart, felt, off: Vector2::zeros() }
            })
            .collect()
    }

    #[test]
    fn a_bias_a_scale_and_a_turn_are_the_sensors() {
        let ways: [fn(Vector2<f64>) -> Vector2<f64>; 4] =
            [|_| Vector2::new(1.5, 0.5), |v| -0.5 * v, |v| Vector2::new(-v.y, v.x) - v, |v| -2.0 * v];
        for way in ways {
            // The velocity is I + c.
            let parts = flight(|_, felt| way(felt + Vector2::new(1.0, -2.0)));
            assert_eq!(parted(&parts), Some(Parted::AtOnce));
        }
    }

    #[test]
    fn a_bias_of_inertia_and_a_tilt_that_grows_lead_away() {
        let ways: [fn(f64) -> Vector2<f64>; 2] =
            [|t| Vector2::new(t, 0.3 * t), |t| Vector2::new(0.0, 0.6 * t * t)];
        for way in ways {
            let Some(Parted::LedAway(led)) = parted(&flight(|t, _| way(t))) else { panic!() };
            let went = way(2.75).norm();
            assert!(
                (led.for_s - 2.75).abs() < 0.6 && (led.velocity_mps - went).abs() < 0.2 * went,
                "{led:?}"
            );
        }
    }

    #[test]
    fn a_sensor_that_becomes_noisy_has_gone_itself() {
        let noise = |t: f64| Vector2::new((37.0 * t).sin(), (53.0 * t).cos()) * 1.5;
        assert_eq!(parted(&flight(|t, _| noise(t) + Vector2::new(0.6 * t, 0.0))), Some(Parted::AtOnce));
    }

    #[test]
    fn a_sensor_that_stands_still_and_inertia_that_leaves_a_hover_look_alike() {
        let mut points = flight(|_, _| Vector2::zeros());
        for p in &mut points {
            let left = 0.8 * (p.t - 4.0).max(0.0);
            let noise = p.apart - Vector2::new(1.0, -2.0);
            (p.felt, p.apart) = (Vector2::new(left, 0.0), noise - Vector2::new(left, 0.0));
        }
        assert!(matches!(parted(&points), Some(Parted::Either(_))), "{:?}", parted(&points));
    }

    #[test]
    fn what_was_followed_of_inertia_is_what_is_navigated_on_less_the_sensor_since_then() {
        let point = |k: u32| PartingPoint {
            t: 0.5 * f64::from(k),
            off: Vector2::new(if k < 4 { 9.0 } else { 0.4 }, 0.3),
            ..PartingPoint::default()
        };
        let points: Vec<_> = (0..9).map(point).collect();
        // From 1.75 s on: the fifth point is at 2 s, the last at 4 s.
        let led = LedAway::new(&points, 1.75, 3.0);
        assert!((led.for_s - 2.25).abs() < 1e-12 && (led.off_mps - 0.5).abs() < 1e-12, "{led:?}");
        assert!((led.off_m - 0.5 * 2.25).abs() < 1e-12 && (led.velocity_mps - 3.0).abs() < 1e-12, "{led:?}");
    }

    #[test]
    fn a_few_points_say_nothing() {
        assert_eq!(parted(&[]), None);
        assert_eq!(parted(&flight(|t, _| Vector2::new(t, 0.0))[..3]), None);
        let rests: Vec<_> =
            (0..24).map(|k| PartingPoint { t: f64::from(k), ..PartingPoint::default() }).collect();
        assert!(matches!(parted(&rests), Some(Parted::Either(_))));
    }
}
