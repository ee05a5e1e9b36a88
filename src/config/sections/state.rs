//! `[state]`: what survives a restart.

use crate::config::key::section;

section! {
    /// What survives a restart.
    "state" struct StateKeys {
        /// The folder in which the navigation's state is kept every second: "auto" takes the first that can be written of $STATE_DIRECTORY, $XDG_STATE_HOME/holdover, ~/.local/state/holdover and /var/lib/holdover; "" keeps none.
        dir: String = "auto";
    }
}
