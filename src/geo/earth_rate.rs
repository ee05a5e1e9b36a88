//! The Earth's rotation seen from the local frame.

use nalgebra::Vector3;

/// The Earth's rotation rate ω_e, rad/s (NIMA TR8350.2, table 3.1; Fusini, Section II).
pub const EARTH_RATE_RADPS: f64 = 7.292_115e-5;

/// The Earth's angular velocity in NED, rad/s: ω_e [cos μ, 0, −sin μ] at latitude μ (Fusini, Section II).
pub fn earth_rate_ned(latitude_rad: f64) -> Vector3<f64> {
    let (s, c) = latitude_rad.sin_cos();
    EARTH_RATE_RADPS * Vector3::new(c, 0.0, -s)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_earth_turns_eastwards() {
        // On the equator the axis is horizontal and points north; at the north pole it points up.
        assert!((earth_rate_ned(0.0) - EARTH_RATE_RADPS * Vector3::x()).norm() < 1e-20);
        assert!((earth_rate_ned(90f64.to_radians()) + EARTH_RATE_RADPS * Vector3::z()).norm() < 1e-18);
        assert!((earth_rate_ned(-0.6).norm() - EARTH_RATE_RADPS).abs() < 1e-18);
    }
}
