//! `[signing]`: whose frames are believed.

use std::path::PathBuf;

use crate::config::key::section;
use crate::wire::signing::{AcceptUnsigned, SigningSettings};

section! {
    /// MAVLink 2 signing: whose frames are believed, and that ours are.
    "signing" struct SigningKeys {
        /// The file with the key (holdover key new, or import), which nobody else may read: mode 0600. With it every frame sent is signed, and what comes is believed by its signature; "" signs nothing and looks at no signature.
        key_file: String = "";
        /// Which frames without a signature are taken: "auto" takes none with a key and all without one; "heartbeat" takes heartbeats, so that a vehicle is seen that does not sign yet.
        accept_unsigned: AcceptUnsigned = "auto" of "auto" | "never" | "heartbeat" | "always";
        /// Take frames without a signature on link.sensor_endpoints.
        accept_unsigned_sensors: bool = false;
        /// Link id of the first endpoint; the others count on. Two programs of one system must not share one.
        link_id: u8 = 0 in 0.0 ..= 255.0 unit "";
    }
}

impl SigningKeys {
    pub(super) fn settings(&self, complain: &mut impl FnMut(&str, String)) -> SigningSettings {
        let key_file = (!self.key_file.is_empty()).then(|| PathBuf::from(&self.key_file));
        let refuses = matches!(self.accept_unsigned, AcceptUnsigned::Never | AcceptUnsigned::Heartbeat);
        if key_file.is_none() && refuses {
            complain(
                "signing.accept_unsigned",
                "refuses unsigned frames, which takes a signing.key_file".into(),
            );
        }
        SigningSettings {
            key_file,
            accept_unsigned: self.accept_unsigned,
            sensors_unsigned: self.accept_unsigned_sensors,
            link_id: self.link_id,
        }
    }
}
