//! An owned MAVLink frame in a fixed buffer, so that frames go through queues without an allocation each.

use std::fmt;
use std::ops::Deref;

use super::frame::{Candidate, Frame, MAX_FRAME_LEN, candidate};

/// The bytes of one frame, from the start byte to the checksum or signature.
#[derive(Clone, Copy)]
pub struct FrameBytes {
    len: usize,
    bytes: [u8; MAX_FRAME_LEN],
}

impl FrameBytes {
    /// Copies `bytes`; `None` when they are more than a frame can have.
    pub fn new(bytes: &[u8]) -> Option<Self> {
        let mut buffer = [0; MAX_FRAME_LEN];
        buffer.get_mut(..bytes.len())?.copy_from_slice(bytes);
        Some(Self { len: bytes.len(), bytes: buffer })
    }

    /// The bytes as a frame, whose checksum is not tested again. `None` when they do not hold one whole frame.
    pub fn frame(&self) -> Option<Frame<'_>> {
        match candidate(self) {
            Candidate::Frame(frame) => Some(frame),
            Candidate::Short | Candidate::NoFrame => None,
        }
    }
}

impl Deref for FrameBytes {
    type Target = [u8];
    fn deref(&self) -> &[u8] {
        &self.bytes[..self.len]
    }
}

impl PartialEq for FrameBytes {
    fn eq(&self, other: &Self) -> bool {
        **self == **other
    }
}
impl Eq for FrameBytes {}

impl fmt::Debug for FrameBytes {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self.frame() {
            Some(frame) => write!(f, "FrameBytes(id {}, {} bytes)", frame.message_id(), self.len),
            None => write!(f, "FrameBytes({} bytes)", self.len),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn holds_up_to_the_longest_frame() {
        assert!(FrameBytes::new(&[0; MAX_FRAME_LEN]).is_some());
        assert!(FrameBytes::new(&[0; MAX_FRAME_LEN + 1]).is_none());
    }

    #[test]
    fn bytes_that_are_no_frame_give_none() {
        assert!(FrameBytes::new(&[]).and_then(|b| b.frame().map(|_| ())).is_none());
        assert!(FrameBytes::new(&[0xFD, 9, 0]).and_then(|b| b.frame().map(|_| ())).is_none());
    }
}
