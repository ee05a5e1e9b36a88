//! Whether an axis of the IMU has another bias or scale than it had: the filter's innovations of the last seconds, fitted with a jump of each
//! ([`crate::filter::error_state::JumpWindow`]).
//!
//! With white innovations what a jump explains is χ²; with what flights really are (gusts, iron, latency) it is more, by how much is learned while GNSS is good,
//! from the filter and from a dead reckoning beside it ([`UsualSpread`]). An axis has jumped where that is far beyond what is usual for one; it is the one that explains most, for all of them have to explain the same innovations, if that is clearly more than a change of magnetometer, flow or wind would.
//!
//! A gyro's scale, alignment and sampling make errors in proportion to how fast a vehicle turns: where it turns faster than it used to while that was learned, more is usual.
//!
//! What is not beyond doubt yet is a suspicion: with the jump's odds as its weight it is a part of what is published as sigma.

use crate::filter::error_state::{IMU_JUMPS, JUMPS, JumpWindow};
use crate::time::{AutopilotTime, Span};

use super::usual::UsualSpread;
use crate::navigator::tuning::inertia_jumps::{
    CALM, CLEAR_OF, DECADES, FIRM, LASTS_AIDED_S, LASTS_S, LEARN_S, LEARNED, LOOK_S, MEMORY, QUIET_S,
    REPEATED, REPEATED_S, SPREAD, UNLIKELY, YOUNGEST_S,
};

/// Jumps of which the same is usual: gyro and accelerometer, level and vertical axes. (A gyro's scale shows where its bias does.)
const GROUPS: [usize; IMU_JUMPS] = [0, 0, 1, 2, 2, 3, 0, 0, 1];
/// Where the gyros' scales begin among the jumps, in the order of their biases, which come first.
const SCALES: usize = 6;

/// A jump of a window.
#[derive(Clone, Copy, Debug)]
struct Likeliest {
    window: usize,
    jump: usize,
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

/// What the innovations say of the IMU.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(in super::super) enum JumpFinding {
    /// Nothing that matters.
    Quiet,
    /// This window's jump may have happened, with this probability.
    Suspected { window: usize, jump: usize, odds: f64 },
    /// It has.
    Found { window: usize, jump: usize },
    /// It has again and again, or is larger than any: no jump is what is wrong.
    Hopeless,
}

/// See the module's documentation.
#[derive(Clone, Copy, Debug)]
pub(in super::super) struct InertiaJumps {
    usual: [UsualSpread; 4],
    /// The same without GNSS.
    usual_alone: [UsualSpread; 4],
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
        let usual = [UsualSpread::expecting(SPREAD, FIRM); 4];
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

    /// Looks at the windows; `aided`: GNSS is good; `flies`: the vehicle does, and what is usual can be learned.
    pub(in super::super) fn judge(
        &mut self,
        now: AutopilotTime,
        windows: &[JumpWindow],
        (aided, flies): (bool, bool),
    ) -> JumpFinding {
        self.suspects = false;
        if !flies || self.learned < LEARNED {
            return JumpFinding::Quiet;
        }
        let usual = if aided { &self.usual } else { &self.usual_alone };
        let (Some(shown), _) = self.shown(windows, usual) else { return JumpFinding::Quiet };
        let Likeliest { window, jump, square, rival } = shown.likeliest;
        // By Bayes: as likely as the ratio says, times how rarely it happens.
        let odds =
            1.0 / (1.0 + (UNLIKELY - 0.5 * shown.square / usual[shown.group].variance().max(1.0)).exp());
        self.quiet = if odds > 0.5 { None } else { self.quiet.or(Some(now)) };
        self.suspects = odds > 0.5 && square > rival;
        let clear = square - rival > CLEAR_OF * usual[GROUPS[jump]].variance().max(1.0);
        let beyond = shown.over > 1.0 && clear;
        self.beyond = if beyond { self.beyond.or(Some(now)) } else { None };
        // With GNSS there is time.
        let lasts_s = if aided { LASTS_AIDED_S } else { LASTS_S };
        if self.beyond.is_some_and(|t| now.seconds_since(t) >= lasts_s) {
            return self.find(now, window, jump, windows[window].is_implausible(jump));
        }
        JumpFinding::Suspected { window, jump, odds }
    }

    /// What all windows and jumps show, and the most that each group does.
    fn shown(&self, windows: &[JumpWindow], usual: &[UsualSpread; 4]) -> (Option<ShownJumps>, [f64; 4]) {
        let mut best: Option<ShownJumps> = None;
        let mut most = [0.0f64; 4];
        for (number, window) in windows.iter().enumerate().filter(|(_, w)| w.age_s() > YOUNGEST_S) {
            let livelier = (window.mean_square_rate() / self.rate.max(CALM * CALM)).max(1.0);
            let square = |jump: usize| window.fit(jump).map_or(0.0, |fit| fit.square / livelier);
            let rival = (IMU_JUMPS..JUMPS).map(square).fold(0.0, f64::max);
            for (jump, group) in GROUPS.iter().enumerate() {
                let usual = &usual[*group];
                let mut square_here = square(jump);
                if let Some(axis) = jump.checked_sub(SCALES) {
                    // Over a steady turn a bias and a scale look alike, and biases are what jumps.
                    let ahead = square_here - CLEAR_OF * usual.variance().max(1.0);
                    square_here = if ahead > square(axis) { ahead } else { 0.0 };
                }
                most[*group] = most[*group].max(square_here);
                let over = square_here / usual.limit(DECADES);
                let likeliest = Likeliest { window: number, jump, square: square_here, rival };
                let shown =
                    best.get_or_insert(ShownJumps { over, square: square_here, group: *group, likeliest });
                if over > shown.over {
                    (shown.over, shown.square, shown.group) = (over, square_here, *group);
                }
                if square_here > shown.likeliest.square {
                    shown.likeliest = likeliest;
                }
            }
        }
        (best, most)
    }

    /// Whether an axis has more likely jumped than not, by what was seen last, whatever the flow says of it.
    pub(in super::super) fn suspects_without_flow(&self, windows: &[JumpWindow]) -> bool {
        let likely = |window: &JumpWindow| {
            let rate = (window.mean_square_rate() / self.rate.max(CALM * CALM)).max(1.0);
            GROUPS.iter().enumerate().any(|(jump, group)| {
                let unit = rate * self.usual_alone[*group].variance().max(1.0);
                window.fit_without_flow(jump).is_some_and(|fit| 0.5 * fit.square > UNLIKELY * unit)
            })
        };
        let old = |w: &&JumpWindow| w.age_s() > YOUNGEST_S;
        self.learned >= LEARNED && windows.iter().filter(old).any(likely)
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
        let (_, most) = self.shown(windows, &self.usual);
        let (_, most_alone) = self.shown(alone, &self.usual_alone);
        for group in 0..4 {
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
