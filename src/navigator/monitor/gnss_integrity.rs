//! Is GNSS there, and does it tell the truth? Every fix gets a verdict with a reason.
//!
//! A receiver shows its loss in many ways (fix type 0 with the old position, zeros at 1 Hz, silence), and a lying one says that all
//! is well. So a fix has to be a fix, to be as accurate as it must, to lie where the inertial prediction of the last tenths of a second
//! expects it, its positions have to move as its own velocities say, and its velocities as the optical flow does. Loss is declared after a
//! time without a good fix, or at once where the fault leaves no doubt; it is not declared good again before a time of good ones, which
//! is the longer the more often GNSS has come and gone.
//!
//! Who was displaced, by a jump or a walk, is good again where it lies as its velocities lead from where it was while it was sound, or where
//! the dead reckoning no longer knows better; by standing where it is alone it never is, as long as something carries that does.

use nalgebra::Vector2;
use strum::VariantArray;

use crate::sample::{GnssFix, GnssSample, GnssWarning};
use crate::time::{AutopilotTime, Span};

use super::super::reset::Reset;
use super::doppler_track::{DopplerTrack, TrackMotion, TrackWander};
use super::frozen_fixes::FrozenFixes;
use crate::navigator::tuning::gnss_integrity::{
    BACK_OFF, FREE_FLAPS, INTERVAL_GAIN, MISSING_FIXES, MOST_BACK_OFF, NORMAL_GAIN, REPLACED_S, SLOWEST_S,
    STEADY_S, TRACK_HOLE_S,
};

/// Limits.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct TrustSettings {
    /// No good fix for this long is a loss, s.
    pub loss_s: f64,
    /// Good fixes for this long end an outage, s.
    pub recover_s: f64,
    /// The same when the fixes lie further away than the uncertainty explains, s.
    pub recover_far_s: f64,
    /// Least number of satellites, where told.
    pub min_satellites: u8,
    /// Worst horizontal accuracy that a receiver may claim, m.
    pub max_horizontal_accuracy_m: f64,
    /// Innovations beyond this many sigmas are a jump.
    pub gate_sigma: f64,
    /// Least gate for the position, m: below it no fix is called a jump.
    pub min_position_gate_m: f64,
    /// Least gate for the velocity, m/s.
    pub min_velocity_gate_mps: f64,
}

/// Why a fix was not used, or GNSS is lost.
#[derive(
    Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Hash, strum::IntoStaticStr, strum::VariantArray,
)]
pub enum GnssFault {
    /// No message came.
    #[strum(serialize = "silent")]
    Silence,
    /// The receiver says that it has no three-dimensional fix.
    #[strum(serialize = "no fix")]
    NoFix,
    /// Too few satellites.
    #[strum(serialize = "few satellites")]
    FewSatellites,
    /// The receiver says that it is inaccurate.
    #[strum(serialize = "inaccurate")]
    Inaccurate,
    /// The position jumped.
    #[strum(serialize = "position jump")]
    PositionJump,
    /// The velocity jumped.
    #[strum(serialize = "velocity jump")]
    VelocityJump,
    /// The positions do not move as the velocities say.
    #[strum(serialize = "position contradicts velocity")]
    Inconsistent,
    /// Position and velocity walk off together from what the optical flow shows.
    #[strum(serialize = "walks off from flow")]
    ContradictsFlow,
    /// Its velocity has changed where inertia has felt no force.
    #[strum(serialize = "velocity contradicts inertia")]
    ContradictsInertia,
    /// Position and velocity stay exactly the same while the vehicle moves.
    #[strum(serialize = "frozen")]
    Frozen,
    /// The receiver says that its signals are spoofed.
    #[strum(serialize = "spoofed")]
    Spoofed,
    /// The receiver says that its signals are jammed.
    #[strum(serialize = "jammed")]
    Jammed,
    /// The receiver says that its signals contradict each other.
    #[strum(serialize = "signals inconsistent")]
    SignalsInconsistent,
    /// Older than what is remembered, or from the future.
    #[strum(serialize = "untimely")]
    Untimely,
    /// Masked by the operator (replay's `--outage`).
    #[strum(serialize = "masked")]
    Masked,
}

impl GnssFault {
    /// All faults, in the order they are shown.
    pub const ALL: &'static [Self] = Self::VARIANTS;

    /// A few words for logs, tables and STATUSTEXT.
    pub fn reason(self) -> &'static str {
        self.into()
    }

    /// One fix of it is enough: it was found over a time, or is the receiver's own word.
    pub const fn is_certain(self) -> bool {
        use GnssFault::{
            ContradictsFlow, ContradictsInertia, Frozen, Inconsistent, Jammed, SignalsInconsistent, Spoofed,
        };
        matches!(
            self,
            Inconsistent
                | ContradictsFlow
                | ContradictsInertia
                | Frozen
                | Spoofed
                | Jammed
                | SignalsInconsistent
        )
    }
}

/// What GNSS is worth now.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum GnssState {
    /// Not yet (or not again) good for long enough.
    Untrusted(GnssFault),
    /// Good.
    Trusted,
}

/// How far a fix lies from the prediction at its own time.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct FixInnovation {
    /// Horizontal position, m.
    pub position_m: f64,
    /// Horizontal velocity, m/s, if the fix has one.
    pub velocity_mps: Option<f64>,
    /// Standard deviation that the prediction adds to the position, m: large after an outage.
    pub position_sigma_m: f64,
    /// The same for the velocity, m/s.
    pub velocity_sigma_mps: f64,
    /// What the position may have drifted by since GNSS was lost, 1 sigma, m: of a jump, this explains some.
    pub drift_sigma_m: f64,
    /// Another receiver is navigated on, and trusted.
    pub aided: bool,
    /// A camera tells the velocity, or landmarks the place.
    pub carried: bool,
    /// Its speed, m/s.
    pub speed_mps: f64,
}

/// What a fix that passed the tests is worth.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Standing {
    /// Where it was expected.
    Near,
    /// Sound in itself, but further away than the uncertainty explains. Only while GNSS is not trusted: then it may be the
    /// dead reckoning that is wrong, which time will tell.
    Far,
    /// It was displaced, and what carries knows better: time alone tells nothing.
    Displaced,
}

/// A slow lie.
#[derive(Clone, Copy, Debug, Default)]
struct WalkedAway {
    /// How far the receiver has walked, NE, m.
    by_ne: Vector2<f64>,
    /// By how much it may wander in that time without walking, m.
    spread_m: f64,
    /// What the estimate has followed of it, NE, m.
    led_ne: Vector2<f64>,
}

/// Judges one receiver.
#[derive(Clone, Debug)]
pub struct GnssIntegrity {
    settings: TrustSettings,
    state: GnssState,
    last_good: Option<AutopilotTime>,
    ever_good: bool,
    good_since: Option<AutopilotTime>,
    last_bad: Option<(AutopilotTime, GnssFault)>,
    track: DopplerTrack,
    frozen: FrozenFixes,
    walked: WalkedAway,
    height_faulty: bool,
    /// Mean square velocity innovation of good fixes, m²/s².
    velocity_ms: f64,
    /// Mean time between two good fixes, s.
    interval_s: f64,
    /// How often it was lost soon after it had come back.
    flaps: u32,
    trusted_since: Option<AutopilotTime>,
}

impl GnssIntegrity {
    /// Nothing heard yet.
    pub fn new(settings: TrustSettings) -> Self {
        Self {
            settings,
            state: GnssState::Untrusted(GnssFault::Silence),
            last_good: None,
            ever_good: false,
            good_since: None,
            last_bad: None,
            track: DopplerTrack::new(),
            frozen: FrozenFixes::default(),
            walked: WalkedAway::default(),
            height_faulty: false,
            velocity_ms: 0.1,
            interval_s: 0.0,
            flaps: 0,
            trusted_since: None,
        }
    }

    /// What GNSS is worth now.
    pub fn state(&self) -> GnssState {
        self.state
    }

    /// Whether there was never a fix that passed every test, whatever has rebooted since.
    pub fn never_good(&self) -> bool {
        !self.ever_good
    }

    /// Whether fixes are good at present, but not yet for long enough.
    pub fn settles(&self) -> bool {
        !self.trusted() && self.good_since.is_some()
    }

    /// Variance of the velocity of good fixes about the estimate, an axis, m²/s².
    pub fn velocity_variance(&self) -> f64 {
        0.5 * self.velocity_ms
    }

    /// Mean time between two good fixes, s.
    pub fn interval_s(&self) -> f64 {
        self.interval_s
    }

    /// Whether GNSS is trusted.
    pub fn trusted(&self) -> bool {
        self.state == GnssState::Trusted
    }

    /// Tests that need no prediction: is it a fix at all, and as good as it must be?
    ///
    /// # Errors
    /// The fault.
    pub fn admit(&self, fix: &GnssSample) -> Result<(), GnssFault> {
        let s = &self.settings;
        match fix.warning {
            Some(GnssWarning::Spoofed) => return Err(GnssFault::Spoofed),
            Some(GnssWarning::Jammed) => return Err(GnssFault::Jammed),
            Some(GnssWarning::Inconsistent) => return Err(GnssFault::SignalsInconsistent),
            None => {}
        }
        if fix.fix < GnssFix::ThreeD || fix.position.is_none() {
            return Err(GnssFault::NoFix);
        }
        if fix.satellites.is_some_and(|n| n < s.min_satellites) {
            return Err(GnssFault::FewSatellites);
        }
        if fix.horizontal_accuracy_m.is_some_and(|a| a > s.max_horizontal_accuracy_m) {
            return Err(GnssFault::Inaccurate);
        }
        Ok(())
    }

    /// Tests an admitted fix against its prediction and against its own history. `innovation` is `None` as long as there is no
    /// prediction.
    ///
    /// # Errors
    /// The fault.
    pub fn judge(
        &mut self,
        time: AutopilotTime,
        position_ne: Vector2<f64>,
        velocity_ne: Option<Vector2<f64>>,
        innovation: Option<FixInnovation>,
    ) -> Result<Standing, GnssFault> {
        let motion = velocity_ne.map_or(TrackMotion::Consistent, |v| self.follow(time, position_ne, v));
        let speed_mps = innovation.map_or(0.0, |i| i.speed_mps);
        if self.frozen.repeats(time, position_ne, velocity_ne, speed_mps) {
            // What it repeats leads nowhere.
            self.track.forget();
            return Err(GnssFault::Frozen);
        }
        if motion == TrackMotion::RanAway {
            let away = self.track.run_away();
            self.walks(away.gap_ne, away.spread_m);
            return Err(GnssFault::Inconsistent);
        }
        if motion == TrackMotion::Stepped || self.trusted() && self.track.displaced().is_some() {
            return Err(GnssFault::PositionJump);
        }
        let Some(i) = innovation else { return Ok(Standing::Near) };
        if self.trusted() { self.expected(&i, velocity_ne.is_some()) } else { Ok(self.standing(&i)) }
    }

    /// A fix of a receiver that is trusted, against its prediction. Where its velocities lead there, `led`, no jump has brought it.
    fn expected(&mut self, i: &FixInnovation, led: bool) -> Result<Standing, GnssFault> {
        if !led && i.position_m > self.position_gate(i.position_sigma_m) {
            return Err(GnssFault::PositionJump);
        }
        if i.velocity_mps.is_some_and(|v| v > self.velocity_gate(i.velocity_sigma_mps)) {
            return Err(GnssFault::VelocityJump);
        }
        if let Some(v) = i.velocity_mps {
            self.velocity_ms += NORMAL_GAIN * ((v * v).min(4.0) - self.velocity_ms);
        }
        Ok(Standing::Near)
    }

    /// What a fix is worth that may end an outage.
    fn standing(&self, i: &FixInnovation) -> Standing {
        if !i.aided
            && let Some((displaced_m, wander_m)) = self.track.displaced()
            && !self.track.resumes()
        {
            let known = displaced_m / i.drift_sigma_m.hypot(wander_m).max(1e-3);
            if known > 1.0 {
                return if i.carried { Standing::Displaced } else { Standing::Far };
            }
        }
        let position = i.position_m / self.position_gate(i.position_sigma_m);
        let velocity = i.velocity_mps.map_or(0.0, |v| v / self.velocity_gate(i.velocity_sigma_mps));
        let away = position.max(velocity);
        if away > 1.0 && !self.track.resumes() { Standing::Far } else { Standing::Near }
    }

    /// Factor on the limits.
    fn caution(&self) -> f64 {
        if self.height_faulty { 0.5 } else { 1.0 }
    }

    /// What lies further off is a jump: many times what this receiver normally shows, and what the prediction may be wrong.
    fn position_gate(&self, prediction_sigma_m: f64) -> f64 {
        let sigma = (2.0 * self.track.step_variance()).sqrt().hypot(prediction_sigma_m);
        (self.settings.gate_sigma * sigma).max(self.settings.min_position_gate_m) * self.caution()
    }

    /// The same for the velocity, m/s.
    fn velocity_gate(&self, prediction_sigma_mps: f64) -> f64 {
        let sigma = self.velocity_ms.sqrt().hypot(prediction_sigma_mps);
        (self.settings.gate_sigma * sigma).max(self.settings.min_velocity_gate_mps) * self.caution()
    }

    /// Notes that a fix passed every test. True when GNSS became trusted by it.
    pub fn good(&mut self, time: AutopilotTime, standing: Standing) -> bool {
        let since = *self.good_since.get_or_insert(time);
        self.ever_good = true;
        let interval = self.last_good.replace(time).map(|last| time.seconds_since(last));
        if let Some(dt) = interval.filter(|dt| (0.0..SLOWEST_S).contains(dt)) {
            let gain = if self.interval_s > 0.0 { INTERVAL_GAIN } else { 1.0 };
            self.interval_s += gain * (dt - self.interval_s);
        }
        if self.state == GnssState::Trusted {
            if self.trusted_since.is_some_and(|t| time.seconds_since(t) > STEADY_S) {
                self.flaps = 0;
            }
            return false;
        }
        if time.seconds_since(since) < self.needed_s(standing) {
            return false;
        }
        self.state = GnssState::Trusted;
        self.trusted_since = Some(time);
        self.track.accept();
        true
    }

    /// For how long fixes of this standing have to come before they are trusted, s.
    fn needed_s(&self, standing: Standing) -> f64 {
        let s = &self.settings;
        let soon =
            s.recover_s * BACK_OFF.powi(self.flaps.saturating_sub(FREE_FLAPS).min(MOST_BACK_OFF) as i32);
        let late = s.recover_far_s.max(soon);
        match standing {
            Standing::Displaced => f64::INFINITY,
            Standing::Far => late,
            Standing::Near if self.height_faulty => late,
            Standing::Near => soon,
        }
    }

    /// Notes a fix that failed a test, and its time. True when GNSS is lost by it.
    pub fn bad(&mut self, now: AutopilotTime, fault: GnssFault) -> bool {
        self.last_bad = Some((now, fault));
        self.good_since = None;
        if fault.is_certain() && self.trusted() { self.lose(now, fault) } else { self.check(now) }
    }

    fn lose(&mut self, now: AutopilotTime, fault: GnssFault) -> bool {
        let was = self.trusted();
        // A silence is a matter of the link.
        let comes_and_goes = was && !matches!(fault, GnssFault::Silence | GnssFault::Masked);
        if comes_and_goes && self.trusted_since.take().is_some_and(|t| now.seconds_since(t) < STEADY_S) {
            self.flaps += 1;
        }
        self.state = GnssState::Untrusted(fault);
        was
    }

    /// No good fix for this long is a loss, s: as configured, but for a receiver so slow that a fix or two may be missing.
    fn loss_s(&self) -> f64 {
        self.settings.loss_s.max(MISSING_FIXES * self.interval_s)
    }

    /// Looks at the time that has passed since the last good fix. True when GNSS is lost by it.
    pub fn check(&mut self, now: AutopilotTime) -> bool {
        let quiet = self.last_good.map_or(f64::INFINITY, |t| now.seconds_since(t));
        let loss_s = self.loss_s();
        if quiet < loss_s {
            return false;
        }
        self.good_since = None;
        let fault = match self.last_bad {
            Some((t, fault)) if now.seconds_since(t) < loss_s => fault,
            _ => GnssFault::Silence,
        };
        self.lose(now, fault)
    }

    /// Whether it is not trusted, or about to be lost: its fixes have not passed for longer than one may be missing.
    pub(in super::super) fn fails(&self, now: AutopilotTime) -> bool {
        let quiet = self.last_good.map_or(f64::INFINITY, |t| now.seconds_since(t));
        !self.trusted() || quiet > REPLACED_S.max(MISSING_FIXES * self.interval_s)
    }

    /// The other receiver takes the place of this one, with all that is known of it. It is trusted with its next fix, if it was.
    pub(in super::super) fn take_over(&mut self, other: &mut Self) {
        std::mem::swap(self, other);
        self.ever_good |= other.ever_good;
        self.height_faulty = false;
        if self.trusted() {
            self.state = GnssState::Untrusted(GnssFault::Silence);
        }
    }

    /// What it was blamed for was somebody else's fault.
    pub fn acquit(&mut self, now: AutopilotTime) {
        self.state = GnssState::Trusted;
        self.last_good = Some(now);
        self.last_bad = None;
    }

    /// Nothing at all was heard for `gap_s` s. Up to `kept_s` that is no silence of the receiver's: what it was worth, it is worth still.
    pub fn deaf(&mut self, gap_s: f64, kept_s: f64) {
        if gap_s <= kept_s {
            let gap = Span::from_seconds(gap_s);
            self.last_good = self.last_good.map(|t| t + gap);
            self.good_since = self.good_since.map(|t| t + gap);
        }
    }

    /// How far a slow lie has led so far, NE, m.
    pub fn walked(&self) -> Vector2<f64> {
        self.walked.by_ne
    }

    /// Since when it tells the same, where it is frozen.
    pub fn frozen_since(&self) -> Option<AutopilotTime> {
        self.frozen.since()
    }

    /// How far that has led the estimate, NE, m: a filter follows positions slowly, and is not wrong by all that they have walked.
    pub fn led(&self) -> Vector2<f64> {
        self.walked.led_ne
    }

    /// A slow lie is found when its fix lies `apart_ne` m from the estimate: so far it has not been followed.
    pub(in super::super) fn leads(&mut self, apart_ne: &Vector2<f64>) {
        let by_ne = self.walked.by_ne;
        let along = apart_ne.dot(&by_ne) / by_ne.norm_squared().max(1e-6);
        self.walked.led_ne = by_ne * (1.0 - along).clamp(0.0, 1.0);
    }

    /// How well it is known how far the slow lie has led, m.
    pub fn walked_spread_m(&self) -> f64 {
        self.walked.spread_m
    }

    /// How far its positions are from where its velocities lead at present.
    pub(in super::super) fn wander(&self) -> TrackWander {
        self.track.wander()
    }

    /// Whether a receiver beside it has moved from its own velocities as this one has, which is not trusted for that.
    pub(in super::super) fn walks_with(&self, other: &TrackWander) -> bool {
        self.state == GnssState::Untrusted(GnssFault::Inconsistent)
            && other.gap_ne.dot(&self.walked.by_ne) > 0.5 * self.walked.by_ne.norm_squared()
    }

    /// Another witness has found that it walks off, and has walked so far, NE, m, as well as that is known, m.
    pub fn walks(&mut self, walked_ne: Vector2<f64>, spread_m: f64) {
        self.walked = WalkedAway { by_ne: walked_ne, spread_m, led_ne: walked_ne };
    }

    /// The height of the fixes is declared faulty, or is not any more. A receiver that is wrong about one axis is trusted less about the
    /// others: its jumps are judged by half the limits, and it does not end an outage sooner than one that lies far away.
    pub fn height_fault(&mut self, faulty: bool) {
        self.height_faulty = faulty;
    }

    pub(in super::super) fn reset(&mut self, reset: &Reset) {
        match reset {
            Reset::OriginMoved(_) => self.forget_track(),
            Reset::Reboot => self.height_fault(false),
            Reset::ClockSetBack => *self = Self { ever_good: self.ever_good, ..Self::new(self.settings) },
            Reset::Relocated | Reset::Bridged | Reset::StreamBroken => {}
        }
    }

    /// Forgets the track: what comes is not comparable with it (another receiver, another origin).
    pub fn forget_track(&mut self) {
        self.track.forget();
    }

    /// Adds a fix to the track and says whether positions and velocities still agree.
    fn follow(
        &mut self,
        time: AutopilotTime,
        position_ne: Vector2<f64>,
        velocity_ne: Vector2<f64>,
    ) -> TrackMotion {
        let hole_s = TRACK_HOLE_S.max(self.loss_s());
        self.track.follow(time, position_ne, velocity_ne, hole_s, self.trusted())
    }
}

#[cfg(test)]
mod tests;
