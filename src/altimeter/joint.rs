//! One Kalman filter for the height from the vertical specific force and up to four height channels.
//!
//! The baro-inertial and the inertial-GPS channel of Contreras and Hajiyev, (11)-(13) and (16)-(18), share one inertial error: fused as
//! independent by (19)(20) they are overconfident, so here they are rows of one filter. In its direct form (h = H_I − ΔH), with the
//! upward acceleration u = −(R f + g)_D:
//!
//! ḣ = w,  ẇ = u − a + κ h,  ȧ = −α a + noise,  ȯ_c = −β_c o_c + noise,  ḟ_c = 0
//!
//! y_c = h + o_c + f_c + v_c
//!
//! for the channels c = barometer, GNSS, second barometer, rangefinder. a is the sum of the paper's Δa and Δg; o_c is what a channel's
//! height is off by anyway (the barometer's bias B, (2); a receiver's slow wander; the ground under the beam); f_c is a fault's bias,
//! known to be zero until a fault is declared. The last two channels have no f of their own: nothing is known of their offset, a
//! fault is a jump of it. κ = 2g/R_I couples the height into the gravity that an inertial altimeter computes; 0 where gravity is computed
//! at the place itself.

use nalgebra::{SMatrix, SVector};
use strum::IntoStaticStr;

/// Number of states: h, w, a, four offsets, two fault biases.
pub(super) const STATES: usize = 9;
pub(super) type State = SVector<f64, STATES>;
pub(super) type Covariance = SMatrix<f64, STATES, STATES>;

/// The states by name; offsets and fault biases are found by [`Channel`].
pub(super) const HEIGHT: usize = 0;
pub(super) const CLIMB: usize = 1;
pub(super) const ACCEL_BIAS: usize = 2;
const OFFSETS: usize = 3;
const FAULTS: usize = 7;

/// A source of heights.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash, PartialOrd, Ord, IntoStaticStr)]
pub enum Channel {
    /// The barometer's pressure altitude.
    #[strum(serialize = "barometer")]
    Baro,
    /// The height of a GNSS fix.
    #[strum(serialize = "GNSS height")]
    Gnss,
    /// Another barometer.
    #[strum(serialize = "second barometer")]
    SecondBaro,
    /// The height over ground of a rangefinder.
    #[strum(serialize = "rangefinder")]
    Range,
}

impl Channel {
    /// All of them, by their index.
    pub const ALL: [Channel; 4] = [Channel::Baro, Channel::Gnss, Channel::SecondBaro, Channel::Range];

    /// Its index in [`Channel::ALL`].
    pub const fn index(self) -> usize {
        self as usize
    }

    /// What it is, for people.
    pub fn label(self) -> &'static str {
        self.into()
    }

    /// The state that is this channel's offset.
    pub(super) const fn offset(self) -> usize {
        OFFSETS + self.index()
    }

    /// The state that a bias fault of this channel jumps.
    pub(super) const fn fault(self) -> usize {
        match self {
            Channel::Baro | Channel::Gnss => FAULTS + self.index(),
            Channel::SecondBaro | Channel::Range => self.offset(),
        }
    }

    /// Whether its fault bias is zero when it is healthy, so that its health tells the height.
    pub(super) const fn is_absolute(self) -> bool {
        matches!(self, Channel::Baro | Channel::Gnss)
    }
}

/// How the offset of a channel behaves.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct OffsetModel {
    /// Standard deviation before anything is known, m.
    pub sigma_m: f64,
    /// Random walk, m/√s.
    pub walk: f64,
    /// Inverse correlation time, 1/s: 0 for a random walk.
    pub rate: f64,
}

/// The inertial part of the model.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct InertialModel {
    /// Noise density of the vertical acceleration, m/s²/√Hz.
    pub accel_noise: f64,
    /// Standard deviation of its bias before anything is known, m/s².
    pub accel_bias_sigma: f64,
    /// Random walk of the bias, m/s³/√Hz.
    pub accel_bias_walk: f64,
    /// Inverse correlation time of the bias, 1/s.
    pub accel_bias_rate: f64,
    /// Standard deviations of height and climb rate at the start, m and m/s.
    pub start_sigma: [f64; 2],
    /// κ, 1/s².
    pub gravity_gradient: f64,
}

/// What becomes of a height and its climb rate while nobody measures anything, not even the acceleration.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct UnseenClimb {
    /// What is left of the climb rate, 0 to 1.
    pub kept: f64,
    /// How far it has led, s of it.
    pub way_s: f64,
    /// What that may be off by: standard deviations of height and climb rate, m and m/s, and their covariance, m²/s.
    pub height_m: f64,
    /// See there.
    pub climb_mps: f64,
    /// See there.
    pub both: f64,
}

/// State and covariance.
#[derive(Clone, Debug)]
pub(super) struct Joint {
    pub(super) x: State,
    pub(super) p: Covariance,
    inertial: InertialModel,
    offsets: [OffsetModel; 4],
}

/// A scalar measurement against the prediction.
#[derive(Clone, Copy, Debug)]
pub(super) struct HeightInnovation {
    /// y − H x, m.
    pub(super) value: f64,
    /// Its variance S = H P Hᵀ + R, m².
    pub(super) variance: f64,
    /// P Hᵀ.
    pub(super) ph: State,
}

/// How states move over an interval: what the prediction and every sensitivity to a jump share.
#[derive(Clone, Copy, Debug)]
pub(super) struct HeightTransition {
    dt: f64,
    kappa_dt: f64,
    keep_bias: f64,
    keep_offset: [f64; 4],
}

impl HeightTransition {
    /// x ← Φ x, without the input.
    pub(super) fn apply(&self, x: &mut [f64; STATES]) {
        let (h, w, a) = (x[HEIGHT], x[CLIMB], x[ACCEL_BIAS]);
        x[HEIGHT] = h + self.dt * (w - 0.5 * self.dt * a);
        x[CLIMB] = w + self.kappa_dt * h - self.dt * a;
        x[ACCEL_BIAS] = a * self.keep_bias;
        for c in 0..4 {
            x[OFFSETS + c] *= self.keep_offset[c];
        }
    }
}

impl Joint {
    pub(super) fn new(inertial: InertialModel, offsets: [OffsetModel; 4]) -> Self {
        let mut sigma = State::zeros();
        sigma[HEIGHT] = inertial.start_sigma[0];
        sigma[CLIMB] = inertial.start_sigma[1];
        sigma[ACCEL_BIAS] = inertial.accel_bias_sigma;
        for c in 0..4 {
            sigma[OFFSETS + c] = offsets[c].sigma_m;
        }
        let p = Covariance::from_diagonal(&sigma.component_mul(&sigma));
        Self { x: State::zeros(), p, inertial, offsets }
    }

    pub(super) fn transition(&self, dt: f64) -> HeightTransition {
        let keep = |rate: f64| (1.0 - rate * dt).max(0.0);
        HeightTransition {
            dt,
            kappa_dt: self.inertial.gravity_gradient * dt,
            keep_bias: keep(self.inertial.accel_bias_rate),
            keep_offset: [0, 1, 2, 3].map(|c| keep(self.offsets[c].rate)),
        }
    }

    /// (23)(27) over the transition's interval, with the integrals of the upward acceleration over it: Δv = ∫u, Δh = ∫∫u.
    /// `noise` is the squared noise density of that acceleration beyond the model's.
    pub(super) fn predict(&mut self, phi: &HeightTransition, delta_v: f64, delta_h: f64, noise: f64) {
        phi.apply(self.x.as_mut_slice().try_into().unwrap_or(&mut [0.0; STATES]));
        self.x[HEIGHT] += delta_h;
        self.x[CLIMB] += delta_v;
        for column in self.p.data.0.iter_mut() {
            phi.apply(column);
        }
        // P is symmetric: the second pass goes over the rows of Φ P.
        let mut rows = self.p.transpose();
        for row in rows.data.0.iter_mut() {
            phi.apply(row);
        }
        // Updates keep what rounding makes of the symmetry, and the prediction lets it grow.
        for i in 1..STATES {
            for j in 0..i {
                let mean = 0.5 * (rows[(i, j)] + rows[(j, i)]);
                rows[(i, j)] = mean;
                rows[(j, i)] = mean;
            }
        }
        self.p = rows;
        let dt = phi.dt;
        let q = self.inertial.accel_noise * self.inertial.accel_noise + noise;
        self.p[(HEIGHT, HEIGHT)] += q * dt * dt * dt / 3.0;
        self.p[(HEIGHT, CLIMB)] += 0.5 * q * dt * dt;
        self.p[(CLIMB, HEIGHT)] += 0.5 * q * dt * dt;
        self.p[(CLIMB, CLIMB)] += q * dt;
        self.p[(ACCEL_BIAS, ACCEL_BIAS)] += self.inertial.accel_bias_walk.powi(2) * dt;
        for c in 0..4 {
            self.p[(OFFSETS + c, OFFSETS + c)] += self.offsets[c].walk.powi(2) * dt;
        }
    }

    /// Goes on for `gap_s` of which nothing is known: h ← h + T w, w ← k w. Offsets and the bias of the acceleration go on as they do, in closed
    /// form, x ← e^(−βt) x with the variance q²(1 − e^(−2βt))/2β. The bias moves nothing: there was no acceleration that it could be in.
    pub(super) fn unseen(&mut self, gap_s: f64, climb: &UnseenClimb) {
        let mut keep = [1.0; STATES];
        let InertialModel { accel_bias_rate, accel_bias_walk, .. } = self.inertial;
        let offsets = self.offsets.map(|o| (o.rate, o.walk));
        let all = [(accel_bias_rate, accel_bias_walk), offsets[0], offsets[1], offsets[2], offsets[3]];
        let walked = all.map(|(rate, walk)| {
            let part = if rate > 0.0 { -(-2.0 * rate * gap_s).exp_m1() / (2.0 * rate) } else { gap_s };
            walk * walk * part
        });
        for (i, (rate, _)) in all.iter().enumerate() {
            keep[ACCEL_BIAS + i] = (-rate * gap_s).exp();
        }
        keep[CLIMB] = climb.kept;
        let apply = |x: &mut [f64; STATES]| {
            x[HEIGHT] += climb.way_s * x[CLIMB];
            x.iter_mut().zip(keep).for_each(|(x, keep)| *x *= keep);
        };
        self.x.data.0.iter_mut().chain(&mut self.p.data.0).for_each(apply);
        let mut rows = self.p.transpose();
        rows.data.0.iter_mut().for_each(apply);
        self.p = 0.5 * (rows + rows.transpose());
        for (i, variance) in walked.into_iter().enumerate() {
            self.p[(ACCEL_BIAS + i, ACCEL_BIAS + i)] += variance;
        }
    }

    /// What a channel's height `y` says against the prediction, with its noise variance `r`.
    pub(super) fn innovation(&self, channel: Channel, y: f64, r: f64) -> HeightInnovation {
        let (o, f) = (channel.offset(), channel.fault());
        let mut value = y - self.x[HEIGHT] - self.x[o];
        let mut ph = self.p.column(HEIGHT) + self.p.column(o);
        if f != o {
            value -= self.x[f];
            ph += self.p.column(f);
        }
        let mut variance = ph[HEIGHT] + ph[o] + r;
        if f != o {
            variance += ph[f];
        }
        HeightInnovation { value, variance, ph }
    }

    /// (30)(31) with the consistent covariance, P ← (I − pKH)P(I − pKH)ᵀ + p²KRKᵀ = P − (2p − p²) K S Kᵀ. Returns the gain pK.
    pub(super) fn update(&mut self, innovation: &HeightInnovation, prob: f64) -> State {
        let gain = innovation.ph / innovation.variance;
        let taken = (2.0 - prob) * prob;
        self.x += gain * (prob * innovation.value);
        self.p.ger(-taken, &gain, &innovation.ph, 1.0);
        gain * prob
    }

    /// Takes for certain that a state is zero.
    pub(super) fn pin(&mut self, state: usize) {
        let variance = self.p[(state, state)];
        if variance > 0.0 {
            let column = self.p.column(state).into_owned();
            self.x -= column * (self.x[state] / variance);
            self.p.ger(-1.0 / variance, &column, &column, 1.0);
        }
        self.x[state] = 0.0;
        self.decorrelate(state, 0.0);
    }

    /// A state is known this well from now on, and has nothing to do with the others.
    pub(super) fn decorrelate(&mut self, state: usize, variance: f64) {
        self.p.row_mut(state).fill(0.0);
        self.p.column_mut(state).fill(0.0);
        self.p[(state, state)] = variance;
    }

    pub(super) fn sigma(&self, state: usize) -> f64 {
        self.p[(state, state)].max(0.0).sqrt()
    }
}

#[cfg(test)]
mod tests;
