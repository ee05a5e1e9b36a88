//! WGS-84 positions and the local NED frame, exact through ECEF (no flat-Earth approximation).

use nalgebra::{Matrix3, Vector3};
use std::f64::consts::{FRAC_PI_2, PI};

/// Semi-major axis a of WGS-84, m (NIMA TR8350.2, table 3.1).
pub const SEMI_MAJOR_M: f64 = 6_378_137.0;
/// Flattening f of WGS-84 (NIMA TR8350.2, table 3.1).
pub const FLATTENING: f64 = 1.0 / 298.257_223_563;
/// First eccentricity squared, e² = f(2 − f).
pub const ECCENTRICITY_SQ: f64 = FLATTENING * (2.0 - FLATTENING);
/// Semi-minor axis b = a(1 − f), m.
pub const SEMI_MINOR_M: f64 = SEMI_MAJOR_M * (1.0 - FLATTENING);

/// A position on WGS-84, with its height above mean sea level, as receivers, autopilots and maps give it.
///
/// What needs a height above the ellipsoid takes this one for it, without the geoid's undulation N (−107 m … +86 m, EGM96):
/// - [`LocalNed`]: lengths scale with the distance from the Earth's centre, so those of a local frame come out wrong by |N|/R ≤ 107/6.34·10⁶ =
///   1.7·10⁻⁵ of themselves, 17 mm per km. Heights in it are those above the sea, as barometers and landmarks have them; the change of N
///   over the flight (the deflection of the vertical, 0.1 m per km in mountains) is not in them. There and back is exact.
/// - [`normal_gravity`](super::normal_gravity): 3.1·10⁻⁶ s⁻² |N| ≤ 3.3·10⁻⁴ m/s², less than the anomalies of gravity.
/// - [`magnetic_field`](super::magnetic_field): 3 B |N|/R ≤ 4 nT of a model that is good to 150 nT.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Geodetic {
    /// Geodetic latitude, rad, positive to the north.
    pub latitude_rad: f64,
    /// Longitude, rad, positive to the east.
    pub longitude_rad: f64,
    /// Height above mean sea level, m.
    pub height_m: f64,
}

impl Geodetic {
    /// A position from degrees and metres.
    pub fn from_degrees(latitude_deg: f64, longitude_deg: f64, height_m: f64) -> Self {
        Self { latitude_rad: latitude_deg.to_radians(), longitude_rad: longitude_deg.to_radians(), height_m }
    }

    /// Whether all is finite, latitude within ±90°, longitude within ±360° and height within −10 km … 1000 km.
    pub fn is_plausible(&self) -> bool {
        self.latitude_rad.abs() <= FRAC_PI_2
            && self.longitude_rad.abs() <= 2.0 * PI
            && (-1e4..=1e6).contains(&self.height_m)
    }

    /// Earth-centred, Earth-fixed position, m, the height taken as one above the ellipsoid (NIMA TR8350.2, eq. (4-14)).
    pub fn to_ecef(&self) -> Vector3<f64> {
        let (sl, cl) = self.latitude_rad.sin_cos();
        let (so, co) = self.longitude_rad.sin_cos();
        let n = SEMI_MAJOR_M / (1.0 - ECCENTRICITY_SQ * sl * sl).sqrt();
        let p = (n + self.height_m) * cl;
        Vector3::new(p * co, p * so, (n * (1.0 - ECCENTRICITY_SQ) + self.height_m) * sl)
    }

    /// The position of an ECEF vector in metres, with its height above the ellipsoid: the inverse of [`to_ecef`](Self::to_ecef).
    ///
    /// Bowring's equation (*Survey Review* 23, 1976) iterated on the reduced latitude; from the surface up to orbits it is
    /// exact to rounding after three iterations. The height is p cos φ + z sin φ − a √(1 − e² sin² φ), well conditioned from
    /// the equator to the poles. Within a few tens of kilometres of the Earth's centre the latitude means nothing.
    pub fn from_ecef(ecef: &Vector3<f64>) -> Self {
        let p = ecef.x.hypot(ecef.y);
        let z = ecef.z;
        let ep2 = ECCENTRICITY_SQ / (1.0 - ECCENTRICITY_SQ);
        let mut beta = (SEMI_MAJOR_M * z).atan2(SEMI_MINOR_M * p);
        let mut latitude_rad = beta;
        for _ in 0..4 {
            let (sb, cb) = beta.sin_cos();
            latitude_rad =
                (z + ep2 * SEMI_MINOR_M * sb.powi(3)).atan2(p - ECCENTRICITY_SQ * SEMI_MAJOR_M * cb.powi(3));
            let (s, c) = latitude_rad.sin_cos();
            beta = ((1.0 - FLATTENING) * s).atan2(c);
        }
        let (s, c) = latitude_rad.sin_cos();
        let height_m = p * c + z * s - SEMI_MAJOR_M * (1.0 - ECCENTRICITY_SQ * s * s).sqrt();
        Self { latitude_rad, longitude_rad: ecef.y.atan2(ecef.x), height_m }
    }
}

/// The local NED frame: tangent at a fixed origin, x true north, y east, z down along the ellipsoid's normal *at the origin*.
///
/// Exact at any distance, but "down" is down at the origin only: 10 km away the ellipsoid lies 7.8 m below the plane.
#[derive(Clone, Debug, PartialEq)]
pub struct LocalNed {
    origin: Geodetic,
    origin_ecef: Vector3<f64>,
    r_ecef_to_ned: Matrix3<f64>,
}

impl LocalNed {
    /// The frame at `origin`.
    pub fn new(origin: Geodetic) -> Self {
        let (sl, cl) = origin.latitude_rad.sin_cos();
        let (so, co) = origin.longitude_rad.sin_cos();
        let r_ecef_to_ned = Matrix3::new(-sl * co, -sl * so, cl, -so, co, 0.0, -cl * co, -cl * so, -sl);
        Self { origin, origin_ecef: origin.to_ecef(), r_ecef_to_ned }
    }

    /// The origin.
    pub fn origin(&self) -> Geodetic {
        self.origin
    }

    /// NED components, m, of a geodetic position.
    pub fn to_ned(&self, position: &Geodetic) -> Vector3<f64> {
        self.r_ecef_to_ned * (position.to_ecef() - self.origin_ecef)
    }

    /// The geodetic position at NED components in metres.
    pub fn to_geodetic(&self, position_ned: &Vector3<f64>) -> Geodetic {
        Geodetic::from_ecef(&(self.origin_ecef + self.r_ecef_to_ned.tr_mul(position_ned)))
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use map_3d::Ellipsoid;
    use proptest::prelude::*;

    proptest! {
        #[test]
        fn ned_agrees_with_map_3d(lat in -89.0..89.0f64, lon in -180.0..180.0f64, h in -400.0..9000.0f64,
                                  dlat in -0.9..0.9f64, dlon in -0.9..0.9f64, dh in -400.0..9000.0f64) {
            let o = Geodetic::from_degrees(lat, lon, h);
            let p = Geodetic::from_degrees(lat + dlat, lon + dlon, h + dh);
            let ned = LocalNed::new(o).to_ned(&p);
            let (n, e, d) = map_3d::geodetic2ned(p.latitude_rad, p.longitude_rad, p.height_m,
                                                 o.latitude_rad, o.longitude_rad, o.height_m, Ellipsoid::WGS84);
            prop_assert!((ned - Vector3::new(n, e, d)).norm() < 1e-6, "{ned} {n} {e} {d}");
        }

        #[test]
        fn ned_round_trips_to_a_micrometre(lat in -90.0..90.0f64, lon in -180.0..180.0f64, h in -400.0..9000.0f64,
                                           n in -2e5..2e5f64, e in -2e5..2e5f64, d in -9000.0..400.0f64) {
            let frame = LocalNed::new(Geodetic::from_degrees(lat, lon, h));
            let ned = Vector3::new(n, e, d);
            prop_assert!((frame.to_ned(&frame.to_geodetic(&ned)) - ned).norm() < 1e-6);
        }

        #[test]
        fn ecef_round_trips(lat in -90.0..90.0f64, lon in -180.0..180.0f64, h in -1e4..1e6f64) {
            let g = Geodetic::from_degrees(lat, lon, h);
            let back = Geodetic::from_ecef(&g.to_ecef());
            prop_assert!((back.latitude_rad - g.latitude_rad).abs() < 1e-13);
            prop_assert!((back.height_m - h).abs() < 1e-6);
            prop_assert!((back.to_ecef() - g.to_ecef()).norm() < 1e-6);
        }
    }

    #[test]
    fn the_axes_point_north_east_and_down() {
        let o = Geodetic::from_degrees(63.4, 10.4, 100.0);
        let frame = LocalNed::new(o);
        let north = frame.to_ned(&Geodetic { latitude_rad: o.latitude_rad + 1e-6, ..o });
        let east = frame.to_ned(&Geodetic { longitude_rad: o.longitude_rad + 1e-6, ..o });
        let up = frame.to_ned(&Geodetic { height_m: 101.0, ..o });
        assert!(north.x > 6.0 && north.yz().norm() < 1e-4);
        assert!(east.y > 2.5 && east.xz().norm() < 1e-4);
        assert!((up - Vector3::new(0.0, 0.0, -1.0)).norm() < 1e-8);
    }

    #[test]
    fn the_poles_and_the_date_line_are_ordinary_places() {
        let pole = Geodetic::from_ecef(&Vector3::new(0.0, 0.0, -SEMI_MINOR_M - 5.0));
        assert!((pole.latitude_rad + FRAC_PI_2).abs() < 1e-12 && (pole.height_m - 5.0).abs() < 1e-8);
        let frame = LocalNed::new(Geodetic::from_degrees(0.0, 179.9999, 0.0));
        let ned = frame.to_ned(&Geodetic::from_degrees(0.0, -179.9999, 0.0));
        assert!((ned.y - 22.264).abs() < 1e-3);
    }

    #[test]
    fn a_height_above_the_sea_costs_a_scale_of_the_undulation_over_the_radius() {
        // The deepest of the geoid: south of India, 106 m below the ellipsoid.
        let undulation = -106.0;
        let above_sea = |dlat, h| Geodetic::from_degrees(4.7 + dlat, 78.8 + 0.5 * dlat, h);
        let above_ellipsoid = |dlat, h| above_sea(dlat, h + undulation);
        for dlat in [0.01, 0.1, 0.9] {
            let stated = LocalNed::new(above_sea(0.0, 20.0)).to_ned(&above_sea(dlat, 120.0));
            let truth = LocalNed::new(above_ellipsoid(0.0, 20.0)).to_ned(&above_ellipsoid(dlat, 120.0));
            let error = (stated - truth).norm() / truth.norm();
            assert!((1.5e-5..1.7e-5).contains(&error), "{error}");
        }
    }

    #[test]
    fn implausible_positions_are_told_apart() {
        assert!(Geodetic::from_degrees(-33.0, 151.0, 20.0).is_plausible());
        for g in [
            Geodetic::from_degrees(f64::NAN, 0.0, 0.0),
            Geodetic::from_degrees(91.0, 0.0, 0.0),
            Geodetic::from_degrees(0.0, 0.0, f64::INFINITY),
        ] {
            assert!(!g.is_plausible());
        }
    }
}
