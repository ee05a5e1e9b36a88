//! Key files: 64 hexadecimal digits or 32 bytes, and nobody's but ours.

use std::io;
use std::os::unix::fs::MetadataExt;
use std::path::{Path, PathBuf};

use zeroize::Zeroizing;

use super::key::{KEY_LEN, KeyError, SigningKey};
use crate::files::{Overwrite, SECRET, read_plain, write_whole};

/// A key file is not larger: white space around the digits is allowed for.
const MOST_BYTES: u64 = 4 * KEY_LEN as u64;

/// Why a key file is not used.
#[derive(Debug, thiserror::Error)]
pub enum KeyFileError {
    /// It cannot be read, or is no file of its own.
    #[error("{path}: {source}")]
    Io {
        /// The file.
        path: PathBuf,
        /// The system's word.
        source: io::Error,
    },
    /// Others can read or write it.
    #[error("{path}: mode {mode:04o} lets others at the key: chmod 600 {path}")]
    Mode {
        /// The file.
        path: PathBuf,
        /// Its permissions.
        mode: u32,
    },
    /// It belongs to somebody else.
    #[error("{path}: belongs to user {owner}, and neither to this one nor to root")]
    Owner {
        /// The file.
        path: PathBuf,
        /// Whose it is.
        owner: u32,
    },
    /// It holds something else.
    #[error("{path}: {what}")]
    Content {
        /// The file.
        path: PathBuf,
        /// What is wrong.
        what: KeyError,
    },
}

/// Reads a key file that is ours (or root's) alone: mode 0600 or stricter, no link.
///
/// # Errors
/// [`KeyFileError`].
pub fn read_key(path: &Path) -> Result<SigningKey, KeyFileError> {
    let owned = || path.to_owned();
    let mut content = Zeroizing::new(Vec::with_capacity(2 * MOST_BYTES as usize));
    let meta = read_plain(path, MOST_BYTES, &mut content)
        .map_err(|source| KeyFileError::Io { path: owned(), source })?;
    let mode = meta.mode() & 0o7777;
    if mode & 0o077 != 0 {
        return Err(KeyFileError::Mode { path: owned(), mode });
    }
    let us = rustix::process::geteuid().as_raw();
    if meta.uid() != us && meta.uid() != 0 {
        return Err(KeyFileError::Owner { path: owned(), owner: meta.uid() });
    }
    SigningKey::parse(&content).map_err(|what| KeyFileError::Content { path: owned(), what })
}

/// Writes a key file of mode 0600.
///
/// # Errors
/// The system's word, with the file's name.
pub fn write_key(path: &Path, key: &SigningKey, overwrite: Overwrite) -> io::Result<()> {
    write_whole(path, key.to_hex().as_bytes(), overwrite, SECRET)
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::fs::{self, Permissions};
    use std::os::unix::fs::PermissionsExt;

    #[test]
    fn what_is_written_is_read_and_belongs_to_one_user() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("signing.key");
        let key = SigningKey::random().unwrap();
        write_key(&path, &key, Overwrite::Never).unwrap();
        assert_eq!(fs::metadata(&path).unwrap().permissions().mode() & 0o777, 0o600);
        assert_eq!(read_key(&path).unwrap().id(), key.id());
        assert!(write_key(&path, &key, Overwrite::Never).is_err());
        for mode in [0o640, 0o604, 0o660, 0o601, 0o644] {
            fs::set_permissions(&path, Permissions::from_mode(mode)).unwrap();
            let e = read_key(&path).unwrap_err().to_string();
            assert!(e.contains("chmod 600") && e.contains(&format!("{mode:04o}")), "{e}");
        }
        fs::set_permissions(&path, Permissions::from_mode(0o400)).unwrap();
        assert!(read_key(&path).is_ok());
    }

    #[test]
    fn links_devices_and_other_content_are_refused_with_the_name() {
        let folder = tempfile::tempdir().unwrap();
        let (path, link) = (folder.path().join("k"), folder.path().join("link"));
        write_key(&path, &SigningKey::new([1; 32]), Overwrite::Never).unwrap();
        std::os::unix::fs::symlink(&path, &link).unwrap();
        for wrong in [&link, folder.path(), Path::new("/dev/zero"), &folder.path().join("none")] {
            let e = read_key(wrong).unwrap_err().to_string();
            assert!(e.contains(&wrong.display().to_string()), "{e}");
        }
        write_whole(&path, b"a secret", Overwrite::Always, 0o600).unwrap();
        let e = read_key(&path).unwrap_err().to_string();
        assert!(e.contains("64 hexadecimal digits") && !e.contains("secret"), "{e}");
        write_whole(&path, &[b'a'; 200], Overwrite::Always, 0o600).unwrap();
        assert!(read_key(&path).unwrap_err().to_string().contains("larger"));
    }
}
