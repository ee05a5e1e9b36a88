//! What a receiver's positions have moved by and what a witness says that the vehicle has travelled, in blocks of about a second.
//!
//! They differ by y = w t + J x + e: w is what the receiver walks by; x what the witness' calibration is wrong by; e the witness' noise, which adds up, and that of the
//! positions at both ends, which does not: E e_k² = q t + 2 R and E e_k e_{k−1} = −R, both measured ([`NoiseAndWalk`], of the differences of what successive times have
//! moved by, in which no constant is left).

use nalgebra::{Matrix2x4, Vector2};

use super::travel_path::{Recalibration, TravelPlace};
use crate::filter::NoiseAndWalk;
use crate::navigator::tuning::witness_blocks::{
    BLOCK_S, FIX_HOLE_S, NOISE_MEMORY_S, NOISE_SPANS, START_GROWTH, START_VARIANCE,
};
use crate::time::AutopilotTime;

/// A second of both.
#[derive(Clone, Copy, Debug, Default)]
pub(super) struct WitnessBlock {
    pub(super) seconds: f64,
    /// For so long of it a walk went on that is looked for, s.
    pub(super) walked_s: f64,
    /// What GNSS moved by more than the witness travelled, NE, m.
    pub(super) gap_ne: Vector2<f64>,
    pub(super) sensitivity: Matrix2x4<f64>,
    /// It begins where the one before has ended.
    pub(super) follows: bool,
    /// When it ended.
    pub(super) ended: Option<AutopilotTime>,
}

impl WitnessBlock {
    /// y, m/s.
    fn rate(&self) -> Vector2<f64> {
        self.gap_ne / self.seconds
    }
}

#[derive(Clone, Copy, Debug)]
struct LastFix {
    /// As stamped, and when it was measured.
    times: [AutopilotTime; 2],
    position_ne: Vector2<f64>,
    place: Option<TravelPlace>,
}

/// What a fix did.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum BlockStep {
    /// The block goes on, or cannot.
    Goes,
    /// The receiver has jumped: what was is not comparable.
    Jumped,
    /// A block is whole.
    Closed,
}

/// See the module's documentation.
#[derive(Clone, Debug)]
pub(super) struct WitnessBlocks {
    last: Option<LastFix>,
    open: WitnessBlock,
    /// Newest last.
    blocks: Vec<WitnessBlock>,
    most: usize,
    fastest_mps: f64,
    jump_m: f64,
    /// R, m², and q, m²/s, on an axis.
    pub(super) noise: NoiseAndWalk,
}

impl WitnessBlocks {
    /// `most` of them are kept. Who parts faster than by `fastest_mps` m/s does not see the ground. A receiver that moves by `jump_m` m more than the witness between two
    /// fixes has jumped.
    pub(super) fn new(most: usize, fastest_mps: f64, jump_m: f64) -> Self {
        Self {
            last: None,
            open: WitnessBlock::default(),
            blocks: Vec::with_capacity(most),
            most,
            fastest_mps,
            jump_m,
            noise: NoiseAndWalk::expecting(START_VARIANCE, START_GROWTH, NOISE_MEMORY_S),
        }
    }

    /// Newest last.
    pub(super) fn all(&self) -> &[WitnessBlock] {
        &self.blocks
    }

    /// The last `n`, oldest first, if there are so many.
    pub(super) fn last(&self, n: usize) -> Option<&[WitnessBlock]> {
        self.blocks.get(self.blocks.len().checked_sub(n)?..)
    }

    /// Newest first.
    pub(super) fn newest(&self, n: usize) -> impl Iterator<Item = &WitnessBlock> {
        self.blocks.iter().rev().take(n)
    }

    /// How many have ended, by the most of them, within the last `seconds` s: there may be holes between them.
    pub(super) fn within(&self, seconds: f64) -> usize {
        let Some(last) = &self.last else { return 0 };
        let middle_s = |b: &WitnessBlock| b.ended.map(|t| last.times[1].seconds_since(t) + 0.5 * b.seconds);
        self.blocks.iter().rev().take_while(|b| middle_s(b).is_some_and(|s| s <= seconds)).count()
    }

    /// Whether the witness was heard at the last fix.
    pub(super) fn watches(&self) -> bool {
        self.last.is_some_and(|l| l.place.is_some())
    }

    /// The calibration that testifies is another: what was seen is as it would have shown it.
    pub(super) fn recalibrate(&mut self, by: &Recalibration) {
        for block in self.blocks.iter_mut().chain(std::iter::once(&mut self.open)) {
            block.gap_ne -= block.sensitivity * by.change;
        }
        if let Some(last) = &mut self.last {
            last.place = last.place.map(|place| place.recalibrated(by));
        }
    }

    /// What comes is not comparable with what was.
    pub(super) fn interrupt(&mut self) {
        (self.last, self.open) = (None, WitnessBlock::default());
        self.blocks.clear();
    }

    /// A fix, as stamped and when it was measured, and where the witness had come to then.
    pub(super) fn fix(
        &mut self,
        times: [AutopilotTime; 2],
        position_ne: Vector2<f64>,
        place: Option<TravelPlace>,
    ) -> BlockStep {
        let here = LastFix { times, position_ne, place };
        let Some(last) = self.last.replace(here) else { return BlockStep::Goes };
        // What has been learned of the latency between is no motion: the witness is that of the receiver's own time.
        let [dt, flown_s] = [0, 1].map(|i| times[i].seconds_since(last.times[i]));
        let pair = last.place.zip(place).filter(|(a, b)| a.stretch == b.stretch);
        let Some((a, b)) = pair.filter(|_| dt > 0.0 && dt < FIX_HOLE_S && flown_s > 0.0) else {
            self.open.follows = false;
            return BlockStep::Goes;
        };
        let moved = position_ne - last.position_ne;
        let travelled = (b.travelled_ne - a.travelled_ne) * (dt / flown_s);
        if (moved - travelled).norm() > self.jump_m {
            // A jump is none of its business, and tells nothing of a walk before and after.
            self.open = WitnessBlock::default();
            self.blocks.clear();
            return BlockStep::Jumped;
        }
        let open = &mut self.open;
        open.seconds += dt;
        open.gap_ne += moved - travelled;
        // GNSS less the witness: an error of the witness counts the other way.
        open.sensitivity -= (b.sensitivity - a.sensitivity) * (dt / flown_s);
        if open.seconds < BLOCK_S {
            return BlockStep::Goes;
        }
        open.walked_s = open.seconds;
        open.ended = Some(times[1]);
        let next = WitnessBlock { follows: true, ..WitnessBlock::default() };
        let block = std::mem::replace(open, next);
        if block.rate().norm() > self.fastest_mps {
            self.blocks.clear();
            return BlockStep::Goes;
        }
        if self.blocks.len() >= self.most {
            self.blocks.remove(0);
        }
        self.blocks.push(block);
        self.learn_noise(block.seconds);
        BlockStep::Closed
    }

    /// What n blocks have moved by less what the n before them have, squared: q t + 3 R, which [`NoiseAndWalk`] knows as 2 R′ + q t.
    fn learn_noise(&mut self, dt: f64) {
        for (at, n) in NOISE_SPANS.into_iter().enumerate() {
            let span = |from: usize| -> (Vector2<f64>, f64) {
                let blocks = self.newest(from + n).skip(from);
                blocks.fold((Vector2::zeros(), 0.0), |(m, s), b| (m + b.gap_ne, s + b.seconds))
            };
            // Of two that are apart the ends' noises are not the same.
            if self.blocks.len() < 2 * n || !self.newest(2 * n - 1).all(|b| b.follows) {
                break;
            }
            let ((now, now_s), (before, before_s)) = (span(0), span(n));
            let squared = (now - before * (now_s / before_s)).norm_squared();
            self.noise.learn(at, dt, now_s, 0.25 * squared);
        }
    }
}
