//! Serial ports.

use std::io;
use std::path::Path;
use std::time::Duration;

use tokio_serial::{Error, ErrorKind, SerialPortBuilderExt, SerialStream};

use super::OpenError;
use super::session::{Connect, keep_connected};
use super::shared::Shared;
use crate::wire::endpoint::{Endpoint, SerialPort};

/// A serial port that is opened when it appears, and again whenever it comes back.
#[derive(Debug)]
pub(super) struct Port {
    reopen: Reopen,
    stream: Option<SerialStream>,
}

#[derive(Debug)]
struct Reopen {
    device: String,
    baud: u32,
}

impl Port {
    /// A device that is not there is waited for; what else is wrong with it a person must put right.
    pub(super) fn open(endpoint: &Endpoint, port: &SerialPort) -> Result<Self, OpenError> {
        let reopen = Reopen { device: port.device().to_owned(), baud: port.baud() };
        match reopen.open() {
            Ok(stream) => Ok(Self { reopen, stream: Some(stream) }),
            Err(error) if reopen.is_missing(&error) => Ok(Self { reopen, stream: None }),
            Err(error) => Err(reopen.refused(endpoint.clone(), error)),
        }
    }

    pub(super) async fn run(self, shared: &Shared) {
        let first = self.stream.map(|stream| (stream, self.reopen.device.clone()));
        keep_connected(&self.reopen, first, shared).await;
    }
}

impl Reopen {
    fn open(&self) -> tokio_serial::Result<SerialStream> {
        tokio_serial::new(&self.device, self.baud).open_native_async()
    }

    fn is_missing(&self, error: &Error) -> bool {
        match error.kind() {
            ErrorKind::Io(io::ErrorKind::NotFound) => true,
            // The serial crate also says this of a device that another program has locked.
            ErrorKind::NoDevice => !Path::new(&self.device).exists(),
            _ => false,
        }
    }

    fn refused(&self, endpoint: Endpoint, error: Error) -> OpenError {
        match error.kind() {
            ErrorKind::Io(io::ErrorKind::PermissionDenied) => OpenError::PermissionDenied { endpoint },
            ErrorKind::NoDevice => OpenError::DeviceInUse { endpoint, device: self.device.clone() },
            _ => OpenError::Other { endpoint, source: error.into() },
        }
    }
}

impl Connect for Reopen {
    type Stream = SerialStream;

    async fn connect(&self, _shared: &Shared) -> io::Result<(SerialStream, String)> {
        match self.open() {
            Ok(stream) => Ok((stream, self.device.clone())),
            Err(error) if self.is_missing(&error) => {
                let missing = format!("there is no device {}", self.device);
                Err(io::Error::new(io::ErrorKind::NotFound, missing))
            }
            Err(error) => Err(error.into()),
        }
    }

    /// An autopilot that is being flashed is silent; the port is still the right one.
    fn silence(&self, _shared: &Shared) -> Option<Duration> {
        None
    }
}
