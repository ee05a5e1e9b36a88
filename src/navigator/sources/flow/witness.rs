//! Flow against inertia over some seconds: whether the velocity that a flow shows changes as the accelerometers say.
//!
//! With I the acceleration that has added up since some time, v − I of a sound flow is constant but for what inertia drifts. A flow that
//! becomes zero, turns its sign, is scaled or gets a bias while the vehicle moves makes it step; one that shows nothing of a
//! motion that begins makes it run away. No velocity has to be known for that, so it holds in an outage as well as with GNSS, and what the
//! filter has been taught by a flow that is wrong has no part in it but for the tilt of a second.
//!
//! v − I is averaged over blocks. The median of the newest blocks is compared with that of earlier ones, axis by axis, with the variance
//!
//! σ² = σ_flow² + (ε|v|)² + (σ_a τ)²,
//!
//! σ_flow what a block's noise is, ε what any flow's scale is off by from one ground to the next and what is not known of this one's, σ_a the acceleration that a tilt of the
//! filter's own doubt makes of gravity. What real vehicles do beyond that (vibration, terrain, latency) is measured: the mean of the squares over
//! their variance, while nothing is wrong, is a factor on the variance.
//!
//! A heading that is corrected meanwhile turns v against I; by how much is known, and adds to ε.
//!
//! A contradiction is the flow's where the two have parted as a sensor does, and inertia's where they have as that leads away ([`super::super::parting`]); where both explain it
//! as well, inertia's on a multirotor whose thrust alone, with the drag of before, makes the velocity that the flow shows: nothing else pushes it sideways.
//!
//! If a multirotor's thrust alone shows it as well, it is not the level accelerometers that are wrong.
//!
//! A finding is over when the differences have fitted for some seconds in which the vehicle's velocity has changed by more than they may be
//! wrong by: a flow that shows zero of a hover fits, and proves nothing.

use nalgebra::Vector2;

use crate::time::AutopilotTime;

use super::super::parting::{LedAway, Parted, PartingPoint, parted};
use crate::navigator::tuning::flow::BACK;
use crate::navigator::tuning::flow_witness::{
    BLOCK_S, BLOCKS, BY_THRUST, CLIPPED, CONTRADICTS, EVIDENCE, FIT, FOLLOWED_S, GROUP, LEARNED_S,
    LEAST_MISFIT, LONGEST_S, MISFIT, MOVED_S, PRIOR_S, SCALE,
};
use crate::navigator::tuning::gnss::LEAST_SPEED_SIGMA;

/// A flow's velocity with what it is compared with.
#[derive(Clone, Copy, Debug)]
pub(super) struct FlowAndInertia {
    pub(super) time: AutopilotTime,
    /// Velocity by flow, and what the acceleration has added up to, NE, m/s.
    pub(super) v_ne: Vector2<f64>,
    pub(super) impulse_ne: Vector2<f64>,
    /// Velocity by GNSS, where that is trusted, NE, m/s.
    pub(super) reference_ne: Option<Vector2<f64>>,
    /// What of that a multirotor's body felt sideways, which is drag: all the rest is thrust. NE, m/s.
    pub(super) sideways_ne: Option<Vector2<f64>>,
    /// Velocity that is navigated on, NE, m/s.
    pub(super) held_ne: Vector2<f64>,
    /// Of the flow's velocity, an axis, m²/s².
    pub(super) variance: f64,
    /// Of its scale, and of what it is turned by, together.
    pub(super) scale_variance: f64,
    /// Standard deviation of the acceleration that the filter's attitude and biases leave, m/s².
    pub(super) accel_sigma: f64,
    /// What the heading has been corrected by since some time, rad: it turns the one velocity against the other.
    pub(super) corrected: f64,
    /// Whether what the acceleration adds up to was begun anew since the last: any number that is another then.
    pub(super) epoch: u32,
}

/// A difference that is no accident.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct Contradiction {
    /// The flow still fitted then.
    pub(super) fitted: AutopilotTime,
    /// What the flow shows now, and how far that has gone from inertia since, NE, m/s.
    pub(super) v_ne: Vector2<f64>,
    pub(super) apart_ne: Vector2<f64>,
    /// Whose doing that is.
    pub(super) parted: Parted,
    /// A multirotor's thrust alone shows it as well: its level accelerometers are not what is wrong.
    pub(super) by_thrust_too: bool,
    /// What inertia has done since, if it is inertia's.
    pub(super) led: LedAway,
}

/// Means over a block.
#[derive(Clone, Copy, Debug)]
struct VelocityBlock {
    begin: AutopilotTime,
    /// Of the last sample.
    end: AutopilotTime,
    samples: f64,
    v: Vector2<f64>,
    impulse: Vector2<f64>,
    held: Vector2<f64>,
    sideways: Option<Vector2<f64>>,
    /// The flow's velocity less GNSS's, where all samples have that.
    off: Option<Vector2<f64>>,
    /// Of a sample.
    variance: f64,
    scale_variance: f64,
    accel_sigma: f64,
    corrected: f64,
}

impl VelocityBlock {
    fn new(s: &FlowAndInertia) -> Self {
        Self {
            begin: s.time,
            end: s.time,
            samples: 1.0,
            v: s.v_ne,
            impulse: s.impulse_ne,
            held: s.held_ne,
            sideways: s.sideways_ne,
            off: s.reference_ne.map(|v| s.v_ne - v),
            variance: s.variance,
            scale_variance: s.scale_variance,
            accel_sigma: s.accel_sigma,
            corrected: s.corrected,
        }
    }

    fn add(&mut self, s: &FlowAndInertia) {
        self.samples += 1.0;
        let part = 1.0 / self.samples;
        self.end = s.time;
        self.v += (s.v_ne - self.v) * part;
        self.impulse += (s.impulse_ne - self.impulse) * part;
        self.held += (s.held_ne - self.held) * part;
        let sideways = self.sideways.zip(s.sideways_ne);
        self.sideways = sideways.map(|(mean, new)| mean + (new - mean) * part);
        let off = self.off.zip(s.reference_ne);
        self.off = off.map(|(off, v)| off + (s.v_ne - v - off) * part);
        self.variance += (s.variance - self.variance) * part;
        self.corrected += (s.corrected - self.corrected) * part;
        self.accel_sigma += (s.accel_sigma - self.accel_sigma) * part;
    }

    fn difference(&self) -> Vector2<f64> {
        self.v - self.impulse
    }
}

/// The newest blocks against earlier ones.
#[derive(Clone, Copy, Debug)]
struct Test {
    /// |Δ(v − I)|² and |ΔI|² over their variance.
    square: f64,
    moved: f64,
    v: Vector2<f64>,
    apart: Vector2<f64>,
    /// What of the latter is left where only thrust is felt and the drag of the earlier ones.
    apart_by_thrust: Option<Vector2<f64>>,
    variance: f64,
    /// Of the earlier ones.
    then: AutopilotTime,
}

impl Test {
    /// Whether it is a multirotor's sideways axes alone that the flow contradicts: nothing pushes it sideways but the air.
    fn is_sideways(&self, misfit: f64) -> bool {
        self.apart_by_thrust.is_some_and(|left| {
            left.norm_squared() < FIT * misfit * self.variance && left.norm() < BY_THRUST * self.apart.norm()
        })
    }
}

/// See the module's documentation.
#[derive(Clone, Debug)]
pub(super) struct InertialWitness {
    blocks: Vec<VelocityBlock>,
    open: Option<VelocityBlock>,
    epoch: u32,
    /// Factor on the variance, as it shows, and over how long that was learned, s.
    misfit: f64,
    learned_s: f64,
    /// Evidence of differences that are none of them beyond doubt (Page's cumulative sum), and since when there is any.
    evidence: f64,
    doubted: Option<AutopilotTime>,
    /// For how long the flow has fitted while it is accused, s, and how much of that the vehicle has moved, s.
    fits_s: f64,
    moved_s: f64,
    /// What it went by when it was accused it has gone back by since, and nothing else.
    stepped_back: bool,
}

impl InertialWitness {
    pub(super) fn new() -> Self {
        Self {
            blocks: Vec::with_capacity(BLOCKS),
            open: None,
            epoch: 0,
            misfit: MISFIT,
            learned_s: PRIOR_S,
            evidence: 0.0,
            doubted: None,
            fits_s: 0.0,
            moved_s: 0.0,
            stepped_back: false,
        }
    }

    /// Nothing of what was compared so far holds any more.
    pub(super) fn forget(&mut self) {
        self.blocks.clear();
        self.open = None;
        (self.fits_s, self.moved_s) = (0.0, 0.0);
        (self.evidence, self.doubted) = (0.0, None);
        self.stepped_back = false;
    }

    /// Whether it does not fit at present, though that may be an accident: it should not teach anything.
    pub(super) fn is_doubted(&self) -> bool {
        self.doubted.is_some()
    }

    /// Takes a flow; `accused`: a finding stands against it, by which it had gone so far from inertia, NE, m/s. A contradiction when a block that ends with it shows one.
    pub(super) fn note(
        &mut self,
        s: &FlowAndInertia,
        accused: Option<&Vector2<f64>>,
    ) -> Option<Contradiction> {
        if s.epoch != self.epoch {
            self.forget();
            self.epoch = s.epoch;
        }
        let open = match &mut self.open {
            None => {
                self.open = Some(VelocityBlock::new(s));
                return None;
            }
            Some(open) if s.time.seconds_since(open.begin) < BLOCK_S => {
                open.add(s);
                return None;
            }
            Some(open) => std::mem::replace(open, VelocityBlock::new(s)),
        };
        let gap_s = self.blocks.last().map_or(BLOCK_S, |b| open.begin.seconds_since(b.end));
        if self.blocks.len() == BLOCKS {
            self.blocks.remove(0);
        }
        self.blocks.push(open);
        self.judge(accused, gap_s.clamp(0.0, LONGEST_S).max(BLOCK_S))
    }

    /// Whether the last that inertia has seen of an accused flow is that it went back as far as it had gone.
    pub(super) fn stepped_back(&self) -> bool {
        self.stepped_back
    }

    /// Whether an accused flow has proven itself.
    pub(super) fn follows(&self) -> bool {
        self.fits_s > FOLLOWED_S && self.moved_s > MOVED_S
    }

    /// How far it may be off as a block's mean beyond what it says of itself: factor on the variance.
    fn judge(&mut self, accused: Option<&Vector2<f64>>, elapsed_s: f64) -> Option<Contradiction> {
        let (worst, moved) = self.tests()?;
        let square = worst.square / self.misfit;
        if let Some(went_ne) = accused {
            if square < FIT {
                self.fits_s += elapsed_s;
                self.moved_s += if moved / self.misfit > CONTRADICTS { elapsed_s } else { 0.0 };
            } else {
                // What it told before has no part in whether it follows from now on.
                (self.fits_s, self.moved_s) = (0.0, 0.0);
                self.stepped_back = (worst.apart + went_ne).norm() < BACK * went_ne.norm();
                self.blocks.drain(..self.blocks.len().saturating_sub(1));
            }
            return None;
        }
        (self.fits_s, self.moved_s) = (0.0, 0.0);
        // The mean of the square is 2 where the variance is right; one that is clipped learns nothing from what is being judged.
        if !self.is_doubted() {
            let clipped = (0.5 * worst.square).min(CLIPPED * self.misfit);
            self.learned_s = (self.learned_s + elapsed_s).min(LEARNED_S);
            self.misfit += (clipped.max(LEAST_MISFIT) - self.misfit) * (elapsed_s / self.learned_s);
        }
        if self.agrees_with_reference() {
            (self.evidence, self.doubted) = (0.0, None);
            return None;
        }
        self.evidence = (self.evidence + (square - FIT) * (elapsed_s / (BLOCK_S * GROUP as f64))).max(0.0);
        let since = (self.evidence > 0.0).then(|| self.doubted.unwrap_or(worst.then));
        self.doubted = since;
        let wrong = square > CONTRADICTS || self.evidence > EVIDENCE;
        let fitted = since.map_or(worst.then, |t| t.min(worst.then));
        wrong.then(|| self.contradiction(&worst, fitted))
    }

    /// What the newest blocks show, which fitted then.
    fn contradiction(&self, worst: &Test, fitted: AutopilotTime) -> Contradiction {
        let mut points = [PartingPoint::default(); BLOCKS];
        let known = self.blocks.len().min(BLOCKS);
        for (point, b) in points.iter_mut().zip(&self.blocks) {
            let (apart, off) = (b.difference(), b.held - b.v);
            *point = PartingPoint { t: b.end.seconds_since(fitted), apart, felt: b.impulse, off };
        }
        let points = &points[..known];
        let parted = match parted(points) {
            Some(Parted::Either(led)) if worst.is_sideways(self.misfit) => Parted::LedAway(led),
            parted => parted.unwrap_or(Parted::AtOnce),
        };
        let led = LedAway::new(points, 0.0, worst.apart.norm());
        let by_thrust_too =
            worst.apart_by_thrust.is_some_and(|left| left.norm() > BY_THRUST * worst.apart.norm());
        Contradiction { fitted, v_ne: worst.v, apart_ne: worst.apart, parted, by_thrust_too, led }
    }

    /// Whether the newest blocks show GNSS's velocity: two that agree are not wrong together because a third says so.
    fn agrees_with_reference(&self) -> bool {
        let newest = &self.blocks[self.blocks.len().saturating_sub(GROUP)..];
        if newest.len() < GROUP || newest.iter().any(|b| b.off.is_none()) {
            return false;
        }
        let off = median(newest, |b| b.off.unwrap_or_default());
        let speed = median(newest, |b| b.v - b.off.unwrap_or_default()).norm_squared();
        let noise = newest.iter().map(|b| b.variance / b.samples).sum::<f64>() / GROUP as f64;
        let variance = noise + SCALE * SCALE * speed + LEAST_SPEED_SIGMA * LEAST_SPEED_SIGMA;
        off.norm_squared() < FIT * self.misfit * variance
    }

    /// The newest group against every earlier one: the one that fits worst, and the most that the vehicle has moved between them.
    fn tests(&self) -> Option<(Test, f64)> {
        let split = self.blocks.len().checked_sub(GROUP)?;
        let newest = &self.blocks[split..];
        let mut worst: Option<Test> = None;
        let mut moved = 0.0f64;
        for earlier in self.blocks[..split].windows(GROUP) {
            let Some(test) = compare(earlier, newest) else { continue };
            moved = moved.max(test.moved);
            if worst.is_none_or(|w| test.square > w.square) {
                worst = Some(test);
            }
        }
        worst.map(|w| (w, moved))
    }
}

/// `None` where they are too far apart, or their blocks are.
fn compare(earlier: &[VelocityBlock], newest: &[VelocityBlock]) -> Option<Test> {
    let (from, to) = (earlier.first()?, newest.last()?);
    if to.end.seconds_since(from.begin) > LONGEST_S {
        return None;
    }
    let tau = to.begin.seconds_since(from.begin);
    let apart = median(newest, VelocityBlock::difference) - median(earlier, VelocityBlock::difference);
    let impulse = median(newest, |b| b.impulse) - median(earlier, |b| b.impulse);
    let v_then = median(earlier, |b| b.v);
    let by_thrust = || {
        let sideways = |of: &[VelocityBlock]| {
            of.iter().all(|b| b.sideways.is_some()).then(|| median(of, |b| b.sideways.unwrap_or_default()))
        };
        let drag_then =
            (from.sideways? - earlier.last()?.sideways?) / -earlier.last()?.begin.seconds_since(from.begin);
        Some(apart + sideways(newest)? - sideways(earlier)? - drag_then * tau)
    };
    let speed = v_then.norm_squared().max((v_then + impulse).norm_squared());
    let mean =
        |of: &[VelocityBlock], f: fn(&VelocityBlock) -> f64| of.iter().map(f).sum::<f64>() / of.len() as f64;
    let noise = |b: &VelocityBlock| b.variance / b.samples;
    let drift = mean(newest, |b| b.accel_sigma).max(mean(earlier, |b| b.accel_sigma)) * tau;
    let turned = mean(newest, |b| b.corrected) - mean(earlier, |b| b.corrected);
    let scale = SCALE * SCALE + turned * turned + mean(newest, |b| b.scale_variance);
    let variance = mean(newest, noise) + mean(earlier, noise) + scale * speed + drift * drift;
    Some(Test {
        square: apart.norm_squared() / variance,
        moved: impulse.norm_squared() / variance,
        v: median(newest, |b| b.v),
        apart,
        apart_by_thrust: by_thrust(),
        variance,
        then: earlier.last()?.begin,
    })
}

/// Axis by axis.
fn median(of: &[VelocityBlock], f: impl Fn(&VelocityBlock) -> Vector2<f64>) -> Vector2<f64> {
    let axis = |i: usize| {
        let mut values = [0.0; GROUP];
        for (value, block) in values.iter_mut().zip(of) {
            *value = f(block)[i];
        }
        values.sort_by(f64::total_cmp);
        values[GROUP / 2]
    };
    Vector2::new(axis(0), axis(1))
}

#[cfg(test)]
mod tests {
    use super::*;

    /// A flight of accelerations along north, with a flow that tells `told` of the velocity; the witness, and when it contradicted first, s.
    fn fly(
        seconds: f64,
        accel: impl Fn(f64) -> f64,
        told: impl Fn(f64, f64) -> f64,
    ) -> (InertialWitness, Option<f64>) {
        let mut witness = InertialWitness::new();
        let (mut v, mut went) = (0.0, None);
        let dt = 0.05;
        for k in 0..(seconds / dt) as u32 {
            let t = f64::from(k) * dt;
            v += accel(t) * dt;
            // What real flows scatter by.
            let scatter = 0.2 * f64::from(k * 7919 % 13).sin();
            let s = FlowAndInertia {
                time: AutopilotTime::from_micros((t * 1e6) as i64),
                v_ne: Vector2::new(told(t, v) + scatter, scatter),
                impulse_ne: Vector2::new(v + 3.0 + 0.02 * t, 0.01 * t),
                sideways_ne: None,
                reference_ne: None,
                held_ne: Vector2::zeros(),
                variance: 0.04,
                scale_variance: 0.0004,
                accel_sigma: 0.03,
                corrected: 0.0,
                epoch: 1,
            };
            let accused = went.as_ref().map(|(_, apart_ne)| apart_ne);
            if let Some(found) = witness.note(&s, accused) {
                went.get_or_insert((t, found.apart_ne));
            }
        }
        (witness, went.map(|(t, _)| t))
    }

    /// To and fro with up to 6 m/s.
    fn to_and_fro(t: f64) -> f64 {
        2.4 * (0.4 * t).cos()
    }

    #[test]
    fn a_flow_that_follows_inertia_is_never_contradicted() {
        let (witness, at) = fly(600.0, to_and_fro, |_, v| 0.97 * v);
        assert_eq!(at, None);
        assert!(!witness.is_doubted());
    }

    #[test]
    fn zero_and_wrong_scale_and_sign_and_bias_are_seen_within_three_seconds_of_motion() {
        type Told = fn(f64) -> f64;
        let wrong: [(&str, Told); 5] = [
            ("zero", |_| 0.0),
            ("double", |v| 2.0 * v),
            ("half", |v| 0.5 * v),
            ("turned round", |v| -v),
            ("biased", |v| v + 2.0),
        ];
        for (name, told) in wrong {
            let (_, at) = fly(80.0, to_and_fro, |t, v| if t < 60.0 { v } else { told(v) });
            assert!(at.is_some_and(|t| (60.0..63.0).contains(&t)), "{name}: {at:?}");
        }
    }

    #[test]
    fn a_zero_in_a_hover_is_right_until_the_vehicle_moves() {
        let hovers = |t: f64| if t < 90.0 { 0.0 } else { 1.0 };
        let (_, at) = fly(95.0, hovers, |t, v| if t < 30.0 { v } else { 0.0 });
        assert!(at.is_some_and(|t| (90.0..93.0).contains(&t)), "{at:?}");
    }

    #[test]
    fn it_follows_again_only_by_moving() {
        let rests = |t: f64| if t < 80.0 { to_and_fro(t) } else { 0.0 };
        let zero = |t: f64, v: f64| if (60.0..85.0).contains(&t) { 0.0 } else { v };
        let (witness, at) = fly(120.0, rests, zero);
        assert!(at.is_some() && !witness.follows());
        let (witness, at) = fly(95.0, to_and_fro, zero);
        assert!(at.is_some() && witness.follows());
    }

    #[test]
    fn it_has_gone_back_where_it_steps_by_as_much_as_it_had_gone_and_not_while_it_stays() {
        let until = |end: f64| move |t: f64, v: f64| if (60.0..end).contains(&t) { v + 2.0 } else { v };
        let (witness, at) = fly(95.0, to_and_fro, until(80.0));
        assert!(at.is_some() && witness.follows() && witness.stepped_back());
        let (witness, at) = fly(95.0, to_and_fro, until(200.0));
        assert!(at.is_some() && witness.follows() && !witness.stepped_back());
    }

    #[test]
    fn another_epoch_begins_anew() {
        let mut witness = InertialWitness::new();
        for k in 0..400u32 {
            let t = f64::from(k) * 0.05;
            let s = FlowAndInertia {
                time: AutopilotTime::from_micros((t * 1e6) as i64),
                v_ne: Vector2::zeros(),
                impulse_ne: Vector2::repeat(if k < 200 { 0.0 } else { 50.0 }),
                sideways_ne: None,
                reference_ne: None,
                held_ne: Vector2::zeros(),
                variance: 0.04,
                scale_variance: 0.0,
                accel_sigma: 0.03,
                corrected: 0.0,
                epoch: u32::from(k >= 200),
            };
            assert_eq!(witness.note(&s, None), None, "{k}");
        }
    }
}
