//! Where an autopilot is reached: `udpin:0.0.0.0:14550`, `tcpout:[::1]:5760`, `serial:/dev/ttyAMA0:921600`.

use std::fmt;
use std::net::Ipv6Addr;
use std::str::FromStr;

use serde::{Deserialize, Deserializer, Serialize, Serializer};

/// The forms an endpoint may have, for messages.
pub const ACCEPTED_FORMS: &str = "udpin:HOST:PORT, udpout:HOST:PORT, tcpin:HOST:PORT, tcpout:HOST:PORT, serial:DEVICE:BAUD \
     (an IPv6 address stands in brackets: udpin:[::]:14550)";

/// One end of a link.
#[derive(Clone, PartialEq, Eq, Hash, Debug)]
pub enum Endpoint {
    /// Binds to the address and answers the autopilot that is heard there.
    UdpIn(HostPort),
    /// Sends to the address, and hears what it answers.
    UdpOut(HostPort),
    /// Listens at the address and serves one client at a time.
    TcpIn(HostPort),
    /// Connects to the address, again and again if need be.
    TcpOut(HostPort),
    /// Opens a serial device, again when it comes back.
    Serial(SerialPort),
}

/// A host name or address, and a port. Only parsing makes one, so it is always well formed.
#[derive(Clone, PartialEq, Eq, Hash, Debug)]
pub struct HostPort {
    host: String,
    port: u16,
}

/// A serial device and its speed. Only parsing makes one, so it is always well formed.
#[derive(Clone, PartialEq, Eq, Hash, Debug)]
pub struct SerialPort {
    device: String,
    baud: u32,
}

impl HostPort {
    /// The host, an IPv6 address without its brackets.
    pub fn host(&self) -> &str {
        &self.host
    }

    /// The port; 0 lets the system choose, where Holdover listens.
    pub fn port(&self) -> u16 {
        self.port
    }
}

impl SerialPort {
    /// The device's path or name.
    pub fn device(&self) -> &str {
        &self.device
    }

    /// Bits per second.
    pub fn baud(&self) -> u32 {
        self.baud
    }
}

/// A text that is not an endpoint.
#[derive(Clone, PartialEq, Eq, Debug, thiserror::Error)]
#[error("\"{text}\" is not an endpoint: {fault}; the accepted forms are {ACCEPTED_FORMS}")]
pub struct EndpointError {
    /// What was given.
    pub text: String,
    /// What is wrong with it.
    pub fault: EndpointFault,
}

/// What is wrong with an endpoint's text.
#[derive(Clone, PartialEq, Eq, Debug, thiserror::Error)]
pub enum EndpointFault {
    /// The text does not begin with a kind and a colon.
    #[error("it does not begin with a kind and a colon")]
    NoKind,
    /// The kind is not one of ours.
    #[error("\"{0}\" is not a kind of link")]
    UnknownKind(String),
    /// There is nothing after the last colon, or no colon.
    #[error("the port is missing")]
    NoPort,
    /// The port is not a number from 0 to 65535.
    #[error("\"{0}\" is not a port (0 to 65535)")]
    BadPort(String),
    /// Port 0 cannot be connected to.
    #[error("port 0 cannot be sent to")]
    PortZero,
    /// No host before the port.
    #[error("the host is missing")]
    NoHost,
    /// The host holds blanks, stray colons or brackets.
    #[error("\"{0}\" is not a host name or address")]
    BadHost(String),
    /// No device before the baud rate.
    #[error("the device is missing")]
    NoDevice,
    /// The device's name holds control characters.
    #[error("the device name holds control characters")]
    BadDevice,
    /// No baud rate after the device.
    #[error("the baud rate is missing")]
    NoBaud,
    /// The baud rate is not a positive number.
    #[error("\"{0}\" is not a baud rate")]
    BadBaud(String),
}

impl FromStr for Endpoint {
    type Err = EndpointError;

    fn from_str(text: &str) -> Result<Self, EndpointError> {
        parse(text).map_err(|fault| EndpointError { text: text.to_owned(), fault })
    }
}

fn parse(text: &str) -> Result<Endpoint, EndpointFault> {
    let (kind, rest) = text.split_once(':').ok_or(EndpointFault::NoKind)?;
    match kind {
        "udpin" => host_port(rest).map(Endpoint::UdpIn),
        "udpout" => remote(rest).map(Endpoint::UdpOut),
        "tcpin" => host_port(rest).map(Endpoint::TcpIn),
        "tcpout" => remote(rest).map(Endpoint::TcpOut),
        "serial" => serial_port(rest).map(Endpoint::Serial),
        other => Err(EndpointFault::UnknownKind(other.to_owned())),
    }
}

fn remote(rest: &str) -> Result<HostPort, EndpointFault> {
    let address = host_port(rest)?;
    if address.port == 0 { Err(EndpointFault::PortZero) } else { Ok(address) }
}

fn host_port(rest: &str) -> Result<HostPort, EndpointFault> {
    let (host, port) = rest.rsplit_once(':').ok_or(EndpointFault::NoPort)?;
    // The last colon of `[::1]` belongs to the address.
    if port.is_empty() || port.ends_with(']') {
        return Err(EndpointFault::NoPort);
    }
    let port = digits(port).ok_or_else(|| EndpointFault::BadPort(port.to_owned()))?;
    if host.is_empty() {
        return Err(EndpointFault::NoHost);
    }
    let bad = || EndpointFault::BadHost(host.to_owned());
    let name = match host.strip_prefix('[') {
        Some(inner) => {
            let inner = inner.strip_suffix(']').ok_or_else(bad)?;
            let address = inner.split_once('%').map_or(inner, |(address, _zone)| address);
            address.parse::<Ipv6Addr>().map_err(|_| bad())?;
            inner
        }
        None => host,
    };
    let stray = |c: char| c.is_whitespace() || c.is_control() || matches!(c, '[' | ']' | '/');
    if name.chars().any(stray) || (name == host && host.contains(':')) {
        return Err(bad());
    }
    Ok(HostPort { host: name.to_owned(), port })
}

fn serial_port(rest: &str) -> Result<SerialPort, EndpointFault> {
    // A device's name may hold colons (`/dev/serial/by-path/…-usb-0:1:1.0`), a baud rate cannot.
    let (device, baud) = rest.rsplit_once(':').ok_or(EndpointFault::NoBaud)?;
    if device.is_empty() {
        return Err(EndpointFault::NoDevice);
    }
    if device.chars().any(char::is_control) {
        return Err(EndpointFault::BadDevice);
    }
    if baud.is_empty() {
        return Err(EndpointFault::NoBaud);
    }
    match digits(baud) {
        Some(rate) if rate > 0 => Ok(SerialPort { device: device.to_owned(), baud: rate }),
        _ => Err(EndpointFault::BadBaud(baud.to_owned())),
    }
}

/// Digits only: `FromStr` for integers would take a sign, too.
fn digits<T: FromStr>(text: &str) -> Option<T> {
    if text.bytes().all(|b| b.is_ascii_digit()) { text.parse().ok() } else { None }
}

impl fmt::Display for HostPort {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        if self.host.contains(':') {
            write!(f, "[{}]:{}", self.host, self.port)
        } else {
            write!(f, "{}:{}", self.host, self.port)
        }
    }
}

impl fmt::Display for SerialPort {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "{}:{}", self.device, self.baud)
    }
}

impl fmt::Display for Endpoint {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Endpoint::UdpIn(address) => write!(f, "udpin:{address}"),
            Endpoint::UdpOut(address) => write!(f, "udpout:{address}"),
            Endpoint::TcpIn(address) => write!(f, "tcpin:{address}"),
            Endpoint::TcpOut(address) => write!(f, "tcpout:{address}"),
            Endpoint::Serial(port) => write!(f, "serial:{port}"),
        }
    }
}

impl Serialize for Endpoint {
    fn serialize<S: Serializer>(&self, serializer: S) -> Result<S::Ok, S::Error> {
        serializer.collect_str(self)
    }
}

impl<'de> Deserialize<'de> for Endpoint {
    fn deserialize<D: Deserializer<'de>>(deserializer: D) -> Result<Self, D::Error> {
        String::deserialize(deserializer)?.parse().map_err(serde::de::Error::custom)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    fn fault(text: &str) -> EndpointFault {
        text.parse::<Endpoint>().unwrap_err().fault
    }

    #[test]
    fn each_form_is_read() {
        let Endpoint::UdpIn(a) = "udpin:0.0.0.0:14550".parse().unwrap() else { panic!("kind") };
        assert_eq!((a.host(), a.port()), ("0.0.0.0", 14550));
        let Endpoint::TcpOut(a) = "tcpout:[fe80::1%eth0]:5760".parse().unwrap() else { panic!("kind") };
        assert_eq!((a.host(), a.port()), ("fe80::1%eth0", 5760));
        let Endpoint::Serial(p) = "serial:/dev/serial/by-path/usb-0:1:1.0:57600".parse().unwrap() else {
            panic!("kind")
        };
        assert_eq!((p.device(), p.baud()), ("/dev/serial/by-path/usb-0:1:1.0", 57600));
    }

    #[test]
    fn each_fault_is_named() {
        assert_eq!(fault("14550"), EndpointFault::NoKind);
        assert_eq!(fault("udp:1.2.3.4:5"), EndpointFault::UnknownKind("udp".into()));
        assert_eq!(fault("udpin:localhost"), EndpointFault::NoPort);
        assert_eq!(fault("udpin:[::1]"), EndpointFault::NoPort);
        assert_eq!(fault("udpin:localhost:"), EndpointFault::NoPort);
        assert_eq!(fault("udpin:localhost:+5"), EndpointFault::BadPort("+5".into()));
        assert_eq!(fault("udpin:localhost:65536"), EndpointFault::BadPort("65536".into()));
        assert_eq!(fault("udpout:localhost:0"), EndpointFault::PortZero);
        assert_eq!(fault("tcpin::5760"), EndpointFault::NoHost);
        assert_eq!(fault("tcpin:::1:5760"), EndpointFault::BadHost("::1".into()));
        assert_eq!(fault("tcpin:[x]:5760"), EndpointFault::BadHost("[x]".into()));
        assert_eq!(fault("tcpin:a b:5760"), EndpointFault::BadHost("a b".into()));
        assert_eq!(fault("serial:/dev/ttyS0"), EndpointFault::NoBaud);
        assert_eq!(fault("serial::57600"), EndpointFault::NoDevice);
        assert_eq!(fault("serial:/dev/ttyS0:fast"), EndpointFault::BadBaud("fast".into()));
        assert_eq!(fault("serial:/dev/ttyS0:0"), EndpointFault::BadBaud("0".into()));
    }

    #[test]
    fn an_error_quotes_the_text_and_lists_the_forms() {
        let message = "udp:1.2.3.4:5".parse::<Endpoint>().unwrap_err().to_string();
        assert!(message.contains("\"udp:1.2.3.4:5\"") && message.contains("serial:DEVICE:BAUD"), "{message}");
    }

    #[test]
    fn serde_goes_through_the_text() {
        let endpoint: Endpoint = serde_json::from_str("\"udpin:[::]:14550\"").unwrap();
        assert_eq!(serde_json::to_string(&endpoint).unwrap(), "\"udpin:[::]:14550\"");
        let error = serde_json::from_str::<Endpoint>("\"udpin:x\"").unwrap_err().to_string();
        assert!(error.contains("\"udpin:x\""), "{error}");
    }

    proptest! {
        #[test]
        fn text_and_endpoint_round_trip(
            kind in prop::sample::select(vec!["udpin", "udpout", "tcpin", "tcpout"]),
            host in prop_oneof![
                "[a-z][a-z0-9.-]{0,20}",
                any::<[u8; 4]>().prop_map(|b| std::net::Ipv4Addr::from(b).to_string()),
                any::<u128>().prop_map(|b| format!("[{}]", Ipv6Addr::from(b))),
            ],
            port in 1u16..,
            device in "[!-~]{1,30}",
            baud in 1u32..,
        ) {
            for text in [format!("{kind}:{host}:{port}"), format!("serial:{device}:{baud}")] {
                let endpoint: Endpoint = text.parse().unwrap();
                prop_assert_eq!(endpoint.to_string(), text);
            }
        }

        #[test]
        fn whatever_parses_prints_to_what_parses_the_same(
            text in "(udpin|udpout|tcpin|tcpout|serial|x)?[:\\[\\]a-f0-9%.]{0,16}(:[0-9]{1,6})?",
        ) {
            if let Ok(endpoint) = text.parse::<Endpoint>() {
                prop_assert_eq!(endpoint.to_string().parse::<Endpoint>().unwrap(), endpoint);
            }
        }

        #[test]
        fn arbitrary_text_never_panics(text in any::<String>()) {
            let _ = text.parse::<Endpoint>();
        }
    }
}
