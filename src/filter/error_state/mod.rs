//! An error-state Kalman filter: attitude, position, velocity, IMU errors, and what is systematically wrong with flow, magnetometer and
//! airspeed, the wind and the rotors' drag.
//!
//! Nominal state R (body → NED), p, v, b_g, b_a, flow [b_x, b_y, s, μ] (see [`crate::camera::calibration`]), magnetometer bias b_m,
//! gyro scale error s_g, wind w (north, east), airspeed scale error k and rotor drag D. Error state, 29 numbers, the attitude error on the body side
//! (R_true = R Exp(δθ)):
//!
//! δθ̇ = −ω × δθ − δb_g − diag(ω) δs_g,  δṗ = δv,  δv̇ = −R S(f) δθ − R δb_a,  biases and wind random walks, scales constant.
//!
//! Linear, locally convergent, and it knows how wrong it is; the nonlinear observers, globally convergent and blind to that, start it
//! and watch it (the staged start of the observers' specification; Fusini (10), (2) is the same idea with the linearisation about the
//! observer). Measurements are scalars with a gate on the normalised innovation, fused one after the other; a late one is related to the
//! present by the motion since ([`Lag`]).

mod carry;
mod covariance;
mod jumps;
mod measure;
mod memory;
#[cfg(test)]
mod tests;
mod tuning;

use nalgebra::{Matrix3, SMatrix, SVector, Vector2, Vector3};

use crate::geo::polar_rotation;
use crate::geo::so3::exp;
pub use carry::{Doubt, Fade};
use covariance::{Covariance, ErrorTransition, SparseRow, reduce};
use jumps::JumpBank;
pub use jumps::{FLOW_JUMPS, IMU_JUMPS, JUMPS, JumpFit, JumpOdds, JumpWindow, RECEIVER_JUMPS};
pub use measure::{Lag, SeenFlow};
pub use memory::EskfMemory;
pub use tuning::JUMP_ONSET_PART;
use tuning::{COVARIANCE_STEP_S, REORTHONORMALISE};

/// Size of the error state.
pub const STATES: usize = 29;
const THETA: usize = 0;
const P: usize = 3;
const V: usize = 6;
const BG: usize = 9;
const BA: usize = 12;
const FLOW: usize = 15;
/// In µT: in tesla its variances would be lost beside the others'.
const BM: usize = 19;
const SG: usize = 22;
const WIND: usize = 25;
const AIRSPEED: usize = 27;
const DRAG: usize = 28;

/// Micro-units in a unit.
const MICRO: f64 = 1e6;

/// Noise densities, walks, and what is known of constants before the flight. A constant whose standard deviation and walk are zero is
/// no state at all.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct EskfSettings {
    /// Gyro noise density, rad/s/√Hz.
    pub gyro_noise: f64,
    /// Accelerometer noise density, m/s²/√Hz.
    pub accel_noise: f64,
    /// Gyro noise that comes with rotation (sampling, scale, alignment): density over angular rate, √s.
    pub gyro_rate_noise: f64,
    /// Accelerometer noise that comes with manoeuvres: density over the specific force beyond gravity's, √s.
    pub accel_load_noise: f64,
    /// Random walk of the gyro bias, rad/s/√s.
    pub gyro_bias_walk: f64,
    /// Random walk of the accelerometer bias, m/s²/√s.
    pub accel_bias_walk: f64,
    /// Standard deviation of the gyros' scale errors.
    pub gyro_scale_sigma: f64,
    /// Random walk of the magnetometer bias, T/√s.
    pub magnetic_bias_walk: f64,
    /// Standard deviation of the magnetometer bias at the start, T.
    pub magnetic_bias_sigma: f64,
    /// Random walk of the flow's bias, rad/s/√s.
    pub flow_bias_walk: f64,
    /// Random walk of the flow's scale and misalignment, 1/√s.
    pub flow_scale_walk: f64,
    /// Wind, airspeed and drag.
    pub air: AirModel,
    /// Innovations beyond this many sigmas are rejected.
    pub gate_sigma: f64,
}

/// What is known before the flight of the air and of how the vehicle feels it. All zero: none of it is a state.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct AirModel {
    /// Standard deviation of the wind before it was seen, m/s per axis.
    pub wind_sigma: f64,
    /// Random walk of the wind, m/s/√s.
    pub wind_walk: f64,
    /// Standard deviation of the airspeed's scale error.
    pub airspeed_scale_sigma: f64,
    /// Standard deviation of the rotors' drag before it was seen, 1/s.
    pub drag_sigma: f64,
}

/// The nominal state.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct EskfState {
    /// Body → NED, orthonormal.
    pub r_body_to_ned: Matrix3<f64>,
    /// Position, NED, m.
    pub position_ned: Vector3<f64>,
    /// Velocity, NED, m/s.
    pub velocity_ned: Vector3<f64>,
    /// Gyro bias, body, rad/s.
    pub gyro_bias: Vector3<f64>,
    /// Accelerometer bias, body, m/s².
    pub accel_bias: Vector3<f64>,
    /// Flow [b_x rad/s, b_y rad/s, s, μ rad].
    pub flow: SVector<f64, 4>,
    /// Magnetometer bias, body, T.
    pub magnetic_bias: Vector3<f64>,
    /// Gyro scale errors: the gyro shows (1 + s_g) ω + b_g.
    pub gyro_scale: Vector3<f64>,
    /// Wind (where the air moves to), north and east, m/s.
    pub wind_ne: Vector2<f64>,
    /// Airspeed scale error: the sensor shows (1 + k) of the airspeed.
    pub airspeed_scale: f64,
    /// Rotor drag D, 1/s: a multirotor's specific force along body x and y is −D times its velocity through the air.
    pub drag: f64,
}

impl EskfState {
    /// In motion, with nothing known of any sensor's errors.
    pub fn moving(
        r_body_to_ned: Matrix3<f64>,
        position_ned: Vector3<f64>,
        velocity_ned: Vector3<f64>,
        gyro_bias: Vector3<f64>,
    ) -> Self {
        Self {
            r_body_to_ned,
            position_ned,
            velocity_ned,
            gyro_bias,
            accel_bias: Vector3::zeros(),
            flow: SVector::zeros(),
            magnetic_bias: Vector3::zeros(),
            gyro_scale: Vector3::zeros(),
            wind_ne: Vector2::zeros(),
            airspeed_scale: 0.0,
            drag: 0.0,
        }
    }

    fn is_finite(&self) -> bool {
        let motion = self.r_body_to_ned.sum() + self.position_ned.sum() + self.velocity_ned.sum();
        let inertial = self.gyro_bias.sum() + self.accel_bias.sum() + self.gyro_scale.sum();
        let others =
            self.flow.sum() + self.magnetic_bias.sum() + self.wind_ne.sum() + self.airspeed_scale + self.drag;
        (motion + inertial + others).is_finite()
    }
}

/// Standard deviations at the start of what is not in the settings.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct StartSigma {
    /// Attitude, rotations about the body axes, rad.
    pub attitude_body: Vector3<f64>,
    /// Position, NED, m.
    pub position_ned: Vector3<f64>,
    /// Velocity, NED, m/s.
    pub velocity_ned: Vector3<f64>,
    /// Gyro bias, rad/s.
    pub gyro_bias: Vector3<f64>,
    /// Accelerometer bias, m/s².
    pub accel_bias: Vector3<f64>,
    /// Covariance of the flow's [b_x, b_y, s, μ].
    pub flow: SMatrix<f64, 4, 4>,
}

/// What a correction moved, so that the remembered past moves with it, and how likely it was.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Correction {
    /// Of the position, m.
    pub position_ned: Vector3<f64>,
    /// Of the velocity, m/s.
    pub velocity_ned: Vector3<f64>,
    /// The normalised innovation squared, innovation²/variance: 1 in the mean where the filter is honest.
    pub nis: f64,
    /// Of the whole error state.
    all: SVector<f64, STATES>,
}

/// A measurement that was not used; its innovation over its standard deviation.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Gated(pub f64);

/// See the module's documentation.
#[derive(Clone, Debug)]
pub struct Eskf {
    settings: EskfSettings,
    state: EskfState,
    p: Covariance,
    pending: ErrorTransition,
    /// Longest step of the covariance, s.
    covariance_step_s: f64,
    steps: u32,
    /// What the covariance became last was finite.
    sound: bool,
    /// What may have jumped.
    jumps: JumpBank,
}

impl Eskf {
    /// Starts at `state`, known this well.
    pub fn new(settings: EskfSettings, state: EskfState, sigma: &StartSigma) -> Self {
        let mut p = Covariance::zeros();
        let s = &settings;
        let wind = Vector3::new(s.air.wind_sigma, s.air.wind_sigma, s.air.airspeed_scale_sigma);
        for (block, s) in [
            (THETA, sigma.attitude_body),
            (P, sigma.position_ned),
            (V, sigma.velocity_ned),
            (BG, sigma.gyro_bias),
            (BA, sigma.accel_bias),
            (BM, Vector3::repeat(s.magnetic_bias_sigma * MICRO)),
            (SG, Vector3::repeat(s.gyro_scale_sigma)),
            (WIND, wind),
        ] {
            for axis in 0..3 {
                p[(block + axis, block + axis)] = s[axis] * s[axis];
            }
        }
        p.fixed_view_mut::<4, 4>(FLOW, FLOW).copy_from(&sigma.flow);
        p[(DRAG, DRAG)] = settings.air.drag_sigma.powi(2);
        Self {
            settings,
            state,
            p,
            pending: ErrorTransition::new(state.r_body_to_ned),
            covariance_step_s: COVARIANCE_STEP_S,
            steps: 0,
            sound: true,
            jumps: JumpBank::new(false),
        }
    }

    /// The nominal state.
    pub fn state(&self) -> &EskfState {
        &self.state
    }

    /// Covariance of the position, NED, m². As all covariances, it may be a step of the covariance old between measurements.
    pub fn position_covariance(&self) -> Matrix3<f64> {
        self.p.fixed_view::<3, 3>(P, P).into_owned()
    }

    /// Covariance of the velocity, NED, m²/s².
    pub fn velocity_covariance(&self) -> Matrix3<f64> {
        self.p.fixed_view::<3, 3>(V, V).into_owned()
    }

    /// Covariance of the attitude error in NED axes, rad².
    pub fn attitude_covariance_ned(&self) -> Matrix3<f64> {
        let r = &self.state.r_body_to_ned;
        r * self.p.fixed_view::<3, 3>(THETA, THETA) * r.transpose()
    }

    /// Standard deviation of the rotor drag, 1/s.
    pub fn drag_sigma(&self) -> f64 {
        self.p[(DRAG, DRAG)].max(0.0).sqrt()
    }

    /// Covariance of the flow's [b_x, b_y, s, μ].
    pub fn flow_covariance(&self) -> SMatrix<f64, 4, 4> {
        self.p.fixed_view::<4, 4>(FLOW, FLOW).into_owned()
    }

    /// The flow's scale error is this, known to `sigma`, and has nothing to do with anything else: what it is multiplied with is another.
    pub fn set_flow_scale(&mut self, scale: f64, sigma: f64) {
        self.propagate_covariance();
        self.decorrelate(FLOW + 2, sigma);
        self.state.flow[2] = scale;
    }

    /// The wind is another by `change`, north and east, m/s, known to `sigma`; all else stays, and forgets what it had to do with the old one.
    pub fn change_wind(&mut self, change: &Vector2<f64>, sigma: f64) {
        self.propagate_covariance();
        for axis in 0..2 {
            self.decorrelate(WIND + axis, sigma);
        }
        self.state.wind_ne += change;
    }

    /// Whether everything is finite. The covariance's part of it is found where the covariance changes, which is not at every sample.
    pub fn is_finite(&self) -> bool {
        self.sound && self.state.is_finite()
    }

    /// North was elsewhere: attitude and velocity are turned about the vertical by `angle`, rad; positions stay.
    pub fn turn(&mut self, angle: f64) {
        self.propagate_covariance();
        let turn = exp(&Vector3::new(0.0, 0.0, angle));
        self.state.r_body_to_ned = turn * self.state.r_body_to_ned;
        self.state.velocity_ned = turn * self.state.velocity_ned;
        self.pending = ErrorTransition::new(self.state.r_body_to_ned);
    }

    /// Moves the origin: positions become smaller by `moved`.
    pub fn shift_origin(&mut self, moved_ned: &Vector3<f64>) {
        self.state.position_ned -= moved_ned;
    }

    /// Position and velocity are known anew (horizontally: the vertical stays), with these standard deviations; attitude and biases
    /// stay, and forget what they had to do with the old ones.
    pub fn reset_motion(
        &mut self,
        position_ne: &Vector2<f64>,
        velocity_ne: &Vector2<f64>,
        sigma_position_m: f64,
        sigma_velocity_mps: f64,
    ) {
        self.reset_position(position_ne, sigma_position_m);
        for axis in 0..2 {
            self.decorrelate(V + axis, sigma_velocity_mps);
            self.state.velocity_ned[axis] = velocity_ne[axis];
        }
    }

    /// The horizontal position is known anew, with this standard deviation; all else stays, and forgets what it had to do with the old one.
    pub fn reset_position(&mut self, position_ne: &Vector2<f64>, sigma_m: f64) {
        self.propagate_covariance();
        for axis in 0..2 {
            self.decorrelate(P + axis, sigma_m);
            self.state.position_ned[axis] = position_ne[axis];
        }
    }

    /// Whether jumps of what is taken for constant are watched for.
    pub fn watch_for_jumps(&mut self, on: bool) {
        self.jumps = JumpBank::new(on);
    }

    /// What the innovations since some onsets show of jumps; none where nobody watches for them.
    pub fn jump_windows(&self) -> &[JumpWindow] {
        self.jumps.windows()
    }

    /// The filter was set anew: innovations of before say nothing of jumps since.
    pub fn forget_jumps(&mut self) {
        self.jumps.forget();
    }

    /// The window of [`Self::jump_windows`] that has gone since this was asked last: the oldest, with what it had shown.
    pub fn take_gone_jumps(&mut self) -> Option<JumpWindow> {
        self.jumps.take_gone()
    }

    /// What the filter would hold had it known of a jump, where each that [`Self::jump_windows`] show has happened with these odds, which sum up to one: the
    /// mean of x̂ + J f̂ over them, and their spread beside each one's own, (1/C + (½ f̂)²) J Jᵀ, where half of f̂ is what it is known to for a window that
    /// does not begin when the jump was. The windows are forgotten: what was is explained.
    pub fn believe_jumps(&mut self, odds: &JumpOdds) -> Correction {
        self.propagate_covariance();
        self.jumps.catch_up();
        let mut mean = SVector::<f64, STATES>::zeros();
        let mut spread = Covariance::zeros();
        let mut nis = 0.0;
        for (shown, odds) in self.jumps.windows().iter().zip(odds) {
            for (jump, odds) in odds.iter().enumerate().filter(|(_, odds)| **odds > 0.0) {
                let Some(fit) = shown.fit(jump) else { continue };
                let (effect, variance) = shown.effect(jump);
                mean += effect * (fit.size * odds);
                nis += fit.square * odds;
                let square = variance + fit.size.powi(2) * (1.0 + JUMP_ONSET_PART.powi(2));
                spread += effect * effect.transpose() * (square * odds);
            }
        }
        self.p += spread - mean * mean.transpose();
        self.has_jumped(mean, nis)
    }

    /// What the filter would hold had it known that the receiver lies in every direction as a window of [`Self::jump_windows`] shows: x̂ + Σ J f̂. The windows are
    /// forgotten. `None` where there is no such window.
    pub fn believe_receiver_lies(&mut self, window: usize) -> Option<Correction> {
        self.propagate_covariance();
        self.jumps.catch_up();
        let shown = self.jumps.windows().get(window)?;
        let mut mean = SVector::<f64, STATES>::zeros();
        for jump in RECEIVER_JUMPS {
            let Some(fit) = shown.fit(jump) else { continue };
            let (effect, variance) = shown.effect(jump);
            mean += effect * fit.size;
            self.p += effect * effect.transpose() * (variance + (fit.size * JUMP_ONSET_PART).powi(2));
        }
        let explained = shown.explained_by_receiver();
        Some(self.has_jumped(mean, explained))
    }

    fn has_jumped(&mut self, moved: SVector<f64, STATES>, nis: f64) -> Correction {
        self.inject(&moved);
        self.restart_transition();
        self.jumps.forget();
        Correction {
            position_ned: moved.fixed_rows::<3>(P).into_owned(),
            velocity_ned: moved.fixed_rows::<3>(V).into_owned(),
            nis,
            all: moved,
        }
    }

    /// Noise densities of gyros and accelerometers from now on, rad/s/√Hz and m/s²/√Hz.
    pub fn set_imu_noise(&mut self, gyro: f64, accel: f64) {
        (self.settings.gyro_noise, self.settings.accel_noise) = (gyro, accel);
    }

    /// Random walk of the magnetometer's bias from now on, T/√s.
    pub fn set_magnetic_walk(&mut self, walk: f64) {
        self.settings.magnetic_bias_walk = walk;
    }

    /// Standard deviation of the magnetometer's bias, the mean of its axes, T.
    pub fn magnetic_bias_sigma(&self) -> f64 {
        (self.p.fixed_view::<3, 3>(BM, BM).trace().max(0.0) / 3.0).sqrt() / MICRO
    }

    /// The covariance follows the motion in steps of so many seconds: longer ones cost less, and are of second order in the rotation within.
    pub fn set_covariance_step(&mut self, seconds: f64) {
        self.covariance_step_s = seconds;
    }

    fn decorrelate(&mut self, index: usize, sigma: f64) {
        self.p.row_mut(index).fill(0.0);
        self.p.column_mut(index).fill(0.0);
        self.p[(index, index)] = sigma * sigma;
    }

    /// One IMU sample over `dt` s: mean angular rate (rad/s) and specific force (m/s²), body; gravity and Earth rate, NED.
    /// Returns the acceleration in NED that was integrated, m/s².
    pub fn predict(
        &mut self,
        dt: f64,
        angular_rate: &Vector3<f64>,
        specific_force: &Vector3<f64>,
        gravity_ned: &Vector3<f64>,
        earth_rate_ned: &Vector3<f64>,
    ) -> Vector3<f64> {
        let s = &mut self.state;
        let r = s.r_body_to_ned;
        let inertial = (angular_rate - s.gyro_bias).component_mul(&(Vector3::repeat(1.0) - s.gyro_scale));
        let rate = inertial - r.tr_mul(earth_rate_ned);
        let force = specific_force - s.accel_bias;
        // The mean attitude of the interval turns the force; two halves make the whole turn.
        let half = exp(&(rate * (0.5 * dt)));
        let turn = half * half;
        let f_ned = r * (half * force);
        let acceleration = f_ned + gravity_ned - 2.0 * earth_rate_ned.cross(&s.velocity_ned);
        s.position_ned += dt * (s.velocity_ned + 0.5 * dt * acceleration);
        s.velocity_ned += dt * acceleration;
        s.r_body_to_ned = r * turn;
        self.steps += 1;
        if self.steps.is_multiple_of(REORTHONORMALISE)
            && let Some(clean) = polar_rotation(&s.r_body_to_ned)
        {
            s.r_body_to_ned = clean;
        }
        self.pending.add(dt, &turn, &r, &f_ned, &inertial, (f_ned + gravity_ned).norm());
        if self.pending.dt >= self.covariance_step_s {
            self.propagate_covariance();
        }
        acceleration
    }

    /// Brings the covariance up to the nominal state.
    fn propagate_covariance(&mut self) {
        if self.pending.dt > 0.0 {
            let phi = self.pending.phi();
            self.sound &= self.pending.propagate_covariance(&phi, &mut self.p, &self.settings);
            self.jumps.propagate(&self.pending);
            self.restart_transition();
        }
    }

    /// What comes is summed up from the present attitude on.
    fn restart_transition(&mut self) {
        self.pending = ErrorTransition::new(self.state.r_body_to_ned);
    }

    /// The innovation's variance, P hᵀ, and whether it passes the gate.
    fn gate(
        &mut self,
        h: &SparseRow,
        innovation: f64,
        variance: f64,
    ) -> Result<(f64, SVector<f64, STATES>), Gated> {
        self.propagate_covariance();
        let ph = h.times(&self.p);
        let s = h.dot(&ph) + variance;
        let normalised = innovation / s.sqrt();
        if normalised.is_finite() && normalised.abs() <= self.settings.gate_sigma {
            Ok((s, ph))
        } else {
            self.jumps.observe(h, innovation, s, None);
            Err(Gated(normalised))
        }
    }

    /// A scalar update.
    fn fuse(&mut self, h: &SparseRow, innovation: f64, variance: f64) -> Result<Correction, Gated> {
        let (s, ph) = self.gate(h, innovation, variance)?;
        // The gate has seen that s is finite.
        self.sound &= ph.sum().is_finite();
        self.jumps.observe(h, innovation, s, Some(&ph));
        reduce(&mut self.p, &ph, s);
        let dx = ph * (innovation / s);
        self.inject(&dx);
        self.restart_transition();
        Ok(Correction {
            position_ned: dx.fixed_rows::<3>(P).into_owned(),
            velocity_ned: dx.fixed_rows::<3>(V).into_owned(),
            nis: innovation * innovation / s,
            all: dx,
        })
    }

    fn inject(&mut self, dx: &SVector<f64, STATES>) {
        let s = &mut self.state;
        s.r_body_to_ned *= exp(&dx.fixed_rows::<3>(THETA).into_owned());
        s.position_ned += dx.fixed_rows::<3>(P);
        s.velocity_ned += dx.fixed_rows::<3>(V);
        s.gyro_bias += dx.fixed_rows::<3>(BG);
        s.accel_bias += dx.fixed_rows::<3>(BA);
        s.flow += dx.fixed_rows::<4>(FLOW);
        s.magnetic_bias += dx.fixed_rows::<3>(BM) / MICRO;
        s.gyro_scale += dx.fixed_rows::<3>(SG);
        s.wind_ne += dx.fixed_rows::<2>(WIND);
        s.airspeed_scale += dx[AIRSPEED];
        s.drag += dx[DRAG];
    }
}
