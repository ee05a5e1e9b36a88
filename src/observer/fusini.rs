//! Fusini's observer: specific force and optical-flow velocity in place of the magnetometer, with GNSS or in dead reckoning.

use super::attitude::{self, AttitudeGains, Discretisation, Gate, MagneticPair};
use super::bias::BiasBounds;
use super::gains::{DeadReckoningGains, TranslationGains};
use super::predictor::Signal;
use super::state::{ObserverState, StepRefusal, StepReport, check};
use super::triad::{injection, normalised_triad, sine_between};
use nalgebra::{Matrix3, Vector3};

/// How the flow velocity bias b_v is estimated while there is GNSS.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum FlowBiasForm {
    /// Low-pass of v_m − R̂ᵀvⁿ in body axes, where the bias is constant. The one to use.
    Body,
    /// As printed: low-pass of vⁿ − R̂v_m in NED. It averages out in circles and is kept for comparison.
    AsPrinted,
}

/// Parameters of Fusini's observer.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct FusiniParams {
    /// Diagonal of K_P, 1/s.
    pub k_p: Vector3<f64>,
    /// σ ≥ 1, scales K_P in the attitude equation but not in the bias equation.
    pub sigma: f64,
    /// k_I, 1/s.
    pub k_i: f64,
    /// Radii of the gyro bias.
    pub bias_bounds: BiasBounds,
    /// K of (7), with GNSS.
    pub gains: TranslationGains,
    /// K′ of (9), in dead reckoning.
    pub dead_reckoning: DeadReckoningGains,
    /// K_f of (7f), 1/s³. Zero is right: with either sign the estimate does not converge to the accelerometer's bias, for ξ
    /// absorbs it. Non-zero applies ḃ_f = −K_f R̂ᵀ(p − p̂).
    pub k_f: f64,
    /// Discretisation of the attitude.
    pub discretisation: Discretisation,
    /// Euler sub-steps an IMU sample, the sample held (Fusini ran at some 300 Hz). At least 1.
    pub sub_steps: u32,
    /// How b_v is found.
    pub flow_bias: FlowBiasForm,
    /// Time constant of b_v's low-pass, s.
    pub flow_bias_time_constant_s: f64,
    /// Replace the z component of the flow velocity, its worst, by (R̂ᵀv̂)_z.
    pub predict_flow_z: bool,
    /// Assumption 3: J = 0 while |f × v| in body or in NED is below this, m²/s³.
    pub guard: f64,
    /// J = 0 while the sine of the angle between specific force and magnetic field is below this, in body or in NED. The quantitative
    /// form of Grip's Assumption 2, our addition: where the field dips steeply, a banked vehicle's specific force passes by it once a
    /// turn, and a normalised triad is then all noise. 0 as printed.
    pub min_magnetic_sine: f64,
    /// Start-up gate; `None` as printed.
    pub gate: Option<Gate>,
}

impl FusiniParams {
    /// As printed (Fusini, Section VI), but for the sign of (7f) and K_f, see [`Self::k_f`]. For 300 Hz: three sub-steps at 100 Hz.
    pub fn printed() -> Self {
        Self {
            k_p: Vector3::new(0.08, 0.04, 0.06),
            sigma: 1.0,
            k_i: 0.02,
            bias_bounds: BiasBounds::printed(),
            gains: TranslationGains::fusini_printed(),
            dead_reckoning: DeadReckoningGains::printed(),
            k_f: 0.0,
            discretisation: Discretisation::Euler,
            sub_steps: 3,
            flow_bias: FlowBiasForm::AsPrinted,
            flow_bias_time_constant_s: 5.0,
            predict_flow_z: false,
            guard: 5.0,
            min_magnetic_sine: 0.0,
            gate: None,
        }
    }

    /// The tuning to use: K_P = 0.1 I, k_I = 0.05, KM gains with GNSS and without, exponential attitude, body b_v over 30 s, gated start.
    pub fn tuned() -> Self {
        Self {
            k_p: Vector3::repeat(0.1),
            k_i: 0.05,
            gains: TranslationGains::km(),
            dead_reckoning: DeadReckoningGains::km(),
            discretisation: Discretisation::Exponential,
            sub_steps: 1,
            flow_bias: FlowBiasForm::Body,
            flow_bias_time_constant_s: 30.0,
            predict_flow_z: true,
            min_magnetic_sine: 0.2,
            gate: Some(Gate::standard()),
            ..Self::printed()
        }
    }

    /// The first half minute from an unknown attitude: as [`Self::tuned`] with K_P = I, a gate that closes later (with k_I = 0.1 and a
    /// threshold of 0.5 one start in a hundred takes 20 s; so, of 2000 starts the slowest takes 8.5 s), and a magnetic triad that is used nearer to where it degenerates. Leave the flow bias alone
    /// ([`update_flow_bias`]) until it is over: it would swallow the attitude error and keep it.
    pub fn start_up() -> Self {
        Self::tuned().starting()
    }

    /// These parameters with the gains and the gate of [`Self::start_up`].
    pub fn starting(self) -> Self {
        Self {
            k_p: Vector3::repeat(1.0),
            k_i: 0.05,
            min_magnetic_sine: 0.1,
            gate: Some(Gate { threshold: 0.4, ..Gate::standard() }),
            ..self
        }
    }
}

/// Biases beyond the shared state. Frozen in dead reckoning.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct FusiniBiases {
    /// b_f, accelerometer bias in body axes, m/s². Constant with K_f = 0: write the Kalman filter's estimate here.
    pub accelerometer: Vector3<f64>,
    /// b_v, bias of the flow velocity in body axes, m/s.
    pub flow_velocity: Vector3<f64>,
    /// The low-pass d of the printed form, NED, m/s, once it runs: b_v = −R̂ᵀd at every step with GNSS then. `None` with
    /// [`FlowBiasForm::Body`].
    pub flow_velocity_printed_ned: Option<Vector3<f64>>,
}

impl Default for FusiniBiases {
    fn default() -> Self {
        Self {
            accelerometer: Vector3::zeros(),
            flow_velocity: Vector3::zeros(),
            flow_velocity_printed_ned: None,
        }
    }
}

/// What corrects position and velocity.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Aiding {
    /// (7), with GNSS: the measurement signal, or `None` before the first fix (then the equations are integrated uncorrected).
    Gnss(Option<Signal>),
    /// (9), without: the altitude as p_D in NED, m (positive down); `None` leaves the vertical uncorrected.
    DeadReckoning {
        /// p_D from the altimeter, m.
        altitude_down_m: Option<f64>,
    },
}

/// Which pair of vectors corrects the attitude.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum AttitudeReference {
    /// (f̂ᵇ, v̂ᵇ) and (f̂ⁿ, v̂) (Fusini (8)), subject to the guard. The flow velocity in the input is needed.
    FlowVelocity,
    /// (f̂ᵇ, m) and (f̂ⁿ, m_n). Our extension: a hovering vehicle has |f × v| ≈ 0, so that (8) is of no use there, while the
    /// magnetic field never goes away. Subject to [`FusiniParams::min_magnetic_sine`] instead of the guard. In dead reckoning it needs
    /// gains as soft as [`DeadReckoningGains::km`]
    /// and is the worse choice in banked turns under a steep field (2-3 % of drift where the flow triad has 0.3 %); with the printed ones flow noise, by way of f̂ⁿ, turns the attitude over.
    Magnetic(MagneticPair),
    /// None: J = 0.
    None,
}

/// What one IMU sample brings, over (t_{k−1}, t_k].
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct FusiniInput {
    /// Length of the interval, s.
    pub dt_s: f64,
    /// Mean angular rate in body axes, rad/s (ω_m).
    pub angular_rate_body: Vector3<f64>,
    /// Mean specific force in body axes, m/s² (f_m).
    pub specific_force_body: Vector3<f64>,
    /// Gravity in NED, m/s².
    pub gravity_ned: Vector3<f64>,
    /// The Earth's rate in NED, rad/s.
    pub earth_rate_ned: Vector3<f64>,
    /// Latest flow velocity in body axes, m/s (v_m, with its bias; held between frames). `None` when there is none or it is stale:
    /// no velocity triad and no velocity correction in dead reckoning then.
    pub flow_velocity_body: Option<Vector3<f64>>,
    /// GNSS or dead reckoning.
    pub aiding: Aiding,
    /// Vectors for the attitude.
    pub reference: AttitudeReference,
    /// Diagonal of K_P for this step instead of the parameters'. In dead reckoning on the flow velocity a tenth of it: in circles the
    /// injection itself drives yaw. On the magnetic triad leave it as it is. The gate goes before it.
    pub k_p_override: Option<Vector3<f64>>,
}

/// One IMU sample through Fusini's observer: (6)-(8) with GNSS, (6a), (8), (9) in dead reckoning, as `sub_steps` forward-Euler steps
/// whose right-hand sides use old values (but for the gyro bias in the attitude equation).
///
/// f̂ᵇ = f_m − b_f, v̂ᵇ = v_m − b_v, f̂ⁿ = R̂f̂ᵇ + ξ; J from the triads of the reference, zero under Assumption 3's guard.
/// With GNSS: p̂ and v̂ as Grip (6) with Coriolis −2ω_e × v̂; dead reckoning: e_D = p_D − p̂_D acts on the D components only and
/// e_v = diag(1,1,0)(R̂v̂ᵇ − v̂); ξ̇ = −σK_P J f̂ᵇ + K_ξ e; Ṙ = R̂S(ω_m − b̂ − R̂ᵀω_e) + σK_P J. The gyro bias moves with GNSS only.
///
/// # Errors
/// [`StepRefusal`] when an input is not finite or the interval is out of (0, 1] s; nothing is changed then.
pub fn step(
    params: &FusiniParams,
    state: &mut ObserverState,
    biases: &mut FusiniBiases,
    input: &FusiniInput,
) -> Result<StepReport, StepRefusal> {
    let zero = Vector3::zeros();
    let (signal, altitude) = match input.aiding {
        Aiding::Gnss(signal) => (signal, 0.0),
        Aiding::DeadReckoning { altitude_down_m } => (None, altitude_down_m.unwrap_or(0.0)),
    };
    check(
        input.dt_s,
        &[
            &input.angular_rate_body,
            &input.specific_force_body,
            &input.gravity_ned,
            &input.earth_rate_ned,
            input.flow_velocity_body.as_ref().unwrap_or(&zero),
            signal.as_ref().map_or(&zero, |s| &s.position_ned),
            signal.as_ref().map_or(&zero, |s| &s.velocity_ned),
            &Vector3::new(altitude, 0.0, 0.0),
        ],
    )?;
    let n = params.sub_steps.max(1);
    let h = input.dt_s / f64::from(n);
    let mut aiding = input.aiding;
    let mut report = StepReport { acceleration_ned: zero, injection: None, gated: false, signal: None };
    for _ in 0..n {
        let sub = sub_step(params, state, biases, input, &aiding, h);
        if let Aiding::Gnss(Some(signal)) = &mut aiding {
            signal.advance(h, &sub.acceleration_ned, &input.earth_rate_ned);
        }
        report.acceleration_ned += sub.acceleration_ned / f64::from(n);
        report.injection = sub.injection;
        report.gated = sub.gated;
    }
    if let Aiding::Gnss(signal) = aiding {
        report.signal = signal;
    }
    if let (Some(d), Aiding::Gnss(_)) = (biases.flow_velocity_printed_ned, input.aiding) {
        biases.flow_velocity = -state.r_hat.tr_mul(&d);
    }
    Ok(report)
}

fn sub_step(
    params: &FusiniParams,
    state: &mut ObserverState,
    biases: &mut FusiniBiases,
    input: &FusiniInput,
    aiding: &Aiding,
    h: f64,
) -> StepReport {
    let old = *state;
    let f_body = input.specific_force_body - biases.accelerometer;
    let f_ned = old.specific_force_ned(&f_body);
    let v_body = input.flow_velocity_body.map(|v_m| {
        let mut v = v_m - biases.flow_velocity;
        if params.predict_flow_z {
            v.z = old.r_hat.column(2).dot(&old.velocity_ned);
        }
        v
    });
    let j = attitude_injection(params, input, &old, &f_body, &f_ned, v_body.as_ref());
    let k_p = input.k_p_override.unwrap_or(params.k_p);
    let gains = AttitudeGains::choose(params.gate, k_p, params.k_i, j.map(|j| j.norm()));

    let acceleration_ned = f_ned + input.gravity_ned;
    let coriolis = -2.0 * input.earth_rate_ned.cross(&old.velocity_ned);
    let (dp, dv, dxi) = match aiding {
        Aiding::Gnss(signal) => {
            let k = &params.gains;
            let (e_p, e_v) = signal.map_or((Vector3::zeros(), Vector3::zeros()), |s| {
                s.errors(&old.position_ned, &old.velocity_ned)
            });
            biases.accelerometer -= h * params.k_f * old.r_hat.tr_mul(&e_p);
            (k.pp * e_p + k.pv * e_v, k.vp * e_p + k.vv * e_v, k.xp * e_p + k.xv * e_v)
        }
        Aiding::DeadReckoning { altitude_down_m } => {
            let k = &params.dead_reckoning;
            let e_d = altitude_down_m.map_or(0.0, |d| d - old.position_ned.z);
            let e_d = Vector3::new(0.0, 0.0, e_d);
            let mut e_v = v_body.map_or(Vector3::zeros(), |v| old.r_hat * v - old.velocity_ned);
            e_v.z = 0.0;
            (k.pp * e_d, k.vp * e_d + k.vv * e_v, k.xp * e_d + k.xv * e_v)
        }
    };

    let delta_r = j.map_or_else(Matrix3::zeros, |j| {
        if matches!(aiding, Aiding::Gnss(_)) {
            state.gyro_bias = gains.advance_bias(&params.bias_bounds, &old.gyro_bias, &old.r_hat, &j, h);
        }
        attitude::scale_rows(&(params.sigma * h * gains.k_p), &j)
    });
    // The attitude takes the bias just updated, all else old values: so the reference trajectories have it.
    let body_rate = input.angular_rate_body - state.gyro_bias - old.r_hat.tr_mul(&input.earth_rate_ned);
    state.position_ned += h * (old.velocity_ned + dp);
    state.velocity_ned += h * (acceleration_ned + coriolis + dv);
    state.xi_ned += h * dxi - delta_r * f_body;
    state.r_hat = attitude::advance(params.discretisation, &old.r_hat, &delta_r, &body_rate, h);
    StepReport { acceleration_ned, injection: j, gated: gains.gated, signal: None }
}

/// J of (8), or of the magnetic extension.
fn attitude_injection(
    params: &FusiniParams,
    input: &FusiniInput,
    state: &ObserverState,
    f_body: &Vector3<f64>,
    f_ned: &Vector3<f64>,
    v_body: Option<&Vector3<f64>>,
) -> Option<Matrix3<f64>> {
    let (second_body, second_ned) = match &input.reference {
        AttitudeReference::FlowVelocity => {
            let v_body = v_body?;
            let weak = |f: &Vector3<f64>, v: &Vector3<f64>| f.cross(v).norm() < params.guard;
            if weak(f_body, v_body) || weak(f_ned, &state.velocity_ned) {
                return None;
            }
            (*v_body, state.velocity_ned)
        }
        AttitudeReference::Magnetic(m) => {
            let parallel = |f, m| sine_between(f, m) < params.min_magnetic_sine;
            if parallel(f_body, &m.field_body) || parallel(f_ned, &m.field_ned) {
                return None;
            }
            (m.field_body, m.field_ned)
        }
        AttitudeReference::None => return None,
    };
    let body = normalised_triad(f_body, &second_body)?;
    let ned = normalised_triad(f_ned, &second_ned)?;
    Some(injection(&ned, &body, &state.r_hat))
}

/// Low-pass of the flow velocity bias at a new flow frame, while GNSS is there (Fusini, Section IV, last paragraph but in body
/// axes, see [`FlowBiasForm`]). `velocity_ned` is the GNSS velocity at the frame (the predictor's), `interval_s` the time since the
/// previous frame. Samples that are not finite are ignored; returns whether the bias was updated.
pub fn update_flow_bias(
    params: &FusiniParams,
    state: &ObserverState,
    biases: &mut FusiniBiases,
    flow_velocity_body: &Vector3<f64>,
    velocity_ned: &Vector3<f64>,
    interval_s: f64,
) -> bool {
    if check(interval_s.min(1.0), &[flow_velocity_body, velocity_ned]).is_err() {
        return false;
    }
    let alpha = -(-interval_s / params.flow_bias_time_constant_s).exp_m1();
    match params.flow_bias {
        FlowBiasForm::Body => {
            let sample = flow_velocity_body - state.r_hat.tr_mul(velocity_ned);
            biases.flow_velocity += alpha * (sample - biases.flow_velocity);
        }
        FlowBiasForm::AsPrinted => {
            let sample = velocity_ned - state.r_hat * flow_velocity_body;
            let d = biases.flow_velocity_printed_ned.unwrap_or_else(Vector3::zeros);
            let d = d + alpha * (sample - d);
            biases.flow_velocity_printed_ned = Some(d);
            biases.flow_velocity = -state.r_hat.tr_mul(&d);
        }
    }
    true
}

#[cfg(test)]
mod tests {
    use super::*;

    fn cruise() -> FusiniInput {
        FusiniInput {
            dt_s: 0.01,
            angular_rate_body: Vector3::zeros(),
            specific_force_body: Vector3::new(0.0, 0.0, -9.81),
            gravity_ned: Vector3::new(0.0, 0.0, 9.81),
            earth_rate_ned: Vector3::zeros(),
            flow_velocity_body: Some(Vector3::new(20.0, 0.0, 0.0)),
            aiding: Aiding::DeadReckoning { altitude_down_m: Some(-100.0) },
            reference: AttitudeReference::FlowVelocity,
            k_p_override: None,
        }
    }

    fn start(speed: f64) -> ObserverState {
        let down = Vector3::new(0.0, 0.0, -100.0);
        ObserverState::new(Matrix3::identity(), down, Vector3::new(speed, 0.0, 0.0))
    }

    fn run(state: &mut ObserverState, input: &FusiniInput) -> Result<StepReport, StepRefusal> {
        step(&FusiniParams::tuned(), state, &mut FusiniBiases::default(), input)
    }

    #[test]
    fn steady_cruise_is_an_equilibrium_of_dead_reckoning() {
        let mut s = start(20.0);
        for _ in 0..1000 {
            run(&mut s, &cruise()).unwrap();
        }
        assert!((s.position_ned - Vector3::new(200.0, 0.0, -100.0)).norm() < 1e-9);
        assert!((s.r_hat - Matrix3::identity()).norm() < 1e-12);
    }

    #[test]
    fn assumption_3_guards_the_velocity_triad_at_low_speed() {
        let slow = FusiniInput { flow_velocity_body: Some(Vector3::new(0.4, 0.0, 0.0)), ..cruise() };
        assert_eq!(run(&mut start(0.4), &slow).unwrap().injection_norm(), None);
        assert_eq!(run(&mut start(0.4), &cruise()).unwrap().injection_norm(), None, "in NED, too");
        assert!(run(&mut start(20.0), &cruise()).unwrap().injection_norm().is_some());
    }

    #[test]
    fn refused_input_leaves_the_state_alone() {
        let bad = [
            FusiniInput { flow_velocity_body: Some(Vector3::repeat(f64::NAN)), ..cruise() },
            FusiniInput { aiding: Aiding::DeadReckoning { altitude_down_m: Some(f64::NAN) }, ..cruise() },
            FusiniInput { specific_force_body: Vector3::repeat(f64::INFINITY), ..cruise() },
        ];
        for input in bad {
            let mut s = start(20.0);
            assert_eq!(run(&mut s, &input), Err(StepRefusal::NotFinite));
            assert_eq!(s, start(20.0));
        }
    }

    #[test]
    fn biases_are_frozen_in_dead_reckoning() {
        let mut s = start(20.0);
        s.gyro_bias = Vector3::new(1e-3, 2e-3, 3e-3);
        let before = s.gyro_bias;
        let off = FusiniInput { flow_velocity_body: Some(Vector3::new(20.0, 3.0, 0.0)), ..cruise() };
        run(&mut s, &off).unwrap();
        assert_eq!(s.gyro_bias, before);
        run(&mut s, &FusiniInput { aiding: Aiding::Gnss(None), ..off }).unwrap();
        assert_ne!(s.gyro_bias, before);
    }
}
