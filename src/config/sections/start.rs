//! `[start]`: navigation where no receiver has ever had a fix.

use crate::config::key::section;
use crate::geo::Geodetic;
use crate::navigator::settings::StartSettings;

section! {
    /// The start where there is no GNSS: indoors, or with the antenna off.
    "start" struct StartKeys {
        /// A vehicle with optical flow that has had no fix for this long since the start navigates from where it is, at (0, 0); 0 waits for GNSS for ever.
        without_gnss_s: f64 = 30.0 in 0.0 ..= 3600.0;
        /// Where that is, if it is known: latitude …
        latitude_deg: Option<f64> = absent in -90.0 ..= 90.0;
        /// … longitude …
        longitude_deg: Option<f64> = absent in -180.0 ..= 180.0;
        /// … and height above mean sea level. An autopilot that has no origin is told this one (SET_GPS_GLOBAL_ORIGIN).
        altitude_m: Option<f64> = absent in -500.0 ..= 9000.0;
    }
}

impl StartKeys {
    pub(super) fn settings(&self, complain: &mut impl FnMut(&str, String)) -> StartSettings {
        let place = match (self.latitude_deg, self.longitude_deg, self.altitude_m) {
            (Some(latitude), Some(longitude), altitude) => {
                Some(Geodetic::from_degrees(latitude, longitude, altitude.unwrap_or(0.0)))
            }
            (None, None, None) => None,
            _ => {
                complain("start.latitude_deg", "needs start.longitude_deg, and the other way round".into());
                None
            }
        };
        let without_gnss_s = (self.without_gnss_s > 0.0).then_some(self.without_gnss_s);
        StartSettings { without_gnss_s, place }
    }
}
