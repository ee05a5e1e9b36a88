//! Whether an axis of the IMU has another bias or scale than it had: the filter's innovations of the last seconds, fitted with a jump of each
//! ([`crate::filter::error_state::JumpWindow`]); and whether the flow may have.
//!
//! With white innovations what a jump explains is χ²; with what flights really are (gusts, iron, latency) it is more, by how much is learned while GNSS is good,
//! from the filter and from a dead reckoning beside it ([`UsualSpread`]). An axis has jumped where that is far beyond what is usual for one; it is the one that explains most, for all of them have to explain the same innovations, if that is clearly more than a change of magnetometer, flow or wind would.
//!
//! A gyro's scale, alignment and sampling make errors in proportion to how fast a vehicle turns: where it turns faster than it used to while that was learned, more is usual.
//!
//! What is not beyond doubt yet is a suspicion, of IMU and flow: with the jump's odds as its weight it is a part of what is published as sigma. The flow is charged by
//! others ([`crate::navigator::flow_judge`]); where those charge inertia, the innovations say which axis it may have been.

use std::ops::Range;

use crate::filter::error_state::{FLOW_JUMPS, IMU_JUMPS, JUMPS, JumpOdds, JumpWindow};
use crate::time::{AutopilotTime, Span};

use super::usual::UsualSpread;
use crate::navigator::tuning::inertia_jumps::{
    CALM, CLEAR_OF, DECADES, FIRM, LASTS_AIDED_S, LASTS_S, LEARN_S, LEARNED, LOOK_S, MEMORY, QUIET_S,
    REPEATED, REPEATED_S, SPREAD, UNLIKELY, YOUNGEST_S,
};

/// How many kinds of jumps there are of which the same is usual, and of which kind each is that is judged: gyro and accelerometer, level and vertical axes (a gyro's
/// scale shows where its bias does), flow's bias and scale.
const GROUPS: usize = 6;
const LIKE: [(usize, usize); 12] =
    [(0, 0), (1, 0), (2, 1), (3, 2), (4, 2), (5, 3), (6, 0), (7, 0), (8, 1), (11, 4), (12, 4), (13, 5)];
/// The gyros' scales among the jumps, in the order of their biases, which come first; and the level accelerometers.
const SCALES: Range<usize> = 6..9;
const LEVEL_ACCELEROMETERS: Range<usize> = 3..5;

/// A jump of a window.
#[derive(Clone, Copy, Debug)]
struct Likeliest {
    window: usize,
    jump: usize,
    group: usize,
    /// What it explains of the innovations, and the most that a rival does.
    square: f64,
    rival: f64,
}

/// What the windows show.
#[derive(Clone, Copy, Debug)]
struct ShownJumps {
    /// What is furthest beyond what is usual, as a part of its limit, and the group of that: that something has jumped.
    over: f64,
    square: f64,
    group: usize,
    /// What explains most: which axis has. What all of them have to explain are the same innovations, whatever is usual for each.
    likeliest: Likeliest,
}

impl ShownJumps {
    /// By Bayes: as likely as the ratio says, times how rarely it happens.
    fn odds(&self, usual: &[UsualSpread; GROUPS]) -> f64 {
        1.0 / (1.0 + (UNLIKELY - 0.5 * self.square / usual[self.group].variance().max(1.0)).exp())
    }
}

/// A window's jump that may have happened, with this probability.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(in super::super) struct SuspectedJump {
    pub(in super::super) window: usize,
    pub(in super::super) jump: usize,
    pub(in super::super) odds: f64,
}

/// The likeliest of IMU and flow.
pub(in super::super) type SuspectedJumps = [Option<SuspectedJump>; 2];

/// What the innovations say.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(in super::super) enum JumpFinding {
    /// Nothing for sure.
    Suspected(SuspectedJumps),
    /// An axis of the IMU has jumped.
    Found { window: usize, jump: usize },
    /// It has again and again, or is larger than any: no jump is what is wrong.
    Hopeless,
}

/// See the module's documentation.
#[derive(Clone, Copy, Debug)]
pub(in super::super) struct InertiaJumps {
    usual: [UsualSpread; GROUPS],
    /// The same without GNSS.
    usual_alone: [UsualSpread; GROUPS],
    /// Mean square of the angular rate while that was learned, (rad/s)².
    rate: f64,
    /// How often what is usual was seen, and when it is again.
    learned: u32,
    learn_due: Option<AutopilotTime>,
    looked: Option<AutopilotTime>,
    /// Since when a jump has been beyond doubt.
    beyond: Option<AutopilotTime>,
    /// Jumps in a row, and when the last was found.
    found: u32,
    last: Option<AutopilotTime>,
    /// Since when nothing has been suspected.
    quiet: Option<AutopilotTime>,
    /// An axis is more likely than not to have jumped, and explains more than another sensor does.
    suspects: bool,
}

impl Default for InertiaJumps {
    fn default() -> Self {
        let usual = [UsualSpread::expecting(SPREAD, FIRM); GROUPS];
        Self {
            usual,
            usual_alone: usual,
            rate: 0.0,
            learned: 0,
            learn_due: None,
            looked: None,
            beyond: None,
            found: 0,
            last: None,
            quiet: None,
            suspects: false,
        }
    }
}

impl InertiaJumps {
    /// Whether it is too early to look again.
    pub(in super::super) fn waits(&mut self, now: AutopilotTime) -> bool {
        let waits = self.looked.is_some_and(|t| (0.0..LOOK_S).contains(&now.seconds_since(t)));
        if !waits {
            self.looked = Some(now);
        }
        waits
    }

    /// Looks at the windows; `aided`: GNSS is good; `flies`: the vehicle does, and what is usual can be learned; `blames`: an axis can be charged now.
    pub(in super::super) fn judge(
        &mut self,
        now: AutopilotTime,
        windows: &[JumpWindow],
        (aided, flies): (bool, bool),
        blames: bool,
    ) -> JumpFinding {
        self.suspects = false;
        let usual = self.usual(aided);
        let Some(shown) =
            self.shown(windows, usual, IMU_JUMPS).0.filter(|_| flies && self.learned >= LEARNED)
        else {
            return JumpFinding::Suspected([None; 2]);
        };
        let Likeliest { window, jump, group, square, rival } = shown.likeliest;
        let odds = shown.odds(usual);
        let clear = square - rival > CLEAR_OF * usual[group].variance().max(1.0);
        let beyond = shown.over > 1.0 && clear && blames;
        self.quiet = if odds > 0.5 { None } else { self.quiet.or(Some(now)) };
        self.suspects = odds > 0.5 && square > rival;
        self.beyond = if beyond { self.beyond.or(Some(now)) } else { None };
        // With GNSS there is time.
        let lasts_s = if aided { LASTS_AIDED_S } else { LASTS_S };
        if self.beyond.is_some_and(|t| now.seconds_since(t) >= lasts_s) {
            return self.find(now, window, jump, windows[window].is_implausible(jump));
        }
        JumpFinding::Suspected(self.suspected(windows, aided))
    }

    fn usual(&self, aided: bool) -> &[UsualSpread; GROUPS] {
        if aided { &self.usual } else { &self.usual_alone }
    }

    /// The jumps of IMU and flow that may have happened, by what windows show; none before it is known what is usual.
    pub(in super::super) fn suspected(&self, windows: &[JumpWindow], aided: bool) -> SuspectedJumps {
        let usual = self.usual(aided);
        [IMU_JUMPS, FLOW_JUMPS].map(|party| {
            let shown = self.shown(windows, usual, party).0.filter(|_| self.learned >= LEARNED)?;
            let Likeliest { window, jump, .. } = shown.likeliest;
            Some(SuspectedJump { window, jump, odds: shown.odds(usual) })
        })
    }

    /// Another witness has told that inertia is wrong: with which odds it was each of the axes, by the likelihoods alone, where the windows show any.
    pub(in super::super) fn told(&self, windows: &[JumpWindow]) -> Option<JumpOdds> {
        let usual = &self.usual_alone;
        let shown = self.shown(windows, usual, IMU_JUMPS).0.filter(|_| self.learned >= LEARNED)?;
        // All of them explain the same innovations: one unit for all.
        let unit = usual[shown.likeliest.group].variance().max(1.0);
        let log = |square: f64| 0.5 * square / unit;
        let most = log(shown.likeliest.square);
        if most < UNLIKELY {
            return None;
        }
        let mut odds = JumpOdds::default();
        for (odds, window) in odds.iter_mut().zip(windows).filter(|(_, w)| w.age_s() > YOUNGEST_S) {
            for jump in IMU_JUMPS {
                odds[jump] = (log(self.square(window, jump)) - most).exp();
            }
        }
        let sum: f64 = odds.iter().flatten().sum();
        odds.iter_mut().flatten().for_each(|odds| *odds /= sum);
        Some(odds)
    }

    /// What a jump explains, in what is usual at the rate that the vehicle turned.
    fn square(&self, window: &JumpWindow, jump: usize) -> f64 {
        window.fit(jump).map_or(0.0, |fit| fit.square / self.livelier(window))
    }

    fn livelier(&self, window: &JumpWindow) -> f64 {
        (window.mean_square_rate() / self.rate.max(CALM * CALM)).max(1.0)
    }

    /// What all windows and jumps of one party show, and the most that each group does.
    fn shown(
        &self,
        windows: &[JumpWindow],
        usual: &[UsualSpread; GROUPS],
        party: Range<usize>,
    ) -> (Option<ShownJumps>, [f64; GROUPS]) {
        let mut best: Option<ShownJumps> = None;
        let mut most = [0.0f64; GROUPS];
        // A flow may have changed at another time.
        let flows = FLOW_JUMPS.filter(|jump| !party.contains(jump));
        let flow =
            flows.flat_map(|jump| windows.iter().map(move |w| self.square(w, jump))).fold(0.0, f64::max);
        for (number, window) in windows.iter().enumerate().filter(|(_, w)| w.age_s() > YOUNGEST_S) {
            let others = (0..JUMPS).filter(|jump| !party.contains(jump));
            let receiver = window.explained_by_receiver() / self.livelier(window);
            let rival = others.map(|jump| self.square(window, jump)).fold(receiver.max(flow), f64::max);
            for (jump, group) in LIKE.into_iter().filter(|(jump, _)| party.contains(jump)) {
                let usual = &usual[group];
                let mut square = self.square(window, jump);
                if SCALES.contains(&jump) {
                    let axis = jump - SCALES.start;
                    // Over a steady turn a bias and a scale look alike, and biases are what jumps.
                    let ahead = square - CLEAR_OF * usual.variance().max(1.0);
                    square = if ahead > self.square(window, axis) { ahead } else { 0.0 };
                }
                most[group] = most[group].max(square);
                let over = square / usual.limit(DECADES);
                let likeliest = Likeliest { window: number, jump, group, square, rival };
                let shown = best.get_or_insert(ShownJumps { over, square, group, likeliest });
                if over > shown.over {
                    (shown.over, shown.square, shown.group) = (over, square, group);
                }
                if square > shown.likeliest.square {
                    shown.likeliest = likeliest;
                }
            }
        }
        (best, most)
    }

    /// Whether an axis has more likely jumped than not, by what was seen last, whatever the flow says of it.
    pub(in super::super) fn suspects_without_flow(&self, windows: &[JumpWindow]) -> bool {
        let likely = |window: &JumpWindow| {
            let livelier = self.livelier(window);
            LIKE.iter().filter(|(jump, _)| IMU_JUMPS.contains(jump)).any(|(jump, group)| {
                let unit = livelier * self.usual_alone[*group].variance().max(1.0);
                window.fit_without_flow(*jump).is_some_and(|fit| 0.5 * fit.square > UNLIKELY * unit)
            })
        };
        let old = |w: &&JumpWindow| w.age_s() > YOUNGEST_S;
        self.learned >= LEARNED && windows.iter().filter(old).any(likely)
    }

    /// Whether a change of the flow explains what was measured of late better than any of the IMU's does; `but_level_accelerometers`: those of the
    /// level accelerometers do not count.
    pub(in super::super) fn favour_flow(windows: &[JumpWindow], but_level_accelerometers: bool) -> bool {
        let counts = |jump: &usize| !(but_level_accelerometers && LEVEL_ACCELEROMETERS.contains(jump));
        let old = || windows.iter().filter(|w| w.age_s() > YOUNGEST_S);
        let most = |party: Range<usize>| {
            let fits = party.filter(counts).flat_map(|jump| old().filter_map(move |w| w.fit(jump)));
            fits.map(|fit| fit.square).fold(0.0, f64::max)
        };
        most(FLOW_JUMPS) > most(IMU_JUMPS)
    }

    fn find(&mut self, now: AutopilotTime, window: usize, jump: usize, implausible: bool) -> JumpFinding {
        let again = self.last.replace(now).is_some_and(|t| now.seconds_since(t) < REPEATED_S);
        self.found = if again { self.found + 1 } else { 1 };
        (self.quiet, self.beyond) = (None, None);
        if self.found > REPEATED || implausible {
            self.found = 0;
            return JumpFinding::Hopeless;
        }
        JumpFinding::Found { window, jump }
    }

    /// With GNSS, in the air: what is usual is learned from the filter's windows, and what is without GNSS from those of a dead reckoning beside it. What is
    /// beyond its limit again and again is usual, too, but no more than the limit at once.
    pub(in super::super) fn learn(
        &mut self,
        now: AutopilotTime,
        windows: &[JumpWindow],
        alone: &[JumpWindow],
    ) {
        if self.learn_due.is_some_and(|due| now < due) {
            return;
        }
        self.learn_due = Some(now + Span::from_seconds(LEARN_S));
        self.learned = self.learned.saturating_add(1);
        let rate = windows.iter().map(JumpWindow::mean_square_rate).fold(0.0, f64::max);
        self.rate += (rate - self.rate) * (1.0 / f64::from(self.learned)).max(1.0 / MEMORY);
        let most = |windows: &[JumpWindow], usual: &[UsualSpread; GROUPS]| {
            let (imu, flow) =
                (self.shown(windows, usual, IMU_JUMPS).1, self.shown(windows, usual, FLOW_JUMPS).1);
            std::array::from_fn::<f64, GROUPS, _>(|group| imu[group].max(flow[group]))
        };
        let (most, most_alone) = (most(windows, &self.usual), most(alone, &self.usual_alone));
        for group in 0..GROUPS {
            // One axis is half of a plane.
            let learn = |usual: &mut UsualSpread, square: f64| {
                usual.learn(2.0 * square.min(usual.limit(DECADES)), MEMORY);
            };
            learn(&mut self.usual[group], most[group]);
            learn(&mut self.usual_alone[group], most_alone[group].max(most[group]));
        }
    }

    /// Whether an axis may well have jumped.
    pub(in super::super) fn suspects(&self) -> bool {
        self.suspects
    }

    /// Whether the axes have been sound for so long that nothing is held against them.
    pub(in super::super) fn is_quiet(&self, now: AutopilotTime) -> bool {
        self.quiet.is_some_and(|t| now.seconds_since(t) > QUIET_S)
    }
}
