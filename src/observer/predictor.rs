//! The inter-sample predictor: what is injected into an observer at the IMU's rate between fixes that come at 1-10 Hz and late.
//!
//! Injecting a held sample costs metres and tenths of degrees; holding the innovation, or jumps with T·K, are unstable with the
//! papers' gains (spectral radius 25 a fix). So a copy w of position and velocity is integrated with the observer's own acceleration,
//! ẇ_v = f̂ⁿ + g − 2ω_e × w_v, ẇ_p = w_v, is set to each fix, and w − (p̂, v̂) is injected at the IMU's rate.
//!
//! A fix stamped t_g < now is compared with the stored w(t_g), and its correction extrapolated to now exactly: the difference of two
//! solutions of ẅ_p = a is e_p + e_v (t − t_g). For a fix without delay this is the plain reset.
//!
//! On an axis whose velocity is not measured, w_v is the observer's own v̂ at every step (Theorem 2 of Grip: e_v = 0).

use super::history::{MotionHistory, PastMotion};
use super::tuning::{MAX_AHEAD, MAX_STEP};
use crate::time::{AutopilotTime, Span};
use nalgebra::Vector3;

/// How fixes are turned into a signal at the IMU's rate.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Scheme {
    /// The inter-sample predictor. The one to use.
    InterSample,
    /// The last fix is held (as both papers do). For comparison; an innovation is then the distance between two fixes.
    Hold,
}

/// A position and velocity fix in NED, any component of which may be absent.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct FixSample {
    /// When it was valid (not when it arrived).
    pub stamp: AutopilotTime,
    /// Position, m.
    pub position_ned: [Option<f64>; 3],
    /// Velocity, m/s.
    pub velocity_ned: [Option<f64>; 3],
}

/// A fix less the prediction at its time, before any correction: for gating.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Innovation {
    /// The fix's stamp.
    pub stamp: AutopilotTime,
    /// How late the fix was, s.
    pub delay_s: f64,
    /// e_p at the stamp, m.
    pub position_ned: [Option<f64>; 3],
    /// e_v at the stamp, m/s.
    pub velocity_ned: [Option<f64>; 3],
}

/// The measurement signal w, with the axes on which it says something.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Signal {
    /// w_p in NED, m.
    pub position_ned: Vector3<f64>,
    /// w_v in NED, m/s.
    pub velocity_ned: Vector3<f64>,
    /// Axes with a recent position; the error of the others is 0.
    pub position_axes: [bool; 3],
    /// Axes with a recent velocity; the error of the others is 0 (Grip, Theorem 2).
    pub velocity_axes: [bool; 3],
    /// Whether it moves between fixes.
    pub scheme: Scheme,
}

impl FixSample {
    /// A position without velocity.
    pub fn position(stamp: AutopilotTime, position_ned: &Vector3<f64>) -> Self {
        Self { stamp, position_ned: some(position_ned), velocity_ned: [None; 3] }
    }

    /// The same with a velocity.
    pub fn with_velocity(self, velocity_ned: &Vector3<f64>) -> Self {
        Self { velocity_ned: some(velocity_ned), ..self }
    }

    /// The same with a horizontal velocity only, as GPS_RAW_INT has it (speed over ground and course).
    pub fn with_horizontal_velocity(self, north_mps: f64, east_mps: f64) -> Self {
        Self { velocity_ned: [Some(north_mps), Some(east_mps), None], ..self }
    }

    /// The same without its vertical position (receivers' height is poor where an altimeter is good).
    pub fn without_vertical_position(self) -> Self {
        let [n, e, _] = self.position_ned;
        Self { position_ned: [n, e, None], ..self }
    }

    /// An altitude (positive down, m) and, where known, vertical speed (positive down, m/s).
    pub fn vertical(stamp: AutopilotTime, down_m: f64, down_rate_mps: Option<f64>) -> Self {
        Self { stamp, position_ned: [None, None, Some(down_m)], velocity_ned: [None, None, down_rate_mps] }
    }
}

impl Signal {
    /// e_p = w_p − p̂ and e_v = w_v − v̂, zero on the axes without a recent measurement.
    pub fn errors(
        &self,
        position_ned: &Vector3<f64>,
        velocity_ned: &Vector3<f64>,
    ) -> (Vector3<f64>, Vector3<f64>) {
        let mut e_p = self.position_ned - position_ned;
        let mut e_v = self.velocity_ned - velocity_ned;
        for axis in 0..3 {
            if !self.position_axes[axis] {
                e_p[axis] = 0.0;
            }
            if !self.velocity_axes[axis] {
                e_v[axis] = 0.0;
            }
        }
        (e_p, e_v)
    }

    /// ẇ_v = a − 2ω_e × w_v, ẇ_p = w_v over `h` seconds, by Euler; nothing for a held signal.
    pub fn advance(&mut self, h: f64, acceleration_ned: &Vector3<f64>, earth_rate_ned: &Vector3<f64>) {
        if self.scheme == Scheme::InterSample {
            let coriolis = -2.0 * earth_rate_ned.cross(&self.velocity_ned);
            self.position_ned += h * self.velocity_ned;
            self.velocity_ned += h * (acceleration_ned + coriolis);
        }
    }
}

/// Turns fixes that are rare, late and incomplete into a measurement signal at the IMU's rate.
#[derive(Clone, Debug)]
pub struct Predictor {
    scheme: Scheme,
    hold: Span,
    earth_rate_ned: Vector3<f64>,
    now: Option<PastMotion>,
    history: MotionHistory,
    measured_position: [Option<AutopilotTime>; 3],
    measured_velocity: [Option<AutopilotTime>; 3],
}

impl Predictor {
    /// A predictor without a state. `history` is the longest delay a fix may have; `hold` is how long after its last measurement an axis
    /// still counts as measured (somewhat over two intervals of the slowest receiver). `earth_rate_ned`, rad/s, is for the Coriolis
    /// term; zero where the observer has none.
    pub fn new(scheme: Scheme, history: Span, hold: Span, earth_rate_ned: Vector3<f64>) -> Self {
        Self {
            scheme,
            hold,
            earth_rate_ned,
            now: None,
            history: MotionHistory::new(history, Span::from_millis(5)),
            measured_position: [None; 3],
            measured_velocity: [None; 3],
        }
    }

    /// Starts, or starts anew, from a full position and velocity. Forgets the history. Values that are not finite leave it without a state.
    pub fn reset(&mut self, stamp: AutopilotTime, position_ned: &Vector3<f64>, velocity_ned: &Vector3<f64>) {
        self.clear();
        let entry = PastMotion { stamp, position_ned: *position_ned, velocity_ned: *velocity_ned };
        if finite(position_ned) && finite(velocity_ned) {
            self.history.record(entry);
            self.now = Some(entry);
        }
    }

    /// Back to having no state.
    pub fn clear(&mut self) {
        self.history.clear();
        self.now = None;
        self.measured_position = [None; 3];
        self.measured_velocity = [None; 3];
    }

    /// Whether it has a state.
    pub fn is_running(&self) -> bool {
        self.now.is_some()
    }

    /// The newest w and its time.
    pub fn latest(&self) -> Option<PastMotion> {
        self.now
    }

    /// Integrates to `now` with the observer's f̂ⁿ + g over the interval (see [`super::StepReport`]); `velocity_ned` is v̂ after the step.
    /// Without a state, with a stamp that is not later than the last, or input that is not finite, nothing happens; after a gap of
    /// more than 1 s the state is dropped. Returns whether it moved.
    pub fn propagate(
        &mut self,
        now: AutopilotTime,
        acceleration_ned: &Vector3<f64>,
        velocity_ned: &Vector3<f64>,
    ) -> bool {
        let Some(last) = self.now else { return false };
        let step = now - last.stamp;
        if step > MAX_STEP {
            self.clear();
            return false;
        }
        if step <= Span::ZERO || !finite(acceleration_ned) || !finite(velocity_ned) {
            return false;
        }
        let mut signal = self.signal_at(&last);
        signal.advance(step.seconds(), acceleration_ned, &self.earth_rate_ned);
        self.follow(now, &signal, velocity_ned)
    }

    /// Takes w at `now` from a signal that was moved by its owner ([`Signal::advance`], [`super::StepReport::signal`]), as
    /// [`Self::propagate`] does with its own. Returns whether it moved.
    pub fn follow(&mut self, now: AutopilotTime, signal: &Signal, velocity_ned: &Vector3<f64>) -> bool {
        let Some(last) = self.now else { return false };
        let values = [&signal.position_ned, &signal.velocity_ned, velocity_ned];
        if now <= last.stamp || !values.into_iter().all(finite) {
            return false;
        }
        let mut entry =
            PastMotion { stamp: now, position_ned: signal.position_ned, velocity_ned: signal.velocity_ned };
        if self.scheme == Scheme::InterSample {
            for axis in 0..3 {
                if !self.is_fresh(self.measured_velocity[axis], now) {
                    entry.velocity_ned[axis] = velocity_ned[axis];
                }
            }
        }
        self.now = Some(entry);
        self.history.record(entry);
        true
    }

    fn is_fresh(&self, measured: Option<AutopilotTime>, now: AutopilotTime) -> bool {
        measured.is_some_and(|t| now - t <= self.hold)
    }

    /// The fix less w at its time; nothing is changed. `None` without a state, for a fix older than the history or more than 50 ms ahead of
    /// the last sample, and for one that is not finite or empty.
    pub fn innovation(&self, fix: &FixSample) -> Option<Innovation> {
        let now = self.now?;
        if fix.stamp - now.stamp > MAX_AHEAD {
            return None;
        }
        let mut values = fix.position_ned.iter().chain(&fix.velocity_ned).flatten().peekable();
        values.peek()?;
        if !values.all(|v| v.is_finite()) {
            return None;
        }
        let (p, v) = self.history.at(fix.stamp, &now)?;
        Some(Innovation {
            stamp: fix.stamp,
            delay_s: now.stamp.seconds_since(fix.stamp),
            position_ned: std::array::from_fn(|i| fix.position_ned[i].map(|z| z - p[i])),
            velocity_ned: std::array::from_fn(|i| fix.velocity_ned[i].map(|z| z - v[i])),
        })
    }

    /// Applies an innovation that was computed on the present state: w_v += e_v, w_p += e_p + e_v (now − t_g), and the history likewise.
    /// Absent components correct nothing.
    pub fn apply(&mut self, innovation: &Innovation) {
        let Some(now) = &mut self.now else { return };
        let mut e_p = Vector3::zeros();
        let mut e_v = Vector3::zeros();
        for axis in 0..3 {
            if let Some(e) = innovation.position_ned[axis] {
                e_p[axis] = e;
                self.measured_position[axis] = Some(innovation.stamp);
            }
            if let Some(e) = innovation.velocity_ned[axis] {
                e_v[axis] = e;
                self.measured_velocity[axis] = Some(innovation.stamp);
            }
        }
        let since = match self.scheme {
            Scheme::InterSample => now.stamp.seconds_since(innovation.stamp) * e_v,
            Scheme::Hold => Vector3::zeros(),
        };
        now.position_ned += e_p + since;
        now.velocity_ned += e_v;
        self.history.correct(innovation.stamp, &e_p, &e_v);
    }

    /// The signal to inject; `None` without a state or when no axis was measured within the hold time.
    pub fn signal(&self) -> Option<Signal> {
        let now = self.now?;
        let signal = self.signal_at(&now);
        let measured = signal.position_axes.iter().chain(&signal.velocity_axes).any(|&a| a);
        measured.then_some(signal)
    }

    fn signal_at(&self, entry: &PastMotion) -> Signal {
        Signal {
            position_ned: entry.position_ned,
            velocity_ned: entry.velocity_ned,
            position_axes: self.measured_position.map(|t| self.is_fresh(t, entry.stamp)),
            velocity_axes: self.measured_velocity.map(|t| self.is_fresh(t, entry.stamp)),
            scheme: self.scheme,
        }
    }
}

fn some(v: &Vector3<f64>) -> [Option<f64>; 3] {
    [Some(v.x), Some(v.y), Some(v.z)]
}

fn finite(v: &Vector3<f64>) -> bool {
    v.iter().all(|c| c.is_finite())
}

#[cfg(test)]
mod tests {
    use super::*;

    fn at(ms: i64) -> AutopilotTime {
        AutopilotTime::from_micros(ms * 1000)
    }

    fn predictor(history: Span, hold: Span) -> Predictor {
        Predictor::new(Scheme::InterSample, history, hold, Vector3::zeros())
    }

    /// A predictor fed a known acceleration at 100 Hz, with fixes of the true motion, each `delay_ms` late. Returns its end state.
    fn run(delay_ms: i64, offset_p: f64, offset_v: f64) -> (PastMotion, f64) {
        let mut w = predictor(Span::from_millis(1000), Span::from_millis(2000));
        w.reset(at(0), &Vector3::new(offset_p, 0.0, 0.0), &Vector3::new(offset_v, 0.0, 0.0));
        // Truth integrated with the predictor's own rule, so that only the handling of delays is under test.
        let mut truth = vec![(0.0, 0.0)];
        let mut worst_after_first = 0.0f64;
        let mut applied = 0;
        for k in 1..=400i64 {
            let a = 3.0 * (0.02 * k as f64).cos();
            let (p, v) = truth[(k - 1) as usize];
            truth.push((p + 0.01 * v, v + 0.01 * a));
            let a_ned = Vector3::new(a, 0.0, 0.0);
            // Before the first fix the velocity follows the observer's, here the predictor's own.
            let v_hat = w.latest().unwrap().velocity_ned + 0.01 * a_ned;
            assert!(w.propagate(at(10 * k), &a_ned, &v_hat));
            let sample = k - delay_ms / 10;
            if k % 20 == 0 && sample > 0 {
                let (p, v) = truth[sample as usize];
                let fix = FixSample::position(at(10 * sample), &Vector3::new(p, 0.0, 0.0))
                    .with_velocity(&Vector3::new(v, 0.0, 0.0));
                let e = w.innovation(&fix).unwrap();
                if applied > 0 {
                    worst_after_first = worst_after_first.max(e.position_ned[0].unwrap().abs());
                }
                w.apply(&e);
                applied += 1;
            }
        }
        let end = w.latest().unwrap();
        let (p, v) = truth[400];
        assert!((end.position_ned.x - p).abs() < 1e-9, "{}", end.position_ned.x - p);
        assert!((end.velocity_ned.x - v).abs() < 1e-9);
        (end, worst_after_first)
    }

    #[test]
    fn late_fixes_correct_as_exactly_as_timely_ones() {
        for delay_ms in [0, 50, 200, 730] {
            let (_, later_innovations) = run(delay_ms, 40.0, -3.0);
            // Also when the next fix lies before the previous correction was made: the history was corrected with it.
            assert!(later_innovations < 1e-9, "{delay_ms} ms: {later_innovations}");
        }
    }

    #[test]
    fn a_fix_without_delay_is_the_plain_reset() {
        let mut w = predictor(Span::from_millis(500), Span::from_millis(1000));
        w.reset(at(0), &Vector3::zeros(), &Vector3::new(1.0, 2.0, 3.0));
        w.propagate(at(10), &Vector3::new(0.0, 0.0, 1.0), &Vector3::zeros());
        let (p, v) = (Vector3::new(7.0, -4.0, 2.0), Vector3::new(0.5, 0.25, -1.0));
        let e = w.innovation(&FixSample::position(at(10), &p).with_velocity(&v)).unwrap();
        assert_eq!(e.delay_s, 0.0);
        w.apply(&e);
        let s = w.signal().unwrap();
        assert!((s.position_ned - p).norm() < 1e-12 && (s.velocity_ned - v).norm() < 1e-12);
        assert_eq!(s.errors(&s.position_ned, &s.velocity_ned), (Vector3::zeros(), Vector3::zeros()));
    }

    #[test]
    fn stamps_between_entries_are_interpolated() {
        let mut w = predictor(Span::from_millis(500), Span::from_millis(1000));
        w.reset(at(0), &Vector3::zeros(), &Vector3::new(10.0, 0.0, 0.0));
        for k in 1..=20 {
            w.propagate(at(20 * k), &Vector3::zeros(), &Vector3::new(10.0, 0.0, 0.0));
        }
        let fix = FixSample::position(AutopilotTime::from_micros(123_456), &Vector3::new(1.0, 0.0, 0.0));
        let e = w.innovation(&fix).unwrap();
        assert!((e.position_ned[0].unwrap() - (1.0 - 1.234_56)).abs() < 1e-12);
        assert!((e.delay_s - 0.276_544).abs() < 1e-12);
    }

    #[test]
    fn absent_components_are_not_corrected_and_not_injected() {
        let mut w = predictor(Span::from_millis(500), Span::from_millis(1000));
        w.reset(at(0), &Vector3::zeros(), &Vector3::zeros());
        assert!(w.signal().is_none(), "a reset is no measurement");
        w.propagate(at(10), &Vector3::zeros(), &Vector3::zeros());
        let fix = FixSample::position(at(10), &Vector3::new(1.0, 2.0, 3.0))
            .with_horizontal_velocity(4.0, 5.0)
            .without_vertical_position();
        let e = w.innovation(&fix).unwrap();
        assert_eq!((e.position_ned[2], e.velocity_ned[2]), (None, None));
        w.apply(&e);
        let s = w.signal().unwrap();
        assert_eq!((s.position_axes, s.velocity_axes), ([true, true, false], [true, true, false]));
        let (e_p, e_v) = s.errors(&Vector3::repeat(-1.0), &Vector3::repeat(-1.0));
        assert_eq!((e_p.z, e_v.z), (0.0, 0.0));
        assert!((e_p.x - 2.0).abs() < 1e-12 && (e_v.y - 6.0).abs() < 1e-12);
        // A vertical sample fills the rest; w_v follows the observer's velocity there and nowhere else.
        let e = w.innovation(&FixSample::vertical(at(10), -30.0, None)).unwrap();
        w.apply(&e);
        w.propagate(at(20), &Vector3::zeros(), &Vector3::new(-7.0, -7.0, 9.0));
        let s = w.signal().unwrap();
        assert_eq!((s.position_axes, s.velocity_axes), ([true; 3], [true, true, false]));
        assert!((s.position_ned.z + 30.0).abs() < 1e-12 && s.velocity_ned.z == 9.0);
        assert!((s.velocity_ned.x - 4.0).abs() < 1e-12);
    }

    #[test]
    fn fixes_that_cannot_be_compared_give_no_innovation() {
        let mut w = predictor(Span::from_millis(100), Span::from_millis(1000));
        let fix = |ms| FixSample::position(at(ms), &Vector3::zeros());
        assert!(w.innovation(&fix(0)).is_none(), "no state");
        w.reset(at(0), &Vector3::zeros(), &Vector3::zeros());
        for k in 1..=100 {
            w.propagate(at(10 * k), &Vector3::zeros(), &Vector3::zeros());
        }
        assert!(w.innovation(&fix(910)).is_some());
        assert!(w.innovation(&fix(700)).is_none(), "older than the history");
        assert!(w.innovation(&fix(1040)).is_some());
        assert!(w.innovation(&fix(1060)).is_none(), "from the future");
        assert!(w.innovation(&FixSample::position(at(1000), &Vector3::repeat(f64::NAN))).is_none());
        assert!(w.innovation(&FixSample { position_ned: [None; 3], ..fix(1000) }).is_none());
    }

    #[test]
    fn nonsense_and_gaps_do_not_get_in() {
        let mut w = predictor(Span::from_millis(100), Span::from_millis(1000));
        w.reset(at(0), &Vector3::repeat(f64::NAN), &Vector3::zeros());
        assert!(!w.is_running());
        w.reset(at(0), &Vector3::zeros(), &Vector3::zeros());
        assert!(!w.propagate(at(10), &Vector3::repeat(f64::INFINITY), &Vector3::zeros()));
        assert!(!w.propagate(at(-10), &Vector3::zeros(), &Vector3::zeros()));
        assert!(!w.propagate(at(5000), &Vector3::zeros(), &Vector3::zeros()), "a gap");
        assert!(!w.is_running());
    }

    #[test]
    fn an_axis_that_is_no_longer_measured_is_no_longer_injected() {
        let mut w = predictor(Span::from_millis(100), Span::from_millis(300));
        w.reset(at(0), &Vector3::zeros(), &Vector3::zeros());
        let e = w.innovation(&FixSample::position(at(0), &Vector3::zeros())).unwrap();
        w.apply(&e);
        for k in 1..=30 {
            w.propagate(at(10 * k), &Vector3::zeros(), &Vector3::zeros());
            assert!(w.signal().is_some());
        }
        w.propagate(at(310), &Vector3::zeros(), &Vector3::zeros());
        assert!(w.signal().is_none());
    }
}
