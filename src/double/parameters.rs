//! The parameters of the double: those that external navigation, streams and arming depend on, as each autopilot has and encodes them.

use mavlink::dialects::ardupilotmega as apm;

use crate::sim::autopilot::AidingRules;
use crate::sim::autopilot::ekf2::Ekf2Settings;
use crate::sim::autopilot::ekf3::{AidingSet, AidingSource, Ekf3Settings};
use crate::wire::messages::Message;
use crate::wire::session::identity::AutopilotKind;

/// How a parameter is kept.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Kept {
    Byte,
    Short,
    Long,
    Real,
}

impl Kept {
    fn wire(self) -> apm::MavParamType {
        match self {
            Self::Byte => apm::MavParamType::MAV_PARAM_TYPE_INT8,
            Self::Short => apm::MavParamType::MAV_PARAM_TYPE_INT16,
            Self::Long => apm::MavParamType::MAV_PARAM_TYPE_INT32,
            Self::Real => apm::MavParamType::MAV_PARAM_TYPE_REAL32,
        }
    }
}

/// ArduPilot, set up as the documentation says: external navigation in source set 2.
const ARDUPILOT: &[(&str, Kept, f64)] = &[
    ("AHRS_EKF_TYPE", Kept::Byte, 3.0),
    ("ARMING_CHECK", Kept::Long, 1.0),
    ("EK3_ENABLE", Kept::Byte, 1.0),
    ("EK3_SRC1_POSXY", Kept::Byte, 3.0),
    ("EK3_SRC1_POSZ", Kept::Byte, 1.0),
    ("EK3_SRC1_VELXY", Kept::Byte, 3.0),
    ("EK3_SRC1_VELZ", Kept::Byte, 3.0),
    ("EK3_SRC1_YAW", Kept::Byte, 1.0),
    ("EK3_SRC2_POSXY", Kept::Byte, 6.0),
    ("EK3_SRC2_POSZ", Kept::Byte, 1.0),
    ("EK3_SRC2_VELXY", Kept::Byte, 6.0),
    ("EK3_SRC2_VELZ", Kept::Byte, 6.0),
    ("EK3_SRC2_YAW", Kept::Byte, 1.0),
    ("EK3_SRC3_POSXY", Kept::Byte, 0.0),
    ("EK3_SRC3_POSZ", Kept::Byte, 1.0),
    ("EK3_SRC3_VELXY", Kept::Byte, 0.0),
    ("EK3_SRC3_VELZ", Kept::Byte, 0.0),
    ("EK3_SRC3_YAW", Kept::Byte, 1.0),
    ("EK3_SRC_OPTIONS", Kept::Short, 0.0),
    ("FLOW_TYPE", Kept::Byte, 10.0),
    ("RNGFND1_TYPE", Kept::Byte, 100.0),
    ("SCHED_LOOP_RATE", Kept::Short, 400.0),
    ("SERIAL1_PROTOCOL", Kept::Byte, 2.0),
    ("SERIAL1_BAUD", Kept::Long, 921.0),
    ("VISO_DELAY_MS", Kept::Short, 10.0),
    ("VISO_POS_M_NSE", Kept::Real, 0.2),
    ("VISO_QUAL_MIN", Kept::Byte, 0.0),
    ("VISO_TYPE", Kept::Byte, 1.0),
    ("VISO_VEL_M_NSE", Kept::Real, 0.1),
    ("VISO_YAW_M_NSE", Kept::Real, 0.2),
];

/// PX4, set up as the documentation says.
const PX4: &[(&str, Kept, f64)] = &[
    ("EKF2_DELAY_MAX", Kept::Real, 200.0),
    ("EKF2_EVP_NOISE", Kept::Real, 0.1),
    ("EKF2_EVV_NOISE", Kept::Real, 0.1),
    ("EKF2_EV_CTRL", Kept::Long, 15.0),
    ("EKF2_EV_DELAY", Kept::Real, 0.0),
    ("EKF2_EV_NOISE_MD", Kept::Long, 0.0),
    ("EKF2_EV_QMIN", Kept::Long, 0.0),
    ("EKF2_GPS_CTRL", Kept::Long, 7.0),
    ("EKF2_HGT_REF", Kept::Long, 0.0),
    ("EKF2_NOAID_TOUT", Kept::Long, 5_000_000.0),
    ("EKF2_OF_CTRL", Kept::Long, 0.0),
    ("MAV_SYS_ID", Kept::Long, 1.0),
];

/// The parameters of one double.
#[derive(Clone, Debug)]
pub struct DoubleParameters {
    kind: AutopilotKind,
    rows: Vec<(&'static str, Kept, f64)>,
}

/// A parameter that the double does not have.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
#[error("the double has no parameter {0}")]
pub struct UnknownParameter(pub String);

impl DoubleParameters {
    /// Set up as the documentation says.
    pub fn documented(kind: AutopilotKind) -> Self {
        let rows = if kind == AutopilotKind::Px4 { PX4 } else { ARDUPILOT };
        Self { kind, rows: rows.to_vec() }
    }

    /// The value of one of the double's own parameters; 0 for any other.
    pub fn get(&self, name: &str) -> f64 {
        self.index(name).map_or(0.0, |i| self.rows[i].2)
    }

    /// Sets one.
    ///
    /// # Errors
    /// [`UnknownParameter`].
    pub fn set(&mut self, name: &str, value: f64) -> Result<(), UnknownParameter> {
        let index = self.index(name).ok_or_else(|| UnknownParameter(name.to_owned()))?;
        let row = &mut self.rows[index];
        row.2 = if row.1 == Kept::Real { f64::from(value as f32) } else { value.round() };
        Ok(())
    }

    /// How many there are.
    pub fn count(&self) -> usize {
        self.rows.len()
    }

    fn index(&self, name: &str) -> Option<usize> {
        self.rows.iter().position(|(n, ..)| *n == name)
    }

    /// The place of what PARAM_REQUEST_READ asks for: by index, or by name where that is −1.
    pub fn asked(&self, index: i16, name: &str) -> Option<usize> {
        match usize::try_from(index) {
            Ok(index) => Some(index).filter(|&i| i < self.rows.len()),
            Err(_) => self.index(name),
        }
    }

    /// PARAM_VALUE of the parameter at this place.
    pub fn message(&self, index: usize) -> Option<Message> {
        let (name, kept, value) = *self.rows.get(index)?;
        Some(Message::PARAM_VALUE(apm::PARAM_VALUE_DATA {
            param_value: self.encoded(kept, value),
            param_count: self.rows.len() as u16,
            param_index: index as u16,
            param_id: name.into(),
            param_type: kept.wire(),
        }))
    }

    /// ArduPilot casts an integer to the field's 32-bit float; PX4 puts the integer's bytes there.
    fn encoded(&self, kept: Kept, value: f64) -> f32 {
        if self.kind == AutopilotKind::Px4 && kept != Kept::Real {
            return f32::from_bits(value as i32 as u32);
        }
        value as f32
    }

    /// The value in a PARAM_SET of this parameter.
    pub fn decoded(&self, name: &str, value: f32) -> Option<f64> {
        let (_, kept, _) = *self.rows.get(self.index(name)?)?;
        if self.kind == AutopilotKind::Px4 && kept != Kept::Real {
            return Some(f64::from(value.to_bits() as i32));
        }
        Some(f64::from(value))
    }

    /// The rules of aiding that follow from them.
    pub fn rules(&self) -> AidingRules {
        if self.kind == AutopilotKind::Px4 {
            return AidingRules::Ekf2(Ekf2Settings {
                control: self.get("EKF2_EV_CTRL") as u8,
                delay_s: self.get("EKF2_EV_DELAY") * 1e-3,
                most_delay_s: self.get("EKF2_DELAY_MAX") * 1e-3,
                least_quality: self.get("EKF2_EV_QMIN") as i8,
                position_noise_m: self.get("EKF2_EVP_NOISE"),
                velocity_noise_mps: self.get("EKF2_EVV_NOISE"),
                no_aid_s: self.get("EKF2_NOAID_TOUT") * 1e-6,
            });
        }
        AidingRules::Ekf3(Ekf3Settings {
            viso_type: self.get("VISO_TYPE") as u8,
            delay_s: self.get("VISO_DELAY_MS") * 1e-3,
            least_quality: self.get("VISO_QUAL_MIN") as i8,
            position_noise_m: self.get("VISO_POS_M_NSE"),
            velocity_noise_mps: self.get("VISO_VEL_M_NSE"),
            sets: [1, 2, 3].map(|n| self.source_set(n)),
        })
    }

    fn source_set(&self, number: u8) -> AidingSet {
        let source = |what: &str| AidingSource::of_parameter(self.get(&format!("EK3_SRC{number}_{what}")));
        AidingSet {
            position: source("POSXY"),
            velocity: source("VELXY"),
            climb: source("VELZ"),
            height: source("POSZ"),
            heading: source("YAW"),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn value(parameters: &DoubleParameters, name: &str) -> f32 {
        let index = parameters.asked(-1, name).unwrap();
        match parameters.message(index) {
            Some(Message::PARAM_VALUE(m)) => {
                assert_eq!((m.param_id.to_str(), usize::from(m.param_index)), (Ok(name), index));
                m.param_value
            }
            other => panic!("{other:?}"),
        }
    }

    #[test]
    fn integers_are_cast_by_one_and_copied_by_the_other() {
        let mut ardupilot = DoubleParameters::documented(AutopilotKind::ArduPilot);
        ardupilot.set("SCHED_LOOP_RATE", 50.0).unwrap();
        assert_eq!(value(&ardupilot, "SCHED_LOOP_RATE"), 50.0);
        assert_eq!(ardupilot.decoded("SCHED_LOOP_RATE", 50.0), Some(50.0));
        let px4 = DoubleParameters::documented(AutopilotKind::Px4);
        assert_eq!(value(&px4, "EKF2_EV_CTRL").to_bits(), 15);
        assert_eq!(px4.decoded("EKF2_EV_CTRL", f32::from_bits(7)), Some(7.0));
        assert_eq!(value(&px4, "EKF2_EVV_NOISE"), 0.1);
        assert!(px4.decoded("VISO_TYPE", 1.0).is_none() && px4.asked(999, "").is_none());
        assert_eq!(px4.asked(3, "anything"), Some(3));
    }

    #[test]
    fn rules_follow_from_parameters() {
        let mut parameters = DoubleParameters::documented(AutopilotKind::ArduPilot);
        parameters.set("EK3_SRC1_POSXY", 6.0).unwrap();
        let AidingRules::Ekf3(rules) = parameters.rules() else { panic!("not ArduPilot's") };
        assert_eq!(rules.sets[0].position, AidingSource::ExternalNav);
        assert_eq!((rules.sets[1].heading, rules.viso_type), (AidingSource::Own, 1));
        let AidingRules::Ekf2(rules) = DoubleParameters::documented(AutopilotKind::Px4).rules() else {
            panic!("not PX4's")
        };
        assert_eq!((rules.control, rules.no_aid_s, rules.most_delay_s), (15, 5.0, 0.2));
        assert_eq!(parameters.set("NONE", 1.0), Err(UnknownParameter("NONE".into())));
    }
}
