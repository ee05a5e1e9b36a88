//! `[start]`: navigation where no receiver has ever had a fix.

use crate::config::key::section;
use crate::geo::Geodetic;
use crate::navigator::settings::StartSettings;

section! {
    /// The start where there is no GNSS: indoors, or with the antenna off.
    "start" struct StartKeys {
        /// A vehicle with optical flow that has had no fix for this long since the start navigates from where it is, at (0, 0); 0 waits for GNSS for ever.
        without_gnss_s: f64 = 30.0 in 0.0 ..= 3600.0;
        /// Where that is, if it is known: latitude and longitude in degrees and height above mean sea level in metres, as in "47.3977, 8.5456, 488". An autopilot that has no origin is told this one (SET_GPS_GLOBAL_ORIGIN).
        place: String = "";
    }
}

impl StartKeys {
    pub(super) fn settings(&self, complain: &mut impl FnMut(&str, String)) -> StartSettings {
        let place = if self.place.is_empty() { None } else { place(&self.place) };
        if place.is_none() && !self.place.is_empty() {
            let is = &self.place;
            complain("start.place", format!("is \"{is}\", which is no latitude, longitude and height"));
        }
        StartSettings { without_gnss_s: (self.without_gnss_s > 0.0).then_some(self.without_gnss_s), place }
    }
}

/// "latitude, longitude, height" in degrees and metres.
fn place(text: &str) -> Option<Geodetic> {
    let numbers: Option<Vec<f64>> = text.split(',').map(|n| n.trim().parse().ok()).collect();
    let &[latitude, longitude, height] = numbers?.as_slice() else { return None };
    let earthly = latitude.abs() <= 90.0 && longitude.abs() <= 180.0 && (-500.0..9000.0).contains(&height);
    earthly.then(|| Geodetic::from_degrees(latitude, longitude, height)).filter(Geodetic::is_plausible)
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    #[test]
    fn three_numbers_are_a_place_and_nothing_else_is() {
        let zurich = place("47.3977, 8.5456,488").unwrap();
        assert!((zurich.latitude_rad.to_degrees() - 47.3977).abs() < 1e-9 && zurich.height_m == 488.0);
        for wrong in ["47", "47, 8", "a, b, c", "91, 8, 0", "47, 8, nan", "47, 8, 1, 2", ","] {
            assert_eq!(place(wrong), None, "{wrong}");
        }
    }

    proptest! {
        #[test]
        fn any_text_is_a_place_on_earth_or_none(text in ".*") {
            prop_assert!(place(&text).is_none_or(|p| p.is_plausible()));
        }
    }
}
