//! The integrated baro-inertial-GNSS altimeter as published: two channels side by side, fused by their variances, scheme 3.

use super::error_model::ErrorModel;
use super::filter::{Ibi, Iig, Variant, WeightedInnovation};
use super::selector::ChannelTest;

/// Which of the published filters.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum AltimeterMethod {
    /// The optimal Kalman filter in both channels.
    Okf,
    /// The robust one as printed.
    Rkf,
    /// The robust one with the covariance that belongs to its gain.
    RkfJoseph,
    /// What the paper recommends: no channel faulty, the fused optimal filters; one faulty, the healthy one's optimal filter; both
    /// faulty, the fused robust filters as printed. [`ChannelTest`] decides which are faulty; the optimal filter of a channel uses none of
    /// its measurements while it is.
    Selector,
}

/// Which of the three altimeters.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum AltimeterScheme {
    /// Baro-inertial.
    Ibi,
    /// Inertial-GNSS.
    Iig,
    /// Both fused.
    Ibig,
}

/// An error of the inertial altitude: H = H_I − `delta_h_m`, (21).
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Estimate {
    /// ΔH, m.
    pub delta_h_m: f64,
    /// Its variance, m².
    pub variance_m2: f64,
}

/// Fuses two estimates by their variances as if their errors were independent, (19) and (20):
/// ΔH = (Var₁ ΔH₂ + Var₂ ΔH₁)/(Var₁ + Var₂), Var = Var₁ Var₂/(Var₁ + Var₂).
///
/// They are not independent, both have the error of the one inertial altitude in them; the variance is too small. Two estimates
/// without any variance are averaged.
pub fn fuse(a: Estimate, b: Estimate) -> Estimate {
    let sum = a.variance_m2 + b.variance_m2;
    let share = if sum > 0.0 { b.variance_m2 / sum } else { 0.5 };
    Estimate {
        delta_h_m: share * a.delta_h_m + (1.0 - share) * b.delta_h_m,
        variance_m2: share * a.variance_m2,
    }
}

/// What a step's measurements met: one element a channel that had one it could use.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct ChannelReport {
    /// The baro-inertial channel.
    pub ibi: Option<WeightedInnovation>,
    /// The inertial-GNSS channel.
    pub iig: Option<WeightedInnovation>,
}

/// Both channels with one kind of filter.
#[derive(Clone, Debug)]
struct Pair {
    ibi: Ibi,
    iig: Iig,
}

impl Pair {
    fn new(model: ErrorModel, variant: Variant) -> Self {
        Self { ibi: Ibi::new(model, variant), iig: Iig::new(model, variant) }
    }

    fn predict(&mut self, dt_s: f64) {
        self.ibi.predict(dt_s);
        self.iig.predict(dt_s);
    }

    fn step(&mut self, dt_s: f64, z_ibi: Option<f64>, z_iig: Option<f64>) -> ChannelReport {
        self.predict(dt_s);
        ChannelReport {
            ibi: z_ibi.and_then(|z| self.ibi.update(z)),
            iig: z_iig.and_then(|z| self.iig.update(z)),
        }
    }

    fn estimate(&self, scheme: AltimeterScheme) -> Estimate {
        let ibi = Estimate { delta_h_m: self.ibi.delta_h(), variance_m2: self.ibi.variance() };
        let iig = Estimate { delta_h_m: self.iig.delta_h(), variance_m2: self.iig.variance() };
        match scheme {
            AltimeterScheme::Ibi => ibi,
            AltimeterScheme::Iig => iig,
            AltimeterScheme::Ibig => fuse(ibi, iig),
        }
    }
}

/// What the selector has beside its optimal filters.
#[derive(Clone, Debug)]
struct Selection {
    robust: Pair,
    ibi: ChannelTest,
    iig: ChannelTest,
}

/// The published altimeter: all three schemes at once, by one method.
#[derive(Clone, Debug)]
pub struct PublishedAltimeter {
    pair: Pair,
    selection: Option<Selection>,
}

impl PublishedAltimeter {
    /// At x = 0 with the model's start covariance.
    pub fn new(model: ErrorModel, method: AltimeterMethod) -> Self {
        let variant = match method {
            AltimeterMethod::Okf | AltimeterMethod::Selector => Variant::Okf,
            AltimeterMethod::Rkf => Variant::Rkf,
            AltimeterMethod::RkfJoseph => Variant::RkfJoseph,
        };
        let selection = (method == AltimeterMethod::Selector).then(|| Selection {
            robust: Pair::new(model, Variant::Rkf),
            ibi: ChannelTest::default(),
            iig: ChannelTest::default(),
        });
        Self { pair: Pair::new(model, variant), selection }
    }

    /// Goes on by `dt_s` and uses the measurements there are then: inertial less barometric altitude and inertial less GNSS altitude, m.
    ///
    /// The report is of the filters that the fused estimate comes from: a channel that the selector leaves out has no weight.
    pub fn step(&mut self, dt_s: f64, z_ibi: Option<f64>, z_iig: Option<f64>) -> ChannelReport {
        let Some(selection) = &mut self.selection else { return self.pair.step(dt_s, z_ibi, z_iig) };
        let robust = selection.robust.step(dt_s, z_ibi, z_iig);
        self.pair.predict(dt_s);
        let optimal = ChannelReport {
            ibi: z_ibi.and_then(|z| selection.ibi.guard(&mut self.pair.ibi, z)),
            iig: z_iig.and_then(|z| selection.iig.guard(&mut self.pair.iig, z)),
        };
        if selection.ibi.is_faulty() && selection.iig.is_faulty() { robust } else { optimal }
    }

    /// The estimate of a scheme. The selector's single channels are its optimal filter while the channel is healthy, and its robust one
    /// while it is faulty.
    pub fn estimate(&self, scheme: AltimeterScheme) -> Estimate {
        let Some(selection) = &self.selection else { return self.pair.estimate(scheme) };
        let (ibi, iig) = self.faulty();
        let of = |robust: bool, scheme| {
            let pair = if robust { &selection.robust } else { &self.pair };
            pair.estimate(scheme)
        };
        match (scheme, ibi, iig) {
            (AltimeterScheme::Ibi, faulty, _) | (AltimeterScheme::Iig, _, faulty) => of(faulty, scheme),
            (AltimeterScheme::Ibig, false, false) => of(false, AltimeterScheme::Ibig),
            (AltimeterScheme::Ibig, true, false) => of(false, AltimeterScheme::Iig),
            (AltimeterScheme::Ibig, false, true) => of(false, AltimeterScheme::Ibi),
            (AltimeterScheme::Ibig, true, true) => of(true, AltimeterScheme::Ibig),
        }
    }

    /// Whether the selector holds the baro-inertial and the inertial-GNSS channel for faulty; the other methods never do.
    pub fn faulty(&self) -> (bool, bool) {
        self.selection.as_ref().map_or((false, false), |s| (s.ibi.is_faulty(), s.iig.is_faulty()))
    }

    /// The two channels' filters (the selector's optimal ones).
    pub fn channels(&self) -> (&Ibi, &Iig) {
        (&self.pair.ibi, &self.pair.iig)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn run(
        method: AltimeterMethod,
        z: impl Fn(usize) -> (Option<f64>, Option<f64>),
        steps: usize,
    ) -> PublishedAltimeter {
        let mut altimeter = PublishedAltimeter::new(ErrorModel::table_1(), method);
        for k in 0..steps {
            let (ibi, iig) = z(k);
            altimeter.step(0.5, ibi, iig);
        }
        altimeter
    }

    #[test]
    fn a_missing_measurement_is_missing_and_the_doubt_grows() {
        for method in [
            AltimeterMethod::Okf,
            AltimeterMethod::Rkf,
            AltimeterMethod::RkfJoseph,
            AltimeterMethod::Selector,
        ] {
            let all = run(method, |_| (Some(1.0), Some(1.0)), 200);
            let out = run(method, |k| if k < 200 { (Some(1.0), Some(1.0)) } else { (None, None) }, 7400);
            let (before, after) = (all.estimate(AltimeterScheme::Ibig), out.estimate(AltimeterScheme::Ibig));
            assert!(after.variance_m2 > 4.0 * before.variance_m2, "{method:?}");
            assert!((all.estimate(AltimeterScheme::Ibig).delta_h_m - 1.0).abs() < 0.2);
            // One channel alone goes on as if the other had never been.
            let half = run(method, |_| (None, Some(1.0)), 200);
            assert_eq!(half.channels().1.state(), all.channels().1.state());
        }
    }

    #[test]
    fn nothing_wild_gets_in() {
        for method in [
            AltimeterMethod::Okf,
            AltimeterMethod::Rkf,
            AltimeterMethod::RkfJoseph,
            AltimeterMethod::Selector,
        ] {
            let mut altimeter = run(method, |_| (Some(1.0), Some(2.0)), 50);
            let before = altimeter.clone();
            for bad in [f64::NAN, f64::INFINITY, -1e300] {
                assert_eq!(altimeter.step(bad, Some(bad), Some(bad)), ChannelReport::default());
            }
            assert_eq!(altimeter.channels().0.state(), before.channels().0.state());
            for _ in 0..200 {
                altimeter.step(1e300, None, None);
            }
            altimeter.step(0.5, Some(9e8), Some(-9e8));
            for scheme in [AltimeterScheme::Ibi, AltimeterScheme::Iig, AltimeterScheme::Ibig] {
                let e = altimeter.estimate(scheme);
                assert!(
                    e.delta_h_m.is_finite() && e.variance_m2.is_finite() && e.variance_m2 >= 0.0,
                    "{e:?}"
                );
            }
        }
    }

    #[test]
    fn the_selector_leaves_a_faulty_channel_and_comes_back() {
        // Noise that is none: alternating, of the size that is expected.
        let noise = |k: usize| if k.is_multiple_of(2) { 3.0 } else { -3.0 };
        let at = |steps, both: bool| {
            let bias = |k: usize| if (200..240).contains(&k) { 30.0 } else { 0.0 };
            let iig = move |k| if both { noise(k) + bias(k) } else { noise(k) };
            run(AltimeterMethod::Selector, move |k| (Some(noise(k) + bias(k)), Some(iig(k))), steps)
        };
        assert_eq!(at(200, false).faulty(), (false, false));
        let one = at(205, false);
        assert_eq!(one.faulty(), (true, false));
        assert_eq!(one.estimate(AltimeterScheme::Ibig), one.estimate(AltimeterScheme::Iig));
        let two = at(205, true);
        assert_eq!(two.faulty(), (true, true));
        assert_eq!(
            two.estimate(AltimeterScheme::Ibig),
            two.selection.as_ref().unwrap().robust.estimate(AltimeterScheme::Ibig)
        );
        assert_eq!(at(600, false).faulty(), (false, false));
    }

    #[test]
    fn estimates_without_variance_are_averaged() {
        let e = |delta_h_m| Estimate { delta_h_m, variance_m2: 0.0 };
        assert_eq!(fuse(e(1.0), e(3.0)), Estimate { delta_h_m: 2.0, variance_m2: 0.0 });
    }
}
