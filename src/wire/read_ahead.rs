//! A window over a byte source: enough of what comes to see the next record whole, without the source in memory.

use std::io::{self, Read};

/// See the module's documentation.
pub struct ReadAhead<R> {
    source: R,
    buffer: Vec<u8>,
    start: usize,
    end: usize,
    look_ahead: usize,
    at_end: bool,
    position: u64,
}

impl<R: Read> ReadAhead<R> {
    /// A window of `capacity` bytes over `source`, which need not be buffered, that shows at least `look_ahead` of them while there are.
    pub fn new(source: R, capacity: usize, look_ahead: usize) -> Self {
        Self { source, buffer: vec![0; capacity], start: 0, end: 0, look_ahead, at_end: false, position: 0 }
    }

    /// What is in sight.
    pub fn bytes(&self) -> &[u8] {
        &self.buffer[self.start..self.end]
    }

    /// What was in sight `len` bytes before the last [`Self::advance`] by as much.
    pub fn passed(&self, len: usize) -> &[u8] {
        &self.buffer[self.start - len..self.start]
    }

    /// Nothing comes behind what is in sight.
    pub fn at_end(&self) -> bool {
        self.at_end
    }

    /// Bytes consumed so far.
    pub fn position(&self) -> u64 {
        self.position
    }

    /// The first `n` bytes in sight are done with.
    pub fn advance(&mut self, n: usize) {
        self.start += n;
        self.position += n as u64;
    }

    /// Brings the next bytes in sight.
    ///
    /// # Errors
    /// Only what the source's `read` returns.
    pub fn fill(&mut self) -> io::Result<()> {
        if self.at_end || self.end - self.start >= self.look_ahead {
            return Ok(());
        }
        self.buffer.copy_within(self.start..self.end, 0);
        self.end -= self.start;
        self.start = 0;
        while self.end < self.buffer.len() {
            match self.source.read(&mut self.buffer[self.end..]) {
                Ok(0) => {
                    self.at_end = true;
                    break;
                }
                Ok(n) => self.end += n,
                Err(e) if e.kind() == io::ErrorKind::Interrupted => {}
                Err(e) => return Err(e),
            }
        }
        Ok(())
    }
}
