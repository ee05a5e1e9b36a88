//! Where an autopilot may be: the serial ports of this computer, and the UDP ports that autopilots and routers send to.

use std::fs;
use std::path::{Path, PathBuf};

/// UDP ports that are usual for a companion computer, a ground station or the second of them, and a router's endpoint.
pub(super) const USUAL_UDP_PORTS: [u16; 4] = [14540, 14550, 14551, 14560];
/// Baud rates that are usual, the most usual first.
pub(super) const USUAL_BAUD_RATES: [u32; 6] = [57_600, 115_200, 921_600, 460_800, 500_000, 1_500_000];

/// The serial ports that there are, by the names that stay.
pub(super) fn serial_devices() -> Vec<String> {
    let found = tokio_serial::available_ports().unwrap_or_default();
    let names = found.into_iter().map(|port| PathBuf::from(port.port_name));
    let real = names.filter(|device| is_there(device, Path::new("/sys/class/tty")));
    by_name(real.collect(), Path::new("/dev/serial/by-id"))
}

/// A port of the computer's own chips that nothing is behind is listed, too: its type is 0.
fn is_there(device: &Path, classes: &Path) -> bool {
    let name = device.file_name().unwrap_or_default();
    let kind = fs::read_to_string(classes.join(name).join("type"));
    kind.map_or(true, |kind| !name.to_string_lossy().starts_with("ttyS") || kind.trim() != "0")
}

/// The same devices, each by its name in `by_id` where it has one.
fn by_name(devices: Vec<PathBuf>, by_id: &Path) -> Vec<String> {
    let mut links: Vec<(PathBuf, PathBuf)> = fs::read_dir(by_id)
        .into_iter()
        .flatten()
        .flatten()
        .filter_map(|entry| Some((fs::canonicalize(entry.path()).ok()?, entry.path())))
        .collect();
    links.sort();
    let mut out: Vec<String> = devices
        .into_iter()
        .map(|device| {
            let real = fs::canonicalize(&device).unwrap_or_else(|_| device.clone());
            let name =
                links.iter().find(|(target, _)| *target == real).map_or(device, |(_, link)| link.clone());
            name.display().to_string()
        })
        .collect();
    out.sort();
    out.dedup();
    out
}

/// Whether a device is a plug of USB that speaks for itself, whose baud rate means nothing.
pub(super) fn is_usb(device: &str) -> bool {
    let real = fs::canonicalize(device).unwrap_or_else(|_| PathBuf::from(device));
    real.file_name().is_some_and(|name| name.to_string_lossy().starts_with("ttyACM"))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_device_has_the_name_that_stays() {
        let folder = tempfile::tempdir().unwrap();
        let dev = |name: &str| {
            let path = folder.path().join(name);
            fs::write(&path, "").unwrap();
            path
        };
        let (acm, ama) = (dev("ttyACM0"), dev("ttyAMA0"));
        let by_id = folder.path().join("by-id");
        fs::create_dir(&by_id).unwrap();
        std::os::unix::fs::symlink("../ttyACM0", by_id.join("usb-Hex_CubeOrange-if00")).unwrap();
        let expected =
            [by_id.join("usb-Hex_CubeOrange-if00").display().to_string(), ama.display().to_string()];
        assert_eq!(by_name(vec![ama.clone(), acm.clone()], &by_id), expected);
        assert_eq!(by_name(vec![ama.clone()], &folder.path().join("none")), [ama.display().to_string()]);
        assert!(is_usb(&expected[0]) && !is_usb(&expected[1]));
    }

    #[test]
    fn a_port_that_nothing_is_behind_is_left_out() {
        let classes = tempfile::tempdir().unwrap();
        for (name, kind) in [("ttyS0", "4\n"), ("ttyS1", "0\n"), ("ttyAMA0", "0\n")] {
            fs::create_dir(classes.path().join(name)).unwrap();
            fs::write(classes.path().join(name).join("type"), kind).unwrap();
        }
        let there = |name: &str| is_there(&Path::new("/dev").join(name), classes.path());
        assert!(there("ttyS0") && there("ttyAMA0") && there("ttyUSB0") && !there("ttyS1"));
    }
}
