//! Files that the program stands on: keys and what it has kept itself.

use std::fs::{Metadata, OpenOptions};
use std::io::{self, ErrorKind, Read};
use std::os::unix::fs::OpenOptionsExt;
use std::path::Path;

use rustix::fs::OFlags;

/// Reads a file of at most `most` bytes that is no link, no device and no pipe, into `to`, and tells of it. Errors are not named.
///
/// # Errors
/// The system's word; [`ErrorKind::InvalidInput`] where it is something else than a file, [`ErrorKind::FileTooLarge`] where there is more.
pub fn read_plain(path: &Path, most: u64, to: &mut Vec<u8>) -> io::Result<Metadata> {
    // Without waiting: a pipe would never answer. A link is refused by the system itself.
    let flags = (OFlags::NOFOLLOW | OFlags::NONBLOCK | OFlags::NOCTTY).bits();
    let opened = OpenOptions::new().read(true).custom_flags(flags.cast_signed()).open(path);
    let file = match opened {
        Err(e) if e.raw_os_error() == Some(rustix::io::Errno::LOOP.raw_os_error()) => return Err(no_file()),
        opened => opened?,
    };
    let meta = file.metadata()?;
    if !meta.is_file() {
        return Err(no_file());
    }
    file.take(most + 1).read_to_end(to)?;
    if to.len() as u64 > most {
        return Err(io::Error::new(ErrorKind::FileTooLarge, format!("is larger than {most} bytes")));
    }
    Ok(meta)
}

fn no_file() -> io::Error {
    io::Error::new(ErrorKind::InvalidInput, "is no file of its own, but a link, a folder or a device")
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn only_a_file_that_is_not_too_large_is_read() {
        let folder = tempfile::tempdir().unwrap();
        let (path, link) = (folder.path().join("a"), folder.path().join("link"));
        std::fs::write(&path, [7; 10]).unwrap();
        std::os::unix::fs::symlink(&path, &link).unwrap();
        let kind = |path: &Path, most| read_plain(path, most, &mut Vec::new()).map_err(|e| e.kind()).err();
        assert_eq!(kind(&path, 10), None);
        assert_eq!(kind(&path, 9), Some(ErrorKind::FileTooLarge));
        for other in [&link, folder.path(), Path::new("/dev/zero")] {
            assert_eq!(kind(other, 10), Some(ErrorKind::InvalidInput), "{other:?}");
        }
        assert_eq!(kind(&folder.path().join("none"), 10), Some(ErrorKind::NotFound));
    }
}
