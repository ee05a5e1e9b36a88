//! What the vehicle was seen to accelerate by, against what its inertia tells: the witness of the IMU whose velocities are horizontal (for the other see
//! [`super::vertical_witness`]).
//!
//! Over a window from one velocity to another a witness (GNSS) tells Δv_W and the accelerometers, turned to NED, Δv_I. A tilt that
//! is off by φ makes them differ by g sin φ Δt, an accelerometer of the wrong sign by twice what it should tell. A heading that is off does, too, but then a turn
//! makes them fit, and it is somebody else's business: what is left is
//! Σ|Δv_W|² + Σ|Δv_I|² − 2 |Σ conj(Δv_I) Δv_W| (as complex numbers).
//!
//! What a witness is apart from a sound IMU, differs by a factor of ten from flight to flight (its noise, its latency, air, vibration), and is learned: its
//! running mean m. A window contradicts when it is apart by more than five times that, more than the motion in it can explain, and more than [`LEAST_MPS2`].
//! One window proves nothing: receivers jump. Inertia is wrong when [`MOST_OF`] of the last [`WINDOWS`] windows contradict it: a receiver that did so would have
//! to run away.

use nalgebra::{Matrix2, Vector2};

use super::heading_witness::Turn;
use crate::navigator::tuning::heading_witness::{LONGEST_S, SHORTEST_S};
use crate::navigator::tuning::inertia_witness::{
    EXPLAINED, FASTEST_MPS2, LEAST_MPS2, MEMORY_S, MOST_OF, STRAYS_M, TIMES_USUAL, UNKNOWN_MPS2,
    UNUSUAL_GAIN, USUAL_GAIN, USUAL_WINDOWS, WINDOWS,
};
use crate::time::AutopilotTime;

/// A window: when it ended, how long it was, s, and the changes of the velocity, m/s.
#[derive(Clone, Copy, Debug)]
struct MotionWindow {
    end: AutopilotTime,
    seconds: f64,
    seen: Vector2<f64>,
    felt: Vector2<f64>,
}

impl MotionWindow {
    /// m/s².
    fn apart(&self) -> f64 {
        (self.seen - self.felt).norm() / self.seconds
    }

    /// Whether it contradicts where `limit` is usual, m/s²: by more than latency and scale make of the motion itself.
    fn contradicts(&self, limit: f64) -> bool {
        let moves = self.seen.norm().max(self.felt.norm()) / self.seconds;
        self.apart() > limit.max(EXPLAINED * moves)
    }
}

/// What the last windows say.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(in super::super) enum Testimony {
    /// Too few windows, or too old.
    Nothing,
    /// None contradicts.
    Agrees,
    /// Some do.
    Doubts,
    /// Most do.
    Contradicts,
    /// Most do, and a turn of the heading would make them fit.
    Turned(Turn),
}

/// What `apart` of so many windows say that contradict, where there have to be `least` and `most_of` of them.
pub(super) fn weigh(windows: usize, apart: usize, (least, most_of): (usize, usize)) -> Testimony {
    match apart {
        _ if windows < least => Testimony::Nothing,
        0 => Testimony::Agrees,
        n if n < most_of => Testimony::Doubts,
        _ => Testimony::Contradicts,
    }
}

/// What a witness sees at a time, NE, m and m/s, and the integral of the inertial acceleration, m/s.
#[derive(Clone, Copy, Debug)]
pub(in super::super) struct SeenMotion {
    pub(in super::super) time: AutopilotTime,
    pub(in super::super) position: Vector2<f64>,
    pub(in super::super) velocity: Vector2<f64>,
    pub(in super::super) impulse: Vector2<f64>,
}

/// What a witness is apart from a sound IMU, in the mean, m/s².
#[derive(Clone, Copy, Debug, Default)]
pub(super) struct UsualMisfit {
    mean: f64,
    windows: u32,
}

impl UsualMisfit {
    pub(super) fn learn(&mut self, apart: f64) {
        // What contradicts is not usual; if it goes on for minutes, it is.
        let gain = if apart > self.limit() { UNUSUAL_GAIN } else { USUAL_GAIN };
        self.windows = self.windows.saturating_add(1);
        self.mean += (apart.min(self.limit()) - self.mean) * (1.0 / f64::from(self.windows)).max(gain);
    }

    /// Beyond this a window contradicts, m/s².
    pub(super) fn limit(&self) -> f64 {
        if self.windows < USUAL_WINDOWS { UNKNOWN_MPS2 } else { (TIMES_USUAL * self.mean).max(LEAST_MPS2) }
    }
}

/// Velocities seen by one witness.
#[derive(Clone, Copy, Debug, Default)]
pub(in super::super) struct HorizontalWitness {
    /// Where the window that goes on began, and what was seen last.
    began: Option<SeenMotion>,
    last: Option<SeenMotion>,
    /// ∫ of the velocity since it began, m.
    travelled: Vector2<f64>,
    windows: [Option<MotionWindow>; WINDOWS],
    next: usize,
    usual: UsualMisfit,
}

impl HorizontalWitness {
    /// What is seen. A witness that contradicts itself is none: it begins anew.
    /// By how much the velocity changed in the window that ends with it, m/s.
    pub(in super::super) fn observe(&mut self, seen: SeenMotion) -> Option<f64> {
        let (Some(began), Some(last)) = (self.began, self.last.replace(seen)) else {
            self.began = Some(seen);
            return None;
        };
        let step = seen.time.seconds_since(last.time);
        self.travelled += (seen.velocity + last.velocity) * (0.5 * step);
        let seconds = seen.time.seconds_since(began.time);
        if (0.0..SHORTEST_S).contains(&seconds) {
            return None;
        }
        let change = seen.velocity - began.velocity;
        let strays = (seen.position - began.position - self.travelled).norm() > STRAYS_M;
        (self.began, self.travelled) = (Some(seen), Vector2::zeros());
        if !(SHORTEST_S..=LONGEST_S).contains(&seconds) {
            return None;
        }
        if strays || change.norm() > FASTEST_MPS2 * seconds {
            self.windows = [None; WINDOWS];
            return None;
        }
        let felt = seen.impulse - began.impulse;
        let window = MotionWindow { end: seen.time, seconds, seen: change, felt };
        self.usual.learn(window.apart());
        self.windows[self.next] = Some(window);
        self.next = (self.next + 1) % WINDOWS;
        Some(change.norm())
    }

    /// What was felt so far does not belong to what will be; what is usual is usual still.
    pub(in super::super) fn forget(&mut self) {
        *self = Self { usual: self.usual, ..Self::default() };
    }

    /// Beyond this a window contradicts, m/s².
    pub(in super::super) fn limit(&self) -> f64 {
        self.usual.limit()
    }

    /// What it says at `now`.
    pub(in super::super) fn testimony(&self, now: AutopilotTime) -> Testimony {
        let fresh =
            || self.windows.iter().flatten().filter(|w| (0.0..MEMORY_S).contains(&now.seconds_since(w.end)));
        // A receiver whose velocity stands still to the last digit sees nothing.
        if fresh().all(|w| w.seen == Vector2::zeros()) {
            return Testimony::Nothing;
        }
        let limit = self.usual.limit();
        let apart = fresh().filter(|w| w.contradicts(limit)).count();
        let said = weigh(fresh().count(), apart, (WINDOWS, MOST_OF));
        if said != Testimony::Contradicts {
            return said;
        }
        let (mut sum, mut felt, mut dot, mut cross, mut allowed) = (0.0, 0.0, 0.0, 0.0, 0.0);
        for w in fresh() {
            felt += w.felt.norm_squared();
            sum += w.seen.norm_squared() + w.felt.norm_squared();
            dot += w.felt.dot(&w.seen);
            cross += Matrix2::from_columns(&[w.felt, w.seen]).determinant();
            allowed += (limit * w.seconds).powi(2);
        }
        let left = (sum - 2.0 * f64::hypot(dot, cross)).max(0.0);
        if left > allowed {
            return said;
        }
        let sigma = (left / (2.0 * WINDOWS as f64 - 1.0) / felt).sqrt();
        Testimony::Turned(Turn { angle: cross.atan2(dot), sigma })
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn at(s: f64) -> AutopilotTime {
        AutopilotTime::from_micros((s * 1e6).round() as i64)
    }

    fn velocity(t: f64) -> Vector2<f64> {
        Vector2::new((0.5 * t).sin(), (0.9 * t).cos()) * 4.0
    }

    fn horizontal(felt: impl Fn(f64) -> Vector2<f64>, seen: impl Fn(f64) -> Vector2<f64>) -> Testimony {
        let (mut w, mut position) = (HorizontalWitness::default(), Vector2::zeros());
        for k in 0..100 {
            let t = f64::from(k) * 0.2;
            let (velocity, impulse) = (seen(t), felt(t));
            w.observe(SeenMotion { time: at(t), position, velocity, impulse });
            position += (velocity + seen(t + 0.2)) * 0.1;
        }
        w.testimony(at(19.8))
    }

    #[test]
    fn a_tilt_contradicts_a_turn_and_a_jump_do_not() {
        let tilted = |t: f64| velocity(t) + Vector2::new(4.0, 0.0) * t;
        assert_eq!(horizontal(velocity, velocity), Testimony::Agrees);
        assert_eq!(horizontal(tilted, velocity), Testimony::Contradicts);
        let turned = |t: f64| nalgebra::Rotation2::new(2.0) * velocity(t);
        let Testimony::Turned(turn) = horizontal(turned, velocity) else { panic!("a turn explains it") };
        assert!((turn.angle + 2.0).abs() < 0.05, "{turn:?}");
        let jumped = |t: f64| velocity(t) + Vector2::new(if t > 18.0 { 20.0 } else { 0.0 }, 0.0);
        assert_ne!(horizontal(velocity, jumped), Testimony::Contradicts);
        let wild = |t: f64| velocity(t) + Vector2::new(25.0 * (5.0 * t).sin(), 0.0);
        assert_ne!(horizontal(velocity, wild), Testimony::Contradicts, "a receiver that is lost");
        assert_eq!(horizontal(tilted, |_| Vector2::zeros()), Testimony::Nothing, "frozen");
    }
}
