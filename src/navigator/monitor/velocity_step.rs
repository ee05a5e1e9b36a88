//! Whether a receiver's velocity steps where inertia feels nothing: so begins a lie that walks off with position and velocity together.
//!
//! With I the inertial acceleration that has added up, d = v_GNSS − I of an honest receiver is c + a t over some seconds: a is what tilt and biases are wrong
//! by. A vehicle cannot change its velocity without a force, so that a step s at a time θ, d = c + a t + s·1(t > θ), is the receiver's. What a tilt or an accelerometer
//! that goes wrong makes is a kink, d = c + a t + k·(t − θ)₊. Both are fitted by least squares for every θ of the last seconds; the step is a lie where it
//! explains more than is usual for this receiver ([`UsualPeak`]), more than any kink does, and more than a heading that is off makes of the change of velocity.
//!
//! Beside a flow all innovations of the filter may show a lie sooner (see `receiver_lie`): what they charge or doubt is held here as well, and ends in the same ways.
//!
//! What is far from usual and not beyond doubt is no charge: how far it has led, if it is a lie, is a part of what is claimed of the position.
//!
//! A lie stands until the velocity steps back, or until whatever else carries knows the velocity, or the position, well enough to see that GNSS agrees with it again; until
//! the receiver is silent for a while; and for as long as it leads further off than the position is uncertain without it. Who was silent, or does no
//! harm any more, is followed like any other, for nobody knows better, and the lie goes on as a doubt.

use nalgebra::Vector2;

use super::difference_noise::DifferenceNoise;
use super::felt_velocity::{FeltVelocity, VelocityLie};
use super::step_fit::{FittedSteps, FixWithImpulse, NUISANCES, VelocityStep, best_steps};
use super::step_look::{StepHunches, StepLook, UsualStep};
use super::usual::UsualPeak;
use super::velocity_doubt::{DoubtKind, VelocityDoubt};
use crate::navigator::tuning::velocity_step::{
    AT_ONCE, BACK, BACK_S, BORNE_OUT_S, DECADES, DOUBT_DECADES, FIRM, GROUND_NOISE_MPS, HOLE_S, KNOWN,
    LEARN_S, LEARNED, LEAST_LED_M, LEAVES, LOOK_S, MEMORY, ONCE_S, PARTED_S, PEAK, PEAK_DEVIATION, SAME_S,
    SAMPLES, SPACING_S, SPARE_GAIN, STANDS_MPS2, STILL, STILL_SAME_S, WINDOW_S,
};
use crate::time::{AutopilotTime, Span};

/// A step that may be a lie, when that was first seen, and when it was.
#[derive(Clone, Copy, Debug)]
struct StepCandidate {
    seen: AutopilotTime,
    onset: AutopilotTime,
}

/// See the module's documentation.
#[derive(Clone, Debug)]
pub(in super::super) struct VelocitySteps {
    /// Oldest first.
    felt: Vec<FixWithImpulse>,
    epoch: u32,
    noise: DifferenceNoise,
    /// Of steps that are old enough, and of younger ones.
    usual: [UsualStep; 2],
    learned: u32,
    learn_due: Option<AutopilotTime>,
    look_due: Option<AutopilotTime>,
    candidate: Option<StepCandidate>,
    lie: Option<VelocityLie>,
    /// How far another receiver does not share it, 0 to 1.
    not_shared: f64,
    /// What may be one.
    doubt: Option<VelocityDoubt>,
    /// What is too little for that.
    hunches: StepHunches,
    cleared: bool,
    /// For how long GNSS has agreed with what carries, s.
    agrees_since: Option<AutopilotTime>,
}

impl VelocitySteps {
    pub(in super::super) fn new() -> Self {
        Self {
            felt: Vec::with_capacity(SAMPLES),
            epoch: 0,
            noise: DifferenceNoise::default(),
            usual: [UsualStep { peak: UsualPeak::expecting(PEAK, PEAK_DEVIATION, FIRM), pending: None }; 2],
            learned: 0,
            learn_due: None,
            look_due: None,
            candidate: None,
            lie: None,
            not_shared: 0.0,
            doubt: None,
            hunches: StepHunches::default(),
            cleared: false,
            agrees_since: None,
        }
    }

    /// How far the receiver has led away by now, NE, m, in the root of the mean square: by the whole step with the probability that it is a lie, and else not at all.
    pub(in super::super) fn may_have_led(&self, now: AutopilotTime) -> Vector2<f64> {
        self.doubt.map_or(Vector2::zeros(), |d| d.lie.led(now) * d.probability().sqrt())
    }

    /// What is held against the receiver.
    pub(in super::super) fn lie(&self) -> Option<&VelocityLie> {
        self.lie.as_ref()
    }

    /// For how long something has been in doubt, s, and the step that is, NE, m/s.
    pub(in super::super) fn doubted(&self, now: AutopilotTime) -> Option<(f64, Vector2<f64>)> {
        self.doubt.map(|d| (now.seconds_since(d.lie.since), d.lie.step))
    }

    /// Whether it lies or may lie.
    pub(in super::super) fn is_doubted(&self) -> bool {
        self.lie.is_some() || self.doubt.is_some()
    }

    /// Whether it was the receiver's velocity that parted from inertia: most of what they are apart came between two fixes, and not little by little, as an IMU that
    /// goes wrong leads away. Fixes that come slowly do not tell that before the next one shows whether it goes on.
    pub(in super::super) fn parted_at_once(&self) -> bool {
        let Some(last) = self.felt.last() else { return false };
        let recent = |f: &&FixWithImpulse| last.time.seconds_since(f.time) < PARTED_S;
        let Some(first) = self.felt.iter().find(recent) else { return false };
        let parted = (last.difference - first.difference).norm();
        self.felt.windows(2).filter(|pair| recent(&&pair[0])).any(|pair| {
            let at_once = pair[1].time.seconds_since(pair[0].time) < ONCE_S || pair[1].time < last.time;
            at_once && (pair[1].difference - pair[0].difference).norm() > AT_ONCE * parted
        })
    }

    /// The filter's innovations show a lie, and what it did to the estimate is undone.
    pub(in super::super) fn charge(&mut self, since: AutopilotTime, step: Vector2<f64>) {
        self.hold(Some(VelocityLie { since, step, undone: true }));
    }

    fn hold(&mut self, lie: Option<VelocityLie>) {
        (self.lie, self.doubt) = (lie, None);
        (self.not_shared, self.agrees_since) = (0.0, None);
    }

    /// They show what may be one, with these odds, ln.
    pub(in super::super) fn suspect(&mut self, now: AutopilotTime, lie: VelocityLie, odds: f64) {
        match &mut self.doubt {
            Some(doubt) if doubt.kind == DoubtKind::Suspected => doubt.odds = doubt.odds.max(odds),
            Some(doubt) if doubt.kind != DoubtKind::Young => {}
            _ if self.lie.is_some() => {}
            doubt => {
                *doubt = Some(VelocityDoubt { odds, ..VelocityDoubt::of(lie, now, DoubtKind::Suspected) })
            }
        }
    }

    /// Another witness has seen that it is a lie, and holds it against the receiver: whoever follows it again follows it in doubt.
    pub(in super::super) fn confirm(&mut self, now: AutopilotTime) {
        self.doubt = self.doubt.map(|d| VelocityDoubt::of(d.lie, now, DoubtKind::Charged));
    }

    /// By how much, ln, flow and air find it more likely now that what is doubted is no lie; who can say nothing any more leaves it at what was said.
    pub(in super::super) fn hear_witnesses(&mut self, refuted: Option<f64>) {
        let Some(refuted) = refuted.filter(|r| r.is_finite()) else { return };
        if let Some(doubt) = self.doubt.as_mut() {
            doubt.refuted = refuted;
        }
        if self.doubt.is_some_and(|d| d.is_refuted()) {
            self.clear();
        }
    }

    /// Where nothing is in doubt, flow and air weigh what inertia alone would say nothing of: by how much, ln, is a step that began so long ago, s, of this size, NE,
    /// m/s, more likely none?
    pub(in super::super) fn weigh_hunches(
        &mut self,
        now: AutopilotTime,
        refutes: impl Fn(f64, &Vector2<f64>) -> Option<f64>,
    ) {
        let free = self.lie.is_none() && self.doubt.is_none_or(|d| d.kind == DoubtKind::Young);
        if let Some((lie, odds)) = self.hunches.weigh(now, refutes).filter(|_| free) {
            self.doubt = Some(VelocityDoubt::witnessed(lie, odds));
        }
    }

    /// Another witness has seen that it is no lie: what it explained is usual.
    pub(in super::super) fn clear(&mut self) {
        if let Some(doubt) = self.doubt.take() {
            self.hunches.forget(&doubt.lie);
            self.came_to_nothing(&doubt);
            self.cleared = true;
        }
    }

    /// Whether what was doubted was found to be no lie since this was asked.
    pub(in super::super) fn take_cleared(&mut self) -> bool {
        std::mem::take(&mut self.cleared)
    }

    /// What the filter's innovations suspected: since when, NE, m/s.
    pub(in super::super) fn suspected(&self) -> Option<AutopilotTime> {
        self.doubt.filter(|d| d.kind == DoubtKind::Suspected).map(|d| d.lie.since)
    }

    fn came_to_nothing(&mut self, doubt: &VelocityDoubt) {
        let usual = &mut self.usual[usize::from(doubt.kind == DoubtKind::Young)].peak;
        if let Some((square, _)) = doubt.look {
            usual.learn(square.min(usual.limit(DECADES)), MEMORY);
        }
    }

    /// Whether another receiver, of this difference d, NE, m/s, since an epoch, tells the same lie. One fix of it is noise: that it does not has to show in the mean
    /// of some.
    pub(in super::super) fn is_shared_by(&mut self, difference: &Vector2<f64>, epoch: u32) -> bool {
        let Some(lie) = self.lie else { return false };
        let Some(own) = self.felt.last().filter(|_| epoch == self.epoch) else { return true };
        // 0 of who tells the same, 1 of who does not.
        let apart = (own.difference - difference).dot(&lie.step) / lie.step.norm_squared();
        self.not_shared += SPARE_GAIN * (apart - self.not_shared);
        self.not_shared < 1.0 - BACK
    }

    /// Nothing is known of this receiver any more, or nothing that could judge it.
    pub(in super::super) fn forget(&mut self) {
        self.felt.clear();
        (self.lie, self.doubt, self.candidate) = (None, None, None);
        self.hunches.clear();
        self.agrees_since = None;
    }

    /// A fix that is sound in itself.
    pub(in super::super) fn observe(&mut self, s: &FeltVelocity) {
        let hole = self.felt.last().is_some_and(|f| !(0.0..HOLE_S).contains(&s.time.seconds_since(f.time)));
        if s.epoch != self.epoch || hole {
            self.felt.clear();
            self.epoch = s.epoch;
        }
        if hole {
            self.doubt = self.doubt.filter(|d| d.kind == DoubtKind::Charged);
            self.hunches.clear();
            self.let_go(s.time);
        }
        if self.felt.last().is_some_and(|f| s.time.seconds_since(f.time) < SPACING_S) {
            return;
        }
        if self.felt.len() == SAMPLES {
            self.felt.remove(0);
        }
        self.felt.push(FixWithImpulse {
            time: s.time,
            difference: s.velocity - s.impulse,
            velocity: s.velocity,
        });
        self.felt.retain(|f| s.time.seconds_since(f.time) < WINDOW_S);
        match self.lie {
            None if s.judged => self.judge(s),
            None => {
                let stays = |d: &VelocityDoubt| s.time < d.until && !has_not_led(s, &d.lie);
                self.doubt = self.doubt.filter(|d| d.kind == DoubtKind::Charged && stays(d));
            }
            Some(lie) => self.come_back(s, &lie),
        }
    }

    fn judge(&mut self, s: &FeltVelocity) {
        if self.look_due.is_some_and(|due| s.time < due) {
            return;
        }
        self.look_due = Some(s.time + Span::from_seconds(LOOK_S));
        let Some(fit) = best_steps(&self.felt, s.time) else { return };
        // On the ground only who stands still is judged, by a noise that any receiver has there.
        if !s.flies && fit.manoeuvre > STANDS_MPS2 * STANDS_MPS2 {
            return;
        }
        let noise = if s.flies { self.noise.of(fit.manoeuvre) } else { GROUND_NOISE_MPS * GROUND_NOISE_MPS };
        let degrees = (2 * self.felt.len()).saturating_sub(NUISANCES).max(1) as f64;
        let [old, young] = fit.steps.map(|step| Some(StepLook::of(&step?, noise, degrees)));
        if old.is_some_and(|look| self.is_borne_out(s.time, &look)) {
            return self.hold(old.map(|look| look.begun));
        }
        self.look_again(s.time, old.as_ref(), &fit);
        self.doubt_what_shows(s, [old, young]);
        // A step in sight is nothing usual, if it is one.
        let in_sight = |d: VelocityDoubt| s.time.seconds_since(d.lie.since) < WINDOW_S;
        if self.doubt.is_some_and(in_sight) {
            self.usual.iter_mut().for_each(|usual| usual.pending = None);
        } else if s.flies {
            self.noise.learn(fit.manoeuvre, fit.plain / degrees);
            self.learn(s.time, [old, young]);
        }
    }

    /// What is far from usual is doubted, and what is less is a hunch.
    fn doubt_what_shows(&mut self, s: &FeltVelocity, looks: [Option<StepLook>; 2]) {
        looks[0].iter().for_each(|look| self.hunches.see(look, &self.usual[0].peak));
        // A receiver that says what who stands feels is sound by now, whatever it said before.
        let at_rest = |lie: &VelocityLie| !s.flies && s.velocity.norm() < BACK * lie.step.norm();
        self.doubt.take_if(|d| d.kind != DoubtKind::Charged && at_rest(&d.lie));
        for (at, kind) in [DoubtKind::Likely, DoubtKind::Young].into_iter().enumerate() {
            let usual = &self.usual[at].peak;
            let shows = |look: &StepLook| look.exceeds(usual.limit(DOUBT_DECADES)) && !at_rest(&look.begun);
            let Some(look) = looks[at].filter(shows) else { continue };
            let young = kind == DoubtKind::Likely && self.doubt.is_some_and(|d| d.kind == DoubtKind::Young);
            if self.doubt.is_none() || young {
                self.doubt = Some(VelocityDoubt::seen(&look, look.odds(usual), s.time, kind));
            }
        }
    }

    /// What is doubted, by what is seen of it now.
    fn look_again(&mut self, now: AutopilotTime, old: Option<&StepLook>, fit: &FittedSteps) {
        let ends = |lie: &VelocityLie| fit.steps[0].is_some_and(|step| steps_back(&step, lie));
        if let (Some(doubt), Some(look)) = (&mut self.doubt, old)
            && !look.is_none
            && look.square > STILL * self.usual[0].peak.limit(DOUBT_DECADES)
            && look.begun.since.seconds_since(doubt.lie.since).abs() < STILL_SAME_S
        {
            doubt.seen_again(look, &self.usual[0].peak, now);
        }
        if self.doubt.is_some_and(|d| d.has_vanished(now)) {
            self.clear();
        }
        if let Some(doubt) = self.doubt.take_if(|d| now >= d.until || ends(&d.lie))
            && now >= doubt.until
        {
            self.came_to_nothing(&doubt);
        }
    }

    /// Whether a step is a lie: beyond doubt, and the same whenever it is looked at for a while. What a manoeuvre leaves is another at every look.
    fn is_borne_out(&mut self, now: AutopilotTime, look: &StepLook) -> bool {
        let beyond = self.learned >= LEARNED
            && look.exceeds(self.usual[0].peak.wide_limit(DECADES))
            && look.left < LEAVES * look.explained;
        let same = |c: &StepCandidate| look.begun.since.seconds_since(c.onset).abs() < SAME_S;
        self.candidate = beyond.then(|| {
            let known = self.candidate.filter(same);
            known.unwrap_or(StepCandidate { seen: now, onset: look.begun.since })
        });
        self.candidate.is_some_and(|c| now.seconds_since(c.seen) > BORNE_OUT_S)
    }

    fn learn(&mut self, now: AutopilotTime, looks: [Option<StepLook>; 2]) {
        if self.learn_due.is_none_or(|due| now >= due) {
            self.learn_due = Some(now + Span::from_seconds(LEARN_S));
            self.learned = self.learned.saturating_add(1);
            for (usual, look) in self.usual.iter_mut().zip(looks) {
                usual.learn(look.map(|look| look.square));
            }
        }
    }

    /// Whether the lie has ended.
    fn come_back(&mut self, s: &FeltVelocity, lie: &VelocityLie) {
        let fit = best_steps(&self.felt, s.time).and_then(|fit| fit.steps[0]);
        let stepped_back = fit.is_some_and(|step| steps_back(&step, lie));
        // What carries knows better than half the step.
        let known = s.sigma < KNOWN * lie.step.norm();
        let agrees = s.error.is_some_and(|e| known && e.norm() < BACK * lie.step.norm());
        let back = agrees || has_not_led(s, lie);
        self.agrees_since = if back { self.agrees_since.or(Some(s.time)) } else { None };
        let led_m = lie.led(s.time).norm();
        let harmless = s.position_sigma > led_m.max(LEAST_LED_M);
        if stepped_back || self.agrees_since.is_some_and(|t| s.time.seconds_since(t) > BACK_S) {
            self.forget();
        } else if harmless {
            self.let_go(s.time);
        }
    }

    /// The receiver is as good as any other evidence, and not disproven.
    fn let_go(&mut self, now: AutopilotTime) {
        if let Some(lie) = self.lie.take() {
            self.doubt = Some(VelocityDoubt::of(lie, now, DoubtKind::Charged));
        }
    }
}

/// Whether a fix is where whatever else carries is, and not where a lie would have led it by now.
fn has_not_led(s: &FeltVelocity, lie: &VelocityLie) -> bool {
    let led_m = lie.led(s.time).norm();
    let known = led_m > LEAST_LED_M && s.position_sigma < KNOWN * led_m;
    known && s.apart.is_some_and(|apart| apart.norm() < BACK * led_m)
}

/// Whether a step takes a lie away.
fn steps_back(step: &VelocityStep, lie: &VelocityLie) -> bool {
    (step.size + lie.step).norm() < BACK * lie.step.norm() && step.gain > step.left
}

#[cfg(test)]
mod tests {
    use super::*;

    fn at(s: f64) -> AutopilotTime {
        AutopilotTime::from_micros((s * 1e6).round() as i64)
    }

    /// Legs with turns between them, felt with a heading that is off by 3 degrees and a tilt; `lie` is what the receiver adds, `wrong` what inertia does.
    /// When the receiver is accused, s, and until when.
    fn fly(lie: impl Fn(f64) -> f64, wrong: impl Fn(f64) -> f64) -> Option<(f64, Option<f64>)> {
        follow(5.0, lie, wrong).0
    }

    /// The same at some speed, m/s, and how far it may have led 10 s after 100 s, m.
    fn follow(
        speed: f64,
        lie: impl Fn(f64) -> f64,
        wrong: impl Fn(f64) -> f64,
    ) -> (Option<(f64, Option<f64>)>, f64) {
        let mut steps = VelocitySteps::new();
        let (mut from, mut to) = (None, None);
        let mut led = 0.0;
        for k in 0..900 {
            let t = f64::from(k) * 0.2;
            let v = Vector2::new((0.3 * t).sin(), (0.2 * t).cos()) * speed;
            let noise =
                Vector2::new(f64::sin(f64::from(k * 7919 % 31)), f64::sin(f64::from(k * 104_729 % 37))) * 0.1;
            let felt = nalgebra::Rotation2::new(0.05) * v + Vector2::new(0.02 * t, wrong(t));
            steps.observe(&FeltVelocity {
                time: at(t),
                velocity: v + noise + Vector2::new(0.6, 0.8) * lie(t),
                impulse: felt,
                epoch: 1,
                judged: true,
                flies: true,
                error: None,
                sigma: f64::INFINITY,
                position_sigma: 1.0,
                apart: None,
            });
            match (steps.lie(), from) {
                (Some(_), None) => from = Some(t),
                (None, Some(_)) if to.is_none() => to = Some(t),
                _ => {}
            }
            if t <= 110.0 {
                led = steps.may_have_led(at(t)).norm();
            }
        }
        (from.map(|from| (from, to)), led)
    }

    #[test]
    fn a_hovering_vehicle_feels_that_it_does_not_move() {
        let lie = |t: f64| if (100.0..130.0).contains(&t) { 1.0 } else { 0.0 };
        let (Some((from, Some(to))), _) = follow(0.0, lie, |_| 0.0) else { panic!() };
        assert!((101.0..104.0).contains(&from) && (131.0..134.5).contains(&to), "{from} {to}");
    }

    #[test]
    fn what_may_be_a_lie_is_no_charge_and_how_far_it_may_have_led_is_known() {
        let (honest, led) = follow(5.0, |_| 0.0, |_| 0.0);
        assert_eq!((honest, led), (None, 0.0));
        let mut doubted = 0;
        for k in 6..20 {
            let size = 0.05 * f64::from(k);
            let (accused, led) = follow(5.0, |t| if t >= 100.0 { size } else { 0.0 }, |_| 0.0);
            if accused.is_none() && led > 0.0 {
                doubted += 1;
                assert!((led - 10.0 * size).abs() < 0.4 * 10.0 * size, "{size} {led}");
            }
        }
        assert!(doubted > 0);
    }

    #[test]
    fn a_step_that_no_force_has_made_is_the_receivers_and_ends_with_a_step_back() {
        assert_eq!(fly(|_| 0.0, |_| 0.0), None);
        let lies = |size: f64| move |t: f64| if (100.0..130.0).contains(&t) { size } else { 0.0 };
        for size in [1.2, 2.0] {
            let Some((from, Some(to))) = fly(lies(size), |_| 0.0) else { panic!("{size}") };
            assert!((101.0..104.0).contains(&from) && (131.0..134.5).contains(&to), "{size}: {from} {to}");
        }
    }

    #[test]
    fn a_tilt_that_goes_wrong_is_none_of_the_receivers() {
        assert_eq!(fly(|_| 0.0, |t| 0.8 * (t - 100.0).max(0.0)), None);
    }

    #[test]
    fn what_others_refute_leads_nowhere() {
        let mut steps = VelocitySteps::new();
        let lie = VelocityLie::new(at(8.0), Vector2::new(1.0, 0.0));
        steps.suspect(at(10.0), lie, 0.0);
        let even = steps.may_have_led(at(18.0)).norm();
        assert!((even - 10.0 * 0.5f64.sqrt()).abs() < 1e-9, "{even}");
        // Another look at the same.
        steps.suspect(at(10.4), lie, 2.3);
        let alone = steps.may_have_led(at(18.0)).norm();
        steps.hear_witnesses(Some(4.0));
        let doubtful = steps.may_have_led(at(18.0)).norm();
        assert!(alone > 9.0 && doubtful < 0.5 * alone, "{alone} {doubtful}");
        // Who is not heard any more leaves it so.
        steps.hear_witnesses(None);
        steps.hear_witnesses(Some(f64::NAN));
        assert_eq!(steps.may_have_led(at(18.0)).norm(), doubtful);
        assert!(!steps.take_cleared());
        steps.hear_witnesses(Some(8.0));
        assert!(!steps.is_doubted() && steps.take_cleared() && !steps.take_cleared());
    }

    /// How far a receiver on the ground may have led at 30 s, m, that walks off by the first until 20 s, and by the second since, m/s; `felt`: what inertia feels.
    fn on_the_ground(walks_mps: [f64; 2], felt: impl Fn(f64) -> f64) -> f64 {
        let mut steps = VelocitySteps::new();
        for k in 0..151 {
            let t = 0.2 * f64::from(k);
            let walk = walks_mps[usize::from(t > 20.0)];
            let wander = Vector2::new((0.9 * t).sin(), (1.3 * t).cos()) * 0.05;
            steps.observe(&FeltVelocity {
                time: at(t),
                velocity: Vector2::new(walk, 0.0) + wander,
                impulse: Vector2::new(felt(t), 0.0),
                epoch: 1,
                judged: true,
                flies: false,
                error: None,
                sigma: f64::INFINITY,
                position_sigma: 1.0,
                apart: None,
            });
        }
        steps.may_have_led(at(30.0)).norm()
    }

    #[test]
    fn who_stands_feels_that_the_receiver_walks_and_who_starts_does_not_judge() {
        assert_eq!(on_the_ground([0.0; 2], |_| 0.0), 0.0);
        let led = on_the_ground([0.0, 1.2], |_| 0.0);
        assert!((9.0..13.0).contains(&led), "{led}");
        // It was wrong before, as receivers are that have just been switched on.
        assert_eq!(on_the_ground([1.2, 0.0], |_| 0.0), 0.0);
        // Badly felt, as wheels on a meadow are.
        assert_eq!(on_the_ground([0.0; 2], |t| 3.0 * (t - 15.0).max(0.0).sin()), 0.0);
    }

    /// A lie of 2 m/s since 0 s, at 30 s and `after_s` later, of a receiver that lies `apart_m` from an estimate that does not follow it.
    fn let_go(after_s: f64, position_sigma: f64, apart_m: Option<f64>) -> VelocitySteps {
        let mut steps = VelocitySteps::new();
        steps.lie = Some(VelocityLie::new(at(0.0), Vector2::new(2.0, 0.0)));
        let apart = apart_m.map(|m| Vector2::new(m, 0.0));
        for t in [0.0, 1.0, 2.0, 3.1, after_s] {
            let (time, velocity, impulse) = (at(30.0 + t), Vector2::new(2.0, 0.0), Vector2::zeros());
            let (epoch, judged, flies, error, sigma) = (0, false, true, None, f64::INFINITY);
            #[rustfmt::skip]
            steps.observe(&FeltVelocity {
                time, velocity, impulse, epoch, judged, flies, error, sigma, position_sigma, apart,
            });
        }
        steps
    }

    #[test]
    fn a_lie_that_nobody_has_disproven_goes_on_as_a_doubt() {
        let known = let_go(4.0, 5.0, None);
        assert!(known.lie().is_some() && known.may_have_led(at(34.0)) == Vector2::zeros());
        // The estimate knows no better, or the receiver was silent, and comes back where the lie would have led it.
        for (after_s, position_sigma, apart) in
            [(4.0, 100.0, Some(1.0)), (8.0, 5.0, None), (8.0, 5.0, Some(70.0))]
        {
            let steps = let_go(after_s, position_sigma, apart);
            assert!(steps.lie().is_none());
            let led = steps.may_have_led(at(40.0)).norm();
            assert!((led - 80.0).abs() < 1e-9, "{after_s}: {led}");
        }
        assert_eq!(let_go(70.0, 5.0, None).lie(), None);
        // One that is where whatever else carries says has not led there, whether it was silent or not.
        for after_s in [4.0, 8.0] {
            let steps = let_go(after_s, 5.0, Some(3.0));
            assert!(!steps.is_doubted() && steps.may_have_led(at(40.0)) == Vector2::zeros(), "{after_s}");
        }
    }

    #[test]
    fn who_tells_the_same_shares_the_lie() {
        let mut steps = VelocitySteps::new();
        steps.felt.push(FixWithImpulse {
            time: at(0.0),
            difference: Vector2::new(2.0, 0.0),
            velocity: Vector2::new(7.0, 0.0),
        });
        assert!(!steps.is_shared_by(&Vector2::new(2.1, 0.0), 0));
        let lie = VelocityLie::new(at(0.0), Vector2::new(2.0, 0.0));
        steps.hold(Some(lie));
        // One fix that is far off does not tell, the mean of several does.
        assert!(steps.is_shared_by(&Vector2::new(0.9, 0.0), 0));
        assert!((0..20).all(|_| steps.is_shared_by(&Vector2::new(2.1, 0.5), 0)));
        let others = (0..10).take_while(|_| steps.is_shared_by(&Vector2::new(-0.1, -0.5), 0)).count();
        assert!((1..5).contains(&others), "{others}");
        assert!(steps.is_shared_by(&Vector2::new(-9.0, 0.0), 1), "not comparable");
    }

    /// Fixes every `every_s`, of a vehicle at rest, that part from inertia by `parted` from 5 s on.
    fn parts_at_once(every_s: f64, parted: impl Fn(f64) -> f64, until_s: f64) -> bool {
        let mut steps = VelocitySteps::new();
        let mut t = 0.0;
        while t < until_s + 1e-9 {
            let difference = Vector2::new(parted(t - 5.0), 0.02 * (37.0 * t).sin());
            steps.felt.push(FixWithImpulse { time: at(t), difference, velocity: difference });
            t += every_s;
        }
        steps.parted_at_once()
    }

    #[test]
    fn a_receiver_steps_from_one_fix_to_the_next_and_an_imu_leads_away() {
        let steps = |t: f64| if t > -1e-9 { 3.0 } else { 0.0 };
        let leads = |t: f64| 2.0 * t.max(0.0).powi(2);
        assert!(parts_at_once(0.2, steps, 5.0) && parts_at_once(0.2, steps, 6.0));
        assert!(!parts_at_once(0.2, leads, 6.0) && !parts_at_once(0.2, leads, 7.0));
        assert!(!parts_at_once(1.0, steps, 5.0), "once a second the first does not tell yet");
        assert!(parts_at_once(1.0, steps, 6.0));
        assert!(!parts_at_once(1.0, leads, 6.0) && !parts_at_once(1.0, leads, 8.0));
    }
}
