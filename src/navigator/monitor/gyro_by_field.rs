//! The magnetic field as a witness of the gyros: an axis of the wrong sign, or of far less than its scale.
//!
//! A field that is at rest turns in the body by ḃ = −ω × b. Where the gyros tell ω and the vehicle turns by (I + diag g) ω, the field b that comes after a turn of
//! θ = ω Δt differs from what they make of the last one by r = Σ gᵢ θᵢ (b × eᵢ). Over the last [`BLOCKS`] blocks gᵢ is found by least squares, axis by axis. An axis is wrong where it
//! alone explains most of what Σ|r|² is more than usual, by a gain that no iron, current or latency makes, in a turn that was large enough, and
//! not by one block: a magnetometer that steps does so once. What stands still in the body has all gains at −1, and where that fits as well it is the magnetometer's fault.

use nalgebra::{Matrix3, Vector3};

use crate::geo::so3;
use crate::navigator::tuning::gyro_by_field::{
    BLOCK_S, BLOCKS, CLIPPED, EXPLAINS, HOLE_S, LEAST_NOISE, LEAST_TURN, NOISE_GAIN, ONE_BLOCK, RIVAL,
    SIGMAS, SOUND, SUSPECTED,
};
use crate::time::AutopilotTime;

/// A turn, and what the field made of it.
#[derive(Clone, Copy, Debug, Default)]
struct FieldBlock {
    /// r, over the field's strength.
    rest: Vector3<f64>,
    /// Columns θᵢ (b × eᵢ), over the field's strength.
    turned: Matrix3<f64>,
}

/// What the last blocks say of one axis.
#[derive(Clone, Copy, Debug)]
struct AxisFinding {
    gain: f64,
    /// What it explains of Σ|r|², what that is more than usual, and what a magnetometer that stands still explains of it.
    explained: f64,
    unusual: f64,
    by_standing: f64,
    /// What it should have turned the field by, Σ θ² |b × e|², rad².
    turn: f64,
    /// The largest |r|².
    largest: f64,
}

/// See the module's documentation.
#[derive(Clone, Copy, Debug)]
pub(in super::super) struct GyroByField {
    last: Option<(AutopilotTime, Vector3<f64>)>,
    blocks: [FieldBlock; BLOCKS],
    filled: usize,
    next: usize,
    /// Mean |r|² of a block, while nothing is suspected.
    noise: f64,
    suspected: bool,
}

impl Default for GyroByField {
    fn default() -> Self {
        Self {
            last: None,
            blocks: [FieldBlock::default(); BLOCKS],
            filled: 0,
            next: 0,
            noise: LEAST_NOISE,
            suspected: false,
        }
    }
}

impl GyroByField {
    /// A field, body, any unit, and what the gyros have turned since a time, body, rad. True where an axis is found to be wrong by it.
    pub(in super::super) fn observe(
        &mut self,
        time: AutopilotTime,
        field: &Vector3<f64>,
        turned: impl Fn(AutopilotTime) -> Option<Vector3<f64>>,
    ) -> bool {
        let Some((since, before)) = self.last else {
            self.last = Some((time, *field));
            return false;
        };
        let dt = time.seconds_since(since);
        if (0.0..BLOCK_S).contains(&dt) {
            return false;
        }
        // Numbers that are told again see nothing.
        let theta = turned(since).filter(|_| (BLOCK_S..HOLE_S).contains(&dt) && before != *field);
        self.last = Some((time, *field));
        let (Some(theta), strength) = (theta, field.norm()) else {
            self.forget();
            self.last = Some((time, *field));
            return false;
        };
        if strength <= 0.0 {
            return false;
        }
        let unit = field / strength;
        let rest = unit - so3::exp(&-theta) * (before / strength);
        let turned = Matrix3::from_columns(&[0, 1, 2].map(|i| {
            let mut axis = Vector3::zeros();
            axis[i] = theta[i];
            unit.cross(&axis)
        }));
        self.blocks[self.next] = FieldBlock { rest, turned };
        self.next = (self.next + 1) % BLOCKS;
        self.filled = (self.filled + 1).min(BLOCKS);
        self.judge(&rest)
    }

    /// Whether an axis begins to look wrong: the magnetometer is not to be blamed for that.
    pub(in super::super) fn suspects(&self) -> bool {
        self.suspected
    }

    /// What was seen so far does not belong to what will be; what is usual is usual still.
    pub(in super::super) fn forget(&mut self) {
        *self = Self { noise: self.noise, ..Self::default() };
    }

    fn judge(&mut self, newest: &Vector3<f64>) -> bool {
        let findings = [0, 1, 2].map(|axis| self.finding(axis));
        // Neither fits better than to the noise of a block.
        let rest = |f: &AxisFinding, explained: f64| (f.unusual - explained).max(self.noise);
        let wrong = |f: &AxisFinding, part: f64| {
            !SOUND.contains(&f.gain)
                && f.turn > LEAST_TURN * LEAST_TURN
                && f.explained > part * f.unusual
                && rest(f, f.by_standing) > RIVAL * rest(f, f.explained)
                && 3.0 * f.explained > SIGMAS * SIGMAS * self.noise
        };
        let found = findings.iter().any(|f| wrong(f, EXPLAINS) && f.largest < ONE_BLOCK * f.unusual);
        self.suspected = findings.iter().any(|f| wrong(f, SUSPECTED));
        if !self.suspected {
            let square = newest.norm_squared().min(CLIPPED * self.noise);
            self.noise = (self.noise + NOISE_GAIN * (square - self.noise)).max(LEAST_NOISE);
        }
        if found {
            self.forget();
        }
        found
    }

    fn finding(&self, axis: usize) -> AxisFinding {
        let (mut vector, mut whole, mut turn, mut largest, mut by_standing) = (0.0, 0.0, 0.0, 0.0f64, 0.0);
        for block in &self.blocks[..self.filled] {
            let column = block.turned.column(axis);
            vector += column.dot(&block.rest);
            whole += block.rest.norm_squared();
            largest = largest.max(block.rest.norm_squared());
            turn += column.norm_squared();
            let all = block.turned.column_sum();
            by_standing -= all.dot(&(block.rest * 2.0 + all));
        }
        let gain = if turn > 0.0 { vector / turn } else { 0.0 };
        let unusual = (whole - self.noise * self.filled as f64).max(0.0);
        AxisFinding { gain, explained: gain * vector, unusual, by_standing, turn, largest }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Ten fields a second of a vehicle that rolls, pitches and yaws to and fro, with a noise of a hundredth; `gyros` is what they tell of a rate, from
    /// 20 s on, and `compass` what it makes of a field. When an axis is found to be wrong, s.
    fn fly(
        gyros: impl Fn(Vector3<f64>) -> Vector3<f64>,
        compass: impl Fn(f64, Vector3<f64>) -> Vector3<f64>,
    ) -> Option<f64> {
        let mut witness = GyroByField::default();
        let mut b = Vector3::new(0.4, 0.1, 0.9);
        let mut told = vec![Vector3::zeros()];
        for k in 1..600u32 {
            let t = 0.1 * f64::from(k);
            let rate = Vector3::new((2.1 * t).sin() * 0.8, (1.7 * t).cos() * 0.9, (0.6 * t).sin() * 0.9);
            b = so3::exp(&(rate * -0.1)) * b;
            told.push(if t > 20.0 { gyros(rate) } else { rate } * 0.1);
            let noise = Vector3::new(
                f64::from(k * 7919 % 31) - 15.0,
                f64::from(k * 104_729 % 37) - 18.0,
                f64::from(k * 1299 % 29) - 14.0,
            ) * 6e-4;
            let field = if t > 20.0 { compass(t, b) } else { b } + noise;
            let time = AutopilotTime::from_micros(i64::from(k) * 100_000);
            let turned = |since: AutopilotTime| {
                let from = (since.micros() / 100_000) as usize;
                Some(told[from + 1..].iter().sum())
            };
            if witness.observe(time, &field, turned) {
                return Some(t);
            }
        }
        None
    }

    fn honest(_: f64, b: Vector3<f64>) -> Vector3<f64> {
        b
    }

    #[test]
    fn an_axis_of_the_wrong_sign_is_found_within_some_seconds() {
        for axis in 0..3 {
            let flipped = |mut w: Vector3<f64>| {
                w[axis] = -w[axis];
                w
            };
            let found = fly(flipped, honest);
            assert!(found.is_some_and(|t| (20.0..30.0).contains(&t)), "{axis}: {found:?}");
        }
    }

    #[test]
    fn what_is_wrong_with_a_magnetometer_is_none_of_the_gyros() {
        let sound = |w: Vector3<f64>| w;
        assert_eq!(fly(sound, honest), None);
        assert_eq!(fly(sound, |_, _| Vector3::new(0.4, 0.1, 0.9)), None, "stuck with noise");
        assert_eq!(fly(sound, |_, b| so3::exp(&Vector3::new(0.0, 0.0, 0.6)) * b), None, "turned");
        assert_eq!(fly(sound, |_, b| b + Vector3::new(0.3, 0.2, 0.0)), None, "bias");
        for k in 0..30 {
            let towards = Vector3::new(
                (0.7 * f64::from(k)).sin(),
                (1.9 * f64::from(k)).cos(),
                (3.1 * f64::from(k)).sin(),
            );
            let swamped = |t: f64, b: Vector3<f64>| b * 0.3 + towards * (0.8 + 0.3 * (0.9 * t).sin());
            assert_eq!(fly(sound, swamped), None, "a bias larger than the field, {k}");
        }
        assert_eq!(fly(sound, |t, b| b + Vector3::x() * 0.3 * (1.3 * t).sin()), None, "currents");
        assert_eq!(fly(|w| w + Vector3::new(0.05, 0.0, 0.05), honest), None, "a biased gyro");
    }
}
