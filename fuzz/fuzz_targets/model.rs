#![no_main]

libfuzzer_sys::fuzz_target!(|bytes: &[u8]| jitai_fuzz::targets::model(bytes));
