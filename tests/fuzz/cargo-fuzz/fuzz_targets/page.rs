#![no_main]
libfuzzer_sys::fuzz_target!(|bytes: &[u8]| {
    r4_fuzz::page::page(bytes);
});
