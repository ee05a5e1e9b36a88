//! What a fault makes of a fix.

use nalgebra::Vector3;

use crate::geo::{Geodetic, LocalNed};
use crate::sample::{GnssFix, GnssSample, GnssWarning, GroundVelocity};

use super::FaultKind;

/// The fix as the fault has it, so long after it began, s; `normal` draws a standard normal number.
pub(super) fn altered(
    fix: &GnssSample,
    kind: &FaultKind,
    since_s: f64,
    mut normal: impl FnMut() -> f64,
) -> GnssSample {
    let along = |course: f64| Vector3::new(course.cos(), course.sin(), 0.0);
    match *kind {
        FaultKind::Jump(m, course) => moved(fix, &(along(course) * m)),
        FaultKind::Walk(rate, course) => moved(fix, &(along(course) * rate * since_s)),
        FaultKind::WalkBoth(rate, course) => {
            let v = along(course) * rate;
            let mut told = moved(fix, &(v * since_s));
            told.ground_velocity = fix.ground_velocity.map(|was| {
                let (north, east) = was.north_east();
                let (north, east) = (north + v.x, east + v.y);
                GroundVelocity { speed_mps: north.hypot(east), course_rad: east.atan2(north) }
            });
            told
        }
        FaultKind::Noise(sigma) => moved(fix, &(Vector3::new(normal(), normal(), normal()) * sigma)),
        FaultKind::Height(m) => moved(fix, &Vector3::new(0.0, 0.0, -m)),
        FaultKind::NoFix => without_fix(fix),
        FaultKind::Spoofed => GnssSample { warning: Some(GnssWarning::Spoofed), ..*fix },
        FaultKind::Jammed => GnssSample { warning: Some(GnssWarning::Jammed), ..*fix },
        FaultKind::Flap(period_s) if (since_s / period_s).fract() < 0.5 => without_fix(fix),
        FaultKind::NotANumber => GnssSample {
            position: fix.position.map(|p| Geodetic { latitude_rad: f64::NAN, longitude_rad: f64::NAN, ..p }),
            ground_velocity: fix.ground_velocity.map(|v| GroundVelocity { speed_mps: f64::NAN, ..v }),
            ..*fix
        },
        _ => *fix,
    }
}

fn without_fix(fix: &GnssSample) -> GnssSample {
    GnssSample { fix: GnssFix::None, position: None, ground_velocity: None, satellites: Some(0), ..*fix }
}

fn moved(fix: &GnssSample, by_ned: &Vector3<f64>) -> GnssSample {
    GnssSample { position: fix.position.map(|p| LocalNed::new(p).to_geodetic(by_ned)), ..*fix }
}
