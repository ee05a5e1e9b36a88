//! The standard atmosphere (ISO 2533), troposphere: pressure, density and altitude.

/// Sea-level pressure of the standard atmosphere, Pa.
const P0_PA: f64 = 101_325.0;
/// Sea-level temperature, K, and lapse rate, K/m, of the standard atmosphere's troposphere.
const T0_K: f64 = 288.15;
const LAPSE_KPM: f64 = 0.0065;
/// R·L/g of dry air, and its inverse to as many digits.
const EXPONENT: f64 = 0.190_263;
const INVERSE_EXPONENT: f64 = 5.255_88;
/// Heights beyond the troposphere have no less than this of the sea level's temperature.
const LEAST_TEMPERATURE: f64 = 0.5;

/// Pressure altitude in the standard atmosphere's troposphere (ISO 2533), m:
/// H = (T0/L)·(1 − (p/p0)^(R·L/g)). The difference to the true altitude (weather, temperature) is the barometer offset that
/// [`crate::altimeter::Altimeter`] estimates. `None` for a pressure that is not positive and finite.
pub fn pressure_altitude_m(pressure_pa: f64) -> Option<f64> {
    (pressure_pa.is_finite() && pressure_pa > 0.0)
        .then(|| T0_K / LAPSE_KPM * (1.0 - (pressure_pa / P0_PA).powf(EXPONENT)))
}

/// True over equivalent airspeed, √(ρ₀/ρ), at a height above the sea in the standard atmosphere: autopilots send what the pitot tube
/// would show at sea level. ρ/ρ₀ = (1 − L h/T₀)^(g/(R L) − 1).
pub fn true_airspeed_factor(height_m: f64) -> f64 {
    let ratio = (1.0 - LAPSE_KPM * height_m.clamp(-1000.0, 11_000.0) / T0_K).max(0.1);
    ratio.powf(-0.5 * (1.0 / EXPONENT - 1.0))
}

/// Static pressure at a height above the sea, Pa: p₀ (1 − L h/T₀)^(g/(R L)).
pub fn static_pressure_pa(height_m: f64) -> f64 {
    P0_PA * relative_temperature(height_m).powf(INVERSE_EXPONENT)
}

/// ρ/ρ₀ at a height above the sea: (1 − L h/T₀)^(g/(R L) − 1).
pub fn density_ratio(height_m: f64) -> f64 {
    relative_temperature(height_m).powf(INVERSE_EXPONENT - 1.0)
}

/// Temperature over that of the sea level.
fn relative_temperature(height_m: f64) -> f64 {
    (1.0 - LAPSE_KPM / T0_K * height_m).max(LEAST_TEMPERATURE)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_standard_atmosphere_is_met() {
        // ISO 2533: 1000 m is 89 874.6 Pa, 5000 m is 54 019.9 Pa.
        assert!((pressure_altitude_m(89_874.6).unwrap() - 1000.0).abs() < 0.5);
        assert!((pressure_altitude_m(54_019.9).unwrap() - 5000.0).abs() < 2.0);
        assert_eq!(pressure_altitude_m(0.0), None);
        assert_eq!(pressure_altitude_m(f64::NAN), None);
    }

    #[test]
    fn pressure_and_its_altitude_are_each_others_inverse() {
        for height in [-100.0, 0.0, 1000.0, 5000.0] {
            assert!((pressure_altitude_m(static_pressure_pa(height)).unwrap() - height).abs() < 0.01);
            let factor = density_ratio(height).powf(-0.5);
            assert!((factor - true_airspeed_factor(height)).abs() < 1e-5);
        }
    }

    #[test]
    fn thin_air_makes_for_a_higher_true_airspeed() {
        // ISO 2533: 1.112 kg/m³ at 1000 m, 0.7361 kg/m³ at 5000 m, of 1.225 kg/m³.
        assert!((true_airspeed_factor(0.0) - 1.0).abs() < 1e-12);
        assert!((true_airspeed_factor(1000.0) - (1.225f64 / 1.1117).sqrt()).abs() < 1e-3);
        assert!((true_airspeed_factor(5000.0) - (1.225f64 / 0.7361).sqrt()).abs() < 1e-3);
    }
}
