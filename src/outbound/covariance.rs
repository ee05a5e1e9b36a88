//! The covariance that is sent: what makes a filter that takes every message for a new, independent measurement weigh ours as they deserve.
//!
//! Our errors last. The velocity's are a flow's bias, a wind, a heading; they stay for seconds to minutes, and 30 messages a second repeat them. The
//! position's are nearly all of them common to this second and the last. Both autopilots take the variance for that of white noise. PX4, told of 0.0047
//! (m/s)² at 30 Hz, believes a velocity that is off for seconds to a centimetre a second: its own position was 0.99 m rms beside good GNSS, 0.17 m with
//! a floor of 0.5 m/s under it, 0.11 m without our velocity. ArduPlane, told of 40 m, never corrects its position by ours, follows our velocity, and was
//! 43 m from our position when it was switched back.
//!
//! **Velocity.** An error with variance s² and correlation time τ (first-order Markov), sampled at f, has the correlation ρ = exp(−1/(fτ)) from one message to
//! the next. The mean of n ≫ fτ of them has the variance (s²/n)(1+ρ)/(1−ρ) (Bartlett 1935, "Some aspects of the time-correlation problem in regard to tests of
//! significance"), that of n white ones with R has R/n. They tell as much if
//!
//! R = s² (1+ρ)/(1−ρ) = s² coth(1/(2fτ)) ≈ 2fτ s².
//!
//! τ is [`CORRELATION_S`], and below [`LEAST_VELOCITY_MPS`] nothing is claimed. That holds as long as there is GNSS to weigh ours against. In an outage there is
//! nothing else: an autopilot that hardly weighs our velocity follows its accelerometers instead. PX4, told of R = 7 (m/s)² in the seconds between the loss
//! and its reset to us, walked off at 0.2 m/s² while our velocity was right to 0.2 m/s, and stepped by 4.2 m; told of s², by 0.3-1.4 m. So in Holdover s² itself
//! is sent, and no less than [`LEAST_ALONE_MPS`].
//!
//! **Position**, where the autopilot is to follow it: what it is off by against its own past of a second,
//! P = σ₀² I + T² s², T = 1 s, σ₀ = [`NOISE_M`], and never more than what is known of it absolutely. How far it may be off from the truth is in `quality`, which
//! both autopilots have a limit for (VISO_QUAL_MIN, EKF2_EV_QMIN). ArduPilot is always to follow: it uses us only on a source set of ours. PX4 uses our position beside
//! GNSS, too, with a bias that it learns; there, the absolute variance keeps ours from outweighing GNSS, and from the loss on the short-term one is sent, by which it resets
//! to us and stays.
//!
//! `outbound.covariance = "absolute"` sends the navigator's own covariance, for whoever reads it as that.

use nalgebra::Matrix3;

use crate::geo::Ned;
use crate::navigator::solution::{Mode, Solution};

use super::handover::StandsOn;
use super::settings::{Covariance, OutboundSettings, Profile};

/// Least standard deviation of the velocity that is claimed to a filter that takes it for white, beside GNSS and in an outage, m/s.
const LEAST_VELOCITY_MPS: f64 = 0.5;
const LEAST_ALONE_MPS: f64 = 0.1;
/// For how long an error of the velocity lasts with GNSS, s: the wander of a receiver as the filter passes it on.
const CORRELATION_S: f64 = 2.0;
/// Noise of the position from one message to the next, m.
const NOISE_M: f64 = 0.2;
/// The position is off against itself of this long ago by what the velocity is off, s.
const PAST_S: f64 = 1.0;

/// (1+ρ)/(1−ρ) for ρ = exp(−1/(fτ)).
fn inflation(rate_hz: f64, tau_s: f64) -> f64 {
    1.0 / (0.5 / (rate_hz * tau_s)).tanh()
}

/// The covariances of position, m², and velocity, m²/s², that are sent, NED.
pub(super) fn sent(
    solution: &Solution,
    settings: &OutboundSettings,
    standing: StandsOn,
) -> (Ned<Matrix3<f64>>, Ned<Matrix3<f64>>) {
    let (p, v) = (solution.position_covariance, solution.velocity_covariance);
    if settings.covariance == Covariance::Absolute {
        return (p, v);
    }
    let beside_gnss = solution.mode == Mode::Aided || standing == StandsOn::Gnss;
    let position = match settings.profile {
        Profile::Px4 if beside_gnss => p.raw(),
        Profile::Px4 | Profile::Ardupilot => short_term(&p.raw(), &v.raw()),
    };
    let (factor, least_mps) = match solution.mode {
        Mode::Holdover => (1.0, LEAST_ALONE_MPS),
        _ => (inflation(settings.rate_hz, CORRELATION_S), LEAST_VELOCITY_MPS),
    };
    let mut velocity = v.raw() * factor;
    for axis in 0..3 {
        velocity[(axis, axis)] = velocity[(axis, axis)].max(least_mps.powi(2));
    }
    (Ned::new(position), Ned::new(velocity))
}

/// See the module's documentation. Without the covariances between the axes, which neither autopilot reads.
fn short_term(p: &Matrix3<f64>, v: &Matrix3<f64>) -> Matrix3<f64> {
    let variances = p.diagonal().zip_map(&v.diagonal(), |p, v| p.min(NOISE_M.powi(2) + PAST_S.powi(2) * v));
    Matrix3::from_diagonal(&variances)
}

#[cfg(test)]
mod tests {
    use super::super::settings::{Carriage, Publish};
    use super::*;
    use crate::geo::{Body, BodyToNed};
    use crate::navigator::solution::VelocitySource;
    use crate::time::AutopilotTime;
    use nalgebra::{Matrix2, Vector2, Vector3};

    const SETTINGS: OutboundSettings = OutboundSettings {
        coasting: super::super::Coasting::Briefly,
        publish: Publish::Auto,
        covariance: Covariance::Correlated,
        carriage: Carriage::Odometry,
        profile: Profile::Ardupilot,
        rate_hz: 30.0,
        worst_sigma_m: 50.0,
        farewell_s: 0.25,
    };

    fn solution(mode: Mode, sigma_m: f64, velocity_variance: f64) -> Solution {
        let zero = Vector3::zeros();
        Solution {
            time: AutopilotTime::from_micros(0),
            mode,
            velocity_source: VelocitySource::Flow,
            position: Ned::new(zero),
            velocity: Ned::new(zero),
            glide_velocity: Ned::new(zero),
            attitude: BodyToNed::from_matrix(&Matrix3::identity()),
            angular_rate: Body::new(zero),
            position_covariance: Ned::new(Matrix3::identity() * sigma_m.powi(2)),
            velocity_covariance: Ned::new(Matrix3::identity() * velocity_variance),
            attitude_variance: zero,
            reset_counter: 0,
        }
    }

    #[test]
    fn as_many_white_samples_tell_as_much_as_correlated_ones() {
        for (rate_hz, tau_s) in [(30.0, 2.0), (30.0, 10.0), (5.0, 0.1)] {
            let rho = f64::exp(-1.0 / (rate_hz * tau_s));
            let n = 20_000;
            // Σ_i Σ_j ρ^|i−j| over n²: the variance of their mean for s = 1.
            let sum: f64 = (1..n).map(|k| 2.0 * f64::from(n - k) * rho.powi(k)).sum();
            let variance = (f64::from(n) + sum) / f64::from(n).powi(2);
            let white = inflation(rate_hz, tau_s) / f64::from(n);
            assert!((variance / white - 1.0).abs() < 0.02, "{rate_hz} {tau_s}: {variance} {white}");
        }
        assert!((inflation(30.0, 0.001) - 1.0).abs() < 1e-6, "what is white is left as it is");
    }

    #[test]
    fn a_velocity_is_not_claimed_to_be_white() {
        let (_, v) = sent(&solution(Mode::Aided, 2.0, 0.0047), &SETTINGS, StandsOn::Gnss);
        // 2 · 30 Hz · 2 s · 0.0047.
        assert!((v.raw()[(0, 0)] - 0.564).abs() < 0.001, "{}", v.raw());
        // Nothing else is there to be outweighed.
        let (_, v) = sent(&solution(Mode::Holdover, 2.0, 0.03), &SETTINGS, StandsOn::Ours);
        assert_eq!(v.raw()[(0, 0)], 0.03);
        let (_, v) = sent(&solution(Mode::Holdover, 2.0, 0.0047), &SETTINGS, StandsOn::Gnss);
        assert!((v.raw()[(0, 0)] - 0.01).abs() < 1e-12, "{}", v.raw());
        let (_, v) = sent(&solution(Mode::Aided, 2.0, 1e-6), &SETTINGS, StandsOn::Gnss);
        assert_eq!(v.raw()[(1, 1)], 0.25);
    }

    #[test]
    fn px4_is_not_outweighed_beside_gnss_and_follows_from_the_loss_on() {
        let px4 = OutboundSettings { profile: Profile::Px4, ..SETTINGS };
        let north = |mode, standing| sent(&solution(mode, 2.0, 0.01), &px4, standing).0.raw()[(0, 0)];
        assert_eq!(north(Mode::Aided, StandsOn::Unknown), 4.0);
        assert_eq!(north(Mode::Holdover, StandsOn::Gnss), 4.0, "it has not lost it yet");
        assert!((north(Mode::Holdover, StandsOn::Ours) - 0.05).abs() < 1e-12);
        assert!((north(Mode::Holdover, StandsOn::Unknown) - 0.05).abs() < 1e-12);
    }

    #[test]
    fn what_is_known_better_is_not_claimed_worse_and_researchers_get_what_is() {
        let near = solution(Mode::Holdover, 0.05, 0.01);
        assert!((sent(&near, &SETTINGS, StandsOn::Ours).0.raw()[(0, 0)] - 0.0025).abs() < 1e-12);
        let absolute = OutboundSettings { covariance: Covariance::Absolute, ..SETTINGS };
        let s = solution(Mode::Holdover, 40.0, 0.01);
        let (p, v) = sent(&s, &absolute, StandsOn::Ours);
        assert_eq!((p, v), (s.position_covariance, s.velocity_covariance));
    }

    /// An autopilot's filter (position and velocity, white acceleration of 0.35 m/s² at 30 Hz) that starts 43 m off and is sent a vehicle at rest: how far it
    /// is off after 20 s.
    fn after_20_s(covariance: Covariance) -> f64 {
        let settings = OutboundSettings { covariance, ..SETTINGS };
        let (p, v) = sent(&solution(Mode::Rejoining, 40.0, 0.02), &settings, StandsOn::Ours);
        let noise = Matrix2::new(p.raw()[(0, 0)], 0.0, 0.0, v.raw()[(0, 0)]);
        let (dt, mut x, mut c) = (1.0_f64 / 30.0, Vector2::new(43.0, 0.0), Matrix2::new(1.0, 0.0, 0.0, 0.1));
        let f = Matrix2::new(1.0, dt, 0.0, 1.0);
        for _ in 0..600 {
            x = f * x;
            c = f * c * f.transpose() + Matrix2::new(0.0, 0.0, 0.0, (0.35 * dt).powi(2));
            let gain = c * (c + noise).try_inverse().unwrap();
            x -= gain * x;
            c -= gain * c;
        }
        x.x.abs()
    }

    #[test]
    fn an_autopilot_that_was_43_m_off_follows() {
        assert!(after_20_s(Covariance::Correlated) < 1.0, "{}", after_20_s(Covariance::Correlated));
        assert!(after_20_s(Covariance::Absolute) > 20.0, "{}", after_20_s(Covariance::Absolute));
    }
}
