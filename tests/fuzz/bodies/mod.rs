//! What is fuzzed: one function a target, from bytes to assertions. The coverage-guided targets in `fuzz/`, the runner of hours in `examples/fuzz.rs`
//! and the tests of every build are these same functions.
#![allow(dead_code, reason = "not every user needs all of it")]
#![allow(clippy::expect_used, reason = "a target fails by panicking")]

mod bytes;
mod decode;
mod http;
mod logs;
mod pipeline;
mod texts;

/// A target: its name, and what it does with bytes. It tells what it has got through: frames where there are some, else 1.
pub struct FuzzTarget {
    pub name: &'static str,
    pub run: fn(&[u8]) -> u64,
}

/// All of them.
pub const TARGETS: [FuzzTarget; 9] = [
    FuzzTarget { name: "deframer", run: bytes::deframer },
    FuzzTarget { name: "tlog", run: bytes::tlog },
    FuzzTarget { name: "ulog", run: logs::ulog },
    FuzzTarget { name: "dataflash", run: logs::dataflash },
    FuzzTarget { name: "decode", run: decode::decode },
    FuzzTarget { name: "config", run: texts::config },
    FuzzTarget { name: "http", run: http::http },
    FuzzTarget { name: "signing", run: bytes::signing },
    FuzzTarget { name: "pipeline", run: pipeline::pipeline },
];

/// The target of a name.
pub fn named(name: &str) -> Option<&'static FuzzTarget> {
    TARGETS.iter().find(|t| t.name == name)
}
