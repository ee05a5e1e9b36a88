//! SIGHUP: the configuration is read again, and what can change in flight is changed. What cannot is named, and stays.

use crate::config::{InForce, LOG_VARIABLE, Loaded};
use crate::daemon::lines::LogHandle;

/// What was in force at the start, or since the last SIGHUP.
#[derive(Debug)]
pub(super) struct Reload {
    in_force: Vec<InForce>,
    /// The level is given by the command line or the environment, which do not change.
    level_is_fixed: bool,
}

/// The keys that can change.
const LEVEL: &str = "log.level";
const LIMIT: &str = "log.lines_per_event_per_min";

impl Reload {
    pub(super) fn new(loaded: &Loaded, level_is_fixed: bool) -> Self {
        Self { in_force: loaded.in_force.clone(), level_is_fixed }
    }

    /// What was read again.
    pub(super) fn take(&mut self, loaded: &Loaded, handle: &LogHandle) {
        let mut changes = 0;
        for (was, is) in self.in_force.iter_mut().zip(&loaded.in_force) {
            if was.value == is.value {
                continue;
            }
            changes += 1;
            let (path, value) = (is.path(), is.value_toml());
            let changed = match path.as_str() {
                LEVEL if self.level_is_fixed => {
                    Err(format!("is given by the command line or {LOG_VARIABLE}"))
                }
                LEVEL => handle.set_level(&loaded.settings.log.level).map_err(|e| e.to_string()),
                LIMIT => {
                    handle.set_limit(loaded.settings.log.lines_per_event_per_min);
                    Ok(())
                }
                _ => Err("takes a restart".to_owned()),
            };
            match changed {
                Ok(()) => {
                    *was = is.clone();
                    tracing::warn!("{path} is {value} now");
                }
                Err(why) => {
                    tracing::warn!(
                        "{path} = {value} is not taken: it {why}; it is still {}",
                        was.value_toml()
                    )
                }
            }
        }
        if changes == 0 {
            tracing::info!("the configuration was read again: nothing has changed");
        }
    }
}
