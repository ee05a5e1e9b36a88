//! GNSS fixes: judged, compared with the past they belong to, and applied or not.

use nalgebra::{Vector2, Vector3};

use crate::altimeter::Channel;
use crate::observer::{FixSample, Innovation};
use crate::sample::{GnssFix, GnssSample};
use crate::time::{AutopilotTime, Span};

use super::Navigator;
use super::event::What;
use super::history::CORRECTED_S;
use super::solution::Mode;
use super::trust::{FixInnovation, GnssFault, Standing};
use super::verdict::{Reason, Verdict};

/// Another receiver takes over when the one in use had no fix for this long, s.
const RECEIVER_SILENCE_S: f64 = 1.0;
/// A receiver's speed is not believed better than this, m/s.
const LEAST_SPEED_SIGMA: f64 = 0.15;
/// Standard deviation of the velocity when a fix has set it, and when it could not, m/s.
pub(super) const AIDED_SPEED_SIGMA: f64 = 0.3;
pub(super) const UNKNOWN_SPEED_SIGMA: f64 = 5.0;
/// The latency of a fix varies by this much, s: at speed, a distance.
const LATENCY_JITTER_S: f64 = 0.1;
/// Vertical over horizontal accuracy of a receiver that claims none.
pub(super) const VERTICAL_RATIO: f64 = 1.5;

impl Navigator {
    pub(super) fn gnss(&mut self, s: &GnssSample) -> Verdict {
        if !s.is_possible() {
            return Verdict::Rejected(Reason::NotFinite);
        }
        let Some(now) = self.last_imu else { return Verdict::Rejected(Reason::NoReferenceYet) };
        if s.receiver != self.receiver {
            let silent = self.receiver_heard.is_none_or(|t| s.time.seconds_since(t) > RECEIVER_SILENCE_S);
            if !silent || s.fix < GnssFix::ThreeD {
                return Verdict::Rejected(Reason::Redundant);
            }
            self.receiver = s.receiver;
            self.trust.forget_track();
            self.latency.interrupt();
            self.height.another(Channel::Gnss);
            self.tell(s.time, What::Receiver(s.receiver));
        }
        match self.fix(now, s) {
            Ok(()) => Verdict::Used,
            Err(fault) => {
                self.trust.bad(now, fault);
                self.latency.interrupt();
                Verdict::Rejected(Reason::Gnss(fault))
            }
        }
    }

    /// GNSS is withheld from the navigator (an outage that the operator made): as if the receiver were silent.
    pub fn mask_gnss(&mut self, time: AutopilotTime) {
        self.trust.bad(time, GnssFault::Masked);
    }

    fn fix(&mut self, now: AutopilotTime, s: &GnssSample) -> Result<(), GnssFault> {
        self.trust.admit(s)?;
        let Some(position) = s.position else { return Err(GnssFault::NoFix) };
        self.receiver_heard = Some(s.time);
        let place = match &self.place {
            Some(place) => place,
            None => {
                self.settle(position);
                // What was measured before there was a place could not be used: the wait for it begins anew.
                self.modes.started(now);
                self.tell(now, What::Origin(0.0));
                return Ok(());
            }
        };
        let measured = s.time - Span::from_seconds(self.latency.latency_s());
        if now.seconds_since(measured) > CORRECTED_S {
            return Err(GnssFault::Untimely);
        }
        let p = place.frame.to_ned(&position);
        let v = s.ground_velocity.map(|g| g.north_east());
        let Some(state) = self.state else { return Ok(()) };
        if !self.predictor.is_running() {
            let (north, east) = v.unwrap_or_default();
            self.predictor.reset(now, &p, &Vector3::new(north, east, 0.0));
            if self.modes.mode() == Mode::Aligning
                && let Some(state) = &mut self.state
            {
                state.position_ned = p;
                state.velocity_ned = Vector3::new(north, east, 0.0);
            }
        }
        let mut sample = FixSample::position(measured, &p).without_vertical_position();
        if let Some((north, east)) = v.filter(|_| self.settings.observer.gnss_velocity) {
            sample = sample.with_horizontal_velocity(north, east);
        }
        let Some(innovation) = self.predictor.innovation(&sample) else { return Err(GnssFault::Untimely) };
        // What the fix has to be compared with is the estimate at its time: the filter's, or in dead reckoning the observer's; with
        // GNSS the observer follows the measurement signal.
        let (e_p, e_v) = self.fix_errors(&innovation, measured, &p, v, state.position_ned);
        let judged = (self.modes.mode() != Mode::Aligning).then(|| self.expectation(&e_p, e_v.as_ref()));
        let velocity_ne = v.map(|(north, east)| Vector2::new(north, east));
        let sigma = s.vertical_accuracy_m.unwrap_or(
            s.horizontal_accuracy_m.unwrap_or(self.settings.gnss.default_accuracy_m) * VERTICAL_RATIO,
        );
        let standing = match self.trust.judge(measured, p.xy(), velocity_ne, judged)? {
            // A receiver that comes back at another height is not where it says.
            Standing::Near if self.modes.dead_reckoning() && self.height_contradicts(-p.z, sigma) => {
                Standing::Far
            }
            standing => standing,
        };
        let regained = self.trust.good(now, standing);
        let claimed = s.horizontal_accuracy_m.unwrap_or(self.settings.gnss.default_accuracy_m);
        self.gnss_sigma_m += 0.1 * (claimed - self.gnss_sigma_m);

        match self.modes.mode() {
            Mode::Holdover | Mode::Lost if regained => {
                let accuracy = [claimed, s.speed_accuracy_mps.unwrap_or(0.3)];
                self.rejoin(now, &innovation, &e_p, e_v.as_ref(), accuracy);
            }
            Mode::Holdover | Mode::Lost => return Ok(()),
            Mode::Aligning | Mode::Aided | Mode::Rejoining => {
                self.predictor.apply(&innovation);
                let accuracy = [claimed, s.speed_accuracy_mps.unwrap_or(0.0).max(LEAST_SPEED_SIGMA)];
                self.weigh_headings(now, measured, velocity_ne, accuracy[1]);
                self.fuse_fix(now, measured, &e_p, e_v.as_ref(), accuracy);
            }
        }
        if let (Some(e_v), Some(a)) =
            (horizontal(&innovation.velocity_ned), self.history.acceleration(measured))
            && self.modes.mode() == Mode::Aided
        {
            self.latency.observe(&e_v, &a.xy());
        } else {
            self.latency.interrupt();
        }
        self.take_height(now, Channel::Gnss, -p.z, Some(sigma), now.seconds_since(measured));
        Ok(())
    }

    /// Whether a GNSS height is far from the altimeter's.
    fn height_contradicts(&self, height_m: f64, sigma_m: f64) -> bool {
        let apart = self.height.disagreement(Channel::Gnss, height_m, sigma_m);
        apart.is_some_and(|sigmas| sigmas.abs() > self.settings.gnss.trust.gate_sigma)
    }

    /// How far the fix lies from what was expected, and how well that was known.
    fn expectation(&self, e_p: &Vector2<f64>, e_v: Option<&Vector2<f64>>) -> FixInnovation {
        let (mut position_sigma_m, mut velocity_sigma_mps) = (0.0, 0.0);
        if let Some(s) = self.solution() {
            let speed = s.velocity.raw().xy().norm();
            position_sigma_m = speed * LATENCY_JITTER_S;
            if self.modes.dead_reckoning() {
                let v = s.velocity_covariance.raw();
                position_sigma_m = s.horizontal_sigma_m().hypot(position_sigma_m);
                velocity_sigma_mps = (v[(0, 0)] + v[(1, 1)]).max(0.0).sqrt();
            }
        }
        FixInnovation {
            position_m: e_p.norm(),
            velocity_mps: e_v.map(|e| e.norm()),
            position_sigma_m,
            velocity_sigma_mps,
        }
    }

    /// Horizontal position and velocity errors of a fix against the estimate at its time.
    fn fix_errors(
        &self,
        innovation: &Innovation,
        measured: AutopilotTime,
        p: &Vector3<f64>,
        v: Option<(f64, f64)>,
        observer_p: Vector3<f64>,
    ) -> (Vector2<f64>, Option<Vector2<f64>>) {
        if self.filtered()
            && let Some((past_p, past_v)) = self.history.motion(measured).or_else(|| self.estimate())
        {
            return ((p - past_p).xy(), v.map(|(north, east)| Vector2::new(north, east) - past_v.xy()));
        }
        let lag = match (self.modes.dead_reckoning(), self.predictor.latest()) {
            (true, Some(w)) => (w.position_ned - observer_p).xy(),
            _ => Vector2::zeros(),
        };
        let e_p = horizontal(&innovation.position_ned).map_or(Vector2::zeros(), |e| e + lag);
        (e_p, horizontal(&innovation.velocity_ned))
    }

    /// GNSS is trusted again: the estimate moves to it at once, the published position stays and glides after it.
    fn rejoin(
        &mut self,
        now: AutopilotTime,
        innovation: &Innovation,
        e_p: &Vector2<f64>,
        e_v: Option<&Vector2<f64>>,
        accuracy: [f64; 2],
    ) {
        let Some((before, _)) = self.estimate() else { return };
        let delay = now.seconds_since(innovation.stamp);
        let e_v_or_zero = e_v.copied().unwrap_or_default();
        let shift = e_p + e_v_or_zero * delay;
        let shift = Vector3::new(shift.x, shift.y, 0.0);
        self.predictor.apply(innovation);
        if let Some(kalman) = &mut self.kalman {
            let velocity = kalman.filter.state().velocity_ned.xy() + e_v_or_zero;
            let sigma_v =
                if e_v.is_some() { accuracy[1].max(AIDED_SPEED_SIGMA) } else { UNKNOWN_SPEED_SIGMA };
            let position = (before + shift).xy();
            kalman.filter.reset_motion(&position, &velocity, accuracy[0], sigma_v);
            self.history.clear();
        }
        self.rejoin_xkf(&(before + shift).xy(), e_v, accuracy);
        if let (Some(state), Some(w)) = (&mut self.state, self.predictor.latest()) {
            state.position_ned = Vector3::new(w.position_ned.x, w.position_ned.y, state.position_ned.z);
            state.velocity_ned += Vector3::new(e_v_or_zero.x, e_v_or_zero.y, 0.0);
        }
        self.offset_ned -= shift;
        self.came_back(now);
    }
}

/// North and east, if both are there.
fn horizontal(v: &[Option<f64>; 3]) -> Option<Vector2<f64>> {
    Some(Vector2::new(v[0]?, v[1]?))
}
