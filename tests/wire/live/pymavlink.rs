//! A MAVLink parser that was not written here: pymavlink, in a virtual environment under the build folder.

use std::path::{Path, PathBuf};
use std::process::{Command, Stdio};
use std::sync::Mutex;

use serde_json::Value;

static SETUP: Mutex<()> = Mutex::new(());

/// The interpreter that has pymavlink, installed when it is not there.
fn python() -> PathBuf {
    let _alone = SETUP.lock().unwrap_or_else(std::sync::PoisonError::into_inner);
    let venv = Path::new(env!("CARGO_TARGET_TMPDIR")).join("pymavlink");
    let python = venv.join("bin/python");
    let has = || quiet(Command::new(&python).args(["-c", "import pymavlink.dialects.v20.ardupilotmega"]));
    if has() {
        return python;
    }
    let made = quiet(Command::new("python3").args(["-m", "venv"]).arg(&venv))
        && quiet(Command::new(&python).args([
            "-m",
            "pip",
            "install",
            "--quiet",
            "--disable-pip-version-check",
            "--timeout",
            "20",
            "--retries",
            "1",
            "pymavlink",
        ]))
        && has();
    assert!(
        made,
        "pymavlink cannot be installed: make a virtual environment that has it at {}",
        venv.display()
    );
    python
}

fn quiet(command: &mut Command) -> bool {
    command
        .stdin(Stdio::null())
        .stdout(Stdio::null())
        .stderr(Stdio::null())
        .status()
        .is_ok_and(|s| s.success())
}

/// What pymavlink reads in `bytes`: one object a message, with `mavpackettype`, `system`, `component` and `sequence`.
pub fn decode(bytes: &[u8]) -> Vec<Value> {
    let python = python();
    let file = tempfile::NamedTempFile::new().unwrap();
    std::fs::write(file.path(), bytes).unwrap();
    let script = Path::new(env!("CARGO_MANIFEST_DIR")).join("tests/wire/live/decode.py");
    let output = Command::new(python).arg(script).arg(file.path()).output().unwrap();
    assert!(output.status.success(), "pymavlink: {}", String::from_utf8_lossy(&output.stderr));
    let text = String::from_utf8(output.stdout).unwrap();
    text.lines().map(|line| serde_json::from_str(line).unwrap()).collect()
}

/// Runs `sign.py` with these arguments over `bytes`; what it prints.
pub fn sign(arguments: &[&str], bytes: &[u8]) -> Vec<u8> {
    let python = python();
    let file = tempfile::NamedTempFile::new().unwrap();
    std::fs::write(file.path(), bytes).unwrap();
    let script = Path::new(env!("CARGO_MANIFEST_DIR")).join("tests/wire/live/sign.py");
    let input = std::fs::File::open(file.path()).unwrap();
    let output = Command::new(python).arg(script).args(arguments).stdin(input).output().unwrap();
    assert!(output.status.success(), "pymavlink: {}", String::from_utf8_lossy(&output.stderr));
    output.stdout
}

/// A telemetry log as pymavlink's tools read it: see `read_tlog.py`.
pub fn tlog(path: &Path) -> Value {
    let script = Path::new(env!("CARGO_MANIFEST_DIR")).join("tests/wire/live/read_tlog.py");
    let output = Command::new(python()).arg(script).arg(path).output().unwrap();
    assert!(output.status.success(), "pymavlink: {}", String::from_utf8_lossy(&output.stderr));
    serde_json::from_slice(&output.stdout).unwrap()
}
