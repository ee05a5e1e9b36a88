//! Writing telemetry logs: what [`super::tlog`] reads.

use std::io::{self, ErrorKind, Write};

use mavlink::dialects::ardupilotmega::MavMessage;

use super::session::Address;
use super::session::outgoing::FrameWriter;

/// Writes the messages of one sender, and of others beside it.
#[derive(Debug)]
pub struct TlogWriter<W> {
    to: W,
    from: Address,
    /// Every sender numbers its own frames.
    senders: Vec<(Address, FrameWriter)>,
    count: u64,
    bytes: u64,
}

impl<W: Write> TlogWriter<W> {
    /// A writer of messages `from` a component to a sink, which should be buffered.
    pub fn new(to: W, from: Address) -> Self {
        Self { to, from, senders: Vec::new(), count: 0, bytes: 0 }
    }

    /// Appends a message with the writer's clock, microseconds since 1970.
    ///
    /// # Errors
    /// What the sink says.
    pub fn write(&mut self, written_us: u64, message: &MavMessage) -> io::Result<()> {
        self.write_from(self.from, written_us, message)
    }

    /// The same of another sender.
    ///
    /// # Errors
    /// What the sink says.
    pub fn write_from(&mut self, from: Address, written_us: u64, message: &MavMessage) -> io::Result<()> {
        let known = self.senders.iter().position(|(address, _)| *address == from);
        let at = known.unwrap_or_else(|| {
            self.senders.push((from, FrameWriter::new(from)));
            self.senders.len() - 1
        });
        let frame = self.senders[at]
            .1
            .write(message)
            .ok_or_else(|| io::Error::new(ErrorKind::InvalidInput, "a message longer than a frame"))?;
        self.to.write_all(&written_us.to_be_bytes())?;
        self.to.write_all(&frame)?;
        self.count += 1;
        self.bytes += 8 + frame.len() as u64;
        Ok(())
    }

    /// Messages written.
    pub fn count(&self) -> u64 {
        self.count
    }

    /// Bytes written.
    pub fn bytes(&self) -> u64 {
        self.bytes
    }

    /// The sink, with all of it written.
    pub fn into_sink(self) -> W {
        self.to
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::wire::frame::{ComponentId, SystemId};
    use crate::wire::session::heartbeat::{SystemStatus, heartbeat};
    use crate::wire::tlog::TlogReader;

    #[test]
    fn what_is_written_is_read() {
        let mut bytes = Vec::new();
        let from = Address { system: SystemId(7), component: ComponentId::AUTOPILOT };
        let mut writer = TlogWriter::new(&mut bytes, from);
        for i in 0..300 {
            writer.write(1_767_225_600_000_000 + i, &heartbeat(SystemStatus::Active, i as u32)).unwrap();
        }
        assert_eq!(writer.count(), 300);
        let written = writer.bytes();
        let mut reader = TlogReader::new(bytes.as_slice());
        let mut n = 0;
        while let Some(record) = reader.next_record().unwrap() {
            assert_eq!(record.written_us, 1_767_225_600_000_000 + n);
            assert_eq!(record.frame.parse().unwrap(), heartbeat(SystemStatus::Active, n as u32));
            assert_eq!(record.frame.system(), SystemId(7));
            n += 1;
        }
        assert_eq!((n, reader.counters().seen().count(), written), (300, 0, bytes.len() as u64));
    }

    #[test]
    fn a_full_disk_is_told() {
        struct Full;
        impl Write for Full {
            fn write(&mut self, _: &[u8]) -> io::Result<usize> {
                Err(ErrorKind::StorageFull.into())
            }
            fn flush(&mut self) -> io::Result<()> {
                Ok(())
            }
        }
        let from = Address { system: SystemId(1), component: ComponentId::AUTOPILOT };
        let error = TlogWriter::new(Full, from).write(0, &heartbeat(SystemStatus::Boot, 0)).unwrap_err();
        assert_eq!(error.kind(), ErrorKind::StorageFull);
    }
}
