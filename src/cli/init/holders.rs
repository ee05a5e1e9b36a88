//! Which program has a device or a port open, as far as the system lets this user see it.

use std::fs;
use std::path::{Path, PathBuf};

/// A program.
#[derive(Clone, PartialEq, Eq, Debug)]
pub(super) struct Holder {
    pid: u32,
    name: String,
}

impl std::fmt::Display for Holder {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        write!(f, "{} (process {})", self.name, self.pid)
    }
}

/// Whoever has this device open but ourselves.
pub(super) fn of_device(device: &str) -> Option<Holder> {
    let device = fs::canonicalize(device).ok()?;
    holding(|target| target == device)
}

/// Whoever has this UDP port.
pub(super) fn of_udp_port(port: u16) -> Option<Holder> {
    let tables = ["/proc/net/udp", "/proc/net/udp6"].map(|t| fs::read_to_string(t).unwrap_or_default());
    let sockets: Vec<PathBuf> = tables
        .iter()
        .flat_map(|table| inodes(table, port))
        .map(|inode| PathBuf::from(format!("socket:[{inode}]")))
        .collect();
    holding(|target| sockets.iter().any(|s| s == target))
}

/// Inodes of the sockets at a port in a table of the kernel.
fn inodes(table: &str, port: u16) -> Vec<u64> {
    let row = |line: &str| {
        let mut cells = line.split_whitespace();
        let local = cells.nth(1)?.rsplit_once(':')?.1;
        let inode = cells.nth(7)?.parse().ok()?;
        (u16::from_str_radix(local, 16).ok()? == port).then_some(inode)
    };
    table.lines().filter_map(row).collect()
}

/// The first other process with an open file that is `wanted`.
fn holding(wanted: impl Fn(&Path) -> bool) -> Option<Holder> {
    let own = std::process::id();
    let processes = fs::read_dir("/proc").ok()?.flatten();
    let numbered = processes.filter_map(|entry| entry.file_name().to_str()?.parse::<u32>().ok());
    let holds = |pid: &u32| {
        let open = fs::read_dir(format!("/proc/{pid}/fd")).into_iter().flatten().flatten();
        open.filter_map(|file| fs::read_link(file.path()).ok()).any(|target| wanted(&target))
    };
    let pid = numbered.filter(|pid| *pid != own).find(holds)?;
    let name = fs::read_to_string(format!("/proc/{pid}/comm")).unwrap_or_default();
    Some(Holder { pid, name: name.trim().to_owned() })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_port_is_found_in_the_kernels_table() {
        let table = "   sl  local_address rem_address   st tx_queue rx_queue tr tm->when retrnsmt   uid  timeout inode ref pointer drops\n\
            \u{20}1: 0100007F:38D6 00000000:0000 07 00000000:00000000 00:00000000 00000000  1000        0 4711 2 0000 0\n\
            \u{20}2: 00000000:14E9 00000000:0000 07 00000000:00000000 00:00000000 00000000   105        0 99 2 0000 0\n";
        assert_eq!(inodes(table, 14550), [4711]);
        assert!(inodes(table, 14551).is_empty() && inodes("", 1).is_empty());
    }
}
