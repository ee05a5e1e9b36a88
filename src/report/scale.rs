//! From values to places on a plot, and the ticks beside it.

/// A range of values along one side of a plot.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct PlotScale {
    pub(super) least: f64,
    pub(super) most: f64,
    /// Decades are equally long.
    pub(super) logarithmic: bool,
}

/// How the range of a plot's values is found.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) enum RangeFit {
    /// Around the values, and at least so wide.
    Around(f64),
    /// From zero up to the greatest, at least to this.
    FromZero(f64),
    /// The same, without the few that are far greater than most.
    MostFromZero(f64),
    /// From zero up, by decades where a few values are far greater than most; at least to this.
    Decades(f64),
    /// As it is.
    Fixed(f64, f64),
}

/// The least value of a logarithmic plot.
const FIRST_DECADE: f64 = 0.01;
/// Where the greatest value is this many times the median, decades show more.
const WIDE: f64 = 40.0;
/// Where all values reach this many times as far as all but one in a hundred of them, they do not fit the plot.
const FAR: f64 = 4.0;
/// Room around the values, as a part of their range.
const ROOM: f64 = 0.06;

fn quantile(sorted: &[f64], part: f64) -> f64 {
    let at = (part * (sorted.len() - 1) as f64).round() as usize;
    sorted[at]
}

impl PlotScale {
    pub(super) const fn linear(least: f64, most: f64) -> Self {
        Self { least, most, logarithmic: false }
    }

    /// The range for these values; `None` where there are none.
    pub(super) fn of(mut values: Vec<f64>, fit: RangeFit) -> Option<Self> {
        values.retain(|v| v.is_finite());
        values.sort_by(f64::total_cmp);
        let (least, most) = (*values.first()?, *values.last()?);
        let (low, high) = (quantile(&values, 0.005), quantile(&values, 0.995));
        // A few that are far outside would leave the others no room.
        let width = high - low;
        let (low, high) = if most - least > FAR * width.max(1e-9) && width > 0.0 {
            (low - 0.5 * width, high + 0.5 * width)
        } else {
            (least, most)
        };
        Some(match fit {
            RangeFit::Fixed(least, most) => Self::linear(least, most),
            RangeFit::Around(wide) => {
                let (middle, half) =
                    (0.5 * (low + high), (0.5 * (high - low)).max(0.5 * wide) * (1.0 + 2.0 * ROOM));
                Self::linear(middle - half, middle + half)
            }
            RangeFit::FromZero(at_least) => Self::linear(0.0, most.max(at_least) * (1.0 + ROOM)),
            RangeFit::MostFromZero(at_least) => Self::linear(0.0, high.max(at_least) * (1.0 + ROOM)),
            RangeFit::Decades(at_least)
                if most > WIDE * quantile(&values, 0.5).max(FIRST_DECADE) && most > at_least =>
            {
                Self {
                    least: decade(quantile(&values, 0.02).max(FIRST_DECADE)),
                    most: most * 1.2,
                    logarithmic: true,
                }
            }
            RangeFit::Decades(at_least) => Self::linear(0.0, most.max(at_least) * (1.0 + ROOM)),
        })
    }

    fn along(&self, value: f64) -> f64 {
        if self.logarithmic { value.max(1e-12).log10() } else { value }
    }

    /// Where a value lies, as a part of the range.
    pub(super) fn part(&self, value: f64) -> f64 {
        let (least, most) = (self.along(self.least), self.along(self.most));
        (self.along(value) - least) / (most - least)
    }

    pub(super) fn holds(&self, value: f64) -> bool {
        self.least <= value && value <= self.most
    }

    /// Values for about `count` ticks, with their texts.
    pub(super) fn ticks(&self, count: usize) -> Vec<(f64, String)> {
        if self.logarithmic {
            let decades = self.least.log10().ceil() as i32..=self.most.log10().floor() as i32;
            return decades.map(|d| 10f64.powi(d)).map(|v| (v, format!("{v}"))).collect();
        }
        let step = round_step((self.most - self.least) / count.max(1) as f64);
        if !(step.is_finite() && step > 0.0) {
            return Vec::new();
        }
        let decimals = (-step.log10().floor()).clamp(0.0, 6.0) as usize;
        let (from, to) = ((self.least / step).ceil() as i64, (self.most / step).floor() as i64);
        (from..=to).map(|i| i as f64 * step).map(|v| (v, format!("{v:.decimals$}"))).collect()
    }
}

fn decade(value: f64) -> f64 {
    10f64.powf(value.log10().floor())
}

/// 1, 2 or 5 times a power of ten, at least `least`.
pub(super) fn round_step(least: f64) -> f64 {
    let power = decade(least);
    [1.0, 2.0, 5.0, 10.0].into_iter().map(|m| m * power).find(|s| *s >= least * 0.999).unwrap_or(10.0 * power)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn ranges_hold_the_values_and_a_few_far_ones_do_not_flatten_them() {
        let values: Vec<f64> = (0..=1000).map(|i| f64::from(i) * 0.01).collect();
        let around = PlotScale::of(values.clone(), RangeFit::Around(1.0)).unwrap();
        assert!(values.iter().all(|v| around.holds(*v)) && around.most - around.least < 12.0);
        let mut far = values.clone();
        far.push(5000.0);
        let robust = PlotScale::of(far.clone(), RangeFit::Around(1.0)).unwrap();
        assert!(robust.most < 20.0 && !robust.holds(5000.0));
        let decades = PlotScale::of(far, RangeFit::Decades(1.0)).unwrap();
        assert!(decades.logarithmic && decades.holds(5000.0) && decades.least < 0.2, "{decades:?}");
        assert_eq!(PlotScale::of(vec![f64::NAN], RangeFit::Around(1.0)), None);
        let flat = PlotScale::of(vec![3.0, 3.0], RangeFit::Around(2.0)).unwrap();
        assert!(flat.least < 2.01 && flat.most > 3.99);
    }

    #[test]
    fn ticks_are_round_and_inside() {
        let texts = |s: PlotScale, n| s.ticks(n).into_iter().map(|t| t.1).collect::<Vec<_>>();
        assert_eq!(texts(PlotScale::linear(-0.3, 1.02), 5), ["0.0", "0.5", "1.0"]);
        assert_eq!(texts(PlotScale::linear(0.0, 1534.0), 6), ["0", "500", "1000", "1500"]);
        let decades = PlotScale { least: 0.1, most: 300.0, logarithmic: true };
        assert_eq!(texts(decades, 5), ["0.1", "1", "10", "100"]);
        assert!((decades.part(10.0) - 2.0 / 3000f64.log10()).abs() < 1e-12);
        assert!(PlotScale::linear(1.0, 1.0).ticks(4).is_empty());
    }
}
