//! What every frame passes, in and out.

use std::path::PathBuf;
use std::sync::{Mutex, MutexGuard, PoisonError};

use serde::Deserialize;

use super::key::SigningKey;
use super::signature::{Signature, SigningStamp, signed};
use super::stamps::{KeptStamps, Margins};
use super::streams::{StampBook, StreamName};
use crate::wire::counters::Cause;
use crate::wire::frame::Frame;
use crate::wire::frame_bytes::FrameBytes;

/// Which frames without a signature are taken.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum AcceptUnsigned {
    /// None where there is a key, all where there is none.
    #[default]
    Auto,
    /// None.
    Never,
    /// Heartbeats, so that a vehicle is seen that does not sign yet; nothing that navigates.
    Heartbeat,
    /// All.
    Always,
}

/// `[signing]`.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct SigningSettings {
    /// Where the key is; without one nothing is signed and no signature is looked at.
    pub key_file: Option<PathBuf>,
    /// Which frames without a signature are taken.
    pub accept_unsigned: AcceptUnsigned,
    /// Frames without a signature are taken on links for sensors.
    pub sensors_unsigned: bool,
    /// Link id of the first link; the others count on.
    pub link_id: u8,
}

/// What became of frames at the gate.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct SigningCounts {
    /// With a signature that fits and a stamp that may be.
    pub verified: u64,
    /// With a signature, and no key here to look at it.
    pub no_key: u64,
    /// With a signature that does not fit: another key, or forged.
    pub bad_signature: u64,
    /// With a stamp that was heard before, or an older one.
    pub replayed: u64,
    /// Of a new stream, more than a minute behind.
    pub too_old: u64,
    /// Without a signature, refused.
    pub unsigned: u64,
}

/// `HEARTBEAT`, and what radios tell of themselves, which no radio signs.
const HEARTBEAT: u32 = 0;
const OF_RADIOS: [u32; 2] = [109, 166];

/// The gate of all links.
#[derive(Debug, Default)]
pub struct SigningGate {
    key: Option<SigningKey>,
    settings: SigningSettings,
    lenient: bool,
    state: Mutex<GateState>,
}

#[derive(Debug, Default)]
struct GateState {
    book: StampBook,
    counts: SigningCounts,
    margins: Margins,
}

impl SigningGate {
    /// A gate with this key, or without one.
    pub fn new(key: Option<SigningKey>, settings: &SigningSettings) -> Self {
        Self { key, settings: settings.clone(), lenient: false, state: Mutex::default() }
    }

    /// The same that takes whatever comes: only what goes out is signed.
    pub fn lenient(self) -> Self {
        Self { lenient: true, ..self }
    }

    fn state(&self) -> MutexGuard<'_, GateState> {
        self.state.lock().unwrap_or_else(PoisonError::into_inner)
    }

    /// The key.
    pub fn key(&self) -> Option<&SigningKey> {
        self.key.as_ref()
    }

    /// What was counted so far.
    pub fn counts(&self) -> SigningCounts {
        self.state().counts
    }

    /// What is done, in a sentence, where there is a key.
    pub fn policy(&self) -> Option<String> {
        let id = self.key.as_ref()?.id();
        let unsigned = match (self.settings.accept_unsigned, self.settings.sensors_unsigned) {
            (AcceptUnsigned::Always, _) => "unsigned frames are taken all the same: anybody can send them",
            (AcceptUnsigned::Heartbeat, false) => "of unsigned frames only heartbeats are taken",
            (AcceptUnsigned::Heartbeat, true) => {
                "of unsigned frames only heartbeats are taken, and those on links for sensors"
            }
            (_, false) => "unsigned frames are refused",
            (_, true) => "unsigned frames are refused but on links for sensors",
        };
        Some(format!("frames are signed with key {id}; {unsigned}"))
    }

    fn takes_unsigned(&self, message_id: u32, for_sensors: bool) -> bool {
        if for_sensors && self.settings.sensors_unsigned {
            return true;
        }
        match self.settings.accept_unsigned {
            AcceptUnsigned::Auto => self.key.is_none(),
            AcceptUnsigned::Never => false,
            AcceptUnsigned::Heartbeat => message_id == HEARTBEAT,
            AcceptUnsigned::Always => true,
        }
    }

    /// Judges a frame, and says what is to be noted of a signature that is good.
    fn judge(
        &self,
        book: &StampBook,
        frame: &Frame<'_>,
        for_sensors: bool,
    ) -> Result<Option<(StreamName, SigningStamp)>, Cause> {
        if self.lenient {
            return Ok(None);
        }
        let Some(signature) = Signature::of(frame) else {
            let taken = self.takes_unsigned(frame.message_id(), for_sensors);
            return if taken { Ok(None) } else { Err(Cause::Unsigned) };
        };
        let Some(key) = &self.key else { return Ok(None) };
        if !signature.fits(frame, key) {
            return Err(Cause::BadSignature);
        }
        let (system, component) = (frame.system().0, frame.component().0);
        let name = StreamName { system, component, link_id: signature.link_id };
        book.judge(name, signature.stamp).map(|()| Some((name, signature.stamp)))
    }

    /// Whether a frame may come in, at this time of day (µs since 1970). A frame that may is taken note of: it may not again.
    ///
    /// # Errors
    /// [`Cause::BadSignature`], [`Cause::Replayed`], [`Cause::OldSignature`], [`Cause::Unsigned`].
    pub fn admit(&self, frame: &Frame<'_>, for_sensors: bool, unix_us: i64) -> Result<(), Cause> {
        let mut state = self.state();
        let state = &mut *state;
        state.book.newest = state.book.newest.max(SigningStamp::of_unix_us(unix_us));
        let judged = self.judge(&state.book, frame, for_sensors);
        let counts = &mut state.counts;
        match judged {
            Ok(Some((name, stamp))) => {
                counts.verified += 1;
                state.margins.opened |= state.book.note(name, stamp);
            }
            Ok(None) => counts.no_key += u64::from(frame.is_signed() && self.key.is_none()),
            Err(Cause::BadSignature) => counts.bad_signature += 1,
            Err(Cause::Replayed) => counts.replayed += 1,
            Err(Cause::OldSignature) => counts.too_old += 1,
            // They are of no use here, and no sign of anything.
            Err(_) if OF_RADIOS.contains(&frame.message_id()) => {}
            Err(_) => counts.unsigned += 1,
        }
        judged.map(drop)
    }

    /// Whether a frame is genuine, before it is admitted: enough to answer who sent it. A stream that lags is answered, since it is from the answer
    /// that it learns the time.
    pub fn is_genuine(&self, frame: &Frame<'_>, for_sensors: bool) -> bool {
        matches!(self.judge(&self.state().book, frame, for_sensors), Ok(_) | Err(Cause::OldSignature))
    }

    /// A frame as it goes out on the link of this number: signed, where there is a key. `None` of one that cannot be, which stays here.
    pub fn sign(&self, frame: FrameBytes, link: usize, unix_us: i64) -> Option<FrameBytes> {
        let Some(key) = &self.key else { return Some(frame) };
        let stamp = self.state().book.next(SigningStamp::of_unix_us(unix_us))?;
        signed(&frame, key, self.settings.link_id.wrapping_add(link as u8), stamp)
    }

    /// What is to be kept, with what could come until it is kept again; exact at the end. Also whether a stream has opened since.
    pub(super) fn keepable(&self, at_the_end: bool) -> KeptStamps {
        let mut state = self.state();
        let GateState { book, margins, .. } = &mut *state;
        let id = self.key.as_ref().map(SigningKey::id).unwrap_or_default();
        margins.kept(book, id, at_the_end)
    }

    /// Whether a stream has opened since stamps were kept.
    pub(super) fn has_opened(&self) -> bool {
        self.state().margins.opened
    }

    /// Goes on from what was kept.
    pub(super) fn recall(&self, kept: &KeptStamps) {
        self.state().book = kept.book();
    }
}

#[cfg(test)]
mod tests;
