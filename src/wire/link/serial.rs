//! Serial ports.

use std::io;
use std::time::Duration;

use tokio_serial::{SerialPortBuilderExt, SerialStream};

use super::OpenError;
use super::session::{Connect, keep_connected};
use super::shared::Shared;
use crate::wire::endpoint::{Endpoint, SerialPort};

/// A serial port that was open once, and is opened again whenever it comes back.
#[derive(Debug)]
pub(super) struct Port {
    reopen: Reopen,
    stream: SerialStream,
}

#[derive(Debug)]
struct Reopen {
    device: String,
    baud: u32,
}

impl Port {
    pub(super) fn open(endpoint: &Endpoint, port: &SerialPort) -> Result<Self, OpenError> {
        let reopen = Reopen { device: port.device().to_owned(), baud: port.baud() };
        let stream = reopen.open().map_err(|error| {
            let (endpoint, device) = (endpoint.clone(), reopen.device.clone());
            // The serial crate calls most failures "no device": the file system knows better.
            match error.kind() {
                io::ErrorKind::PermissionDenied => OpenError::PermissionDenied { endpoint },
                io::ErrorKind::ResourceBusy => OpenError::DeviceInUse { endpoint, device },
                _ if !std::path::Path::new(&device).exists() => OpenError::NoDevice { endpoint, device },
                _ if says_busy(&error) => OpenError::DeviceInUse { endpoint, device },
                _ => OpenError::Other { endpoint, source: error },
            }
        })?;
        Ok(Self { reopen, stream })
    }

    pub(super) async fn run(self, shared: &Shared) {
        let first = (self.stream, self.reopen.device.clone());
        keep_connected(&self.reopen, Some(first), shared).await;
    }
}

fn says_busy(error: &io::Error) -> bool {
    let text = error.to_string();
    text.contains("busy") || text.contains("lock")
}

impl Reopen {
    fn open(&self) -> io::Result<SerialStream> {
        tokio_serial::new(&self.device, self.baud).open_native_async().map_err(io::Error::from)
    }
}

impl Connect for Reopen {
    type Stream = SerialStream;

    async fn connect(&self, _shared: &Shared) -> io::Result<(SerialStream, String)> {
        self.open().map(|stream| (stream, self.device.clone()))
    }

    /// An autopilot that is being flashed is silent; the port is still the right one.
    fn silence(&self, _shared: &Shared) -> Option<Duration> {
        None
    }
}
