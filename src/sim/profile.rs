//! Functions of time made of smooth steps and waves, with exact derivatives and integrals: what a flight plan is written in.

use super::trajectory::smooth_step;
use std::f64::consts::TAU;

/// A value and its first three derivatives.
pub(super) type Jet = [f64; 4];

/// A quantity that goes from one constant to the next in seventh-order steps: three times continuously differentiable.
#[derive(Clone, Debug, PartialEq)]
pub(super) struct MotionProfile {
    start: f64,
    steps: Vec<Step>,
}

#[derive(Clone, Copy, Debug, PartialEq)]
struct Step {
    from_s: f64,
    over_s: f64,
    by: f64,
    /// Value before it.
    before: f64,
    /// Integral from 0 to its beginning.
    integral: f64,
}

/// A step takes at least this long, s.
const SHORTEST_STEP_S: f64 = 1e-3;

impl MotionProfile {
    /// Always the same.
    pub(super) fn constant(value: f64) -> Self {
        Self { start: value, steps: Vec::new() }
    }

    /// Becomes `to` in the `over_s` seconds from `from_s` on, but not before the last step has ended.
    pub(super) fn then(mut self, from_s: f64, over_s: f64, to: f64) -> Self {
        self.step_to(from_s, over_s, to);
        self
    }

    /// As [`Self::then`].
    pub(super) fn step_to(&mut self, from_s: f64, over_s: f64, to: f64) {
        let from_s = self.joins().last().map_or(from_s, |end| from_s.max(end));
        let before = self.at(from_s)[0];
        let integral = self.integral(from_s);
        self.steps.push(Step {
            from_s,
            over_s: over_s.max(SHORTEST_STEP_S),
            by: to - before,
            before,
            integral,
        });
    }

    /// Where steps begin and end, in order.
    pub(super) fn joins(&self) -> impl Iterator<Item = f64> + '_ {
        self.steps.iter().flat_map(|s| [s.from_s, s.from_s + s.over_s])
    }

    fn step_at(&self, t_s: f64) -> Option<&Step> {
        self.steps[..self.steps.partition_point(|s| s.from_s <= t_s)].last()
    }

    pub(super) fn at(&self, t_s: f64) -> Jet {
        let Some(s) = self.step_at(t_s) else { return [self.start, 0.0, 0.0, 0.0] };
        let mut jet = smooth_step((t_s - s.from_s) / s.over_s);
        let mut scale = s.by;
        for x in &mut jet {
            *x *= scale;
            scale /= s.over_s;
        }
        jet[0] += s.before;
        jet
    }

    /// Its integral from 0 to `t_s` (the last value goes on for ever).
    pub(super) fn integral(&self, t_s: f64) -> f64 {
        let Some(s) = self.step_at(t_s) else { return self.start * t_s };
        let into = t_s - s.from_s;
        let tau = (into / s.over_s).min(1.0);
        // ∫ of the step polynomial: 7τ⁵ − 14τ⁶ + 10τ⁷ − 5/2 τ⁸, and then the new constant.
        let ramp = tau.powi(5) * (7.0 + tau * (-14.0 + tau * (10.0 - 2.5 * tau))) * s.over_s;
        s.integral + s.before * into + s.by * (ramp + (into - s.over_s).max(0.0))
    }
}

/// amplitude · sin(2π t / period + phase)
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct Wave {
    pub(super) amplitude: f64,
    pub(super) period_s: f64,
    pub(super) phase_rad: f64,
}

impl Wave {
    pub(super) fn at(&self, t_s: f64) -> Jet {
        let w = TAU / self.period_s;
        let (s, c) = (w * t_s + self.phase_rad).sin_cos();
        [s, w * c, -w * w * s, -w * w * w * c].map(|x| self.amplitude * x)
    }
}

/// The sum of waves.
pub(super) fn sum(waves: &[Wave], t_s: f64) -> Jet {
    waves.iter().fold([0.0; 4], |total, w| add(&total, &w.at(t_s)))
}

pub(super) fn add(a: &Jet, b: &Jet) -> Jet {
    std::array::from_fn(|i| a[i] + b[i])
}

/// Leibniz' rule.
pub(super) fn product(a: &Jet, b: &Jet) -> Jet {
    [
        a[0] * b[0],
        a[1] * b[0] + a[0] * b[1],
        a[2] * b[0] + 2.0 * a[1] * b[1] + a[0] * b[2],
        a[3] * b[0] + 3.0 * (a[2] * b[1] + a[1] * b[2]) + a[0] * b[3],
    ]
}

#[cfg(test)]
mod tests {
    use super::*;

    fn profile() -> MotionProfile {
        MotionProfile::constant(2.0).then(3.0, 4.0, -1.0).then(8.0, 1.0, 5.0)
    }

    #[test]
    fn derivatives_and_integral_are_those_of_the_value() {
        let h = 1e-4;
        let (p, w) = (profile(), Wave { amplitude: 1.5, period_s: 7.0, phase_rad: 0.4 });
        let jets: [&dyn Fn(f64) -> Jet; 3] =
            [&|t| p.at(t), &|t| w.at(t), &|t| product(&p.at(t), &add(&w.at(t), &[1.0, 0.0, 0.0, 0.0]))];
        for k in 0..120 {
            let t = 0.1 * f64::from(k) + 0.003;
            for jet in jets {
                let (a, b, c) = (jet(t - h), jet(t), jet(t + h));
                for i in 0..3 {
                    let slope = (c[i] - a[i]) / (2.0 * h);
                    assert!((slope - b[i + 1]).abs() < 1e-3, "{i} at {t}: {slope} {}", b[i + 1]);
                }
            }
            let slope = (p.integral(t + h) - p.integral(t - h)) / (2.0 * h);
            assert!((slope - p.at(t)[0]).abs() < 1e-6, "{t}");
        }
    }

    #[test]
    fn a_step_ends_where_it_was_told_and_waits_for_the_one_before() {
        let p = profile();
        assert_eq!((p.at(0.0)[0], p.at(7.5)[0], p.at(100.0)[0]), (2.0, -1.0, 5.0));
        let early = MotionProfile::constant(0.0).then(0.0, 2.0, 1.0).then(1.0, 2.0, 2.0);
        assert_eq!(early.joins().collect::<Vec<_>>(), [0.0, 2.0, 2.0, 4.0]);
    }
}
