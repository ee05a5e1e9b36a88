//! The covariance: propagated along with the motion, and reduced by scalar measurements.
//!
//! Between measurements it is propagated in steps of up to 20 ms, several IMU samples at once: the nominal state moves with every sample,
//! what the error moves by over the step is summed up in [`ErrorTransition`]. Only the rows of attitude, position and velocity change
//! (Φ differs from I in those alone), so that is all that is computed; the other half follows by symmetry.

use nalgebra::{Matrix3, RowVector3, SMatrix, SVector, Vector3};

use super::{BA, BG, BM, EskfSettings, FLOW, P, SG, STATES, THETA, V, WIND};
use crate::geo::so3::hat;

/// Symmetric, of the error state.
pub(super) type Covariance = SMatrix<f64, STATES, STATES>;
type Rows9 = SMatrix<f64, 9, STATES>;

/// What the error moves by, summed over the samples since the covariance was propagated last.
#[derive(Clone, Copy, Debug)]
pub(super) struct ErrorTransition {
    /// Their time, s.
    pub(super) dt: f64,
    /// Attitude at their beginning, body → NED.
    r_start: Matrix3<f64>,
    /// Rotation since then.
    turn: Matrix3<f64>,
    /// ∫ R dt, s.
    rotation: Matrix3<f64>,
    /// ∫ R f dt, m/s.
    impulse_ned: Vector3<f64>,
    /// ∫ ω dt, rad.
    angle: Vector3<f64>,
    /// ∫ ‖ω‖² dt, rad²/s, and ∫ ‖R f + g‖² dt, m²/s³: how lively it was.
    rate_squared: f64,
    load_squared: f64,
}

impl ErrorTransition {
    /// Nothing yet, beginning at this attitude.
    pub(super) fn new(r_start: Matrix3<f64>) -> Self {
        let zero = Vector3::zeros();
        let (turn, rotation) = (Matrix3::identity(), Matrix3::zeros());
        Self {
            dt: 0.0,
            r_start,
            turn,
            rotation,
            impulse_ned: zero,
            angle: zero,
            rate_squared: 0.0,
            load_squared: 0.0,
        }
    }

    /// One more sample.
    pub(super) fn add(
        &mut self,
        dt: f64,
        turn: &Matrix3<f64>,
        r: &Matrix3<f64>,
        f_ned: &Vector3<f64>,
        rate: &Vector3<f64>,
        load: f64,
    ) {
        self.dt += dt;
        self.turn *= turn;
        self.rotation += r * dt;
        self.impulse_ned += f_ned * dt;
        self.angle += rate * dt;
        self.rate_squared += rate.norm_squared() * dt;
        self.load_squared += load * load * dt;
    }

    /// Attitude at the beginning.
    pub(super) fn start(&self) -> &Matrix3<f64> {
        &self.r_start
    }

    /// ∫ ‖ω‖² dt, rad²/s.
    pub(super) fn rate_squared(&self) -> f64 {
        self.rate_squared
    }

    /// What comes after it.
    pub(super) fn append(&mut self, next: &Self) {
        self.dt += next.dt;
        self.turn *= next.turn;
        self.rotation += next.rotation;
        self.impulse_ned += next.impulse_ned;
        self.angle += next.angle;
        self.rate_squared += next.rate_squared;
        self.load_squared += next.load_squared;
    }

    /// Φ of the time since the beginning.
    pub(super) fn phi(&self) -> Phi {
        let dt = self.dt;
        let turn_t = self.turn.transpose();
        // A gyro error acts in the axes of its own moment: those of the end and of the beginning, half and half.
        let by_bias = (turn_t + Matrix3::identity()) * (0.5 * dt);
        let by_scale = (turn_t + Matrix3::identity()) * 0.5 * Matrix3::from_diagonal(&self.angle);
        let tilt = hat(&self.impulse_ned) * self.r_start;
        Phi { dt, turn_t, by_bias, by_scale, tilt, rotation: self.rotation }
    }

    /// P ← Φ P Φᵀ + Q. False when what came of it is not finite.
    pub(super) fn propagate_covariance(
        &self,
        phi: &Phi,
        p: &mut Covariance,
        settings: &EskfSettings,
    ) -> bool {
        let mut u = Rows9::zeros();
        for (to, from) in u.data.0.iter_mut().zip(&p.data.0) {
            *to = phi.times(|i| from[i]);
        }
        // U Φᵀ in the columns of θ, p and v: Φ times the rows of U.
        let u = &u.data.0;
        let mut w = [[0.0; 9]; 9];
        for (i, row) in w.iter_mut().enumerate() {
            *row = phi.times(|j| u[j][i]);
        }
        let mut sum = 0.0;
        for i in 0..9 {
            for j in 0..9 {
                p[(i, j)] = 0.5 * (w[i][j] + w[j][i]);
                sum += w[i][j];
            }
        }
        for (j, column) in u.iter().enumerate().skip(9) {
            for (i, value) in column.iter().enumerate() {
                p[(i, j)] = *value;
                p[(j, i)] = *value;
            }
            sum += column.iter().sum::<f64>();
        }
        self.add_noise(p, settings);
        sum.is_finite()
    }

    fn add_noise(&self, p: &mut Covariance, s: &EskfSettings) {
        let magnetic = s.magnetic_bias_walk * super::MICRO;
        for (at, noise, square) in
            [(THETA, s.gyro_rate_noise, self.rate_squared), (V, s.accel_load_noise, self.load_squared)]
        {
            for i in at..at + 3 {
                p[(i, i)] += noise * noise * square;
            }
        }
        for (at, n, density) in [
            (THETA, 3, s.gyro_noise),
            (V, 3, s.accel_noise),
            (BG, 3, s.gyro_bias_walk),
            (BA, 3, s.accel_bias_walk),
            (FLOW, 2, s.flow_bias_walk),
            (FLOW + 2, 2, s.flow_scale_walk),
            (BM, 3, magnetic),
            (WIND, 2, s.air.wind_walk),
        ] {
            for i in at..at + n {
                p[(i, i)] += density * density * self.dt;
            }
        }
    }
}

/// Φ, the rows of θ, p and v: the others are those of the identity.
pub(super) struct Phi {
    dt: f64,
    turn_t: Matrix3<f64>,
    by_bias: Matrix3<f64>,
    by_scale: Matrix3<f64>,
    tilt: Matrix3<f64>,
    rotation: Matrix3<f64>,
}

impl Phi {
    /// Φ x, by the components of x. One vector at a time stays in registers.
    #[inline(always)]
    pub(super) fn times(&self, x: impl Fn(usize) -> f64) -> [f64; 9] {
        let three = |at: usize| Vector3::new(x(at), x(at + 1), x(at + 2));
        let (theta, velocity) = (three(THETA), three(V));
        let pulled = self.tilt * theta;
        let turned = self.turn_t * theta - self.by_bias * three(BG) - self.by_scale * three(SG);
        let position = three(P) + velocity * self.dt - pulled * (0.5 * self.dt);
        let faster = velocity - pulled - self.rotation * three(BA);
        let ([a, b, c], [d, e, f], [g, h, i]) = (turned.into(), position.into(), faster.into());
        [a, b, c, d, e, f, g, h, i]
    }

    /// The same of N vectors side by side, a row a state, in single precision.
    pub(super) fn times_side_by_side<const N: usize>(&self, x: &[[f32; N]; STATES]) -> [[f32; N]; 9] {
        let mut out = [[0.0f32; N]; 9];
        let mut add = |to: usize, by: f64, from: usize| {
            let by = by as f32;
            for (out, x) in out[to].iter_mut().zip(&x[from]) {
                *out += by * x;
            }
        };
        for i in 0..3 {
            for j in 0..3 {
                add(THETA + i, self.turn_t[(i, j)], THETA + j);
                add(THETA + i, -self.by_bias[(i, j)], BG + j);
                add(THETA + i, -self.by_scale[(i, j)], SG + j);
                add(P + i, -0.5 * self.dt * self.tilt[(i, j)], THETA + j);
                add(V + i, -self.tilt[(i, j)], THETA + j);
                add(V + i, -self.rotation[(i, j)], BA + j);
            }
            add(P + i, 1.0, P + i);
            add(P + i, self.dt, V + i);
            add(V + i, 1.0, V + i);
        }
        out
    }
}

/// ∂z/∂x of a scalar measurement: its entries that are not zero.
#[derive(Clone, Copy, Debug)]
pub(super) struct SparseRow {
    len: usize,
    at: [usize; SparseRow::MOST],
    by: [f64; SparseRow::MOST],
}

impl SparseRow {
    const MOST: usize = 18;

    pub(super) fn empty() -> Self {
        Self { len: 0, at: [0; Self::MOST], by: [0.0; Self::MOST] }
    }

    /// Of one state itself.
    pub(super) fn unit(index: usize) -> Self {
        Self::empty().with(index, 1.0)
    }

    /// With one more entry.
    #[inline(always)]
    pub(super) fn with(mut self, index: usize, by: f64) -> Self {
        if self.len < Self::MOST && index < STATES {
            self.at[self.len] = index;
            self.by[self.len] = by;
            self.len += 1;
        }
        self
    }

    /// With three more entries, of the states from `block` on.
    #[inline(always)]
    pub(super) fn with3(self, block: usize, by: &RowVector3<f64>) -> Self {
        self.with(block, by.x).with(block + 1, by.y).with(block + 2, by.z)
    }

    pub(super) fn entries(&self) -> impl Iterator<Item = (usize, f64)> + '_ {
        self.at.iter().copied().zip(self.by.iter().copied()).take(self.len)
    }

    /// h x.
    pub(super) fn dot(&self, x: &SVector<f64, STATES>) -> f64 {
        self.entries().map(|(i, h)| h * x[i]).sum()
    }

    /// P hᵀ.
    pub(super) fn times(&self, p: &Covariance) -> SVector<f64, STATES> {
        let mut out = SVector::<f64, STATES>::zeros();
        for (i, h) in self.entries() {
            out.axpy(h, &p.column(i), 1.0);
        }
        out
    }
}

/// P ← P − (P hᵀ)(P hᵀ)ᵀ/s, which for the optimal gain is Joseph's form; every product is formed the same way on both sides of the
/// diagonal, so it stays symmetric to the last bit.
pub(super) fn reduce(p: &mut Covariance, ph: &SVector<f64, STATES>, s: f64) {
    let inverse = 1.0 / s;
    for j in 0..STATES {
        let with = ph[j];
        let mut column = p.column_mut(j);
        for i in 0..STATES {
            column[i] -= (ph[i] * with) * inverse;
        }
        // What rounding may leave below zero is zero.
        column[j] = column[j].max(0.0);
    }
}
