//! Is GNSS there, and does it tell the truth? Every fix gets a verdict with a reason.
//!
//! A receiver shows its loss in many ways (fix type 0 with the old position, zeros at 1 Hz, silence), and a lying one says that all
//! is well. So a fix has to be a fix, to be as accurate as it must, to lie where the inertial prediction of the last tenths of a second
//! expects it, and its positions have to move as its own velocities say. Loss is declared after a time without a good fix; it is
//! not declared good again before a time of good ones.

use nalgebra::Vector2;
use strum::VariantArray;

use crate::sample::{GnssFix, GnssSample};
use crate::time::{AutopilotTime, Span};

use super::super::reset::Reset;
use crate::navigator::tuning::gnss_integrity::{
    INTERVAL_GAIN, MISSING_FIXES, NORMAL_GAIN, SLOWEST_S, TRACK_HOLE_S, TRACK_LEN,
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
    /// Time over which positions are compared with the integral of the velocities, s.
    pub consistency_window_s: f64,
    /// Disagreement that a healthy receiver may show over that time, m …
    pub consistency_limit_m: f64,
    /// … and per second of it, m/s.
    pub consistency_rate_mps: f64,
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
}

/// What a fix that passed the tests is worth.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Standing {
    /// Where it was expected.
    Near,
    /// Sound in itself, but further away than the uncertainty explains. Only while GNSS is not trusted: then it may be the
    /// dead reckoning that is wrong, which time will tell.
    Far,
}

/// How the positions moved, by the velocities.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum TrackMotion {
    Consistent,
    /// One fix jumped.
    Stepped,
    /// Over the window they ran away.
    RanAway,
}

#[derive(Clone, Copy, Debug)]
struct Track {
    time: AutopilotTime,
    position_ne: Vector2<f64>,
    /// ∫v dt, m.
    travelled_ne: Vector2<f64>,
    velocity_ne: Vector2<f64>,
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
    lost_by: GnssFault,
    track: Vec<Track>,
    oldest: usize,
    run_away_ne: Vector2<f64>,
    height_faulty: bool,
    /// Mean square of the step from fix to fix beyond the velocity's, m²: what this receiver normally shows.
    position_ms: f64,
    /// Mean square velocity innovation of good fixes, m²/s².
    velocity_ms: f64,
    /// Mean time between two good fixes, s.
    interval_s: f64,
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
            lost_by: GnssFault::Silence,
            track: Vec::with_capacity(TRACK_LEN),
            oldest: 0,
            run_away_ne: Vector2::zeros(),
            height_faulty: false,
            position_ms: 0.25,
            velocity_ms: 0.1,
            interval_s: 0.0,
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
        let s = self.settings;
        let motion = velocity_ne.map_or(TrackMotion::Consistent, |v| self.follow(time, position_ne, v));
        if motion == TrackMotion::Stepped {
            return Err(GnssFault::PositionJump);
        }
        let Some(i) = innovation else {
            return if motion == TrackMotion::RanAway {
                Err(GnssFault::Inconsistent)
            } else {
                Ok(Standing::Near)
            };
        };
        let velocity_sigma = self.velocity_ms.sqrt().hypot(i.velocity_sigma_mps);
        let jumped = i.position_m > self.position_gate(i.position_sigma_m);
        let surged = i.velocity_mps.is_some_and(|v| {
            v > (s.gate_sigma * velocity_sigma).max(s.min_velocity_gate_mps) * self.caution()
        });
        if self.trusted() && jumped {
            return Err(GnssFault::PositionJump);
        }
        if motion == TrackMotion::RanAway {
            return Err(GnssFault::Inconsistent);
        }
        if !self.trusted() {
            return Ok(if jumped || surged { Standing::Far } else { Standing::Near });
        }
        if surged {
            return Err(GnssFault::VelocityJump);
        }
        if let Some(v) = i.velocity_mps {
            self.velocity_ms += NORMAL_GAIN * ((v * v).min(4.0) - self.velocity_ms);
        }
        Ok(Standing::Near)
    }

    /// Factor on the limits.
    fn caution(&self) -> f64 {
        if self.height_faulty { 0.5 } else { 1.0 }
    }

    /// What lies further off is a jump: many times what this receiver normally shows, and what the prediction may be wrong.
    fn position_gate(&self, prediction_sigma_m: f64) -> f64 {
        let sigma = self.position_ms.sqrt().hypot(prediction_sigma_m);
        (self.settings.gate_sigma * sigma).max(self.settings.min_position_gate_m) * self.caution()
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
        let needed = match (standing, self.lost_by) {
            (Standing::Far, _) => self.settings.recover_far_s,
            _ if self.height_faulty => self.settings.recover_far_s,
            // Who lied slowly has to be watched for as long as a slow lie takes to show.
            (_, GnssFault::Inconsistent) => self.settings.recover_s.max(self.settings.consistency_window_s),
            _ => self.settings.recover_s,
        };
        if self.state == GnssState::Trusted || time.seconds_since(since) < needed {
            return false;
        }
        self.state = GnssState::Trusted;
        true
    }

    /// Notes a fix that failed a test, and its time. True when GNSS is lost by it.
    pub fn bad(&mut self, now: AutopilotTime, fault: GnssFault) -> bool {
        self.last_bad = Some((now, fault));
        self.good_since = None;
        self.check(now)
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
        let was = self.trusted();
        if was {
            self.lost_by = fault;
        }
        self.state = GnssState::Untrusted(fault);
        was
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

    /// How far the positions have run away from the velocities over the window, NE, m: what a slow lie has added so far.
    pub fn run_away(&self) -> Vector2<f64> {
        self.run_away_ne
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

    /// Forgets the track: what comes is not comparable with it (another receiver).
    pub fn forget_track(&mut self) {
        self.track.clear();
        self.oldest = 0;
        self.run_away_ne = Vector2::zeros();
    }

    fn newest(&self) -> Option<&Track> {
        let n = self.track.len();
        if n < TRACK_LEN { self.track.last() } else { self.track.get((self.oldest + n - 1) % n) }
    }

    /// Adds a fix to the track and says whether positions and velocities still agree.
    fn follow(
        &mut self,
        time: AutopilotTime,
        position_ne: Vector2<f64>,
        velocity_ne: Vector2<f64>,
    ) -> TrackMotion {
        let s = self.settings;
        let mut stepped = false;
        let travelled_ne = match self.newest() {
            Some(last) => {
                let dt = time.seconds_since(last.time);
                if !(0.0..=TRACK_HOLE_S.max(self.loss_s())).contains(&dt) {
                    self.forget_track();
                    Vector2::zeros()
                } else {
                    let moved = (last.velocity_ne + velocity_ne) * (0.5 * dt);
                    let travelled = last.travelled_ne + moved;
                    let step = (position_ne - last.position_ne - moved).norm();
                    stepped = step > self.position_gate(0.0);
                    if !stepped {
                        self.position_ms += NORMAL_GAIN * (step * step - self.position_ms);
                    }
                    if stepped {
                        // Positions before and after a step are not comparable.
                        self.forget_track();
                    }
                    travelled
                }
            }
            None => Vector2::zeros(),
        };
        let entry = Track { time, position_ne, travelled_ne, velocity_ne };
        if self.track.len() < TRACK_LEN {
            self.track.push(entry);
        } else {
            self.track[self.oldest] = entry;
            self.oldest = (self.oldest + 1) % TRACK_LEN;
        }
        let n = self.track.len();
        // The oldest entry within the window.
        let mut from = entry;
        for i in 0..n {
            let candidate = self.track[(self.oldest + i) % n];
            if time.seconds_since(candidate.time) <= s.consistency_window_s {
                from = candidate;
                break;
            }
        }
        let window = time.seconds_since(from.time);
        self.run_away_ne = (position_ne - from.position_ne) - (travelled_ne - from.travelled_ne);
        // Receivers filter position and velocity differently: some tenths of a second of the change of velocity are no lie.
        let slack = 0.25 * (velocity_ne - from.velocity_ne).norm();
        if stepped {
            TrackMotion::Stepped
        } else if self.run_away_ne.norm() > s.consistency_limit_m + s.consistency_rate_mps * window + slack {
            TrackMotion::RanAway
        } else {
            TrackMotion::Consistent
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn settings() -> TrustSettings {
        TrustSettings {
            loss_s: 1.0,
            recover_s: 3.0,
            recover_far_s: 10.0,
            min_satellites: 5,
            max_horizontal_accuracy_m: 10.0,
            gate_sigma: 5.0,
            min_position_gate_m: 4.0,
            min_velocity_gate_mps: 2.0,
            consistency_window_s: 15.0,
            consistency_limit_m: 4.0,
            consistency_rate_mps: 0.15,
        }
    }

    fn at(s: f64) -> AutopilotTime {
        AutopilotTime::from_micros((s * 1e6) as i64)
    }

    fn near() -> Option<FixInnovation> {
        Some(FixInnovation {
            position_m: 0.3,
            velocity_mps: Some(0.1),
            position_sigma_m: 0.1,
            velocity_sigma_mps: 0.1,
        })
    }

    fn trusted_after(seconds: f64) -> GnssIntegrity {
        let mut t = GnssIntegrity::new(settings());
        let mut time = 0.0;
        while time < seconds {
            let v = Vector2::new(3.0, 0.0);
            assert_eq!(t.judge(at(time), v * time, Some(v), near()), Ok(Standing::Near));
            t.good(at(time), Standing::Near);
            time += 0.2;
        }
        t
    }

    #[test]
    fn trust_takes_time_and_silence_ends_it() {
        let mut t = trusted_after(2.0);
        assert!(!t.trusted());
        t = trusted_after(4.0);
        assert!(t.trusted());
        assert!(!t.check(at(4.5)));
        assert!(t.check(at(5.2)));
        assert_eq!(t.state(), GnssState::Untrusted(GnssFault::Silence));
    }

    #[test]
    fn a_jump_is_rejected_and_then_declared() {
        let mut t = trusted_after(10.0);
        let far = Some(FixInnovation {
            position_m: 40.0,
            velocity_mps: Some(0.1),
            position_sigma_m: 0.2,
            velocity_sigma_mps: 0.1,
        });
        let v = Vector2::new(3.0, 0.0);
        let mut lost_at = None;
        for k in 0..60 {
            let time = 10.0 + 0.2 * f64::from(k);
            let verdict = t.judge(at(time), v * time + Vector2::new(40.0, 0.0), Some(v), far);
            if t.trusted() {
                assert_eq!(verdict, Err(GnssFault::PositionJump));
                if t.bad(at(time), GnssFault::PositionJump) {
                    lost_at = Some(time);
                }
            } else {
                // From then on it may be the dead reckoning that is wrong, but that takes long to believe.
                assert_eq!(verdict, Ok(Standing::Far));
                assert_eq!(t.good(at(time), Standing::Far), time > lost_at.unwrap() + 10.1);
            }
            if t.trusted() && lost_at.is_some() {
                assert!(time > 20.0);
                return;
            }
        }
        panic!("never believed again");
    }

    #[test]
    fn a_slow_walk_is_found_within_ten_seconds_and_its_size_is_known() {
        let mut t = trusted_after(30.0);
        let v = Vector2::new(3.0, 0.0);
        let mut found = None;
        for k in 0..100 {
            let time = 30.0 + 0.2 * f64::from(k);
            let walked = Vector2::new(0.0, 0.75 * (time - 30.0));
            if t.judge(at(time), v * time + walked, Some(v), near()).is_err() {
                found = Some((time, walked));
                break;
            }
        }
        let (time, walked) = found.unwrap();
        assert!(time < 41.0, "{time}");
        assert!((t.run_away() - walked).norm() < 1.0, "{} {walked}", t.run_away());
    }

    #[test]
    fn a_fix_has_to_be_one() {
        let t = GnssIntegrity::new(settings());
        let mut fix = GnssSample {
            time: at(0.0),
            receiver: 0,
            fix: GnssFix::ThreeD,
            position: Some(crate::geo::Geodetic::from_degrees(47.0, 8.0, 400.0)),
            ground_velocity: None,
            horizontal_accuracy_m: None,
            vertical_accuracy_m: None,
            speed_accuracy_mps: None,
            satellites: None,
            warning: None,
        };
        assert_eq!(t.admit(&fix), Ok(()));
        fix.satellites = Some(3);
        assert_eq!(t.admit(&fix), Err(GnssFault::FewSatellites));
        fix.satellites = Some(12);
        fix.horizontal_accuracy_m = Some(35.0);
        assert_eq!(t.admit(&fix), Err(GnssFault::Inaccurate));
        fix.fix = GnssFix::None;
        assert_eq!(t.admit(&fix), Err(GnssFault::NoFix));
    }
}
