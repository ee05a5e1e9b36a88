//! Normal gravity of WGS-84.

use super::wgs84::{ECCENTRICITY_SQ, FLATTENING, SEMI_MAJOR_M};
use nalgebra::Vector3;

/// Standard gravity g₀, m/s² (3rd CGPM, 1901): the g in the units of accelerometers. Exact.
pub const STANDARD_GRAVITY_MPS2: f64 = 9.806_65;
/// The Earth's gravity to three digits, m/s²: for gates, budgets and shapes of flight, and where no place is known yet. It is within 0.3 % of
/// [`normal_gravity`] everywhere on the ground.
pub const NOMINAL_GRAVITY_MPS2: f64 = 9.81;
/// Normal gravity at the equator γ_e, m/s² (NIMA TR8350.2, table 3.4).
const GAMMA_EQUATOR: f64 = 9.780_325_335_9;
/// Somigliana's constant k (NIMA TR8350.2, table 3.4).
const SOMIGLIANA_K: f64 = 0.001_931_852_652_41;
/// m = ω²a²b/GM (NIMA TR8350.2, table 3.4).
const M: f64 = 0.003_449_786_506_84;

/// Magnitude of normal gravity, m/s², at a geodetic latitude and a height (see [`Geodetic`](super::Geodetic) for which).
///
/// Somigliana's closed formula γ = γ_e (1 + k sin²φ)/√(1 − e² sin²φ) with the second-order height correction
/// γ_h = γ [1 − (2/a)(1 + f + m − 2f sin²φ) h + (3/a²) h²] (NIMA TR8350.2, eq. (4-1) and (4-3)). Good to 10⁻⁶ m/s² of the
/// normal field below 20 km; true gravity differs from it by up to some 10⁻³ m/s² (anomalies), which the filters carry as
/// accelerometer bias.
pub fn normal_gravity(latitude_rad: f64, height_m: f64) -> f64 {
    let s2 = latitude_rad.sin().powi(2);
    let surface = GAMMA_EQUATOR * (1.0 + SOMIGLIANA_K * s2) / (1.0 - ECCENTRICITY_SQ * s2).sqrt();
    let h = height_m / SEMI_MAJOR_M;
    surface * (1.0 - 2.0 * (1.0 + FLATTENING + M - 2.0 * FLATTENING * s2) * h + 3.0 * h * h)
}

/// The gravity vector [0, 0, γ_h] in NED, m/s² (Grip (1b), Fusini Section II). The deflection of normal gravity from the
/// ellipsoid's normal aloft (below 10⁻⁵ m/s² at 2 km) is left out.
pub fn gravity_ned(latitude_rad: f64, height_m: f64) -> Vector3<f64> {
    Vector3::new(0.0, 0.0, normal_gravity(latitude_rad, height_m))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_defining_values_of_wgs84_are_met() {
        assert!((normal_gravity(0.0, 0.0) - 9.780_325_335_9).abs() < 1e-12);
        assert!((normal_gravity(90f64.to_radians(), 0.0) - 9.832_184_937_9).abs() < 1e-9);
        // Mean and 45° values as tabulated for GRS-80/WGS-84.
        assert!((normal_gravity(45f64.to_radians(), 0.0) - 9.806_197_7).abs() < 1e-6);
    }

    #[test]
    fn gravity_falls_with_height_by_the_free_air_gradient() {
        let g = |h: f64| normal_gravity(0.8, h);
        assert!(((g(1000.0) - g(0.0)) / 1000.0 + 3.086e-6).abs() < 2e-9);
        assert!(g(-100.0) > g(0.0));
    }

    #[test]
    fn nominal_gravity_is_that_of_everywhere_to_three_parts_in_a_thousand() {
        for g in [STANDARD_GRAVITY_MPS2, NOMINAL_GRAVITY_MPS2] {
            for latitude_deg in [-90.0f64, -45.0, 0.0, 30.0, 60.0] {
                assert!((normal_gravity(latitude_deg.to_radians(), 0.0) / g - 1.0).abs() < 3.1e-3);
            }
        }
    }

    #[test]
    fn the_vector_points_down() {
        let g = gravity_ned(-0.5, 300.0);
        assert_eq!((g.x, g.y), (0.0, 0.0));
        assert!(g.z > 9.77);
    }
}
