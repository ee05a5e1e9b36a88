//! The error model of the inertial altitude, the barometer and GNSS that the published altimeters share.
//!
//! The altimeters are indirect: their state is the error of the inertial altitude,
//! x = [ΔH_I, ΔW_z, Δa_z, Δg, B], in m, m/s, m/s², m/s², m, all positive up; a height is H = H_I − ΔH_I, (21). What they measure is
//! z_IBI = H_I − H_B = ΔH_I − B + v and z_IIG = H_I − H_G = ΔH_I + v. Contreras and Hajiyev, (1)-(18).

use super::tuning::{LONGEST_INTERVAL_S, MOST_STEPS};
use nalgebra::{Matrix5, RowVector5, Vector5};

/// Rows of the two measurements, (7) and (14).
pub(super) const H_IBI: RowVector5<f64> = RowVector5::new(1.0, 0.0, 0.0, 0.0, -1.0);
pub(super) const H_IIG: RowVector5<f64> = RowVector5::new(1.0, 0.0, 0.0, 0.0, 0.0);

/// The parameters of (11)-(18).
///
/// The three Markov processes are given by their rate and by the standard deviation that they have when they have run for long. The
/// paper gives the noise that drives Δa_z and Δg in every step instead ([`stationary_sigma`] converts), which would mean another
/// process at another sampling rate; real data has no fixed one.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct ErrorModel {
    /// α: rate at which the error of the vertical acceleration is forgotten, 1/s.
    pub alpha_per_s: f64,
    /// β_g: the same for the gravity error, 1/s.
    pub beta_g_per_s: f64,
    /// β = 1/τ: the same for the barometer's offset, 1/s.
    pub beta_per_s: f64,
    /// Stationary standard deviation of the vertical acceleration's error Δa_z, m/s².
    pub accel_sigma_mps2: f64,
    /// Stationary standard deviation of the gravity error Δg, m/s².
    pub gravity_sigma_mps2: f64,
    /// Stationary standard deviation of the barometer's offset B, m.
    pub baro_offset_sigma_m: f64,
    /// σ_INS: white noise of the inertial altitude in both measurements, m.
    pub inertial_noise_m: f64,
    /// σ_B: white noise of one barometer height, m.
    pub baro_noise_m: f64,
    /// σ_GPS: white noise of one GNSS height, m.
    pub gps_noise_m: f64,
    /// R_0: radius of the Earth, m.
    pub earth_radius_m: f64,
    /// H: flight altitude, m.
    pub altitude_m: f64,
    /// g: gravity, m/s².
    pub gravity_mps2: f64,
    /// Standard deviation of ΔH_I at the start, m.
    pub start_height_sigma_m: f64,
    /// Standard deviation of ΔW_z at the start, m/s.
    pub start_speed_sigma_mps: f64,
    /// The longest step (11) is taken in, s: what is longer is divided. (11) is a first-order solution, so this is well below 1/α.
    pub longest_step_s: f64,
}

/// Standard deviation in the long run of x(i) = (1 − rate Td) x(i−1) + Td u with u of standard deviation `driving`:
/// Td·driving/√(1 − (1 − rate Td)²).
pub fn stationary_sigma(driving: f64, rate_per_s: f64, step_s: f64) -> f64 {
    step_s * driving / forgotten(rate_per_s, step_s).sqrt()
}

/// 1 − rate dt, (5), (6) and the last row of (11); never negative.
fn kept(rate_per_s: f64, dt_s: f64) -> f64 {
    (1.0 - rate_per_s * dt_s).max(0.0)
}

/// The share of a process's variance that a step renews: 1 − (1 − rate dt)².
fn forgotten(rate_per_s: f64, dt_s: f64) -> f64 {
    let kept = kept(rate_per_s, dt_s);
    (1.0 - kept) * (1.0 + kept)
}

impl ErrorModel {
    /// Table 1 of the paper, at its Td = 0.5 s. The driving noise of Δa_z and Δg is 2·10⁻⁵ m/s² a step; σ_B = 1 m is both the stationary
    /// offset of the barometer and its white noise; σ_w is not used by any of the paper's equations. The start, which the paper does not
    /// give, is 3 m, 0.1 m/s and stationary values.
    pub fn table_1() -> Self {
        let (step_s, driving) = (0.5, 2e-5);
        let (alpha_per_s, beta_g_per_s) = (0.001, 0.005);
        Self {
            alpha_per_s,
            beta_g_per_s,
            beta_per_s: 0.01,
            accel_sigma_mps2: stationary_sigma(driving, alpha_per_s, step_s),
            gravity_sigma_mps2: stationary_sigma(driving, beta_g_per_s, step_s),
            baro_offset_sigma_m: 1.0,
            inertial_noise_m: 3.0,
            baro_noise_m: 1.0,
            gps_noise_m: 2.23,
            earth_radius_m: 6_378_150.0,
            altitude_m: 1000.0,
            gravity_mps2: 9.81,
            start_height_sigma_m: 3.0,
            start_speed_sigma_mps: 0.1,
            longest_step_s: step_s,
        }
    }

    /// For a drone's own sensors, where Table 1 describes an aircraft's inertial navigation system. These are orders of magnitude of
    /// such sensors, not the result of an identification:
    ///
    /// - Δa_z: 0.3 m/s² for about 1 s. What is left of the specific force of a MEMS accelerometer on a vibrating airframe, rotated by an
    ///   attitude that is wrong by a degree or two in manoeuvres; it changes with the manoeuvre.
    /// - Δg: 0.05 m/s² for 1000 s. It enters (4) just as Δa_z does, so it takes the slow part: the accelerometer's bias, left over from the
    ///   navigator's own estimate and drifting with temperature. Gravity itself is known to 10⁻³ m/s².
    /// - B: 1 m for 1000 s, √(2β)·σ = 0.045 m/√s: weather, the warming sensor, airflow at the static port, from when the pressure altitude
    ///   was aligned with the GNSS height.
    /// - White noise: 0.4 m of one barometer height (a few Pa, with the airflow of the rotors), 2 m of one GNSS height (a receiver without
    ///   corrections; its slow wander is not in the model), none of the inertial altitude: that is an integral, it is smooth.
    /// - The start: 3 m, 0.5 m/s.
    pub fn recorded() -> Self {
        Self {
            alpha_per_s: 1.0,
            beta_g_per_s: 1e-3,
            beta_per_s: 1e-3,
            accel_sigma_mps2: 0.3,
            gravity_sigma_mps2: 0.05,
            baro_offset_sigma_m: 1.0,
            inertial_noise_m: 0.0,
            baro_noise_m: 0.4,
            gps_noise_m: 2.0,
            start_speed_sigma_mps: 0.5,
            longest_step_s: 0.1,
            altitude_m: 0.0,
            ..Self::table_1()
        }
    }

    /// φ over one step of `dt` s, (11). The upper left four rows and columns are (16).
    pub fn transition(&self, dt_s: f64) -> Matrix5<f64> {
        let mut phi = Matrix5::identity();
        phi[(0, 1)] = dt_s;
        phi[(1, 0)] = 2.0 * self.gravity_mps2 * dt_s / (self.earth_radius_m + self.altitude_m);
        phi[(1, 2)] = dt_s;
        phi[(1, 3)] = dt_s;
        for (i, rate) in [(2, self.alpha_per_s), (3, self.beta_g_per_s), (4, self.beta_per_s)] {
            phi[(i, i)] = kept(rate, dt_s);
        }
        phi
    }

    /// Diagonal of G Q Gᵀ over one step of `dt` s, (12) and (27): what a step gives back to each process of the variance that φ takes.
    pub fn process_noise(&self, dt_s: f64) -> Vector5<f64> {
        let renewed = |sigma: f64, rate: f64| sigma * sigma * forgotten(rate, dt_s);
        Vector5::new(
            0.0,
            0.0,
            renewed(self.accel_sigma_mps2, self.alpha_per_s),
            renewed(self.gravity_sigma_mps2, self.beta_g_per_s),
            renewed(self.baro_offset_sigma_m, self.beta_per_s),
        )
    }

    /// Standard deviations of the state at the start.
    pub fn start_sigmas(&self) -> Vector5<f64> {
        Vector5::new(
            self.start_height_sigma_m,
            self.start_speed_sigma_mps,
            self.accel_sigma_mps2,
            self.gravity_sigma_mps2,
            self.baro_offset_sigma_m,
        )
    }

    /// R of the baro-inertial measurement, (13): σ_INS² + σ_B², m².
    pub fn baro_variance(&self) -> f64 {
        self.inertial_noise_m * self.inertial_noise_m + self.baro_noise_m * self.baro_noise_m
    }

    /// R of the inertial-GNSS measurement, (18): σ_INS² + σ_GPS², m².
    pub fn gps_variance(&self) -> f64 {
        self.inertial_noise_m * self.inertial_noise_m + self.gps_noise_m * self.gps_noise_m
    }

    /// How an interval is divided: the number of steps and their length. `None` for an interval that is not positive and finite.
    pub(super) fn steps(&self, dt_s: f64) -> Option<(usize, f64)> {
        if !(dt_s > 0.0 && dt_s.is_finite()) {
            return None;
        }
        let dt_s = dt_s.min(LONGEST_INTERVAL_S);
        // A rounding error in the interval is no reason for a second step.
        let n = (dt_s / self.longest_step_s - 1e-9).ceil().clamp(1.0, MOST_STEPS);
        Some((n as usize, dt_s / n))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_processes_keep_their_level_at_any_rate() {
        let model = ErrorModel::recorded();
        for dt in [0.005, 0.1, 0.5, 5.0] {
            let (phi, q, p) = (model.transition(dt), model.process_noise(dt), model.start_sigmas());
            for i in 2..5 {
                let after = phi[(i, i)] * phi[(i, i)] * p[i] * p[i] + q[i];
                assert!((after / (p[i] * p[i]) - 1.0).abs() < 1e-12, "{i} {dt}");
            }
        }
    }

    #[test]
    fn intervals_are_divided() {
        let model = ErrorModel::table_1();
        assert_eq!(model.steps(0.5), Some((1, 0.5)));
        assert_eq!(model.steps(0.1 + 0.4 + 1e-12), Some((1, 0.5 + 1e-12)));
        assert_eq!(model.steps(2.25), Some((5, 0.45)));
        assert_eq!(model.steps(1e9).map(|s| s.0), Some(20_000));
        for bad in [0.0, -1.0, f64::NAN, f64::INFINITY] {
            assert_eq!(model.steps(bad), None);
        }
    }
}
