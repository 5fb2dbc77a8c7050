#![no_main]
libfuzzer_sys::fuzz_target!(|bytes: &[u8]| lumenfab_fuzz::as_corrections(bytes));
