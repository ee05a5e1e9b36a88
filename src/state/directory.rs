//! Where states are kept.

use std::fs::{self, OpenOptions};
use std::io;
use std::path::{Path, PathBuf};

/// `state.dir`.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum StateDirectory {
    /// Nothing is kept.
    Off,
    /// The first of the usual places that can be written.
    Auto,
    /// Here.
    At(PathBuf),
}

/// Where a service keeps its state that nobody has given a place.
const OF_SERVICES: &str = "/var/lib/holdover";

impl StateDirectory {
    /// As it is configured.
    pub fn new(text: &str) -> Self {
        match text {
            "" => Self::Off,
            "auto" => Self::Auto,
            path => Self::At(PathBuf::from(path)),
        }
    }

    /// The usual places, the best first: what systemd has made for the service, what is the user's, what is the system's.
    fn usual(variable: impl Fn(&str) -> Option<String>) -> Vec<PathBuf> {
        let absolute = |name: &str| variable(name).map(PathBuf::from).filter(|path| path.is_absolute());
        let users = absolute("XDG_STATE_HOME").or_else(|| Some(absolute("HOME")?.join(".local/state")));
        let by_systemd = variable("STATE_DIRECTORY")
            .and_then(|paths| paths.split(':').next().map(PathBuf::from))
            .filter(|path| path.is_absolute());
        by_systemd
            .into_iter()
            .chain(users.map(|path| path.join("holdover")))
            .chain([OF_SERVICES.into()])
            .collect()
    }

    /// The folder, made where it is missing. `variable` reads the environment.
    ///
    /// # Errors
    /// A sentence: why there is none.
    pub fn make(&self, variable: impl Fn(&str) -> Option<String>) -> Result<Option<PathBuf>, String> {
        let places = match self {
            Self::Off => return Ok(None),
            Self::Auto => Self::usual(variable),
            Self::At(path) => vec![path.clone()],
        };
        let mut refused = Vec::new();
        for path in places {
            match fs::create_dir_all(&path).and_then(|()| try_writing(&path)) {
                Ok(()) => return Ok(Some(path)),
                Err(e) => refused.push(format!("{}: {e}", path.display())),
            }
        }
        Err(refused.join("; "))
    }
}

/// Only trying tells whether a folder can be written.
fn try_writing(folder: &Path) -> io::Result<()> {
    let trial = folder.join(format!("trial-{}", std::process::id()));
    OpenOptions::new().write(true).create_new(true).open(&trial)?;
    fs::remove_file(&trial)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_usual_places_are_tried_in_turn_and_relative_ones_are_none() {
        let set = |pairs: &'static [(&'static str, &'static str)]| {
            StateDirectory::usual(move |name| {
                pairs.iter().find(|(n, _)| *n == name).map(|(_, value)| (*value).to_owned())
            })
        };
        let paths = |p: &[&str]| p.iter().map(PathBuf::from).collect::<Vec<_>>();
        assert_eq!(set(&[]), paths(&[OF_SERVICES]));
        assert_eq!(set(&[("HOME", "/users/a")]), paths(&["/users/a/.local/state/holdover", OF_SERVICES]));
        assert_eq!(
            set(&[("STATE_DIRECTORY", "/var/lib/x:/y"), ("XDG_STATE_HOME", "/s"), ("HOME", "/users/a")]),
            paths(&["/var/lib/x", "/s/holdover", OF_SERVICES])
        );
        assert_eq!(set(&[("XDG_STATE_HOME", "s"), ("HOME", "")]), paths(&[OF_SERVICES]));
    }

    #[test]
    fn a_folder_is_made_or_told_why_not() {
        let folder = tempfile::tempdir().unwrap();
        let inner = folder.path().join("a/b");
        let none = |_: &str| None;
        assert_eq!(StateDirectory::At(inner.clone()).make(none), Ok(Some(inner.clone())));
        assert!(inner.is_dir());
        let file = folder.path().join("file");
        fs::write(&file, "").unwrap();
        let refused = StateDirectory::new(file.join("x").to_str().unwrap()).make(none);
        assert!(refused.unwrap_err().contains("file/x"));
        assert_eq!(StateDirectory::new("").make(none), Ok(None));
    }
}
