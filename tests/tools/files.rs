//! Files that are written and read: whole or not at all, never through a link, and from wherever a log may come.

use std::fs;
use std::io::Write;
use std::os::unix::fs::symlink;
use std::path::Path;
use std::process::{Command, Output, Stdio};

use flate2::Compression;
use flate2::write::GzEncoder;
use holdover::wire::frame_bytes::FrameBytes;
use holdover::wire::signing::{SigningGate, SigningKey, SigningSettings};
use holdover::wire::tlog::TlogReader;

use crate::command::{PX4, bytes_of, records, write_log};

fn command(arguments: &[&str]) -> Command {
    let mut command = Command::new(env!("CARGO_BIN_EXE_holdover"));
    for (name, _) in std::env::vars_os().filter(|(n, _)| n.to_string_lossy().starts_with("HOLDOVER_")) {
        command.env_remove(name);
    }
    command.args(arguments);
    command
}

/// `holdover` with this on its standard input.
fn fed(arguments: &[&str], input: &[u8]) -> Output {
    let mut child = command(arguments)
        .stdin(Stdio::piped())
        .stdout(Stdio::piped())
        .stderr(Stdio::piped())
        .spawn()
        .unwrap();
    let (mut stdin, input) = (child.stdin.take().unwrap(), input.to_vec());
    // One that has seen enough reads no further.
    let feeding = std::thread::spawn(move || drop(stdin.write_all(&input)));
    let output = child.wait_with_output().unwrap();
    feeding.join().unwrap();
    output
}

fn said(output: &Output) -> (i32, String) {
    (output.status.code().unwrap_or(-1), String::from_utf8_lossy(&output.stderr).into_owned())
}

fn names(folder: &Path) -> Vec<String> {
    let mut names: Vec<_> =
        fs::read_dir(folder).unwrap().map(|e| e.unwrap().file_name().into_string().unwrap()).collect();
    names.sort();
    names
}

#[test]
fn a_solution_is_not_overwritten_and_not_written_through_a_link() {
    let folder = tempfile::tempdir().unwrap();
    let log = write_log(folder.path(), "a.tlog", &bytes_of(&records(PX4, 0.0, 30.0)));
    let out = folder.path().join("out");
    let replay = |more: &[&str]| {
        let arguments = ["replay", log.to_str().unwrap(), "--out", out.to_str().unwrap()];
        said(&command(&[&arguments, more].concat()).output().unwrap())
    };
    let solution = out.join("solution.csv");
    fs::create_dir(&out).unwrap();
    fs::write(&solution, "mine").unwrap();
    let (code, told) = replay(&[]);
    assert!(code == 2 && told.contains("solution.csv") && told.contains("--force"), "{code} {told}");
    assert_eq!(fs::read_to_string(&solution).unwrap(), "mine");
    let (code, told) = replay(&["--force"]);
    assert_eq!(code, 0, "{told}");
    assert!(fs::read_to_string(&solution).unwrap().starts_with("t_s,"));

    let precious = folder.path().join("precious");
    fs::write(&precious, "mine").unwrap();
    fs::remove_file(&solution).unwrap();
    symlink(&precious, &solution).unwrap();
    for more in [&[][..], &["--force"]] {
        let (code, told) = replay(more);
        assert!(code == 2 && told.contains("solution.csv") && told.contains("link"), "{code} {told}");
    }
    assert_eq!(fs::read_to_string(&precious).unwrap(), "mine");
    assert_eq!(names(&out), ["solution.csv"]);
}

/// A disk that takes no more: here a limit of 64 KiB a file, which the system tells of in the same way.
#[test]
fn a_full_disk_leaves_what_was_there_and_is_told_with_the_file() {
    let folder = tempfile::tempdir().unwrap();
    let out = folder.path().join("flight.tlog");
    let script = "ulimit -f 64; trap '' XFSZ; exec \"$@\"";
    let simulate = |more: &[&str]| {
        let output = Command::new("bash")
            .args([
                "-c",
                script,
                "-",
                env!("CARGO_BIN_EXE_holdover"),
                "simulate",
                "square",
                "--duration",
                "30",
            ])
            .args(["--out", out.to_str().unwrap()])
            .args(more)
            .output()
            .unwrap();
        let (code, told) = said(&output);
        assert!(code == 1 && told.contains("flight.tlog"), "{code} {told}");
    };
    simulate(&[]);
    assert_eq!(names(folder.path()), Vec::<String>::new());
    fs::write(&out, "before").unwrap();
    simulate(&["--force"]);
    assert_eq!(fs::read_to_string(&out).unwrap(), "before");
    assert_eq!(names(folder.path()), ["flight.tlog"]);
}

fn gzip(bytes: &[u8]) -> Vec<u8> {
    let mut encoder = GzEncoder::new(Vec::new(), Compression::fast());
    encoder.write_all(bytes).unwrap();
    encoder.finish().unwrap()
}

#[test]
fn a_log_is_read_from_standard_input_and_pipes_packed_or_not() {
    let folder = tempfile::tempdir().unwrap();
    let bytes = bytes_of(&records(PX4, 0.0, 60.0));
    let log = write_log(folder.path(), "a.tlog", &bytes);
    let of_file = command(&["inspect", "--json", log.to_str().unwrap()]).output().unwrap();
    let wanted = String::from_utf8(of_file.stdout).unwrap();
    for input in [bytes.clone(), gzip(&bytes)] {
        let output = fed(&["inspect", "--json", "-"], &input);
        assert_eq!(said(&output).0, 0, "{}", said(&output).1);
        let told = String::from_utf8(output.stdout).unwrap();
        assert_eq!(told.replace("standard input", log.to_str().unwrap()), wanted);
    }
    for arguments in
        [&["replay", "--json", "--outage", "30..50", "-"][..], &["evaluate", "-", "--lengths", "20"]]
    {
        let (code, told) = said(&fed(arguments, &bytes));
        assert!(code == 0 || told.contains("standard input: no outage"), "{arguments:?} {told}");
    }
    let pipe = folder.path().join("pipe");
    assert!(Command::new("mkfifo").arg(&pipe).status().unwrap().success());
    let (to, packed) = (pipe.clone(), gzip(&bytes));
    let feeding = std::thread::spawn(move || fs::write(to, packed));
    let output = command(&["inspect", "--json", pipe.to_str().unwrap()]).output().unwrap();
    assert_eq!(said(&output).0, 0, "{}", said(&output).1);
    feeding.join().unwrap().unwrap();
}

#[test]
fn what_is_no_log_on_standard_input_is_refused_by_its_beginning() {
    for (input, word) in [
        (vec![0; 1 << 20], "no log"),
        (b"once upon a time".to_vec(), "text file"),
        (Vec::new(), "empty"),
        (gzip(&[7; 1000]), "no log"),
    ] {
        let (code, told) = said(&fed(&["inspect", "-"], &input));
        assert!(code == 3 && told.contains("standard input") && told.contains(word), "{code} {told}");
    }
    let zeros = fs::File::open("/dev/zero").unwrap();
    let output = command(&["replay", "-"]).stdin(zeros).output().unwrap();
    assert_eq!(said(&output).0, 3);
    let (code, told) = said(&command(&["inspect", "/dev/zero"]).output().unwrap());
    assert!(code == 3 && told.contains("/dev/zero") && told.contains("device"), "{told}");
}

#[test]
fn what_is_no_configuration_is_refused_before_it_is_read() {
    let folder = tempfile::tempdir().unwrap();
    for (config, word) in [("/dev/zero", "device"), (folder.path().to_str().unwrap(), "directory")] {
        let (code, told) = said(&command(&["check", "--config", config]).output().unwrap());
        assert!(code == 2 && told.contains(config) && told.contains(word), "{code} {told}");
    }
}

#[test]
fn a_variable_of_somebody_else_is_told_and_harms_nothing() {
    let check = |name: &str, value: &str| said(&command(&["check"]).env(name, value).output().unwrap());
    let (code, told) = check("HOLDOVER_SERVICE_HOST", "10.0.0.1");
    assert!(code == 0 && told.contains("HOLDOVER_SERVICE_HOST"), "{code} {told}");
    let (code, told) = check("HOLDOVER_OUTBOUND__RAT_HZ", "5");
    assert!(
        code == 2 && told.contains("HOLDOVER_OUTBOUND__RAT_HZ") && told.contains("outbound.rate_hz"),
        "{told}"
    );
    for value in ["nan", "inf", "12345678901234567890"] {
        let (code, told) = check("HOLDOVER_OUTBOUND__RATE_HZ", value);
        assert!(code == 2 && told.contains("outbound.rate_hz") && told.contains(value), "{code} {told}");
    }
}

/// How many frames are signed is told of a log; the signatures are not looked at.
#[test]
fn inspect_tells_how_many_frames_are_signed() {
    let folder = tempfile::tempdir().unwrap();
    let gate = SigningGate::new(Some(SigningKey::new([5; 32])), &SigningSettings::default());
    let inspect = |name: &str, bytes: &[u8]| {
        let path = write_log(folder.path(), name, bytes);
        String::from_utf8(command(&["inspect", path.to_str().unwrap()]).output().unwrap().stdout).unwrap()
    };
    let plain = bytes_of(&records(PX4, 0.0, 20.0));
    assert!(!inspect("plain.tlog", &plain).contains("signed"));
    let (mut signed, mut reader) = (Vec::new(), TlogReader::new(plain.as_slice()));
    let mut n = 0;
    while let Some(record) = reader.next_record().unwrap() {
        let Some(bytes) = gate.sign(FrameBytes::new(record.frame.bytes()).unwrap(), 0, 0) else { continue };
        signed.extend(record.written_us.to_be_bytes());
        signed.extend_from_slice(&bytes);
        n += 1;
    }
    let told = inspect("signed.tlog", &signed);
    assert!(n > 100 && told.contains(&format!("{n} messages are signed")), "{n} {told}");
}
