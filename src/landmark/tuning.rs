//! The landmark filter's tuning constants, with their reasons.

use super::settings::{BeliefSettings, LandmarkSettings};

// What is no measurement.

/// No vehicle moves or turns faster, m/s and rad/s: what does is a wrong number.
pub(super) const FASTEST: f64 = 1e3;
/// No landmark is seen from farther away, m.
pub(super) const FARTHEST_SEEN_M: f64 = 1e5;
/// No landmark of one map is farther from its origin, m: farther away than the Earth is large.
pub(super) const FARTHEST_MAPPED_M: f64 = 1e7;

// The dead reckoning.

/// Steps after which Ψ is made a rotation again: it leaves SO(3) by 10⁻¹⁶ a step.
pub(super) const RENEWAL: u32 = 4096;

// Whether the landmarks can tell a pose.

/// Landmarks whose spread across is less than this part of that along are on a line: the turn about it is then known twenty times worse.
pub(super) const THIN: f64 = 0.05;
/// For each landmark that is rejected as many have to agree, and two more: three fix a pose whatever they are, so a majority needs more.
pub(super) const MAJORITY: u32 = 2;
/// More than this part of a landmark's sightings rejected, of 255: half of them.
pub(super) const SUSPECT: u8 = 127;
/// Seconds after which a landmark that is not seen any more counts 1/e: as long as a vehicle may look away and still know the field. The H∞
/// filter forgets faster.
pub(super) const MEMORY_S: f64 = 10.0;

// When which filter is believed.

/// N is pulled towards SO(3) once as many sightings have shaped it. Before, it has to be free: pulled from the start it would have to turn
/// through SO(3), where wrong minima are. More than its twelve unknowns take, by three.
pub(super) const SHAPED: u32 = 40;
/// Weight of a new verdict in the smoothed part of rejected sightings: the last twenty count.
pub(super) const SMOOTHING: f64 = 0.05;
/// Sightings below this part of rejections: the filter follows. Below [`BeliefSettings::lockout_part`], so that a filter that is nearly locked
/// out starts no other.
pub(super) const TRUSTED: f64 = 0.4;
/// The H∞ filter has acquired when N's elements are known to this: 7°, within the reach of a linearisation.
pub(super) const ACQUIRED_ROTATION: f64 = 0.12;
/// … its singular values are this near to 1: N shrinks under noise, but one that is no rotation at all is none to start from.
pub(super) const ACQUIRED_SCALE: f64 = 0.25;
/// … and the centroid of the field is known to this part of the distances bearings are scaled with at most.
pub(super) const ACQUIRED_POSITION: f64 = 0.1;
/// The refining filter is reset when it is off its monitor's estimate by this χ². 6 degrees of freedom are beyond it once in 2·10¹⁰; the two
/// share their sightings, and a reset costs the refined pose.
pub(super) const APART: f64 = 60.0;
/// … for this long, s: a single picture with wrong landmarks is over by then.
pub(super) const APART_S: f64 = 1.0;

impl Default for LandmarkSettings {
    fn default() -> Self {
        Self {
            lambda: 0.25,
            bearing_sigma_rad: 0.015,
            distance_clip_m: [0.5, 12.0],
            distance_sigma_part: 0.1,
            gravity_sigma_rad: 0.03,
            gravity_period_s: 0.2,
            orthonormality_weight: 400.0,
            position_drift: 0.02,
            attitude_drift: 0.003,
            history_s: 1.0,
            gap_s: 0.25,
            motions: 1024,
            events: 256,
            belief: BeliefSettings {
                gate: 20.0,
                refined_gate: 16.0,
                lockout_part: 0.6,
                lockout_factor: 0.02,
                converged_sigma: [0.3, 0.06],
            },
        }
    }
}
