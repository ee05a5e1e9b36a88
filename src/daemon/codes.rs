//! What our heartbeat says of the navigation, in `custom_mode`.

use crate::navigator::solution::Mode;

/// `custom_mode` of our heartbeat before an autopilot was heard.
pub const CODE_NO_AUTOPILOT: u32 = 0;
/// `custom_mode` of our heartbeat while the autopilot or its IMU is silent.
pub const CODE_SILENT: u32 = 6;

/// `custom_mode` of our heartbeat in each mode; see also [`CODE_NO_AUTOPILOT`] and [`CODE_SILENT`].
pub const fn mode_code(mode: Mode) -> u32 {
    match mode {
        Mode::Aligning => 1,
        Mode::Aided => 2,
        Mode::Holdover => 3,
        Mode::Rejoining => 4,
        Mode::Lost => 5,
    }
}
