//! The Earth's magnetic field from the World Magnetic Model (WMM2020 and WMM2025).

use super::frame::Ned;
use super::wgs84::Geodetic;
use nalgebra::Vector3;
use std::f64::consts::{FRAC_PI_2, PI};
use thiserror::Error;
use world_magnetic_model::GeomagneticField;
use world_magnetic_model::time::util::days_in_year;
use world_magnetic_model::time::{Date, OffsetDateTime};
use world_magnetic_model::uom::si::angle::radian;
use world_magnetic_model::uom::si::f32::{Angle, Length};
use world_magnetic_model::uom::si::length::meter;
use world_magnetic_model::uom::si::magnetic_flux_density::nanotesla;

/// First and last year (inclusive) the built-in coefficients cover: WMM2020 and WMM2025.
const YEARS: (i32, i32) = (2020, 2029);
/// Heights of validity, m.
const HEIGHTS_M: (f64, f64) = (-1000.0, 850_000.0);

/// A day and the mean year of the calendar, µs.
const DAY_US: i64 = 86_400_000_000;
const GREGORIAN_YEAR_US: f64 = 365.2425 * DAY_US as f64;

/// Why there is no reference field.
#[derive(Clone, Copy, Debug, PartialEq, Error)]
pub enum MagneticError {
    /// Latitude, longitude or height is not finite or not on Earth.
    #[error("position is not finite or not on Earth")]
    Position,
    /// The height is outside the model's −1 km … 850 km.
    #[error("height {height_m} m is outside the model's range of -1 km to 850 km")]
    Height {
        /// The height asked for, m.
        height_m: f64,
    },
    /// The date is not finite.
    #[error("date is not finite")]
    Date,
    /// The model gave no finite field (at the poles themselves).
    #[error("the model has no value here")]
    Undefined,
}

/// The reference field, T, at `position` and `decimal_year` (2026.5 is the middle of 2026), from spherical harmonics of degree 12
/// (NOAA/BGS, World Magnetic Model technical report). Accurate to about 0.15 µT and, away from the magnetic poles, 0.4° of
/// declination (the crust's field is not in it). In single precision; evaluate it once in a while, not per sample.
///
/// A date outside 2020 … 2029 is moved to the nearest covered day. The field's direction then ages by some 0.1° to 0.5° a year, more near the
/// magnetic poles.
///
/// # Errors
/// [`MagneticError`] for arguments that are not finite or out of range. It never panics.
pub fn magnetic_field(position: &Geodetic, decimal_year: f64) -> Result<Ned<Vector3<f64>>, MagneticError> {
    if !position.is_plausible() {
        let height_only =
            position.height_m.is_finite() && Geodetic { height_m: 0.0, ..*position }.is_plausible();
        return Err(if height_only {
            MagneticError::Height { height_m: position.height_m }
        } else {
            MagneticError::Position
        });
    }
    if !(HEIGHTS_M.0..=HEIGHTS_M.1).contains(&position.height_m) {
        return Err(MagneticError::Height { height_m: position.height_m });
    }
    let date = date_of(decimal_year).ok_or(MagneticError::Date)?;
    let lon = super::so3::wrap_pi(position.longitude_rad);
    // Rounding to f32 may pass ±π by half a unit, which the crate refuses.
    let limit = PI as f32 - 1e-6;
    // 600 m short of a pole: there the spherical harmonics divide by the cosine of the latitude.
    let polar = FRAC_PI_2 - 1e-4;
    let field = GeomagneticField::new(
        Length::new::<meter>(position.height_m as f32),
        Angle::new::<radian>(position.latitude_rad.clamp(-polar, polar) as f32),
        Angle::new::<radian>((lon as f32).clamp(-limit, limit)),
        date,
    )
    .map_err(|_| MagneticError::Undefined)?;
    let nt = Vector3::new(
        field.x().get::<nanotesla>(),
        field.y().get::<nanotesla>(),
        field.z().get::<nanotesla>(),
    );
    let field_ned_t = nt.map(|c| f64::from(c) * 1e-9);
    // The Earth's field lies between 20 and 70 µT.
    if !(1e-5..=1e-4).contains(&field_ned_t.norm()) {
        return Err(MagneticError::Undefined);
    }
    Ok(Ned::new(field_ned_t))
}

/// Decimal year of a UTC time in microseconds since 1970 (MAVLink SYSTEM_TIME); leap years count, leap seconds do not.
pub fn decimal_year_from_unix_us(unix_us: i64) -> f64 {
    let Ok(date) = OffsetDateTime::from_unix_timestamp_nanos(i128::from(unix_us) * 1000) else {
        // Beyond the year 9999 on either side.
        return 1970.0 + unix_us as f64 / GREGORIAN_YEAR_US;
    };
    let days = f64::from(date.ordinal() - 1) + unix_us.rem_euclid(DAY_US) as f64 / DAY_US as f64;
    f64::from(date.year()) + days / f64::from(days_in_year(date.year()))
}

fn date_of(decimal_year: f64) -> Option<Date> {
    if !decimal_year.is_finite() {
        return None;
    }
    let clamped = decimal_year.clamp(f64::from(YEARS.0), f64::from(YEARS.1) + 1.0 - 1e-9);
    let year = clamped.floor();
    let days = f64::from(days_in_year(year as i32));
    let ordinal = 1 + ((clamped - year) * days).floor().min(days - 1.0) as u16;
    Date::from_ordinal_date(year as i32, ordinal).ok()
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    fn declination_deg(m: Ned<Vector3<f64>>) -> f64 {
        m.raw().y.atan2(m.raw().x).to_degrees()
    }

    fn inclination_deg(m: Ned<Vector3<f64>>) -> f64 {
        m.raw().z.atan2(m.raw().xy().norm()).to_degrees()
    }

    #[test]
    fn the_field_matches_the_published_model() {
        // WMM2020 at 3000 ft, 80° N, 2.36 rad E on 2023-01-15: F = 58769.0 nT, D = −19.998°.
        let p = Geodetic { latitude_rad: 80f64.to_radians(), longitude_rad: 2.36, height_m: 914.4 };
        let m = magnetic_field(&p, 2023.0 + 14.5 / 365.0).unwrap();
        assert!((m.raw().norm() - 58_769.0e-9).abs() < 2e-9);
        assert!((declination_deg(m) + 19.998).abs() < 0.01);
    }

    #[test]
    fn the_field_is_where_maps_put_it() {
        // Canberra: some 12° east, dips upwards; Trondheim: some 5° east, dips down steeply.
        let canberra = magnetic_field(&Geodetic::from_degrees(-35.36, 149.17, 580.0), 2025.5).unwrap();
        assert!((11.0..14.0).contains(&declination_deg(canberra)));
        assert!((-68.0..-63.0).contains(&inclination_deg(canberra)));
        let trondheim = magnetic_field(&Geodetic::from_degrees(63.43, 10.39, 50.0), 2025.5).unwrap();
        assert!((3.0..7.0).contains(&declination_deg(trondheim)));
        assert!((73.0..76.0).contains(&inclination_deg(trondheim)));
    }

    #[test]
    fn dates_outside_the_model_are_clamped() {
        let p = Geodetic::from_degrees(47.4, 8.5, 500.0);
        let last = magnetic_field(&p, 2029.999).unwrap();
        let later = magnetic_field(&p, 2034.2).unwrap();
        assert_eq!(later, last);
        assert_eq!(magnetic_field(&p, 1970.0), magnetic_field(&p, 2020.0));
    }

    #[test]
    fn the_two_models_meet_at_2025() {
        let p = Geodetic::from_degrees(47.4, 8.5, 500.0);
        let a = magnetic_field(&p, 2024.9999).unwrap();
        let b = magnetic_field(&p, 2025.0).unwrap();
        assert!((a - b).raw().norm() < 300e-9);
    }

    #[test]
    fn decimal_years_of_known_instants() {
        assert_eq!(decimal_year_from_unix_us(0), 1970.0);
        assert_eq!(decimal_year_from_unix_us(946_684_800_000_000), 2000.0); // 2000-01-01
        assert_eq!(decimal_year_from_unix_us(1_735_689_600_000_000), 2025.0); // 2025-01-01
        // 2024-12-31T00:00: day 366 of a leap year.
        let y = decimal_year_from_unix_us(1_735_603_200_000_000);
        assert!((y - (2024.0 + 365.0 / 366.0)).abs() < 1e-12);
        // 2024-02-29T12:00.
        let y = decimal_year_from_unix_us(1_709_208_000_000_000);
        assert!((y - (2024.0 + 59.5 / 366.0)).abs() < 1e-12);
    }

    proptest! {
        #[test]
        fn every_place_and_date_gives_a_field_or_a_reason(lat in -95.0..95.0f64, lon in -400.0..400.0f64,
                                                          h in -2e3..9e5f64, year in 1900.0..2100.0f64) {
            if let Ok(m) = magnetic_field(&Geodetic::from_degrees(lat, lon, h), year) {
                prop_assert!(m.raw().iter().all(|c| c.is_finite()));
            }
        }

        #[test]
        fn decimal_years_grow_with_time(a in -2_000_000_000_000_000i64..4_000_000_000_000_000, d in 1_000_000i64..1_000_000_000_000) {
            prop_assert!(decimal_year_from_unix_us(a + d) > decimal_year_from_unix_us(a));
        }
    }

    #[test]
    fn bad_arguments_have_reasons() {
        let p = |lat, lon, h| Geodetic::from_degrees(lat, lon, h);
        assert_eq!(magnetic_field(&p(f64::NAN, 0.0, 0.0), 2025.0), Err(MagneticError::Position));
        assert_eq!(magnetic_field(&p(0.0, 0.0, 9e5), 2025.0), Err(MagneticError::Height { height_m: 9e5 }));
        assert_eq!(magnetic_field(&p(0.0, 0.0, 0.0), f64::INFINITY), Err(MagneticError::Date));
        for lat in [90.0, -90.0] {
            assert!(magnetic_field(&p(lat, 0.0, 0.0), 2025.0).is_ok());
        }
        assert!(magnetic_field(&p(10.0, 180.0, 0.0), 2025.0).is_ok());
    }
}
