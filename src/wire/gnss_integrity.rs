//! GNSS_INTEGRITY: what a receiver says of its own signals. The dialect of the mavlink crate does not have it, so it is read here.
//!
//! Layout of the payload as the definition in `development.xml` orders it on the wire, largest fields first: system_errors u32, raim_hfom
//! u16, raim_vfom u16, then bytes: id, authentication_state, jamming_state, spoofing_state, raim_state, corrections_quality,
//! system_status_summary, gnss_signal_quality, post_processing_quality. MAVLink 2 cuts trailing zeros.

use crate::sample::GnssWarning;

/// Number of the message.
pub const ID: u32 = 441;
/// Its name.
pub const NAME: &str = "GNSS_INTEGRITY";
/// Seed of its checksum: names and types of its fields.
pub const CRC_EXTRA: u8 = 169;

/// Length of the whole payload, and where the fields that are read stand in it.
const LEN: usize = 17;
const RECEIVER: usize = 8;
const JAMMING: usize = 10;
const SPOOFING: usize = 11;
const RAIM: usize = 12;

/// `…_DETECTED` of `GPS_JAMMING_STATE` and `GPS_SPOOFING_STATE`: found, and not mitigated.
const DETECTED: u8 = 3;
/// `GPS_RAIM_STATE_FAILED`.
const RAIM_FAILED: u8 = 3;

/// The receiver, and what it warns of; `None` for a payload that is longer than the definition.
pub(super) fn read(payload: &[u8]) -> Option<(u8, Option<GnssWarning>)> {
    let mut whole = [0; LEN];
    whole.get_mut(..payload.len())?.copy_from_slice(payload);
    let warning = if whole[SPOOFING] == DETECTED {
        Some(GnssWarning::Spoofed)
    } else if whole[JAMMING] == DETECTED {
        Some(GnssWarning::Jammed)
    } else {
        (whole[RAIM] == RAIM_FAILED).then_some(GnssWarning::Inconsistent)
    };
    Some((whole[RECEIVER], warning))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn states_are_read_where_the_definition_puts_them() {
        let mut payload = [0; LEN];
        payload[..4].copy_from_slice(&7u32.to_le_bytes());
        payload[RECEIVER] = 1;
        assert_eq!(read(&payload), Some((1, None)));
        // Mitigated is no warning.
        (payload[JAMMING], payload[SPOOFING]) = (2, 2);
        assert_eq!(read(&payload), Some((1, None)));
        payload[JAMMING] = DETECTED;
        assert_eq!(read(&payload[..13]), Some((1, Some(GnssWarning::Jammed))));
        payload[SPOOFING] = DETECTED;
        assert_eq!(read(&payload[..12]), Some((1, Some(GnssWarning::Spoofed))));
        (payload[JAMMING], payload[SPOOFING], payload[RAIM]) = (0, 0, RAIM_FAILED);
        assert_eq!(read(&payload), Some((1, Some(GnssWarning::Inconsistent))));
        assert_eq!(read(&[]), Some((0, None)));
        assert_eq!(read(&[0; LEN + 1]), None);
    }

    #[test]
    fn the_checksum_is_that_of_the_names_and_types_of_its_fields() {
        let bytes = ["id", "authentication_state", "jamming_state", "spoofing_state", "raim_state"];
        let more = [
            "corrections_quality",
            "system_status_summary",
            "gnss_signal_quality",
            "post_processing_quality",
        ];
        let mut text = format!("{NAME} uint32_t system_errors uint16_t raim_hfom uint16_t raim_vfom ");
        for field in bytes.iter().chain(&more) {
            text += &format!("uint8_t {field} ");
        }
        // The crate's checksum ends with the seed itself; X.25 without it is what the definition asks for.
        let (last, head) = text.as_bytes().split_last().unwrap();
        let crc = mavlink::calculate_crc(head, *last);
        assert_eq!((crc & 0xFF) as u8 ^ (crc >> 8) as u8, CRC_EXTRA);
    }
}
