//! Serial ports.

use std::io;
use std::path::Path;
use std::time::Duration;

use tokio_serial::{ErrorKind, SerialPortBuilderExt, SerialStream};

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
            match error.kind() {
                ErrorKind::Io(io::ErrorKind::PermissionDenied) => OpenError::PermissionDenied { endpoint },
                ErrorKind::Io(io::ErrorKind::NotFound) => OpenError::NoDevice { endpoint, device },
                // The serial crate also says this of a device that another program has locked.
                ErrorKind::NoDevice if Path::new(&device).exists() => {
                    OpenError::DeviceInUse { endpoint, device }
                }
                ErrorKind::NoDevice => OpenError::NoDevice { endpoint, device },
                _ => OpenError::Other { endpoint, source: error.into() },
            }
        })?;
        Ok(Self { reopen, stream })
    }

    pub(super) async fn run(self, shared: &Shared) {
        let first = (self.stream, self.reopen.device.clone());
        keep_connected(&self.reopen, Some(first), shared).await;
    }
}

impl Reopen {
    fn open(&self) -> tokio_serial::Result<SerialStream> {
        tokio_serial::new(&self.device, self.baud).open_native_async()
    }
}

impl Connect for Reopen {
    type Stream = SerialStream;

    async fn connect(&self, _shared: &Shared) -> io::Result<(SerialStream, String)> {
        Ok((self.open()?, self.device.clone()))
    }

    /// An autopilot that is being flashed is silent; the port is still the right one.
    fn silence(&self, _shared: &Shared) -> Option<Duration> {
        None
    }
}
