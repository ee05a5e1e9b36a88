//! Cut, flipped, garbage within, appended, and whatever else: the damaged part is lost, counted, told, and nothing else.

use std::path::Path;
use std::sync::OnceLock;

use holdover::log::{Log, LogError};
use holdover::sample::{Input, Sample};
use holdover::wire::counters::Cause;
use proptest::prelude::*;

use crate::command::{holdover, write_log};
use crate::dataflash_file::DataFlashFile;
use crate::flight::Flight;
use crate::inputs;
use crate::ulog_file::{Fields, UlogFile};

/// A flight of some seconds as a ULog and as a DataFlash log.
fn logs() -> &'static [Vec<u8>; 2] {
    static LOGS: OnceLock<[Vec<u8>; 2]> = OnceLock::new();
    LOGS.get_or_init(|| {
        let flight = Flight::wing(0.01, 10.0, 5);
        [UlogFile::of(&flight.steps).bytes, DataFlashFile::of(&flight.steps).bytes]
    })
}

fn imu(inputs: &[Input]) -> usize {
    inputs.iter().filter(|i| matches!(i, Input::Sample(Sample::Imu(_)))).count()
}

/// Everything in the log is a number.
fn finite(inputs: &[Input]) -> bool {
    inputs.iter().all(|i| match i {
        Input::Sample(Sample::Imu(s)) => (s.angular_rate.raw() + s.specific_force.raw()).norm().is_finite(),
        Input::Sample(Sample::Mag(s)) => s.field.raw().norm().is_finite(),
        Input::Sample(Sample::Gnss(s)) => s.is_possible(),
        Input::Sample(Sample::Pressure(s)) => s.pressure_pa.is_finite(),
        Input::Sample(Sample::Flow(s)) => s.rate_xy.iter().all(|r| r.is_finite()),
        _ => true,
    })
}

#[test]
fn a_log_that_was_appended_to_another_is_another_boot() {
    let folder = tempfile::tempdir().unwrap();
    for log in logs() {
        let once = inputs(&write_log(folder.path(), "once", log)).0;
        let (twice, summary) = inputs(&write_log(folder.path(), "twice", &[&log[..], log].concat()));
        assert_eq!(summary.reboots, 1);
        assert!(imu(&twice) + 5 >= 2 * imu(&once), "{} {}", imu(&twice), imu(&once));
    }
}

#[test]
fn dropouts_and_numbers_that_nobody_registered_are_told() {
    let folder = tempfile::tempdir().unwrap();
    let mut file = UlogFile::of(&Flight::rotor(0.01, 2.0, 1).steps);
    file.message(b'O', &1500u16.to_le_bytes());
    file.message(b'D', &[99, 0, 1, 2, 3, 4, 5, 6, 7, 8]);
    file.message(b'O', &500u16.to_le_bytes());
    let (_, summary) = inputs(&write_log(folder.path(), "log", &file.bytes));
    let remarks = summary.remarks();
    assert!(remarks.contains(&"the logger dropped data 2 times, 2.0 s in all".to_owned()), "{remarks:?}");
    assert_eq!(summary.counters.of(Cause::UnknownId), 1);
}

#[test]
fn a_packed_log_that_is_cut_off_loses_its_end_and_nothing_else() {
    let folder = tempfile::tempdir().unwrap();
    let [_, log] = logs();
    let whole = imu(&inputs(&write_log(folder.path(), "whole", log)).0);
    // A frame whose window is all of it: blocks of raw bytes.
    let mut packed = [&[0x28, 0xB5, 0x2F, 0xFD, 0xA0][..], &(log.len() as u32).to_le_bytes()].concat();
    for block in log.chunks(10_000) {
        packed.extend_from_slice(&((block.len() as u32) << 3).to_le_bytes()[..3]);
        packed.extend_from_slice(block);
    }
    packed.truncate(packed.len() / 2);
    let path = write_log(folder.path(), "half.bin.zst", &packed);
    let (half, summary) = inputs(&path);
    let share = imu(&half) as f64 / whole as f64;
    assert!((0.4..0.51).contains(&share) && summary.truncated, "{share}");
    let ran = holdover(&["inspect", path.to_str().unwrap()]);
    assert!(ran.code == Some(0) && ran.out.contains("the file is cut off"), "{ran:?}");
    let report = holdover(&["inspect", path.to_str().unwrap(), "--json"]).json();
    assert_eq!(report["truncated"], true);
}

#[test]
fn a_file_that_is_not_there_is_told_in_words() {
    for arguments in [&["inspect", "no-such.bin"][..], &["check", "--config", "no-such.toml"]] {
        let ran = holdover(arguments);
        assert!(ran.err.contains("No such file or directory\n"), "{ran:?}");
    }
}

#[test]
fn what_cannot_be_read_is_refused_with_the_documented_code() {
    let folder = tempfile::tempdir().unwrap();
    let [ulog, dataflash] = logs();
    let cases: [(&str, &[u8], &str); 5] = [
        ("key.ulge", b"ULogKey\x01 and what is encrypted", "encrypted"),
        ("head.ulg", &ulog[..16], "not a message"),
        ("fmt.bin", &dataflash[..89], "not a message"),
        ("archive.zip", b"PK\x03\x04 something", "archive"),
        ("packed.gz", b"\x1F\x8B\x08\x00 no deflate follows here", "unpacked"),
    ];
    for (name, bytes, word) in cases {
        let path = write_log(folder.path(), name, bytes);
        assert!(matches!(Log::open(&path, None), Err(LogError::NotALog { .. })), "{name}");
        holdover(&["replay", path.to_str().unwrap()]).fails(3, &[name, word]);
    }
}

#[test]
fn a_log_without_fixes_or_without_an_imu_says_so() {
    let folder = tempfile::tempdir().unwrap();
    let steps = Flight::wing(0.01, 20.0, 5).steps;
    let mut without_imu = UlogFile::new(&[]);
    let mut without_fix = UlogFile::new(&[]);
    for sample in steps.iter().flat_map(|s| &s.samples) {
        let us = crate::ulog_file::micros(sample);
        match sample {
            Sample::Imu(_) => without_fix.sample(us, sample),
            Sample::Flow(_) => {}
            Sample::Gnss(_) => without_imu.sample(us, sample),
            other => {
                without_imu.sample(us, other);
                without_fix.sample(us, other);
            }
        }
    }
    // A receiver that has none is no GNSS to start from.
    let declaration = "uint8_t fix_type;double latitude_deg;double longitude_deg;double altitude_msl_m";
    for i in 0..50 {
        let fields = Fields::default().u8(1).f64(0.0).f64(0.0).f64(0.0);
        without_fix.data("vehicle_gps_position", declaration, 2_000_000 + i * 200_000, fields);
    }
    for (name, file, why) in [("imu.ulg", without_imu, "no IMU"), ("fix.ulg", without_fix, "no GNSS fix")] {
        let path = write_log(folder.path(), name, &file.bytes);
        holdover(&["replay", path.to_str().unwrap()]).fails(4, &[name, why]);
        holdover(&["evaluate", path.to_str().unwrap()]).fails(4, &[name, why]);
        let inspected = holdover(&["inspect", path.to_str().unwrap(), "--json"]).json();
        assert!(inspected["lacks"].as_str().unwrap().contains(why), "{inspected}");
        assert!(!inspected["lacks"].as_str().unwrap().contains("holds GNSS") || name == "imu.ulg");
    }
}

fn play(folder: &Path, bytes: &[u8]) -> Option<(Vec<Input>, u64)> {
    let path = write_log(folder, "damaged", bytes);
    let log = Log::open(&path, None).ok()?;
    let mut read = Vec::new();
    let summary = log.play(|_, _| {}, |_, i| read.push(*i)).unwrap();
    Some((read, summary.skipped_bytes()))
}

proptest! {
    #![proptest_config(ProptestConfig { cases: 48, failure_persistence: None, ..ProptestConfig::default() })]

    #[test]
    fn whatever_is_done_to_a_log_costs_what_it_hits(
        which in 0usize..2,
        flips in proptest::collection::vec((0.1f64..1.0, 0u8..8), 0..20),
        garbage in proptest::collection::vec(any::<u8>(), 0..3000),
        at in 0.1f64..1.0,
        cut in 0.5f64..1.0,
    ) {
        let folder = tempfile::tempdir().unwrap();
        let whole = &logs()[which];
        let all = imu(&play(folder.path(), whole).unwrap().0);
        let place = |part: f64, n: usize| ((part * n as f64) as usize).min(n - 1);
        let mut bytes = whole.clone();
        for (part, bit) in &flips {
            let i = place(*part, bytes.len());
            bytes[i] ^= 1 << bit;
        }
        let i = place(at, bytes.len());
        bytes.splice(i..i, garbage.iter().copied());
        bytes.truncate(place(cut, bytes.len()) + 1);
        let (read, skipped) = play(folder.path(), &bytes).unwrap();
        prop_assert!(finite(&read));
        // Every hit may take the message that it hits, and those beside it that nothing proves any more.
        let least = cut * all as f64 - 6.0 * (flips.len() as f64 + 2.0) - garbage.len() as f64 / 30.0;
        prop_assert!(imu(&read) as f64 >= least, "{} of {all}, at least {least}", imu(&read));
        prop_assert!(skipped <= bytes.len() as u64);
    }

    #[test]
    fn arbitrary_bytes_behind_a_good_beginning_are_read(which in 0usize..2, tail in proptest::collection::vec(any::<u8>(), 0..20_000)) {
        let folder = tempfile::tempdir().unwrap();
        let whole = &logs()[which];
        if let Some((read, _)) = play(folder.path(), &[&whole[..whole.len() / 10], &tail].concat()) {
            prop_assert!(finite(&read));
        }
    }
}
