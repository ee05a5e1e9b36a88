//! What it costs to find that a megabyte of hostile bytes holds no frame: `cargo bench --bench hostile_bytes`.

use divan::Bencher;
use divan::counter::BytesCount;
use holdover::wire::tlog::TlogReader;

const LEN: usize = 1_000_000;

/// Bytes that declare as much as they can, as often as they can.
const PATTERNS: [(&str, &[u8]); 6] = [
    ("0xFE", &[0xFE]),
    ("0xFD", &[0xFD]),
    ("MAVLink 1, length 255", &[0xFE, 255]),
    ("MAVLink 2, length 255, heartbeat", &[0xFD, 255, 0, 0, 0, 0, 0, 0, 0, 0]),
    ("both, nested", &[0xFE, 0xFD, 255, 0, 0, 0, 0, 0, 0, 0]),
    ("unknown messages", &[0xFD, 9, 0, 0, 0, 1, 1, 0xFD, 0xFD, 0xFD]),
];

fn pattern(bytes: &[u8]) -> Vec<u8> {
    bytes.iter().copied().cycle().take(LEN).collect()
}

fn read(mut reader: TlogReader<&[u8]>) -> u64 {
    let mut frames = 0;
    while let Ok(Some(_)) = reader.next_record() {
        frames += 1;
    }
    frames
}

#[divan::bench(args = PATTERNS.map(|(name, _)| name))]
fn a_log_with_stamps(bencher: Bencher, name: &str) {
    let Some((_, bytes)) = PATTERNS.iter().find(|(n, _)| *n == name) else { return };
    let log = pattern(bytes);
    bencher.counter(BytesCount::new(LEN)).bench(|| read(TlogReader::new(log.as_slice())));
}

#[divan::bench(args = PATTERNS.map(|(name, _)| name))]
fn frames_alone(bencher: Bencher, name: &str) {
    let Some((_, bytes)) = PATTERNS.iter().find(|(n, _)| *n == name) else { return };
    let log = pattern(bytes);
    bencher.counter(BytesCount::new(LEN)).bench(|| read(TlogReader::without_stamps(log.as_slice())));
}

fn main() {
    divan::main();
}
