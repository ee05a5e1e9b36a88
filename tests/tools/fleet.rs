//! Evaluations of many logs: split, interrupted, gone on with, and put together.

use std::fs;
use std::path::{Path, PathBuf};
use std::process::{Child, Command, Stdio};
use std::thread::sleep;
use std::time::Duration;

use serde_json::Value;
use tempfile::{TempDir, tempdir};

use crate::command::{COPTER, PX4, Ran, bytes_of, holdover, holdover_with, records, write_log};

/// What is asked: little, so that many logs take little time.
const QUESTION: [&str; 6] = ["--lengths", "15,10", "--starts", "2", "--estimator", "shipped"];

/// A folder with flights, a damaged one, and one that cannot be flown.
fn fleet() -> (TempDir, Vec<PathBuf>) {
    let folder = tempdir().unwrap();
    let write = |name: &str, bytes: &[u8]| write_log(folder.path(), name, bytes);
    let copter = records(COPTER, 0.0, 110.0);
    let mut without_imu = copter.clone();
    without_imu.retain(|r| !matches!(r.id(), 26 | 27 | 105 | 116 | 129));
    let logs = vec![
        write("a.tlog", &bytes_of(&copter)),
        write("b-noise.tlog", &[0x55; 5000]),
        write("c-without-imu.tlog", &bytes_of(&without_imu)),
        write("d.tlog", &bytes_of(&records(PX4, 0.0, 130.0))),
        write("e.tlog", &bytes_of(&copter[..copter.len() - 1])),
    ];
    let names: Vec<String> =
        logs.iter().map(|l| l.file_name().unwrap().to_str().unwrap().to_owned()).collect();
    write("list", format!("# all\n{}\n", names.join("\n")).as_bytes());
    (folder, logs)
}

fn arguments<'a>(more: &[&'a str]) -> Vec<&'a str> {
    [&["evaluate"], &QUESTION[..], more].concat()
}

fn text(path: &Path) -> &str {
    path.to_str().unwrap()
}

fn shard(list: &Path, out: &Path, of: &str) -> Value {
    holdover(&arguments(&["--list", text(list), "--out", text(out), "--shard", of, "--json"])).json()
}

fn merge(out: &Path, more: &[&str]) -> Ran {
    holdover(&[&["evaluate", "--merge", text(out)], more].concat())
}

#[test]
fn all_shards_together_print_what_one_run_prints() {
    let (folder, _) = fleet();
    let (list, out) = (folder.path().join("list"), folder.path().join("out"));
    for i in ["2/3", "0/3", "1/3"] {
        shard(&list, &out, i);
    }
    let entries = fs::read_dir(&out).unwrap().map(|e| e.unwrap().file_name().into_string().unwrap());
    assert!(
        entries
            .collect::<Vec<_>>()
            .iter()
            .all(|n| n.starts_with("shard-000") && n.ends_with("-of-0003.parquet"))
    );
    for more in [&[][..], &["--json"]] {
        let alone = holdover(&arguments(&[&["--list", text(&list)], more].concat()));
        let together = merge(&out, more);
        assert_eq!((alone.code, together.code), (Some(0), Some(0)), "{alone:?}");
        assert_eq!(together.out, alone.out);
        assert_eq!(together.err, alone.err);
    }
    let together = merge(&out, &[]);
    assert!(
        together.err.contains("b-noise.tlog: no log") && together.err.contains("c-without-imu.tlog: no IMU")
    );
    let rows = merge(&out, &["--json"]).json();
    assert_eq!(rows["rows"].as_array().unwrap().len(), 3 * 2 * 2);
    // One shard is lost: what there is is shown, and the exit code tells.
    fs::remove_file(out.join("shard-0001-of-0003.parquet")).unwrap();
    let part = merge(&out, &[]);
    assert!(part.code == Some(4) && part.err.contains("shards are missing: 1"), "{part:?}");
    assert!(part.out.contains("shipped"));
}

/// A run that is killed while it works; a test that fails leaves none behind.
struct Killed(Child);

impl Drop for Killed {
    fn drop(&mut self) {
        let _ = self.0.kill();
        let _ = self.0.wait();
    }
}

#[test]
fn what_is_done_is_skipped_also_after_a_kill_and_what_changed_is_done_again() {
    let (folder, logs) = fleet();
    let (list, out) = (folder.path().join("list"), folder.path().join("out"));
    let journal = out.join(".shard-0000-of-0001.journal");
    let command = arguments(&["--list", text(&list), "--out", text(&out), "--jobs", "1"]);
    let child = Command::new(env!("CARGO_BIN_EXE_holdover"))
        .args(&command)
        .stdout(Stdio::null())
        .stderr(Stdio::null())
        .spawn()
        .unwrap();
    let killed = Killed(child);
    // Its head, and two logs: the third that is flown takes some time.
    let lines = || fs::read(&journal).map_or(0, |b| b.iter().filter(|b| **b == b'\n').count());
    for _ in 0..3000 {
        if lines() >= 3 {
            break;
        }
        sleep(Duration::from_millis(20));
    }
    drop(killed);
    assert!(lines() >= 3);
    let count = |told: &Value| (told["done_before"].as_u64().unwrap(), told["done_now"].as_u64().unwrap());
    let (before, now) = count(&shard(&list, &out, "0/1"));
    assert!(before >= 2 && before + now == 5, "{before} {now}");
    assert!(!journal.exists());
    let alone = holdover(&arguments(&["--list", text(&list)]));
    assert_eq!(merge(&out, &[]).out, alone.out);
    assert_eq!(count(&shard(&list, &out, "0/1")), (5, 0));
    // A log that was damaged is whole now.
    fs::copy(&logs[0], &logs[1]).unwrap();
    assert_eq!(count(&shard(&list, &out, "0/1")), (4, 1));
    assert!(!merge(&out, &[]).err.contains("b-noise"));
    // Another configuration, or other outages: everything again.
    let set = ["--list", text(&list), "--out", text(&out), "--json", "--set", "outbound.rate_hz=40"];
    assert_eq!(count(&holdover(&arguments(&set)).json()), (0, 5));
}

#[test]
fn tasks_of_an_array_take_their_shard_from_the_environment() {
    let (folder, _) = fleet();
    let (list, out) = (folder.path().join("list"), folder.path().join("out"));
    let auto = |of: &str, variables: &[(&str, &str)]| {
        holdover_with(
            &arguments(&["--list", text(&list), "--out", text(&out), "--shard", of, "--json"]),
            variables,
        )
    };
    let slurm = [
        ("SLURM_ARRAY_TASK_ID", "1"),
        ("SLURM_ARRAY_TASK_COUNT", "5"),
        ("SLURM_ARRAY_TASK_MIN", "0"),
        ("SLURM_ARRAY_TASK_MAX", "4"),
    ];
    assert_eq!(auto("auto", &slurm).json()["shard"], "1/5");
    let again = auto("auto/5", &[("JOB_COMPLETION_INDEX", "1")]).json();
    assert_eq!(
        (&again["shard"], &again["done_before"], &again["without_rows"]),
        (&"1/5".into(), &1.into(), &1.into())
    );
    auto("auto", &[]).fails(2, &["SLURM_ARRAY_TASK_ID", "JOB_COMPLETION_INDEX"]);
    auto("5/5", &[]).fails(2, &["0 to 4"]);
    holdover(&arguments(&["--list", text(&list), "--shard", "0/2"])).fails(2, &["--out"]);
    holdover(&["evaluate"]).fails(2, &["LOG"]);
    holdover(&arguments(&["--list", text(&folder.path().join("none"))])).fails(2, &["none"]);
    merge(folder.path(), &[]).fails(3, &["no results"]);
    fs::write(out.join("shard-0000-of-0005.parquet"), b"PAR1 is not all of it").unwrap();
    merge(&out, &[]).fails(3, &["shard-0000-of-0005.parquet"]);
}

#[test]
fn a_folder_that_cannot_be_made_is_told() {
    let (folder, logs) = fleet();
    let out = folder.path().join("file");
    fs::write(&out, "in the way").unwrap();
    let told = holdover(&arguments(&[text(&logs[1]), "--out", text(&out)]));
    assert!(told.code == Some(2) && told.err.contains("file"), "{told:?}");
}

#[cfg(not(feature = "object-store"))]
#[test]
fn an_address_says_how_to_build_for_it() {
    holdover(&arguments(&["s3://fleet/flights/"]))
        .fails(3, &["s3://fleet/flights/", "--features object-store"]);
}
