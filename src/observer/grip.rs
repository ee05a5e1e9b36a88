//! Grip's observer: attitude, gyro bias, position and velocity from IMU, GNSS and magnetometer.

use super::attitude::{self, AttitudeGains, Discretisation, Gate, MagneticPair};
use super::bias::BiasBounds;
use super::gains::TranslationGains;
use super::state::{ObserverState, StepRefusal, StepReport, check};
use super::triad::{injection, normalised_triad, sine_between};
use nalgebra::{Matrix3, Vector3};

/// Parameters of Grip's observer (6)-(7).
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct GripParams {
    /// Diagonal of K_P, 1/s.
    pub k_p: Vector3<f64>,
    /// σ ≥ 1, scales K_P in the attitude equation but not in the bias equation.
    pub sigma: f64,
    /// k_I, 1/s.
    pub k_i: f64,
    /// Radii of the gyro bias.
    pub bias_bounds: BiasBounds,
    /// K of the translational part.
    pub gains: TranslationGains,
    /// Discretisation of the attitude.
    pub discretisation: Discretisation,
    /// J = 0 while the sine of the angle between specific force and magnetic field is below this, in body or in NED. The quantitative
    /// form of Grip's Assumption 2, our addition: where the field dips steeply, a banked vehicle's specific force passes by it once a
    /// turn, and a normalised triad is then all noise. 0 as printed.
    pub min_magnetic_sine: f64,
    /// Start-up gate; `None` as printed.
    pub gate: Option<Gate>,
}

impl GripParams {
    /// As printed (Grip, Section V) with plain Euler steps and normalised triads; gains of the raw triads would diverge.
    pub fn printed() -> Self {
        Self {
            k_p: Vector3::new(10.0, 0.1, 0.1),
            sigma: 1.0,
            k_i: 0.02,
            bias_bounds: BiasBounds::printed(),
            gains: TranslationGains::grip_printed(),
            discretisation: Discretisation::Euler,
            min_magnetic_sine: 0.0,
            gate: None,
        }
    }

    /// The tuning to use ("KM"): K_P = 0.1 I, k_I = 0.05, exponential steps, gated start.
    pub fn km() -> Self {
        Self {
            k_p: Vector3::repeat(0.1),
            sigma: 1.0,
            k_i: 0.05,
            bias_bounds: BiasBounds::printed(),
            gains: TranslationGains::km(),
            discretisation: Discretisation::Exponential,
            min_magnetic_sine: 0.2,
            gate: Some(Gate::standard()),
        }
    }

    /// The same without GNSS velocity (Theorem 2): the velocity columns of K are zero.
    pub fn position_only(self) -> Self {
        Self { gains: self.gains.position_only(), ..self }
    }

    /// The first half minute from an unknown attitude: as [`Self::km`] with K_P = I, k_I = 0.1 and a
    /// magnetic triad that is used nearer to where it degenerates.
    pub fn start_up() -> Self {
        Self { k_p: Vector3::repeat(1.0), k_i: 0.1, min_magnetic_sine: 0.1, ..Self::km() }
    }
}

/// What one IMU sample brings, over (t_{k−1}, t_k].
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct GripInput {
    /// Length of the interval, s.
    pub dt_s: f64,
    /// Mean angular rate in body axes, rad/s (ω_m, with its bias).
    pub angular_rate_body: Vector3<f64>,
    /// Mean specific force in body axes, m/s² (the paper's aᵇ).
    pub specific_force_body: Vector3<f64>,
    /// Gravity in NED, m/s².
    pub gravity_ned: Vector3<f64>,
    /// The Earth's rate in NED, rad/s. Zero as printed (NED taken as inertial, Grip's footnote 1); otherwise R̂ᵀω_e is taken off
    /// the gyros and 2 ω_e × v̂ off the acceleration, as Fusini (6a), (7b).
    pub earth_rate_ned: Vector3<f64>,
    /// Magnetometer and reference; absent → J = 0.
    pub magnetic: Option<MagneticPair>,
    /// Injected position error e_p = w_p − p̂, NED, m; zero where there is none (see [`super::Signal::errors`]).
    pub position_error_ned: Vector3<f64>,
    /// Injected velocity error e_v = w_v − v̂, NED, m/s; zero where there is none (Theorem 2).
    pub velocity_error_ned: Vector3<f64>,
}

/// One step of Grip's observer (6)-(7) with the projection and resetting rule (12). Right-hand sides use the state before the step.
///
/// With a = f and â = R̂a + ξ, J from the triads of (m, a) and (m_n, â):
/// p̂⁺ = p̂ + dt(v̂ + K_pp e_p + K_pv e_v); v̂⁺ = v̂ + dt(â + g + K_vp e_p + K_vv e_v); ξ⁺ = ξ − ΔR a + dt(K_ξp e_p + K_ξv e_v);
/// b̂⁺ = b̂ + dt Proj(b̂, −k_I vex(P_a(sat(R̂)ᵀ K_P J))).
/// [`Discretisation::Exponential`] solves Ṙ = σK_P J over the step exactly: ΔR = diag(1 − e^{−σk_i dt}) J.
///
/// Valid while |m × a| > 0 (Assumption 2). The acceleration in the input must be the interval's mean: at 25-100 Hz of
/// instantaneous samples the error shows as noise.
///
/// # Errors
/// [`StepRefusal`] when an input is not finite or the interval is out of (0, 1] s; the state is then unchanged.
pub fn step(
    params: &GripParams,
    state: &mut ObserverState,
    input: &GripInput,
) -> Result<StepReport, StepRefusal> {
    let dt = input.dt_s;
    check(
        dt,
        &[
            &input.angular_rate_body,
            &input.specific_force_body,
            &input.gravity_ned,
            &input.earth_rate_ned,
            &input.position_error_ned,
            &input.velocity_error_ned,
        ],
    )?;
    let a = &input.specific_force_body;
    let (e_p, e_v) = (&input.position_error_ned, &input.velocity_error_ned);
    let r = state.r_hat;
    let a_ned = state.specific_force_ned(a);

    // A magnetometer vector that is not finite has no triad, so it cannot get further than here.
    let triads = input.magnetic.and_then(|m| triads(params, &m, a, &a_ned));
    let j = triads.map(|(ned, body)| injection(&ned, &body, &r));
    let gains = AttitudeGains::choose(params.gate, params.k_p, params.k_i, j.map(|j| j.norm()));

    let acceleration_ned = a_ned + input.gravity_ned;
    let coriolis = -2.0 * input.earth_rate_ned.cross(&state.velocity_ned);
    let k = &params.gains;
    let position = state.position_ned + dt * (state.velocity_ned + k.pp * e_p + k.pv * e_v);
    let velocity = state.velocity_ned + dt * (acceleration_ned + coriolis + k.vp * e_p + k.vv * e_v);

    let body_rate = input.angular_rate_body - state.gyro_bias - r.tr_mul(&input.earth_rate_ned);
    let delta_r = j.map_or_else(Matrix3::zeros, |j| {
        state.gyro_bias = gains.advance_bias(&params.bias_bounds, &state.gyro_bias, &r, &j, dt);
        let rate = params.sigma * gains.k_p;
        match params.discretisation {
            Discretisation::Euler => attitude::scale_rows(&(rate * dt), &j),
            // 1 − e^{−x}, without cancellation at small x.
            Discretisation::Exponential => attitude::scale_rows(&rate.map(|k| -(-k * dt).exp_m1()), &j),
        }
    });
    state.r_hat = attitude::advance(params.discretisation, &r, &delta_r, &body_rate, dt);
    state.xi_ned += -(delta_r * a) + dt * (k.xp * e_p + k.xv * e_v);
    state.position_ned = position;
    state.velocity_ned = velocity;
    Ok(StepReport { acceleration_ned, injection: j, gated: gains.gated, signal: None })
}

/// The triads of field and specific force, in NED and in body axes.
fn triads(
    params: &GripParams,
    m: &MagneticPair,
    f_body: &Vector3<f64>,
    f_ned: &Vector3<f64>,
) -> Option<(Matrix3<f64>, Matrix3<f64>)> {
    let parallel = |f, m| sine_between(f, m) < params.min_magnetic_sine;
    if parallel(f_body, &m.field_body) || parallel(f_ned, &m.field_ned) {
        return None;
    }
    Some((normalised_triad(&m.field_ned, f_ned)?, normalised_triad(&m.field_body, f_body)?))
}

#[cfg(test)]
mod tests {
    use super::*;

    fn level() -> GripInput {
        GripInput {
            dt_s: 0.01,
            angular_rate_body: Vector3::new(0.0, 0.0, 0.1),
            specific_force_body: Vector3::new(0.0, 0.0, -9.81),
            gravity_ned: Vector3::new(0.0, 0.0, 9.81),
            earth_rate_ned: Vector3::zeros(),
            magnetic: None,
            position_error_ned: Vector3::zeros(),
            velocity_error_ned: Vector3::zeros(),
        }
    }

    fn start() -> ObserverState {
        ObserverState::new(Matrix3::identity(), Vector3::zeros(), Vector3::zeros())
    }

    #[test]
    fn refused_input_leaves_the_state_alone() {
        let mut s = start();
        let nan = Vector3::new(0.0, f64::NAN, 0.0);
        let refused = |s: &mut ObserverState, i: &GripInput| step(&GripParams::km(), s, i).unwrap_err();
        assert_eq!(refused(&mut s, &GripInput { angular_rate_body: nan, ..level() }), StepRefusal::NotFinite);
        assert_eq!(
            refused(&mut s, &GripInput { position_error_ned: nan, ..level() }),
            StepRefusal::NotFinite
        );
        for dt_s in [0.0, -0.01, 1.5, f64::NAN] {
            assert_eq!(refused(&mut s, &GripInput { dt_s, ..level() }), StepRefusal::Interval);
        }
        assert_eq!(s, start());
    }

    #[test]
    fn a_magnetometer_that_is_absent_or_nonsense_injects_nothing() {
        let pair = |x: f64| MagneticPair { field_body: Vector3::repeat(x), field_ned: Vector3::x() };
        for magnetic in [None, Some(pair(f64::NAN)), Some(pair(0.0)), Some(pair(f64::INFINITY))] {
            let mut s = start();
            let report = step(&GripParams::km(), &mut s, &GripInput { magnetic, ..level() }).unwrap();
            assert_eq!(report.injection_norm(), None);
            assert!((s.r_hat - crate::geo::so3::exp(&Vector3::new(0.0, 0.0, 1e-3))).norm() < 1e-15);
            assert!(s.is_finite() && s.velocity_ned.norm() < 1e-12);
        }
    }

    #[test]
    fn the_gate_holds_the_bias_and_opens_the_attitude_gain() {
        let magnetic = Some(MagneticPair { field_body: -Vector3::x(), field_ned: Vector3::x() });
        let mut s = start();
        let report = step(&GripParams::km(), &mut s, &GripInput { magnetic, ..level() }).unwrap();
        assert!(report.gated && report.injection_norm().is_some_and(|n| (n - 8f64.sqrt()).abs() < 1e-9));
        assert_eq!(s.gyro_bias, Vector3::zeros());
        let mut printed = start();
        let report = step(
            &GripParams { gate: None, ..GripParams::km() },
            &mut printed,
            &GripInput { magnetic, ..level() },
        );
        assert!(!report.unwrap().gated);
        let turned = |s: &ObserverState| (s.r_hat.m11 - 1.0).abs();
        assert!(turned(&s) > 8.0 * turned(&printed), "K_P = 1 instead of 0.1");
    }
}
