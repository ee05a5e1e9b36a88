//! From the settings to a gate with its key and its stamps.

use std::path::{Path, PathBuf};
use std::sync::Arc;

use super::gate::{SigningGate, SigningSettings};
use super::key_file::{KeyFileError, read_key};
use super::stamps::{StampKeeper, StampsError};

/// Why nothing can be signed.
#[derive(Debug, thiserror::Error)]
pub enum SigningError {
    /// The key.
    #[error("signing.key_file: {0}")]
    Key(#[from] KeyFileError),
    /// The stamps.
    #[error("signing.key_file: {0}")]
    Stamps(#[from] StampsError),
}

/// Signing as it is configured.
#[derive(Debug, Default)]
pub struct Signing {
    /// What the links' frames pass.
    pub gate: Arc<SigningGate>,
    /// What is odd about the stamps that were kept, a sentence.
    pub told: Option<String>,
    /// Keeps the stamps until it is dropped.
    keeper: Option<StampKeeper>,
}

impl Signing {
    /// For a daemon, which goes on from the stamps that were kept in the folder of states or beside the key, and keeps them.
    ///
    /// # Errors
    /// [`SigningError`]. Nothing is sent or believed without the key that was asked for.
    pub fn open(settings: &SigningSettings, states: Option<&Path>) -> Result<Self, SigningError> {
        let Some((gate, place)) = gate(settings, states)? else { return Ok(Self::default()) };
        let (keeper, told) = StampKeeper::start(Arc::clone(&gate), place)?;
        Ok(Self { gate, told, keeper: Some(keeper) })
    }

    /// For a command of a minute beside a daemon with so many links: it goes on from the stamps, and leaves them to the daemon. Its link ids are the
    /// next after the daemon's, so that the stamps of neither are those of the other's streams.
    ///
    /// # Errors
    /// [`SigningError::Key`].
    pub fn beside(
        settings: &SigningSettings,
        states: Option<&Path>,
        links: usize,
    ) -> Result<Self, SigningError> {
        let link_id = settings.link_id.wrapping_add(links as u8);
        let settings = &SigningSettings { link_id, ..settings.clone() };
        let Some((gate, place)) = gate(settings, states)? else { return Ok(Self::default()) };
        let told = StampKeeper::recall(&gate, &place).err();
        Ok(Self { gate, told, keeper: None })
    }

    /// The last stamps are kept as they are.
    pub fn close(&mut self) {
        self.keeper = None;
    }
}

type GateAndPlace = Option<(Arc<SigningGate>, PathBuf)>;

fn gate(settings: &SigningSettings, states: Option<&Path>) -> Result<GateAndPlace, SigningError> {
    let Some(file) = &settings.key_file else { return Ok(None) };
    let gate = Arc::new(SigningGate::new(Some(read_key(file)?), settings));
    Ok(Some((gate, StampKeeper::place(states, file))))
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::files::Overwrite;
    use crate::wire::signing::{SigningKey, write_key};

    #[test]
    fn a_key_that_is_asked_for_is_there_or_nothing_is_begun() {
        assert!(Signing::open(&SigningSettings::default(), None).unwrap().gate.key().is_none());
        let folder = tempfile::tempdir().unwrap();
        let file = folder.path().join("k");
        let settings = SigningSettings { key_file: Some(file.clone()), ..SigningSettings::default() };
        assert!(Signing::open(&settings, None).unwrap_err().to_string().contains("/k: "));
        write_key(&file, &SigningKey::new([1; 32]), Overwrite::Never).unwrap();
        let signing = Signing::open(&settings, None).unwrap();
        assert!(signing.gate.key().is_some() && signing.told.is_none());
        assert!(folder.path().join("k.stamps.json").is_file(), "beside the key");
        // Where stamps cannot be kept, replays could not be refused.
        let e = Signing::open(&settings, Some(&folder.path().join("no/folder"))).unwrap_err().to_string();
        assert!(e.contains("no/folder/signing.json"), "{e}");
        std::fs::write(folder.path().join("k.stamps.json"), "{}").unwrap();
        assert!(Signing::open(&settings, None).unwrap().told.unwrap().contains("replayed"));
    }
}
