//! Lists of logs.

use std::fs::File;
use std::io::{self, BufRead, BufReader, ErrorKind, Read};
use std::path::{Path, PathBuf};

use crate::files::named;

/// More than this is no list of logs, bytes.
const MOST_BYTES: u64 = 1 << 30;

/// What a list names, a log, a folder or an address a line; empty lines and what follows `#` at a line's beginning are left out. A path
/// that is not absolute is one from the list's own folder. `-` is standard input, whose paths are from the working directory.
///
/// # Errors
/// The system's word; a list that is no text.
pub fn listed(list: &Path) -> io::Result<Vec<PathBuf>> {
    let read = |from: &mut dyn Read, folder: &Path| {
        let mut names = Vec::new();
        for line in BufReader::new(from.take(MOST_BYTES)).lines() {
            let line = line.map_err(|e| match e.kind() {
                ErrorKind::InvalidData => {
                    io::Error::new(e.kind(), "is no text: a log or an address a line is wanted")
                }
                _ => e,
            })?;
            let name = line.trim();
            if !name.is_empty() && !name.starts_with('#') {
                // An address stays as it is: with a scheme it is not joined.
                names.push(if super::is_address(name) { name.into() } else { folder.join(name) });
            }
        }
        Ok(names)
    };
    if list.as_os_str() == "-" {
        return read(&mut io::stdin().lock(), Path::new(""));
    }
    let folder = list.parent().unwrap_or(Path::new(""));
    File::open(list).and_then(|mut file| read(&mut file, folder)).map_err(|e| named(list, &e))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_list_is_read_from_its_own_folder() {
        let folder = tempfile::tempdir().unwrap();
        let list = folder.path().join("logs.txt");
        std::fs::write(&list, "# all of May\n a.ulg \r\n\n/data/b.bin\ns3://fleet/c.ulg\n").unwrap();
        let names = listed(&list).unwrap();
        assert_eq!(names, [folder.path().join("a.ulg"), "/data/b.bin".into(), "s3://fleet/c.ulg".into()]);
        std::fs::write(&list, [0x55, 0x4C, 0xFF, 0xFE, b'\n']).unwrap();
        assert!(listed(&list).unwrap_err().to_string().contains("logs.txt: is no text"));
        assert!(listed(&folder.path().join("none")).unwrap_err().to_string().contains("none"));
    }
}
