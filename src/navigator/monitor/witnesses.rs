//! Who can testify against the vehicle's own heading and inertia.

use super::gyro_by_field::GyroByField;
use super::heading_witness::HeadingWitness;
use super::inertia_jumps::InertiaJumps;
use super::inertia_trust::InertiaTrust;
use super::inertia_witness::HorizontalWitness;
use super::plausibility::Plausibility;
use super::receiver_lie::ReceiverLies;
use super::unexplained::Unexplained;
use super::vertical_witness::VerticalWitness;
use crate::navigator::tuning::inertia_witness::TURNED_S;
use crate::time::AutopilotTime;

/// See the module's documentation.
#[derive(Clone, Copy, Debug, Default)]
pub(in super::super) struct Witnesses {
    /// GNSS, of the heading.
    pub(in super::super) heading: HeadingWitness,
    /// GNSS, of the inertia.
    pub(in super::super) gnss: HorizontalWitness,
    /// The barometer, of the inertia.
    pub(in super::super) barometer: VerticalWitness,
    /// The magnetic field, of the gyros.
    pub(in super::super) field: GyroByField,
    /// When the heading was turned for it, last.
    turned: Option<AutopilotTime>,
    /// What the vehicle can do.
    pub(in super::super) plausibility: Plausibility,
    /// The filter's innovations, of the IMU's axes.
    pub(in super::super) jumps: InertiaJumps,
    /// The same, of a receiver's honesty.
    pub(in super::super) receiver: ReceiverLies,
    /// What came of the IMU's.
    pub(in super::super) inertia: InertiaTrust,
    /// Of where the receiver came back.
    pub(in super::super) unexplained: Unexplained,
}

impl Witnesses {
    /// The heading is turned. False when that has been tried of late: it was not what was wrong.
    pub(in super::super) fn turns(&mut self, now: AutopilotTime) -> bool {
        let again = self.turned.is_some_and(|t| (0.0..TURNED_S).contains(&now.seconds_since(t)));
        self.turned = Some(now);
        !again
    }

    /// What was felt so far does not belong to what will be.
    pub(in super::super) fn forget(&mut self) {
        self.heading.forget();
        self.gnss.forget();
        self.barometer.forget();
        self.field.forget();
    }
}
