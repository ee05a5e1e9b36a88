//! Fuzzing as far as a build has time for: every input of the corpus, and a minute of others that a fixed seed makes of them. For hours:
//! `cargo run --release --example fuzz -- --hours 1`; guided by coverage: `cargo fuzz`, see `fuzz/`.
#![allow(
    clippy::unwrap_used,
    clippy::expect_used,
    clippy::panic,
    reason = "helpers of tests may fail like tests"
)]

mod bodies;
mod mutate;

#[path = "../support/dataflash_file.rs"]
mod dataflash_file;
#[path = "../support/flight.rs"]
mod flight;
#[path = "../support/ulog_file.rs"]
mod ulog_file;

use std::collections::BTreeSet;
use std::fs::{self, File};
use std::path::Path;

use bodies::{TARGETS, named};
use holdover::wire::tlog::TlogReader;
use mutate::{Dice, corpus, mutated, tried};

/// Inputs of each target, as many as take some seconds.
const INPUTS: [(&str, u64); 9] = [
    ("deframer", 60_000),
    ("tlog", 30_000),
    ("ulog", 20_000),
    ("dataflash", 20_000),
    ("decode", 6_000),
    ("config", 600),
    ("http", 15_000),
    ("signing", 15_000),
    ("pipeline", 600),
];

#[test]
fn the_corpus_is_survived() {
    for target in &TARGETS {
        let inputs = corpus(target.name);
        assert!(!inputs.is_empty(), "{} has no corpus", target.name);
        for (path, bytes) in inputs {
            tried(target.run, &bytes).unwrap_or_else(|why| panic!("{}: {why}", path.display()));
        }
        // What is shorter than anything.
        assert_eq!(tried(target.run, &[]), Ok(1));
    }
}

/// A target over inputs of a fixed seed; the bytes of the first that it does not stand are shown.
fn fuzzed(name: &str) {
    let inputs = corpus(name);
    let target = named(name).unwrap();
    let (_, n) = INPUTS.iter().find(|(of, _)| *of == name).unwrap();
    let mut dice = Dice(14);
    let mut got_through = 0;
    for i in 0..*n {
        let bytes = mutated(&mut dice, &inputs);
        match tried(target.run, &bytes) {
            Ok(n) => got_through += n,
            Err(why) => panic!("input {i} of {name}: {why}\n{bytes:02x?}"),
        }
    }
    // Nearly nothing would be got through if inputs were thrown away before they are looked at.
    assert!(got_through >= *n, "{got_through}");
}

macro_rules! fuzz_tests {
    ($($name:ident)+) => { $(#[test] fn $name() { fuzzed(stringify!($name)); })+ };
}

fuzz_tests! { deframer tlog ulog dataflash decode config http signing pipeline }

#[test]
fn every_target_is_a_test_and_one_of_cargo_fuzz() {
    let folder = Path::new(env!("CARGO_MANIFEST_DIR")).join("fuzz");
    let manifest = fs::read_to_string(folder.join("Cargo.toml")).unwrap();
    for target in &TARGETS {
        let name = target.name;
        assert!(INPUTS.iter().any(|(of, _)| *of == name), "{name}");
        let text = fs::read_to_string(folder.join(format!("fuzz_targets/{name}.rs"))).unwrap();
        assert!(text.contains(&format!("\"{name}\"")), "{name}");
        assert!(manifest.contains(&format!("name = \"{name}\"")), "{name}");
    }
}

/// Writes the corpus anew: `cargo test --release --test fuzz corpus -- --ignored`.
#[test]
#[ignore = "writes into the sources"]
fn the_corpus_is_written() {
    let root = Path::new(env!("CARGO_MANIFEST_DIR"));
    let put = |target: &str, name: &str, bytes: &[u8]| {
        let folder = root.join("tests/fuzz/corpus").join(target);
        fs::create_dir_all(&folder).unwrap();
        fs::write(folder.join(name), bytes).unwrap();
    };
    for log in ["ardupilot-copter-gps-loss", "px4-quad-gps-loss"] {
        let (mut seen, mut stamped, mut frames) = (BTreeSet::new(), Vec::new(), Vec::new());
        let path = root.join("sitl-logs").join(format!("{log}.tlog"));
        let mut reader = TlogReader::new(File::open(path).unwrap());
        while let Some(record) = reader.next_record().unwrap() {
            // One of each message is enough to begin with.
            if seen.insert((record.frame.component().0, record.frame.message_id())) && frames.len() < 3000 {
                stamped.extend(record.written_us.to_be_bytes());
                stamped.extend(record.frame.bytes());
                frames.extend(record.frame.bytes());
            }
        }
        put("deframer", log, &[&[16], &frames[..]].concat());
        put("tlog", log, &stamped);
        put("decode", log, &frames);
        put("signing", log, &frames[..600]);
    }
    put("signing", "changes", &(0..60u8).flat_map(|i| [i, i % 3]).collect::<Vec<u8>>());
    let flight = flight::Flight::rotor(0.02, 0.3, 1);
    put("ulog", "rotor", &ulog_file::UlogFile::of(&flight.steps).bytes[7..]);
    put("dataflash", "rotor", &dataflash_file::DataFlashFile::of(&flight.steps).bytes[3..]);
    put(
        "config",
        "some",
        b"outbound.rate_hz=20\nlink.endpoints=udpin:127.0.0.1:1,serial:/dev/x:9\nvehicle.system_id=3\n",
    );
    put("config", "lists", b"cameras=[{component = 4, yaw_deg = 3.5}]\nflow.patches=[{id = 1, right_deg = -20, forward_deg = 15}]\n");
    put(
        "config",
        "signing",
        b"signing.key_file=k\nsigning.accept_unsigned=heartbeat\ntuning.gnss.loss_s=1e3\n",
    );
    let host = "Host: localhost:8750";
    for (name, size, lines) in [
        ("page", 255, format!("GET / HTTP/1.1\r\n{host}\r\nOrigin: http://localhost:8750\r\n\r\n")),
        ("status", 7, "GET /api/v1/status HTTP/1.1\r\nHost: [::1]:8750\r\nAccept: */*\r\n\r\n".to_owned()),
        ("events", 255, "GET /api/v1/events?after=0 HTTP/1.1\r\nHost: 127.0.0.1\r\n\r\n".to_owned()),
        ("stream", 255, format!("GET /api/v1/stream HTTP/1.1\r\n{host}\r\nLast-Event-ID: 3\r\n\r\n")),
        ("metrics", 0, format!("HEAD /metrics HTTP/1.0\r\n{host}\r\n\r\nGET /page.js HTTP/1.1\r\n{host}\r\n\r\n")),
        ("track", 31, format!("GET /api/v1/track HTTP/1.1\r\n{host}\r\nConnection: Upgrade\r\nUpgrade: h2c\r\nExpect: 100-continue\r\n\r\n")),
        ("post", 15, format!("POST /api/v1/openapi.json HTTP/1.1\r\n{host}\r\nTransfer-Encoding: chunked\r\n\r\n3\r\nabc\r\n0\r\n\r\n")),
        ("foreign", 255, "GET http://localhost/../page.css HTTP/1.1\r\nHost: drone.local.evil.example\r\nContent-Length: 3\r\n\r\nabc".to_owned()),
    ] {
        put("http", name, &[&[size], lines.as_bytes()].concat());
    }
    let mut dice = Dice(3);
    for (which, name) in [(0, "aided"), (1, "outage"), (2, "back")] {
        let script: Vec<u8> = (0..40).flat_map(|_| dice.roll().to_le_bytes().into_iter().take(6)).collect();
        put("pipeline", name, &[&[which], &script[..]].concat());
    }
}
