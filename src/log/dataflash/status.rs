//! What a DataFlash log tells of the vehicle itself: whether it is armed and flies, what it is, and which version.

use crate::sample::{Airframe, VehicleStatus};
use crate::wire::counters::Cause;
use crate::wire::session::identity::{FirmwareVersion, ReleaseType};

use super::super::row::LogRow;
use super::{ArduPilot, MessageMeaning, Told};

/// Whether it is armed, and whether it flies. Each holds from where it stands, whatever its stamp: Copter to 3.3 wrote `EV` without one.
pub(super) const MEANINGS: &[MessageMeaning] = &[
    MessageMeaning { names: &["ARM"], fields: &["TimeUS", "TimeMS", "ArmState"], decode: arm },
    MessageMeaning { names: &["STAT"], fields: &["TimeUS", "TimeMS", "Armed", "isFlying"], decode: stat },
    MessageMeaning { names: &["EV"], fields: &["TimeUS", "TimeMS", "Id"], decode: event },
];

const ARMED: u8 = 10;

/// It was armed or disarmed just now.
fn armed(vehicle: &mut ArduPilot, armed: bool) -> Result<(), Cause> {
    vehicle.intake.changed(VehicleStatus { armed: Some(armed), ..VehicleStatus::default() });
    Ok(())
}

/// It has landed or taken off just now.
fn landed(vehicle: &mut ArduPilot, landed: bool) -> Result<(), Cause> {
    vehicle.intake.changed(VehicleStatus { landed: Some(landed), ..VehicleStatus::default() });
    Ok(())
}

/// `ARM` is written when that changes.
fn arm(vehicle: &mut ArduPilot, m: &Told<'_>) -> Result<(), Cause> {
    let is_armed = m.row.byte("ArmState").ok_or(Cause::BadPayload)? != 0;
    // EV 10 and 11 stand beside it, and tell of the same change.
    if vehicle.intake.is_armed() == Some(is_armed) { Ok(()) } else { armed(vehicle, is_armed) }
}

/// `STAT` tells what is so, again and again.
fn stat(vehicle: &mut ArduPilot, m: &Told<'_>) -> Result<(), Cause> {
    let armed = Some(m.row.byte("Armed").ok_or(Cause::BadPayload)? != 0);
    let landed = m.row.byte("isFlying").map(|flies| flies == 0);
    vehicle.intake.status(VehicleStatus { airframe: None, armed, landed });
    Ok(())
}

/// Whether a message is the event that the vehicle is armed.
pub(super) fn arms(row: LogRow<'_>) -> bool {
    row.byte("Id") == Some(ARMED)
}

/// Events of `AP_Logger.h`: `ARMED`, `DISARMED`, `LAND_COMPLETE`, `NOT_LANDED`.
fn event(vehicle: &mut ArduPilot, m: &Told<'_>) -> Result<(), Cause> {
    match m.row.byte("Id") {
        Some(ARMED) => armed(vehicle, true),
        Some(11) => armed(vehicle, false),
        Some(18) => landed(vehicle, true),
        Some(28) => landed(vehicle, false),
        _ => Ok(()),
    }
}

/// What the firmware's name, as MSG and VER hold it, tells.
pub(super) fn firmware(name: &str) -> Option<(Airframe, u8, Option<FirmwareVersion>)> {
    let (airframe, vehicle_type, rest) = [
        ("ArduCopter", Airframe::Multirotor, 2),
        ("ArduPlane", Airframe::FixedWing, 1),
        ("ArduRover", Airframe::Surface, 10),
        ("APM:Copter", Airframe::Multirotor, 2),
        ("APM:Plane", Airframe::FixedWing, 1),
        ("APM:Rover", Airframe::Surface, 10),
    ]
    .into_iter()
    .find_map(|(prefix, airframe, kind)| Some((airframe, kind, name.strip_prefix(prefix)?)))?;
    Some((airframe, vehicle_type, version(rest)))
}

/// ` V4.5.7 (2a3dc4b7)` or ` V4.7.0-dev (…)`.
fn version(text: &str) -> Option<FirmwareVersion> {
    let word = text.trim_start().strip_prefix('V')?.split_whitespace().next()?;
    let (numbers, release) = word.split_once('-').map_or((word, None), |(n, r)| (n, Some(r)));
    let mut numbers = numbers.split('.').map(|n| n.parse().ok());
    let release = match release {
        None => ReleaseType::Official,
        Some(r) if r.starts_with("beta") => ReleaseType::Beta,
        Some(r) if r.starts_with("rc") => ReleaseType::Candidate,
        Some(_) => ReleaseType::Development,
    };
    Some(FirmwareVersion {
        major: numbers.next()??,
        minor: numbers.next()??,
        patch: numbers.next().flatten().unwrap_or(0),
        release,
    })
}
