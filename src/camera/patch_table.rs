//! Several patches of one image: which sensor id looks where.

use nalgebra::Vector2;

/// Patches of one camera.
pub const MAX_PATCHES: usize = 8;

/// One patch.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct PatchCentre {
    /// The `sensor_id` of its messages.
    pub sensor: u8,
    /// Centre [r, s] in the image, in units of the focal length.
    pub image: Vector2<f64>,
}

/// The patches of one camera; empty where every sensor is a camera of its own.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct PatchTable {
    entries: [Option<PatchCentre>; MAX_PATCHES],
}

impl PatchCentre {
    /// A patch that is seen under these angles from the optical axis, to the right (camera +y) and forward (camera +x), rad:
    /// r = tan(right), s = −tan(forward).
    pub fn from_angles(sensor: u8, right_rad: f64, forward_rad: f64) -> Self {
        Self { sensor, image: Vector2::new(right_rad.tan(), -forward_rad.tan()) }
    }
}

impl PatchTable {
    /// Adds a patch; false when there is no room, or its sensor id is taken.
    pub fn add(&mut self, patch: PatchCentre) -> bool {
        if self.find(patch.sensor).is_some() {
            return false;
        }
        match self.entries.iter_mut().find(|e| e.is_none()) {
            Some(free) => {
                *free = Some(patch);
                true
            }
            None => false,
        }
    }

    /// The patches, in the order in which they were added.
    pub fn iter(&self) -> impl Iterator<Item = &PatchCentre> {
        self.entries.iter().flatten()
    }

    /// The patch of a sensor id.
    pub fn find(&self, sensor: u8) -> Option<&PatchCentre> {
        self.iter().find(|p| p.sensor == sensor)
    }

    /// The id that stands for all of them: the first.
    pub fn camera_id(&self) -> Option<u8> {
        self.iter().next().map(|p| p.sensor)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn ids_are_unique_and_room_is_limited() {
        let mut table = PatchTable::default();
        assert_eq!(table.camera_id(), None);
        for sensor in 0..MAX_PATCHES as u8 {
            assert!(table.add(PatchCentre::from_angles(10 + sensor, 0.1, 0.2)));
            assert!(!table.add(PatchCentre::from_angles(10, 0.3, 0.0)), "taken");
        }
        assert!(!table.add(PatchCentre::from_angles(99, 0.0, 0.0)), "full");
        assert_eq!((table.camera_id(), table.iter().count()), (Some(10), MAX_PATCHES));
        let image = table.find(12).unwrap().image;
        assert!(image.x > 0.0 && image.y < 0.0, "right of the centre, and forward of it");
        assert!(table.find(0).is_none());
    }
}
