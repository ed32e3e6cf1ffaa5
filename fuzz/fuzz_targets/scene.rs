#![no_main]
#[path = "../text_invariants.rs"]
mod text_invariants;
libfuzzer_sys::fuzz_target!(|bytes: &[u8]| {
    if let Ok(text) = std::str::from_utf8(bytes) {
        text_invariants::check_scene(text);
    }
});
