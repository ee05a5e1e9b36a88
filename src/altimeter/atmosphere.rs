//! Pressure to altitude.

/// Sea-level pressure of the standard atmosphere, Pa.
const P0_PA: f64 = 101_325.0;
/// Sea-level temperature, K, and lapse rate, K/m, of the standard atmosphere's troposphere.
const T0_K: f64 = 288.15;
const LAPSE_KPM: f64 = 0.0065;
/// R·L/g of dry air.
const EXPONENT: f64 = 0.190_263;

/// Pressure altitude in the standard atmosphere's troposphere (ISO 2533), m:
/// H = (T0/L)·(1 − (p/p0)^(R·L/g)). The difference to the true altitude (weather, temperature) is the barometer offset that
/// [`super::HeightFilter`] estimates. `None` for a pressure that is not positive and finite.
pub fn pressure_altitude_m(pressure_pa: f64) -> Option<f64> {
    (pressure_pa.is_finite() && pressure_pa > 0.0)
        .then(|| T0_K / LAPSE_KPM * (1.0 - (pressure_pa / P0_PA).powf(EXPONENT)))
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
}
