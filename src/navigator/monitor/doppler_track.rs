//! A receiver's positions against its own velocities.
//!
//! Position comes from the code, velocity from the Doppler shift of the carrier: two measurements, and who forges one rarely forges the other.
//! D(t) = p(t) − ∫v dt wanders by what a receiver's position wanders and its velocity is biased by, which differs by a factor of ten
//! between receivers, so it is learned ([`UsualSpread`]) over four lengths of time. What exceeds that is a jump or a walk.

use nalgebra::Vector2;

use crate::time::{AutopilotTime, Span};

use super::usual::UsualSpread;
use crate::navigator::tuning::doppler_track::{
    CHANGES_MPS, DECADES, DELAY_DECADES, DELAY_S, DISTINCT, DRIFT_MPS, FIRM, GOES_ON_DECADES, GOES_ON_S,
    JITTER_S, LEAST_STEP_M, LEAST_WALK_M, LEAST_WALK_MPS, LIKELY_DECADES, MARK_S, MARKS, MATCHES, MEMORY,
    SETTLE_S, SLACK_S, STEP_MEMORY, STEP_SIGMA_M, TURNING_M, WANDER_M, WINDOWS_S,
};

/// How the positions moved, by the velocities.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(in super::super) enum TrackMotion {
    Consistent,
    /// One fix jumped.
    Stepped,
    /// Over a window they ran away.
    RanAway,
}

#[derive(Clone, Copy, Debug)]
struct TrackMark {
    time: AutopilotTime,
    position_ne: Vector2<f64>,
    /// ∫v dt, m.
    travelled_ne: Vector2<f64>,
    velocity_ne: Vector2<f64>,
    /// Nothing was held against the receiver.
    sound: bool,
    /// It had jumped.
    astray: bool,
}

/// How far positions are from where the velocities lead.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(in super::super) struct TrackWander {
    /// By which the newest fix has moved beyond its velocities, NE, m.
    pub(in super::super) gap_ne: Vector2<f64>,
    /// What of that is more than the latency that is usual would make of the change of velocity, m.
    pub(in super::super) beyond_m: f64,
    /// How far apart they usually are over that time and through that change of velocity, m.
    pub(in super::super) spread_m: f64,
}

impl TrackWander {
    pub(in super::super) const NONE: Self =
        Self { gap_ne: Vector2::new(0.0, 0.0), beyond_m: 0.0, spread_m: 0.0 };
}

/// One length of time.
#[derive(Clone, Copy, Debug)]
struct TrackWindow {
    usual: UsualSpread,
    /// The same through changes of the velocity, whatever the latency is.
    turning: UsualSpread,
    due: Option<AutopilotTime>,
    /// Waits until the next is seen, too: a walk is not to be learned while it begins.
    pending: Option<UsualPair>,
}

/// What a window showed that was usual: the square of the deviation, m², and, where the velocity changed, that of all of the gap, m², and of the delay
/// that would explain it, s².
#[derive(Clone, Copy, Debug)]
struct UsualPair {
    deviation: f64,
    turning: Option<[f64; 2]>,
}

/// See the module's documentation.
#[derive(Clone, Debug)]
pub(in super::super) struct DopplerTrack {
    /// One a second, a ring.
    marks: Vec<TrackMark>,
    oldest: usize,
    newest: Option<TrackMark>,
    windows: [TrackWindow; WINDOWS_S.len()],
    step: UsualSpread,
    /// What the latency of positions and velocities is apart, and varies by, s: as much as this receiver's changes of velocity have shown.
    delay: UsualSpread,
    /// What is older is not compared: there was a step.
    since: Option<AutopilotTime>,
    run_away: TrackWander,
    /// Over the window that shows most of it.
    wander: TrackWander,
    /// Sum of the steps since it was accepted, NE, m, and whether it has run away since.
    steps_ne: Vector2<f64>,
    ran: bool,
    /// It was sound on the way that is remembered.
    was_sound: bool,
}

impl DopplerTrack {
    pub(in super::super) fn new() -> Self {
        let window = |length_s: f64| TrackWindow {
            usual: UsualSpread::expecting((WANDER_M + DRIFT_MPS * length_s).powi(2), FIRM),
            turning: UsualSpread::expecting(TURNING_M * TURNING_M, FIRM),
            due: None,
            pending: None,
        };
        Self {
            marks: Vec::with_capacity(MARKS),
            oldest: 0,
            newest: None,
            windows: WINDOWS_S.map(window),
            step: UsualSpread::expecting(STEP_SIGMA_M * STEP_SIGMA_M, FIRM),
            delay: UsualSpread::expecting(DELAY_S * DELAY_S, FIRM),
            since: None,
            run_away: TrackWander::NONE,
            wander: TrackWander::NONE,
            steps_ne: Vector2::zeros(),
            ran: false,
            was_sound: false,
        }
    }

    /// Forgets the way: what comes is not comparable with it. What is usual for the receiver stays known.
    pub(in super::super) fn forget(&mut self) {
        self.marks.clear();
        (self.oldest, self.newest, self.since) = (0, None, None);
        (self.run_away, self.wander) = (TrackWander::NONE, TrackWander::NONE);
        (self.steps_ne, self.ran, self.was_sound) = (Vector2::zeros(), false, false);
        self.nothing_pends();
    }

    /// How far the positions have run away from the velocities.
    pub(in super::super) fn run_away(&self) -> TrackWander {
        self.run_away
    }

    /// How far the positions are from where the velocities lead, beyond doubt or not.
    pub(in super::super) fn wander(&self) -> TrackWander {
        self.wander
    }

    /// Mean square of the step from fix to fix beyond the velocity's, an axis, m².
    pub(in super::super) fn step_variance(&self) -> f64 {
        self.step.variance()
    }

    /// Adds a fix; a silence of more than `hole_s` ends the comparison. `sound`: nothing is held against the receiver at present.
    pub(in super::super) fn follow(
        &mut self,
        time: AutopilotTime,
        position_ne: Vector2<f64>,
        velocity_ne: Vector2<f64>,
        hole_s: f64,
        sound: bool,
    ) -> TrackMotion {
        let mut travelled_ne = Vector2::zeros();
        let mut stepped = false;
        if let Some(last) = self.newest {
            let dt = time.seconds_since(last.time);
            if (0.0..=hole_s).contains(&dt) {
                let moved = (last.velocity_ne + velocity_ne) * (0.5 * dt);
                travelled_ne = last.travelled_ne + moved;
                let gap_ne = position_ne - last.position_ne - moved;
                let step = (gap_ne.norm() - SLACK_S * (velocity_ne - last.velocity_ne).norm()).max(0.0);
                stepped = step > self.step.limit(DECADES).sqrt().max(LEAST_STEP_M);
                if stepped {
                    self.steps_ne += gap_ne;
                } else {
                    self.step.learn(step * step, STEP_MEMORY);
                }
            } else {
                self.forget();
            }
        }
        let astray = self.stepped();
        let sound = sound && !astray && !self.ran;
        let here = TrackMark { time, position_ne, travelled_ne, velocity_ne, sound, astray };
        self.was_sound |= sound;
        self.newest = Some(here);
        if stepped {
            // Positions before and after a step are not comparable, but for those before one that is undone.
            self.since = astray.then_some(time);
            self.run_away = TrackWander::NONE;
            self.nothing_pends();
        }
        let ran_away = self.compare(&here);
        self.ran |= ran_away;
        self.keep(&here);
        if stepped {
            TrackMotion::Stepped
        } else if ran_away {
            TrackMotion::RanAway
        } else {
            TrackMotion::Consistent
        }
    }

    /// How far it was displaced, by jumps or by running away, since it was accepted, m, and how much of that may be the usual wander, m: what
    /// jumped has not wandered.
    pub(in super::super) fn displaced(&self) -> Option<(f64, f64)> {
        if !self.was_sound {
            // Who was never sound on this way has not left it.
            return None;
        }
        if self.ran {
            let (apart, age) = self.apart()?;
            return Some((apart, self.limit_m(age)));
        }
        self.stepped().then(|| (self.steps_ne.norm(), 0.0))
    }

    fn stepped(&self) -> bool {
        self.steps_ne.norm() >= LEAST_STEP_M
    }

    /// From the last mark that was sound, m, and how old that is, s.
    fn apart(&self) -> Option<(f64, f64)> {
        let here = self.newest?;
        let mark = self.ordered().rev().find(|m| m.sound)?;
        Some((deviation(&here, mark), here.time.seconds_since(mark.time)))
    }

    /// The receiver is believed where it stands.
    pub(in super::super) fn accept(&mut self) {
        (self.steps_ne, self.ran) = (Vector2::zeros(), false);
    }

    /// Whether the newest fix lies where the velocities lead from where it was while it was sound: whatever lay between was a lie, and it is
    /// over.
    pub(in super::super) fn resumes(&self) -> bool {
        let Some((here, (apart, _))) = self.newest.zip(self.apart()) else { return false };
        let mut matches = 0;
        for mark in self.ordered().filter(|m| m.sound) {
            let age = here.time.seconds_since(mark.time);
            if age < SETTLE_S {
                break;
            }
            // To where it was when it was last sound it does not lead: a wide limit alone is no evidence.
            let limit = self.limit_m(age).min(apart / DISTINCT);
            matches = if deviation(&here, mark) < limit { matches + 1 } else { 0 };
            if matches >= MATCHES {
                return true;
            }
        }
        false
    }

    /// What the deviation over `age` s may be, m: beyond the longest window it grows with time.
    fn limit_m(&self, age: f64) -> f64 {
        let longest = WINDOWS_S.len() - 1;
        let k = WINDOWS_S.iter().position(|w| *w >= age).unwrap_or(longest);
        let beyond = (age / WINDOWS_S[longest]).max(1.0);
        3.0 * (2.0 * self.windows[k].usual.variance()).sqrt() * beyond
    }

    /// Oldest first.
    fn ordered(&self) -> impl DoubleEndedIterator<Item = &TrackMark> {
        let (tail, head) = self.marks.split_at(self.oldest.min(self.marks.len()));
        head.iter().chain(tail)
    }

    fn keep(&mut self, here: &TrackMark) {
        let newest = self.ordered().next_back();
        if newest.is_some_and(|m| here.time.seconds_since(m.time) < MARK_S) {
            return;
        }
        if self.marks.len() < MARKS {
            self.marks.push(*here);
        } else {
            self.marks[self.oldest] = *here;
            self.oldest = (self.oldest + 1) % MARKS;
        }
    }

    fn nothing_pends(&mut self) {
        for window in &mut self.windows {
            (window.pending, window.due) = (None, None);
        }
    }

    /// Compares `here` with the marks a window's length ago; whether it has run away.
    fn compare(&mut self, here: &TrackMark) -> bool {
        let mut from = [None; WINDOWS_S.len()];
        // The largest change of the velocity since, m/s.
        let mut change: f64 = 0.0;
        let mut last_s = 0.0;
        let comparable = |m: &&TrackMark| self.since.is_some_and(|s| m.time >= s) || !m.astray;
        let since = self.since;
        for mark in self.ordered().rev().take_while(|m| since.is_none_or(|s| m.time >= s)).filter(comparable)
        {
            let age = here.time.seconds_since(mark.time);
            change = change.max((mark.velocity_ne - here.velocity_ne).norm());
            for (k, length) in WINDOWS_S.iter().enumerate() {
                // The youngest that is old enough.
                if (last_s..age).contains(length) {
                    from[k] = Some((*mark, change));
                }
            }
            last_s = age;
        }
        let mut ran_away = None;
        self.wander = TrackWander::NONE;
        for (k, from) in from.into_iter().enumerate() {
            let Some((from, change)) = from else { continue };
            if self.runs(k, here, &from, change) {
                ran_away = Some(ran_away.unwrap_or(here.time).min(from.time));
            }
        }
        if let Some(since) = ran_away {
            // A walk that is found over one window began before it, where a longer one shows more.
            self.run_away = self.wander;
            self.nothing_pends();
            // It was on its way already.
            self.marks.iter_mut().filter(|m| m.time > since).for_each(|m| m.sound = false);
        }
        ran_away.is_some()
    }

    /// Whether it has run away from a mark of window `k`, since when the velocity has changed by `change`, m/s, at most; if not, that was usual.
    fn runs(&mut self, k: usize, here: &TrackMark, from: &TrackMark, change: f64) -> bool {
        let gap_ne = gap(here, from);
        let slack_m = SLACK_S * (here.velocity_ne - from.velocity_ne).norm() + JITTER_S * change;
        let window = &mut self.windows[k];
        let beyond = |decades: f64| {
            let late_m = self.delay.limit(decades).sqrt() * change;
            let slack_m = slack_m.min(late_m).min(window.turning.limit(decades).sqrt());
            (gap_ne.norm() - slack_m).max(0.0)
        };
        let (d, likely) = (beyond(DELAY_DECADES), beyond(LIKELY_DECADES));
        if likely > self.wander.beyond_m {
            let late = (self.delay.variance() * change * change).min(window.turning.variance());
            let variance = window.usual.variance().max(self.step.variance()) + late;
            self.wander = TrackWander { gap_ne, beyond_m: likely, spread_m: (2.0 * variance).sqrt() };
        }
        let walk_mps = LEAST_WALK_MPS * WINDOWS_S[k];
        // What is allowed for changes of velocity hides noise from what is learned; from fix to fix they make little.
        let usual_m = |decades: f64| window.usual.limit(decades).max(self.step.limit(decades)).sqrt();
        let limit = usual_m(DECADES).max(LEAST_WALK_M + walk_mps);
        // Who has run away goes on with it as long as it looks like that, and not only beyond doubt.
        let goes_on = self.ran && WINDOWS_S[k] <= GOES_ON_S;
        let on = goes_on && likely > limit.min(usual_m(GOES_ON_DECADES).max(walk_mps));
        if on || d > limit {
            return true;
        }
        if here.sound && window.due.is_none_or(|due| here.time >= due) {
            let squared = gap_ne.norm_squared();
            let turning = (change > CHANGES_MPS).then(|| [squared, squared / (change * change)]);
            if let Some(usual) = window.pending.replace(UsualPair { deviation: d * d, turning }) {
                window.usual.learn(usual.deviation, MEMORY);
                if let Some([squared, delay]) = usual.turning {
                    window.turning.learn(squared, MEMORY);
                    self.delay.learn(delay, MEMORY);
                }
            }
            // Windows that overlap by half tell nearly twice as much.
            window.due = Some(here.time + Span::from_seconds(0.5 * WINDOWS_S[k]));
        }
        false
    }
}

/// What the positions moved by more than the velocities say, NE, m.
fn gap(to: &TrackMark, from: &TrackMark) -> Vector2<f64> {
    (to.position_ne - from.position_ne) - (to.travelled_ne - from.travelled_ne)
}

/// The same as a distance, m. Receivers filter position and velocity differently: a part of a second of the change of velocity is no lie.
fn deviation(to: &TrackMark, from: &TrackMark) -> f64 {
    (gap(to, from).norm() - SLACK_S * (to.velocity_ne - from.velocity_ne).norm()).max(0.0)
}

#[cfg(test)]
mod tests {
    use super::*;

    const V: Vector2<f64> = Vector2::new(3.0, -1.0);

    /// A receiver at 5 Hz whose position wanders by some decimetres, with `lie` on the position of a time.
    fn fly(
        from_s: f64,
        to_s: f64,
        track: &mut DopplerTrack,
        lie: impl Fn(f64) -> Vector2<f64>,
    ) -> Option<f64> {
        let mut k = (from_s * 5.0) as i64;
        while (k as f64) < to_s * 5.0 {
            let t = 0.2 * k as f64;
            // Incommensurable sines instead of a random generator.
            let wander = Vector2::new((0.11 * t).sin() + 0.2 * (3.1 * t).sin(), (0.07 * t).cos()) * 0.4;
            let time = AutopilotTime::from_micros(200_000 * k);
            if track.follow(time, V * t + wander + lie(t), V, 1.0, true) != TrackMotion::Consistent {
                return Some(t);
            }
            k += 1;
        }
        None
    }

    fn honest(_: f64) -> Vector2<f64> {
        Vector2::zeros()
    }

    #[test]
    fn a_walk_of_half_a_metre_a_second_is_found_before_it_is_eight_metres_long_and_its_size_is_known() {
        let mut track = DopplerTrack::new();
        assert_eq!(fly(0.0, 300.0, &mut track, honest), None, "no false alarm");
        let walk = |t: f64| Vector2::new(0.3, 0.4) * (t - 300.0);
        let found = fly(300.0, 400.0, &mut track, walk).unwrap();
        assert!(walk(found).norm() < 8.0, "{found}");
        assert!(
            (track.run_away().gap_ne - walk(found)).norm() < 2.5,
            "{:?} {}",
            track.run_away(),
            walk(found)
        );
    }

    #[test]
    fn what_it_wanders_is_known_before_it_is_a_walk_and_one_that_goes_on_stays_one() {
        let mut track = DopplerTrack::new();
        fly(0.0, 300.0, &mut track, honest);
        assert!(track.wander().beyond_m < 2.5, "{:?}", track.wander());
        let walk = |t: f64| Vector2::new(0.3, 0.4) * (t - 300.0).clamp(0.0, 40.0);
        assert_eq!(fly(300.0, 308.0, &mut track, walk), None, "it is not beyond doubt yet");
        assert!((track.wander().gap_ne - walk(308.0)).norm() < 2.0, "{:?} {}", track.wander(), walk(308.0));
        let found = fly(308.0, 340.0, &mut track, walk).unwrap();
        let next = |t: f64, track: &mut DopplerTrack| fly(t, t + 0.1, track, walk);
        let on = (0..100).filter(|k| next(found + 0.2 * f64::from(k + 1), &mut track).is_some()).count();
        assert_eq!(on, 100);
        let since = found + 20.2;
        fly(since, 352.0, &mut track, walk);
        assert_eq!(fly(352.0, 360.0, &mut track, walk), None, "it stands still again");
    }

    #[test]
    fn a_jump_is_found_at_once_and_its_end_is_known_from_its_standing() {
        let mut track = DopplerTrack::new();
        assert_eq!(fly(0.0, 60.0, &mut track, honest), None);
        let jump = |_| Vector2::new(0.0, 5.0);
        assert_eq!(fly(60.0, 61.0, &mut track, jump), Some(60.0));
        assert_eq!(fly(60.2, 100.0, &mut track, jump), None, "it stands");
        let (displaced_m, wander_m) = track.displaced().unwrap();
        assert!((displaced_m - 5.0).abs() < 0.3 && wander_m == 0.0, "{displaced_m}");
        assert!(!track.resumes());
        assert_eq!(fly(100.0, 101.0, &mut track, honest), Some(100.0));
        fly(100.2, 102.0, &mut track, honest);
        assert_eq!(track.displaced(), None);
    }

    #[test]
    fn the_end_of_a_lie_that_was_believed_is_told_from_a_jump_away() {
        let lie =
            |t: f64| if (100.0..160.0).contains(&t) { Vector2::new(30.0, 0.0) } else { Vector2::zeros() };
        let mut track = DopplerTrack::new();
        for (from_s, to_s) in [(0.0, 100.0), (100.2, 101.0)] {
            fly(from_s, to_s, &mut track, lie);
        }
        // Whatever the reason, it was believed there.
        track.accept();
        fly(101.0, 160.0, &mut track, lie);
        fly(160.0, 160.1, &mut track, lie);
        assert!(track.displaced().is_some() && track.resumes(), "it is back where it was before");
        fly(160.2, 165.0, &mut track, |_| Vector2::new(0.0, 60.0));
        assert!(!track.resumes(), "nor is it anywhere else");
    }

    /// A vehicle that circles at 20 m/s, once in 30 s, with a receiver whose position is `late_s` later than its velocity; a walk of 0.5 m/s since 300 s if it
    /// `walks`. The first time, s, that anything was found, and how far it was thought to have wandered just before the walk.
    fn circle(late_s: f64, walks: bool) -> (Option<f64>, f64) {
        let (mut track, mut before) = (DopplerTrack::new(), 0.0);
        let rate = std::f64::consts::TAU / 30.0;
        for k in 0..2000 {
            let t = 0.2 * f64::from(k);
            let at = |t: f64| Vector2::new((rate * t).sin(), -(rate * t).cos()) * (20.0 / rate);
            let v = Vector2::new((rate * t).cos(), (rate * t).sin()) * 20.0;
            let wander = Vector2::new((0.11 * t).sin() + 0.2 * (3.1 * t).sin(), (0.07 * t).cos()) * 0.4;
            let walk = Vector2::new(0.3, 0.4) * if walks { (t - 300.0).max(0.0) } else { 0.0 };
            let time = AutopilotTime::from_micros(200_000 * i64::from(k));
            if track.follow(time, at(t - late_s) + wander + walk, v, 1.0, true) != TrackMotion::Consistent {
                return (Some(t), before);
            }
            if t < 300.0 {
                before = track.wander().beyond_m;
            }
        }
        (None, before)
    }

    #[test]
    fn whose_latency_has_shown_to_be_small_cannot_hide_a_walk_in_turns() {
        assert_eq!(circle(0.0, false).0, None);
        assert_eq!(circle(0.3, false).0, None, "one that is late is no walk");
        let (found, before) = circle(0.0, true);
        assert!(found.is_some_and(|t| (300.0..340.0).contains(&t)) && before < 1.5, "{found:?} {before}");
    }

    #[test]
    fn a_wing_whose_receiver_is_noisy_does_not_walk_off() {
        use rand::SeedableRng;
        use rand_distr::{Distribution, StandardNormal};
        for seed in 0..10 {
            let mut rng = rand_chacha::ChaCha8Rng::seed_from_u64(seed);
            let (mut track, mut position, mut heading) = (DopplerTrack::new(), Vector2::zeros(), 0.0f64);
            for k in 0..3000 {
                // Legs of 25 s at 20 m/s, and turns of 20 s between them.
                let t = 0.2 * f64::from(k);
                heading += if t % 45.0 > 25.0 { 0.06 } else { 0.0 };
                let v = Vector2::new(heading.cos(), heading.sin()) * 20.0;
                position += v * 0.2;
                let noise = Vector2::from_fn(|_, _| StandardNormal.sample(&mut rng)) * 2.0;
                let time = AutopilotTime::from_micros(200_000 * i64::from(k));
                let motion = track.follow(time, position + noise, v, 1.0, true);
                assert_ne!(motion, TrackMotion::RanAway, "{seed}: {t} s");
            }
        }
    }
}
