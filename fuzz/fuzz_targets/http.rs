//! See `tests/fuzz/bodies`.
#![no_main]

#[path = "../../tests/fuzz/bodies/mod.rs"]
mod bodies;

libfuzzer_sys::fuzz_target!(|bytes: &[u8]| {
    if let Some(target) = bodies::named("http") {
        (target.run)(bytes);
    }
});
