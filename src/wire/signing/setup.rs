//! Handing a key to an autopilot: SETUP_SIGNING, which carries it in clear.

use mavlink::dialects::ardupilotmega::{MavMessage, SETUP_SIGNING_DATA};

use super::key::SigningKey;
use super::signature::{Signature, SigningStamp};
use crate::wire::frame::{ComponentId, Frame, SystemId};

/// The message that makes a vehicle sign with this key from now on, at this time of day (µs since 1970). Whoever hears the link has the key.
pub fn setup_signing(to: (SystemId, ComponentId), key: &SigningKey, unix_us: i64) -> MavMessage {
    MavMessage::SETUP_SIGNING(SETUP_SIGNING_DATA {
        initial_timestamp: SigningStamp::of_unix_us(unix_us).0,
        target_system: to.0.0,
        target_component: to.1.0,
        secret_key: *key.bytes(),
    })
}

/// Whether a frame carries a signature by this key, whatever its stamp.
pub fn is_signed_with(frame: &Frame<'_>, key: &SigningKey) -> bool {
    Signature::of(frame).is_some_and(|signature| signature.fits(frame, key))
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::wire::session::Address;
    use crate::wire::session::outgoing::FrameWriter;
    use crate::wire::signing::signature::signed;

    #[test]
    fn the_message_carries_key_and_time_to_one_autopilot() {
        let key = SigningKey::new([7; 32]);
        let to = (SystemId(3), ComponentId::AUTOPILOT);
        let message = setup_signing(to, &key, 1_420_070_401_000_000);
        let from = Address { system: SystemId(255), component: ComponentId(190) };
        let bytes = FrameWriter::new(from).write(&message).unwrap();
        let Ok(MavMessage::SETUP_SIGNING(sent)) = bytes.frame().unwrap().parse() else {
            panic!("no such message")
        };
        assert_eq!((sent.target_system, sent.target_component), (3, 1));
        assert_eq!((sent.secret_key, sent.initial_timestamp), ([7; 32], SigningStamp::PER_SECOND));
        assert!(!is_signed_with(&bytes.frame().unwrap(), &key));
        let signed = signed(&bytes, &key, 0, SigningStamp(4)).unwrap();
        assert!(is_signed_with(&signed.frame().unwrap(), &key));
        assert!(!is_signed_with(&signed.frame().unwrap(), &SigningKey::new([6; 32])));
    }
}
