//! What if something that is taken for constant jumped some seconds ago? A bank of onset times, each with the filter's sensitivity to a jump then.
//!
//! A gyro that has a bias all of a sudden, an accelerometer, or a scale, is a jump f of one error state s at an onset θ. A linear filter that
//! does not know of it errs by J f,
//!
//! J(θ) = e_s,  J ← Φ J,  r = H J,  J ← J − K r,
//!
//! where r f is what the jump adds to an innovation ν of variance S. With the sums over the innovations since, C = Σ r²/S and d = Σ r ν/S, the most likely
//! size is f̂ = d/C, known to 1/C (with a prior of σ², C + 1/σ² takes the place of C), and d²/C is χ² with one degree of freedom where nothing jumped: the generalised likelihood ratio of Willsky and Jones
//! (IEEE TAC 21, 1976). x̂ + J f̂ with P + J Jᵀ/C is what the filter would hold had it had the state open since θ (Friedland's separation,
//! IEEE TAC 14, 1969). Every measurement that the filter takes testifies, and those that it gates out as well.
//!
//! Not only the IMU may have changed: what magnetometer, flow or a receiver's velocity could have changed explains the same innovations better or worse.
//!
//! J follows the motion in steps of a tenth of a second, in single precision and jump beside jump: what it is for, is a test.

use std::ops::Range;

use nalgebra::{SVector, Vector2};

use super::covariance::{ErrorTransition, Phi, SparseRow};
use super::tuning::{
    IMPLAUSIBLE_SIGMAS, JUMP_EVERY, JUMP_SPACING_S, JUMP_STEP_S, JUMP_WINDOWS, OUTLIER_SIGMAS,
};
use super::{BA, BG, BM, FLOW, P, SG, STATES, V, WIND};

/// What may jump: gyro biases, accelerometer biases and gyro scales of the IMU's axes, and then the IMU's rivals: magnetometer bias x and y, flow
/// (bias x, y, scale), climb, height, wind, a compass that is turned about the body's z axis, and the velocity, north and east, of a receiver whose positions
/// walk off with it.
pub const JUMPS: usize = 21;
/// Those of the IMU.
pub const IMU_JUMPS: Range<usize> = 0..9;
/// Those of a flow sensor.
pub const FLOW_JUMPS: Range<usize> = 11..14;
/// Odds of every jump of every window: a row a window.
pub type JumpOdds = [[f64; JUMPS]; JUMP_WINDOWS];

/// The last are no error states, but show in what their own sensor tells alone: r = H J + ∂m/∂ψ of a magnetometer, and H J + 1 of a receiver's velocity, H J + (t − θ)
/// of its position.
const COMPASS: usize = 18;
const RECEIVER: usize = COMPASS + 1;
/// Those of a receiver: both together are one lie.
pub const RECEIVER_JUMPS: Range<usize> = RECEIVER..JUMPS;

const AT: [usize; COMPASS] = [
    BG,
    BG + 1,
    BG + 2,
    BA,
    BA + 1,
    BA + 2,
    SG,
    SG + 1,
    SG + 2,
    BM,
    BM + 1,
    FLOW,
    FLOW + 1,
    FLOW + 2,
    V + 2,
    P + 2,
    WIND,
    WIND + 1,
];

/// How large such jumps are, 1 sigma: rad/s, m/s², a scale that turns round, µT, rad/s, flow's scale, m/s, m, rad.
const PRIOR: [f64; JUMPS] = [
    0.1, 0.1, 0.1, 2.0, 2.0, 2.0, 1.0, 1.0, 1.0, 20.0, 20.0, 0.1, 0.1, 1.0, 3.0, 10.0, 5.0, 5.0, 0.5, 3.0,
    3.0,
];

/// What is measured, and how a change of the sensor itself shows in it.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) enum MeasuredScalar {
    /// By a sensor whose changes are error states, or none.
    Other,
    Flow,
    /// A magnetic field that a turn of the compass changes by this, µT/rad.
    Magnetic(f64),
    /// A receiver's velocity or position, along north (0) or east (1).
    Velocity(usize),
    Position(usize),
}

/// The hypothesis that one state jumped at a window's beginning.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct JumpFit {
    /// d²/C over the mean square of what the jump leaves of the innovations, where that is more than noise: twice the log-likelihood ratio against
    /// "nothing jumped".
    pub square: f64,
    /// f̂, in the state's unit.
    pub size: f64,
}

/// Sums over innovations.
#[derive(Clone, Copy, Debug)]
struct JumpSums {
    /// C and d.
    information: [f64; JUMPS],
    evidence: [f64; JUMPS],
    /// Σν²/S and the number of innovations.
    square: f64,
    scalars: f64,
}

impl JumpSums {
    const NONE: Self = Self { information: [0.0; JUMPS], evidence: [0.0; JUMPS], square: 0.0, scalars: 0.0 };

    fn add(&mut self, r: &[f32; JUMPS], innovation: f64, s: f64) {
        let (by_variance, weighed) = (1.0 / s, innovation / s);
        self.square += innovation * weighed;
        self.scalars += 1.0;
        for ((r, c), d) in r.iter().zip(&mut self.information).zip(&mut self.evidence) {
            let r = f64::from(*r);
            *c += r * r * by_variance;
            *d += r * weighed;
        }
    }

    fn fit(&self, jump: usize) -> Option<JumpFit> {
        let (c, d) = (self.information.get(jump)?, self.evidence.get(jump)?);
        (*c > 0.0).then(|| {
            let size = d / self.known(jump);
            JumpFit { square: self.measured_by_the_rest(d * size), size }
        })
    }

    /// C + 1/σ².
    fn known(&self, jump: usize) -> f64 {
        self.information[jump] + 1.0 / (PRIOR[jump] * PRIOR[jump])
    }

    /// What is left of the innovations is noise that the filter does not know of, or another fault: a measure of what is explained.
    fn measured_by_the_rest(&self, square: f64) -> f64 {
        square / ((self.square - square) / self.scalars).max(1.0)
    }

    /// What jumps explain together that show in different innovations.
    fn together(&self, jumps: Range<usize>) -> f64 {
        self.measured_by_the_rest(jumps.map(|jump| self.evidence[jump].powi(2) / self.known(jump)).sum())
    }
}

/// What is known since one onset.
#[derive(Clone, Debug)]
pub struct JumpWindow {
    age_s: f64,
    /// J, a row a state.
    effect: [[f32; JUMPS]; STATES],
    /// Of all innovations, and of those that are not the flow's.
    all: JumpSums,
    without_flow: JumpSums,
    /// ∫ ‖ω‖² dt, rad²/s.
    turned_squared: f64,
}

impl JumpWindow {
    fn new() -> Self {
        let mut effect = [[0.0; JUMPS]; STATES];
        for (jump, at) in AT.iter().enumerate() {
            effect[*at][jump] = 1.0;
        }
        let (all, without_flow) = (JumpSums::NONE, JumpSums::NONE);
        Self { age_s: 0.0, effect, all, without_flow, turned_squared: 0.0 }
    }

    /// How long ago it began, s.
    pub fn age_s(&self) -> f64 {
        self.age_s
    }

    /// Mean square of the angular rate since, (rad/s)².
    pub fn mean_square_rate(&self) -> f64 {
        self.turned_squared / self.age_s.max(1e-3)
    }

    /// What it shows of a jump; `None` where nothing was measured that would show it.
    pub fn fit(&self, jump: usize) -> Option<JumpFit> {
        self.all.fit(jump)
    }

    /// What a receiver's lie explains in whatever direction it leads, in the unit of [`JumpFit::square`].
    pub fn explained_by_receiver(&self) -> f64 {
        self.all.together(RECEIVER_JUMPS)
    }

    /// What a receiver's velocity is wrong by, if it lies, NE, m/s.
    pub fn receiver_step(&self) -> Vector2<f64> {
        Vector2::from_fn(|axis, _| self.fit(RECEIVER + axis).map_or(0.0, |fit| fit.size))
    }

    /// Whether a jump is so large that it is none that sensors of this kind make.
    pub fn is_implausible(&self, jump: usize) -> bool {
        self.fit(jump).is_some_and(|fit| fit.size.abs() > IMPLAUSIBLE_SIGMAS * PRIOR[jump])
    }

    /// The same without the flow's word.
    pub fn fit_without_flow(&self, jump: usize) -> Option<JumpFit> {
        self.without_flow.fit(jump)
    }

    /// How far a jump that happened would move the horizontal position and velocity, NE, m and m/s.
    pub fn moves(&self, jump: usize) -> Option<[Vector2<f64>; 2]> {
        let size = self.fit(jump)?.size;
        let by = |at: usize| Vector2::from_fn(|i, _| f64::from(self.effect[at + i][jump])) * size;
        Some([by(P), by(V)])
    }

    /// J of a jump, and the variance of its size, 1/(C + 1/σ²).
    pub(super) fn effect(&self, jump: usize) -> (SVector<f64, STATES>, f64) {
        let effect = SVector::from_fn(|i, _| f64::from(self.effect[i][jump]));
        (effect, 1.0 / (self.all.information[jump] + 1.0 / (PRIOR[jump] * PRIOR[jump])))
    }

    fn propagate(&mut self, by: &ErrorTransition, phi: &Phi) {
        self.age_s += by.dt;
        self.turned_squared += by.rate_squared();
        let moved = phi.times_side_by_side(&self.effect);
        for (row, moved) in self.effect.iter_mut().zip(moved) {
            *row = moved;
        }
    }

    fn observe(
        &mut self,
        h: &SparseRow,
        (innovation, s): (f64, f64),
        gain: Option<&[f32; STATES]>,
        measured: MeasuredScalar,
    ) {
        let mut r = [0.0f32; JUMPS];
        match measured {
            MeasuredScalar::Other | MeasuredScalar::Flow => {}
            MeasuredScalar::Magnetic(by_turn) => r[COMPASS] = by_turn as f32,
            MeasuredScalar::Velocity(axis) => r[RECEIVER + axis.min(1)] = 1.0,
            MeasuredScalar::Position(axis) => r[RECEIVER + axis.min(1)] = self.age_s as f32,
        }
        for (i, h) in h.entries() {
            let (row, h) = (&self.effect[i], h as f32);
            for (r, effect) in r.iter_mut().zip(row) {
                *r += h * effect;
            }
        }
        self.all.add(&r, innovation, s);
        if measured != MeasuredScalar::Flow {
            self.without_flow.add(&r, innovation, s);
        }
        let Some(gain) = gain else { return };
        for (row, k) in self.effect.iter_mut().zip(gain) {
            for (effect, r) in row.iter_mut().zip(&r) {
                *effect -= k * r;
            }
        }
    }
}

/// See the module's documentation.
#[derive(Clone, Debug)]
pub(super) struct JumpBank {
    /// A filter that nobody asks spares itself the sums.
    on: bool,
    /// The newest first. Each takes over from the one before every so many spacings, so that onsets of late lie close together and earlier ones farther apart.
    windows: [JumpWindow; JUMP_WINDOWS],
    /// The last that was the oldest.
    gone: Option<JumpWindow>,
    /// How many were begun, and for how long the newest has gone on, s.
    begun: u32,
    since_s: f64,
    /// What is measured next.
    pub(super) measured: MeasuredScalar,
    /// What J has not followed yet.
    pending: Option<ErrorTransition>,
}

impl JumpBank {
    pub(super) fn new(on: bool) -> Self {
        Self {
            on,
            windows: std::array::from_fn(|_| JumpWindow::new()),
            gone: None,
            begun: 0,
            since_s: 0.0,
            measured: MeasuredScalar::Other,
            pending: None,
        }
    }

    pub(super) fn windows(&self) -> &[JumpWindow] {
        if self.on { &self.windows } else { &[] }
    }

    /// See [`super::Eskf::take_gone_jumps`].
    pub(super) fn take_gone(&mut self) -> Option<JumpWindow> {
        self.gone.take()
    }

    /// What happened until now has nothing to do with what comes.
    pub(super) fn forget(&mut self) {
        if self.on {
            *self = Self::new(true);
        }
    }

    /// The error has moved by this.
    pub(super) fn propagate(&mut self, transition: &ErrorTransition) {
        if !self.on {
            return;
        }
        let pending = match &mut self.pending {
            Some(pending) => pending,
            none => none.insert(ErrorTransition::new(*transition.start())),
        };
        pending.append(transition);
        if pending.dt >= JUMP_STEP_S {
            self.catch_up();
            if self.since_s > JUMP_SPACING_S {
                self.since_s = 0.0;
                self.begin();
            }
        }
    }

    /// A new onset.
    fn begin(&mut self) {
        self.begun = self.begun.wrapping_add(1);
        let stays = JUMP_EVERY.iter().take_while(|every| self.begun.is_multiple_of(**every)).count();
        self.windows[..stays].rotate_right(1);
        if stays == JUMP_WINDOWS {
            self.gone = Some(self.windows[0].clone());
        }
        self.windows[0] = JumpWindow::new();
    }

    /// J follows what has been; the windows stay which they are.
    pub(super) fn catch_up(&mut self) {
        let Some(pending) = self.pending.take() else { return };
        let phi = pending.phi();
        self.since_s += pending.dt;
        for window in &mut self.windows {
            window.propagate(&pending, &phi);
        }
    }

    /// An innovation of variance `s`, whether it is fused (with K = P hᵀ/s) or not.
    pub(super) fn observe(
        &mut self,
        h: &SparseRow,
        innovation: f64,
        s: f64,
        ph: Option<&SVector<f64, STATES>>,
    ) {
        if !self.on || !(innovation / s).is_finite() {
            return;
        }
        // What is far out may be a single outlier: it counts no more than one.
        let innovation = innovation.clamp(-OUTLIER_SIGMAS * s.sqrt(), OUTLIER_SIGMAS * s.sqrt());
        let gain = ph.map(|ph| std::array::from_fn(|i| (ph[i] / s) as f32));
        for window in &mut self.windows {
            window.observe(h, (innovation, s), gain.as_ref(), self.measured);
        }
    }
}

#[cfg(test)]
mod tests {
    use super::super::tests::silent;
    use super::super::{Eskf, EskfSettings, EskfState, Lag, StartSigma};
    use super::*;
    use nalgebra::{Matrix4, Vector3};
    use rand::{RngExt, SeedableRng};

    const GRAVITY: Vector3<f64> = Vector3::new(0.0, 0.0, 9.81);
    /// The onset of a jump, s.
    const FROM_S: f64 = 30.0;

    /// A level vehicle that stands, with positions of 0.5 m and a heading of 0.03 rad five times a second; `gyro`, `accel`: what its IMU shows wrongly since
    /// [`FROM_S`]. The filter `seconds` later.
    fn fly(seed: u64, gyro: Vector3<f64>, accel: Vector3<f64>, seconds: f64) -> Eskf {
        let mut rng = rand_chacha::ChaCha8Rng::seed_from_u64(seed);
        let mut normal = || {
            let (u, v): (f64, f64) = (rng.random_range(1e-12..1.0), rng.random_range(0.0..1.0));
            (-2.0 * u.ln()).sqrt() * (std::f64::consts::TAU * v).cos()
        };
        let settings = EskfSettings {
            gyro_noise: 1e-3,
            accel_noise: 1e-2,
            gyro_bias_walk: 1e-5,
            accel_bias_walk: 1e-4,
            ..silent()
        };
        let zero = Vector3::zeros();
        let state = EskfState::moving(nalgebra::Matrix3::identity(), zero, zero, zero);
        let sigma = StartSigma {
            attitude_body: Vector3::repeat(0.01),
            position_ned: Vector3::repeat(0.5),
            velocity_ned: Vector3::repeat(0.1),
            gyro_bias: Vector3::repeat(1e-3),
            accel_bias: Vector3::repeat(0.05),
            flow: Matrix4::zeros(),
        };
        let mut filter = Eskf::new(settings, state, &sigma);
        filter.watch_for_jumps(true);
        let dt = 0.01;
        for k in 0..((FROM_S + seconds) / dt) as u32 {
            let wrong = f64::from(u8::from(f64::from(k) * dt >= FROM_S));
            let mut noise = |density: f64| Vector3::from_fn(|_, _| normal() * density / f64::sqrt(dt));
            let (rate, force) = (gyro * wrong + noise(1e-3), accel * wrong - GRAVITY + noise(1e-2));
            filter.predict(dt, &rate, &force, &GRAVITY, &Vector3::zeros());
            if k % 20 == 0 {
                for axis in 0..3 {
                    let innovation = normal() * 0.5 - filter.state().position_ned[axis];
                    let _ = filter.fuse_position(axis, innovation, 0.25, &Lag::NONE);
                }
                let r = filter.state().r_body_to_ned;
                let heading = normal() * 0.03 - r[(1, 0)].atan2(r[(0, 0)]);
                let _ = filter.fuse_heading(heading, 9e-4);
            }
        }
        filter
    }

    /// The same vehicle with fixes five times a second, whose receiver lies since [`FROM_S`] by `lie`, m/s, north and east, with its positions; and `gyro`, what
    /// its gyros show wrongly since.
    fn follow(lie: Vector2<f64>, gyro: f64, seconds: f64) -> Eskf {
        let mut filter = fly(3, Vector3::zeros(), Vector3::zeros(), 0.0);
        let noise = |k: u32, of: u32| f64::from((k * of) % 61) / 30.0 - 1.0;
        for k in 0..(seconds * 100.0) as u32 {
            let rate =
                Vector3::new(noise(k, 7919), noise(k, 104_729), noise(k, 31)) * 1e-2 + Vector3::x() * gyro;
            filter.predict(0.01, &rate, &-GRAVITY, &GRAVITY, &Vector3::zeros());
            if k % 20 == 0 {
                let s = *filter.state();
                let place = lie * (f64::from(k) * 0.01) + Vector2::new(noise(k, 13), noise(k, 17)) * 0.3;
                let speed = lie + Vector2::new(noise(k, 19), noise(k, 23)) * 0.05;
                let errors = (place - s.position_ned.xy(), speed - s.velocity_ned.xy());
                let _ = filter.fuse_fix(&errors.0, Some(&errors.1), [0.25, 0.01], &Lag::NONE);
            }
        }
        filter
    }

    #[test]
    fn a_receiver_that_lies_is_told_from_an_axis_and_what_it_led_to_is_taken_back() {
        let best = |filter: &Eskf| {
            let windows = filter.jump_windows().iter().enumerate().filter(|(_, w)| w.age_s() > 1.0);
            let most = |a: &(usize, &JumpWindow), b: &(usize, &JumpWindow)| {
                a.1.explained_by_receiver().total_cmp(&b.1.explained_by_receiver())
            };
            let (number, window) = windows.max_by(most).unwrap();
            (number, window.explained_by_receiver(), window.receiver_step())
        };
        let lie = Vector2::new(1.2, -0.8);
        let mut lied = follow(lie, 0.0, 3.0);
        let (window, square, step) = best(&lied);
        let (_, _, axis) = likeliest(&lied);
        assert!(square > 1.5 * axis.square + 20.0, "{square} {axis:?}");
        assert!((step - lie).norm() < 0.5 * lie.norm(), "{step:?}");
        let led = lied.state().position_ned.xy().norm();
        assert!(lied.believe_receiver_lies(window).is_some() && lied.believe_receiver_lies(9).is_none());
        let left = lied.state().position_ned.xy().norm();
        assert!(led > 1.0 && left < 0.5 * led, "{led} {left}");
        // A gyro leads away as well, and is none of the receiver's.
        let wrong = follow(Vector2::zeros(), 0.05, 3.0);
        let (_, square, _) = best(&wrong);
        let (_, jump, axis) = likeliest(&wrong);
        // For a level vehicle an accelerometer tilts alike.
        assert!([0, 4].contains(&jump) && axis.square > square + 9.2, "{jump} {axis:?} {square}");
    }

    /// The window and jump of the IMU's that explain most.
    fn likeliest(filter: &Eskf) -> (usize, usize, JumpFit) {
        let windows = filter.jump_windows().iter().enumerate().filter(|(_, w)| w.age_s() > 1.0);
        let fits = windows.flat_map(|(n, w)| (0..6).filter_map(move |jump| Some((n, jump, w.fit(jump)?))));
        fits.max_by(|a, b| a.2.square.total_cmp(&b.2.square)).unwrap()
    }

    #[test]
    fn where_nothing_jumps_what_a_jump_explains_is_the_square_of_a_normal_deviation() {
        let (mut sum, mut n) = (0.0, 0.0);
        for seed in 0..40 {
            let filter = fly(seed, Vector3::zeros(), Vector3::zeros(), 0.0);
            let oldest = filter.jump_windows().iter().max_by(|a, b| a.age_s().total_cmp(&b.age_s())).unwrap();
            for jump in 0..6 {
                sum += oldest.fit(jump).unwrap().square;
                n += 1.0;
            }
        }
        assert!((sum / n - 1.0f64).abs() < 0.35, "{}", sum / n);
    }

    #[test]
    fn a_jump_is_found_on_its_axis_and_the_filter_goes_on_as_if_it_had_known() {
        let axes = [Vector3::x(), Vector3::y(), Vector3::z()];
        for (jump, size, seconds) in
            [(0, 0.03, 6.0), (1, -0.03, 6.0), (2, 0.05, 4.0), (3, 1.0, 4.0), (5, -1.0, 4.0)]
        {
            let wrong = axes[jump % 3] * size;
            let (gyro, accel) = if jump < 3 { (wrong, Vector3::zeros()) } else { (Vector3::zeros(), wrong) };
            let mut filter = fly(7, gyro, accel, seconds);
            let (window, found, fit) = likeliest(&filter);
            // For a vehicle at rest a level accelerometer and the gyro across it tilt alike.
            let alike = [(0, 4), (1, 3), (3, 1)].contains(&(jump, found));
            assert!(fit.square > 40.0 && (found == jump || alike), "{jump}: {found} {fit:?}");
            let before = *filter.state();
            let mut odds = JumpOdds::default();
            odds[window][found] = 1.0;
            filter.believe_jumps(&odds);
            let after = *filter.state();
            if found == jump {
                let bias = |s: &EskfState| if jump < 3 { s.gyro_bias } else { s.accel_bias }[jump % 3];
                let off = |s: &EskfState| (bias(s) - size).abs();
                assert!(off(&after) < 0.8 * off(&before), "{jump}: {} {}", off(&before), off(&after));
            }
            assert!(after.position_ned.norm() < 0.6 * before.position_ned.norm() + 0.5, "{jump}");
            assert!(filter.jump_windows().iter().all(|w| w.age_s() == 0.0), "what was is explained");
        }
    }
}
