//! GNSS against the air: has the receiver's velocity stepped, or does the wind blow as it did?
//!
//! What a receiver has moved by in a second less what the vehicle has travelled through the air is the wind, y = W t + J x + s t·1(after θ) + e: x what the airspeed's or the
//! drag's scale is wrong by, and the nose's direction; s a step of the receiver's velocity at θ; e gusts, and the noise of the positions (`witness_blocks`).
//! By itself a step of y may as well be the wind's. But where inertia suspects the receiver (`velocity_step`) of a step of this size at this time, and
//! the air shows the same wind before and after, there was none: inertia erred, as it does in manoeuvres that are sampled badly. How much more likely that is
//! ([`WalkSums::against`]) is weighed in what such windows usually show of this vehicle's gusts ([`UsualSpread`]).

use nalgebra::{Matrix2x4, Matrix4, Vector2, Vector4};

use super::travel_path::{TravelPath, TravelTestimony};
use super::usual::UsualSpread;
use super::walk_fit::WalkSums;
use super::witness_blocks::{BlockStep, WitnessBlock, WitnessBlocks};
use crate::navigator::tuning::gnss_by_air::{
    AFTER, BEFORE, BLOCKS, CLIPPED_DECADES, FIRM, HOLE_S, JUMP_M, LEAST_AFTER, LEAST_BEFORE, MEMORY, SCALE,
    SIDE, SPREAD, TURN, WIND_MPS,
};
use crate::navigator::tuning::witness_blocks::WALK_SIGMA_MPS;
use crate::time::AutopilotTime;

/// See the module's documentation.
#[derive(Clone, Debug)]
pub(in super::super) struct GnssByAir {
    path: TravelPath,
    blocks: WitnessBlocks,
    /// The wind from which y is counted, NE, m/s, as it was when this began.
    wind_ne: Option<Vector2<f64>>,
    /// What a step in the middle of a window explains, as a square of sigmas.
    usual: UsualSpread,
    /// How many blocks there are until that is learned again.
    due: usize,
}

impl GnssByAir {
    pub(in super::super) fn new() -> Self {
        Self {
            path: TravelPath::new(HOLE_S),
            blocks: WitnessBlocks::new(BLOCKS, f64::INFINITY, JUMP_M),
            wind_ne: None,
            usual: UsualSpread::expecting(SPREAD, FIRM),
            due: 2 * SIDE,
        }
    }

    /// A velocity through the air that nothing but air and attitude tell, NE, m/s; `wind_ne`: the wind by now, as far as it is known, m/s.
    pub(in super::super) fn tell(
        &mut self,
        time: AutopilotTime,
        air_ne: Vector2<f64>,
        wind_ne: Vector2<f64>,
    ) {
        if !(air_ne + wind_ne).sum().is_finite() {
            return;
        }
        let wind_ne = *self.wind_ne.get_or_insert(wind_ne);
        let mut sensitivity = Matrix2x4::identity();
        sensitivity.set_column(2, &air_ne);
        sensitivity.set_column(3, &Vector2::new(-air_ne.y, air_ne.x));
        self.path.add(time, TravelTestimony { velocity_ne: air_ne + wind_ne, sensitivity });
    }

    /// What comes is not comparable with what was.
    pub(in super::super) fn interrupt(&mut self) {
        self.path.interrupt();
        self.blocks.interrupt();
        self.wind_ne = None;
    }

    /// A fix, as stamped and when it was measured; `doubted`: it shows nothing usual.
    pub(in super::super) fn fix(
        &mut self,
        times: [AutopilotTime; 2],
        position_ne: Vector2<f64>,
        doubted: bool,
    ) {
        let place = self.path.at(times[1]);
        match self.blocks.fix(times, position_ne, place) {
            BlockStep::Closed => {}
            BlockStep::Goes => return,
            // What slow fixes part by may be the wind: it is counted from as it is known by now.
            BlockStep::Jumped => return self.interrupt(),
        }
        if doubted {
            self.due = 2 * SIDE;
        } else if self.due > 0 {
            self.due -= 1;
        } else if let Some(square) = self.step_in_the_middle() {
            self.usual.learn(square.min(self.usual.limit(CLIPPED_DECADES)), MEMORY);
            self.due = SIDE;
        }
    }

    /// By how much it is more likely, ln, that the wind blows as it did, and there was no step of `step`, NE, m/s, of the receiver's velocity `seconds` ago; `None` where the
    /// air was not heard for long enough before and after.
    pub(in super::super) fn refutes(&self, seconds: f64, step: &Vector2<f64>) -> Option<f64> {
        let sums = self.around(self.blocks.within(seconds), [BEFORE, AFTER])?;
        Some(sums.against(step, &prior())? / (2.0 * self.usual.variance().max(1.0)))
    }

    /// What a step in the middle of the last blocks explains.
    fn step_in_the_middle(&self) -> Option<f64> {
        let sums = self.around(SIDE, [SIDE; 2])?;
        let (nothing, _) = sums.explained(1e-6, &prior())?;
        let (step, _) = sums.explained(WALK_SIGMA_MPS, &prior())?;
        Some(step - nothing)
    }

    /// The blocks around an onset that is `after` blocks ago, so many of them before and after it. A silence between them leaves the wind as it was.
    fn around(&self, after: usize, [most_before, most_after]: [usize; 2]) -> Option<WalkSums> {
        let all = self.blocks.all();
        let onset = all.len().checked_sub(after)?;
        let to = (onset + most_after).min(all.len());
        let from = onset.saturating_sub(most_before);
        let mut window = [WitnessBlock::default(); BEFORE + AFTER];
        if onset < from + LEAST_BEFORE || to < onset + LEAST_AFTER {
            return None;
        }
        for (at, (copy, block)) in window.iter_mut().zip(&all[from..to]).enumerate() {
            let walked_s = if from + at < onset { 0.0 } else { block.seconds };
            *copy = WitnessBlock { walked_s, ..*block };
        }
        Some(WalkSums::of(&window[..to - from], &self.blocks.noise))
    }
}

/// Information about the wind that is left, scale and turn.
fn prior() -> Matrix4<f64> {
    Matrix4::from_diagonal(&Vector4::new(WIND_MPS, WIND_MPS, SCALE, TURN).map(|sigma| sigma.powi(-2)))
}

#[cfg(test)]
mod tests {
    use super::*;

    /// What is found of a step of 1.5 m/s to the east 20 s before 150 s, on legs of 12 s at 20 m/s in a wind of 5 m/s that gusts; `lie`: what the receiver's velocity is off by,
    /// `wind`: what the wind has changed by.
    fn refuted(lie: impl Fn(f64) -> f64, wind: impl Fn(f64) -> f64) -> f64 {
        let mut air = GnssByAir::new();
        let mut p = Vector2::zeros();
        for k in 0..3000 {
            let (t, time) = (0.05 * f64::from(k), AutopilotTime::from_micros(50_000 * i64::from(k)));
            let heading = (t / 12.0).floor() * 1.9;
            let through = Vector2::new(heading.cos(), heading.sin()) * 20.0;
            let gust = Vector2::new((0.5 * t).sin(), (0.7 * t).cos()) * 0.2;
            p += (through + Vector2::new(3.0, 4.0 + lie(t) + wind(t)) + gust) * 0.05;
            // 2 % too much, and a nose that is off by half a degree.
            let told = through * 1.02 + Vector2::new(-through.y, through.x) * 0.009;
            if k % 4 == 0 {
                air.tell(time, told, Vector2::new(3.2, 3.9));
                let wander = Vector2::new((5.0 * t).sin(), (7.0 * t).cos()) * 0.1;
                air.fix([time; 2], p + wander, t > 129.0);
            }
        }
        air.refutes(20.0, &Vector2::new(0.0, 1.5)).unwrap()
    }

    #[test]
    fn a_wind_that_blows_as_it_did_refutes_a_step_and_a_step_is_not_refuted() {
        let step = |t: f64| if t > 130.0 { 1.5 } else { 0.0 };
        let none = refuted(|_| 0.0, |_| 0.0);
        let lie = refuted(step, |_| 0.0);
        assert!(none > 3.0 && lie < -3.0, "{none} {lie}");
        // Another wind looks the same: the air alone never charges anybody.
        assert!(refuted(|_| 0.0, step) < -3.0);
    }

    #[test]
    fn who_has_not_heard_the_air_for_long_enough_says_nothing() {
        let mut air = GnssByAir::new();
        let step = Vector2::new(0.0, 1.5);
        assert_eq!(air.refutes(20.0, &step), None);
        for k in 0..400 {
            let (t, time) = (0.1 * f64::from(k), AutopilotTime::from_micros(100_000 * i64::from(k)));
            // It is silent for some seconds in the middle.
            if !(15.0..20.0).contains(&t) {
                air.tell(time, Vector2::new(20.0, 0.0), Vector2::zeros());
            }
            air.fix([time; 2], Vector2::new(20.0 * t, 0.0), false);
        }
        let says = |air: &GnssByAir, seconds: f64| air.refutes(seconds, &step).unwrap_or(f64::NAN);
        assert!(says(&air, 22.0) > 0.0 && says(&air, 10.0) > 0.0, "a silence leaves the wind");
        assert!(says(&air, 2.0).is_nan() && says(&air, 36.0).is_nan(), "too little after, and before");
        air.tell(AutopilotTime::from_micros(41_000_000), Vector2::repeat(f64::NAN), Vector2::zeros());
        assert!(says(&air, 10.0).is_finite());
    }

    /// Its onset is found by time: a silence since is none of the blocks.
    #[test]
    fn a_silence_behind_a_step_does_not_move_it() {
        let mut air = GnssByAir::new();
        for k in 0..900 {
            let (t, time) = (0.1 * f64::from(k), AutopilotTime::from_micros(100_000 * i64::from(k)));
            if !(50.0..70.0).contains(&t) {
                air.tell(time, Vector2::new(20.0, 0.0), Vector2::zeros());
            }
            let wander = Vector2::new((5.0 * t).sin(), (7.0 * t).cos()) * 0.1;
            let walked = Vector2::new(0.0, 1.5 * (t - 30.0).max(0.0));
            air.fix([time; 2], Vector2::new(20.0 * t, 0.0) + walked + wander, t > 30.0);
        }
        let refuted = air.refutes(59.9, &Vector2::new(0.0, 1.5)).unwrap();
        assert!(refuted < -1.0, "{refuted}");
    }
}
