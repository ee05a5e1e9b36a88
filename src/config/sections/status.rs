//! `[status]`: where the page, the API and the metrics are served.

use std::net::{IpAddr, Ipv4Addr, SocketAddr};

use crate::config::StatusSettings;
use crate::config::key::section;

section! {
    /// A page, an API and metrics of the running daemon, to be read only.
    "status" struct StatusKeys {
        /// Where they are served: a port, as in "8750", serves this computer alone; an address and a port, as in "0.0.0.0:8750", serves whoever reaches it. Who does can read everything, where the vehicle is before all. "" serves nothing.
        listen: String = "";
        /// Names that lead there, beside addresses and localhost, as in ["drone.local"]: a browser that asks for another name is refused.
        hosts: Vec<String> = [];
    }
}

impl StatusKeys {
    pub(super) fn settings(&self, complain: &mut impl FnMut(&str, String)) -> StatusSettings {
        let text = self.listen.trim();
        let port =
            |text: &str| text.parse().ok().map(|p| SocketAddr::new(IpAddr::V4(Ipv4Addr::LOCALHOST), p));
        let listen = port(text).or_else(|| text.parse().ok());
        if listen.is_none() && !text.is_empty() {
            complain(
                "status.listen",
                format!(
                    "is \"{text}\": expected a port, as in \"8750\", or an address and a port, as in \"0.0.0.0:8750\""
                ),
            );
        }
        for name in &self.hosts {
            let plain = |c: char| c.is_ascii_alphanumeric() || matches!(c, '-' | '.');
            if name.is_empty() || !name.chars().all(plain) {
                complain(
                    "status.hosts",
                    format!("has \"{name}\": expected a name without port, as in \"drone.local\""),
                );
            }
        }
        StatusSettings { listen, hosts: self.hosts.clone() }
    }
}
