//! Pseudo-terminals: a serial cable that can be pulled.

use std::fs::{File, OpenOptions};
use std::os::fd::AsFd;
use std::os::unix::fs::{OpenOptionsExt, symlink};
use std::path::Path;

use nix::fcntl::OFlag;
use nix::pty::{grantpt, posix_openpt, ptsname_r, unlockpt};
use nix::sys::termios::{SetArg, cfmakeraw, tcgetattr, tcsetattr};
use tokio::io::{Join, join};
use tokio::net::unix::pipe::{Receiver, Sender};

/// The drone's end of a cable.
pub type Cable = Join<Receiver, Sender>;

/// A pseudo-terminal: the drone's end, and a symbolic link to the device at `path`. The other end must be kept until the
/// device was opened by its name.
///
/// Both are closed in every process that another test starts meanwhile, from the first moment on: with one that inherited them
/// no cable could be pulled.
pub fn plug_in(path: &Path) -> (Cable, File) {
    let master =
        posix_openpt(OFlag::O_RDWR | OFlag::O_NOCTTY | OFlag::O_NONBLOCK | OFlag::O_CLOEXEC).unwrap();
    grantpt(&master).unwrap();
    unlockpt(&master).unwrap();
    let name = ptsname_r(&master).unwrap();
    let device =
        OpenOptions::new().read(true).write(true).custom_flags(OFlag::O_NOCTTY.bits()).open(&name).unwrap();
    let mut settings = tcgetattr(&device).unwrap();
    cfmakeraw(&mut settings);
    tcsetattr(&device, SetArg::TCSANOW, &settings).unwrap();
    let _ = std::fs::remove_file(path);
    symlink(name, path).unwrap();
    let end = || File::from(master.as_fd().try_clone_to_owned().unwrap());
    let cable =
        join(Receiver::from_file_unchecked(end()).unwrap(), Sender::from_file_unchecked(end()).unwrap());
    (cable, device)
}
